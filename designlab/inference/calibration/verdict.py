"""Whether a calibration is worth using, and why not."""

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np

from designlab.core.types import Array
from designlab.inference.calibration.result import Calibration, FrameResult
from designlab.sensor.design import CHANNELS
from designlab.simulation.effects.model import SensorModel

FitWord = Literal["good", "doubtful", "failed"]

LIGHT_IN_FLOOR = (0.2, 0.5)  # share of a channel's mean signal: doubtful, failed
FALLEN = (0.001, 0.05)  # of the structure correlation: what its figures show, what no other gain outweighs
UNLIKE_DB = (15.0, 8.0)  # SNR of the untouched gel: 18 and 40 % of the signal are left
LITTLE_LIGHT = 0.02  # of the strongest group of a channel


class FitVerdict(NamedTuple):
    """A verdict on a fit, and its reasons: empty where it is good.

    A doubtful fit may serve, a failed one is not to be used.
    """

    word: FitWord
    reasons: tuple[str, ...]


def fit_verdict(found: Calibration) -> FitVerdict:
    """Judge a calibration by the light that it needs and by what it leaves of the pictures.

    Light without transport is a baseline to compare with: what it leaves makes it doubtful, no failure.
    """
    told = [*_floor(found), *_groups(found), *_structure(found), *_left(found), *_search(found)]
    renders = isinstance(found.model, SensorModel)
    failed = [reason for fails, reason in told if fails and renders]
    reasons = (*failed, *(reason for _, reason in told if reason not in failed))
    return FitVerdict("failed" if failed else "doubtful" if reasons else "good", reasons)


def _floor(found: Calibration) -> Iterator[tuple[bool, str]]:
    """A floor holds what no LED explains; where it holds the light, the LEDs of the model do not fit."""
    levels = _levels(_untouched(found))
    shares = {
        name: float(floor / level) if level > 0 else 0.0
        for name, floor, level in zip(CHANNELS, found.floor, levels, strict=True)
    }
    much = {name: share for name, share in shares.items() if share > LIGHT_IN_FLOOR[0]}
    if much:
        channel = "channel" if len(much) == 1 else "channels"
        yield (
            max(much.values()) > LIGHT_IN_FLOOR[1],
            f"{max(much.values()):.0%} of the light in {channel} {', '.join(much)} is a floor that no LED "
            "explains: is the picture without colour, or does light come in from outside?",
        )


def _groups(found: Calibration) -> Iterator[tuple[bool, str]]:
    """With as many groups as channels, each group should be the strongest of one channel."""
    if not isinstance(found.model, SensorModel):
        return
    names, transfer = found.model.effective_design().group_names, np.abs(found.transfer)
    strongest = {int(group) for group in transfer.argmax(axis=1)}
    for group, name in enumerate(names):
        if (transfer[:, group] <= LITTLE_LIGHT * transfer.max(axis=1)).all():
            yield True, f"no channel sees the light of LED group {name}: does it shine from another side?"
        elif len(names) == len(CHANNELS) and group not in strongest:
            yield (
                True,
                f"LED group {name} is the strongest in no channel, others stand for its light: does it shine "
                "from another side than the design says?",
            )


def _structure(found: Calibration) -> Iterator[tuple[bool, str]]:
    """What contact adds to a picture must not be rendered worse than before."""
    presses = [frame for frame in found.frames if frame.pose is not None]
    presses = [frame for frame in presses if frame.held_out] or presses
    if not presses:
        return
    before, after = (
        float(np.mean([getattr(frame, when)["structure_corr"] for frame in presses]))
        for when in ("before", "after")
    )
    if (fall := before - after) > FALLEN[0]:
        digits = 2 if fall > 0.01 else 3
        change = f"{before:.{digits}f} -> {after:.{digits}f}"
        yield fall > FALLEN[1], f"presses are rendered worse than before: structure correlation {change}"


def _left(found: Calibration) -> Iterator[tuple[bool, str]]:
    gel = _untouched(found)
    ratio = float(np.mean([frame.after["snr_db"] for frame in gel]))
    if ratio < UNLIKE_DB[0]:
        left = 100 * 10 ** (-ratio / 20)
        yield (
            ratio < UNLIKE_DB[1],
            f"the fit leaves {left:.0f} % of the signal, far more than noise (SNR {ratio:.1f} dB)",
        )


def _search(found: Calibration) -> Iterator[tuple[bool, str]]:
    """A search that went nowhere has values that it began with, and intervals of no worth."""
    if found.stuck:
        yield (
            False,
            "the search ended where no step made the pictures fit better, though their derivatives promise "
            "one: values may still be those that it began with",
        )


def _untouched(found: Calibration) -> list[FrameResult]:
    """Pictures of the untouched gel, or all where there is none."""
    return [frame for frame in found.frames if frame.use == "background"] or list(found.frames)


def _levels(frames: list[FrameResult]) -> Array:
    """Mean signal of each channel."""
    return np.asarray(np.mean([frame.measured.mean(axis=(0, 1)) for frame in frames], axis=0))
