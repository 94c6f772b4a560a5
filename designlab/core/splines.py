"""Cubic splines through pictures, looked up at places that several pictures share."""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import spline_filter1d

from designlab.core.types import Array

MARGIN = 12  # pixels by which edges are repeated, beyond which they do not change coefficients within


def coefficients(layers: NDArray[np.floating], pad: int) -> Array:
    """Coefficients of cubic B-splines, of pictures continued in proportion beyond their edges.

    Parameters
    ----------
    layers : array, shape (n, rows, columns)
        Pictures.
    pad : int
        By how many pixels they are continued, point-symmetrically about the edge; further out they are even.

    Returns
    -------
    array, shape (n, rows + 2 (pad + `MARGIN`), columns + 2 (pad + `MARGIN`))
    """
    sides = (0, 0), (pad, pad), (pad, pad)
    wide = np.pad(np.asarray(layers, dtype=float), sides, mode="reflect", reflect_type="odd")
    wide = np.pad(wide, ((0, 0), (MARGIN, MARGIN), (MARGIN, MARGIN)), mode="edge")
    for axis in (1, 2):
        wide = spline_filter1d(wide, order=3, axis=axis, mode="nearest")
    return np.asarray(wide)


def look_up(found: Array, place: Array, pad: int) -> Array:
    """Values of splines at places.

    Parameters
    ----------
    found : array
        What `coefficients` gave for `pad`.
    place : array, shape (2, ...)
        Rows and columns, of pictures without their continuation.

    Returns
    -------
    array, shape (n, ...)
    """
    row, column = (np.ravel(part) + (pad + MARGIN) for part in place)
    return np.asarray(_look_up(found, row, column).reshape(len(found), *place.shape[1:]))


@njit(cache=True)
def _look_up(found: Array, row: Array, column: Array) -> Array:
    layers, rows, columns = found.shape
    values = np.empty((layers, len(row)))
    across, along = np.empty(4), np.empty(4)
    for n in range(len(row)):
        # Beyond the edges that are repeated nothing changes any more.
        r, c = min(max(row[n], 1.0), rows - 2.0), min(max(column[n], 1.0), columns - 2.0)
        i, j = min(int(r), rows - 3), min(int(c), columns - 3)
        _weights(r - i, across)
        _weights(c - j, along)
        for layer in range(layers):
            total = 0.0
            for k in range(4):
                line = found[layer, i - 1 + k]
                total += across[k] * (
                    along[0] * line[j - 1]
                    + along[1] * line[j]
                    + along[2] * line[j + 1]
                    + along[3] * line[j + 2]
                )
            values[layer, n] = total
    return values


@njit(cache=True)
def _weights(t: float, weights: Array) -> None:
    """Cubic B-splines of four neighbours, a share `t` beyond the second."""
    rest = 1.0 - t
    weights[0] = rest * rest * rest / 6.0
    weights[1] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
    weights[2] = (4.0 - 6.0 * rest * rest + 3.0 * rest * rest * rest) / 6.0
    weights[3] = t * t * t / 6.0
