"""What the checks of the data, made before any fit, and missing frames take from the verdict."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.result import Found, GapReport
from designlab.measurement import Measurement, refuse
from designlab.measurement.frames import FULL_SCALE
from designlab.measurement.quality.invariants import FrameCheck, invariants
from designlab.measurement.quality.model_check import against_model
from designlab.measurement.shots import LEFT_OUT, Observations
from designlab.measurement.usable_frames import end_at_zero
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.simulation.contact.press import Press
from designlab.simulation.effects import CATALOGUE, SensorModel, effect
from designlab.simulation.render_cache import Renders

LEAST_PRESSES, LEAST_SELECT = 6, 2
SATURATED = 0.005  # of the values of a frame
# Largest confidence: without repeats, of few or doubtful frames, without a dark one, of saturated ones.
ASSUMED, WEAK, NO_DARK, CUT = 0.5, 0.5, 0.7, 0.7
DOUBTED = ("trusted although", "odd: ")  # starts of notes


@dataclass(frozen=True)
class Reserve:
    """What weakens a verdict: in words, the largest confidence left, whether a name may stand."""

    why: str
    confidence: float
    name_stands: bool = False


READ_OFF = Reserve(
    "places or depths of presses were not noted but read off the pictures that they explain: a wrong model "
    "moves them",
    0.7,
    name_stands=True,
)


@dataclass(frozen=True)
class Examined:
    """Outcome of the checks: comparisons, notes, what weakens the verdict."""

    checks: tuple[FrameCheck, ...]
    notes: tuple[str, ...]
    reserves: tuple[Reserve, ...]


def examine(
    measurement: Measurement,
    model: SensorModel,
    seen: Observations,
    renders: Renders,
    notes: Sequence[str] = (),
    trust: Sequence[str] = (),
) -> Examined:
    """Compare frames with each other and with the model as given, before anything is fitted.

    Parameters
    ----------
    seen : Observations
        All shots, dark ones among them, with the black level under their signals.
    renders : Renders
        Where pictures of the model come from.
    notes : sequence of str
        What `measurement.quality.comparable.check_comparable` has noted.
    trust : sequence of str
        Names of suspicions that are known and right as they are.

    Raises
    ------
    MeasurementError
        Naming files, evidence, cause, remedy and the way on.
    """
    lit = [s for s in seen.shots if s.lit.any() and not s.gel_rotation_deg]
    above = [replace(s, signal=s.signal - seen.black_level) for s in lit]
    design = model.effective_design()

    def pictures(asked: Sequence[tuple[Press | None, View]]) -> list[Array]:
        return [renders.basis(model, press, view).astype(float) for press, view in asked]

    found = against_model(
        above,
        pictures([(s.press, s.view) for s in above]),
        black=seen.black_level,
        transfer=design.transfer_mw,
        response=measurement.response,
        others=pictures,
    )
    notes = (*notes, *refuse(measurement, found.suspicions, trust))
    return Examined(
        checks=(*invariants(measurement, design), found.missed),
        notes=notes,
        reserves=tuple(_reserves(measurement, seen, [note for note in notes if note.startswith(DOUBTED)])),
    )


def _reserves(measurement: Measurement, seen: Observations, doubted: Sequence[str]) -> Iterable[Reserve]:
    """What weakens the verdict."""
    if not seen.repeats:
        why = (
            "the noise floor is unknown: no frame was taken twice, and noise is taken from the camera's "
            "description"
        )
        yield Reserve(why, ASSUMED)
    if not seen.dark:
        why = (
            "no frame without light: nothing is said about an additive floor, and the black level is the "
            "camera's stated one"
        )
        yield Reserve(why, NO_DARK, name_stands=True)
    lit = [frame for frame in measurement.frames if frame.lit and frame.kind not in LEFT_OUT]
    saturated = max(float((measurement.image(frame) >= FULL_SCALE).mean()) for frame in lit)
    if saturated > SATURATED:
        why = (
            f"up to {saturated:.1%} of the values of a frame are saturated: the brightest places say nothing"
        )
        yield Reserve(why, CUT, name_stands=True)
    presses, select = len(seen.of("train", "select", "final")), len(seen.of("select"))
    if presses < LEAST_PRESSES or select < LEAST_SELECT:
        taken = "1 press" if presses == 1 else f"{presses} presses"
        why = (
            f"{taken}, {select or 'none'} of them to choose by: fewer than the {LEAST_PRESSES} and "
            f"{LEAST_SELECT} that a name takes"
        )
        yield Reserve(why, WEAK)
    for note in doubted:
        yield Reserve(note, WEAK)


def below_zero(effects: Sequence[Found], seen: Observations, design: Design) -> bool:
    """Whether a black level was found of which no frame without light tells: where counts end at zero."""
    ends = np.array(end_at_zero(seen.shots))
    for found in effects:
        highest = {name: value.high for name, value in found.parameters.items() if value.high is not None}
        if effect(found.name).constant and len(highest) == len(found.parameters):
            dark = effect(found.name).on_signal(np.full((1, 1, 3), design.camera.black_level), highest)
            if (ends & (dark[0, 0] < 0)).any():
                return True
    return False


def looking_alike(effects: Sequence[Found], seen: Observations, design: Design) -> tuple[str, ...]:
    """Effects that frames of this kind cannot tell apart."""
    single = any((s.lit > 0).sum() == 1 for s in seen.shots)
    if seen.dark and (single or not below_zero(effects, seen, design)):
        return ()
    missing = ("dark",) if single else ("dark", "single_group")
    return tuple(e.name for e in CATALOGUE if e.told_by in missing)


def weakened(
    report: GapReport, examined: Examined, tried: Sequence[str], alike: Sequence[str] = ()
) -> GapReport:
    """Take from a report what its frames do not bear.

    A name falls to `partial` where the floor is unknown, presses are few, or something was trusted although
    it looked wrong, and to `ambiguous` where other effects look alike without the frames that would tell
    them apart. Confidence is limited by each reserve.

    Parameters
    ----------
    tried : sequence of str
        Effects that were tried: others cannot stand in for one.
    alike : sequence of str
        Effects that frames of this kind cannot tell apart.
    """
    most = min([reserve.confidence for reserve in examined.reserves], default=1.0)
    others = {name for name in alike if name in tried}

    def lowered(found: Found) -> Found:
        names, confidence = found.coherence_set, min(found.confidence, most)
        if found.name in others and others.difference(names):
            names = (*names, *sorted(others.difference(names)))
            confidence = min(confidence, 1 / len(names))
        return replace(found, confidence=confidence, coherence_set=names)

    effects = tuple(lowered(found) for found in report.effects)
    verdict = report.verdict
    if verdict == "named" and any(len(found.coherence_set) > 1 for found in effects):
        verdict = "ambiguous"
    barred: tuple[str, ...] = ()
    if verdict in ("named", "ambiguous"):
        barred = tuple(reserve.why for reserve in examined.reserves if not reserve.name_stands)
    if barred:
        verdict = "partial"
    notes = [*examined.notes]
    if verdict != report.verdict:
        notes.append(f"verdict lowered from {report.verdict} to {verdict}")
    notes += [reserve.why for reserve in examined.reserves]
    if report.verdict == "at_floor" and examined.reserves:
        notes.append("at_floor says no more than these frames can show")
    return replace(
        report,
        verdict=verdict,
        effects=effects,
        notes=tuple(dict.fromkeys([*report.notes, *notes])),
        checks=examined.checks,
        reserves=tuple(reserve.why for reserve in examined.reserves),
        barred=barred,
    )
