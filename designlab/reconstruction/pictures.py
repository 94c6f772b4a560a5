"""Pictures of presses made ready for a calibration: checked, set against the untouched gel, thinned."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from designlab.core.types import Array, Mask

# A ratio to a background darker than this share of its mean would be noise.
_DARKEST = 0.1
NOISE_LEFT = 0.015  # of the change of colour in contacts: a degree, which the regression averages further
SMOOTHING_PX = 0.7, 2.0  # least, below which a Gaussian on pixels averages little, and most


def colour_change(image: Array, background: Array) -> Array:
    """Change of colour from the untouched gel, as a share of it; shape (rows, columns, channels)."""
    return np.asarray((image - background) / level_of(background))


def level_of(background: Array) -> Array:
    """What a change of colour is a share of: the untouched gel, but for its darkest corners."""
    return np.asarray(np.maximum(background, _DARKEST * background.mean(axis=(0, 1))))


def smoothed(values: Array, sigma_px: float, mask: Mask | None = None) -> Array:
    """Gaussian smoothing over the pixels of the mask only, shape (rows, columns, channels)."""
    sigma = (sigma_px, sigma_px, 0)
    if mask is None:
        return np.asarray(gaussian_filter(values, sigma, mode="nearest")) if sigma_px else values.copy()
    share = gaussian_filter(mask.astype(float), max(sigma_px, 0.5), mode="nearest")[..., None]
    sigma = (max(sigma_px, 0.5), max(sigma_px, 0.5), 0)
    total = gaussian_filter(np.where(mask[..., None], values, 0.0), sigma, mode="nearest")
    return np.asarray(np.where(share > 1e-3, total / np.maximum(share, 1e-3), 0.0))


def smoothing_for(shares: Sequence[float]) -> float:
    """Gaussian smoothing (px) that leaves little of the pictures' noise, and blurs edges no more than that.

    Parameters
    ----------
    shares : sequence of float
        `noise_share` of each calibration press.
    """
    least, most = SMOOTHING_PX
    # white noise falls to 1 / (2 sigma sqrt(pi)) of itself
    needed = float(np.median(shares)) / (2 * math.sqrt(math.pi) * NOISE_LEFT)
    return min(needed, most) if needed > least else 0.0


def noise_share(noise: Array, change: Array, contact: Mask) -> float:
    """Noise of a pixel as a share of the change of colour in a contact, over all channels.

    Parameters
    ----------
    noise : array, shape (rows, columns, channels)
        What is noise of the change of colour; few pixels that differ more do not count.
    change : array, same shape
        Change of colour.
    contact : bool array, shape (rows, columns)
        Where the probe touches; 0 is told where it touches nowhere.
    """
    if not contact.any():
        return 0.0
    spread = np.sqrt((change[contact] ** 2).mean(axis=0))
    usual = 1.4826 * np.median(np.abs(noise), axis=(0, 1))
    return float(np.sqrt(((usual / np.maximum(spread, 1e-9)) ** 2).mean()))


def thinned(pixels: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """At most `count` of the pixels, evenly spread over the list."""
    if pixels.size <= count:
        return pixels
    return pixels[np.linspace(0, pixels.size - 1, count).round().astype(np.intp)]


def checked_image(image: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """Finite image of a given shape; the error names it."""
    image = np.asarray(image, dtype=float)
    if image.ndim != 3 or image.shape != shape:
        raise ValueError(f"{name}: must have shape (rows, columns, channels) {shape}, got {image.shape}")
    if not np.isfinite(image).all():
        raise ValueError(f"{name}: values must be finite, {int((~np.isfinite(image)).sum())} are not")
    return image


def check_filled(filled: Mask | None, shape: tuple[int, ...]) -> None:
    """Refuse pixels that were filled in that are not bool of a given shape (rows, columns)."""
    if filled is not None and (filled.shape != shape or filled.dtype != bool):
        raise ValueError(f"filled: must be bool of shape {shape}, got {filled.dtype} of {filled.shape}")


def check_mask(mask: Mask | None, shape: tuple[int, ...]) -> None:
    """Refuse a mask of pixels to use that is not bool of a given shape (rows, columns), or is empty."""
    if mask is not None and (mask.shape != shape or mask.dtype != bool or not mask.any()):
        raise ValueError(f"mask: must be bool of shape {shape} with a pixel to use")


def centred(position_mm: ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    """Positions brought to -1..1."""
    position_mm = np.asarray(position_mm, dtype=float)
    if position_mm.shape != shape[:2] or not np.isfinite(position_mm).all():
        raise ValueError(f"{name}: must be finite of shape {shape[:2]}, got shape {position_mm.shape}")
    low, high = position_mm.min(), position_mm.max()
    if low == high:
        raise ValueError(f"{name}: must vary over the image, it is {low:g} mm everywhere")
    return np.asarray((2 * position_mm - low - high) / (high - low))
