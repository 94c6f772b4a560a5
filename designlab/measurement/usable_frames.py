"""Which shots are needed, and which are used, to name what a model lacks."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from designlab.measurement import Measurement, MeasurementError
from designlab.measurement.shots import Observations, Shot, observe
from designlab.sensor.design import Design

LEAST_PLACES = 3
DARK_SIGMA = 2.0  # median of a channel, in its noise without light, below which it is dark


def observe_apart(measurement: Measurement, design: Design, *, columns: int) -> Observations:
    """Gather the frames of a measurement, each a shot of its own, and check that a diagnosis can use them.

    Raises
    ------
    MeasurementError
        As `observe`, or if a background or presses for training, selection and final numbers are missing.
    """
    seen = _with_depths(observe(measurement, design, columns=columns, apart=True))
    if not is_single(seen):
        _require_enough(measurement, seen.shots)
    return replace(seen, shots=tuple(without_cut(shot) for shot in seen.shots))


def _with_depths(seen: Observations) -> Observations:
    """Leave out presses that state their force alone: depths are fitted about stated ones."""
    kept, notes = [], []
    for shot in seen.shots:
        if shot.press is not None and shot.press.depth_mm is None:
            notes.append(f"{', '.join(shot.files)}: left out, depth_mm is not stated, force_n alone")
        else:
            kept.append(shot)
    return replace(seen, shots=tuple(kept), notes=(*seen.notes, *notes))


def is_single(seen: Observations) -> bool:
    """Whether the only picture with light is one press."""
    lit = [shot for shot in seen.shots if shot.lit.any() and shot.ball is None]
    return len(lit) == 1 and lit[0].press is not None


def without_cut(shot: Shot) -> Shot:
    """Leave out channels that are dark and cut at zero: how far below zero they would be is not known."""
    level = np.median(shot.signal, axis=(0, 1))
    seen = (shot.clip_sigma == 0) | (level > DARK_SIGMA * shot.clip_sigma)
    return replace(shot, valid=shot.valid & seen)


def end_at_zero(shots: Sequence[Shot]) -> tuple[bool, bool, bool]:
    """Channels of which a frame without light shows, or would show, no value below zero."""
    dark = [shot.clips for shot in shots if not shot.lit.any()]
    if dark:
        red, green, blue = (any(clips[channel] for clips in dark) for channel in range(3))
    else:
        red, green, blue = (all((shot.signal[..., c] >= 0).all() for shot in shots) for c in range(3))
    return red, green, blue


def _require_enough(measurement: Measurement, shots: tuple[Shot, ...]) -> None:
    if not any(shot.press is None and shot.lit.any() for shot in shots):
        raise MeasurementError(f"{measurement.folder}: field frame: a background with LEDs on is needed")
    missing = [use for use in ("train", "select", "final") if not any(shot.use == use for shot in shots)]
    if missing:
        raise MeasurementError(
            f"{measurement.folder}: field frame: usable presses at {LEAST_PLACES} places or more are needed, "
            f"so that an effect fitted at one is judged at others; none is left for {', '.join(missing)}"
        )
