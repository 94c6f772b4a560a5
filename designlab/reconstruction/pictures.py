"""Pictures of presses made ready for a calibration: checked, set against the untouched gel, thinned."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from designlab.core.types import Array, Mask

# A ratio to a background darker than this share of its mean would be noise.
_DARKEST = 0.1


def colour_change(image: Array, background: Array) -> Array:
    """Change of colour from the untouched gel, as a share of it; shape (rows, columns, channels)."""
    return np.asarray((image - background) / level_of(background))


def level_of(background: Array) -> Array:
    """What a change of colour is a share of: the untouched gel, but for its darkest corners."""
    return np.asarray(np.maximum(background, _DARKEST * background.mean(axis=(0, 1))))


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
