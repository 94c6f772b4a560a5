"""`gap diagnose`: from a measurement and a model to the effects the model lacks."""

import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from designlab.design import Design
from designlab.effects import CATALOGUE
from designlab.effects.model import AppliedEffect, SensorModel, effect
from designlab.gap.advise import advise
from designlab.gap.basis import Progress, Renders
from designlab.gap.fit import Fit, fit, numerical_shift
from designlab.gap.floor import floor, problem
from designlab.gap.judge import Judged, counted, judge
from designlab.gap.observe import limited, observe
from designlab.gap.pictures import draw
from designlab.gap.problem import Problem, State
from designlab.gap.result import Found, GapReport, Level, Value, Verdict
from designlab.gap.search import Search
from designlab.gap.where import where
from designlab.measurement import Measurement
from designlab.measurement.shots import Observations
from designlab.store import remove_partial, write_atomic, write_json

SAMPLES = 64
COLUMNS = 128
MOST_TRAINED = 5
UNEXPLAINED_ABOVE = 0.5  # leftover share of the gap from which nothing is named
PARTIAL_ABOVE = 0.1
INTERVAL_SD = 1.96


def diagnose(
    measurement: Measurement,
    model: SensorModel | Design,
    *,
    out: str | Path,
    seed: int,
    progress: Progress | None = None,
    resume: bool = True,
    catalogue: Sequence[str] | None = None,
    samples: int = SAMPLES,
    columns: int = COLUMNS,
) -> GapReport:
    """Find the effects that explain the difference between a measurement and a model.

    Every candidate is fitted on the training presses with gains and poses as nuisances, and judged on the
    select presses; the final presses give the last numbers and decide nothing.

    Parameters
    ----------
    measurement : Measurement
        A loaded measurement folder.
    model : SensorModel or Design
        The model to begin with; its effects stay as they are.
    out : path
        Folder for ``model.toml``, ``report.json``, pictures and the renders kept for resuming.
    seed : int
        Seed of rendering and bootstrap; the same seed gives the same report.
    progress : callable, optional
        Called with the stage, pictures done and pictures expected in it.
    resume : bool
        Whether pictures of an earlier, interrupted run are used.
    catalogue : sequence of str, optional
        Names of the effects to try; all known ones when absent.
    samples : int
        Samples per pixel and LED group.
    columns : int
        Wider frames are binned to at most this many columns.

    Raises
    ------
    MeasurementError
        If the measurement cannot be compared, or has too few frames.
    ValueError
        If an effect is unknown, or the light of a group does not fit at all.
    """
    begun = time.perf_counter()
    out = Path(out)
    known = [e.name for e in CATALOGUE]
    names = known if catalogue is None else [effect(name).name for name in catalogue]
    model = SensorModel.of(model)
    seen = observe(measurement, model.effective_design(), columns=columns)
    # What a calibration found to lie under every picture is no light.
    lift = model.on_signal(np.zeros((1, 1, 3)))[0, 0] + model.design.camera.black_level - seen.black_level
    shots = limited(seen.shots, MOST_TRAINED)
    if any(applied.name == "black_level" for applied in model.effects):
        shots = tuple(replace(shot, signal=shot.signal - lift) for shot in shots)
    seen = replace(seen, shots=shots)
    if not resume:
        shutil.rmtree(out / "renders", ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    remove_partial(out)
    renders = Renders(out / "renders", samples, seed, progress)
    train, select, final = seen.of("background", "train"), seen.of("select"), seen.of("final")
    renders.begin("noise", 2 * len(shots))
    compared, start = problem(renders, shots, State(model, np.ones(len(model.design.leds.groups)), {}))
    renders.begin("registering", 3 * len(train))
    registered = fit(compared, start, shots=train).state
    search = Search(compared, names, train, select, seed)
    best, before, after = search.run(registered)
    verdict = _verdict(search, best.state, before, after)
    if verdict in ("unexplained", "at_floor"):
        best, after = replace(best, state=registered, free=()), before
    renders.begin("final presses", 5 * len(final))
    ends = [judge(compared, state, final) for state in (registered, best.state)]
    presses = [n for n in train if shots[n].press is not None]
    judged = {n: shots[n].valid for n in presses} | {n: counted(compared, n) for n in (*select, *final)}
    floors = [
        floor(compared, best.state, part, [judged[n] for n in part], seed=seed).envelope
        for part in (presses, select, final)
    ]
    fitted = [_mean(compared, state, presses) for state in (registered, best.state)]
    gap = {
        "train": Level(fitted[0], fitted[1], floors[0]),
        "select": Level(before.mean, after.mean, floors[1]),
        "final": Level(ends[0].mean, ends[1].mean, floors[2]),
    }
    shift = numerical_shift(compared, best, shots=train)
    at_poses = replace(registered, poses={**registered.poses, **before.state.poses})
    updated = _updated(model, best, shift, measurement.name)
    report = GapReport(
        verdict=verdict,
        effects=tuple(
            Found(w.name, _values(best, w.name, shift), w.confidence, w.coherence_set)
            for w in search.winners
            if verdict != "unexplained"
        ),
        where=where(compared, at_poses, [*train, *select]) if verdict != "at_floor" else (),
        gap=gap,
        next_measurement=advise(compared, seen, search, verdict),
        updated=updated,
        model=out / "model.toml",
        candidates=tuple(search.tried),
        notes=_notes(seen, measurement, model),
        provenance=_provenance(seen, measurement, model, renders, begun),
        pictures=draw(compared, ends[0].state, ends[1].state, out),
    )
    write_atomic(report.model, updated.dumps())
    write_json(out / "report.json", report.to_json())
    return report


def _verdict(search: Search, state: State, before: Judged, after: Judged) -> Verdict:
    """Judge by the select presses alone."""
    envelope = search.floor(state).envelope
    if not search.winners:
        return "at_floor" if before.mean <= envelope else "unexplained"
    left = max(after.mean - envelope, 0.0) / max(before.mean - envelope, 1e-12)
    if left > UNEXPLAINED_ABOVE:
        return "unexplained"
    if any(len(winner.coherence_set) > 1 for winner in search.winners):
        return "ambiguous"
    return "partial" if left > PARTIAL_ABOVE else "named"


def _mean(compared: Problem, state: State, shots: Sequence[int]) -> float:
    squares = [compared.residual(state, n)[compared.shots[n].valid] ** 2 for n in shots]
    return float(np.mean([square.mean() for square in squares]))


def _values(best: Fit, name: str, shift: Mapping[tuple[str, str], float]) -> dict[str, Value]:
    """Values with 95 % intervals: statistical error, and the move that a finer simulation would cause."""
    values = best.values(name)
    deviation = {p: float(np.hypot(d, shift[name, p])) for p, d in best.deviation(name).items()}
    parameters = effect(name).parameters(best.state.model.design)
    return {
        p.name: Value(
            values[p.name],
            max(values[p.name] - INTERVAL_SD * deviation[p.name], p.low),
            min(values[p.name] + INTERVAL_SD * deviation[p.name], p.high),
            p.unit,
        )
        for p in parameters
    }


def _updated(
    model: SensorModel, best: Fit, shift: Mapping[tuple[str, str], float], found_in: str
) -> SensorModel:
    """Add the effects found to the model that was given."""
    for name in dict.fromkeys(free.effect for free in best.free):
        values = _values(best, name, shift)
        model = model.with_effect(
            AppliedEffect(
                name=name,
                values={p: v.value for p, v in values.items()},
                low={p: v.low for p, v in values.items()},
                high={p: v.high for p, v in values.items()},
                found_in=found_in,
            )
        )
    return model


def _notes(seen: Observations, measurement: Measurement, model: SensorModel) -> tuple[str, ...]:
    notes = list(seen.notes)
    stated = measurement.design()
    if stated is not None and stated.digest != model.design.digest:
        notes.append(
            f"the measurement names the sensor {measurement.sensor!r}, which is not the design of the model"
        )
    return tuple(notes)


def _provenance(
    seen: Observations, measurement: Measurement, model: SensorModel, renders: Renders, begun: float
) -> dict[str, object]:
    from designlab import __version__

    return {
        "measurement": measurement.name,
        "model": model.digest,
        "seed": renders.seed,
        "samples": renders.samples,
        "noise": seen.noise_source,
        "frames": {
            use: [file for shot in seen.shots if shot.use == use for file in shot.files]
            for use in ("background", "train", "select", "final")
        },
        "rendered": renders.rendered,
        "seconds": round(time.perf_counter() - begun, 1),
        "version": __version__,
    }
