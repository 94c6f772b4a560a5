"""Score a design: how evenly it lights the gel, and how well its pictures tell the shape of a press."""

import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from itertools import count, islice
from typing import TYPE_CHECKING, NamedTuple

from threadpoolctl import threadpool_limits

from designlab.core.backend import activate
from designlab.core.progress import silent
from designlab.core.types import Progress
from designlab.evaluation import contact_scores, illumination_scores, press_scores, response_maps
from designlab.evaluation.illumination_scores import Estimate
from designlab.evaluation.press_plan import Presses, PressPlan
from designlab.evaluation.protocol import EvaluationProtocol, Reconstruction, sub_seed
from designlab.evaluation.score import Evaluation, Score
from designlab.evaluation.weakest_point import GelMaps, Place, worst_of_gel, worst_of_presses
from designlab.mechanics.contact import NotConverged
from designlab.reconstruction import KernelCalibration
from designlab.sensor.design import Design, InfeasibleDesign
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Surface
from designlab.simulation.effects.model import SensorModel
from designlab.simulation.render.estimators import Estimator
from designlab.simulation.simulator import Frame, Simulator, exposure, saturation_warning

if TYPE_CHECKING:
    pass

SCALAR_COLUMNS = 160  # of pictures that ``scalar_rgb`` has to path-trace, four times as fast


class Fidelity(NamedTuple):
    """Effort of an evaluation.

    Samples per pixel and LED group, rounds of the six test probes, grids of nine calibration balls,
    estimator, width of the pictures, samples of the unbiased part of the estimator "corrected".
    """

    samples: int
    rounds: int
    grids: int = 1
    estimator: Estimator = "fast"
    columns: int = 320
    traced: int = 64


FIDELITIES: dict[str, Fidelity] = {
    "fast": Fidelity(samples=48, rounds=1),
    "standard": Fidelity(samples=192, rounds=2, grids=2),
    # Each of its pictures takes many seconds; calibrated as fast is, it shows what the light is off.
    "reference": Fidelity(samples=1024, rounds=2, estimator="corrected"),
}


def evaluate(
    design: Design | SensorModel,
    *,
    fidelity: str = "fast",
    seed: int = 0,
    presses: PressPlan | None = None,
    all_scores: bool = False,
    progress: Progress = silent,
    calibration: KernelCalibration | None = None,
    as_built: bool = False,
) -> Evaluation:
    """Score a design by simulation, and keep what the scores were taken from.

    The untouched gel tells how each LED group lights it and what the camera makes of it. Ball presses
    calibrate photometric stereo, which then reconstructs other probes at other places, with camera noise; and
    they tell how well the picture's response to slope stands out of the camera's noise. What render noise
    adds to the errors of the presses is told by pictures from half of the light, and taken off. Standard
    errors cover the choice of presses, render noise and camera noise.

    Parameters
    ----------
    design : Design or SensorModel
        What to score.
    fidelity : str
        One of `FIDELITIES`; presses depend on plan and seed alone, so fidelities see the same ones.
    seed : int
        Seed of places, render noise and camera noise.
    presses : PressPlan, optional
        How deep and in which area the gel is pressed; designs that are compared share one. That of
        `PressPlan.of` the design when absent.
    all_scores : bool
        Whether to find the scores of elastic gels that need presses of their own (`OWN_PRESSES`), as fidelity
        standard always does.
    progress : callable, optional
        Called with what is being done, how many steps are done, and how many there are.
    calibration : KernelCalibration, optional
        Of another sensor of the kind, see `calibration_of`, which stands in for calibrating this one: of it
        only the untouched gel is seen. Its pictures must be as large as those of `fidelity`.
    as_built : bool
        Whether it is a sensor as it was built, which may have lost some of its view: ``coverage`` tells.

    Returns
    -------
    Score
        Each score with value, standard error, bound of its bias, and unit.

    Raises
    ------
    InfeasibleDesign
        If the design breaks a geometric rule, or cannot take the presses.
    ValueError
        If the fidelity is unknown.
    """
    effort = _effort(fidelity)
    model = SensorModel.of(design)
    model.effective_design().require_feasible(as_built=as_built)
    plan = _plan(model, presses)
    simulator = _simulator(model, effort, seed)
    if calibration is not None:
        _require_fitting(calibration, simulator)
    pressed = plan.presses(rounds=effort.rounds, seed=seed, grids=effort.grids)
    clock = _Clock()
    with ThreadPoolExecutor(1) as beside:
        frames = _rendered(simulator, pressed, beside, clock, progress, at_once=plan.force_n is not None)
        # Threads of the linear algebra wait for each other longer than its small products take.
        with clock.part("reconstruction and scores"), threadpool_limits(limits=1, user_api="blas"):
            found = _scored(simulator, frames, calibration, beside)
        with clock.part("force scores"), threadpool_limits(limits=1, user_api="blas"):
            contact = contact_scores.force_scores(
                simulator.design, found.presses, found.errors["height_rmse_um"]
            )
        if contact and (all_scores or fidelity == "standard"):
            with clock.part("presses of their own"), threadpool_limits(limits=1, user_api="blas"):
                contact |= _of_own_presses(simulator, found, frames.untouched[0])
    errors, of_presses = found.errors, dict(found.of_presses)
    if plan.force_n is not None:
        of_presses["depth_mm"] = _depths_mm(frames.tests)
        errors |= {"press_depth_mm": press_scores.mean_depth(of_presses["depth_mm"])}
    score = Score(
        design=simulator.design.name,
        digest=model.digest if model.effects else model.design.digest,
        fidelity=fidelity,
        seed=seed,
        press_plan=plan,
        scores=errors | contact | found.gel.scores,
        margins=simulator.design.margins(),
        light=illumination_scores.transport_error(simulator.design, *frames.untouched),
        seconds=clock.seconds,
        groups=found.gel.groups,
        worst=found.worst,
        presses=of_presses,
        warnings=(
            *model.warnings([*pressed.calibration, *pressed.test]),
            *_beyond(frames),
            *saturation_warning(found.gel.scores["saturation_share"].value, "the untouched gel"),
        ),
        made_from=simulator.design.lineage,
        not_buildable=simulator.design.not_buildable,
    )
    return Evaluation(
        score, simulator.design, found.protocol.exposure, frames.untouched[0], found.gel.maps, found.presses
    )


