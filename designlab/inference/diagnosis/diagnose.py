"""`gap diagnose`: from a measurement and a model to the effects the model lacks."""

import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from designlab.core.progress import Work, of_thousand, silent
from designlab.core.run_folder import claim
from designlab.core.store import remove_partial
from designlab.core.types import Progress
from designlab.inference.calibration.poses import posed
from designlab.inference.diagnosis.emulator.rendering import cost_to_fill, fill
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.grain import grain
from designlab.inference.diagnosis.result import (
    Control,
    Found,
    GapReport,
    Level,
    Overlap,
    Unexplained,
    Verdict,
    provenance,
)
from designlab.inference.diagnosis.selection.forward_selection import ForwardSelection, Winner
from designlab.inference.diagnosis.selection.held_out import Judged, Stand, judge, level
from designlab.inference.diagnosis.selection.negative_control import control
from designlab.inference.diagnosis.selection.recentring import placed
from designlab.inference.diagnosis.selection.refine import refined
from designlab.inference.diagnosis.single_image.diagnose import diagnose_single
from designlab.inference.diagnosis.verdict.comparison import compared
from designlab.inference.diagnosis.verdict.data_checks import READ_OFF, examine, looking_alike, weakened
from designlab.inference.diagnosis.verdict.decision import NAMELESS, settled, sure, verdict_of
from designlab.inference.diagnosis.verdict.intervals import values
from designlab.inference.diagnosis.verdict.led_layout import (
    LOOKS_LIKE,
    clear_of_suspicion,
    layout_report,
    misplaced,
)
from designlab.inference.diagnosis.verdict.localise import localise
from designlab.inference.diagnosis.verdict.next_measurement import advise
from designlab.inference.diagnosis.verdict.notes import OF_PIXELS, notes
from designlab.inference.diagnosis.verdict.unexplained import unexplained
from designlab.inference.diagnosis.verdict.update import updated
from designlab.measurement import Measurement
from designlab.measurement.quality.comparable import check_comparable
from designlab.measurement.quality.suspicion import SuspiciousFrames
from designlab.measurement.shots import Observations
from designlab.measurement.usable_frames import (
    LEAST_PLACES,
    MOST_PRESSES,
    is_single,
    observe_apart,
    spread_out,
)
from designlab.sensor.design import Design
from designlab.simulation.effects import CATALOGUE, UNASKED, SensorModel, effect
from designlab.simulation.render_cache import Renders

RUN = "run.json"
SAMPLES = 256
COLUMNS = 96  # those that all limits and confidence were learnt at: evidence grows with the pixels
OVERLAPPING = 0.5  # share of an effect's signature from which a pair is reported
OF_ONE_PICTURE = 22  # times what is screened, a search among real light takes (measured on one)
GIVEN_BACK = 0.1  # of what a search removes of the gap, which the last fit must not give back


