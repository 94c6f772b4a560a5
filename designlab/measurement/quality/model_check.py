"""A set of frames beside the pictures of a model, before anything is fitted to it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from designlab.core.types import Array
from designlab.measurement.quality.invariants import FrameCheck
from designlab.measurement.quality.odd_presses import ModelPictures, odd_presses
from designlab.measurement.quality.picture_faults import coarse, faults, lights_of_others, misfit
from designlab.measurement.quality.suspicion import Suspicion
from designlab.measurement.shots import Shot


class ModelCheck(NamedTuple):
    """What a model as given shows of frames: what is suspicious, and how far it misses them."""

    suspicions: tuple[Suspicion, ...]
    missed: FrameCheck


def against_model(
    shots: Sequence[Shot],
    bases: Sequence[Array],
    *,
    black: Array,
    transfer: Array,
    response: str,
    others: ModelPictures | None = None,
) -> ModelCheck:
    """Look for faults of pictures, then for presses that are not as stated.

    Parameters
    ----------
    shots : sequence of Shot
        Shots with LEDs on, black level taken away.
    bases : sequence of array, shape (groups, rows, columns)
        Picture of each LED group at unit flux for every shot, by the model.
    black : array, shape (3,)
        Black level.
    transfer : array, shape (3, groups)
        Light of the groups in the channels by the model, in any unit.
    response : str
        Response that the files are declared to have.
    others : ModelPictures, optional
        Simulates other presses; without it only faults of pictures are looked for, since poses that are
        still to be fitted may be off.
    """
    pictures = [coarse(shot, basis) for shot, basis in zip(shots, bases, strict=True)]
    found = faults(pictures, black, transfer, response)
    missed = [
        0.0 if light is None or not one.valid.any() else misfit(one, light)
        for one, light in zip(pictures, lights_of_others(pictures), strict=True)
    ]
    if others is not None and not found:
        found = odd_presses(shots, pictures, missed, black, others)
    return ModelCheck(found, FrameCheck("model as given", not found, _figure(shots, missed)))


def _figure(shots: Sequence[Shot], missed: Sequence[float]) -> str:
    kinds = {"untouched gel": False, "presses": True}
    parts = [
        f"{name} {np.median(ours):.2g} (at most {max(ours):.2g})"
        for name, pressed in kinds.items()
        if (ours := [m for s, m in zip(shots, missed, strict=True) if (s.press is not None) == pressed])
    ]
    return f"misses, in units of noise and 1 % of the mean: {', '.join(parts)}"
