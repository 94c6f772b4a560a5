"""What the membrane's light loses on its way to the camera."""

from functools import lru_cache
from typing import Any

import numpy as np

from designlab.core.types import Array
from designlab.sensor.optical_constants import AIR
from designlab.simulation.contact.surface import Surface
from designlab.simulation.optics.viewing_rays import Rays
from designlab.simulation.render import bridge
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.tables import on_device
from designlab.simulation.scene.scene import Dielectric, Scene

ON_THE_WAY = ("interface", "window")  # boundaries between membrane and camera
RIM = "window-rim"  # the plane around a hollow window
OFF_EDGES_MM = (1.3e-3, 0.7e-3)  # along edges of a round mesh, as on the axis, rays miss it
GAP = "gap-gel"  # the interface where gel and core have come apart: gel, then air, then core


@lru_cache(maxsize=4)
def transmission(scene: Scene, surface: Surface, rays: Rays) -> Array:
    """Share of the membrane's radiance that reaches the camera, shape (groups, rows, columns).

    The viewing rays are followed from the membrane through the boundaries: Fresnel's losses for unpolarised
    light, what the media absorb or scatter away, and the widening of the beam on leaving the gel. Of a gap
    between gel and core all reflections within it count, and its thickness does not.
    """
    boundaries = {s.name: s for s in scene.shapes if s.name in (*ON_THE_WAY, GAP, RIM)}
    passed = np.ones((scene.groups, *rays.x_mm.shape))
    if not boundaries:
        return passed
    loaded = bridge.load_shapes(boundaries.values())
    at_x, at_y = rays.hit(surface)
    at_z = surface.sample(np.nan_to_num(surface.z_mm), at_x, at_y)
    x, y, z, slope_x, slope_y = (on_device(a) for a in (at_x, at_y, at_z, rays.slope_x, rays.slope_y))
    beside = mi.Vector3f(*OFF_EDGES_MM, 0.0)
    ray = mi.Ray3f(mi.Point3f(x, y, z) + beside, dr.normalize(mi.Vector3f(slope_x, slope_y, 1.0)))
    for name in ON_THE_WAY:
        boundary = boundaries[name].material
        assert isinstance(boundary, Dielectric)
        si = loaded.ray_intersect(ray)
        ratio = boundary.inside.index / boundary.outside.index
        normal = dr.mulsign(si.n, dr.dot(si.n, ray.d))
        cosine = dr.dot(normal, ray.d)
        reflected, *_ = mi.fresnel(cosine, 1 / ratio)
        if name == "interface" and GAP in boundaries:
            gap = next(mi.ShapePtr(shape) for shape in loaded.shapes() if shape.id() == GAP)
            reflected = dr.select(si.shape == gap, _off_gap(cosine, boundary), reflected)
        onward = dr.safe_sqrt(1 - ratio**2 * (1 - cosine * cosine))
        direction = ratio * ray.d + (onward - ratio * cosine) * normal
        share = np.asarray(dr.select(si.is_valid(), 1 - reflected, 0.0)).reshape(rays.x_mm.shape)
        way_mm = np.nan_to_num(np.asarray(si.t).reshape(rays.x_mm.shape), posinf=0.0)
        medium = boundary.inside
        for group in range(scene.groups):
            extinction = medium.absorption_per_mm[group] + medium.scattering_per_mm
            passed[group] *= share * np.exp(-extinction * way_mm)
        ray = si.spawn_ray(dr.normalize(direction))
    gel = boundaries["interface"].material
    assert isinstance(gel, Dielectric)
    return passed / gel.inside.index**2


def _off_gap(cosine: Any, boundary: Dielectric) -> Any:
    """Share of light that a gap of air in a boundary reflects; thick against the wave, so without phases."""
    inner, outer = boundary.inside.index / AIR.index, boundary.outside.index / AIR.index
    first, *_ = mi.fresnel(cosine, 1 / inner)
    between = dr.safe_sqrt(1 - inner**2 * (1 - cosine * cosine))
    second, *_ = mi.fresnel(between, outer)
    passed = (1 - first) * (1 - second) / dr.maximum(1 - first * second, 1e-6)
    return dr.select(first >= 1, 1.0, 1 - passed)
