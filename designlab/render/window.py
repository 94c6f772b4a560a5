"""What the membrane's light loses on its way to the camera."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from designlab.press import Surface
from designlab.render import bridge
from designlab.scene import Dielectric, Scene
from designlab.viewing import Rays

Array = NDArray[np.float64]
ON_THE_WAY = ("interface", "window")  # boundaries between membrane and camera


@lru_cache(maxsize=4)
def transmission(scene: Scene, surface: Surface, rays: Rays) -> Array:
    """Share of the membrane's radiance that reaches the camera, shape (groups, rows, columns).

    The viewing rays are followed from the membrane through the boundaries: Fresnel's losses for unpolarised
    light, what the media absorb or scatter away, and the widening of the beam on leaving the gel.
    """
    boundaries = {s.name: s for s in scene.shapes if s.name in ON_THE_WAY}
    passed = np.ones((scene.groups, *rays.x_mm.shape))
    if not boundaries:
        return passed
    import drjit as dr
    import mitsuba as mi

    loaded = bridge.load_shapes(boundaries.values())
    at_x, at_y = rays.hit(surface)
    at_z = surface.sample(np.nan_to_num(surface.z_mm), at_x, at_y)
    x, y, z, slope_x, slope_y = (
        mi.Float(np.ascontiguousarray(a, dtype=np.float32).ravel())
        for a in (at_x, at_y, at_z, rays.slope_x, rays.slope_y)
    )
    ray = mi.Ray3f(mi.Point3f(x, y, z), dr.normalize(mi.Vector3f(slope_x, slope_y, 1.0)))
    for name in ON_THE_WAY:
        boundary = boundaries[name].material
        assert isinstance(boundary, Dielectric)
        si = loaded.ray_intersect(ray)
        ratio = boundary.inside.index / boundary.outside.index
        normal = dr.mulsign(si.n, dr.dot(si.n, ray.d))
        cosine = dr.dot(normal, ray.d)
        reflected, *_ = mi.fresnel(cosine, 1 / ratio)
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
