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
from scipy.ndimage import gaussian_filter, uniform_filter
from threadpoolctl import threadpool_limits

from designlab.bench import SMOOTHING_PX, Bench, Reconstruction, plan_presses, sub_seed
from designlab.design import Design
from designlab.effects.model import SensorModel
from designlab.metrics import uniformity_cv, uniformity_u0
from designlab.press import Press, Surface
from designlab.render import Estimator
from designlab.render.backend import activate
from designlab.simulate import Frame, Simulator, exposure
from designlab.store import atomic_folder, write_atomic

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

BOOTSTRAPS = 400
SCALAR_COLUMNS = 160  # of pictures that ``scalar_rgb`` has to path-trace, four times as fast
UNIFORMITY_DRAWS = 50
BLOCK_CELLS = 3  # noise of a light field reaches over its cells, not over three of them


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
    "reference": Fidelity(samples=1024, rounds=2, grids=3, estimator="corrected"),
}


@dataclass(frozen=True)
class Estimate:
    """A score with its standard error, both in `unit`.

    `bias_bound` is how much of the standard error is systematic; None where no bias is known.
    """

    value: float
    se: float
    unit: str
    bias_bound: float | None = None

    def __str__(self) -> str:
        """Value, standard error and unit for people."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.value:.4g} ± {self.se:.2g}{unit}"


class TransportError(NamedTuple):
    """How far the light of a picture may be off, relative to its mean; of the worst LED group.

    Parameters
    ----------
    noise : float
        Standard error of blocks of 1 mm x 1 mm of the untouched gel.
    bias_mean, bias_block : float
        Systematic error of the mean and of small blocks, the largest seen, see `designlab.render.Bias`.
    """

    noise: float
    bias_mean: float
    bias_block: float

    def __str__(self) -> str:
        """Sentence for people."""
        noise = f"light on the untouched gel: random error {self.noise:.1%} of each mm2"
        if not self.bias_block:
            return f"{noise}, no bias"
        return (
            f"{noise}; bias, the largest of random designs: {self.bias_mean:.1%} of the mean, "
            f"{self.bias_block:.0%} of 8 x 8 of 160 columns"
        )


@dataclass(frozen=True)
class Score:
    """What `evaluate` found.

    Every score is an attribute too, for example ``score.normal_error_median_deg``.
    """

    design: str
    digest: str
    fidelity: str
    seed: int
    scores: Mapping[str, Estimate]
    margins: Mapping[str, float]
    light: TransportError
    seconds: Mapping[str, float] = field(default_factory=dict)

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
            "scores": {
                name: {"value": e.value, "se": e.se, "bias_bound": e.bias_bound, "unit": e.unit}
                for name, e in self.scores.items()
            },
            "margins": dict(self.margins),
            "light": self.light._asdict(),
            "seconds": dict(self.seconds),
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

    The untouched gel gives the uniformity of each LED group. Ball presses calibrate photometric
    stereo, which then reconstructs other probes at other places, with camera noise; and they tell how well
    the picture's response to slope stands out of the camera's noise. Standard errors cover the choice of
    presses (bootstrap over presses), render noise and camera noise.

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
        bench = Bench(simulator.design, exposure(simulator.design, untouched), seed)
        calibration, results = bench.reconstruct(untouched, again, balls, tests)
        _, noisier = bench.reconstruct(untouched, again, balls, tests, noisier_than=calibration)
        scores = (
            _uniformity(simulator.design, untouched, again, seed)
            | _reconstruction_scores(results, noisier, seed)
            | _information(bench, untouched, balls)
        )
    score = Score(
        design=simulator.design.name,
        digest=model.digest if model.effects else model.design.digest,
        fidelity=fidelity,
        seed=seed,
        scores=scores,
        margins=simulator.design.margins(),
        light=_transport_error(simulator.design, untouched, again),
        seconds=clock.seconds,
    )
    if out is not None:
        _write(Path(out), score, simulator.design, untouched, results, bench.exposure)
    return score


def _uniformity(design: Design, a: Frame, b: Frame, seed: int) -> dict[str, Estimate]:
    """Evenness of the worst LED group; errors from the difference of two independent renders.

    Noise passes for unevenness in proportion to its variance, of which each render has twice that of their
    mean; the difference of the two is taken off.
    """
    mask = _sensing_area(design, a)
    # Mean and half difference carry the same noise: blocks of the latter with random signs are new draws.
    mean, noise = (a.basis + b.basis) / 2, (a.basis - b.basis) / 2
    random = np.random.default_rng(sub_seed(seed, 7, 0))
    # A path tracer's pixels err independently, a light field over its cells.
    block = max(1, round(BLOCK_CELLS * a.grain_mm / a.rays.pitch_mm[0]))
    draws = [
        _evenness(mean + _random_signs(random, mean.shape, block) * noise, mask)
        for _ in range(UNIFORMITY_DRAWS)
    ]
    single = np.mean([_evenness(a.basis, mask), _evenness(b.basis, mask)], axis=0)
    values = 2 * np.array(_evenness(mean, mask)) - single
    errors = np.std(draws, axis=0, ddof=1)
    return {
        name: Estimate(float(value), float(se), "1")
        for name, value, se in zip(("uniformity_u0", "uniformity_cv"), values, errors, strict=True)
    }


def _transport_error(design: Design, a: Frame, b: Frame) -> TransportError:
    """Noise of the mean of two independent renders of the untouched gel, and the bound of their bias."""
    mask = _sensing_area(design, a)
    size = max(1, round(1.0 / float(a.rays.pitch_mm[0])))
    noise = []
    for one, other in zip(a.basis, b.basis, strict=True):
        blocks = uniform_filter((one - other) / 2, size, mode="nearest")
        noise.append(float(np.sqrt(np.mean(blocks[mask] ** 2)) / (one + other)[mask].mean() * 2))
    return TransportError(max(noise), *a.bias)


def _sensing_area(design: Design, frame: Frame) -> NDArray[np.bool_]:
    width, height = design.sensing_area_mm
    return np.asarray((np.abs(frame.rays.x_mm) <= width / 2) & (np.abs(frame.rays.y_mm) <= height / 2))


def _evenness(basis: NDArray[np.floating], mask: NDArray[np.bool_]) -> tuple[float, float]:
    """U0 and coefficient of variation of the worst group."""
    smooth = [gaussian_filter(image, SMOOTHING_PX, mode="nearest") for image in basis]
    return min(uniformity_u0(i, mask) for i in smooth), max(uniformity_cv(i, mask) for i in smooth)


def _random_signs(random: np.random.Generator, shape: tuple[int, ...], block: int) -> NDArray[np.float32]:
    """Signs that are equal over square blocks of an image stack."""
    groups, rows, columns = shape
    coarse = random.choice([-1.0, 1.0], size=(groups, -(-rows // block), -(-columns // block)))
    fine = np.repeat(np.repeat(coarse, block, axis=1), block, axis=2)
    return fine[:, :rows, :columns].astype(np.float32)


def _information(bench: Bench, untouched: Frame, balls: Sequence[Frame]) -> dict[str, Estimate]:
    """Median noise limit over the sensing area; error by leaving each ball out in turn (jackknife)."""
    mask = _sensing_area(bench.design, untouched)

    value, *without = (float(np.median(limit[mask])) for limit in bench.noise_limits_deg(untouched, balls))
    se = float(np.std(without) * np.sqrt(len(balls) - 1))
    return {"information_deg": Estimate(value, se, "deg")}


def _reconstruction_scores(
    results: Sequence[Reconstruction], noisier: Sequence[Reconstruction], seed: int
) -> dict[str, Estimate]:
    units = {
        "normal_error_median_deg": "deg",
        "normal_error_mean_deg": "deg",
        "height_mae_um": "um",
        "height_rmse_um": "um",
    }
    each = _errors(results)
    value, doubled = _pooled(each), _pooled(_errors(noisier))
    random = np.random.default_rng(sub_seed(seed, 6, 0))
    draws = [_pooled(each[random.integers(0, len(each), len(each))]) for _ in range(BOOTSTRAPS)]
    # The spread of a bootstrap falls short of that of the sample by (n - 1) / n.
    short = np.sqrt(len(results) / (len(results) - 1))
    estimates = {}
    for name, unit in units.items():
        choice = short * float(np.std([draw[name] for draw in draws]))
        # Doubling the variance of the render noise moves a score by about what that noise already moved it.
        bias = abs(doubled[name] - value[name])
        estimates[name] = Estimate(value[name], float(np.hypot(choice, bias)), unit, bias)
    return estimates


def _errors(results: Sequence[Reconstruction]) -> Array:
    """Median and mean angle, mean absolute and mean square height error of each press, shape (presses, 4)."""
    angles = [r.error_deg[r.region] for r in results]
    heights = [r.height_error_um for r in results]
    return np.array(
        [
            (np.median(a), a.mean(), np.abs(h).mean(), np.mean(h**2))
            for a, h in zip(angles, heights, strict=True)
        ]
    )


def _pooled(errors: Array) -> dict[str, float]:
    """Each press counts the same, whatever its size."""
    median, mean, absolute, square = (float(value) for value in errors.mean(axis=0))
    return {
        "normal_error_median_deg": median,
        "normal_error_mean_deg": mean,
        "height_mae_um": absolute,
        "height_rmse_um": float(np.sqrt(square)),
    }


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
    out: Path, score: Score, design: Design, untouched: Frame, results: Sequence[Reconstruction], scale: float
) -> None:
    from designlab import figures
    from designlab.design import dumps

    with atomic_folder(out, replace=True) as folder:
        write_atomic(folder / "design.toml", dumps(design))
        write_atomic(folder / "score.json", json.dumps(score.to_json(), indent=2))
        extent = figures.extent_mm(untouched.rays.x_mm, untouched.rays.y_mm)
        figures.background(folder / "background.png", untouched.mixed * scale, extent)
        named = dict(zip(design.group_names, untouched.basis, strict=True))
        figures.uniformity(folder / "uniformity.png", named, extent)
        for number, result in enumerate(results):
            press = result.frame.press
            assert press is not None  # every test frame has one
            figures.press(
                folder / f"press-{number + 1:02d}-{press.probe.kind}.png",
                title=f"{press.probe.text} mm pressed {press.depth_mm:.2f} mm deep",
                image=result.image,
                normals=result.normals,
                true_normals=result.true_normals,
                height_mm=result.height_mm,
                true_height_mm=result.frame.height_mm,
                error_deg=np.where(result.region, result.error_deg, np.nan),
                extent=extent,
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
