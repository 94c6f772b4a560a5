"""Printed markers: dark dots on the membrane, found in the untouched gel and followed into a press."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, find_objects, gaussian_filter, grey_closing, label
from scipy.spatial import cKDTree

from designlab.core.types import Array, Mask
from designlab.reconstruction.pictures import smoothed

LARGEST_SHARE = 0.1  # diameter of a dot over the picture's width
DARKER = 0.25  # than the gel around, from which a pixel may belong to a dot
FEWEST = 9  # dots that make a gel one with markers
LEAST_PX = 6  # area of a dot
LEAST_CELLS = 12  # area of a dot, where it is looked for on cells
ALIKE = 0.35, 2.5  # area of a dot over the median
ROUND = 0.85  # eccentricity, above which it is none
MOST_ODD = 0.3  # share of dark spots that are no dots, above which there are no markers
MOST_COVERED = 0.4  # of the picture, by dots
MARGIN_PX = 2  # around a dot, that it darkens too
REACH = 0.45  # of the distance of neighbours, that a dot may move
LEVEL_PX = 1.0  # smoothing before dots are looked for
FILLED = 0.1
"""Weight of a pixel whose marker was filled in, see ``benchmarks/filled_markers.py``."""


class MovedMarkers(NamedTuple):
    """Markers of one picture.

    Attributes
    ----------
    places_px : array, shape (markers, 2)
        Columns and rows of those that were found again, in the untouched gel.
    moved_px : array, shape (markers, 2)
        How far they have moved along columns and rows.
    covered : bool array, shape (rows, columns)
        Pixels that show a marker, in this picture or in that of the untouched gel; cells, if it was looked at
        on cells.
    """

    places_px: Array
    moved_px: Array
    covered: Mask


@dataclass(frozen=True, eq=False)
class Markers:
    """Markers of an untouched gel.

    Attributes
    ----------
    places_px : array, shape (markers, 2)
        Columns and rows of their centres.
    covered : bool array, shape (rows, columns)
        Pixels that show one.
    """

    places_px: Array
    covered: Mask

    @classmethod
    def found_in(cls, background: NDArray[np.floating]) -> Self | None:
        """Find the markers in a picture of the untouched gel, (rows, columns, channels); None without any."""
        spots = _spots(background)
        dots = spots.dots()
        count = int(dots.sum())
        if count < FEWEST or count < (1 - MOST_ODD) * len(dots):
            return None
        covered = spots.covered(dots)
        if covered.mean() > MOST_COVERED:
            return None
        return cls(spots.centres[dots], covered)

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any], shape: tuple[int, ...]) -> Self:
        """Read what `plain` gave, for pictures of a shape."""
        covered = np.zeros(shape[:2], dtype=bool)
        covered.ravel()[np.array(plain["covered"], dtype=int)] = True
        return cls(np.array(plain["places_px"], dtype=float), covered)

    def plain(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "places_px": np.round(self.places_px, 3).tolist(),
            "covered": np.flatnonzero(self.covered).tolist(),
        }

    def followed(self, image: NDArray[np.floating], *, cell_px: int = 1) -> MovedMarkers:
        """Find the markers again in a press; each moves by less than half the distance of its neighbours.

        Parameters
        ----------
        image : array, shape (rows, columns, channels)
            The press.
        cell_px : int
            Side of the cells on which `covered` is wanted. Markers are looked for on these too, which takes
            less time, where dots are large enough.
        """
        usual = self.covered.sum() / max(len(self.places_px), 1)
        side = cell_px if usual >= LEAST_CELLS * cell_px**2 else 1
        spots = _spots(image, side)
        covered = on_cells(self.covered, cell_px) | on_cells(spots.covered(), cell_px // side)
        if not len(spots.centres):
            return MovedMarkers(np.zeros((0, 2)), np.zeros((0, 2)), covered)
        now = (spots.centres + 0.5) * side - 0.5
        spacing = float(np.median(cKDTree(self.places_px).query(self.places_px, k=2)[0][:, 1]))
        far, near = cKDTree(now).query(self.places_px)
        _, back = cKDTree(self.places_px).query(now)
        # each is the other's nearest
        same = (far < REACH * spacing) & (back[near] == np.arange(len(near))) & spots.dots()[near]
        return MovedMarkers(self.places_px[same], now[near[same]] - self.places_px[same], covered)


def without(image: NDArray[np.floating], covered: Mask) -> Array:
    """A picture whose markers are filled in from around."""
    filled, sigma = np.array(image, dtype=float), 1.0
    left = covered.copy()
    while left.any():
        around = smoothed(filled, sigma, ~left)
        share = gaussian_filter((~left).astype(float), sigma, mode="nearest")
        known = left & (share > 0.05)
        filled[known] = around[known]
        left &= ~known
        sigma *= 1.5
    return filled


class _Spots(NamedTuple):
    """Dark spots: centres (column, row), areas, eccentricities, whether the border cuts them, their labels.

    `parts` holds 0 where there is no spot, else the number of the spot, from 1. Numbers that `kept` lacks are
    of spots too small to be one. `margin` is how far around a spot it darkens.
    """

    centres: Array
    area: Array
    eccentricity: Array
    cut: Mask
    parts: NDArray[np.int32]
    kept: Mask
    margin: int

    def dots(self) -> Mask:
        """Which spots are dots: whole, round, and about as large as most."""
        if not len(self.area):
            return np.zeros(0, dtype=bool)
        usual = float(np.median(self.area))
        alike = (ALIKE[0] * usual < self.area) & (self.area < ALIKE[1] * usual)
        return np.asarray(~self.cut & alike & (self.eccentricity < ROUND))

    def covered(self, chosen: Mask | None = None) -> Mask:
        """Pixels of the spots, or of some of them, and around these."""
        numbers = np.flatnonzero(self.kept) + 1
        of_spot = np.zeros(len(self.kept) + 1, dtype=bool)
        of_spot[numbers if chosen is None else numbers[chosen]] = True
        return np.asarray(binary_dilation(of_spot[self.parts], iterations=self.margin))


def _spots(image: NDArray[np.floating], cell_px: int = 1) -> _Spots:
    """Spots that are darker than the gel around, found on cells of some pixels."""
    channels = image.shape[-1]
    flat = image.reshape(-1, channels)
    usual = np.maximum(flat[:: cell_px**2].mean(axis=0), 1e-12)
    # a linear-algebra library would start threads, and wait for them longer than this takes
    level = np.einsum("rcd,d->rc", image, (1 / (channels * usual)).astype(image.dtype))
    if cell_px == 1:
        level = gaussian_filter(level, LEVEL_PX, mode="nearest")
    else:
        level = np.einsum("apbq->ab", _cells_of(level, cell_px)) / cell_px**2
    side = max(5, round(LARGEST_SHARE * level.shape[1]))
    around = grey_closing(level, size=(side, side), mode="nearest")
    dark = 1 - level / np.maximum(around, 1e-12)
    parts, count = label(dark > DARKER, np.ones((3, 3)))
    at = np.flatnonzero(parts)
    number, shade = parts.ravel()[at] - 1, dark.ravel()[at]
    row, column = np.divmod(at, level.shape[1])
    area = np.bincount(number, minlength=count).astype(float)
    kept = area * cell_px**2 >= LEAST_PX

    def mean(values: Array, weights: Array) -> Array:
        total = np.bincount(number, weights, minlength=count)
        return np.asarray(np.bincount(number, weights * values, minlength=count) / total)

    every = np.ones(len(at))
    x, y = mean(column, every), mean(row, every)
    across, down = column - x[number], row - y[number]
    # moments of an area of whole pixels
    xx, yy, xy = mean(across**2, every) + 1 / 12, mean(down**2, every) + 1 / 12, mean(across * down, every)
    split = np.hypot(xx - yy, 2 * xy)
    eccentricity = np.sqrt(np.clip(2 * split / (xx + yy + split), 0, 1))
    last = level.shape[0] - 1, level.shape[1] - 1
    cut = np.array(
        [
            any(part.start == 0 or part.stop > end for part, end in zip(box, last, strict=True))
            for box in find_objects(parts)
        ],
        dtype=bool,
    )
    centres = np.stack([mean(column, shade), mean(row, shade)], axis=1).reshape(-1, 2)
    margin = -(-MARGIN_PX // cell_px)
    return _Spots(centres[kept], area[kept], eccentricity[kept], cut[kept], parts, kept, margin)


def _cells_of(values: NDArray[Any], cell_px: int) -> NDArray[Any]:
    """Values by cells, shape (cells, cell_px, cells, cell_px); the last repeat the border."""
    beyond = [(0, -side % cell_px) for side in values.shape]
    padded = np.pad(values, beyond, mode="edge") if any(more for _, more in beyond) else values
    return padded.reshape(padded.shape[0] // cell_px, cell_px, padded.shape[1] // cell_px, cell_px)


def on_cells(covered: Mask, cell_px: int) -> Mask:
    """Cells of which any pixel is covered."""
    return covered if cell_px == 1 else np.asarray(_cells_of(covered, cell_px).any(axis=(1, 3)))
