"""Irradiance by light that matte surfaces reflected: each reflection of a photon shines on every point.

A photon that lands tells of one place; where it was last reflected it is a small light source, and tells of
all places at once (Keller 1997, "Instant radiosity"). So few photons give smooth light without grain.
"""

from typing import Any

import numpy as np

from designlab.core.types import Array
from designlab.simulation.render import bridge, photons
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.tables import held, on_device
from designlab.simulation.scene.scene import Scene

OFF_MM = 0.01  # from a surface, where rays between two points start and end
SOFT_MM = 0.5  # sources count as discs of this size, so that none is too bright near by
AT_ONCE = 2**22  # pairs of a source and a point; bounds memory


def irradiance(
    scene: Scene,
    x: Array,
    y: Array,
    *,
    group: int,
    photons_traced: int,
    seed: int,
    loaded: Any,
    guide: photons.Guide | None,
) -> Array:
    """Irradiance of the membrane by matte reflections of one LED group that emits 1 mW, in mW/mm2.

    Where a point is none of the membrane it is not a number: a ray down may slip through between two faces.

    Parameters
    ----------
    scene : Scene
        Without dielectrics: nothing bends or dims light between two surfaces.
    x, y : array, shape (n,)
        Points of the membrane (mm).
    photons_traced : int
        Photons whose reflections shine.
    loaded : mitsuba.Scene
        The scene loaded for this group.
    guide : Guide, optional
        Starts photons where they are worth most.
    """
    place, normal, power = _sources(scene, group, photons_traced, seed, loaded, guide)
    points, facing = _on_membrane(scene, x, y)
    total, count = np.where(np.isnan(points[:, 0]), np.nan, 0.0), power.size
    if not count:
        return total
    place, normal = place + OFF_MM * normal, np.ascontiguousarray(normal)
    sources = [on_device(column) for column in (*place.T, *normal.T, power)]
    step = max(1, AT_ONCE // count)
    for first in range(0, len(x), step):
        some = slice(first, first + step)
        size = len(points[some])
        pair = dr.arange(mi.UInt32, size * count)
        source, point = pair % held(count), pair // held(count)
        px, py, pz, nx, ny, nz, shines = (dr.gather(mi.Float, column, source) for column in sources)
        there = [on_device(column) for column in (*points[some].T, *facing[some].T)]
        qx, qy, qz, mx, my, mz = (dr.gather(mi.Float, column, point) for column in there)
        origin = mi.Point3f(px, py, pz)
        across = mi.Point3f(qx, qy, qz) - origin
        square = dr.squared_norm(across)
        cosines = dr.maximum(dr.dot(across, mi.Normal3f(nx, ny, nz)), 0.0)
        cosines *= dr.maximum(-dr.dot(across, mi.Normal3f(mx, my, mz)), 0.0)
        value = shines * cosines / (square * (dr.pi * square + SOFT_MM**2))
        ray = mi.Ray3f(origin, across)
        ray.maxt = held(1.0)
        value = dr.select(loaded.ray_test(ray, cosines > 0), 0.0, value)
        total[some] += np.asarray(dr.block_sum(value, count))
    return total


def _sources(
    scene: Scene, group: int, count: int, seed: int, loaded: Any, guide: photons.Guide | None
) -> tuple[Array, Array, Array]:
    """Places and normals (n, 3) of matte reflections, and the power (n,) that leaves there."""
    bounces = max(scene.path_length - 2, 0)
    kept = [dr.zeros(mi.Float, max(count * bounces, 1)) for _ in range(7)]

    def reflected(found: photons.Reflection, active: Any) -> None:
        normal = found.at.sh_frame.n
        index = found.number * mi.UInt32(bounces) + found.bounces
        for column, value in zip(kept, (*found.at.p, *normal, found.power), strict=True):
            dr.scatter(column, value, index, active & found.matte)

    own = int(np.random.SeedSequence([seed, group, 82]).generate_state(1)[0])
    photons.trace(
        scene,
        group=group,
        photons=count,
        seed=own,
        record=lambda arrival, active: None,
        loaded=loaded,
        guide=guide,
        reflected=reflected,
    )
    table = np.array([np.asarray(column) for column in kept], dtype=float)
    table = table[:, table[6] > 0]
    return table[:3].T, table[3:6].T, table[6]


def _on_membrane(scene: Scene, x: Array, y: Array) -> tuple[Array, Array]:
    """Points just above the membrane at x and y (mm), and its normals there, (n, 3) each; NaN where none."""
    above = float(scene.membrane.vertices[:, 2].max()) + 1.0
    origin = mi.Point3f(x.astype(np.float32), y.astype(np.float32), above)
    hit = bridge.load_shapes([scene.membrane]).ray_intersect(mi.Ray3f(origin, mi.Vector3f(0, 0, -1)))
    normal = np.array(hit.sh_frame.n).T
    points = np.where(np.array(hit.is_valid())[:, None], np.array(hit.p).T, np.nan)
    return points + OFF_MM * normal, normal
