"""Light of LEDs that meets mirrors and clear boundaries only, backwards from within the gel.

At a clear boundary the engine's path tracers choose by chance between mirrored and refracted light. Here both
count by Fresnel's shares, so that nothing is left to chance but a ray's first direction.
"""

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from designlab.validation.synthetic import boundaries

ENGINE = boundaries.Functions(dr.select, dr.safe_sqrt)
BLACK, SIDE, INTERFACE, GAP_ABOVE, GAP_BELOW, SPREADS = range(6)  # what a ray meets
GEL, CORE, AIR, GAP = range(4)  # what a ray passes
FAINTEST = 1e-4  # share of a ray's worth below which it is given up
LAST_DRAW = 1.0 - 1e-6  # what is rounded up to one would never be drawn
BEFORE_MM = 5e-3  # what spreads light is looked at from this near


class Stuff(NamedTuple):
    """Indices of refraction and extinction (1/mm, one for each colour channel) of gel and core."""

    gel_index: float
    core_index: float
    gel_per_mm: tuple[float, ...]
    core_per_mm: tuple[float, ...]


class Followed(NamedTuple):
    """What came of rays: light of LEDs, and where something is met that spreads light.

    Of the things met, one is drawn for each ray: the first that `ray` meets, in `passing`, after `segment`
    segments. What it sends counts by the factor `worth`, zero where nothing is met.
    """

    direct: Any
    ray: Any
    worth: Any
    passing: Any
    segment: Any


