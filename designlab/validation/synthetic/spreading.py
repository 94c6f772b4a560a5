"""Light that ground sides, paint and boards spread, backwards, with clear light between them.

Of the directions in which a surface spreads light, half are drawn as it spreads it and half towards the
boards of the LEDs and their images in window and gel, roughly where they seem to stand. The first alone would
do; a direction counts by the chance of both (Veach and Guibas 1995, balance heuristic).
"""

from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi
import numpy as np

from designlab.core.types import Array
from designlab.validation.synthetic.clear import AIR, CORE, Follower

LARGER = 1.25  # targets over boards: through a side of the core things are seen elsewhere
DULL = 0.02  # chance of targets towards which nothing seems to be spread, over that of the others
FAINT = 0.1  # worth below which some paths end and the others count more


class Target(NamedTuple):
    """Rectangle to look at: its centre and half axes (3,)."""

    centre: Array
    across: Array
    down: Array


class Spreader:
    """Paths through one scene that start where something spreads light.

    Parameters
    ----------
    scene : mitsuba.Scene
        The scene.
    follower : Follower
        What follows clear light in it.
    targets : list of Target
        Where light comes from.
    """

    def __init__(self, scene: "mi.Scene", follower: Follower, targets: list[Target]) -> None:
        self._scene, self._follower, self._targets = scene, follower, targets

    def seen(self, ray: Any, sampler: Any) -> Any:
        """Radiance of what spreads light, as rays from within the gel see it."""
        first = self._follower.follow(ray, sampler.next_1d())
        found = dr.zeros(mi.Color3f, dr.width(ray))
        start = first.ray, first.worth, first.passing, first.segment, found, sampler, dr.max(first.worth) > 0
        end = dr.while_loop(start, lambda *state: state[-1], self._step, label="spread")
        return end[4]

    def _step(
        self, ray: Any, worth: Any, passing: Any, segment: Any, found: Any, sampler: Any, active: Any
    ) -> tuple[Any, ...]:
        """One thing that spreads light: the LEDs that it is lit by, and on to the next such thing."""
        met = self._scene.ray_intersect(ray, active)
        active &= met.is_valid()
        context, bsdf = mi.BSDFContext(), met.bsdf(ray)
        chances = self._chances(met, bsdf, context, active)
        aimed = self._aimed(met, chances, sampler.next_1d(active), sampler.next_2d(active))
        local = met.to_local(aimed)
        spread, by_bsdf = bsdf.eval_pdf(context, met, local, active)
        counts = dr.max(spread) > 0
        chance = self._density(met, aimed, chances) + by_bsdf
        lit = self._follower.follow(
            met.spawn_ray(aimed), 0.5, self._into(met, local, passing), segment + 1, active & counts
        ).direct
        found = found + dr.select(active & counts & (chance > 0), worth * spread * lit / chance, 0.0)

        sample, weight = bsdf.sample(context, met, sampler.next_1d(active), sampler.next_2d(active), active)
        onward = met.to_world(sample.wo)
        active &= (sample.pdf > 0) & (dr.max(weight) > 0)
        worth = worth * weight
        share = sample.pdf / (sample.pdf + self._density(met, onward, chances))
        then = self._follower.follow(
            met.spawn_ray(onward),
            sampler.next_1d(active),
            self._into(met, sample.wo, passing),
            segment + 1,
            active,
        )
        found = found + dr.select(active, worth * share * then.direct, 0.0)
        worth = dr.select(active, worth * then.worth, 0.0)
        stays = dr.minimum(dr.max(worth) / FAINT, 1.0)
        active &= sampler.next_1d(active) < stays
        worth = dr.select(active, worth / stays, 0.0)
        return then.ray, worth, then.passing, then.segment, found, sampler, active

    def _into(self, met: Any, local: Any, passing: Any) -> Any:
        """What a direction leads into: through a ground side it leads out of the core, or into it."""
        through = mi.Frame3f.cos_theta(met.wi) * mi.Frame3f.cos_theta(local) < 0
        return dr.select(through, dr.select(passing == CORE, mi.UInt32(AIR), mi.UInt32(CORE)), passing)

    def _chances(self, met: Any, bsdf: Any, context: Any, active: Any) -> list[Any]:
        """Chance of each target, by how much would be spread from its middle."""
        values = []
        for target in self._targets:
            normal = np.cross(target.across, target.down)
            area = 4.0 * float(np.linalg.norm(normal))
            way = mi.Point3f(*target.centre.tolist()) - met.p
            squared = dr.squared_norm(way)
            direction = way * dr.rsqrt(squared)
            facing = dr.abs(dr.dot(direction, mi.Vector3f(*(4.0 * normal / area).tolist())))
            spread = dr.mean(bsdf.eval(context, met, met.to_local(direction), active))
            values.append(spread * area * (facing + 0.1) / (squared + area))
        whole = sum(values)
        low = DULL * whole / len(values) + 1e-12
        whole = whole + len(values) * low
        return [(value + low) / whole for value in values]

    def _aimed(self, met: Any, chances: list[Any], draw: Any, place: Any) -> Any:
        """Directions to points of targets drawn by their chances."""
        point, below = mi.Point3f(*self._targets[-1].centre.tolist()), mi.Float(0.0)
        u, v = 2.0 * place.x - 1.0, 2.0 * place.y - 1.0
        for target, chance in zip(self._targets, chances, strict=True):
            centre, across, down = (mi.Vector3f(*part.tolist()) for part in target)
            taken = (draw >= below) & (draw < below + chance)
            point = dr.select(taken, mi.Point3f(centre + u * across + v * down), point)
            below = below + chance
        return dr.normalize(point - met.p)

    def _density(self, met: Any, direction: Any, chances: list[Any]) -> Any:
        """Chance of directions for each steradian."""
        density = mi.Float(0.0)
        for target, chance in zip(self._targets, chances, strict=True):
            centre, across, down = (mi.Vector3f(*part.tolist()) for part in target)
            normal = np.cross(target.across, target.down)
            area = 4.0 * float(np.linalg.norm(normal))
            normal = mi.Vector3f(*(normal / np.linalg.norm(normal)).tolist())
            towards = dr.dot(direction, normal)
            way = dr.dot(centre - mi.Vector3f(met.p), normal) / towards
            offset = mi.Vector3f(met.p) + way * direction - centre
            inside = (way > 0) & (dr.abs(dr.dot(offset, across)) <= dr.squared_norm(across))
            inside &= dr.abs(dr.dot(offset, down)) <= dr.squared_norm(down)
            density = density + dr.select(inside, chance * dr.square(way) / (dr.abs(towards) * area), 0.0)
        return density