def calibration_of(
    design: Design | SensorModel,
    *,
    fidelity: str = "fast",
    seed: int = 0,
    presses: PressPlan | None = None,
) -> KernelCalibration:
    """Calibrate one sensor, for others that are built to the same drawing.

    Parameters
    ----------
    design, fidelity, seed, presses
        As of `evaluate`.
    """
    effort = _effort(fidelity)
    model = SensorModel.of(design)
    model.effective_design().require_feasible()
    plan = _plan(model, presses)
    simulator = _simulator(model, effort, seed)
    pressed = plan.presses(rounds=effort.rounds, seed=seed, grids=effort.grids)
    untouched, again = _untouched(simulator)
    surfaces = (_surface(simulator, press) for press in pressed.calibration)
    alone = Presses(pressed.calibration, ())
    balls = list(_pressed(simulator, alone, surfaces, _Steps(silent, len(pressed.calibration))))
    protocol = EvaluationProtocol(
        simulator.design, exposure(simulator.design, untouched, again), seed, model=simulator.model
    ).with_markers(untouched, again)
    with threadpool_limits(limits=1, user_api="blas"):
        return protocol.calibrate(untouched, again, balls)


def _effort(fidelity: str) -> Fidelity:
    if fidelity not in FIDELITIES:
        raise ValueError(f"fidelity: must be one of {', '.join(FIDELITIES)}, got {fidelity!r}")
    return FIDELITIES[fidelity]


def _plan(model: SensorModel, presses: PressPlan | None) -> PressPlan:
    """The plan given, or the usual one; a design must take its presses."""
    design = model.effective_design()
    plan = presses or PressPlan.of(design)
    plan.require_possible(design)
    return plan


def _simulator(model: SensorModel, effort: Fidelity, seed: int) -> Simulator:
    columns = effort.columns if activate().is_jit else SCALAR_COLUMNS
    return Simulator(
        model,
        columns=columns,
        samples=effort.samples,
        seed=seed,
        estimator=effort.estimator,
        traced_samples=effort.traced,
    )


def _require_fitting(calibration: KernelCalibration, simulator: Simulator) -> None:
    rows, columns, _ = calibration.background.shape
    view = simulator.view
    if (rows, columns) != (view.rows, view.columns):
        raise ValueError(
            f"calibration: must be of pictures of {view.columns} x {view.rows} pixels, "
            f"is of {columns} x {rows}: of another camera or fidelity"
        )


