"""One picture as three: alternate blocks of it are fitted to, judge, and give the last numbers."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.measurement.shots import POSE, Observations, Use

Uses = NDArray[np.intp]

TRAIN, SELECT, FINAL = 0, 1, 2
USES: tuple[Use, Use, Use] = ("train", "select", "final")
BLOCKS = 15  # across a picture: some 10 pixels each, several times as far as neighbouring values are alike
NORMAL_MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


def block_numbers(rows: int, columns: int) -> tuple[Uses, Uses]:
    """Row and column of the block that every pixel belongs to, (rows, 1) and (1, columns)."""
    down = max(round(rows / columns * BLOCKS), 1)
    row, column = np.arange(rows) * down // rows, np.arange(columns) * BLOCKS // columns
    return row[:, None], column[None, :]


def block_uses(rows: int, columns: int, *, parity: int = 0) -> Uses:
    """What every pixel serves: fields of one colour of a chessboard fit, the others judge and end in turn.

    Parameters
    ----------
    parity : int
        0 or 1: which colour is fitted to.
    """
    row, column = block_numbers(rows, columns)
    other = (row + column + parity) % 2
    return np.asarray(np.where(other == 0, TRAIN, np.where((row + column // 2) % 2, FINAL, SELECT)))


def in_blocks(seen: Observations, *, parity: int = 0) -> Observations:
    """Replace the only press by one shot for each use of its blocks.

    Without repeats noise is not known. What neighbouring values differ by, noise and grain of the coating
    together, stands for it.
    """
    (shot,) = (s for s in seen.shots if s.lit.any() and s.ball is None)
    uses = block_uses(*shot.signal.shape[:2], parity=parity)
    variance = shot.variance + (grain(shot.signal) * shot.signal) ** 2
    shots = tuple(
        replace(
            shot,
            use=use,
            variance=variance,
            valid=shot.valid & (uses == number)[..., None],
            pose_sigma=shot.pose_sigma if number == TRAIN else np.zeros(len(POSE)),
        )
        for number, use in enumerate(USES)
    )
    return replace(seen, shots=shots, noise_source="camera description and grain of the picture")


def grain(signal: Array) -> Array:
    """Relative fluctuation of neighbouring values of each channel, (3,); slopes and edges do not count."""
    bends = signal[:, 2:] - 2 * signal[:, 1:-1] + signal[:, :-2]
    relative = np.abs(bends) / np.maximum(signal[:, 1:-1], np.finfo(float).tiny)
    return np.asarray(NORMAL_MAD * np.median(relative, axis=(0, 1)) / np.sqrt(6))
