"""Score a design: how evenly it lights the gel, and how well its pictures tell the shape of a press."""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from designlab import maps, press_scores, scores
from designlab.bench import Bench, Reconstruction, plan_presses, sub_seed
from designlab.design import Design
from designlab.effects.model import SensorModel
from designlab.press import Press, Surface
from designlab.render import Estimator
from designlab.render.backend import activate
from designlab.scores import Estimate, TransportError
from designlab.simulate import Frame, Simulator, exposure
from designlab.store import atomic_folder, write_atomic
from designlab.worst import Place, worst_of_gel, worst_of_presses

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

SCALAR_COLUMNS = 160  # of pictures that ``scalar_rgb`` has to path-trace, four times as fast


class Fidelity(NamedTuple):
    """Effort of an evaluation.

    Samples per pixel and LED group, rounds of the six test probes, grids of nine calibration balls,
    estimator, width of the pictures.
    """

    samples: int
    rounds: int
    grids: int = 1
    estimator: Estimator = "fast"
    columns: int = 320


FIDELITIES: dict[str, Fidelity] = {
    "fast": Fidelity(samples=64, rounds=1),
    "standard": Fidelity(samples=256, rounds=2, grids=3),
    # Each of its pictures takes a quarter of a minute; calibrated as fast is, it shows what the light is off.
    "reference": Fidelity(samples=1024, rounds=2, estimator="corrected"),
}


@dataclass(frozen=True)
class Score:
    """What `evaluate` found.

    Every score is an attribute too, for example ``score.normal_error_median_deg``.

    Attributes
    ----------
    scores : mapping of str to Estimate
        The scores; of figures that each LED group has, that of the worst group.
    groups : mapping of str to mapping of str to Estimate
        Figures of each LED group.
    worst : mapping of str to Place
        Worst place of the untouched gel (``gel``) and of the test presses (``press``), see `designlab.worst`.
    presses : mapping of str to sequence of float
        Figures of each test press, of which the scores of presses are pooled.
    """

    design: str
    digest: str
    fidelity: str
    seed: int
    scores: Mapping[str, Estimate]
    margins: Mapping[str, float]
    light: TransportError
    seconds: Mapping[str, float] = field(default_factory=dict)
    groups: Mapping[str, Mapping[str, Estimate]] = field(default_factory=dict)
    worst: Mapping[str, Place] = field(default_factory=dict)
    presses: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def __getattr__(self, name: str) -> Estimate:
        """Look a score up by name."""
        scores: Mapping[str, Estimate] = self.__dict__.get("scores", {})
        if name in scores:
            return scores[name]
        raise AttributeError(f"no score {name!r}; there are {', '.join(scores)}")

    def to_json(self) -> dict[str, Any]:
        """Return the content as plain data."""
        return {
            "design": self.design,
            "digest": self.digest,
            "fidelity": self.fidelity,
            "seed": self.seed,
            "scores": _plain(self.scores),
            "groups": {name: _plain(figures) for name, figures in self.groups.items()},
            "worst": {name: place._asdict() for name, place in self.worst.items()},
            "presses": {
                # A figure that a press does not have is not a number, which JSON does not know.
                name: [None if np.isnan(value) else value for value in values]
                for name, values in self.presses.items()
            },
            "margins": dict(self.margins),
            "light": self.light._asdict(),
            "seconds": dict(self.seconds),
        }


def _plain(estimates: Mapping[str, Estimate]) -> dict[str, dict[str, Any]]:
    return {
        name: {"value": e.value, "se": e.se, "bias_bound": e.bias_bound, "unit": e.unit}
        for name, e in estimates.items()
    }


