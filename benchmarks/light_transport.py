"""Cost of light transport at equal error, against Mitsuba's path tracer with its default sampler.

    python benchmarks/light_transport.py            # some ten minutes on two cores
    python benchmarks/light_transport.py --quick    # a minute; the figures are rougher

Two designs: a small LED of each colour behind the side faces of an acrylic block, across an air gap, and the
published scene of the 2020 prototype. Error is the root mean square difference from the true picture of
every press and LED group, relative to that picture's mean radiance, bias included. The truth is two
independent pictures A and B of an unbiased estimator: the mean of (picture - A)(picture - B) is free of their
noise. They are made by designlab's reference mode (for the published scene, by its path tracer), whose own
error is known from their difference. Cost is processor time, all threads together, for all presses and LED
groups, from design to pictures; the light field of the fast mode is baked within it. Kernels are compiled
before.

The path tracer's error falls with the square root of its samples, which two sample counts show; so its cost
at the error of another method follows. It is taken as a user would write it: all LEDs in one picture in
colour, or one LED group a picture, with Russian roulette as it is by default, or without. The cheapest of
these is what the ratios refer to.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.store import CACHE_VARIABLE
from designlab.sensor.camera import View
from designlab.sensor.design import Design, preset
from designlab.simulation.contact.press import Press
from designlab.simulation.render import bridge, sensors
from designlab.simulation.render.estimators import Estimator
from designlab.simulation.scene.scene import Dielectric, Scene
from designlab.simulation.simulator import Simulator
from geometries.probes import parse

Pictures = list[NDArray[np.floating]]  # of every press, shape (groups, rows, columns)
DEFAULT_ROULETTE, NO_ROULETTE = 5, 1000  # path segments after which Mitsuba plays Russian roulette
SAMPLES = 64  # designlab's effort
COUNTS = (8, 32)  # samples of the plain path tracer
PRESSES = (
    ("sphere:4", 0.5, (0.0, 0.0), 0.0),
    ("triangle:5", 0.5, (2.0, -1.5), 20.0),
    ("sphere:6", 0.6, (-3.0, 2.0), 0.0),
    ("star:6", 0.5, (-2.0, -1.5), 10.0),
    ("sphere:8", 0.7, (3.0, 1.5), 0.0),
    ("cylinder:4", 0.6, (1.0, 2.0), 30.0),
    ("sphere:3", 0.4, (-4.0, -2.5), 0.0),
    ("cone:3", 0.5, (3.5, -2.5), 0.0),
    ("sphere:5", 0.6, (0.0, 3.0), 0.0),
    ("prism:3", 0.5, (-1.0, -2.0), 60.0),
    ("sphere:4", 0.4, (5.0, 0.0), 0.0),
    ("dots:2", 0.4, (-3.0, 0.5), 15.0),
)


@dataclass(frozen=True)
class Case:
    """A sensor, what is seen of it, the presses, and the estimator that the truth comes from."""

    name: str
    design: Design
    view: View
    presses: tuple[Press, ...]
    unbiased: Estimator


@dataclass(frozen=True)
class Result:
    """Mean squared relative error, over whole pictures and where probes touch, and its price."""

    method: str
    samples: int
    cpu_s: float
    whole: float
    contact: float
    whole_se: float  # standard error of `whole` from the noise of the truth and the picture


def presses(count: int) -> tuple[Press, ...]:
    """Return the first presses of the set."""
    return tuple(
        Press(probe=parse(probe), depth_mm=depth, centre_mm=centre, yaw_deg=yaw)
        for probe, depth, centre, yaw in PRESSES[:count]
    )


def behind_glass(*, quick: bool) -> Case:
    """An acrylic block of 24 x 20 x 8 mm with 2 mm of silicone gel, and an LED of 3 x 2 mm at three sides."""
    sides = {f"leds.groups.{k}.azimuth_deg": (azimuth,) for k, azimuth in enumerate((0.0, 180.0, 90.0))}
    design = preset("default").replace(
        {
            "name": "small-led-behind-air-gap",
            "gelcore.shape": "slab",
            "gelcore.width_mm": 24.0,
            "gelcore.length_mm": 20.0,
            "gelcore.height_mm": 8.0,
            "elastomer.outline": "rectangle",
            "elastomer.width_mm": 24.0,
            "elastomer.length_mm": 20.0,
            "leds.radius_mm": 12.3,
            "leds.emitting_width_mm": 3.0,
            "leds.emitting_spans_mm": ((-1.0, 1.0),),
            "leds.body_width_mm": 3.5,
            **sides,
            **{f"leds.groups.{k}.count": 1 for k in range(3)},
        }
    )
    few = presses(2 if quick else 12)
    return Case("small LEDs behind an air gap, 160 x 120", design, design.view(160), few, "reference")


def published(*, quick: bool) -> Case:
    """The scene of arXiv 2012.13184, seen in a square."""
    design = preset("gelsight-2020-flat")
    side = 200 if quick else 600
    whole = design.view(600)
    left = whole.x_px + (whole.width_px - whole.height_px) / 2
    view = whole._replace(x_px=left, width_px=whole.height_px, columns=side, rows=side)
    return Case(f"published scene, {side} x {side}", design, view, presses(2), "path")


def plain(scene: Scene, *, together: bool, roulette: int, samples: int, seed: int) -> NDArray[np.float32]:
    """Mitsuba's path tracer and its default sampler, shape (groups, rows, columns)."""
    import mitsuba as mi

    integrator = {"type": "path", "max_depth": scene.path_length, "rr_depth": roulette}
    film = {**sensors.sensor(scene, samples)}
    film["sampler"] = {"type": "independent", "sample_count": samples}
    shape = (scene.view.rows, scene.view.columns, -1)
    if together:
        film["film"]["pixel_format"] = "rgb"
        loaded = coloured(scene, integrator)
        picture = mi.render(loaded, sensor=mi.load_dict(film), spp=samples, seed=seed)
        return np.moveaxis(np.asarray(picture).reshape(shape), 2, 0)
    found = []
    for group in range(scene.groups):
        loaded = bridge.load(scene, group=group, integrator=integrator, samples=4)
        picture = mi.render(loaded, sensor=mi.load_dict(film), spp=samples, seed=seed + group)
        found.append(np.asarray(picture).reshape(shape)[..., 0])
    return np.array(found)


