"""Denoising of pictures traced with few photons: a Wiener filter by spatial frequency."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from designlab.core.types import Array, Single

BANDS = 24  # of frequency, in which powers are averaged
LEAST_LIGHT = 1e-3  # of the brightest: what is darker counts as this
DEGREE, DEGREE_OF_CHANGE = 6, 3  # of polynomials that follow light without its structure, and its changes


def coefficients(images: NDArray[np.floating]) -> Array:
    """Orthonormal cosine transform over the last two axes."""
    return np.asarray(dctn(images.astype(float), axes=(-2, -1), norm="ortho"))


def bands(shape: tuple[int, int]) -> NDArray[np.int64]:
    """Number of the band of each coefficient, (rows, columns): equal frequency in all directions.

    Small pictures have fewer: none is empty.
    """
    rows, columns = shape
    count = min(BANDS, max(shape))
    frequency = np.hypot(np.arange(rows)[:, None] / rows, np.arange(columns) / columns)
    return np.minimum((frequency * count + 1e-9).astype(np.int64), count - 1)


def by_band(squares: Array) -> Array:
    """Mean over each band of squared coefficients (rows, columns), (bands,)."""
    band = bands((squares.shape[0], squares.shape[1])).ravel()
    return np.asarray(np.bincount(band, squares.ravel()) / np.bincount(band))


@dataclass(frozen=True, eq=False)
class Denoiser:
    """Monte Carlo noise of the picture of the untouched gel, relative to its light; all pictures share it.

    Attributes
    ----------
    factor : array, shape (groups, rows, columns)
        That takes it from any picture of the sensor.
    removed : array, shape (repeats, groups, rows, columns)
        Part of the relative deviation of every repeat that is removed with it.
    """

    factor: Single
    removed: Single


def fit_denoiser(repeated: Single) -> Denoiser:
    """Tell the structure of light from Monte Carlo noise by frequency (Wiener 1949).

    Parameters
    ----------
    repeated : array, shape (repeats, groups, rows, columns)
        Pictures of the untouched gel with other random numbers.
    """
    mean = repeated.mean(axis=0)
    repeats, groups, *shape = repeated.shape
    band = bands((shape[0], shape[1]))
    factor, removed = np.empty_like(mean), np.empty_like(repeated)
    for group in range(groups):
        light = np.maximum(mean[group], LEAST_LIGHT * mean[group].max())
        broad = np.exp(_polynomial(np.log(light), DEGREE))  # light without its structure
        structure = coefficients(light / broad - 1.0)
        spread = coefficients((repeated[:, group] - mean[group]) / broad)
        noise = by_band((spread**2).sum(axis=0)) / (repeats * (repeats - 1))
        kept = np.clip(1.0 - noise / np.maximum(by_band(structure**2), 1e-300), 0.0, 1.0)
        found = broad * (1.0 + idctn(kept[band] * structure, norm="ortho"))
        factor[group] = found / light
        # The root: structure that is lost errs as well, and both together have this variance.
        lost = idctn((1.0 - np.sqrt(kept[band])) * spread, axes=(-2, -1), norm="ortho")
        removed[:, group] = broad / light * lost
    return Denoiser(factor, removed)


def _polynomial(image: NDArray[np.floating], degree: int) -> Array:
    """Least-squares polynomial in both coordinates: a cosine transform takes slopes at borders for edges."""
    down, across = (
        np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1, 1, n), degree))[0] for n in image.shape
    )
    return np.asarray(down @ (down.T @ image @ across) @ across.T)


def denoised_change(change: Single, drawn: Single, light: Single, spread: Single) -> Single:
    """Remove Monte Carlo noise from the change of a picture.

    The noise of the picture itself is in change and picture alike and cancels in their ratio. Where photons
    go other ways there is more: it is filtered by frequency (Wiener 1949). How much that is, the finer half
    of the frequencies tells, where light that goes other ways changes least.

    Parameters
    ----------
    change : array, shape (groups, rows, columns)
        Difference of two pictures with the same random numbers.
    drawn : array, shape (groups, rows, columns)
        The picture that it is a change of.
    light : array, shape (groups, rows, columns)
        The same with as little noise as is known, what the change is put on.
    spread : array, shape (repeats, groups, rows, columns)
        Deviations of repeated pictures from their mean.
    """
    found = np.empty_like(change)
    band = bands((change.shape[1], change.shape[2]))
    for group, image in enumerate(share_of(change, drawn)):
        broad = _polynomial(image, DEGREE_OF_CHANGE)
        rest = coefficients(image - broad)
        noise = by_band((coefficients(share_of(spread[:, group], light[group])) ** 2).mean(axis=0))
        power = by_band(rest**2)
        left = np.median((power / np.maximum(noise, 1e-300))[len(power) // 2 :])
        kept = np.clip(1.0 - left * noise / np.maximum(power, 1e-300), 0.0, 1.0)
        found[group] = light[group] * (broad + idctn(kept[band] * rest, norm="ortho"))
    return found


def share_of(images: Single, light: Single) -> Array:
    """Images relative to light, where that is not dark."""
    least = LEAST_LIGHT * light.max(axis=(-2, -1), keepdims=True)
    return np.asarray(images / np.maximum(light, least), dtype=float)
