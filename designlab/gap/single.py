"""Diagnosis of a single picture: a press without a background, repeats or other presses.

Such a picture has nothing to compare with but itself. Blocks of it are fitted to, others judge, and others
decide nothing (see `blocks`). What explains blocks that it was not fitted to is more than a fit to fibres
and dirt, but no more than that: they lie beside each other in one picture of one press. So effects are at
most consistent with it, and none is named for certain.
"""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.camera import View
from designlab.effects import AppliedEffect, SensorModel, effect
from designlab.gap.bank import moved
from designlab.gap.basis import Renders
from designlab.gap.blocks import FINAL, SCALE, TRAIN, USES, Uses, block_uses, in_blocks
from designlab.gap.forward import coordinate, value_at
from designlab.gap.frame_picture import draw
from designlab.gap.frame_search import FrameSearch, Stand
from designlab.gap.result import Found, GapReport, Level, Value, Verdict
from designlab.gap.structure import rendered, structure
from designlab.gap.where import where
from designlab.measurement import Measurement
from designlab.measurement.shots import POSE, Observations
from designlab.press import Press
from designlab.store import write_atomic, write_json

Array = NDArray[np.float64]
Figures = dict[str, dict[str, Mapping[str, float]]]

UNEXPLAINED_ABOVE = 0.5  # leftover share of the gap from which nothing is named
AT_FLOOR = 3.0  # mean squared residual over the floor below which there is no gap to explain
INTERVAL_SD = 1.96
BEYOND_SD = 3.0
MOST_CONFIDENCE = 2.0 / 3.0  # of one success in one trial (rule of succession)
NEXT = (
    "the untouched gel with all LEDs on, three times, once with all off and once with each LED group alone "
    "(about 5 min), then the same shape at two more places: without them light, coating, camera and contact "
    "share one picture, and its noise is not known"
)


def diagnose_single(
    seen: Observations,
    measurement: Measurement,
    model: SensorModel,
    *,
    names: Sequence[str],
    source: Renders,
    out: Path,
    pictures: bool = True,
    parity: int = 0,
) -> GapReport:
    """Find effects that are consistent with a single picture.

    Parameters
    ----------
    seen : Observations
        Whose only shot with light is a press, see `blocks.is_single`.
    measurement : Measurement
        What was observed.
    model : SensorModel
        The model to begin with.
    names : sequence of str
        Effects to try.
    source : Renders
        Where pictures come from.
    out : Path
        Folder for ``model.toml``, ``report.json`` and the picture.
    pictures : bool
        Whether to draw.
    parity : int
        0 or 1: which blocks are fitted to.

    Raises
    ------
    ValueError
        If the light of a group does not fit at all.
    """
    begun = time.perf_counter()
    seen = in_blocks(seen, parity=parity)
    search = FrameSearch(source, model, seen.shots, names)
    given, best = search.run()
    verdict = _verdict(search, given, best)
    nothing = verdict in ("unexplained", "at_floor")
    if nothing:
        best = given
    given.fitter.noises = best.fitter.noises
    updated = _updated(model, best, measurement.name)
    figures, images, uses = _compared(measurement, seen, model, updated, given, best, source, parity)
    report = GapReport(
        verdict=verdict,
        effects=()
        if nothing
        else tuple(
            Found(
                member.name,
                _values(best, member.name),
                MOST_CONFIDENCE / len(member.equals),
                member.equals,
            )
            for member in search.members
        ),
        where=where(given.fitter, source, given.state, range(len(USES))) if verdict != "at_floor" else (),
        gap={
            use: Level(
                float(search.blocks(given, number).mean()),
                float(search.blocks(best, number).mean()),
                search.floor(best, number),
            )
            for number, use in enumerate(USES)
        },
        next_measurement=NEXT,
        updated=updated,
        model=out / "model.toml",
        candidates=tuple(search.tried),
        notes=(*_words(search, given, best, measurement, figures, nothing), *seen.notes),
        provenance=_provenance(seen, measurement, model, source, parity, figures, begun),
        pictures=draw(images, uses, out) if pictures else {},
    )
    write_atomic(report.model, updated.dumps())
    write_json(out / "report.json", report.to_json())
    return report


def _verdict(search: FrameSearch, given: Stand, best: Stand) -> Verdict:
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


def _values(stand: Stand, name: str) -> dict[str, Value]:
    """Values with 95 % intervals, statistical; those that were not fitted have none."""
    values, deviations = stand.state.values[name], stand.fit.deviations(name)
    found = {}
    for p in effect(name).parameters(stand.fitter.bank.model.design):
        low = high = values[p.name]
        own = next((q for q in stand.fitter.forward.parameters[name] if q.name == p.name), None)
        if own is not None:
            t, away = coordinate(own, values[p.name]), INTERVAL_SD * deviations.get(p.name, 0.0)
            low, high = value_at(own, t - away), value_at(own, t + away)
        found[p.name] = Value(float(values[p.name]), float(low), float(high), p.unit)
    return found


