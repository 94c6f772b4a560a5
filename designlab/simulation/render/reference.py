"""Unbiased pictures of one press where light refracts: every photon at the membrane is seen by the camera.

The way from a membrane point to the camera is the viewing ray through the layers, run backwards; so each
photon that arrives adds its share to the pixel that sees it. On average this is the box-filtered picture of
the pressed mesh: nothing is smoothed, binned or left out.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.simulation.contact.surface import Surface
from designlab.simulation.optics.viewing_rays import Rays
from designlab.simulation.render import photons
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.eye import Eye
from designlab.simulation.render.stray import stray
from designlab.simulation.render.window import transmission
from designlab.simulation.scene.scene import Scene


def radiance(
    scene: Scene, surface: Surface, rays: Rays, *, photons_per_group: int, seed: int
) -> NDArray[np.float32]:
    """Radiance of every LED group at unit flux, shape (groups, rows, columns), in mW/mm2/sr per mW.

    Parameters
    ----------
    scene : Scene
        The pressed scene; the camera looks through a window onto it.
    surface : Surface
        Its membrane.
    rays : Rays
        Where the pixels look.
    photons_per_group : int
        Effort.
    seed : int
        Seed of the random numbers.
    """
    eye, shape = Eye.of(rays), rays.x_mm.shape
    passed = transmission(scene, surface, rays)
    pictures = []
    for group in range(scene.groups):
        loaded = photons.load(scene, group)
        camera = _Camera(eye, shape, loaded)

        def worth(arrival: photons.Arrival, active: Any, *, camera: "_Camera" = camera) -> Any:
            return camera.sees(arrival, active)[0]

        (guide,) = photons.learn(scene, group=group, seed=seed, worth=[worth], loaded=loaded)
        picture = dr.zeros(mi.Float, shape[0] * shape[1])

        def record(
            arrival: photons.Arrival, active: Any, *, camera: "_Camera" = camera, picture: Any = picture
        ) -> None:
            value, pixel, seen = camera.sees(arrival, active)
            dr.scatter_add(picture, value, pixel, seen)

        photons.trace(
            scene,
            group=group,
            photons=photons_per_group,
            seed=seed,
            record=record,
            loaded=loaded,
            guide=guide,
        )
        pictures.append(np.asarray(picture).reshape(shape) * passed[group])
    haze = stray(scene, photons_per_group=photons_per_group, seed=seed)
    return np.asarray(np.stack(pictures) + haze, dtype=np.float32)


class _Camera:
    """The camera's side of a photon's way."""

    def __init__(self, eye: Eye, shape: tuple[int, int], loaded: Any) -> None:
        self.eye, self.shape, self.loaded = eye, shape, loaded
        opaque = ("membrane", "gel-rim", "core-side", "board")
        self.blockers = [mi.ShapePtr(s) for s in loaded.shapes() if s.id().startswith(opaque)]

    def sees(self, arrival: photons.Arrival, active: Any) -> tuple[Any, Any, Any]:
        """Radiance (before the window) that a photon adds to a pixel, which one, and whether it does."""
        si = arrival.at
        seen = self.eye.look(si.p.x, si.p.y, si.p.z)
        across, down = mi.Int32(dr.floor(seen.column + 0.5)), mi.Int32(dr.floor(seen.row + 0.5))
        rows, columns = self.shape
        counts = active & (across >= 0) & (across < columns) & (down >= 0) & (down < rows)
        view = dr.normalize(mi.Vector3f(seen.slope_x, seen.slope_y, 1.0))
        local = si.to_local(view)
        context = mi.BSDFContext(mi.TransportMode.Importance)
        value = si.bsdf().eval(context, si, local, counts).x
        # Shading normals change neither the light that falls on a face nor the area of it that is seen.
        facing, lit = dr.dot(si.n, view), dr.dot(si.n, arrival.towards)
        value *= dr.abs(si.wi.z * facing) / dr.maximum(dr.abs(lit * local.z), 1e-4)
        counts &= (facing > 0) & (lit > 0) & (local.z > 0) & (value > 0)
        hit = self.loaded.ray_intersect_preliminary(si.spawn_ray(view), coherent=False, active=counts)
        for blocker in self.blockers:
            counts &= ~(hit.is_valid() & (hit.shape == blocker))
        amount = dr.select(counts, arrival.power * value / (view.z * seen.area), 0.0)
        return amount, mi.UInt32(dr.maximum(down * columns + across, 0)), counts
