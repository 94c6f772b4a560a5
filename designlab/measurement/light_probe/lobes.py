"""Lobes of light around the ball: what each LED, or each strip of one, puts into a channel."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, find_objects, label, map_coordinates, median_filter

from designlab.core.types import Array
from designlab.measurement.light_probe.polar import angles_deg
from designlab.measurement.light_probe.unwrap import Unwrapped

LEAST_PX = 6  # smaller spots are noise
FAINT = 0.02  # lobes with less flux than this share of the channel's strongest are left out
SPLIT = 5  # of a pixel along each side, where a lobe's contour runs through it
RIM_PX = 2  # flux is summed this far around a lobe, where pixels are lit in part


@dataclass(frozen=True)
class Lobe:
    """One connected bright region of one channel.

    Attributes
    ----------
    channel : str
        LED group or camera channel.
    polar_deg, azimuth_deg : float
        Its middle, weighed by radiance: angle from +z, and counter-clockwise from +x.
    direction : tuple of float
        The same as a unit vector towards the light.
    solid_angle_sr : float
        Of the directions, each from its own point of the ball, whose radiance exceeds the threshold.
    seen_sr : float
        Solid angle under which the source is seen from the points of the ball, if it stands as far away as
        the LED next to that direction.
    width_deg : tuple of float
        Full widths, greater and lesser, of the even rectangle with the lobe's second moments.
    flux : float
        Integral of radiance over the solid angle of the directions.
    peak : float
        Radiance at its brightest, a single pixel's noise left out.
    origin_mm : tuple of float
        Mean point of the ball that mirrors it.
    source_mm : tuple of float
        Middle of the source, if it stands in the plane of the LED next to that direction. Seen from each
        point of the ball this is the direction of the source; `direction` is the mean over all of them.
    pixels : int
        Pixels above the threshold.
    cut : bool
        Whether it touches the outline of the ball or the edge of the picture, so that part of it is missing.
    """

    channel: str
    polar_deg: float
    azimuth_deg: float
    direction: tuple[float, float, float]
    solid_angle_sr: float
    seen_sr: float
    width_deg: tuple[float, float]
    flux: float
    peak: float
    origin_mm: tuple[float, float, float]
    source_mm: tuple[float, float, float]
    pixels: int
    cut: bool


@dataclass(frozen=True)
class Lobes:
    """Lobes of all channels, the strongest of each channel first.

    Attributes
    ----------
    threshold : float
        Share of the channel's peak above which a pixel belongs to a lobe.
    total : dict of str to float
        Integral of radiance over all directions, by channel.
    """

    threshold: float
    lobes: tuple[Lobe, ...]
    total: dict[str, float]

    def of(self, channel: str) -> tuple[Lobe, ...]:
        """Lobes of one channel."""
        return tuple(lobe for lobe in self.lobes if lobe.channel == channel)

    def to_json(self) -> str:
        """Content as JSON."""
        return json.dumps(asdict(self))


def lobes(found: Unwrapped, *, threshold: float = 0.5) -> Lobes:
    """Find the lobes of every channel.

    Parameters
    ----------
    found : Unwrapped
        Incident light.
    threshold : float
        Share of the channel's peak above which a pixel belongs to a lobe; 0.5 is half maximum.

    Raises
    ------
    ValueError
        If the threshold is not between 0 and 1.
    """
    if not 0 < threshold < 1:
        raise ValueError(f"threshold: must lie between 0 and 1, got {threshold:g}")
    every: list[Lobe] = []
    total = {}
    for name, radiance in zip(found.names, np.nan_to_num(found.radiance), strict=True):
        total[name] = float((radiance * found.solid_angle_sr).sum())
        own = sorted(_of_channel(found, name, radiance, threshold), key=lambda lobe: -lobe.flux)
        every += [lobe for lobe in own if lobe.flux >= FAINT * own[0].flux]
    return Lobes(threshold, tuple(every), total)


def _of_channel(found: Unwrapped, name: str, radiance: Array, threshold: float) -> Iterator[Lobe]:
    smooth = median_filter(radiance, size=3)
    top = float(smooth.max())
    if top <= 0:
        return
    numbers, _ = label((radiance > threshold * top) & found.on_ball, structure=np.ones((3, 3)))
    pixels = np.bincount(numbers.ravel())
    outside = binary_dilation(~np.pad(found.on_ball, 1))[1:-1, 1:-1]
    for number, box in enumerate(find_objects(numbers), start=1):
        if pixels[number] < LEAST_PX:
            continue
        near = tuple(slice(max(0, side.start - RIM_PX), side.stop + RIM_PX) for side in box)
        part = _Part(found, near, radiance[near], numbers[near], number)
        peak = float(smooth[near][part.inside].max())
        yield part.lobe(name, peak, threshold * top, bool((part.inside & outside[near]).any()))


class _Part:
    """Pixels around one lobe."""

    def __init__(
        self,
        found: Unwrapped,
        near: tuple[slice, ...],
        radiance: Array,
        numbers: NDArray[np.integer],
        number: int,
    ) -> None:
        self.found, self.near, self.radiance = found, near, radiance
        self.inside = numbers == number
        self.own = self.inside | (numbers == 0)
        self.around = binary_dilation(self.inside, iterations=RIM_PX) & self.own & found.on_ball[near]

    def lobe(self, name: str, peak: float, level: float, cut: bool) -> Lobe:
        found, around = self.found, self.around
        direction, origin = found.direction[self.near][around], found.origin_mm[self.near][around]
        solid, seen = found.solid_angle_sr[self.near], found.seen_sr(found.led_mm)[self.near]
        light = (self.radiance * solid)[around]
        middle = light @ direction
        middle = middle / np.linalg.norm(middle)
        polar, azimuth = angles_deg(middle)
        lesser, greater = _widths_deg(direction, light, middle)
        reach = found.led_mm[self.near][around]
        emitting = (self.radiance * seen)[around] * reach**2
        source = emitting @ (origin + reach[:, None] * direction) / emitting.sum()
        covered = self._covered(level)
        return Lobe(
            channel=name,
            polar_deg=polar,
            azimuth_deg=azimuth,
            direction=_floats(middle),
            solid_angle_sr=float((covered * solid).sum()),
            seen_sr=float(np.nansum(covered * seen)),
            width_deg=(greater, lesser),
            flux=float(light.sum()),
            peak=peak,
            origin_mm=_floats(light @ origin / light.sum()),
            source_mm=_floats(source),
            pixels=int(self.inside.sum()),
            cut=cut,
        )

    def _covered(self, level: float) -> Array:
        """Share of each pixel that exceeds the level, linear in between: contours run through pixels."""
        rows, columns = self.radiance.shape
        steps = (np.arange(SPLIT) + 0.5) / SPLIT - 0.5
        finer = [(np.arange(pixels)[:, None] + steps).ravel() for pixels in (rows, columns)]
        places = np.meshgrid(*finer, indexing="ij")
        above = map_coordinates(self.radiance, places, order=1, mode="nearest") > level
        share = above.reshape(rows, SPLIT, columns, SPLIT).mean(axis=(1, 3))
        return np.asarray(share * (binary_dilation(self.inside) & self.own & self.found.on_ball[self.near]))


def _widths_deg(direction: Array, light: Array, middle: Array) -> tuple[float, float]:
    """Lesser and greater full width of the even rectangle with the same second moments."""
    across = np.cross(middle, [0.0, 0.0, 1.0] if abs(middle[2]) < 0.9 else [1.0, 0.0, 0.0])
    across = across / np.linalg.norm(across)
    beside = direction @ np.stack([across, np.cross(middle, across)]).T  # sines of small angles
    spread = np.linalg.eigvalsh((beside * light[:, None]).T @ beside / light.sum())
    lesser, greater = np.degrees(np.sqrt(12 * np.maximum(spread, 0.0)))
    return float(lesser), float(greater)


def _floats(vector: Array) -> tuple[float, float, float]:
    x, y, z = vector
    return float(x), float(y), float(z)
