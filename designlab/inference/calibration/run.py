"""`calibrate` fits the design of a sensor to its pictures."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from designlab.core import metrics
from designlab.core.progress import Work, of_thousand, silent
from designlab.core.types import Array, Mask, Progress
from designlab.inference.calibration.directional import Directional
from designlab.inference.calibration.fields import WITHIN, SharedField, shared_fields
from designlab.inference.calibration.imaging import ALBEDO, MODULUS, SCALE, Rendered
from designlab.inference.calibration.poses import posed
from designlab.inference.calibration.problem import CalibrationState, Imaging, Problem
from designlab.inference.calibration.result import Calibration, FittedParameter, FrameResult
from designlab.inference.calibration.solve import FINE_GAIN, MOST_STEPS, ROUGH_GAIN, Layout, covariance, fit
from designlab.measurement import Measurement, MeasurementError, Suspicion, check, refuse
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.quality.model_check import against_model
from designlab.measurement.shots import POSE, ROUND, Observations, Shot, observe, within
from designlab.measurement.transfer import MODEL_ERROR
from designlab.sensor.design import CHANNELS, Design
from designlab.simulation.directional_light import DirectionalLight
from designlab.simulation.effects.model import SensorModel, effect
from designlab.simulation.optics.viewing_rays import rays
from designlab.simulation.simulator import RenderFailed

SCALES = (0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1)  # of the tangent of half the field of view
COARSE_STEPS, PROBE_STEPS, CORRECTED_STEPS = 8, 8, 2
MOST_WEIGHINGS = 4
SETTLED = 0.05  # change of standard deviations below which they stay; they are known to a few per cent
ENTANGLED = 0.95  # correlation of errors that is worth a note
DARKEST, BRIGHTEST = 0.02, 0.98  # reflectance to start from
LEAST_COLUMNS = 64  # of a picture that a first, coarse fit is worth making on

Number = tuple[str, str, float]
"""Name, unit and value."""


def calibrate(
    measurement: Measurement,
    model: Design | SensorModel | DirectionalLight,
    *,
    columns: int = 160,
    samples: int = 48,
    seed: int = 0,
    free: Sequence[str] | None = None,
    mask: Mask | None = None,
    trust: Sequence[str] = (),
    drawn: Design | None = None,
    progress: Progress = silent,
) -> Calibration:
    """Fit the light, some fields of the design and the pose of every press to the pictures of one sensor.

    Light is linear: `transfer`, from each LED group to each channel, and a floor follow in closed form from
    unit-power pictures. The rest takes damped Gauss-Newton steps, on coarse pictures first; where
    ``camera.horizontal_fov_deg`` is free, the best of several scales of the picture is the start. Fitted are
    backgrounds, light probes and training presses; of the other presses the pose alone. Every value has its
    noise and 1 % of its channel's mean signal in the picture as standard deviation (of a light probe, of the
    bright end), more where the model leaves more, every pose the measurement's prior. The last steps are
    taken with pictures corrected by exact ones, see `problem.Problem.correct`.

    Parameters
    ----------
    measurement : Measurement
        A loaded measurement folder; one press is enough.
    model : Design, SensorModel or DirectionalLight
        The sensor to start from, without effects.
    columns : int
        Wider frames are binned to at most this many columns.
    samples : int
        Samples per pixel and LED group.
    seed : int
        Seed of the light transport; the same seed gives the same result.
    free : sequence of str, optional
        Dotted paths of the design's numbers to fit, or of the probe's such as ``probe.size_mm``, with what is
        known of them beside the pictures, see `fields.shared_fields`. When absent: length of kernel or skin,
        field of view, the modulus where a press tells its force, and the reflectance for each LED group where
        a light probe tells it from their light; of directional light, direction of every light, exponent.
    mask : bool array, shape (rows, columns) of the files, optional
        Pixels that are fitted to, all when absent; figures are of the whole pictures.
    trust : sequence of str
        Names of suspicions, see `measurement.quality.suspicion`, that are known and right as they are.
    drawn : Design, optional
        The design that figures before the fit are of, where `model` is one that a search has found.
    progress : callable, optional
        Called with what is being done, and how much of everything is done in thousandths.

    Raises
    ------
    MeasurementError
        If the measurement cannot be compared, is suspicious, or no frame is there to be fitted.
    ValueError
        If the model has effects, or a field cannot be calibrated.
    """
    for name, value, least in (("columns", columns, 8), ("samples", samples, 1)):
        if value < least:
            raise ValueError(f"{name}: must be at least {least}, got {value}")
    imaging = _imaging(model, samples)
    design, renders = imaging.design, isinstance(imaging, Rendered)
    read = posed(measurement, design, seed=seed, progress=of_thousand(progress))
    measurement = read.measurement
    trusted = (*refuse(measurement, check(measurement, design), trust), *read.notes)
    seen = observe(measurement, design, columns=columns, light_probes=renders)
    fitted = seen.of("background", "light_probe", "train")
    usual = imaging.usual([seen.shots[number] for number in fitted])
    probes = [press.probe for press in seen.presses]
    fields = shared_fields(imaging.model, usual if free is None else free, probes)
    _check_modulus(fields, [seen.shots[number] for number in fitted])
    coarsely = columns // 2 >= LEAST_COLUMNS
    work = Work(progress, _costs(seen, fields, coarsely))
    imaging = replace(imaging, work=work)
    problem = Problem(imaging, within(mask, seen.shots), fields, seed=seed)
    _check(measurement, problem, fitted)
    work.begin("model as given")
    first = problem
    if drawn is not None:
        first = Problem(replace(_imaging(drawn, samples), work=work), problem.shots, (), seed=seed)
    given = _given(measurement, first, imaging.level() - seen.black_level)
    if renders:  # a model without light transport misses pictures for reasons of its own
        trusted += refuse(measurement, _faults(measurement, problem, seen), trust)
    balls = seen.of("light_probe")
    work.begin("light probe")
    state = _reflecting(problem, _placed(problem, problem.start(), balls), fitted)
    problem.hold(balls)
    work.begin("trying scales")
    if coarsely:
        shots = observe(measurement, design, columns=columns // 2, light_probes=renders).shots
        coarse = Problem(imaging, within(mask, shots), fields, seed=seed)
        coarse.hold(balls)
        state = _scaled(coarse, state, fitted)
        work.begin("fitting coarsely")
        state, _ = _weighed(coarse, state, fitted, steps=COARSE_STEPS)
    else:
        state = _scaled(problem, state, fitted)
    work.begin("fitting")
    state, bases = _weighed(problem, state, fitted, steps=MOST_STEPS)
    work.begin("correcting")
    problem.correct(state, fitted)
    problem.weigh(state, problem.bases(state, fitted))
    state, bases = fit(problem, state, fitted, steps=CORRECTED_STEPS, least_gain=FINE_GAIN)
    work.begin("errors")
    layout = Layout(problem, fitted, held_out=False)
    products, gradients = _products(problem, layout, state)
    spread, simulated = covariance(problem, layout, state, bases, gradients)
    work.begin("held-out presses")
    state, bases = _registered(problem, state, fitted, seen.of("select", "final"))
    errors = np.sqrt(np.diag(spread + simulated))
    parameters = _fitted(_unknowns(problem, layout, state), errors[: layout.size])
    deviation = np.sqrt(np.diag(spread))
    correlation = (spread / np.outer(deviation, deviation))[: layout.size, : layout.size]
    level = state.floor + seen.black_level
    work.end()
    return Calibration(
        model=imaging.finished(problem.changes(state.shared), state.transfer, level, measurement.name),
        parameters=parameters,
        correlation=correlation,
        products=_fitted(products, errors[layout.size :]),
        frames=tuple(
            _frame_result(problem, state, n, shot.valid, given[n], bases[n])
            for n, shot in enumerate(seen.shots)
        ),
        transfer=state.transfer,
        floor=state.floor,
        stuck=state.stuck,
        notes=(*trusted, *_notes(problem, seen, state, fitted, bases), *_entangled(parameters, correlation)),
        provenance={
            "measurement": measurement.name,
            "model_digest": model.digest,
            "imaging": imaging.kind,
            "seed": seed,
            "samples": samples,
            "columns": columns,
            "free": [field.path for field in fields],
            "noise": seen.noise_source,
        },
    )


def _weighed(
    problem: Problem, state: CalibrationState, fitted: Sequence[int], *, steps: int
) -> tuple[CalibrationState, dict[int, Array]]:
    """Weigh values by what is left of them and fit, until the weights stay.

    The weights come first: a model that explains a picture badly would otherwise be trusted more than what is
    known of the poses, and a fit would end where only a wrong pose helps it.
    """
    bases = problem.bases(state, fitted)
    state = problem.lit_best(state, bases)
    for _ in range(MOST_WEIGHINGS):
        if problem.weigh(state, bases) < SETTLED:
            break
        state, bases = fit(problem, state, fitted, steps=steps)
    return state, bases


def _registered(
    problem: Problem, state: CalibrationState, fitted: Sequence[int], held_out: Sequence[int]
) -> tuple[CalibrationState, dict[int, Array]]:
    """Find the poses of held-out presses, with all else as it was fitted; and pictures as usual of all."""
    fixed, settled = problem.settled(state.shared), replace(state, shared=np.zeros(0))
    bases = fixed.bases(settled, fitted)
    for number in held_out:
        found, own = fit(fixed, settled, [number], held_out=True, least_gain=ROUGH_GAIN)
        state, bases = replace(state, poses={**state.poses, **found.poses}), bases | own
    return state, bases


def _costs(seen: Observations, fields: Sequence[SharedField], coarsely: bool) -> dict[str, float]:
    """About how many pictures each part of a calibration takes; the untouched gel is one in all frames."""
    uses = ("light_probe", "train"), ("light_probe",), ("select", "final")
    fitted, balls, held_out = (len(seen.of(*use)) for use in uses)
    fitted += 1
    of_step = fitted * (1 + len(fields) + len(POSE))
    return {
        "model as given": fitted + held_out,
        "light probe": 2 * PROBE_STEPS * balls,
        "trying scales": fitted * len(SCALES) * any(f.path.removeprefix(WITHIN) == SCALE for f in fields),
        "fitting coarsely": 2.5 * of_step * coarsely,
        "fitting": 1.5 * of_step,
        "correcting": 8 * fitted + of_step,
        "errors": fitted,
        "held-out presses": 8 * held_out,
    }


def _imaging(model: Design | SensorModel | DirectionalLight, samples: int) -> Imaging:
    if isinstance(model, DirectionalLight):
        return Directional(model)
    sensor = SensorModel.of(model)
    named = [applied.name for applied in sensor.effects if not effect(applied.name).constant]
    if named:
        raise ValueError(
            "model: must be a design without effects, since they are named after calibration; "
            f"has {', '.join(named)}"
        )
    # A reflectance for each group, since a light probe tells them apart.
    albedo = list(sensor.design.per_group("membrane_albedo"))
    beyond = sensor.on_signal(np.zeros((1, 1, 3)))[0, 0]
    return Rendered(
        sensor.design.replace({"optics.membrane_albedo": albedo}), samples, beyond=np.asarray(beyond)
    )


def _check_modulus(fields: Sequence[SharedField], shots: Sequence[Shot]) -> None:
    """Modulus changes forces and no shape at a depth: something has to tell a force."""
    forced = any(shot.press and (shot.press.force_n or math.isfinite(shot.force_sigma_n)) for shot in shots)
    for field in fields:
        if field.path.endswith(MODULUS) and not forced:
            raise ValueError(
                f"free: {field.path} needs a fitted press with force_n, since no shape depends on it"
            )


def _check(measurement: Measurement, problem: Problem, fitted: Sequence[int]) -> None:
    if not fitted:
        raise MeasurementError(
            f"{measurement.folder}: field frame: a background or a press of the split 'train' is needed"
        )
    for shot in problem.shots:
        if min(shot.signal.shape[:2]) < 8:
            raise MeasurementError(
                f"{measurement.folder}: frame {shot.files[0]}: must be at least 8 x 8 px when binned, "
                f"is {shot.signal.shape[1]} x {shot.signal.shape[0]} px"
            )


def _given(measurement: Measurement, problem: Problem, floor: Array) -> dict[int, Array]:
    """Signals of the model as given, at the stated poses."""
    bases = {}
    for number, shot in enumerate(problem.shots):
        try:
            bases[number] = problem.basis(problem.start(), number)
        except (ValueError, RenderFailed) as error:
            of_press = shot.press is not None and type(error) is ValueError
            if shot.ball is None and not of_press:
                raise
            raise MeasurementError(f"{measurement.folder}: frame {shot.files[0]}: {error}") from None
    state = replace(problem.start(), transfer=problem.imaging.factors(), floor=floor)
    return {number: problem.predict(state, number, basis) for number, basis in bases.items()}


def _faults(measurement: Measurement, problem: Problem, seen: Observations) -> tuple[Suspicion, ...]:
    """Faults of the pictures, beside those of the model as given at the stated poses."""
    bases = problem.bases(problem.start(), seen.of("background", "train", "select", "final"))
    return against_model(
        [seen.shots[number] for number in bases],
        list(bases.values()),
        black=seen.black_level,
        transfer=problem.imaging.design.transfer_mw,
        response=measurement.response,
    ).suspicions


def _placed(problem: Problem, state: CalibrationState, balls: Sequence[int]) -> CalibrationState:
    """Find the places of light probes, with their light alone.

    They are held afterwards: they matter little to all else, and pictures with sharp edges change by jumps.
    """
    from skimage.registration import phase_cross_correlation

    for number in balls:
        # Narrow images of LEDs leave a fit little to hold on to: first move by what the picture is shifted.
        shot = problem.shots[number]
        measured, simulated = shot.signal.sum(axis=-1), problem.basis(state, number).sum(axis=0)
        shift, _, _ = phase_cross_correlation(
            measured / measured.sum(), simulated / simulated.sum(), upsample_factor=10, normalization=None
        )
        x_mm, y_mm = rays(problem.imaging.design, shot.view).pitch_mm
        moved = state.pose(number) + np.array([shift[1] * x_mm, -shift[0] * y_mm, 0.0, 0.0])
        tried = replace(state, poses={**state.poses, number: moved})
        state = min((tried, state), key=lambda candidate: _misfit(problem, candidate, [number]))
        found, _ = fit(problem, state, [number], steps=PROBE_STEPS)
        state = replace(state, poses={**state.poses, **found.poses})
    return state


def _reflecting(problem: Problem, state: CalibrationState, fitted: Sequence[int]) -> CalibrationState:
    """Start the reflectances, where free, from the light that a light probe and that the gel tells of.

    The two stages of the paper: light from the ball, then the reflectance from the gel.
    """
    balls = [number for number in fitted if problem.shots[number].ball is not None]
    others = [number for number in fitted if number not in balls]
    free = [n for n, field in enumerate(problem.fields) if field.path.startswith(ALBEDO)]
    if not (free and balls and others):
        return state
    direct, reflected = (
        problem.lit_best(state, problem.bases(state, part)).transfer.sum(axis=0) for part in (balls, others)
    )
    shared = state.shared.copy()
    for place in free:
        group = problem.imaging.alone(problem.fields[place].path)
        if group is not None and direct[group] > 0:
            most = min(BRIGHTEST, problem.fields[place].high)
            shared[place] = np.clip(shared[place] * reflected[group] / direct[group], DARKEST, most)
    return replace(state, shared=shared)


def _scaled(problem: Problem, state: CalibrationState, fitted: Sequence[int]) -> CalibrationState:
    """Start from the scale of the picture that fits best, where the field of view is free."""
    paths = [field.path.removeprefix(WITHIN) for field in problem.fields]
    if SCALE not in paths:
        return state
    place = paths.index(SCALE)
    field, pinhole = problem.fields[place], problem.imaging.design.camera.lens == "pinhole"
    found = []
    for scale in SCALES:
        shared = state.shared.copy()
        if scale != 1.0:
            half = math.radians(shared[place] / 2)
            turned = math.atan(scale * math.tan(half)) if pinhole else scale * half
            shared[place] = 2 * math.degrees(turned)
        if field.low <= shared[place] <= field.high:
            found.append(replace(state, shared=shared))
    return min(found, key=lambda tried: _misfit(problem, tried, fitted))


def _misfit(problem: Problem, state: CalibrationState, fitted: Sequence[int]) -> float:
    bases = problem.bases(state, fitted)
    return problem.objective(problem.lit_best(state, bases), bases)


def _fitted(numbers: Sequence[Number], errors: Array) -> tuple[FittedParameter, ...]:
    return tuple(
        FittedParameter(name, unit, value, float(se) if math.isfinite(se) else None)
        for (name, unit, value), se in zip(numbers, errors, strict=True)
    )


def _unknowns(problem: Problem, layout: Layout, state: CalibrationState) -> list[Number]:
    """Name every unknown, in the order of the layout."""
    named: list[Number] = [
        (field.path, field.unit, float(value))
        for field, value in zip(problem.fields, state.shared, strict=True)
    ]
    for number, free in layout.pose.items():
        for _, part in free:
            name, pose = POSE[part], _pose(problem, state, number)
            named.append((f"{problem.shots[number].files[0]}.{name}", name.rpartition("_")[2], pose[name]))
    for channel, letter in enumerate(CHANNELS):
        for group, name in enumerate(problem.imaging.names):
            named.append(
                (f"transfer.{letter}.{name}", problem.imaging.unit, float(state.transfer[channel, group]))
            )
        named.append((f"floor.{letter}", "1", float(state.floor[channel])))
    return named


def _products(problem: Problem, layout: Layout, state: CalibrationState) -> tuple[list[Number], Array]:
    """Transfer times reflectance: names, units and values, and gradients by all unknowns."""
    model = problem.imaging.model
    if not isinstance(model, Design):
        return [], np.zeros((0, layout.size))
    albedo = np.array(model.replace(problem.changes(state.shared)).per_group("membrane_albedo"))
    places = {f.path: n for n, f in enumerate(problem.fields)}
    named, gradients = [], []
    for channel, letter in enumerate(CHANNELS):
        for group, name in enumerate(model.group_names):
            gradient = np.zeros(layout.size)
            gradient[layout.light(channel, group)] = albedo[group]
            if (place := places.get(f"{ALBEDO}.{group}")) is not None:
                gradient[place] = state.transfer[channel, group]
            gradients.append(gradient)
            value = float(state.transfer[channel, group] * albedo[group])
            named.append((f"product.{letter}.{name}", "mm2 sr", value))
    return named, np.array(gradients)


def _pose(problem: Problem, state: CalibrationState, number: int) -> dict[str, float]:
    touched = problem.touched(state, number)
    if isinstance(touched, LightProbe):
        return dict(zip(POSE, (*touched.centre_mm, touched.lowest_mm, 0.0), strict=True))
    assert touched is not None
    depth_mm = problem.depth_mm(state, number)
    return dict(zip(POSE, (*touched.centre_mm, depth_mm, touched.yaw_deg), strict=True))


def _frame_result(
    problem: Problem, state: CalibrationState, number: int, valid: Mask, given: Array, basis: Array
) -> FrameResult:
    shot = problem.shots[number]
    simulated = problem.predict(state, number, basis)
    measured = shot.signal

    def figures(picture: Array) -> dict[str, object]:
        return metrics.compare(np.where(valid, picture, measured), measured)

    pose = None if shot.press is None and shot.ball is None else _pose(problem, state, number)
    before, after = figures(given), figures(simulated)
    return FrameResult(shot.files[0], shot.use, before, after, pose, measured, given, simulated)


def _notes(
    problem: Problem,
    seen: Observations,
    state: CalibrationState,
    fitted: Sequence[int],
    bases: dict[int, Array],
) -> tuple[str, ...]:
    notes = [_known_apart(problem)]
    chi = sum(float((problem.residual(state, n, bases[n], weighed=False) ** 2).sum()) for n in fitted)
    chi /= sum(int(problem.shots[n].valid.sum()) for n in fitted)
    notes.append(
        f"squared residual over noise and {MODEL_ERROR:.0%} model error: {chi:.3g}; standard errors are from "
        "the residuals themselves"
    )
    if not any(problem.shots[n].press is None for n in fitted):
        notes.append("no background: smooth light is told from the press by the simulation alone")
    if any(shot.press and shot.press.probe.kind in ROUND for shot in problem.shots):
        notes.append("the yaw of a round probe cannot be seen and is not fitted")
    for number, shot in enumerate(problem.shots):
        if not seen.shots[number].valid.all():
            notes.append(f"{shot.files[0]}: saturated values count as right in its figures")
        if shot.clip_sigma.any():
            notes.append(f"{shot.files[0]}: dark values are cut at zero, which lifts the floor")
        far = np.abs(state.pose(number)) > 3 * shot.pose_sigma
        for name in np.array(POSE)[far & (shot.pose_sigma > 0)]:
            notes.append(f"{shot.files[0]}: {name} departs from the stated pose by more than 3 sigma")
    dark = [n for g, n in enumerate(problem.imaging.names) if not state.transfer[:, g].any()]
    if dark:
        kept = "; the flux stays and its mixing is zero" if isinstance(problem.imaging, Rendered) else ""
        notes.append(f"no light of {', '.join(dark)} was found{kept}")
    for field, value in zip(problem.fields, state.shared, strict=True):
        if not field.low < value < field.high:
            notes.append(f"{field.path} stands at its bound, {value:g} {field.unit}")
    return (*dict.fromkeys(seen.notes), *notes)


def _known_apart(problem: Problem) -> str:
    if not isinstance(problem.imaging, Rendered):
        return (
            "directional light knows no unit: factors are signals, each a product of light, reflectance, "
            "exposure"
        )
    apart = any(shot.ball is not None for shot in problem.shots)
    apart &= any(field.path.startswith(ALBEDO) for field in problem.fields)
    return (
        "flux x exposure is a product; the light probe, whose reflectance is taken as known, tells it from "
        "the reflectance of the membrane"
        if apart
        else "flux x reflectance x exposure is a product: that alone is known without a light probe; the "
        "design keeps its exposure where it has one, and its reflectance unless that was free"
    )


def _entangled(parameters: Sequence[FittedParameter], correlation: Array) -> list[str]:
    """Say which errors go together, so that one value is only as right as the other."""
    untold = [p.name for p in parameters if p.se is None and p.value != 0.0]
    notes = [f"{', '.join(untold)}: other values explain the pictures as well"] if untold else []
    pairs = zip(*np.nonzero(np.triu(np.abs(correlation) > ENTANGLED, 1)), strict=True)
    return notes + [
        f"{parameters[a].name} and {parameters[b].name} are hardly told apart "
        f"(their errors correlate {correlation[a, b]:+.2f})"
        for a, b in pairs
    ]