def coloured(scene: Scene, integrator: dict[str, Any]) -> Any:
    """All LEDs at once, each group in a colour channel of its own."""
    import mitsuba as mi

    lights = tuple(replace(light, group=0) for light in scene.lights)
    loaded = bridge.load(replace(scene, lights=lights), group=0, integrator=integrator, samples=4)
    parameters = mi.traverse(loaded)
    for number, light in enumerate(scene.lights):
        own = [float(light.radiance) * (light.group == k) for k in range(3)]
        parameters[f"light-{number}.emitter.radiance.value"] = mi.Color3f(own)
    surfaces = {shape.name: shape.material for shape in scene.shapes}
    surfaces |= {f"light-{k}": surfaces["board-0"] for k in range(len(scene.lights))}
    for name, material in surfaces.items():
        # Mitsuba keeps surfaces of equal material once.
        key = f"{name}.bsdf.reflectance.value"
        if isinstance(material, Dielectric) or key not in parameters:
            continue
        parameters[key] = mi.Color3f(list(material.reflectance))
    parameters.update()
    return loaded


class Truth:
    """Two independent unbiased pictures of every press, and where probes touch."""

    def __init__(self, case: Case, seed: int) -> None:
        ours(case, case.unbiased, seed=seed + 500, count=1)
        self.cpu_s, first = timed(lambda: ours(case, case.unbiased, seed=seed))
        self.pairs = list(zip(first, ours(case, case.unbiased, seed=seed + 1000), strict=True))
        simulator = _simulator(case, "fast", SAMPLES, seed)
        self.contact = [_contact(simulator, press) for press in case.presses]

    def own(self, method: str) -> Result:
        """Error of either of the two."""
        squares = [((a - b) / _level(a, b)) ** 2 / 2 for a, b in self.pairs]
        return self._result(method, SAMPLES, self.cpu_s, squares)

    def judge(self, method: str, samples: int, cpu_s: float, pictures: Pictures) -> Result:
        """Compare pictures of all presses with the truth."""
        products = [
            (picture - a) * (picture - b) / _level(a, b) ** 2
            for picture, (a, b) in zip(pictures, self.pairs, strict=True)
        ]
        return self._result(method, samples, cpu_s, products)

    def _result(self, method: str, samples: int, cpu_s: float, squares: Sequence[Any]) -> Result:
        touched = [p[:, contact] for p, contact in zip(squares, self.contact, strict=True)]
        contact = float(np.mean(np.concatenate(touched, axis=1)))
        spread = float(np.std(squares) / np.sqrt(np.size(squares)))
        return Result(method, samples, cpu_s, float(np.mean(squares)), contact, spread)


def _contact(simulator: Simulator, press: Press) -> NDArray[np.bool_]:
    """Pixels that see the membrane where the probe touches it."""
    surface = simulator.surface(press)
    touched = surface.sample(surface.contact.astype(float), *simulator.rays.hit(surface))
    return np.asarray(touched > 0.5)


def _level(first: NDArray[np.floating], second: NDArray[np.floating]) -> NDArray[np.floating]:
    return np.asarray((first + second).mean(axis=(1, 2), keepdims=True) / 2)


def _simulator(case: Case, estimator: Estimator, samples: int, seed: int) -> Simulator:
    return Simulator(case.design, view=case.view, samples=samples, seed=seed, estimator=estimator)


def ours(case: Case, estimator: Estimator, *, seed: int, count: int | None = None) -> Pictures:
    """Pictures by designlab, from design to radiance."""
    simulator = _simulator(case, estimator, SAMPLES, seed)
    return [simulator.frame(press).basis for press in case.presses[:count]]


