"""LED groups that shine from other sides than drawn: looked for before effects, which would stand in for it.

No effect of the catalogue moves LEDs that far, and every one that changes light takes up a part of it.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from designlab.inference.calibration.layout import MOST_GROUPS, STEP_DEG, LayoutFound, search_layout
from designlab.inference.diagnosis.result import (
    Advice,
    Found,
    GapReport,
    Level,
    Value,
    provenance,
)
from designlab.inference.diagnosis.verdict.data_checks import Examined, weakened
from designlab.measurement import Measurement
from designlab.measurement.quality.picture_faults import CoarseShot, Fault, coarse, fitted_light, misfit
from designlab.measurement.quality.turns import UPRIGHT
from designlab.measurement.shots import Observations
from designlab.sensor.design import CHANNELS, Design
from designlab.simulation.effects import SensorModel
from designlab.simulation.render_cache import Renders

NAME = "led_layout"
SUMMARY = "LED groups shine from other sides than drawn"
# Misfits are root mean squares in units of the noise and 1 % of the mean signal, light fitted.
ASKED_FROM = 15.0  # from which azimuths are tried; models of sets with effects of usual size stay below
BETTER = 4.0  # squared misfit of the groups as drawn over that of the azimuths found, from which these count
MOST_LEFT = 0.3  # of a channel's mean that the azimuths found may leave, noise of the quick pictures included
EXPLAINED = 5.0  # misfit of pictures once mirrored, below which that explains them
CLEARER = 2.0  # factor by which the azimuths must explain them better than that
LEAST_TURN_DEG = 2 * STEP_DEG  # that a group is off by
NAMED_FROM = 0.5  # share of the gap of each use that the azimuths must take away to be named
CONFIDENCE = 5 / 6  # four made sensors with turned rows, of four, were told right (rule of succession)
USES = ("train", "select", "final")
LOOKS_LIKE = ("mirrored", "channels", "odd", "probe", "place")  # suspicions that a wrong layout raises


def clear_of_suspicion(examined: Examined) -> Examined:
    """Leave out what was trusted only because the layout explains it."""
    said = "trusted although"
    return replace(
        examined,
        notes=tuple(note for note in examined.notes if not note.startswith(said)),
        reserves=tuple(reserve for reserve in examined.reserves if not reserve.why.startswith(said)),
    )


def misplaced(
    measurement: Measurement, model: SensorModel, seen: Observations, renders: Renders
) -> LayoutFound | None:
    """Azimuths of the LED groups, if the pictures show that some shine from other sides than drawn.

    They are tried only where the model misses the pictures by far, whatever the light of its groups is, or
    where light of another group stands for that of one.

    Parameters
    ----------
    measurement : Measurement
        The set.
    model : SensorModel
        The model as given.
    seen : Observations
        Its shots, the black level under their signals.
    renders : Renders
        Where pictures of the model come from.
    """
    design = model.effective_design()
    if not 1 < len(design.leds.groups) <= MOST_GROUPS:
        return None
    pictures = _pictures(model, seen, renders)
    mirrored = min(_missed(pictures, turn) for turn in UPRIGHT if turn)
    if not _doubtful(pictures, design) or mirrored < EXPLAINED:
        return None

    def told(stage: str, done: int, total: int) -> None:
        renders.work.tell(f"LED groups at other sides: {stage}, {100 * done // total} %")

    found = search_layout(measurement, design, seed=renders.seed, closely=False, progress=told)
    turned = any(abs(place.moved_deg) >= LEAST_TURN_DEG for place in found.places)
    if not turned or found.drawn < BETTER or found.left > MOST_LEFT:
        return None
    there = _missed(_pictures(_corrected(model, found), seen, renders))
    return found if CLEARER * there < mirrored else None


def _corrected(model: SensorModel, found: LayoutFound) -> SensorModel:
    """Model with the groups where they are found."""
    azimuths = {
        f"leds.groups.{n}.azimuth_deg": list(group.azimuth_deg)
        for n, group in enumerate(found.design.leds.groups)
    }
    return model.model_copy(update={"design": model.design.replace(azimuths)})


def _missed(pictures: Sequence[CoarseShot], turn: str = "") -> float:
    """Misfit of pictures, light fitted; of pictures that were turned or mirrored, once that is undone."""
    return fitted_light(pictures, Fault(turn), np.zeros(len(CHANNELS))).misfit


def _pictures(model: SensorModel, seen: Observations, renders: Renders) -> list[CoarseShot]:
    """Shots with light, without the black level, beside the pictures of a model."""
    lit = [s for s in seen.shots if s.lit.any() and s.ball is None and not s.gel_rotation_deg]
    return [
        coarse(
            replace(shot, signal=shot.signal - seen.black_level),
            renders.basis(model, shot.press, shot.view).astype(float),
        )
        for shot in lit
    ]


def _doubtful(pictures: Sequence[CoarseShot], design: Design) -> bool:
    """Whether a model misses pictures by far, or needs the light of other groups for that of one."""
    fit = fitted_light(pictures, Fault(), np.zeros(len(CHANNELS)))
    if fit.misfit > ASKED_FROM:
        return True
    expected, found = design.transfer_mw.argmax(axis=1), fit.transfer.argmax(axis=1)
    told = len(set(expected.tolist())) == len(CHANNELS)  # each group has a channel of its own
    return told and bool((expected != found).any())


def layout_report(
    found: LayoutFound,
    seen: Observations,
    measurement: Measurement,
    model: SensorModel,
    *,
    source: Renders,
    examined: Examined,
    out: Path,
    begun: float,
) -> GapReport:
    """Report that names the layout: nothing else was tried, for a wrong layout has no other cause's shape.

    Parameters
    ----------
    found : LayoutFound
        Where the groups shine from.
    seen, measurement, model, source
        What was observed, and with which model and pictures.
    examined : Examined
        Outcome of the checks, which weakens the verdict.
    out : Path
        Folder of the results.
    begun : float
        When the diagnosis began, by `time.perf_counter`.
    """
    corrected = _corrected(model, found)
    moved = [place for place in found.places if abs(place.moved_deg) >= LEAST_TURN_DEG]
    values = {
        f"{place.name}_azimuth_deg": Value(
            place.drawn_deg + place.moved_deg,
            place.drawn_deg + place.moved_deg - STEP_DEG / 2,
            place.drawn_deg + place.moved_deg + STEP_DEG / 2,
            "deg",
            place.drawn_deg,
            STEP_DEG,
            (place.drawn_deg - 180.0, place.drawn_deg + 180.0),
        )
        for place in moved
    }
    places = ", ".join(
        f"{place.name} from about {place.found_deg:.0f} deg, drawn at {place.drawn_deg:.0f} deg"
        for place in moved
    )
    command = f"designlab calibrate {measurement.folder} --layout --model DESIGN --out calibrated"
    gap = _levels((model, corrected), seen, source)
    closed = all(level.removed is not None and level.removed >= NAMED_FROM for level in gap.values())
    report = GapReport(
        verdict="named" if closed else "partial",
        effects=(Found(NAME, values, CONFIDENCE, (NAME,), f"{SUMMARY}: {places}"),),
        where=(),
        gap=gap,
        next_measurement=Advice(
            f"none: run `{command}`, which fits azimuth, height and tilt, then diagnose again with "
            "calibrated/calibrated.toml"
        ),
        updated=corrected,
        model=out / "model.toml",
        candidates=(),
        notes=(
            f"the LED groups shine from other sides than drawn: {places}; run `{command}`",
            f"with the groups as drawn the squared misfit is {found.drawn:.3g} times that with these "
            "azimuths; no effect was tried: each that changes light would stand in for the layout",
            *seen.notes,
        ),
        provenance=provenance(measurement, seen, model, seed=source.seed, samples=source.samples)
        | {
            "frames": {
                use: [file for shot in seen.shots if shot.use == use for file in shot.files]
                for use in ("dark", "background", *USES)
            },
            "rendered": source.rendered,
            "seconds": round(time.perf_counter() - begun, 1),
        },
        seen=seen,
    )
    return weakened(report, examined, (NAME,))


def _levels(
    models: tuple[SensorModel, SensorModel], seen: Observations, source: Renders
) -> Mapping[str, Level]:
    """Mean squared misfit of each use before and after, the light fitted to all pictures."""
    fits = []
    for model in models:
        pictures = _pictures(model, seen, source)
        light = fitted_light(pictures, Fault(), np.zeros(len(CHANNELS)))
        fits.append({picture.files: misfit(picture, light) ** 2 for picture in pictures})
    of_use: dict[str, list[tuple[str, ...]]] = {
        use: [s.files for s in seen.shots if s.use == use and s.files in fits[0]] for use in USES
    }
    every = list(fits[0])

    def mean(fit: Mapping[tuple[str, ...], float], use: str) -> float:
        return float(np.mean([fit[files] for files in of_use[use] or every]))

    before, after = fits
    return {use: Level(mean(before, use), mean(after, use), 1.0, 1.0) for use in USES}