def diagnose(
    measurement: Measurement,
    model: SensorModel | Design,
    *,
    out: str | Path,
    seed: int,
    progress: Progress = silent,
    resume: bool = True,
    catalogue: Sequence[str] | None = None,
    samples: int = SAMPLES,
    columns: int = COLUMNS,
    presses: int | None = None,
    renders: Path | None = None,
    trust: Sequence[str] = (),
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
        Folder of the results, which `report.diagnosis_folder` writes, and of the renders kept for resuming.
    seed : int
        Seed of rendering; the same seed gives the same report.
    progress : callable, optional
        Called with what is being done, and how much of everything is done in thousandths.
    resume : bool
        Whether pictures of an earlier, interrupted run are used.
    catalogue : sequence of str, optional
        Names of the effects to try; when absent, all that can act on the design but those that are tried by
        name alone.
    samples : int
        Samples per pixel and LED group.
    columns : int
        Wider frames are binned to at most this many columns.
    presses : int, optional
        Of more presses than these, those that differ most are used; `MOST_PRESSES` when absent.
    renders : path, optional
        Folder of renders that several diagnoses share; within `out` when absent.
    trust : sequence of str
        Names of suspicions, see `measurement.quality.suspicion`, that are known and right as they are.

    Raises
    ------
    MeasurementError
        If the measurement cannot be compared, is suspicious, or has too few frames.
    ValueError
        If an effect is unknown, the light of a group does not fit at all, or the folder holds another
        diagnosis.
    """
    begun = time.perf_counter()
    out = Path(out)
    presses = MOST_PRESSES if presses is None else presses
    for name, value, least in (
        ("columns", columns, 8),
        ("samples", samples, 1),
        ("presses", presses, LEAST_PLACES),
        ("seed", seed, 0),
    ):
        if value < least:
            raise ValueError(f"{name}: must be at least {least}, got {value}")
    model = SensorModel.of(model)
    read = posed(measurement, model.effective_design(), seed=seed, progress=of_thousand(progress))
    measurement = read.measurement
    noted = (*check_comparable(measurement, model, trust), *read.notes)
    seen = spread_out(observe_apart(measurement, model.effective_design(), columns=columns), presses)
    names = _names(model, catalogue, seen)
    noted = (*noted, *_untried(catalogue, model, seen))
    folder = renders or out / "renders"
    if not resume:
        shutil.rmtree(folder, ignore_errors=True)
        (out / RUN).unlink(missing_ok=True)
    _claim(out, measurement, model, seed)
    work = Work(progress, _costs(model, seen, names))
    work.begin("model as given")
    source = Renders(folder, samples, seed, work)
    layout = None
    try:
        examined = examine(measurement, model, seen, source, noted, trust)
    except SuspiciousFrames as error:
        if not set(error.names) <= set(LOOKS_LIKE):
            raise
        if (layout := misplaced(measurement, model, seen, source)) is None:
            raise
        trusted = (*trust, *(name for name in LOOKS_LIKE if name not in trust))
        examined = clear_of_suspicion(examine(measurement, model, seen, source, noted, trusted))
    if read.files:
        examined = replace(examined, reserves=(*examined.reserves, READ_OFF))
    if layout is not None or (layout := misplaced(measurement, model, seen, source)) is not None:
        work.end()
        return layout_report(
            layout, seen, measurement, model, source=source, examined=examined, out=out, begun=begun
        )
    if is_single(seen):
        return diagnose_single(
            seen, measurement, model, names=names, source=source, examined=examined, out=out
        )
    found = _explained(seen, model, names, source)
    given, last = found.given, found.last
    train = seen.of("dark", "background", "train")
    intervals = {name: values(last.fitter, last.fit, name, train) for name in last.fit.state.values}
    effects = tuple(Found.of(w.name, intervals[w.name], 0.0, w.coherence_set) for w in found.winners)
    wrong = _control(found, seen, seed=int(measurement.content_digest()[:8], 16))
    at_floor = found.verdict == "at_floor"
    excess = (
        () if at_floor else localise(given.fitter, source, given.judged.state, [*train, *seen.of("select")])
    )
    report = GapReport(
        verdict=found.verdict,
        effects=effects,
        where=excess,
        gap=found.gap,
        next_measurement=advise(given.fitter, seen, found.search, found.verdict, effects),
        updated=model,
        model=out / "model.toml",
        candidates=tuple(found.search.tried),
        notes=notes(seen, measurement, model, given, last, effects),
        provenance=_provenance(seen, measurement, model, source, begun),
        seen=seen,
        control=wrong,
        unexplained=_unexplained(found, seen.of("final")),
        overlaps=_overlaps(found.search),
    )
    alike = looking_alike(effects, seen, model.effective_design())
    report = weakened(sure(report, len(seen.of("select"))), examined, names, alike)
    better = updated(last.fitter, last.fit, measurement, seen, report, intervals, seed=seed, samples=samples)
    before, after = ((stand.fitter, end.state) for stand, end in zip((given, last), found.ends, strict=True))
    work.end()
    return replace(report, updated=better, shown=compared(source, before, after))


@dataclass(frozen=True, eq=False)
class _Explanation:
    """Where a search has ended: the model as given, the corrected one, and the final presses by either."""

    search: ForwardSelection
    given: Stand
    last: Stand
    verdict: Verdict
    gap: Mapping[str, Level]
    ends: Sequence[Judged]

    @property
    def winners(self) -> Sequence[Winner]:
        """Effects that are named."""
        return [] if self.verdict in NAMELESS else self.search.winners


def _explained(seen: Observations, model: SensorModel, names: Sequence[str], source: Renders) -> _Explanation:
    """Search for effects, fit those found exactly, and judge by presses that had no say in it."""
    train, select, final = seen.of("dark", "background", "train"), seen.of("select"), seen.of("final")
    source.work.begin("pictures of the model")
    fitter, start = begun(seen, model, names, source)
    source.work.begin("searching")
    search = ForwardSelection(fitter, names, train, select, source, work=source.work)
    given, found = search.run(start)
    as_good = [winner.coherence_set for winner in search.winners]
    before, after = given.judged, found.judged
    verdict = verdict_of(as_good, level(before, after))
    source.work.begin("refining")
    last = given if verdict in NAMELESS else _last_fit(source, given, found, train, select)
    source.work.begin("conclusions")
    ends = [judge(stand.fitter, stand.fit, final) for stand in (given, last)]
    trained = [judge(stand.fitter, stand.fit, seen.of("train")) for stand in (given, last)]
    gap = {
        "train": level(*trained),
        "select": level(given.judged, last.judged),
        "final": level(*ends),
    }
    return _Explanation(search, given, last, settled(verdict, as_good, gap), gap, ends)


def begun(
    seen: Observations, model: SensorModel, names: Sequence[str], source: Renders
) -> tuple[Fitter, State]:
    """What a search begins from: the model as given, fitted to the training shots, and all noise known.

    Parameters
    ----------
    names : sequence of str
        Effects that will be tried.
    """
    train, select, final = seen.of("dark", "background", "train"), seen.of("select"), seen.of("final")
    shown = fill(source, model, seen.shots, names, both=False)
    fitter = placed(source, Fitter(shown), train, [*select, *final])
    start = fitter.fit(fitter.start(train), (), train).state
    fitter.grain = grain(fitter, start, [*train, *select])
    fitter.measure(start)
    start = fitter.fit(start, (), train).state
    fitter.measure(start)
    return fitter, start


def _control(found: _Explanation, seen: Observations, *, seed: int) -> Control | None:
    """Fit a wrong effect for comparison, where any was named."""
    if not found.winners:
        return None
    return control(
        found.given.fitter,
        found.given.judged.state,
        named=[w.name for w in found.winners],
        as_good={name for w in found.winners for name in w.coherence_set},
        tried=found.search.screened[0],
        seed=seed,
        train=seen.of("dark", "background", "train"),
        final=seen.of("final"),
        before=found.ends[0],
        corrected=found.ends[1],
    )


def _unexplained(found: _Explanation, final: Sequence[int]) -> Unexplained:
    """Say what is left, of all presses where they stand."""
    last, (before, after) = found.last, found.ends
    states = dict.fromkeys(range(len(last.fitter.bank.shots)), last.judged.state)
    states |= dict.fromkeys(final, after.state)
    held_out = [(found.given.judged, last.judged), (before, after)]
    return unexplained(last.fitter, states, held_out)


def _costs(model: SensorModel, seen: Observations, names: Sequence[str]) -> dict[str, float]:
    """What parts of a diagnosis cost about, in usual pictures; how long a search takes is not known."""
    screened, shown = cost_to_fill(model, seen.shots, names), len({(s.press, s.view) for s in seen.shots})
    # One real picture is searched to the last round, and every candidate rendered where it stands.
    search = OF_ONE_PICTURE * screened if is_single(seen) else screened / 3 + 14 * shown
    return {
        "model as given": shown,
        "pictures of the model": screened,
        "searching": search,
        "refining": 5 * shown,
        "conclusions": 5,
    }


def _claim(out: Path, measurement: Measurement, model: SensorModel, seed: int) -> None:
    """Mark a folder with what is diagnosed in it; clear what a killed run left half-written."""
    run = {
        "measurement": measurement.name,
        "frames": measurement.content_digest(),
        "model": model.digest,
        "seed": seed,
    }
    differing = {"frames": "of other frames", "model": "of another model", "seed": "with another seed"}
    claim(out, RUN, run, kind="a diagnosis", decided_by=differing)
    remove_partial(out / "renders")


def _names(model: SensorModel, catalogue: Sequence[str] | None, seen: Observations) -> list[str]:
    """Effects to try."""
    # What a picture or unit has alone is not in the simulation of the model given, and may be found again.
    present = {applied.name for applied in model.effects if not effect(applied.name).drawn}
    wanted = _wanted(catalogue, seen)
    if len({shot.view for shot in seen.shots}) > 1:
        present.update(OF_PIXELS)  # which frames of several crops do not share
    presses = seen.presses
    return [
        name
        for name in wanted
        if name not in present and effect(name).parameters_under(model.design, presses)
    ]


def _wanted(catalogue: Sequence[str] | None, seen: Observations) -> list[str]:
    """Return effects that are asked for; of a single picture all, since nothing of it was learnt without."""
    if catalogue is None:
        return [e.name for e in CATALOGUE] if is_single(seen) else list(UNASKED)
    return [effect(name).name for name in catalogue]


def _untried(catalogue: Sequence[str] | None, model: SensorModel, seen: Observations) -> Iterator[str]:
    """Note effects asked for that the design cannot have, and those that these presses leave no range."""
    for name in _wanted(catalogue, seen):
        if not effect(name).parameters(model.design):
            if catalogue is not None:
                yield f"{name} was not tried: the design {model.design.name or 'given'} cannot have it"
        elif not effect(name).parameters_under(model.design, seen.presses):
            yield f"{name} was not tried: the gel is too thin for presses as deep as these"


def _last_fit(
    source: Renders, given: Stand, searched: Stand, train: Sequence[int], select: Sequence[int]
) -> Stand:
    """Fit what a search has found exactly, unless the select presses speak against it."""
    fitter, fit = refined(source, searched.fitter, searched.fit, train)
    last = Stand(fitter, fit, train, judge(fitter, fit, select))
    means = (stand.judged.mean for stand in (given, searched, last))
    return searched if _gives_back(*means) else last


def _gives_back(before: float, searched: float, refined: float) -> bool:
    """Whether a last fit undoes on the select presses what the search has reached there, by mean squares."""
    return refined - searched > GIVEN_BACK * (before - searched)


def _overlaps(search: ForwardSelection) -> tuple[Overlap, ...]:
    """Pairs of effects that these frames hardly tell apart, closest first."""
    close = [
        Overlap(*pair, round(share, 3)) for pair, share in search.overlaps.items() if share >= OVERLAPPING
    ]
    return tuple(sorted(close, key=lambda overlap: -overlap.share))


def _provenance(
    seen: Observations, measurement: Measurement, model: SensorModel, renders: Renders, begun: float
) -> dict[str, object]:
    return provenance(measurement, seen, model, seed=renders.seed, samples=renders.samples) | {
        "frames": {
            use: [file for shot in seen.shots if shot.use == use for file in shot.files]
            for use in ("dark", "background", "train", "select", "final")
        },
        "rendered": renders.rendered,
        "seconds": round(time.perf_counter() - begun, 1),
    }
