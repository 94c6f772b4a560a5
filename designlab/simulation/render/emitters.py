"""LEDs as sources: photons that leave them, and the same light as a Mitsuba emitter."""

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from designlab.core.backend import activate
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.surfaces import bsdf, diffuse
from designlab.simulation.scene.scene import Light, Scene
from geometries.emission import AngularProfile

if TYPE_CHECKING:
    import mitsuba

NODES = 1024  # steps of a table in sqrt(1 - cosine): 0.08 deg at the axis, 0.06 deg at 90 deg
PLANES = 360  # planes of a table that is not round
BESIDE_AXIS = 1e-4  # density by solid angle is taken here instead of on the axis itself


def photons(lights: list[Light], sampler: Any, size: int) -> "mitsuba.Ray3f":
    """Rays of photons of equal power that leave the lights of one group.

    They start uniformly on each face, which gets its share of them; their directions follow the lights'
    angular profile exactly, so that the power of the group does not depend on it.
    """
    profile = _common_profile(lights)
    flux = np.array([light.flux_mw for light in lights])
    bounds = np.cumsum(flux / flux.sum())
    choice = sampler.next_1d()
    index = dr.zeros(mi.UInt32, size)
    for bound in bounds[:-1]:
        index += dr.select(choice >= float(bound), mi.UInt32(1), mi.UInt32(0))

    def column(values: Any) -> Any:
        table = np.array(values, dtype=np.float32)
        return mi.Vector3f(*(dr.gather(mi.Float, mi.Float(table[:, k]), index) for k in range(3)))

    centre, normal = column([light.centre_mm for light in lights]), column([light.normal for light in lights])
    across = column([light.half_width_mm * np.asarray(light.across) for light in lights])
    down = column([light.half_height_mm * np.asarray(light.down) for light in lights])
    place = sampler.next_2d()
    origin = centre + across * (2 * place.x - 1) + down * (2 * place.y - 1)
    if profile.is_lambertian:
        direction = mi.Frame3f(normal).to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d()))
    else:
        local = Directions(profile).sample(sampler.next_2d())
        frame = mi.Frame3f(dr.normalize(across), dr.normalize(down), normal)
        direction = frame.to_world(local)
    return mi.Ray3f(mi.Point3f(origin + 1e-4 * normal), direction)


def _common_profile(lights: list[Light]) -> AngularProfile:
    profile = lights[0].profile
    if any(light.profile != profile for light in lights):
        raise ValueError("leds.groups: all LEDs of a group share one angular profile")
    return profile


class Directions:
    """Angular profile in Dr.Jit: directions drawn from it, and its density by solid angle.

    A power of the cosine is inverted in closed form. A table is put on a grid over v = sqrt(1 - cosine) and
    the azimuth, where solid angle is 2 v dv d(azimuth); its bilinear interpolant is both drawn from and
    evaluated, so that photons and path tracer see one and the same light.
    """

    def __init__(self, profile: AngularProfile) -> None:
        self.power = profile.power
        if self.power is None:
            v = np.linspace(0.0, 1.0, NODES + 1)
            turn = np.linspace(0.0, 360.0, (PLANES if profile.azimuth_deg else 1) + 1)
            polar = np.degrees(np.arccos(1.0 - v**2))
            density = profile.share_per_sr(*np.meshgrid(polar, turn)) * 2 * v
            self.table = mi.MarginalContinuous2D0(np.ascontiguousarray(density, dtype=np.float32))

    def sample(self, uniform: Any) -> Any:
        """Local unit vectors, z along the normal."""
        if self.power is None:
            drawn, _ = self.table.sample(uniform)
            cosine, turn = 1.0 - drawn.x * drawn.x, drawn.y * dr.two_pi
        else:
            # Inverse of the share 1 - cos^(m + 1) of the flux within a polar angle.
            cosine, turn = dr.power(1.0 - uniform.x, 1.0 / (self.power + 1.0)), uniform.y * dr.two_pi
        sine = dr.safe_sqrt(1.0 - cosine * cosine)
        return mi.Vector3f(sine * dr.cos(turn), sine * dr.sin(turn), cosine)

    def density(self, local: Any) -> Any:
        """Share of the flux by solid angle (1/sr) in local directions; zero behind the face."""
        front = local.z > 0
        if self.power is not None:
            scale = (self.power + 1.0) / (2.0 * np.pi)
            return dr.select(front, scale * dr.power(dr.maximum(local.z, 1e-12), self.power), 0.0)
        v = dr.maximum(dr.safe_sqrt(1.0 - local.z), BESIDE_AXIS)
        turn = dr.atan2(local.y, local.x) / dr.two_pi
        pdf = self.table.eval(mi.Point2f(v, turn - dr.floor(turn)))
        return dr.select(front, pdf / (dr.two_pi * 2.0 * v), 0.0)