def _surface(simulator: Simulator, press: Press) -> Surface:
    """Membrane under a press; that it cannot be made speaks of the design, for all get the same."""
    try:
        return simulator.surface(press)
    except ValueError as error:
        x_mm, y_mm = press.centre_mm
        raise InfeasibleDesign(
            f"design {simulator.design.name!r} is infeasible for these presses: {press.probe.text} at "
            f"({x_mm:.3g}, {y_mm:.3g}) mm: {error}"
        ) from None


def _depths_mm(frames: Sequence[Frame]) -> list[float]:
    """How deep presses of an elastic gel went."""
    found = [frame.surface.mechanics for frame in frames]
    return [mechanics.depth_mm for mechanics in found if mechanics is not None]


def _untouched(simulator: Simulator) -> tuple[Frame, Frame]:
    """Two pictures of the untouched gel, which differ by render noise."""
    first, again = (
        simulator.frame(None, seed=sub_seed(simulator.seed, 3, half), half=half) for half in (0, 1)
    )
    return first, again


class _Frames(NamedTuple):
    """What an evaluation renders.

    The untouched gel twice, the calibration and the test presses, and some of the latter, by their numbers,
    from either half of the light alone.
    """

    untouched: tuple[Frame, Frame]
    balls: list[Frame]
    tests: list[Frame]
    halved: Sequence[int]
    halves: list[list[Frame]]


def _rendered(
    simulator: Simulator,
    presses: Presses,
    beside: Executor,
    clock: "_Clock",
    progress: Progress,
    *,
    at_once: bool,
) -> _Frames:
    """Render; surfaces are laid out, and what pictures show of them is found, while light is traced.

    Where some presses may be out of reach, surfaces are laid out `at_once`, before any light is traced.
    """
    halved = press_scores.noisier_presses(len(presses.test))
    steps = _Steps(progress, 1 + len(presses.calibration) + len(presses.test) + 2 * len(halved) + 1)
    surfaces = beside.map(partial(_surface, simulator), (*presses.calibration, *presses.test))
    if at_once:
        surfaces = iter(list(surfaces))
    with clock.part("untouched gel"):
        steps("untouched gel")
        untouched = _untouched(simulator)
    frames = _pressed(simulator, presses, surfaces, steps)
    with clock.part("calibration presses"):
        balls = list(islice(frames, len(presses.calibration)))
        beside.submit(_find_truth, balls)
    with clock.part("test presses"):
        tests = list(frames)
        halves = _by_halves(simulator, [tests[k] for k in halved], steps)
    steps("reconstruction")
    return _Frames(untouched, balls, tests, halved, halves)


def _beyond(frames: _Frames) -> list[str]:
    """Where the model of contact was used beyond what it holds for, each way once."""
    surfaces = [frame.surface for frame in (*frames.balls, *frames.tests)]
    return list(dict.fromkeys(text for surface in surfaces for text in surface.warnings))


class _Scored(NamedTuple):
    """What an evaluation finds in its frames."""

    protocol: EvaluationProtocol
    calibration: KernelCalibration
    gel: "_Gel"
    presses: Sequence[Reconstruction]
    errors: dict[str, Estimate]
    of_presses: Mapping[str, Sequence[float]]
    worst: dict[str, Place]


def _scored(
    simulator: Simulator, frames: _Frames, calibration: KernelCalibration | None, beside: Executor
) -> _Scored:
    """Reconstruct the test presses and score them and the untouched gel."""
    design, (untouched, again) = simulator.design, frames.untouched
    protocol = EvaluationProtocol(
        design, exposure(design, untouched, again), simulator.seed, model=simulator.model
    ).with_markers(untouched, again)
    of_gel = beside.submit(_scores_of_gel, simulator, protocol, frames)
    if calibration is None:
        own = protocol.calibrate(untouched, again, frames.balls)
    else:
        own = calibration.on(protocol.background(untouched, again))
    noisier = beside.submit(_noisier, protocol, own, frames)
    presses = protocol.reconstruct(own, frames.tests)
    errors, of_presses = press_scores.reconstruction_scores(
        protocol, untouched, own.background, presses, noisier.result()
    )
    gel = of_gel.result()
    worst = {
        "gel": worst_of_gel(gel.maps, design.group_names),
        "press": worst_of_presses(
            response_maps.press_maps(protocol, untouched, presses),
            gel.maps,
            design.group_names,
            steepest=response_maps.steepest_slope(frames.balls),
        ),
    }
    return _Scored(protocol, own, gel, presses, errors, of_presses, worst)


