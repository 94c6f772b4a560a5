"""Printed markers: dark dots on the membrane, found in the untouched gel and followed into a press."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.ndimage import binary_dilation, gaussian_filter, grey_closing
from scipy.spatial import cKDTree
from skimage.measure import label, regionprops

from designlab.core.types import Array, Mask
from designlab.reconstruction.balls import smoothed

LARGEST_SHARE = 0.1  # diameter of a dot over the picture's width
DARKER = 0.25  # than the gel around, from which a pixel may belong to a dot
FEWEST = 9  # dots that make a gel one with markers
LEAST_PX = 6  # area of a dot
ALIKE = 0.35, 2.5  # area of a dot over the median
ROUND = 0.85  # eccentricity, above which it is none
MOST_ODD = 0.3  # share of dark spots that are no dots, above which there are no markers
MOST_COVERED = 0.4  # of the picture, by dots
MARGIN_PX = 2  # around a dot, that it darkens too
REACH = 0.45  # of the distance of neighbours, that a dot may move
LEVEL_PX = 1.0  # smoothing before dots are looked for


class MovedMarkers(NamedTuple):
    """Markers of one picture.

    Attributes
    ----------
    places_px : array, shape (markers, 2)
        Columns and rows of those that were found again, in the untouched gel.
    moved_px : array, shape (markers, 2)
        How far they have moved along columns and rows.
    covered : bool array, shape (rows, columns)
        Pixels that show a marker, in this picture or in that of the untouched gel.
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
    def found_in(cls, background: Array) -> Self | None:
        """Find the markers in a picture of the untouched gel, (rows, columns, channels); None without any."""
        spots = _spots(background)
        if len(spots) < FEWEST:
            return None
        usual = float(np.median([spot.area for spot in spots]))
        dots = [spot for spot in spots if _is_dot(spot, usual)]
        if len(dots) < FEWEST or len(dots) < (1 - MOST_ODD) * len(spots):
            return None
        covered = _covered(dots, background.shape)
        if covered.mean() > MOST_COVERED:
            return None
        return cls(np.array([dot.centre for dot in dots]), covered)

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

    def followed(self, image: Array) -> MovedMarkers:
        """Find the markers again in a press; each moves by less than half the distance of its neighbours."""
        spots = _spots(image)
        covered = self.covered | _covered(spots, image.shape)
        if not spots:
            return MovedMarkers(np.zeros((0, 2)), np.zeros((0, 2)), covered)
        now = np.array([spot.centre for spot in spots])
        spacing = float(np.median(cKDTree(self.places_px).query(self.places_px, k=2)[0][:, 1]))
        far, near = cKDTree(now).query(self.places_px)
        _, back = cKDTree(self.places_px).query(now)
        usual = float(np.median([spot.area for spot in spots]))
        dots = np.array([_is_dot(spot, usual) for spot in spots])
        # each is the other's nearest
        same = (far < REACH * spacing) & (back[near] == np.arange(len(near))) & dots[near]
        return MovedMarkers(self.places_px[same], now[near[same]] - self.places_px[same], covered)


def without(image: Array, covered: Mask) -> Array:
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


class _Spot(NamedTuple):
    """A dark spot: centre (column, row), area (px), eccentricity, whether the border cuts it, its pixels."""

    centre: tuple[float, float]
    area: float
    eccentricity: float
    cut: bool
    pixels: Array


def _spots(image: Array) -> list[_Spot]:
    """Spots that are darker than the gel around."""
    level = (image / np.maximum(image.mean(axis=(0, 1)), 1e-12)).mean(axis=-1)
    level = gaussian_filter(level, LEVEL_PX, mode="nearest")
    side = max(5, round(LARGEST_SHARE * level.shape[1]))
    around = grey_closing(level, size=(side, side), mode="nearest")
    dark = 1 - level / np.maximum(around, 1e-12)
    rows, columns = level.shape
    found = []
    parts = label(dark > DARKER)
    for part in regionprops(parts, intensity_image=dark):
        if part.area < LEAST_PX:
            continue
        row, column = part.centroid_weighted
        top, left, bottom, right = part.bbox
        cut = top == 0 or left == 0 or bottom == rows or right == columns
        found.append(_Spot((column, row), float(part.area), part.eccentricity, cut, part.coords))
    return found


def _is_dot(spot: _Spot, usual_area: float) -> bool:
    return (
        not spot.cut
        and ALIKE[0] * usual_area < spot.area < ALIKE[1] * usual_area
        and spot.eccentricity < ROUND
    )


def _covered(spots: list[_Spot], shape: tuple[int, ...]) -> Mask:
    covered = np.zeros(shape[:2], dtype=bool)
    for spot in spots:
        covered[tuple(np.asarray(spot.pixels, dtype=int).T)] = True
    return np.asarray(binary_dilation(covered, iterations=MARGIN_PX))
