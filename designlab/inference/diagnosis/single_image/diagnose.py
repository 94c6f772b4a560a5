"""Diagnosis of a single picture: a press without a background, repeats or other presses.

Such a picture has nothing to compare with but itself. Blocks of it are fitted to, others judge, and others
decide nothing (see `blocks`). What explains blocks that it was not fitted to is more than a fit to fibres
and dirt, but no more than that: they lie beside each other in one picture of one press. So effects are at
most consistent with it, and none is named for certain.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from designlab.core.metrics import compare_within
from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.rendering import moved
from designlab.inference.diagnosis.result import (
    Advice,
    Found,
    GapReport,
    Level,
    PictureComparison,
    Verdict,
    provenance,
)
from designlab.inference.diagnosis.single_image.frame_fitter import SCALE
from designlab.inference.diagnosis.single_image.search import FittedPicture, FrameSearch, Member
from designlab.inference.diagnosis.verdict.data_checks import Examined, looking_alike, weakened
from designlab.inference.diagnosis.verdict.intervals import values
from designlab.inference.diagnosis.verdict.localise import localise
from designlab.inference.diagnosis.verdict.update import updated
from designlab.measurement import Measurement
from designlab.measurement.blocks import FINAL, TRAIN, USES, block_uses, in_blocks
from designlab.measurement.compare import rendered
from designlab.measurement.shots import POSE, Observations
from designlab.simulation.effects import SensorModel, effect
from designlab.simulation.render_cache import Renders

Figures = dict[str, dict[str, Mapping[str, float]]]

UNEXPLAINED_ABOVE = 0.5  # leftover share of the gap from which nothing is named
AT_FLOOR = 3.0  # mean squared residual over the floor below which there is no gap to explain
FAR_SD = 3.0  # standard deviations from the stated pose that are worth a note
MOST_CONFIDENCE = 2.0 / 3.0  # of one success in one trial (rule of succession)
NEXT = Advice(
    "the untouched gel with all LEDs on, three times, once with all off and once with each LED group alone, "
    "then the same shape at two more places: without them light, coating, camera and contact share one "
    "picture, and its noise is not known",
    minutes=10.0,
)


def diagnose_single(
    seen: Observations,
    measurement: Measurement,
    model: SensorModel,
    *,
    names: Sequence[str],
    source: Renders,
    examined: Examined,
    out: Path,
    parity: int = 0,
) -> GapReport:
    """Find effects that are consistent with a single picture.

    Parameters
    ----------
    seen : Observations
        Whose only shot with light is a press, see `usable_frames.is_single`.
    measurement : Measurement
        What was observed.
    model : SensorModel
        The model to begin with.
    names : sequence of str
        Effects to try.
    source : Renders
        Where pictures come from.
    examined : Examined
        Outcome of the checks, which weakens the verdict.
    out : Path
        Folder of the results.
    parity : int
        0 or 1: which blocks are fitted to.

    Raises
    ------
    ValueError
        If the light of a group does not fit at all.
    """
    begun = time.perf_counter()
    source.work.begin("pictures of the model")
    seen = in_blocks(seen, parity=parity)
    search = FrameSearch(source, model, seen.shots, names)
    given, best = search.run()
    verdict = _verdict(search, given, best)
    if verdict in ("unexplained", "at_floor"):
        best, search.members = given, []
    source.work.begin("conclusions")
    given.fitter.noises = best.fitter.noises
    found = {name: values(best.fitter, best.fit, name, (TRAIN,)) for name in best.state.values}
    effects = tuple(
        Found.of(m.name, found[m.name], MOST_CONFIDENCE / len(m.equals), m.equals) for m in search.members
    )
    report = GapReport(
        verdict=verdict,
        effects=effects,
        where=localise(given.fitter, source, given.state, range(len(USES))) if verdict != "at_floor" else (),
        gap={
            use: Level(
                float(search.blocks(given, number).mean()),
                float(search.blocks(best, number).mean()),
                search.floor(best, number),
                search.floor(best, number),  # what pictures of other sensors leave says nothing of its grain
            )
            for number, use in enumerate(USES)
        },
        next_measurement=NEXT,
        updated=model,
        model=out / "model.toml",
        candidates=tuple(search.tried),
        notes=seen.notes,
        provenance=_provenance(seen, measurement, model, source, parity),
        seen=seen,
    )
    alike = looking_alike(report.effects, seen, model.effective_design())
    report = weakened(report, examined, names, alike)
    better = updated(
        best.fitter, best.fit, measurement, seen, report, found, seed=source.seed, samples=source.samples
    )
    figures, shown = _compared(measurement, seen, model, better, given, best, source, parity)
    source.work.end()
    made = {**report.provenance, "blocks": {"parity": parity, "structure": figures}}
    return replace(
        report,
        updated=better,
        shown=shown,
        notes=(*_words(search, best, figures), *report.notes),
        provenance=made | {"rendered": source.rendered, "seconds": round(time.perf_counter() - begun, 1)},
    )


def _verdict(search: FrameSearch, given: FittedPicture, best: FittedPicture) -> Verdict:
    """Judge by the blocks that chose; more than partial or ambiguous one picture cannot give."""
    floor = search.floor(best)
    before, after = (float(search.blocks(stand).mean()) for stand in (given, best))
    if before < AT_FLOOR * floor and not search.members:
        return "at_floor"
    left = max(after - floor, 0.0) / max(before - floor, 1e-12)
    if not search.members or (left > UNEXPLAINED_ABOVE and after > AT_FLOOR * floor):
        return "unexplained"
    if any(len(member.equals) > 1 for member in search.members):
        return "ambiguous"
    return "partial"


def _compared(
    measurement: Measurement,
    seen: Observations,
    model: SensorModel,
    updated: SensorModel,
    given: FittedPicture,
    best: FittedPicture,
    source: Renders,
    parity: int,
) -> tuple[Figures, PictureComparison]:
    """Figures of the models on the blocks, rendered anew in full resolution, and the pictures."""
    frame = next(f for f in measurement.frames if f.file == seen.shots[TRAIN].files[0])
    press = seen.shots[TRAIN].press
    assert press is not None
    real = measurement.linear(frame).astype(float)
    view = measurement.view(frame, model.effective_design())
    uses = block_uses(*real.shape[:2], parity=parity)
    images: dict[str, Array] = {}
    figures: Figures = {}
    for label, own, stand in (("given", model, given), ("corrected", updated, best)):
        there = moved(press, stand.fitter.stated(stand.state))
        image = images[label] = rendered(
            own, there, stand.state.gains, view=view, samples=source.samples, seed=source.seed
        )
        figures[label] = {
            "blocks fitted to": compare_within(image, real, uses == TRAIN),
            "other blocks": compare_within(image, real, uses != TRAIN),
            "blocks that decided nothing": compare_within(image, real, uses == FINAL),
        }
    return figures, PictureComparison(real, **images, fitted=uses == TRAIN)


def _words(search: FrameSearch, best: FittedPicture, figures: Figures) -> list[str]:
    """What the picture shows, in sentences."""
    words = []
    classes: dict[str, list[str]] = {}
    for member in search.members:
        own = "scale of the picture" if member.name == SCALE else effect(member.name).stage
        classes.setdefault(own, []).append(f"{member.name} ({member.gain.value:.0%})")
    if classes:
        words.append(
            "classes of effects that the picture is consistent with; in brackets, what blocks that were not "
            "fitted to lose without each, as a share of the gap after registration: "
            + "; ".join(f"{own}: {', '.join(found)}" for own, found in classes.items())
        )
    words += [_rivals(member) for member in search.members if member.beside]
    for member in search.members:
        far = best.fitter.beyond_prior(best.fit, member.name)
        bound = best.fitter.at_bound(best.state, member.name)
        if far or bound:
            words.append(
                f"{member.name}: {', '.join(dict.fromkeys((*far, *bound)))} beyond what is likely of built "
                "sensors, so it may stand for something else"
            )
    for label, title in (("given", "the model as given"), ("corrected", "the corrected model")):
        held = figures[label]["other blocks"]
        words.append(
            f"{title}, light and pose fitted, at the picture's own resolution, on blocks it was not fitted "
            f"to: structure correlation {held['structure_corr']:.3f}, structure SNR "
            f"{held['structure_snr_db']:.2f} dB, SNR {held['snr_db']:.1f} dB"
        )
    return [*words, *_registered(best)]


def _rivals(member: Member) -> str:
    """Say how much better an effect explains the blocks than others of its class did in its place."""
    stage = effect(member.name).stage
    told = ", ".join(
        f"{name} (by {lead.value:.3g} ± {lead.se:.2g})"
        for name, lead in sorted(member.beside.items(), key=lambda item: item[1].value)
        if effect(name).stage == stage or name in member.equals
    )
    return (
        f"{member.name} explains the blocks better than {told or 'no other effect, since none was tried'}; "
        "in brackets the evidence, a difference of log scores, and its standard error between blocks"
    )


def _registered(best: FittedPicture) -> list[str]:
    """Where the press was found, and how bright the light."""
    away, sigma = best.fitter.stated(best.state), best.fitter.bank.shots[TRAIN].pose_sigma
    press = ", ".join(f"{axis} {value:+.3f}" for axis, value in zip(POSE, away, strict=True))
    words = [f"the press departs from its stated pose by {press}"]
    far = [a for a, v, s in zip(POSE, away, sigma, strict=True) if s > 0 and abs(v) > FAR_SD * s]
    if far:
        words.append(
            f"{', '.join(far)}: more than {FAR_SD:g} standard deviations from the stated pose, so the shape "
            "of the object, the contact or the scale may be wrong"
        )
    names = best.fitter.forward.design.group_names
    light = ", ".join(f"{name} {gain:.3g}" for name, gain in zip(names, best.state.gains, strict=True))
    words.append(
        "light of the groups over that of the model, a product of flux, reflectance and exposure that is not "
        f"carried into the model: {light}"
    )
    return words


def _provenance(
    seen: Observations, measurement: Measurement, model: SensorModel, source: Renders, parity: int
) -> dict[str, Any]:
    files = list(seen.shots[TRAIN].files)
    return provenance(measurement, seen, model, seed=source.seed, samples=source.samples) | {
        "frames": {"dark": [], "background": [], **{use: files for use in USES}},
        "blocks": {"parity": parity},
    }
