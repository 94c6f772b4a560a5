"""What a point of the membrane sees through clear boundaries, and mirrored in the window.

Where light is split, sight goes one way: through, but for the window, which mirrors, as do other boundaries
where they let less pass than they mirror. The other ways are left to photons.
"""

from typing import Any, NamedTuple

import numpy as np

from designlab.matter import Dielectric
from designlab.render import bridge
from designlab.render.photons import Mirrors, dr_index, numbers_of, sides, straight_boundaries
from designlab.render.tables import held
from designlab.scene import Scene


class Last(NamedTuple):
    """The last straight piece of each line of sight, as Dr.Jit arrays.

    Attributes
    ----------
    ray
        Where it starts (mm), and its direction.
    reach
        Its length (mm) up to what is in the way.
    passed
        Share of the light that all boundaries let pass, or mirror.
    way
        Length (mm) of the pieces before within gel and core.
    mirrors
        How often it was mirrored.
    """

    ray: Any
    reach: Any
    passed: Any
    way: Any
    mirrors: Any


class Sight:
    """Lines of sight of one LED group through the clear boundaries of a scene.

    Parameters
    ----------
    scene : Scene
        The undeformed scene.
    group : int
        LED group that is looked for.
    inside : bool
        Whether its LEDs shine within the core.
    """

    def __init__(self, scene: Scene, group: int, inside: bool) -> None:
        import mitsuba as mi

        self._loaded = bridge.load_shapes(scene.shapes)
        self._mirrors = Mirrors(scene, group, self._loaded)
        self._most = held(straight_boundaries(scene))
        boundaries = {s.name: s.material for s in scene.shapes if isinstance(s.material, Dielectric)}
        gel, core = boundaries["interface"].inside, boundaries["interface"].outside
        numbers = numbers_of(self._loaded)
        count = max(numbers.values()) + 1
        # By number of the shape: index behind its surface over that before it, zero where sight ends; whether
        # it ends where not mirrored. By that and side: whether gel, or core, is there.
        indices, ends = np.zeros(count, dtype=np.float32), np.zeros(count, dtype=bool)
        matter = np.zeros((2, count, 2), dtype=np.float32)
        for name, number in numbers.items():
            boundary = boundaries.get(name)
            ends[number] = inside and name.startswith("core-side")
            if boundary is not None and not boundary.roughness:
                indices[number] = boundary.inside.index / boundary.outside.index
            for side, medium in enumerate(sides(name, boundaries, scene)):
                if medium in (gel, core):
                    matter[(gel, core).index(medium), number, side] = 1.0
        self._indices, self._ends = mi.Float(indices), mi.Bool(ends)
        self._matter = [mi.Float(table.ravel()) for table in matter]
        self._lost = [held(m.absorption_per_mm[group] + m.scattering_per_mm) for m in (gel, core)]
        self._squared = held((gel.index / (core.index if inside else 1.0)) ** 2)
        self._inside = held(float(inside))
        self._shrunk = held(gel.index / core.index), held(gel.index / (core.index if inside else 1.0))

    def last(self, origin: Any, direction: Any) -> Last:
        """Follow lines of sight from points within the gel."""
        import drjit as dr
        import mitsuba as mi

        def going(active: Any, *_: Any) -> Any:
            return active

        def step(active: Any, ray: Any, reach: Any, passed: Any, way: Any, mirrors: Any, met: Any) -> Any:
            si = self._loaded.ray_intersect(ray, active)
            shape = dr_index(si.shape)
            index = dr.gather(mi.Float, self._indices, shape, active & si.is_valid())
            cosine = -dr.dot(si.sh_frame.n, ray.d)
            reflected, behind, _, ratio = mi.fresnel(cosine, index)
            mirrored = self._mirrors.count(si.shape, reflected)
            through = ~mirrored & (reflected < 1.0) & ~dr.gather(mi.Bool, self._ends, shape, active)
            goes_on = active & (index > 0) & (mirrored | through) & (met < self._most)
            bent = mi.refract(-ray.d, si.sh_frame.n, behind, ratio)
            bent = dr.select(mirrored, ray.d + 2.0 * cosine * si.sh_frame.n, bent)
            side = 2 * shape + dr.select(dr.dot(si.n, ray.d) > 0, mi.UInt32(1), mi.UInt32(0))
            within = (si.t * dr.gather(mi.Float, table, side, goes_on) for table in self._matter)
            way = dr.select(goes_on, way + mi.Vector2f(*within), way)
            passed *= dr.select(goes_on, dr.select(mirrored, reflected, 1.0 - reflected), 1.0)
            reach = dr.select(active & ~goes_on, si.t, reach)
            ray = dr.select(goes_on, si.spawn_ray(bent), ray)
            mirrors += dr.select(goes_on & mirrored, mi.UInt32(1), mi.UInt32(0))
            return goes_on, ray, reach, passed, way, mirrors, met + 1

        size = dr.width(direction)
        start = dr.full(mi.Bool, True, size), mi.Ray3f(origin, direction), dr.zeros(mi.Float, size)
        none = dr.zeros(mi.UInt32, size), dr.zeros(mi.UInt32, size)
        state = (*start, dr.full(mi.Float, 1.0, size), dr.zeros(mi.Vector2f, size), *none)
        _, *found, _ = dr.while_loop(
            state, going, step, labels=("active", "ray", "reach", "passed", "way", "mirrors", "met")
        )
        return Last(*found)

    def kept(self, last: Last, length: Any) -> Any:
        """By how much radiance within the gel is that of a face at some length (mm) of the last piece.

        Boundaries, absorption and haze take from it; across a boundary it changes with the square of the
        refractive index.
        """
        import drjit as dr

        gel, core = self._lost
        lost = gel * last.way.x + core * (last.way.y + self._inside * length)
        return last.passed * dr.exp(-lost) * self._squared

    def apparent(self, last: Last, length: Any) -> Any:
        """How far away a face at some length (mm) of the last piece appears from within the gel (mm).

        Along the axis of a plane boundary; slanting rays make it differ by direction, as little as it counts.
        """
        core, end = self._shrunk
        return last.way.x + core * last.way.y + end * length
