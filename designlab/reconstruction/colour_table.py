"""The maps of a calibration as one table over colour and place, which is read in place of them."""

import itertools
from collections.abc import Callable
from typing import NamedTuple, Self

import numpy as np
from numba import njit
from numpy.typing import NDArray

from designlab.core.types import Array, Single

COLOURS = 3
OUTPUTS = 5
MARGIN = 0.5  # beyond the colours that the balls showed, in their spreads
STEP = 0.2  # of the table, in spreads of the colour; a kernel is 1.5 wide
MOST_STEPS = 24  # on either side of the untouched gel
PLACES = (5, 5)  # rows and columns of places; kernels are 0.7 pictures wide or more


class ColourTable(NamedTuple):
    """Values of maps at nodes of colour and place; between the nodes they are interpolated linearly.

    Attributes
    ----------
    values : array of float32, shape (rows, columns, nodes, nodes, nodes, 5)
        Outputs at places that are evenly spread over the picture, and at changes of each colour.
    zero, step : array of float32, shape (3,)
        Node of each colour at which nothing has changed, so that what the maps say of the untouched gel stays
        exact; and distance of the nodes, in the unit of the maps.
    """

    values: Single
    zero: Single
    step: Single

    @classmethod
    def of(cls, outputs: Callable[[Array, Array], NDArray[np.floating]], taught: Array) -> Self:
        """Tabulate maps.

        Parameters
        ----------
        outputs : callable
            From changes of colour (N, 3) and a place (2,) in -1..1 to `OUTPUTS` outputs each.
        taught : array, shape (samples, 3)
            Changes of colour that balls showed; the table reaches a little beyond them.

        Raises
        ------
        ValueError
            If the pictures have other than three colours.
        """
        if taught.shape[1] != COLOURS:
            raise ValueError(f"mode: video needs pictures of {COLOURS} colours, got {taught.shape[1]}")
        nodes = []
        for own in taught.T:
            below, above = max(-float(own.min()), 0.0) + MARGIN, max(float(own.max()), 0.0) + MARGIN
            step = max(STEP, max(below, above) / MOST_STEPS)
            nodes.append(step * np.arange(-np.ceil(below / step), np.ceil(above / step) + 1))
        colour = np.stack(np.meshgrid(*nodes, indexing="ij"), axis=-1).reshape(-1, COLOURS)
        down, across = (np.linspace(-1, 1, count) for count in PLACES)
        shape = (*map(len, nodes), OUTPUTS)
        values = np.stack(
            [
                _levelled(
                    np.asarray(outputs(colour, np.array([x, y]))).reshape(shape),
                    colour.reshape(*shape[:3], 3),
                )
                for y, x in itertools.product(-down, across)
            ]
        )
        return cls(
            np.ascontiguousarray(values.reshape(*PLACES, *shape), dtype=np.float32),
            np.array([np.abs(each).argmin() for each in nodes], dtype=np.float32),
            np.array([each[1] - each[0] for each in nodes], dtype=np.float32),
        )

    def __call__(self, change: Single) -> Single:
        """Outputs of each pixel, shape (rows, columns, `OUTPUTS`).

        Parameters
        ----------
        change : array of float32, shape (rows, columns, 3)
            Changes of colour all over the picture; those beyond the table count as at its border.
        """
        found = np.empty((*change.shape[:2], OUTPUTS), dtype=np.float32)
        _interpolate(
            self.values.reshape(-1, OUTPUTS), self.values.shape[:-1], self.zero, self.step, change, found
        )
        return found


def _levelled(values: NDArray[np.floating], colour: Array) -> NDArray[np.floating]:
    """Nodes moved so that what is interpolated linearly between them is right on average, not always flat.

    That is a twelfth of the second difference; the untouched gel's node stays.
    """
    away: NDArray[np.bool_] = np.abs(colour).max(axis=-1) > 1e-9
    moved = values.copy()
    for axis in range(COLOURS):
        second = np.diff(values, n=2, axis=axis, append=0, prepend=0)
        np.moveaxis(second, axis, 0)[[0, -1]] = 0
        moved -= away[..., None] * second / 12
    return moved


@njit(cache=True, nogil=True, fastmath=True)
def _node(at: np.float32, nodes: int) -> tuple[int, np.float32]:
    """Node below a place, and how far the place is beyond it."""
    at = min(max(at, np.float32(0)), np.float32(nodes - 1))
    below = min(int(at), nodes - 2)
    return below, at - np.float32(below)


@njit(cache=True, nogil=True, fastmath=True)
def _interpolate(
    values: Single, nodes: tuple[int, ...], zero: Single, step: Single, change: Single, found: Single
) -> None:
    rows, columns = change.shape[:2]
    # distances of neighbours in each direction, in nodes; those of the last colour are 1
    by_1 = nodes[4]
    by_0 = nodes[3] * by_1
    by_column = nodes[2] * by_0
    by_row = nodes[1] * by_column
    one = np.float32(1)
    for row in range(rows):
        place_row, below = _node(np.float32(row * (nodes[0] - 1) / (rows - 1)), nodes[0])
        for column in range(columns):
            place, right = _node(np.float32(column * (nodes[1] - 1) / (columns - 1)), nodes[1])
            node_0, more_0 = _node(change[row, column, 0] / step[0] + zero[0], nodes[2])
            node_1, more_1 = _node(change[row, column, 1] / step[1] + zero[1], nodes[3])
            node_2, more_2 = _node(change[row, column, 2] / step[2] + zero[2], nodes[4])
            first = place_row * by_row + place * by_column + node_0 * by_0 + node_1 * by_1 + node_2
            a = b = c = d = e = np.float32(0)
            for corner in range(16):
                weight = below if corner & 8 else one - below
                weight *= right if corner & 4 else one - right
                weight *= more_0 if corner & 2 else one - more_0
                weight *= more_1 if corner & 1 else one - more_1
                at = first + (corner >> 3 & 1) * by_row + (corner >> 2 & 1) * by_column
                at += (corner >> 1 & 1) * by_0 + (corner & 1) * by_1
                low_2, high_2 = weight * (one - more_2), weight * more_2
                a += low_2 * values[at, 0] + high_2 * values[at + 1, 0]
                b += low_2 * values[at, 1] + high_2 * values[at + 1, 1]
                c += low_2 * values[at, 2] + high_2 * values[at + 1, 2]
                d += low_2 * values[at, 3] + high_2 * values[at + 1, 3]
                e += low_2 * values[at, 4] + high_2 * values[at + 1, 4]
            found[row, column, 0] = a
            found[row, column, 1] = b
            found[row, column, 2] = c
            found[row, column, 3] = d
            found[row, column, 4] = e
