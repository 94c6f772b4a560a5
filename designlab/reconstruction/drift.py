"""What has changed since the untouched gel: brightness, white balance, place; what of it is corrected."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, zoom

from designlab.core.types import Array, Mask

BLOCK_PX = 8  # blocks over which brightness is compared
ALIKE = 0.04  # ratios of brightness that differ by less in every colour are of gel that nothing touches
CANDIDATES = 50  # blocks that are tried for its ratio
COUNTED = 1200  # blocks among which the others that share it are counted
ROUNDS = 4
ENOUGH = 0.2  # share of the picture from which the ratio is that of the untouched gel
SURE = 0.01  # standard error of the ratio from which it is not known
INDEPENDENT = 9  # blocks that err alike: the light's unevenness, compressed video
EDGE = 3  # blocks over which what is touched is faded out
STANDS_OUT = 8  # standard deviations of the correlation from which a shift is one
MOVED_PX = 1.0  # of the untouched gel
PRESS_MOVED_PX = 2.0  # of the gel beside a press, which may drag it along by a pixel
DRIFTED = 0.03  # change of the light, relative, from which it is told
LEAST_UNTOUCHED = 0.1  # share of the picture that looks like the untouched gel; below it is doubtful
MOST_GAIN = 2.0  # change of brightness that is still corrected


class Drift(NamedTuple):
    """Change of a picture against the untouched gel, by the pixels that nothing touches.

    Attributes
    ----------
    gain : tuple of float
        Brightness of each channel over that of the untouched gel.
    gain_error : tuple of float
        Their standard errors.
    untouched : float
        Share of the picture that it follows from.
    shift_px : tuple of int or None
        How far the gel has moved to the right and up; None where no structure of the gel stands out, or it
        was not looked for.
    """

    gain: tuple[float, ...]
    gain_error: tuple[float, ...]
    untouched: float
    shift_px: tuple[int, int] | None = None

    @property
    def known(self) -> bool:
        """Whether enough of the picture is untouched to tell the gain."""
        return self.untouched >= ENOUGH and max(self.gain_error) <= SURE

    def plain(self) -> dict[str, object]:
        """Plain data; a gain that is not known is null."""
        return {
            "gain": [round(value, 4) for value in self.gain] if self.known else None,
            "gain_error": [round(value, 4) for value in self.gain_error] if self.known else None,
            "untouched": round(self.untouched, 3),
            "shift_px": None if self.shift_px is None else list(self.shift_px),
        }


class Untouched(NamedTuple):
    """The untouched gel: its picture, and the means over its blocks."""

    image: Array
    blocks: Array

    @classmethod
    def of(cls, image: Array) -> Self:
        """Of a picture, shape (rows, columns, channels)."""
        return cls(image, _blocks(image))


def drift_between(
    untouched: Untouched, image: Array, *, place: bool = True, free: Mask | None = None
) -> Drift:
    """Estimate what has changed between two pictures, one of which may show a press.

    A press changes the ratio of brightness differently in every place and colour. The ratio that most blocks
    share is that of the gel which nothing touches.

    Parameters
    ----------
    untouched : Untouched
        The gel untouched.
    image : array, shape (rows, columns, channels)
        A picture of it, with a press or without.
    place : bool
        Whether to look for a shift.
    free : bool array, shape (rows, columns), optional
        Pixels that are compared: those that show the bare membrane.
    """
    if free is None:
        ratio = _blocks(image) / np.maximum(untouched.blocks, 1e-3)
    else:
        bare = _parted(free[..., None])[..., 0]
        pixels = bare.shape[1] * bare.shape[3]
        now, before = (
            np.einsum("apbqc,apbq->abc", _parted(each), bare.astype(each.dtype)) / pixels
            for each in (image, untouched.image)
        )
        ratio = np.asarray(now / np.maximum(before, 1e-3))
    gain, alike = _most_common(ratio.reshape(-1, ratio.shape[-1]))
    inside = ratio.reshape(-1, ratio.shape[-1])[alike]
    spread = 1.4826 * np.median(np.abs(inside - gain), axis=0)
    error = 1.2533 * spread / np.sqrt(max(len(inside) / INDEPENDENT, 1.0))
    moved = None
    if place and alike.mean() >= ENOUGH:
        beside = alike.reshape(ratio.shape[:2])
        moved = shift_px(untouched.image.mean(axis=-1), image.mean(axis=-1), beside)
    return Drift(tuple(map(float, gain)), tuple(map(float, error)), float(alike.mean()), moved)


def shift_px(before: Array, now: Array, untouched: Mask | None = None) -> tuple[int, int] | None:
    """How far fine structure has moved to the right and up, by phase correlation; None where none stands out.

    Parameters
    ----------
    before, now : array, shape (rows, columns)
        Pictures of one channel.
    untouched : bool array, optional
        Coarser mask of what shows the gel alone; all when absent.
    """
    rows, columns = before.shape
    fine = [image - gaussian_filter(image, 4.0) for image in (before, now)]
    if untouched is not None:
        kept = 1 - gaussian_filter((~untouched).astype(float), EDGE, mode="nearest")
        kept = np.clip(2 * kept - 1, 0, 1)
        kept = zoom(
            kept, (rows / kept.shape[0], columns / kept.shape[1]), order=1, grid_mode=True, mode="nearest"
        )
        fine = [kept * image for image in fine]
    spectra = [np.fft.rfft2(image) for image in fine]
    cross = spectra[1] * spectra[0].conj()
    peak = np.fft.irfft2(cross / np.maximum(np.abs(cross), 1e-12), s=before.shape)
    row, column = np.unravel_index(int(peak.argmax()), peak.shape)
    if peak.max() < STANDS_OUT * peak.std():
        return None
    down = int((row + rows // 2) % rows - rows // 2)
    right = int((column + columns // 2) % columns - columns // 2)
    return right, -down


def changed_since(before: Array, now: Array) -> tuple[str, ...]:
    """Say what has changed between two pictures of the untouched gel, shape (rows, columns, channels)."""
    found = []
    ratio = now.mean(axis=(0, 1)) / before.mean(axis=(0, 1))
    if np.abs(ratio - 1).max() > DRIFTED:
        told = ", ".join(f"{value - 1:+.0%}" for value in ratio)
        found.append(f"the untouched gel is brighter by {told} (R, G, B) than when it was calibrated")
    moved = shift_px(before.mean(axis=-1), now.mean(axis=-1))
    if moved is not None and np.hypot(*moved) >= MOVED_PX:
        found.append(
            f"the untouched gel has moved by {moved[0]:+d} px to the right and {moved[1]:+d} px up since "
            "it was calibrated: calibrate again, or put gel and camera back"
        )
    rest = gaussian_filter(now / ratio - before, (3, 3, 0)) / before.mean(axis=(0, 1))
    if rest.std() > DRIFTED:
        found.append(
            f"the light on the untouched gel has changed by {rest.std():.0%} in places since the "
            "calibration: calibrate again"
        )
    return tuple(found)


def levelled(image: Array, drift: Drift, usual_gain: Sequence[float] | None) -> tuple[Array, list[str]]:
    """Give a picture the brightness that the balls' pictures had, and say what has drifted.

    Parameters
    ----------
    image : array, shape (rows, columns, channels)
        The picture.
    drift : Drift
        Its change against the untouched gel.
    usual_gain : sequence of float or None
        Brightness of the balls' pictures over that of the untouched gel; None corrects nothing.

    Returns
    -------
    array, list of str
        The picture, and warnings.
    """
    if drift.untouched < LEAST_UNTOUCHED:
        return image, [
            f"only {drift.untouched:.0%} of the picture looks like the untouched gel: is it the sensor "
            "that was calibrated, with its light and place as then? Give today's untouched gel as the "
            "background, or calibrate again"
        ]
    warnings = []
    if drift.shift_px is not None and np.hypot(*drift.shift_px) >= PRESS_MOVED_PX:
        warnings.append(
            f"the gel has moved by {drift.shift_px[0]:+d} px to the right and {drift.shift_px[1]:+d} px "
            "up since its untouched picture: put gel and camera back, or take that picture again"
        )
    gain = np.array(drift.gain) / np.array(usual_gain or 1.0)
    if not drift.known or np.abs(gain - 1).max() <= DRIFTED:
        return image, warnings
    told = ", ".join(f"{value - 1:+.0%}" for value in gain)
    said = f"brightness has changed by {told} (R, G, B) where nothing touches the gel"
    if usual_gain is None or max(gain.max(), 1 / gain.min()) > MOST_GAIN:
        return image, [
            *warnings,
            f"{said}, and is not corrected: take today's untouched gel as the background",
        ]
    warnings.append(f"{said}; this is corrected. Fix exposure and white balance of the camera")
    return image * np.asarray(1 / gain, dtype=image.dtype), warnings


def _blocks(image: Array) -> Array:
    """Means over blocks, shape (blocks, blocks, channels), without what is left at the right and below."""
    return np.asarray(_parted(image).mean(axis=(1, 3)))


def _parted(image: NDArray[Any]) -> NDArray[Any]:
    """Every second pixel, which is enough, by blocks: shape (blocks, pixels, blocks, pixels, channels)."""
    rows, columns = (max(side // BLOCK_PX, 1) for side in image.shape[:2])
    down, across = image.shape[0] // rows, image.shape[1] // columns
    part = image[: rows * down, : columns * across]
    return part.reshape(rows, down, columns, across, -1)[:, ::2, :, ::2]


def _most_common(ratio: Array) -> tuple[Array, Mask]:
    """The ratio, (channels,), with the most others near it, and which those are."""

    def near(by_channel: Array, value: Array) -> Mask:
        return np.asarray((np.abs(by_channel / value[:, None] - 1) < ALIKE).all(axis=0))

    tried = ratio[:: max(1, len(ratio) // CANDIDATES)]
    tried = tried[(tried > 0).all(axis=-1)]
    if not len(tried):
        return np.ones(ratio.shape[-1]), np.zeros(len(ratio), dtype=bool)
    by_channel = np.ascontiguousarray(ratio.T)  # which is many times faster to compare
    some = np.ascontiguousarray(by_channel[:, :: max(1, len(ratio) // COUNTED)])
    gain = max(tried, key=lambda value: int(near(some, value).sum()))
    for _ in range(ROUNDS):
        gain = np.median(ratio[near(by_channel, gain)], axis=0)
    return gain, near(by_channel, gain)
