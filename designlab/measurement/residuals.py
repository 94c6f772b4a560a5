"""How far errors of neighbouring values go together, by what a model leaves of a picture."""

import numpy as np

from designlab.core.types import Array, Mask

BLOCKS_PX = (1, 2, 4, 8, 16)  # within which errors may go together; tried for how far they do
LARGER = 1.1  # variance over that of smaller blocks from which larger ones are needed


def spread_of(left: Array, valid: Mask) -> tuple[Array, int]:
    """How much more sums of residuals vary than if values erred independently by their standard deviation.

    Parameters
    ----------
    left : array, shape (rows, columns, 3)
        Residuals over their standard deviations, 0 where they are not valid.
    valid : bool array, shape (rows, columns, 3)
        Values that count.

    Returns
    -------
    array, shape (3,)
        Variance per value of sums over square blocks, of those blocks where it is largest.
    int
        Side of the smallest blocks (px) whose sums vary about as much as those of any.
    """
    spreads = np.array([_of_blocks(left, valid, size) for size in BLOCKS_PX])
    means = spreads.mean(axis=1)
    needed = next(size for size, mean in zip(BLOCKS_PX, means, strict=True) if mean * LARGER > means.max())
    return spreads.max(axis=0), needed


def _of_blocks(values: Array, valid: Mask, size: int) -> Array:
    """Variance per value of sums over blocks of `size` squared pixels, of each channel."""
    counted = block_sums(valid.astype(float), size).sum(axis=(0, 1))
    return np.asarray((block_sums(values, size) ** 2).sum(axis=(0, 1)) / np.maximum(counted, 1.0))


def block_sums(values: Array, size: int) -> Array:
    """Sums over blocks of `size` squared pixels, those at the last rows and columns smaller."""
    rows, columns = (np.arange(0, count, size) for count in values.shape[:2])
    return np.asarray(np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1))