def evaluate(
    design: Design | SensorModel,
    *,
    fidelity: str = "fast",
    seed: int = 0,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> Score:
    """Score a design by simulation.

    The untouched gel tells how each LED group lights it and what the camera makes of it. Ball presses
    calibrate photometric stereo, which then reconstructs other probes at other places, with camera noise; and
    they tell how well the picture's response to slope stands out of the camera's noise. Standard errors cover
    the choice of presses (bootstrap over presses), render noise and camera noise.

    Parameters
    ----------
    design : Design or SensorModel
        What to score.
    fidelity : str
        One of `FIDELITIES`; presses depend on the seed alone, so fidelities see the same ones.
    seed : int
        Seed of places, render noise and camera noise.
    out : path, optional
        Folder for scores and pictures; replaced when it exists.
    progress : callable, optional
        Called with what is being done, how many steps are done, and how many there are.

    Raises
    ------
    InfeasibleDesign
        If the design breaks a geometric rule.
    ValueError
        If the fidelity is unknown.
    """
    if fidelity not in FIDELITIES:
        raise ValueError(f"fidelity: must be one of {', '.join(FIDELITIES)}, got {fidelity!r}")
    effort = FIDELITIES[fidelity]
    model = SensorModel.of(design)
    model.effective_design().require_feasible()
    if out is not None:
        _require_writable(Path(out))
    clock = _Clock()
    columns = effort.columns if activate().is_jit else SCALAR_COLUMNS
    simulator = Simulator(
        model, columns=columns, samples=effort.samples, seed=seed, estimator=effort.estimator
    )
    presses = plan_presses(simulator.design, rounds=effort.rounds, seed=seed, grids=effort.grids)
    steps = _Steps(progress, 2 + len(presses.calibration) + len(presses.test) + 1)

    # Surfaces are laid out while light is traced.
    with ThreadPoolExecutor(1) as ahead, clock.part("untouched gel"):
        laid_out = ahead.map(simulator.surface, (*presses.calibration, *presses.test))
        untouched = _render(simulator, None, steps, "untouched gel", sub_seed(seed, 3, 0), half=0)
        again = _render(simulator, None, steps, "untouched gel", sub_seed(seed, 3, 1), half=1)
        surfaces = dict(zip((*presses.calibration, *presses.test), laid_out, strict=True))
    with clock.part("calibration presses"):
        balls = [
            _render(simulator, p, steps, "calibration press", sub_seed(seed, 1, k), surface=surfaces[p])
            for k, p in enumerate(presses.calibration)
        ]
    with clock.part("test presses"):
        tests = [
            _render(simulator, p, steps, "test press", sub_seed(seed, 2, k), surface=surfaces[p])
            for k, p in enumerate(presses.test)
        ]
    # Threads of the linear algebra wait for each other longer than its small products take.
    with clock.part("reconstruction"), threadpool_limits(limits=1, user_api="blas"):
        steps("reconstruction")
        bench = Bench(simulator.design, exposure(simulator.design, untouched, again), seed)
        calibration, results = bench.reconstruct(untouched, again, balls, tests)
        # Every other press tells what noise adds.
        _, noisier = bench.reconstruct(untouched, again, balls, tests[::2], noisier_than=calibration)
        errors, pressed = press_scores.reconstruction_scores(
            bench, untouched, calibration.background, results, noisier
        )
    with clock.part("scores"), threadpool_limits(limits=1, user_api="blas"):
        found = _analyse(simulator, bench, (untouched, again), balls, results)
    score = Score(
        design=simulator.design.name,
        digest=model.digest if model.effects else model.design.digest,
        fidelity=fidelity,
        seed=seed,
        scores=errors | found.scores,
        margins=simulator.design.margins(),
        light=scores.transport_error(simulator.design, untouched, again),
        seconds=clock.seconds,
        groups=found.groups,
        worst=found.worst,
        presses=pressed,
    )
    if out is not None:
        _write(Path(out), score, bench, untouched, results, found)
    return score


class _Found(NamedTuple):
    """Scores and maps of the untouched gel, and the worst places."""

    scores: dict[str, Estimate]
    groups: dict[str, dict[str, Estimate]]
    worst: dict[str, Place]
    limit_deg: Array


def _analyse(
    simulator: Simulator,
    bench: Bench,
    renders: tuple[Frame, Frame],
    balls: Sequence[Frame],
    results: Sequence[Reconstruction],
) -> _Found:
    untouched, again = renders
    design, names = bench.design, bench.design.group_names
    responses = maps.slope_responses(simulator, untouched, balls)
    gel = maps.gel_maps(bench, untouched, responses.best)
    evenness, even_groups = scores.evenness_scores(design, untouched, again, bench.seed)
    exposed, exposure_error = scores.exposure_scores(bench, untouched, again)
    slants, slant_groups = scores.slant_scores(design, untouched, responses)
    presses = maps.press_maps(bench, untouched, results)
    return _Found(
        scores=scores.uniformity(design, untouched, again, bench.seed)
        | scores.information_score(bench, untouched, gel, responses, exposure_error)
        | evenness
        | exposed
        | slants,
        groups=scores.merged(even_groups, slant_groups),
        worst={
            "gel": worst_of_gel(gel, names),
            "press": worst_of_presses(presses, gel, names, steepest=maps.steepest_slope(balls)),
        },
        limit_deg=np.where(gel.seen & ~gel.saturated, gel.limit_deg, np.nan),
    )


def _render(
    simulator: Simulator,
    press: Press | None,
    steps: "_Steps",
    what: str,
    seed: int,
    *,
    half: int | None = None,
    surface: Surface | None = None,
) -> Frame:
    steps(what if press is None else f"{what} {press.probe.text}")
    return simulator.frame(press, seed=seed, half=half, surface=surface)


class _Steps:
    """Counts the steps of an evaluation for a progress display."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def __call__(self, what: str) -> None:
        if self._progress is not None:
            self._progress(what, self._done, self._total)
        self._done += 1


class _Clock:
    """Wall-clock seconds of each part."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        self.seconds[name] = round(time.perf_counter() - start, 3)


def _write(
    out: Path,
    score: Score,
    bench: Bench,
    untouched: Frame,
    results: Sequence[Reconstruction],
    found: _Found,
) -> None:
    from designlab import figures
    from designlab.design import dumps

    design = bench.design
    with atomic_folder(out, replace=True) as folder:
        write_atomic(folder / "design.toml", dumps(design))
        write_atomic(folder / "score.json", json.dumps(score.to_json(), indent=2))
        extent = figures.extent_mm(untouched.rays.x_mm, untouched.rays.y_mm)
        gel, press = found.worst["gel"], found.worst["press"]
        figures.background(folder / "background.png", untouched.mixed * bench.exposure, extent)
        named = dict(zip(design.group_names, untouched.basis, strict=True))
        figures.uniformity(folder / "uniformity.png", named, extent)
        figures.information(folder / "information.png", found.limit_deg, extent, gel)
        figures.errors(
            folder / "errors.png",
            [np.where(r.region, r.error_deg, np.nan) for r in results],
            [np.where(r.region, 1000 * np.abs(r.height_mm - r.frame.height_mm), np.nan) for r in results],
            extent,
            press,
        )
        for number, result in enumerate(results):
            shown = result.frame.press
            assert shown is not None  # every test frame has one
            figures.press(
                folder / f"press-{number + 1:02d}-{shown.probe.kind}.png",
                title=f"{shown.probe.text} mm pressed {shown.depth_mm:.2f} mm deep",
                image=result.image,
                normals=result.normals,
                true_normals=result.true_normals,
                height_mm=result.height_mm,
                true_height_mm=result.frame.height_mm,
                error_deg=np.where(result.region, result.error_deg, np.nan),
                extent=extent,
                mark=press if press.press == number else None,
            )


def _require_writable(out: Path) -> None:
    """Fail before the work, not after it; an earlier evaluation may be replaced, anything else may not."""
    if out.exists() and not out.is_dir():
        raise NotADirectoryError(f"{out}: must be a folder, is a file")
    if out.is_dir() and any(out.iterdir()) and not (out / "score.json").is_file():
        raise FileExistsError(f"{out}: is not empty and holds no earlier evaluation; choose another folder")
    with atomic_folder(out.parent / f".{out.name}.probe", replace=True):
        pass
    (out.parent / f".{out.name}.probe").rmdir()