def _of_own_presses(simulator: Simulator, found: _Scored, untouched: Frame) -> dict[str, Estimate]:
    """Scores that need presses of their own; those whose presses a design does not take are left out."""
    numbers = count()

    def picture(press: Press) -> Frame:
        own = sub_seed(simulator.seed, 11, next(numbers))
        return simulator.frame(press, seed=own, surface=_surface(simulator, press))

    pixel_mm = max(abs(pitch) for pitch in untouched.rays.pitch_mm)
    scores: dict[str, Estimate] = {}
    with suppress(InfeasibleDesign, NotConverged):
        scores |= contact_scores.saturation_depth(found.protocol, picture)
    with suppress(InfeasibleDesign, NotConverged):
        scores |= contact_scores.lateral_resolution(
            found.protocol, found.calibration, picture, pixel_mm=pixel_mm
        )
    return scores


class _Gel(NamedTuple):
    """Scores and maps of the untouched gel."""

    scores: dict[str, Estimate]
    groups: dict[str, dict[str, Estimate]]
    maps: GelMaps


def _scores_of_gel(simulator: Simulator, protocol: EvaluationProtocol, frames: _Frames) -> _Gel:
    design, (untouched, again) = protocol.design, frames.untouched
    responses = response_maps.slope_responses(simulator, untouched, frames.balls)
    gel = response_maps.gel_maps(protocol, untouched, responses.best)
    evenness, even_groups = illumination_scores.evenness_scores(design, untouched, again, protocol.seed)
    exposed, exposure_error = illumination_scores.exposure_scores(protocol, untouched, again)
    slants, slant_groups = illumination_scores.slant_scores(design, untouched, responses)
    return _Gel(
        scores=illumination_scores.uniformity(design, untouched, again, protocol.seed)
        | illumination_scores.information_score(protocol, untouched, gel, responses, exposure_error)
        | evenness
        | exposed
        | slants,
        groups=illumination_scores.merged(even_groups, slant_groups),
        maps=gel,
    )


def _pressed(
    simulator: Simulator, presses: Presses, surfaces: Iterator[Surface], steps: "_Steps"
) -> Iterator[Frame]:
    """Pictures of the calibration presses, then of the test presses."""
    surface = next(surfaces)
    for stage, (what, planned) in enumerate(zip(("calibration", "test"), presses, strict=True), 1):
        for number, press in enumerate(planned):
            steps(f"{what} press {press.probe.text}")
            following = next(surfaces, None)
            own = sub_seed(simulator.seed, stage, number)
            yield simulator.frame(press, seed=own, surface=surface, following=following)
            surface = following or surface


def _by_halves(simulator: Simulator, tests: Sequence[Frame], steps: "_Steps") -> list[list[Frame]]:
    """Presses again, from either half of the light alone: with twice the variance of render noise."""
    halves: list[list[Frame]] = [[], []]
    for half, frames in enumerate(halves):
        for number, frame in enumerate(tests):
            assert frame.press is not None  # every test frame has one
            steps(f"render noise, {frame.press.probe.text}")
            own = sub_seed(simulator.seed, 5 + half, number)
            frames.append(simulator.frame(frame.press, seed=own, half=half, surface=frame.surface))
    return halves


def _noisier(
    protocol: EvaluationProtocol, calibration: KernelCalibration, frames: _Frames
) -> list[list[Reconstruction]]:
    """Test presses as either half of the light shows them, each beside its own untouched gel."""
    return [
        protocol.reconstruct(calibration.on(protocol.background(alone, alone)), halves, numbers=frames.halved)
        for alone, halves in zip(frames.untouched, frames.halves, strict=True)
    ]


def _find_truth(frames: Sequence[Frame]) -> None:
    """Find what frames show, which they keep."""
    for frame in frames:
        _ = frame.gradient, frame.contact


class _Steps:
    """Counts the steps of an evaluation for a progress display."""

    def __init__(self, progress: Progress, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def __call__(self, what: str) -> None:
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