def emitter(light: Light, scene: Scene, group: int) -> dict[str, Any]:
    """Emitting rectangle for Mitsuba's dictionary of a scene.

    Raises
    ------
    RuntimeError
        If its profile is not Lambertian and the back end is ``scalar_rgb``, which calls no Python code.
    """
    # The rectangle plug-in spans [-1, 1]^2 and emits along +z: its columns are the half axes and the normal.
    across, normal = np.asarray(light.across), np.asarray(light.normal)
    up = np.cross(normal, across)
    matrix = np.eye(4)
    matrix[:3, 0] = light.half_width_mm * across
    matrix[:3, 1] = light.half_height_mm * up
    matrix[:3, 2] = normal
    matrix[:3, 3] = light.centre_mm
    board = next((s for s in scene.shapes if s.name.startswith("board")), None)
    source: Any = {"type": "area", "radiance": {"type": "rgb", "value": [float(light.radiance)] * 3}}
    if not light.profile.is_lambertian:
        backend = activate()
        if not backend.is_jit:
            raise RuntimeError(
                f"leds.profile: the back end {backend.variant} renders Lambertian LEDs only; other profiles "
                "need LLVM 17 or newer, or CUDA (see `designlab doctor`)"
            )
        source = _profiled_area(backend.variant)(light)
    return {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f(matrix),
        "bsdf": bsdf(board.material, group) if board is not None else diffuse(0.0),
        "emitter": source,
    }


@cache
def _profiled_area(variant: str) -> Any:
    """Class of an area emitter with an angular profile, for one variant of Mitsuba, which must be set."""

    class ProfiledArea(mi.Emitter):  # type: ignore[misc]
        """Rectangle whose radiance depends on direction; next-event samples are uniform over its area."""

        def __init__(self, light: Light) -> None:
            mi.Emitter.__init__(self, mi.Properties())
            self.m_flags = int(mi.EmitterFlags.Surface)
            self.m_needs_sample_2 = self.m_needs_sample_3 = True
            self.light, self.directions = light, Directions(light.profile)
            # Radiance of a Lambertian face of this flux, times pi: flux over area.
            self.exitance = float(np.pi * light.radiance)
            self.area = 4.0 * light.half_width_mm * light.half_height_mm

        def _radiance(self, towards: Any, active: Any) -> Any:
            """Radiance leaving in world directions."""
            axes = (self.light.across, self.light.down, self.light.normal)
            local = mi.Vector3f(*(dr.dot(mi.Vector3f(*axis), towards) for axis in axes))
            share = self.directions.density(local)
            return mi.Spectrum(
                dr.select(active & (local.z > 0), self.exitance * share / dr.maximum(local.z, 1e-6), 0.0)
            )

        def _place(self, sample: Any) -> Any:
            light = self.light
            across = mi.Vector3f(*(light.half_width_mm * np.asarray(light.across)).tolist())
            down = mi.Vector3f(*(light.half_height_mm * np.asarray(light.down)).tolist())
            return mi.Point3f(*light.centre_mm) + across * (2 * sample.x - 1) + down * (2 * sample.y - 1)

        def eval(self, si: Any, active: Any = True) -> Any:
            return self._radiance(si.to_world(si.wi), active)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            ds = dr.zeros(mi.DirectionSample3f)
            ds.p, ds.n = self._place(sample), mi.Normal3f(*self.light.normal)
            ds.uv, ds.time, ds.delta = sample, it.time, False
            ds.emitter = mi.EmitterPtr(self)
            ds.d = ds.p - it.p
            square = dr.squared_norm(ds.d)
            ds.dist = dr.sqrt(square)
            ds.d /= ds.dist
            facing = -dr.dot(ds.d, ds.n)
            active = active & (facing > 0)
            ds.pdf = dr.select(active, square / (facing * self.area), 0.0)
            weight = dr.select(active, self._radiance(-ds.d, active) / ds.pdf, 0.0)
            return ds, weight

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            facing = -dr.dot(ds.d, ds.n)
            pdf = ds.dist * ds.dist / (facing * self.area)
            return dr.select(active & (facing > 0), pdf, 0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return self._radiance(-ds.d, active)

        def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> Any:
            frame = mi.Frame3f(*(mi.Vector3f(*a) for a in (self.light.across, self.light.down)),
                               mi.Vector3f(*self.light.normal))  # fmt: skip
            ray = mi.Ray3f(self._place(sample2), frame.to_world(self.directions.sample(sample3)))
            return ray, mi.Spectrum(self.exitance * self.area) & active

        def to_string(self) -> str:
            return f"ProfiledArea[{self.light}]"

    return ProfiledArea
