"""Slopes of each pixel from its channels, by Levenberg and Marquardt; the model is that of `nearfield`."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array

STEEPEST = float(np.tan(np.radians(76.0)))  # slope that is never exceeded, as of the calibrated methods
# Slopes of which the best on each ring is a further start: attached shadow leaves more than one minimum.
_RINGS_DEG, _AZIMUTHS = (25.0, 55.0), 12
_ROUNDS = 40
_DAMPING, _MOST_DAMPING = 1e-3, 1e9
_CONVERGED = 1e-9  # slope
_LEAST_ERROR = float(np.tan(np.radians(0.5)))  # smaller ones would make the integration stiff


class Pixels(NamedTuple):
    """What is known of some pixels; the first axis is that of pixels."""

    facing: Array  # (pixels, groups, 3): product of V with the normal is its first entry plus (p, q) . rest
    base: Array  # (pixels, 2)
    around: Array  # (pixels, groups): what the gel around would throw on a pixel that faced it
    target: Array  # (pixels, channels): signal less the offset
    certainty: Array  # (pixels, channels): 1 / sigma, zero where a channel tells nothing
    steepness: Array  # (pixels,): 1 / slope to be expected

    def of(self, chosen: NDArray[np.generic]) -> "Pixels":
        """Some of them."""
        return Pixels(*(values[chosen] for values in self))


def predicted(pixels: Pixels, mix: Array, slope: Array) -> Array:
    """Signals less the offset, (pixels, channels)."""
    facing, total, length = _turned(pixels, slope)
    light = np.maximum(facing, 0.0) / length
    cosine = _cosine(pixels, total, length)
    return np.asarray((light + (1 - cosine) / 2 * pixels.around) @ mix.T)


def jacobian_of(pixels: Pixels, mix: Array, slope: Array) -> Array:
    """Derivatives of `predicted` by the slopes, (pixels, channels, 2)."""
    facing, total, length = _turned(pixels, slope)
    lit = facing > 0
    light = np.where(lit, facing, 0.0) / length
    cosine = _cosine(pixels, total, length)
    at_rest = length * np.sqrt(1 + (pixels.base**2).sum(axis=-1))[:, None]
    parts = []
    for axis in (0, 1):
        turn = total[:, axis, None] / length**2
        direct = np.where(lit, pixels.facing[..., 1 + axis], 0.0) / length - light * turn
        thrown = (cosine * turn - pixels.base[:, axis, None] / at_rest) / 2 * pixels.around
        parts.append((direct + thrown) @ mix.T)
    return np.stack(parts, axis=-1)


def _turned(pixels: Pixels, slope: Array) -> tuple[Array, Array, Array]:
    """Product of V with the normal, (pixels, groups), slopes with those of the base, and 1 / n_z."""
    facing = pixels.facing[..., 0] + (pixels.facing[..., 1:] @ slope[..., None])[..., 0]
    total = pixels.base + slope
    return facing, total, np.sqrt(1 + (total**2).sum(axis=-1))[:, None]


def _cosine(pixels: Pixels, total: Array, length: Array) -> Array:
    """Cosine of the angle by which the indentation turns the normal, (pixels, 1)."""
    along = 1 + (pixels.base * total).sum(axis=-1)
    return np.asarray(along[:, None] / (length * np.sqrt(1 + (pixels.base**2).sum(axis=-1))[:, None]))


def _cost(pixels: Pixels, mix: Array, slope: Array) -> Array:
    """Squared residuals and slopes in units of their standard deviations, summed, (pixels,)."""
    residual = (pixels.target - predicted(pixels, mix, slope)) * pixels.certainty
    return np.asarray((residual**2).sum(axis=-1) + (slope**2).sum(axis=-1) * pixels.steepness**2)


def solved(pixels: Pixels, mix: Array) -> tuple[Array, Array]:
    """Slopes of least cost, (pixels, 2), and that cost, from a flat start and the best of each ring."""
    slope, cost = _descended(pixels, mix, np.zeros_like(pixels.base))
    channels = (pixels.certainty > 0).sum(axis=-1)
    # A fit as good as noise allows with all groups lit is the only one.
    facing, _, _ = _turned(pixels, slope)
    doubtful = np.flatnonzero(
        (channels >= 2) & ((facing <= 0).any(axis=-1) | (channels < mix.shape[0]) | (cost > 4 * channels))
    )
    some = pixels.of(doubtful)
    for tangent in np.tan(np.radians(_RINGS_DEG)):
        best, least = np.zeros((doubtful.size, 2)), np.full(doubtful.size, np.inf)
        for azimuth in np.arange(_AZIMUTHS) * 2 * np.pi / _AZIMUTHS:
            trial = np.broadcast_to(tangent * np.array([np.cos(azimuth), np.sin(azimuth)]), best.shape)
            found = _cost(some, mix, trial)
            better = found < least
            best[better], least[better] = trial[better], found[better]
        other, lower = _descended(some, mix, best)
        better = lower < cost[doubtful]
        slope[doubtful[better]], cost[doubtful[better]] = other[better], lower[better]
    return slope, cost


def _descended(pixels: Pixels, mix: Array, start: Array) -> tuple[Array, Array]:
    """Slopes after steps of Levenberg and Marquardt, each pixel with its own damping, and their cost."""
    slope, cost = start.copy(), _cost(pixels, mix, start)
    damping = np.full(len(slope), _DAMPING)
    going = np.flatnonzero((pixels.certainty > 0).any(axis=-1))
    for _ in range(_ROUNDS):
        if not going.size:
            break
        some, at = pixels.of(going), slope[going]
        jacobian = jacobian_of(some, mix, at) * some.certainty[..., None]
        residual = (some.target - predicted(some, mix, at)) * some.certainty
        prior = some.steepness**2
        downhill = (jacobian * residual[..., None]).sum(axis=1) - prior[:, None] * at
        xx, xy, yy = _information(jacobian)
        xx, yy = xx + prior, yy + prior
        # Marquardt's scale, with a share of the other slope's so that where nothing responds nothing moves
        held = damping[going] * (xx + yy) + 1e-300
        xx, yy = xx + held, yy + held
        determinant = xx * yy - xy**2
        step = (
            np.stack(
                [
                    yy * downhill[:, 0] - xy * downhill[:, 1],
                    xx * downhill[:, 1] - xy * downhill[:, 0],
                ],
                axis=-1,
            )
            / np.maximum(determinant, 1e-300)[:, None]
        )
        trial = at + step
        trial *= np.minimum(1.0, STEEPEST / np.maximum(np.hypot(*trial.T), 1e-12))[:, None]
        found = _cost(some, mix, trial)
        better = found <= cost[going]
        slope[going[better]], cost[going[better]] = trial[better], found[better]
        damping[going] *= np.where(better, 0.1, 10.0)
        moved = np.hypot(*(trial - at).T)
        going = going[(moved > _CONVERGED) & (damping[going] < _MOST_DAMPING)]
    return slope, cost


def _information(jacobian: Array) -> tuple[Array, Array, Array]:
    """Fisher's information of the two slopes: entries xx, xy and yy, each (pixels,)."""
    x, y = jacobian[..., 0], jacobian[..., 1]
    return (x * x).sum(axis=-1), (x * y).sum(axis=-1), (y * y).sum(axis=-1)


def weights_of(pixels: Pixels, mix: Array, slope: Array, cost: Array) -> Array:
    """Inverse of the expected variance of the slopes, (pixels,)."""
    xx, xy, yy = _information(jacobian_of(pixels, mix, slope) * pixels.certainty[..., None])
    determinant = xx * yy - xy**2
    free = np.maximum((pixels.certainty > 0).sum(axis=-1) - 2, 1)
    known = determinant > 1e-12 * (xx + yy) ** 2
    variance = (xx + yy) / np.where(known, determinant, 1.0) * np.maximum(cost / free, 1.0)
    return np.where(known, 1 / (variance + _LEAST_ERROR**2), 0.0)
