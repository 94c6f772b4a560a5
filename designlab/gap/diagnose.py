"""`gap diagnose`: from a measurement and a model to the effects the model lacks."""

import shutil
import time
from collections.abc import Sequence
from pathlib import Path

from designlab.design import Design
from designlab.effects import CATALOGUE, AppliedEffect, SensorModel, effect
from designlab.gap.advise import advise
from designlab.gap.bank import fill
from designlab.gap.basis import Progress, Renders
from designlab.gap.blocks import is_single
from designlab.gap.fit import Fit, Fitter
from designlab.gap.forward import coordinate, value_at
from designlab.gap.judge import Judged, judge
from designlab.gap.observe import observe
from designlab.gap.pictures import draw
from designlab.gap.result import Found, GapReport, Level, Value, Verdict
from designlab.gap.search import Search
from designlab.gap.single import diagnose_single
from designlab.gap.where import where
from designlab.measurement import Measurement
from designlab.measurement.shots import Observations
from designlab.store import remove_partial, write_atomic, write_json

SAMPLES = 256
COLUMNS = 160
UNEXPLAINED_ABOVE = 0.5  # leftover share of the gap from which nothing is named
PARTIAL_ABOVE = 0.15
AT_FLOOR = 3.0  # mean squared residual over the floor below which there is no gap to explain
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
    renders: Path | None = None,
    pictures: bool = True,
    recentre: bool = True,
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
        Seed of rendering; the same seed gives the same report.
    progress : callable, optional
        Called with the stage, pictures done and pictures expected in it.
    resume : bool
        Whether pictures of an earlier, interrupted run are used.
    catalogue : sequence of str, optional
        Names of the effects to try; all that can act on the design when absent.
    samples : int
        Samples per pixel and LED group.
    columns : int
        Wider frames are binned to at most this many columns.
    renders : path, optional
        Folder of renders that several diagnoses share; within `out` when absent.
    pictures : bool
        Whether to draw what is left.
    recentre : bool
        Whether effects on the light are rendered anew at the values found and fitted once more: pictures
        combined from afar leave out what several parameters do together.

    Raises
    ------
    MeasurementError
        If the measurement cannot be compared, or has too few frames.
    ValueError
        If an effect is unknown, or the light of a group does not fit at all.
    """
    begun = time.perf_counter()
    out = Path(out)
    model = SensorModel.of(model)
    names = _names(model, catalogue)
    seen = observe(measurement, model.effective_design(), columns=columns)
    folder = renders or out / "renders"
    if not resume:
        shutil.rmtree(folder, ignore_errors=True)
    out.mkdir(parents=True, exist_ok=True)
    remove_partial(out)
    source = Renders(folder, samples, seed, progress)
    if is_single(seen):
        return diagnose_single(
            seen, measurement, model, names=names, source=source, out=out, pictures=pictures
        )
    bank = fill(source, model, seen.shots, names)
    fitter = Fitter(bank)
    train, select, final = seen.of("dark", "background", "train"), seen.of("select"), seen.of("final")
    source.begin("effects", 1)
    start = fitter.fit(fitter.start(train), (), train).state
    fitter.measure(start)
    search = Search(fitter, names, train, select)
    best, before, after = search.run(start)
    verdict = _verdict(search, before, after)
    last = fitter
    if verdict in ("unexplained", "at_floor"):
        best, after = fitter.fit(start, (), train), before
    elif recentre:
        last, best = _recentred(source, fitter, best, train)
        after = judge(last, best.state, select)
    stands = (fitter, start), (last, best.state)
    ends = [judge(own, state, final) for own, state in stands]
    fitted = [judge(own, state, seen.of("train")) for own, state in stands]
    gap = {
        name: Level(first.mean, last.mean, float(first.floor.mean()))
        for name, (first, last) in {
            "train": fitted,
            "select": (before, after),
            "final": ends,
        }.items()
    }
    updated = _updated(fitter, best, measurement.name)
    report = GapReport(
        verdict=verdict,
        effects=tuple(
            Found(w.name, _values(fitter, best, w.name), w.confidence, w.coherence_set)
            for w in search.winners
            if verdict not in ("unexplained", "at_floor")
        ),
        where=where(fitter, source, before.state, [*train, *select]) if verdict != "at_floor" else (),
        gap=gap,
        next_measurement=advise(fitter, seen, search, verdict),
        updated=updated,
        model=out / "model.toml",
        candidates=tuple(search.tried),
        notes=_notes(seen, measurement, model),
        provenance=_provenance(seen, measurement, model, source, begun),
        pictures=draw((fitter, ends[0].state), (last, ends[1].state), out) if pictures else {},
    )
    write_atomic(report.model, updated.dumps())
    write_json(out / "report.json", report.to_json())
    return report


def _recentred(source: Renders, fitter: Fitter, best: Fit, train: Sequence[int]) -> tuple[Fitter, Fit]:
    """Fit the effects found once more, about pictures rendered at their values."""
    bank, found = fitter.bank, best.state.values
    origin = {name: values for name, values in found.items() if effect(name).rendered}
    if not origin:
        return fitter, best
    near = Fitter(fill(source, bank.model, bank.shots, list(origin), origin=origin))
    near.noises = fitter.noises
    return near, near.fit(best.state, [n for n in found if n != "fixed_pattern"], train)


def _names(model: SensorModel, catalogue: Sequence[str] | None) -> list[str]:
    present = {applied.name for applied in model.effects}
    wanted = [e.name for e in CATALOGUE] if catalogue is None else [effect(n).name for n in catalogue]
    return [name for name in wanted if name not in present and effect(name).parameters(model.design)]


def _verdict(search: Search, before: Judged, after: Judged) -> Verdict:
    """Judge by the select presses alone."""
    excess, left = (float((judged.per_shot - judged.floor).mean()) for judged in (before, after))
    near = after.mean < AT_FLOOR * float(after.floor.mean())
    if not search.winners:
        return "at_floor" if near else "unexplained"
    share = max(left, 0.0) / max(excess, 1e-12)
    if share > UNEXPLAINED_ABOVE and not near:
        return "unexplained"
    if any(len(winner.coherence_set) > 1 for winner in search.winners):
        return "ambiguous"
    return "partial" if share > PARTIAL_ABOVE and not near else "named"


def _values(fitter: Fitter, best: Fit, name: str) -> dict[str, Value]:
    """Values with 95 % intervals, statistical."""
    values, deviations = best.state.values[name], best.deviations(name)
    found = {}
    for p in fitter.forward.parameters[name]:
        t = coordinate(p, values[p.name])
        away = INTERVAL_SD * deviations.get(p.name, 0.0)
        found[p.name] = Value(values[p.name], value_at(p, t - away), value_at(p, t + away), p.unit)
    return found


def _updated(fitter: Fitter, best: Fit, found_in: str) -> SensorModel:
    """Add the effects found to the model that was given."""
    model = fitter.bank.model
    for name in best.state.values:
        values = _values(fitter, best, name)
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
            for use in ("dark", "background", "train", "select", "final")
        },
        "rendered": renders.rendered,
        "seconds": round(time.perf_counter() - begun, 1),
        "version": __version__,
    }