class Follower:
    """Rays through one scene.

    Parameters
    ----------
    scene : mitsuba.Scene
        The scene.
    kinds : dict
        What its shapes are to a ray, by name; those not named are black.
    stuff : Stuff
        What fills gel and core.
    longest : int
        Most segments of a ray.
    far : bool
        Whether rays are followed beyond the boundary of gel and core, which haze in the core forbids.
    """

    def __init__(
        self,
        scene: "mi.Scene",
        kinds: dict[str, int],
        stuff: Stuff,
        *,
        longest: int,
        far: bool,
    ) -> None:

        self._scene, self._stuff, self._longest, self._far = scene, stuff, longest, far
        shapes = {int(_number(mi.ShapePtr(shape))[0]): shape.id() for shape in scene.shapes()}
        table = np.full(max(shapes) + 1, BLACK, dtype=np.uint32)
        for number, name in shapes.items():
            table[number] = kinds.get(name, BLACK)
        self._kinds = mi.UInt32(table)

    def follow(
        self, ray: Any, draw: Any, passing: Any = GEL, segment: Any = 0, active: Any = True
    ) -> Followed:
        """Follow rays that start within gel, core or air.

        Parameters
        ----------
        ray : mitsuba.Ray3f
            The rays.
        draw : mitsuba.Float
            A random number in [0, 1) for each.
        passing, segment : mitsuba.UInt32
            What they pass first, and after how many segments.
        active : mitsuba.Bool
            Which of them count.
        """
        width = dr.width(ray)
        nothing = dr.zeros(mi.Color3f, width)
        passing, segment = (mi.UInt32(n) + dr.zeros(mi.UInt32, width) for n in (passing, segment))
        start = (
            mi.Ray3f(ray),
            dr.ones(mi.Color3f, width),
            passing,
            segment,
            mi.Float(draw) + dr.zeros(mi.Float, width),
            nothing,
            (mi.Ray3f(ray), nothing, mi.UInt32(passing), mi.UInt32(segment)),
            dr.zeros(mi.Float, width),
            mi.Bool(active) & dr.full(mi.Bool, True, width),
        )
        *_, direct, last, _, _ = dr.while_loop(start, lambda *state: state[-1], self._step, label="followed")
        return Followed(direct, *last)

    def _step(
        self,
        ray: Any,
        share: Any,
        passing: Any,
        segment: Any,
        draw: Any,
        direct: Any,
        last: tuple[Any, Any, Any, Any],
        total: Any,
        active: Any,
    ) -> tuple[Any, ...]:
        """One segment: to the next boundary, and on from there."""

        def offer(at: Any, *offered: Any) -> None:
            """Draw one of all that is offered, in proportion to what each counts."""
            nonlocal draw, last, total
            ray, counts, within = offered
            weight = dr.select(at, dr.mean(counts), 0.0)
            total = total + weight
            chance = dr.select(total > 0, weight / total, 0.0)
            taken = at & (dr.minimum(draw, LAST_DRAW) < chance)
            draw = dr.select(at, dr.select(taken, draw / chance, (draw - chance) / (1.0 - chance)), draw)
            # What was drawn before keeps its worth, one over the chance that it was drawn with.
            before, worth, passing, after = last
            worth = dr.select(at, worth / (1.0 - chance), worth)
            last = (
                dr.select(taken, ray, before),
                dr.select(taken, counts / chance, worth),
                dr.select(taken, within, passing),
                dr.select(taken, segment, after),
            )

        met = self._scene.ray_intersect(ray, active)
        active &= met.is_valid()
        kind = self._kind(met, active)
        share_here = share * self._kept(passing, met.t)
        direct = direct + dr.select(active, share_here * self._shines(met, active), 0.0)
        offer(active & (kind == SPREADS), _before(met, ray), share_here, passing)
        cosine = dr.minimum(dr.abs(dr.dot(ray.d, met.sh_frame.n)), 1.0)

        stuff = self._stuff
        into_core = active & (passing == GEL) & (kind == INTERFACE)
        into_gap = active & (passing == GEL) & (kind == GAP_BELOW)
        out_of_gap = active & (passing == GAP) & (kind == GAP_ABOVE)
        within, outside = active & (passing == CORE), active & (passing == AIR)
        leaves, enters = within & (kind == SIDE), outside & (kind == SIDE)
        if not self._far:
            offer(into_gap, ray, share, passing)
            into_gap = mi.Bool(False)

        in_air = (passing == GAP) | (passing == AIR)
        index = dr.select(passing == GEL, stuff.gel_index, dr.select(in_air, 1.0, stuff.core_index))
        other = dr.select(within & (kind == INTERFACE), stuff.gel_index, stuff.core_index)
        other = dr.select(leaves | into_gap | (within & (kind == GAP_ABOVE)), 1.0, other)
        mirrored = boundaries.reflectance(cosine, index, other, ENGINE)
        behind = dr.select(within, stuff.core_index, stuff.gel_index)
        slab = boundaries.gap_transmission(cosine, behind, (stuff.gel_index, stuff.core_index), ENGINE)
        beyond = met.spawn_ray(refracted(ray.d, met.sh_frame.n, index / other))
        turned = met.spawn_ray(ray.d - 2.0 * dr.dot(ray.d, met.sh_frame.n) * met.sh_frame.n)
        passed = (1.0 - mirrored) * dr.square(index / other)

        # At a clear side, the part in the air ends at what stands there; the other stays in the core.
        aside = dr.select(leaves, beyond, turned)
        share_aside = share_here * dr.select(leaves, passed, mirrored)
        goes = (leaves | enters) & (dr.max(share_aside) > FAINTEST) & (segment + 1 < self._longest)
        stands = self._scene.ray_intersect(aside, goes)
        goes &= stands.is_valid()
        direct = direct + dr.select(goes, share_aside * self._shines(stands, goes), 0.0)
        segment = segment + 1
        offer(
            goes & (self._kind(stands, goes) == SPREADS), _before(stands, aside), share_aside, mi.UInt32(AIR)
        )

        back, back_of_gap = leaves | (within & (kind == INTERFACE)), within & (kind == GAP_ABOVE)
        factor = dr.select(back, mirrored, 0.0)
        factor = dr.select(back_of_gap, 1.0 - slab, factor)
        factor = dr.select(into_core | enters, passed, factor)
        # All that the gap does to light, between its two sides too, is counted on the way in.
        factor = dr.select(into_gap, slab * dr.square(index), factor)
        factor = dr.select(out_of_gap, 1.0 / dr.square(stuff.core_index), factor)
        ray = dr.select(back | back_of_gap, turned, beyond)
        share = share_here * factor
        passing = dr.select(into_gap, GAP, dr.select(into_core | out_of_gap | enters, CORE, passing))
        if not self._far:
            offer(into_core, ray, share, passing)
            into_core = mi.Bool(False)
        active &= into_core | into_gap | out_of_gap | back | back_of_gap | enters
        active &= (dr.max(share) > FAINTEST) & (segment < self._longest)
        return ray, share, passing, segment, draw, direct, last, total, active

    def _kind(self, met: Any, active: Any) -> Any:

        number = _number(met.shape)
        known = active & (number < dr.width(self._kinds))
        return dr.select(known, dr.gather(mi.UInt32, self._kinds, number, known), BLACK)

    def _shines(self, met: Any, active: Any) -> Any:
        """Radiance that LED faces send from where rays meet them."""
        return met.emitter(self._scene, active).eval(met, active)

    def _kept(self, passing: Any, way_mm: Any) -> Any:
        """Share of light that a way through gel or core leaves."""
        gel, core = (mi.Color3f(*per_mm) for per_mm in (self._stuff.gel_per_mm, self._stuff.core_per_mm))
        per_mm = dr.select(passing == GEL, gel, dr.select(passing == CORE, core, mi.Color3f(0.0)))
        return dr.select(dr.isfinite(way_mm), dr.exp(-per_mm * way_mm), 0.0)


def refracted(direction: Any, normal: Any, ratio: Any) -> Any:
    """Unit vectors beyond a boundary with a normal to either side; `ratio` is index over index beyond."""
    cosine = -dr.dot(direction, normal)
    facing = dr.select(cosine < 0, -normal, normal)
    return dr.normalize(boundaries.refracted(direction, facing, dr.abs(cosine), ratio, ENGINE))


def _before(met: Any, ray: Any) -> Any:
    """Rays to the same points from close by."""
    return mi.Ray3f(met.p - dr.minimum(BEFORE_MM, met.t / 2) * ray.d, ray.d)


def _number(shape: Any) -> Any:
    """Numbers of shapes in the engine's registry."""
    return dr.reinterpret_array(mi.UInt32, shape)
