"""What a point of the membrane sees through clear boundaries, and mirrored in the window.

Where light is split, sight goes one way: through, but for the window, which mirrors, as do other boundaries
where they let nothing pass. The other ways are left to photons.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.matter import Dielectric, Medium
from designlab.render import bridge
from designlab.render.emitters import Directions
from designlab.render.photons import Mirrors, dr_index, numbers_of, sides, straight_boundaries
from designlab.render.tables import held
from designlab.scene import Light, Scene

Array = NDArray[np.float64]
Single = NDArray[np.float32]
RAYS = 2**21  # traced at once; bounds memory


class Last(NamedTuple):
    """The last straight piece of each line of sight, behind all boundaries.

    Attributes
    ----------
    origin, direction : array, shape (3, n)
        Where it starts (mm), and its unit vector.
    reach : array, shape (n,)
        Its length (mm) up to what is in the way.
    passed : array, shape (n,)
        Share of the light that all boundaries let pass.
    way : array, shape (2, n)
        Length (mm) of the pieces before within gel and core.
    """

    origin: Single
    direction: Single
    reach: Single
    passed: Single
    way: Single

    def some(self, at: NDArray[np.int64]) -> "Last":
        """Chosen ones of them."""
        return Last(*(part[..., at] for part in self))


@dataclass(frozen=True, eq=False)
class Sight:
    """Lines of sight through the clear boundaries of a scene.

    Parameters
    ----------
    scene : Scene
        The undeformed scene.
    group : int
        LED group that is looked for.
    inside : bool
        Whether its LEDs shine within the core.
    """

    scene: Scene
    group: int
    inside: bool

    def radiance(self, light: Light, last: Last, length: Single) -> Array:
        """Radiance (1/mm2/sr) that an LED's face sends along lines of sight that end on it, within the gel.

        Across a boundary radiance changes with the square of the refractive index.

        Parameters
        ----------
        light : Light
            The LED.
        last : Last
            Lines of sight.
        length : array, shape (n,)
            Of their last pieces, up to the face (mm).
        """
        import mitsuba as mi

        local = -np.array([light.across, light.down, light.normal]) @ last.direction
        density = np.asarray(
            Directions(light.profile).density(mi.Vector3f(*local.astype(np.float32))), dtype=float
        )
        area = 4 * light.half_width_mm * light.half_height_mm
        gel, core = self._media
        way = last.way + np.stack([0 * length, length * light.inside])
        lost = [m.absorption_per_mm[light.group] + m.scattering_per_mm for m in (gel, core)]
        index = gel.index / (core.index if light.inside else 1.0)
        passed = last.passed * np.exp(-np.array(lost) @ way) * index**2
        return np.asarray(light.flux_mw * density * passed / (area * np.maximum(local[2], 1e-6)))

    @property
    def _media(self) -> tuple[Medium, Medium]:
        """Gel and core."""
        boundary = next(s.material for s in self.scene.shapes if s.name == "interface")
        assert isinstance(boundary, Dielectric)
        return boundary.inside, boundary.outside

    def last(self, origin: Array, direction: Array) -> Last:
        """Follow lines of sight from points within the gel, both of shape (3, n)."""
        loaded = bridge.load_shapes(self.scene.shapes)
        tables = self._tables(loaded)
        parts = [
            self._some(loaded, tables, origin[:, some], direction[:, some])
            for some in (slice(first, first + RAYS) for first in range(0, origin.shape[1], RAYS))
        ]
        return Last(*(np.concatenate(part, axis=-1) for part in zip(*parts, strict=True)))

    def _some(self, loaded: Any, tables: Any, origin: Array, direction: Array) -> Last:
        import drjit as dr
        import mitsuba as mi

        (indices, ends, matter), most = tables, held(straight_boundaries(self.scene))
        mirrors = Mirrors(self.scene, self.group, loaded)

        def going(active: Any, *_: Any) -> Any:
            return active

        def step(active: Any, ray: Any, reach: Any, passed: Any, way: Any, met: Any) -> Any:
            si = loaded.ray_intersect(ray, active)
            shape = dr_index(si.shape)
            index = dr.select(active & si.is_valid(), dr.gather(mi.Float, indices, shape, active), 0.0)
            cosine = -dr.dot(si.sh_frame.n, ray.d)
            reflected, behind, _, ratio = mi.fresnel(cosine, index)
            mirrored = mirrors.count(si.shape, reflected >= 1.0)
            through = (reflected < 1.0) & ~dr.gather(mi.Bool, ends, shape, active)
            goes_on = active & (index > 0) & (mirrored | through) & (met < most)
            bent = mi.refract(-ray.d, si.sh_frame.n, behind, ratio)
            bent = dr.select(mirrored, ray.d + 2.0 * cosine * si.sh_frame.n, bent)
            side = 2 * shape + dr.select(dr.dot(si.n, ray.d) > 0, mi.UInt32(1), mi.UInt32(0))
            within = [si.t * dr.gather(mi.Float, table, side, goes_on) for table in matter]
            way = dr.select(goes_on, way + mi.Vector2f(*within), way)
            passed = dr.select(goes_on, passed * dr.select(mirrored, reflected, 1.0 - reflected), passed)
            reach = dr.select(active & ~goes_on, si.t, reach)
            ray = dr.select(goes_on, si.spawn_ray(bent), ray)
            return goes_on, ray, reach, passed, way, met + 1

        size = origin.shape[1]
        start, towards = (np.ascontiguousarray(a, dtype=np.float32) for a in (origin, direction))
        ray = mi.Ray3f(mi.Point3f(*start), mi.Vector3f(*towards))
        _, ray, reach, passed, way, _ = dr.while_loop(
            (
                dr.full(mi.Bool, True, size),
                ray,
                dr.zeros(mi.Float, size),
                dr.full(mi.Float, 1.0, size),
                dr.zeros(mi.Vector2f, size),
                dr.zeros(mi.UInt32, size),
            ),
            going,
            step,
            labels=("active", "ray", "reach", "passed", "way", "met"),
        )
        dr.eval(ray, reach, passed, way)
        return Last(*(np.array(a, dtype=np.float32) for a in (ray.o, ray.d, reach, passed, way)))

    def _tables(self, loaded: Any) -> tuple[Any, Any, list[Any]]:
        """By number of the shape: index behind its surface over that before it, zero where sight ends.

        Likewise, whether it ends where not mirrored. By number of the shape and side: whether gel, or core,
        is there.
        """
        import mitsuba as mi

        boundaries = {s.name: s.material for s in self.scene.shapes if isinstance(s.material, Dielectric)}
        numbers = numbers_of(loaded)
        count = max(numbers.values()) + 1
        indices, ends = np.zeros(count, dtype=np.float32), np.zeros(count, dtype=bool)
        matter = np.zeros((2, count, 2), dtype=np.float32)
        for name, number in numbers.items():
            boundary = boundaries.get(name)
            ends[number] = self.inside and name.startswith("core-side")
            if boundary is not None and not boundary.roughness:
                indices[number] = boundary.inside.index / boundary.outside.index
            for side, medium in enumerate(sides(name, boundaries, self.scene)):
                if medium in self._media:
                    matter[self._media.index(medium), number, side] = 1.0
        return mi.Float(indices), mi.Bool(ends), [mi.Float(table.ravel()) for table in matter]
