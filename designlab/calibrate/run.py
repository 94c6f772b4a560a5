"""`calibrate`: from a measurement and a model to the sensor that its pictures show."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from designlab import metrics
from designlab.calibrate.fields import SharedField, shared_fields
from designlab.calibrate.problem import MODEL_ERROR, Problem, Progress, State
from designlab.calibrate.result import Calibration, FrameResult, Parameter
from designlab.calibrate.solve import MOST_STEPS, Layout, covariance, fit
from designlab.calibrate.suspicions import suspicious
from designlab.design import CHANNELS, Design
from designlab.effects.model import SensorModel
from designlab.measurement import Measurement, MeasurementError, check, refuse
from designlab.measurement.shots import POSE, ROUND, Observations, observe
from designlab.simulate import automatic_exposure

Array = NDArray[np.float64]

FREE = ("contact.kernel_length_mm", "camera.horizontal_fov_deg")
SCALED = "camera.horizontal_fov_deg"
SCALES = (0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1)  # of the tangent of half the field of view
COARSE_STEPS = 8
ENTANGLED = 0.95  # correlation of errors that is worth a note
LEAST_COLUMNS = 32  # of a picture that a first, coarse fit is worth making on


def calibrate(
    measurement: Measurement,
    model: Design | SensorModel,
    *,
    columns: int = 160,
    samples: int = 48,
    seed: int = 0,
    free: Sequence[str] = FREE,
    trust: Sequence[str] = (),
    progress: Progress | None = None,
) -> Calibration:
    """Fit the light, some fields of the design and the pose of every press to the pictures of one sensor.

    Light is linear: `transfer`, from each LED group to each channel, and a floor follow in closed form from
    unit-power pictures. The rest takes damped Gauss-Newton steps, on coarse pictures first; where
    ``camera.horizontal_fov_deg`` is free, the best of several scales of the picture is the start. Fitted are
    backgrounds and training presses; of the other presses the pose alone. Every value has its noise and 1 %
    of its channel's mean signal in the picture as standard deviation, every pose the measurement's prior.

    Parameters
    ----------
    measurement : Measurement
        A loaded measurement folder; one press is enough.
    model : Design or SensorModel
        The sensor to start from, without effects.
    columns : int
        Wider frames are binned to at most this many columns.
    samples : int
        Samples per pixel and LED group.
    seed : int
        Seed of the light transport; the same seed gives the same result.
    free : sequence of str
        Dotted paths of the design's numbers to fit.
    trust : sequence of str
        Names of suspicions, see `designlab.measurement.suspicion`, that are known and right as they are.
    progress : callable, optional
        Called with the stage, pictures done and pictures expected in it.

    Raises
    ------
    MeasurementError
        If the measurement cannot be compared, is suspicious, or no frame is there to be fitted.
    ValueError
        If the model has effects, or a field cannot be calibrated.
    """
    sensor = SensorModel.of(model)
    if sensor.effects:
        raise ValueError(
            "model: must be a design without effects, since they are named after calibration; "
            f"has {', '.join(applied.name for applied in sensor.effects)}"
        )
    for name, value, least in (("columns", columns, 8), ("samples", samples, 1)):
        if value < least:
            raise ValueError(f"{name}: must be at least {least}, got {value}")
    design, fields = sensor.design, shared_fields(sensor.design, free)
    trusted = refuse(measurement, check(measurement, design), trust)
    seen = observe(measurement, design, columns=columns)
    problem = Problem(design, seen.shots, fields, samples=samples, seed=seed, progress=progress)
    fitted = seen.of("background", "train")
    _check(measurement, problem, fitted)
    given = _given(problem)
    trusted += suspicious(measurement, seen, problem, trust=trust)
    state = problem.start()
    if columns // 2 >= LEAST_COLUMNS:
        coarse = observe(measurement, design, columns=columns // 2)
        state = _coarse(
            Problem(design, coarse.shots, fields, samples=samples, seed=seed, progress=progress), fitted
        )
    moves = len(fields) + 5
    problem.begin("fitting", len(fitted) * (1 + 4 * moves))
    state, bases = fit(problem, state, fitted)
    problem.begin("errors", len(fitted) * (1 + moves))
    layout = Layout(problem, fitted, held_out=False)
    spread, random = covariance(problem, layout, state, bases)
    held_out = seen.of("select", "final")
    problem.begin("held-out presses", len(held_out) * 20)
    for number in held_out:
        found, own = fit(problem, state, [number], held_out=True)
        state, bases = replace(state, poses={**state.poses, **found.poses}), bases | own
    parameters = _parameters(problem, layout, state, np.sqrt(np.diag(spread) + random))
    frames = tuple(
        _frame_result(problem, state, number, given[number], bases[number])
        for number in range(len(seen.shots))
    )
    deviation = np.sqrt(np.diag(spread))
    correlation = spread / np.outer(deviation, deviation)
    notes = (*trusted, *_notes(problem, seen, state, fitted, bases), *_entangled(parameters, correlation))
    return Calibration(
        design=_calibrated(problem, state),
        parameters=parameters,
        correlation=correlation,
        frames=frames,
        transfer=state.transfer,
        floor=state.floor,
        notes=notes,
        provenance={
            "measurement": measurement.name,
            "model_digest": sensor.digest,
            "seed": seed,
            "samples": samples,
            "columns": columns,
            "free": list(free),
            "noise": seen.noise_source,
        },
    )


def _check(measurement: Measurement, problem: Problem, fitted: Sequence[int]) -> None:
    if not fitted:
        raise MeasurementError(
            f"{measurement.folder}: field frame: a background or a press of the split 'train' is needed"
        )
    camera = problem.design.camera
    for shot in problem.shots:
        view = shot.view
        if view.x_px + view.width_px > camera.width_px or view.y_px + view.height_px > camera.height_px:
            raise MeasurementError(
                f"{measurement.folder}: frame {shot.files[0]}: field crop_px: must lie on the model's sensor "
                f"of {camera.width_px} x {camera.height_px} px"
            )
        if min(shot.signal.shape[:2]) < 8:
            raise MeasurementError(
                f"{measurement.folder}: frame {shot.files[0]}: must be at least 8 x 8 px when binned, "
                f"is {shot.signal.shape[1]} x {shot.signal.shape[0]} px"
            )


def _given(problem: Problem) -> dict[int, Array]:
    """Signals of the model as given, at the stated poses."""
    design, state = problem.design, problem.start()
    problem.begin("model as given", len(problem.shots))
    flux = np.array([group.flux_mw for group in design.leds.groups])
    transfer = design.mixing_matrix * flux
    bases = problem.bases(state, range(len(problem.shots)))
    exposure = design.camera.exposure
    if exposure is None:
        untouched = problem.untouched()
        exposure = automatic_exposure(np.moveaxis(np.tensordot(transfer, untouched, axes=1), 0, -1))
    state = replace(state, transfer=transfer * exposure)
    return {number: problem.predict(state, number, basis) for number, basis in bases.items()}


def _coarse(problem: Problem, fitted: Sequence[int]) -> State:
    """Fit coarse pictures, from the best scale of the picture where that is free."""
    state = problem.start()
    paths = [field.path for field in problem.fields]
    if SCALED in paths:
        problem.begin("trying scales", len(SCALES) * len(fitted))
        state = min(
            _scaled(problem, state, paths.index(SCALED)),
            key=lambda tried: _misfit(problem, tried, fitted),
        )
    problem.begin("fitting coarsely", len(fitted) * (1 + COARSE_STEPS * (len(paths) + 5)))
    return fit(problem, state, fitted, steps=min(COARSE_STEPS, MOST_STEPS))[0]


def _scaled(problem: Problem, state: State, place: int) -> list[State]:
    """States with other fields of view, within its bounds."""
    field = problem.fields[place]
    found = []
    for scale in SCALES:
        shared = state.shared.copy()
        if scale != 1.0:
            half = math.radians(shared[place] / 2)
            tangent = math.tan(half) if problem.design.camera.lens == "pinhole" else half
            turned = math.atan(scale * tangent) if problem.design.camera.lens == "pinhole" else scale * half
            shared[place] = 2 * math.degrees(turned)
        if field.low <= shared[place] <= field.high:
            found.append(replace(state, shared=shared))
    return found


def _misfit(problem: Problem, state: State, fitted: Sequence[int]) -> float:
    bases = problem.bases(state, fitted)
    return problem.objective(problem.lit_best(state, bases), bases)


def _calibrated(problem: Problem, state: State) -> Design:
    """Put the product into fields: exposure stays as given, else total flux; columns of mixing reach 1."""
    design = problem.design_at(state.shared)
    largest = state.transfer.max(axis=0)
    flux = np.array([group.flux_mw for group in design.leds.groups])
    shown = largest > 0
    exposure = design.camera.exposure or float(largest.sum() / flux[shown].sum()) if shown.any() else 1.0
    changes: dict[str, object] = {
        f"leds.groups.{g}.flux_mw": float(largest[g] / exposure) for g in np.flatnonzero(shown)
    }
    mixing = state.transfer / np.where(shown, largest, 1.0)
    return design.replace(
        {**changes, "mixing": [[float(v) for v in row] for row in mixing], "camera.exposure": exposure}
    )


def _parameters(problem: Problem, layout: Layout, state: State, deviation: Array) -> tuple[Parameter, ...]:
    """Name every unknown, in the order of the layout."""
    named: list[tuple[str, str, float]] = [
        (field.path, field.unit, float(value))
        for field, value in zip(problem.fields, state.shared, strict=True)
    ]
    for number, free in layout.pose.items():
        for _, part in free:
            name, pose = POSE[part], _pose(problem, state, number)
            named.append((f"{problem.shots[number].files[0]}.{name}", name.rpartition("_")[2], pose[name]))
    for channel, letter in enumerate(CHANNELS):
        for group, name in enumerate(problem.design.group_names):
            named.append((f"transfer.{letter}.{name}", "mm2 sr", float(state.transfer[channel, group])))
        named.append((f"floor.{letter}", "1", float(state.floor[channel])))
    return tuple(
        Parameter(name, unit, value, float(se) if math.isfinite(se) else None)
        for (name, unit, value), se in zip(named, deviation, strict=True)
    )


def _pose(problem: Problem, state: State, number: int) -> dict[str, float]:
    press = problem.press(state, number)
    assert press is not None
    return dict(zip(POSE, (*press.centre_mm, press.depth_mm, press.yaw_deg), strict=True))


def _frame_result(problem: Problem, state: State, number: int, given: Array, basis: Array) -> FrameResult:
    shot = problem.shots[number]
    simulated = problem.predict(state, number, basis)
    measured = shot.signal

    def figures(picture: Array) -> dict[str, object]:
        return metrics.compare(np.where(shot.valid, picture, measured), measured)

    pose = None if shot.press is None else _pose(problem, state, number)
    before, after = figures(given), figures(simulated)
    return FrameResult(shot.files[0], shot.use, before, after, pose, measured, given, simulated)


def _notes(
    problem: Problem, seen: Observations, state: State, fitted: Sequence[int], bases: dict[int, Array]
) -> tuple[str, ...]:
    notes = [
        "flux x reflectance x exposure is a product: transfer is what is known; the design keeps its "
        "exposure where it has one, and its reflectance unless that was free",
        "the floor (a constant for each channel) is no part of the design, whose camera has one black level "
        f"for all: R, G, B {', '.join(f'{value:.4g}' for value in state.floor)} of full scale above it",
    ]
    chi = sum(float((problem.residual(state, n, bases[n]) ** 2).sum()) for n in fitted)
    chi /= sum(int(problem.shots[n].valid.sum()) for n in fitted)
    notes.append(
        f"squared residual over noise and {MODEL_ERROR:.0%} model error: {chi:.3g}; standard errors are from "
        "the residuals themselves, priors of poses count as if it were 1"
    )
    if not any(problem.shots[n].press is None for n in fitted):
        notes.append("no background: smooth light is told from the press by the simulation alone")
    if any(shot.press and shot.press.probe.kind in ROUND for shot in problem.shots):
        notes.append("the yaw of a round probe cannot be seen and is not fitted")
    for number, shot in enumerate(problem.shots):
        if not shot.valid.all():
            notes.append(f"{shot.files[0]}: saturated values count as right in its figures")
        if shot.clip_sigma.any():
            notes.append(f"{shot.files[0]}: dark values are cut at zero, which lifts the floor")
        far = np.abs(state.pose(number)) > 3 * shot.pose_sigma
        for name in np.array(POSE)[far & (shot.pose_sigma > 0)]:
            notes.append(f"{shot.files[0]}: {name} departs from the stated pose by more than 3 sigma")
    dark = [n for g, n in enumerate(problem.design.group_names) if not state.transfer[:, g].any()]
    if dark:
        notes.append(f"no light of {', '.join(dark)} was found; the flux stays and its mixing is zero")
    for field, value in zip(problem.fields, state.shared, strict=True):
        if _at_bound(field, float(value)):
            notes.append(f"{field.path} stands at its bound, {value:g} {field.unit}")
    return (*dict.fromkeys(seen.notes), *notes)


def _entangled(parameters: Sequence[Parameter], correlation: Array) -> list[str]:
    """Say which errors go together, so that one value is only as right as the other."""
    pairs = zip(*np.nonzero(np.triu(np.abs(correlation) > ENTANGLED, 1)), strict=True)
    return [
        f"{parameters[a].name} and {parameters[b].name} are hardly told apart "
        f"(their errors correlate {correlation[a, b]:+.2f})"
        for a, b in pairs
    ]


def _at_bound(field: SharedField, value: float) -> bool:
    return value <= field.low or value >= field.high
