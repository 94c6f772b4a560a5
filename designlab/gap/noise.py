"""How far a perfect model may miss: noise of the camera, and the error the simulation is granted.

The granted error has four parts. Three are white, shares of the signal, of its curvature and of what a press
changes: they belong to the standard deviation of every value. The fourth is smooth over the picture and the
same in all frames, as that of a light source known to a limited accuracy is; fits count it as covariance, so
that small effects of large pictures are not taken for certain.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn
from scipy.ndimage import gaussian_laplace

from designlab.measurement.shots import Shot

Array = NDArray[np.float64]

# Two programs that share no code agree to 0.1 % (rms) on balls and differ by 2 % of the curvature at edges.
SIGNAL_BUDGET = 0.0015
EDGE_BUDGET = 0.03
CONTACT_BUDGET = 0.02  # share of what a press changes: neither probe nor contact model are better known
SMOOTH_BUDGET = 0.005  # smooth error common to all frames, relative: what no catalogue lists, too
SHOT_BUDGET = 0.001  # smooth error of each frame, relative
SMOOTH_LENGTH = 0.15  # of smooth errors, over the picture's width
EDGE_WIDTH_PX = 0.7
DARK_LIGHT = 0.03  # of full scale: below, smooth errors are absolute


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviations of a shot's values.

    Attributes
    ----------
    sigma : array, shape (rows, columns, 3)
        Of a value: camera and white errors of the simulation.
    camera : array, shape (rows, columns, 3)
        Of the camera alone.
    granted : array, shape (rows, columns, 3)
        Of camera and smooth errors: what a model that is right is expected to miss by.
    level : array, shape (3,)
        Root mean square of signal over sigma, what smooth relative errors are multiples of.
    """

    sigma: Array
    camera: Array
    granted: Array
    level: Array


def noise(shot: Shot, predicted: Array, untouched: Array, black: Array | float) -> Noise:
    """Noise of a shot about a prediction, and about that of the untouched gel (rows, columns, 3)."""
    light = predicted - black
    curvature = np.stack([gaussian_laplace(light[..., c], EDGE_WIDTH_PX) for c in range(3)], axis=-1)
    budget = np.hypot(SIGNAL_BUDGET * light, EDGE_BUDGET * curvature)
    budget = np.hypot(budget, CONTACT_BUDGET * (predicted - untouched))
    camera = np.sqrt(shot.variance)
    sigma = np.hypot(camera, budget)
    lit = np.hypot(light, DARK_LIGHT)
    level = np.sqrt(np.where(shot.valid, (lit / sigma) ** 2, 0.0).mean(axis=(0, 1)))
    granted = np.hypot(camera, np.hypot(SMOOTH_BUDGET, SHOT_BUDGET) * lit)
    return Noise(sigma, camera, granted, level)


def spectrum(shape: tuple[int, int]) -> Array:
    """Power of a smooth error of unit variance in the coefficients of a cosine transform, (rows, columns)."""
    rows, columns = shape
    length_px = SMOOTH_LENGTH * columns
    ky, kx = np.pi * np.arange(rows) / rows, np.pi * np.arange(columns) / columns
    power = np.exp(-((ky[:, None] ** 2 + kx[None, :] ** 2) * length_px**2) / 2)
    return np.asarray(power / power.mean())


def transformed(values: NDArray[np.floating]) -> NDArray[np.float32]:
    """Orthonormal cosine transform over rows and columns of (rows, columns, ...)."""
    return np.asarray(dctn(values.astype(np.float32), axes=(0, 1), norm="ortho"), dtype=np.float32)
