"""Light of pictures in closed form: transfer from LED groups to channels, and a floor, none negative.

signal[channel] = sum over groups of transfer[channel, group] x lit[group] x basis[group] + floor[channel]
"""

from collections.abc import Iterable

import numpy as np

from designlab.core.types import Array, Mask
from designlab.simulation.imaging import mixed

MODEL_ERROR = 0.01  # of a channel's mean signal in a shot: what a simulation is not trusted with
RELATIVE_RANK = 1e-13  # eigenvalue over the largest, below which pictures do not change in a direction


def predicted(transfer: Array, floor: Array, lit: Array, basis: Array) -> Array:
    """Signal, (rows, columns, 3), from unit-power pictures (groups, rows, columns)."""
    return np.asarray(mixed(basis, transfer * lit) + floor)


def transfer_and_floor(equations: Iterable[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Weighted least squares over all shots, without negative values (Lawson and Hanson 1974, NNLS).

    Parameters
    ----------
    equations : iterable of (array, array)
        The `normal_equations` of each shot.

    Returns
    -------
    transfer, floor : array, shapes (3, groups) and (3,)
        A group that was never on gets zero.
    """
    return solved(*(np.sum(parts, axis=0) for parts in zip(*equations, strict=True)))


def normal_equations(
    basis: Array, lit: Array, signal: Array, sigma: Array, valid: Mask
) -> tuple[Array, Array]:
    """Matrices (3, groups + 1, groups + 1) and right sides (3, groups + 1) of one shot, which add up.

    Parameters
    ----------
    basis : array, shape (groups, rows, columns)
        Pictures at unit power.
    lit : array, shape (groups,)
        Relative exposure times whether a group is on.
    signal, sigma, valid : array, shape (rows, columns, 3)
        Measured values, their standard deviations, and which count.
    """
    groups = len(lit)
    matrix, right = np.zeros((3, groups + 1, groups + 1)), np.zeros((3, groups + 1))
    for channel in range(3):
        used = valid[..., channel]
        weight = 1.0 / sigma[..., channel][used]
        columns = np.vstack([lit[:, None] * basis[:, used] * weight, weight])
        matrix[channel] = columns @ columns.T
        right[channel] = columns @ (signal[..., channel][used] * weight)
    return matrix, right


def solved(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Transfer and floor from summed normal equations."""
    found = np.stack([_nonnegative(*each) for each in zip(matrix, right, strict=True)])
    return found[:, :-1], found[:, -1]


def _nonnegative(matrix: Array, right: Array) -> Array:
    """Minimise x' matrix x / 2 - right' x over x >= 0; unknowns that the matrix does not see are zero."""
    from scipy.optimize import nnls

    scale = np.sqrt(np.diag(matrix))
    seen = scale > 0
    found = np.zeros(len(right))
    if not seen.any():
        return found
    values, vectors = np.linalg.eigh(matrix[np.ix_(seen, seen)] / np.outer(scale[seen], scale[seen]))
    kept = values > RELATIVE_RANK * values[-1]
    root = np.sqrt(values[kept])
    projected = vectors[:, kept].T @ (right[seen] / scale[seen])
    found[seen] = nnls(root[:, None] * vectors[:, kept].T, projected / root)[0] / scale[seen]
    return found