def theirs(
    case: Case, *, together: bool, roulette: int, samples: int, seed: int, count: int | None = None
) -> Pictures:
    """Pictures by the plain path tracer."""
    simulator = _simulator(case, "path", samples, seed)
    settings: dict[str, Any] = {"together": together, "roulette": roulette, "samples": samples}
    return [
        plain(simulator.scene(simulator.surface(press)), seed=seed + 10 * number, **settings)
        for number, press in enumerate(case.presses[:count])
    ]


def timed(action: Callable[[], Pictures]) -> tuple[float, Pictures]:
    """Processor time of all threads, and the pictures."""
    begun = time.process_time()
    pictures = action()
    return time.process_time() - begun, pictures


def run(case: Case, *, seed: int) -> None:
    """Measure one case and print its tables."""
    begun = time.perf_counter()
    truth = Truth(case, seed + 100)
    print(f"\n{case.name}, {len(case.presses)} presses, {len(case.design.leds.groups)} LED groups")
    variants = [("one colour picture, roulette from segment 5", True, DEFAULT_ROULETTE),
                ("one colour picture, no roulette", True, NO_ROULETTE),
                ("one picture a group, no roulette", False, NO_ROULETTE)]  # fmt: skip
    if case.design.optics.path_length < DEFAULT_ROULETTE:
        variants = variants[1:]
    pairs = []
    for label, together, roulette in variants:
        settings: dict[str, Any] = {"together": together, "roulette": roulette}
        theirs(case, **settings, samples=COUNTS[0], seed=seed + 500, count=1)
        pair = []
        for samples in COUNTS:
            cpu_s, pictures = timed(partial(theirs, case, **settings, samples=samples, seed=seed))
            pair.append(truth.judge(label, samples, cpu_s, pictures))
        pairs.append((pair[0], pair[1]))
    ours(case, "fast", seed=seed + 500, count=1)
    cpu_s, pictures = timed(lambda: ours(case, "fast", seed=seed))
    found = [
        truth.judge("designlab, fast", SAMPLES, cpu_s, pictures),
        truth.own(f"designlab, {case.unbiased}"),
    ]
    print(table(pairs, found))
    print(f"{time.perf_counter() - begun:.0f} s")


def cost_s(pair: tuple[Result, Result], error: float, region: str) -> float:
    """Processor time of the path tracer at a mean squared error: a fixed part and one for each sample."""
    few, many = pair
    each = (many.cpu_s - few.cpu_s) / (many.samples - few.samples)
    fixed = max(few.cpu_s - each * few.samples, 0.0)
    return float(fixed + each * many.samples * getattr(many, region) / error)


def table(pairs: Sequence[tuple[Result, Result]], found: Sequence[Result]) -> str:
    """Errors and costs, and the ratios of costs at equal error."""
    lines = [f"{'method':<46}{'samples':>8}{'cpu s':>9}{'error':>9}{'contact':>9}"]
    for r in [*(r for pair in pairs for r in pair), *found]:
        whole, contact = (np.sqrt(max(value, 0.0)) for value in (r.whole, r.contact))
        lines.append(f"{r.method:<46}{r.samples:>8}{r.cpu_s:>9.1f}{whole:>9.2%}{contact:>9.2%}")
    lines.append("path tracer: squared error x samples, many samples over few (1 if it falls as 1/N):")
    for few, many in pairs:
        law = many.whole * many.samples / (few.whole * few.samples)
        lines.append(f"  {many.method:<44}{law:>8.3f}")
    lines.append(f"{'cost of the path tracer at the error of':<46}{'cpu s':>17}{'ratio':>9}{'contact':>9}")
    for r in found:
        for pair in pairs:
            costs = [cost_s(pair, max(getattr(r, region), 1e-12), region) for region in ("whole", "contact")]
            lines.append(
                f"{r.method + ' | ' + pair[1].method:<52}{costs[0]:>11.0f}"
                f"{costs[0] / r.cpu_s:>9.0f}{costs[1] / r.cpu_s:>9.0f}"
            )
        cheapest = [
            min(cost_s(pair, max(getattr(r, region), 1e-12), region) for pair in pairs) / r.cpu_s
            for region in ("whole", "contact")
        ]
        lines.append(
            f"=> {r.method}: {cheapest[0]:.0f} times cheaper at equal error (where probes touch: "
            f"{cheapest[1]:.0f}); uncertainty of its squared error {r.whole_se / r.whole:.0%}"
        )
    return "\n".join(lines)


def main() -> None:
    """Run the cases asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few presses, small pictures, a rough truth")
    parser.add_argument("--case", choices=("glass", "published", "all"), default="all")
    parser.add_argument("--seed", type=int, default=1, help="seed of all random numbers (default: 1)")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ[CACHE_VARIABLE] = folder  # no light field of an earlier run is taken
        if args.case != "published":
            run(behind_glass(quick=args.quick), seed=args.seed)
        if args.case != "glass":
            run(published(quick=args.quick), seed=args.seed)


if __name__ == "__main__":
    main()
