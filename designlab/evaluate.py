"""Score a design: how evenly it lights the gel, and how well its pictures tell the shape of a press."""

import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, gaussian_filter

from designlab.camera import Camera
from designlab.design import Design
from designlab.effects.model import SensorModel
from designlab.metrics import normal_error_deg, uniformity_cv, uniformity_u0
from designlab.press import Press
from designlab.reconstruct import Calibration, fit_calibration, integrate, normals
from designlab.simulate import Frame, Simulator, exposure
from designlab.store import atomic_folder, write_atomic
from geometries.elastomer import base_gradient
from geometries.probes import parse

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

# Errors count over the contact grown by this: a flat background would make any median look good.
GROWN_MM = 0.5
SMOOTHING_PX = 2.0  # illumination is smooth; render noise is not, and would pass for unevenness
BALL_MM = 6.0
TEST_PROBES = ("sphere:4", "triangle:5", "star:6", "cylinder:4", "cone:4", "dots:1.5")
BOOTSTRAPS = 400


class Fidelity(NamedTuple):
    """Effort of an evaluation: samples per pixel and LED group, and rounds of the six test probes."""

    samples: int
    rounds: int
    columns: int = 200


FIDELITIES: dict[str, Fidelity] = {
    "fast": Fidelity(samples=64, rounds=1),
    "standard": Fidelity(samples=256, rounds=2),
    "reference": Fidelity(samples=1024, rounds=2),
}


@dataclass(frozen=True)
class Estimate:
    """A score with its standard error, both in `unit`; `bias_bound` is None where no bias is known."""

    value: float
    se: float
    unit: str
    bias_bound: float | None = None

    def __str__(self) -> str:
        """Value, standard error and unit for people."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.value:.4g} ± {self.se:.2g}{unit}"


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
            "seconds": dict(self.seconds),
        }


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """One test press: the picture, what was reconstructed from it, and the truth."""

    frame: Frame
    image: NDArray[np.float32]
    normals: Array
    true_normals: Array
    height_mm: Array
    region: NDArray[np.bool_]
    error_deg: Array

    @property
    def height_error_um(self) -> Array:
        """Errors of height in the region that counts, one a pixel."""
        return np.asarray(1000 * (self.height_mm - self.frame.height_mm)[self.region])


class Presses(NamedTuple):
    """Calibration balls and test presses; their places are disjoint."""

    calibration: tuple[Press, ...]
    test: tuple[Press, ...]


def evaluate(
    design: Design | SensorModel,
    *,
    fidelity: str = "fast",
    seed: int = 0,
    out: str | Path | None = None,
    progress: Progress | None = None,
) -> Score:
    """Score a design by simulation.

    The untouched gel gives the uniformity of each LED group. Nine ball presses calibrate photometric
    stereo, which then reconstructs other probes at other places, with camera noise. Standard errors cover
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
    simulator = Simulator(model, columns=effort.columns, samples=effort.samples, seed=seed)
    presses = plan_presses(simulator.design, rounds=effort.rounds, seed=seed)
    steps = _Steps(progress, 2 + len(presses.calibration) + len(presses.test) + 1)

    with clock.part("untouched gel"):
        untouched = _render(simulator, None, steps, "untouched gel", _sub(seed, 3, 0), half=0)
        again = _render(simulator, None, steps, "untouched gel", _sub(seed, 3, 1), half=1)
    with clock.part("calibration presses"):
        balls = [
            _render(simulator, p, steps, "calibration press", _sub(seed, 1, k))
            for k, p in enumerate(presses.calibration)
        ]
    with clock.part("test presses"):
        tests = [
            _render(simulator, p, steps, "test press", _sub(seed, 2, k)) for k, p in enumerate(presses.test)
        ]
    with clock.part("reconstruction"):
        steps("reconstruction")
        bench = _Bench(simulator.design, exposure(simulator.design, untouched), seed)
        results = bench.reconstruct(untouched, again, balls, tests, extra_noise=False)
        noisier = bench.reconstruct(untouched, again, balls, tests, extra_noise=True)
        scores = _uniformity(simulator.design, untouched, again) | _reconstruction_scores(
            results, noisier, seed
        )
    score = Score(
        design=simulator.design.name,
        digest=model.digest if model.effects else model.design.digest,
        fidelity=fidelity,
        seed=seed,
        scores=scores,
        margins=simulator.design.margins(),
        seconds=clock.seconds,
    )
    if out is not None:
        _write(Path(out), score, simulator.design, untouched, results, bench.exposure)
    return score


