"""What chance leaves in pictures of light that is counted in photons, by spatial frequency."""

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

Array = NDArray[np.float64]
Single = NDArray[np.float32]

BANDS = 12  # of frequency, in which powers are averaged


def coefficients(images: NDArray[np.floating]) -> Array:
    """Orthonormal cosine transform over the last two axes."""
    return np.asarray(dctn(images.astype(float), axes=(-2, -1), norm="ortho"))


def bands(shape: tuple[int, int]) -> NDArray[np.int64]:
    """Number of the band of each coefficient, (rows, columns): equal frequency in all directions."""
    rows, columns = shape
    frequency = np.hypot(np.arange(rows)[:, None] / rows, np.arange(columns) / columns)
    return np.minimum((frequency * BANDS).astype(np.int64), BANDS - 1)


def by_band(squares: Array) -> Array:
    """Mean over each band of squared coefficients (rows, columns), (bands,)."""
    band = bands((squares.shape[0], squares.shape[1])).ravel()
    return np.asarray(np.bincount(band, squares.ravel(), BANDS) / np.bincount(band, minlength=BANDS))


def without_grain(images: Single, light: Single, spread: Single) -> Single:
    """Take from changes of pictures what the chance of two pictures leaves in their difference.

    Optimal linear filter by frequency (Wiener 1949), relative to the light. How much chance is left is told
    by the finer half of the frequencies, where light that goes other ways changes least.

    Parameters
    ----------
    images : array, shape (groups, rows, columns)
        The changes.
    light : array, shape (groups, rows, columns)
        What they are changes of.
    spread : array, shape (repeats, groups, rows, columns)
        Deviations of repeated pictures from their mean.
    """
    found = np.empty_like(images)
    band = bands((images.shape[1], images.shape[2]))
    for group, image in enumerate(images):
        scale = light[group] + 1e-3 * light[group].max()
        change = coefficients(image / scale)
        chance = by_band((coefficients(spread[:, group] / scale) ** 2).mean(axis=0))
        power = by_band(change**2)
        left = (power / chance)[BANDS // 2 :].min()
        kept = np.clip(1.0 - left * chance / np.maximum(power, 1e-300), 0.0, 1.0)
        found[group] = scale * idctn(kept[band] * change, norm="ortho")
    return found