def _updated(model: SensorModel, best: Stand, found_in: str) -> SensorModel:
    """Add the effects found to the model that was given."""
    for name in best.state.values:
        values = _values(best, name)
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


def _compared(
    measurement: Measurement,
    seen: Observations,
    model: SensorModel,
    updated: SensorModel,
    given: Stand,
    best: Stand,
    source: Renders,
    parity: int,
) -> tuple[Figures, dict[str, Array], Uses]:
    """Figures of the models on the blocks, rendered anew in full resolution, the pictures, and the blocks."""
    frame = next(f for f in measurement.frames if f.file == seen.shots[TRAIN].files[0])
    press = measurement.press(frame)
    assert press is not None
    real = measurement.linear(frame).astype(float)
    view = measurement.view(frame, model.effective_design())
    uses = block_uses(*real.shape[:2], parity=parity)
    images: dict[str, Array] = {"measured": real}
    figures: Figures = {}
    for label, own, stand in (("given", model, given), ("corrected", updated, best)):
        image = _rendered(own, press, stand, view, source)
        images[label] = image
        figures[label] = {
            "blocks fitted to": structure(image, real, uses == TRAIN),
            "other blocks": structure(image, real, uses != TRAIN),
            "blocks that decided nothing": structure(image, real, uses == FINAL),
        }
    return figures, images, uses


def _rendered(model: SensorModel, press: Press, stand: Stand, view: View, source: Renders) -> Array:
    there = moved(press, stand.fitter.stated(stand.state))
    return rendered(model, there, stand.state.gains, view=view, samples=source.samples, seed=source.seed)


def _words(
    search: FrameSearch,
    given: Stand,
    best: Stand,
    measurement: Measurement,
    figures: Figures,
    nothing: bool,
) -> list[str]:
    """What one picture shows and what it cannot."""
    words = [
        "n = 1: one picture of one press. Alternate blocks of it were fitted to and the others scored, which "
        "shows that a correction is no fit to dirt, not that it holds for another press. The effects are "
        "consistent with this picture; none is validated",
        "the noise floor is unknown without repeats; the grain of the picture itself, dirt included, stands "
        "for it",
    ]
    if not nothing:
        classes: dict[str, list[str]] = {}
        for member in search.members:
            own = "scale of the picture" if member.name == SCALE else effect(member.name).stage
            classes.setdefault(own, []).append(f"{member.name} ({member.gain.value:.0%})")
        words.append(
            "classes of effects, with what the misfit of the judging blocks rises by without each, as a "
            "share of the gap after registration: "
            + "; ".join(f"{own}: {', '.join(found)}" for own, found in classes.items())
        )
        for member in search.members:
            if far := best.fitter.beyond_prior(best.state, member.name):
                words.append(
                    f"{member.name}: {', '.join(far)} beyond what is likely of built sensors: it may stand "
                    "for something else"
                )
    for label, words_for in (("given", "the model as given"), ("corrected", "the corrected model")):
        held = figures[label]["other blocks"]
        words.append(
            f"{words_for}, light and pose fitted, rendered at the picture's own resolution, on blocks it was "
            f"not fitted to: structure correlation {held['structure_corr']:.3f}, structure SNR "
            f"{held['structure_snr_db']:.2f} dB, SNR {held['snr_db']:.1f} dB"
        )
    away = best.fitter.stated(best.state)
    sigma = best.fitter.bank.shots[TRAIN].pose_sigma
    press = ", ".join(f"{axis} {value:+.3f}" for axis, value in zip(POSE, away, strict=True))
    words.append(f"the press departs from its stated pose by {press}")
    far_axes = [a for a, v, s in zip(POSE, away, sigma, strict=True) if s > 0 and abs(v) > BEYOND_SD * s]
    if far_axes:
        words.append(
            f"{', '.join(far_axes)}: more than {BEYOND_SD:g} standard deviations from the stated pose, so "
            "the shape of the object, the contact or the scale may be wrong"
        )
    words.append(
        "light of the groups over that of the model, a product of flux, reflectance and exposure that is not "
        "carried into the model: "
        + ", ".join(
            f"{name} {gain:.3g}"
            for name, gain in zip(best.fitter.forward.design.group_names, best.state.gains, strict=True)
        )
    )
    return words


def _provenance(
    seen: Observations,
    measurement: Measurement,
    model: SensorModel,
    source: Renders,
    parity: int,
    figures: Mapping[str, Any],
    begun: float,
) -> dict[str, Any]:
    from designlab import __version__

    return {
        "measurement": measurement.name,
        "model": model.digest,
        "seed": source.seed,
        "samples": source.samples,
        "noise": seen.noise_source,
        "frames": {use: [file for file in seen.shots[TRAIN].files] for use in USES},
        "blocks": {"parity": parity, "structure": figures},
        "rendered": source.rendered,
        "seconds": round(time.perf_counter() - begun, 1),
        "version": __version__,
    }