def plan_presses(design: Design, *, rounds: int, seed: int) -> Presses:
    """Choose places and depths: balls on a jittered 3 x 3 grid, test probes at random places between them."""
    random = np.random.default_rng(_sub(seed, 0, 0))
    width, height = design.sensing_area_mm
    scale = min(1.0, min(width, height) / 12.0)  # small sensors get small probes
    depth = min(0.4 * design.elastomer.thickness_mm, 0.8) * scale
    balls = []
    for number, (column, row) in enumerate((c, r) for r in (-1, 0, 1) for c in (-1, 0, 1)):
        jitter = random.uniform(-0.04, 0.04, size=2)
        centre = ((0.3 * column + jitter[0]) * width, (0.28 * row + jitter[1]) * height)
        balls.append(
            Press(
                probe=parse(f"sphere:{BALL_MM * scale:.6g}"),
                depth_mm=depth * (1.0, 0.6)[number % 2],
                centre_mm=centre,
            )
        )
    tests = []
    for number in range(rounds):
        # The first round does not depend on how many follow.
        draw = np.random.default_rng(_sub(seed, 9, number))
        for text in TEST_PROBES:
            kind, size = text.split(":")
            centre = (draw.uniform(-0.22, 0.22) * width, draw.uniform(-0.2, 0.2) * height)
            tests.append(
                Press(
                    probe=parse(f"{kind}:{float(size) * scale:.6g}"),
                    depth_mm=depth * draw.uniform(0.5, 0.9),
                    centre_mm=centre,
                    yaw_deg=draw.uniform(-180.0, 180.0),
                )
            )
    return Presses(tuple(balls), tuple(tests))


@dataclass(frozen=True)
class _Bench:
    """Camera and reconstruction around rendered frames."""

    design: Design
    exposure: float
    seed: int

    def picture(self, frame: Frame, number: int, extra: Array | None) -> NDArray[np.float32]:
        """What the camera reports; `extra` adds render noise of the given standard deviation per group."""
        mixed = frame.mixed
        if extra is not None:
            random = np.random.default_rng(_sub(self.seed, 5, number))
            noise = random.standard_normal(frame.basis.shape) * extra[:, None, None] * frame.basis
            mixed = np.einsum("cg,grk->rkc", frame.weights, frame.basis + noise).astype(np.float32)
        camera: Camera = self.design.camera
        return camera.expose(
            mixed, exposure=self.exposure, seed=_sub(self.seed, 4, number), binned=max(frame.rays.binned, 1.0)
        )

    def reconstruct(
        self,
        untouched: Frame,
        again: Frame,
        balls: Sequence[Frame],
        tests: Sequence[Frame],
        *,
        extra_noise: bool,
    ) -> list[Reconstruction]:
        """Calibrate on the balls and reconstruct the tests."""
        extra = _render_noise(untouched, again) if extra_noise else None
        # A lab averages many frames of the untouched gel; smoothing stands for that.
        background = gaussian_filter(
            (self.picture(untouched, 0, extra) + self.picture(again, 1, extra)) / 2,
            sigma=(SMOOTHING_PX, SMOOTHING_PX, 0),
        )
        x, y = untouched.rays.x_mm, untouched.rays.y_mm
        images = [self.picture(frame, 10 + number, extra) for number, frame in enumerate(balls)]
        truths = [frame.gradient for frame in balls]
        everywhere = [np.ones(x.shape, dtype=bool) for _ in balls]
        calibration = fit_calibration(
            images, background, [p for p, _ in truths], [q for _, q in truths], everywhere, x, y
        )
        return [
            self._one(calibration, frame, self.picture(frame, 100 + k, extra))
            for k, frame in enumerate(tests)
        ]

    def _one(self, calibration: Calibration, frame: Frame, image: NDArray[np.float32]) -> Reconstruction:
        p, q = calibration.gradients(image)
        true_p, true_q = frame.gradient
        base_p, base_q = base_gradient(self.design.elastomer, *frame.seen_mm)
        pitch = frame.rays.pitch_mm
        estimated, truth = normals(p + base_p, q + base_q), normals(true_p + base_p, true_q + base_q)
        region = _grown(frame.contact, GROWN_MM / pitch[0])
        return Reconstruction(
            frame=frame,
            image=image,
            normals=estimated,
            true_normals=truth,
            height_mm=integrate(p, q, pitch_mm=pitch, boundary="dirichlet"),
            region=region,
            error_deg=normal_error_deg(estimated, truth),
        )


