"""Light traced from the LEDs to the membrane: finds small LEDs behind glass, which paths meet by chance."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.simulation.render import bridge, emitters, sobol
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.tables import held
from designlab.simulation.scene.scene import Dielectric, Light, Medium, Scene

BATCH = 5_000_000  # photons traced at once; bounds memory
# Photons that lost all but this share of their power live on by chance: the first light, to which faint ones
# add little, is traced with less patience.
FAINT, FAINT_ONCE = 1 / 16, 1 / 4
FACE_CELLS, DIRECTION_CELLS = 4, 32  # of a guide, along each side of an LED's face and of its directions
UNGUIDED = 0.2  # share of photons that a guide leaves alone, so that no way is missed
PILOT = 200_000  # photons that a guide is learnt from


@dataclass(frozen=True, eq=False)
class Arrival:
    """Photons at the membrane, as Dr.Jit arrays.

    Attributes
    ----------
    at
        Mitsuba's surface interaction.
    towards
        Unit vector back along the ray.
    power
        Power in mW, of the 1 mW that the LED group emits.
    bounces
        Number of surfaces met before.
    start
        Cell of the guide that the photon started in.
    returned
        Whether the photon was at the membrane before, or haze has scattered it.
    number
        Number of the photon among all that are traced.
    matte
        Whether the surface met last sent it on as a Lambertian one does.
    """

    at: Any
    towards: Any
    power: Any
    bounces: Any
    start: Any
    returned: Any
    number: Any
    matte: Any


@dataclass(frozen=True, eq=False)
class Reflection:
    """Photons on the point of leaving a surface for another that counts.

    Attributes
    ----------
    at
        Mitsuba's surface interaction.
    power
        Power in mW, as of an `Arrival`.
    bounces
        Number of surfaces met before.
    number
        Number of the photon among all that are traced.
    matte
        Whether the surface sends photons on as a Lambertian one does.
    """

    at: Any
    power: Any
    bounces: Any
    number: Any
    matte: Any


@dataclass(frozen=True, eq=False)
class Scattering:
    """Photons on the point of being scattered by haze: where (mm), their direction so far, and power (mW)."""

    position: Any
    direction: Any
    power: Any


Record = Callable[[Arrival, Any], None]
Scattered = Callable[[Scattering, Any], None]
Reflected = Callable[[Reflection, Any], None]
Worth = Callable[[Arrival, Any], Any]
"""Importance of each arrival, zero where it does not count."""


@dataclass(frozen=True, eq=False)
class Guide:
    """Where on the LEDs, and into which directions, photons are worth starting: shares of cells."""

    share: NDArray[np.float64]

    @staticmethod
    def cells(lights: int) -> int:
        """Return how many cells there are: lights x face x directions."""
        return lights * FACE_CELLS**2 * DIRECTION_CELLS**2


def trace(
    scene: Scene,
    *,
    group: int,
    photons: int,
    seed: int,
    record: Record,
    loaded: Any = None,
    guide: Guide | None = None,
    scattered: Scattered | None = None,
    housing: Record | None = None,
    reflected: Reflected | None = None,
    once: bool = False,
) -> None:
    """Trace photons of one LED group that emits 1 mW and hand every arrival at the membrane to `record`.

    Parameters
    ----------
    scene : Scene
        What light meets. Needs a just-in-time back end.
    group : int
        LED group.
    photons : int
        Number of photons, rounded up to whole batches.
    seed : int
        Seed of the random numbers.
    record : callable
        Called with an `Arrival` and the mask of photons that arrive. It is called while a loop is recorded,
        so it may only scatter.
    loaded : mitsuba.Scene, optional
        The scene loaded for this group.
    guide : Guide, optional
        Start photons where they are worth most.
    scattered : callable, optional
        Called likewise with a `Scattering` wherever haze scatters photons.
    housing : callable, optional
        Called likewise with photons that arrive at the inside of the housing.
    reflected : callable, optional
        Called likewise with a `Reflection` wherever a surface sends photons on.
    once : bool
        Light on its first way only: photons end at the membrane, and haze dims them all instead of
        scattering some.
    """
    loaded = loaded if loaded is not None else load(scene, group)
    lights = [light for light in scene.lights if light.group == group]
    batches = max(1, round(photons / BATCH))
    size = int(np.ceil(photons / batches))
    seeds = np.random.default_rng([seed, group, 78]).integers(0, 2**32, size=5)
    for batch in range(batches):
        starts = Starts(batch * size, size, seeds, len(lights), guide)
        lot = size * batches, _seed(seed, group, batch)
        _batch(loaded, scene, group, lights, starts, *lot, record, scattered, housing, reflected, once)
        dr.eval()
    dr.sync_thread()


def load(scene: Scene, group: int) -> Any:
    """Load a scene for `trace`."""
    return bridge.load(scene, group=group, integrator={"type": "path"}, samples=4)


class Starts:
    """Evenly spread starts of photons, as a sampler of five numbers: light, place on it, direction.

    Attributes
    ----------
    cell : Dr.Jit array
        Cell of the guide that each start lies in.
    weight : Dr.Jit array
        How much more power each photon carries than an unguided one.
    number : Dr.Jit array
        Number of each start in the whole sequence.
    """

    def __init__(self, first: int, size: int, seeds: Any, lights: int, guide: Guide | None) -> None:
        self.weight = mi.Float(1.0)
        self.number = dr.arange(mi.UInt32, size) + held(first)
        numbers = sobol.points(first, size, seeds)
        counts = (lights, FACE_CELLS, FACE_CELLS, DIRECTION_CELLS, DIRECTION_CELLS)
        if guide is None:
            places = [dr.minimum(mi.UInt32(u * n), n - 1) for u, n in zip(numbers, counts, strict=True)]
            self.cell = mi.UInt32(0)
            for place, n in zip(places, counts, strict=True):
                self.cell = self.cell * n + place
        else:
            distribution = mi.DiscreteDistribution(np.ascontiguousarray(guide.share, dtype=np.float32))
            self.cell, inner, share = distribution.sample_reuse_pmf(numbers[0])
            self.weight = 1.0 / (share * len(guide.share))
            rest, places = self.cell, []
            for n in counts[::-1]:
                places.insert(0, rest % n)
                rest = rest // n
            numbers = [
                (mi.Float(place) + (inner if k == 0 else u)) / n
                for k, (place, u, n) in enumerate(zip(places, numbers, counts, strict=True))
            ]
        self._numbers = [dr.minimum(u, 1.0 - 2.0**-24) for u in numbers]

    def next_1d(self, active: Any = True) -> Any:
        """Return the next number of every start."""
        return self._numbers.pop(0)

    def next_2d(self, active: Any = True) -> Any:
        """Return the next two numbers of every start."""
        first = self.next_1d()
        return mi.Point2f(first, self.next_1d())


def learn(
    scene: Scene,
    *,
    group: int,
    seed: int,
    worth: Sequence[Worth],
    loaded: Any,
    photons: int = PILOT,
) -> list[Guide]:
    """Learn from a pilot run where photons start that are `worth` most, a guide for each kind of worth."""
    lights = sum(light.group == group for light in scene.lights)
    squares, count = [dr.zeros(mi.Float, Guide.cells(lights)) for _ in worth], held(float(photons))

    def record(arrival: Arrival, active: Any) -> None:
        for table, kind in zip(squares, worth, strict=True):
            value = kind(arrival, active) * count
            dr.scatter_add(table, value * value, arrival.start, active & (value > 0))

    # What is traced afterwards must not follow the very numbers it is guided by.
    own = int(np.random.SeedSequence([seed, group, 79]).generate_state(1)[0])
    trace(scene, group=group, photons=photons, seed=own, record=record, loaded=loaded)
    return [_guide(np.asarray(table), lights) for table in squares]


def _guide(squares: NDArray[np.floating], lights: int) -> Guide:
    """Share of photons for each cell: the best density follows the root mean square of what a start brings.

    Neighbours make it less jagged.
    """
    cells = squares.reshape(lights, FACE_CELLS**2, DIRECTION_CELLS, DIRECTION_CELLS)
    smooth = np.sqrt(cells + cells.mean(axis=1, keepdims=True)).ravel()
    if smooth.sum() == 0:
        smooth = np.ones_like(smooth)
    return Guide((1 - UNGUIDED) * smooth / smooth.sum() + UNGUIDED / len(smooth))


def _batch(
    loaded: Any,
    scene: Scene,
    group: int,
    lights: list[Light],
    starts: Starts,
    total: int,
    seed: int,
    record: Record,
    see: Scattered | None,
    housing: Record | None,
    leaves: Reflected | None,
    once: bool,
) -> None:
    flux_mw = sum(light.flux_mw for light in lights)
    cell, weight = starts.cell, starts.weight * held(flux_mw / total)
    size = dr.width(cell)
    number = starts.number
    # What matter does has numbers of its own: a clear scene and a hazy one share all others.
    sampler, within = mi.load_dict({"type": "independent"}), mi.load_dict({"type": "independent"})
    sampler.seed(seed, size)
    within.seed(_other(seed), size)
    ray = emitters.photons(lights, starts, size)
    membrane = mi.ShapePtr(next(shape for shape in loaded.shapes() if shape.id() == "membrane"))
    around = [mi.ShapePtr(shape) for shape in loaded.shapes() if shape.id().startswith("housing")]
    matter = _Matter.of(scene, group, loaded)
    context = mi.BSDFContext(mi.TransportMode.Importance)
    # The way from membrane to camera crosses the interface and the window: three segments.
    longest = scene.path_length - (3 if scene.refracts else 1)

    def going(active: Any, *_: Any) -> Any:
        return active

    def step(
        active: Any, ray: Any, power: Any, depth: Any, returned: Any, matte: Any, sampler: Any, within: Any
    ) -> Any:
        si = loaded.ray_intersect(ray, active)
        active = active & si.is_valid()
        scattered = mi.Mask(False)
        if matter is not None:
            before = ray.d
            if once:
                power = matter.dim(si, ray, power, active)
            else:
                power, ray, scattered = matter.cross(si, ray, power, within, active)
            if see is not None:
                see(Scattering(ray.o, before, power), scattered)
        arrives = active & ~scattered & (si.shape == membrane) & (dr.dot(si.sh_frame.n, ray.d) < 0)
        arrival = Arrival(si, -ray.d, power, depth, cell, returned, number, matte)
        record(arrival, arrives)
        if housing is not None:
            for shape in around:
                housing(arrival, active & ~scattered & (si.shape == shape))
        if once:
            active = active & ~arrives
        returned = returned | arrives | scattered
        bsdf = si.bsdf()
        meets = active & ~scattered
        sample, reflected = bsdf.sample(context, si, sampler.next_1d(meets), sampler.next_2d(meets), meets)
        power = dr.select(scattered, power, power * reflected.x)
        ray = dr.select(scattered, ray, si.spawn_ray(si.to_world(sample.wo)))
        met = depth
        depth = depth + 1
        active = active & (power > 0) & (depth < longest)
        matte = mi.has_flag(sample.sampled_type, mi.BSDFFlags.DiffuseReflection) & ~scattered
        if leaves is not None:
            leaves(Reflection(si, power, met, number, matte), active & ~scattered)
        # Russian roulette: the faint ones live on with their chance, and those that do are brighter for it.
        chance = dr.minimum(power / (weight * (FAINT_ONCE if once else FAINT)), 1.0)
        active = active & (sampler.next_1d(active) < chance)
        power = power / dr.maximum(chance, 1e-12)
        return active, ray, power, depth, returned, matte, sampler, within

    dr.while_loop(
        (
            dr.full(mi.Bool, True, size),
            ray,
            mi.Float(weight) + dr.zeros(mi.Float, size),
            dr.zeros(mi.UInt32, size),
            dr.full(mi.Bool, False, size),
            dr.full(mi.Bool, False, size),
            sampler,
            within,
        ),
        going,
        step,
        labels=("active", "ray", "power", "depth", "returned", "matte", "sampler", "within"),
    )


@dataclass(frozen=True, eq=False)
class _Matter:
    """What absorbs or scatters light between two surfaces, found from the side of the surface it meets."""

    shapes: int
    absorption: Any
    scattering: Any
    anisotropy: Any

    @staticmethod
    def of(scene: Scene, group: int, loaded: Any) -> "_Matter | None":
        """Tables by shape and side; None where all is clear."""
        boundaries = {s.name: s.material for s in scene.shapes if isinstance(s.material, Dielectric)}
        media = [m for b in boundaries.values() for m in (b.inside, b.outside)]
        if all(medium.clear for medium in media):
            return None
        sides = {shape.name: _sides(shape.name, boundaries, scene) for shape in scene.shapes}
        numbers = {shape.id(): int(np.asarray(dr_index(mi.ShapePtr(shape)))[0]) for shape in loaded.shapes()}
        count = max(numbers.values()) + 1
        tables = np.zeros((3, count, 2), dtype=np.float32)
        for name, number in numbers.items():
            for side, medium in enumerate(sides.get(name, ())):
                if medium is not None:
                    tables[:, number, side] = (
                        medium.absorption_per_mm[group],
                        medium.scattering_per_mm,
                        medium.anisotropy,
                    )
        return _Matter(count, *(mi.Float(table.ravel()) for table in tables))

    def dim(self, si: Any, ray: Any, power: Any, active: Any) -> Any:
        """Power left at the surface of what has been neither absorbed nor scattered."""
        absorption, scattering, _ = self._at(si, ray, active)
        return dr.select(active, power * dr.exp(-(absorption + scattering) * si.t), power)

    def _at(self, si: Any, ray: Any, active: Any) -> Any:
        """Absorption, scattering and anisotropy of what a ray has crossed to a surface."""
        behind = dr.dot(si.n, ray.d) > 0
        index = 2 * dr_index(si.shape) + dr.select(behind, mi.UInt32(1), mi.UInt32(0))
        tables = self.absorption, self.scattering, self.anisotropy
        return [dr.gather(mi.Float, table, index, active) for table in tables]

    def cross(self, si: Any, ray: Any, power: Any, sampler: Any, active: Any) -> Any:
        """Power left at the surface, or a new ray where the photon is scattered before it."""
        absorption, scattering, g = self._at(si, ray, active)
        free = -dr.log(1.0 - sampler.next_1d(active)) / dr.maximum(scattering, 1e-12)
        scattered = active & (scattering > 0) & (free < si.t)
        travelled = dr.minimum(free, si.t)
        power = dr.select(active, power * dr.exp(-absorption * travelled), power)
        cosine = _henyey_greenstein(sampler.next_1d(active), g)
        turn = 2 * dr.pi * sampler.next_1d(active)
        sine = dr.safe_sqrt(1 - cosine * cosine)
        local = mi.Vector3f(sine * dr.cos(turn), sine * dr.sin(turn), cosine)
        onward = mi.Ray3f(ray(travelled), mi.Frame3f(ray.d).to_world(local))
        return power, dr.select(scattered, onward, ray), scattered


def dr_index(pointer: Any) -> Any:
    """Number of a shape in Dr.Jit's registry."""
    return dr.reinterpret_array(mi.UInt32, pointer)


def _sides(name: str, boundaries: dict[str, Dielectric], scene: Scene) -> tuple[Medium | None, Medium | None]:
    """Media on the side that a shape's normal points to, and on the other one."""
    if name in boundaries:
        return boundaries[name].outside, boundaries[name].inside
    if name in ("membrane", "gel-rim"):
        return boundaries["interface"].inside, None
    within = name.startswith("core-side") or (
        name.startswith(("board", "light")) and any(light.inside for light in scene.lights)
    )
    return (boundaries["window"].inside if within else boundaries["window"].outside), None


def _henyey_greenstein(uniform: Any, g: Any) -> Any:
    """Cosine of the scattering angle (Henyey and Greenstein 1941), inverted in closed form."""
    safe = dr.select(dr.abs(g) < 1e-3, 1e-3, g)
    ratio = (1 - safe * safe) / (1 - safe + 2 * safe * uniform)
    return dr.clip((1 + safe * safe - ratio * ratio) / (2 * safe), -1.0, 1.0)


def _other(seed: int) -> int:
    return int(np.random.SeedSequence([seed, 76]).generate_state(1)[0])


def _seed(seed: int, group: int, batch: int) -> int:
    return int(np.random.SeedSequence([seed, group, batch, 77]).generate_state(1)[0])
