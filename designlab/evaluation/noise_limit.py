"""The noise limit (Cramer-Rao bound) is the least tilt that a picture could tell from the camera's noise.

For a known background the only unknowns of a pixel are the two slopes. With J the response of its channels
to them and S the covariance of the camera's noise, no unbiased estimate scatters less than (J' S^-1 J)^-1
(Cramer and Rao); the root of its trace is the tilt of a flat membrane that noise alone makes up.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array

GENTLEST, STEEPEST = 0.02, 0.35  # slopes between which the response is taken as quadratic
NO_INFORMATION_DEG = 90.0
RINGS, AZIMUTHS = 3, 8  # slopes at which a pressed membrane is looked at


def responses(
    signals: Sequence[NDArray[np.floating]],
    background: NDArray[np.floating],
    gradients: Sequence[tuple[Array, Array]],
    x_mm: Array,
    y_mm: Array,
) -> list[Array]:
    """Response of a flat membrane's picture to slope, fitted to presses of known shape.

    The first one is fitted to all presses, each further one without one press in turn.

    Relative to the background the response is a quadratic polynomial in position, which absorbs most of how
    light falls off; terms of second order keep steeper pixels from biasing it.

    Parameters
    ----------
    signals : sequence of arrays, shape (rows, columns, channels)
        Pictures of presses without camera noise.
    background : array, shape (rows, columns, channels)
        The untouched gel.
    gradients : sequence of pairs of arrays, shape (rows, columns)
        Slopes p = dz/dx and q = dz/dy of each press.
    x_mm, y_mm : array, shape (rows, columns)
        Membrane point that each pixel sees.

    Returns
    -------
    list of arrays, shape (rows, columns, channels, 2)
        Change of signal per unit of p and of q.
    """
    background = np.asarray(background, dtype=float)
    position = _position_terms(x_mm, y_mm)
    matrices, rights = [], []
    for signal, (p, q) in zip(signals, gradients, strict=True):
        slope = np.hypot(p, q)
        used = (slope > GENTLEST) & (slope < STEEPEST) & (background > 0).all(axis=-1)
        # A Lambertian membrane is linear in the components of its unit normal, not in its slopes.
        u, v = (component[used, None] / np.sqrt(1 + slope[used, None] ** 2) for component in (p, q))
        at = position[used]
        terms = np.concatenate([u * at, v * at, u**2, u * v, v**2], axis=1)
        matrices.append(terms.T @ terms)
        rights.append(terms.T @ (signal[used] / background[used] - 1.0))
    matrix, right = np.sum(matrices, axis=0), np.sum(rights, axis=0)
    left_out = [(matrix - m, right - r) for m, r in zip(matrices, rights, strict=True)]
    count, found = position.shape[-1], []
    for normal, moment in [(matrix, right), *left_out]:
        weights, *_ = np.linalg.lstsq(normal, moment, rcond=None)
        relative = np.stack([position @ weights[:count], position @ weights[count : 2 * count]], axis=-1)
        found.append(np.asarray(background[..., None] * relative))
    return found


def noise_limit_deg(response: Array, sigma: Array) -> Array:
    """Least tilt (deg) that camera noise makes up on a flat membrane, shape (rows, columns); 90 at most.

    Parameters
    ----------
    response : array, shape (rows, columns, channels, 2)
        Change of signal per unit of slope.
    sigma : array, shape (rows, columns, channels)
        Standard deviation of the camera's noise.
    """
    along_x, along_y = (response[..., k] / sigma for k in (0, 1))
    # Fisher's information of the two slopes
    xx, xy, yy = (
        (a * b).sum(axis=-1) for a, b in ((along_x, along_x), (along_x, along_y), (along_y, along_y))
    )
    determinant = xx * yy - xy**2
    with np.errstate(divide="ignore", invalid="ignore"):
        tilt = np.degrees(np.sqrt((xx + yy) / determinant))
    return np.asarray(np.minimum(np.where(determinant > 0, tilt, np.inf), NO_INFORMATION_DEG))


def pressed_limit_deg(
    light: Array, response: Array, mix: Array, sigma: Callable[[Array], Array], *, steepest_deg: float
) -> Array:
    """Noise limit (deg) of a pressed membrane: geometric mean over slopes, shape (points,).

    The slopes are evenly spread over a disc of angles up to the steepest. Each group's light stands for
    distant light of the same effect on the untouched membrane, so slopes that turn away from it get none
    (attached shadow). Where too few channels respond, or all are at full scale, the limit is 90 deg.

    Parameters
    ----------
    light : array, shape (points, groups)
        Of the untouched membrane.
    response : array, shape (points, groups, 2)
        Change of that light per unit of slope along x and y.
    mix : array, shape (channels, groups)
        Signal of each channel per unit of light.
    sigma : callable
        Standard deviation of the camera's noise for a signal (points, channels); infinite at full scale.
    steepest_deg : float
        Steepest slope.
    """
    total = np.zeros(len(light))
    for ring in range(RINGS):
        # Rings of equal area.
        tangent = np.tan(np.radians(steepest_deg) * np.sqrt((ring + 0.5) / RINGS))
        length = np.hypot(1.0, tangent)
        for azimuth in (np.arange(AZIMUTHS) + 0.5 * (ring % 2)) * 2 * np.pi / AZIMUTHS:
            uphill = np.array([np.cos(azimuth), np.sin(azimuth)])
            across = np.array([-uphill[1], uphill[0]])
            towards = light + tangent * response @ uphill
            lit = towards > 0
            shaded = np.where(lit, towards / length, 0.0)
            slopes = response / length - (towards / length**3)[..., None] * tangent * uphill
            # From slopes to angles of the normal, uphill and across.
            turns = np.stack([length**2 * uphill, length * across], axis=-1)
            changes = np.where(lit[..., None], slopes @ turns, 0.0)
            jacobian = np.tensordot(changes, mix, axes=(1, 1)).swapaxes(1, 2)
            total += np.log(noise_limit_deg(jacobian, sigma(shaded @ mix.T)))
    return np.asarray(np.exp(total / (RINGS * AZIMUTHS)))


def _position_terms(x_mm: Array, y_mm: Array) -> Array:
    """1, x, y, x^2, xy, y^2 of positions brought to -1..1, along a new last axis."""
    x, y = (2 * (v - v.min()) / np.ptp(v) - 1 for v in (x_mm, y_mm))
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