def _grown(mask: NDArray[np.bool_], radius_px: float) -> NDArray[np.bool_]:
    reach = int(np.ceil(radius_px))
    offsets = np.arange(-reach, reach + 1)
    disc = np.hypot(offsets[:, None], offsets[None]) <= radius_px
    return np.asarray(binary_dilation(mask, structure=disc))


def _render_noise(a: Frame, b: Frame) -> Array:
    """Relative standard deviation of each group's pixel noise, from two renders of one scene.

    Only what differs between neighbouring pixels counts: a smooth error is shared by all presses and is
    calibrated away.
    """
    difference = (a.basis - b.basis) / (0.5 * (a.basis + b.basis).mean(axis=(1, 2), keepdims=True))
    smooth = gaussian_filter(difference, sigma=(0, 4, 4))
    return np.asarray((difference - smooth).std(axis=(1, 2)) / np.sqrt(2.0))


def _uniformity(design: Design, a: Frame, b: Frame) -> dict[str, Estimate]:
    width, height = design.sensing_area_mm
    mask = (np.abs(a.rays.x_mm) <= width / 2) & (np.abs(a.rays.y_mm) <= height / 2)

    def worst(images: NDArray[np.floating]) -> tuple[float, float]:
        smooth = [gaussian_filter(image, SMOOTHING_PX, mode="nearest") for image in images]
        return min(uniformity_u0(i, mask) for i in smooth), max(uniformity_cv(i, mask) for i in smooth)

    both, first, second = worst((a.basis + b.basis) / 2), worst(a.basis), worst(b.basis)
    return {
        name: Estimate(both[k], abs(first[k] - second[k]) / 2 + 1e-6, "1")
        for k, name in enumerate(("uniformity_u0", "uniformity_cv"))
    }


def _reconstruction_scores(
    results: Sequence[Reconstruction], noisier: Sequence[Reconstruction], seed: int
) -> dict[str, Estimate]:
    units = {
        "normal_error_median_deg": "deg",
        "normal_error_mean_deg": "deg",
        "height_mae_um": "um",
        "height_rmse_um": "um",
    }
    value, doubled = _pooled(results), _pooled(noisier)
    random = np.random.default_rng(_sub(seed, 6, 0))
    draws = [
        _pooled([results[k] for k in random.integers(0, len(results), len(results))])
        for _ in range(BOOTSTRAPS)
    ]
    estimates = {}
    for name, unit in units.items():
        choice = float(np.std([draw[name] for draw in draws]))
        # Doubling the variance of the render noise moves a score by about what that noise already moved it.
        estimates[name] = Estimate(value[name], float(np.hypot(choice, doubled[name] - value[name])), unit)
    return estimates


def _pooled(results: Sequence[Reconstruction]) -> dict[str, float]:
    """Each press counts the same, whatever its size."""
    angles = [r.error_deg[r.region] for r in results]
    heights = [r.height_error_um for r in results]
    return {
        "normal_error_median_deg": float(np.mean([np.median(a) for a in angles])),
        "normal_error_mean_deg": float(np.mean([a.mean() for a in angles])),
        "height_mae_um": float(np.mean([np.abs(h).mean() for h in heights])),
        "height_rmse_um": float(np.sqrt(np.mean([np.mean(h**2) for h in heights]))),
    }


def _render(
    simulator: Simulator, press: Press | None, steps: "_Steps", what: str, seed: int, half: int | None = None
) -> Frame:
    steps(what if press is None else f"{what} {press.probe.text}")
    return simulator.frame(press, seed=seed, half=half)


def _sub(seed: int, stage: int, number: int) -> int:
    """Independent seed of one draw."""
    return int(np.random.SeedSequence([seed, stage, number]).generate_state(1)[0])


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
