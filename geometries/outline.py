"""Planar outlines shared by the parts: rectangle, hexagon, circle, and the star polygons of the probes."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

OutlineName = Literal["rectangle", "hexagon", "round"]


def outline_polygon(
    outline: OutlineName, *, width_mm: float, length_mm: float, segments: int = 360
) -> NDArray[np.float64]:
    """Corners of an outline centred on the origin, counter-clockwise.

    Parameters
    ----------
    outline : {"rectangle", "hexagon", "round"}
        A hexagon has its flats at azimuth 30, 90, 150... deg, so one faces +y and a corner lies on +x.
    width_mm : float
        Size along x of a rectangle, distance across flats of a hexagon, diameter of a circle (mm).
    length_mm : float
        Size along y of a rectangle (mm); others ignore it.
    segments : int
        Corners of the inscribed polygon that stands for a circle.

    Returns
    -------
    ndarray, shape (n, 2)
        Corners in mm; the first is not repeated.
    """
    if outline == "rectangle":
        a, b = width_mm / 2, length_mm / 2
        return np.array([[a, -b], [a, b], [-a, b], [-a, -b]])
    if outline == "hexagon":
        return regular_polygon(corners=6, radius_mm=width_mm / np.sqrt(3.0), azimuth_deg=0.0)
    return regular_polygon(corners=segments, radius_mm=width_mm / 2, azimuth_deg=0.0)


def inside_outline(
    outline: OutlineName, x: ArrayLike, y: ArrayLike, *, width_mm: float, length_mm: float
) -> NDArray[np.bool_]:
    """Which points lie within an outline, its border included; a circle is exact, not a polygon.

    Parameters
    ----------
    outline : {"rectangle", "hexagon", "round"}
        See `outline_polygon`, also for the sizes.
    x, y : array_like
        Points (mm), broadcast against each other.
    width_mm, length_mm : float
        Sizes (mm).
    """
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    half = width_mm / 2 * (1 + 1e-12)  # points computed to lie on the border belong to it
    if outline == "rectangle":
        return np.asarray((np.abs(x) <= half) & (np.abs(y) <= length_mm / 2 * (1 + 1e-12)))
    if outline == "hexagon":
        sine = np.sqrt(0.75)
        return np.asarray(
            (np.abs(y) <= half) & (np.abs(sine * x + 0.5 * y) <= half) & (np.abs(sine * x - 0.5 * y) <= half)
        )
    return np.asarray(np.hypot(x, y) <= half)


def reach_mm(
    polygon: NDArray[np.float64], directions: NDArray[np.float64], *, grown_mm: float = 0.0
) -> NDArray[np.float64]:
    """Distance from the axis to a convex polygon around it along unit vectors.

    Parameters
    ----------
    polygon : array, shape (n, 2)
        Corners (mm), counter-clockwise.
    directions : array, shape (m, 2)
        Unit vectors.
    grown_mm : float
        By which every side is moved outwards (mm).

    Returns
    -------
    array, shape (m,)
        Distances in mm.
    """
    edge = np.roll(polygon, -1, axis=0) - polygon
    outward = np.column_stack([edge[:, 1], -edge[:, 0]])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    ahead = directions @ outward.T
    with np.errstate(divide="ignore"):
        reach = np.where(ahead > 1e-12, ((polygon * outward).sum(axis=1) + grown_mm) / ahead, np.inf)
    return np.asarray(reach.min(axis=1))


def regular_polygon(*, corners: int, radius_mm: float, azimuth_deg: float) -> NDArray[np.float64]:
    """Corners (mm) of a regular polygon, counter-clockwise from `azimuth_deg`; shape (corners, 2)."""
    angle = np.deg2rad(azimuth_deg) + 2 * np.pi * np.arange(corners) / corners
    return radius_mm * np.column_stack([np.cos(angle), np.sin(angle)])


def star_polygon(*, tips: int, outer_mm: float, inner_mm: float) -> NDArray[np.float64]:
    """Corners (mm) of a star with a tip at +y, tips and notches in turn, counter-clockwise; (2 tips, 2)."""
    corners = regular_polygon(corners=2 * tips, radius_mm=1.0, azimuth_deg=90.0)
    radius = np.where(np.arange(2 * tips) % 2 == 0, outer_mm, inner_mm)
    return corners * radius[:, None]


def inside_star(
    x: ArrayLike, y: ArrayLike, *, tips: int, outer_mm: float, inner_mm: float
) -> NDArray[np.bool_]:
    """Which points lie within a star with a tip at +y, its border included.

    With `inner_mm = outer_mm * cos(pi / tips)` the star is the regular polygon of `tips` corners.

    Parameters
    ----------
    x, y : array_like
        Points (mm), broadcast against each other.
    tips : int
        Number of tips.
    outer_mm, inner_mm : float
        Radius of the tips and of the notches (mm).
    """
    u, v = _in_half_sector(x, y, tips=tips)
    notch_u, notch_v = inner_mm * np.cos(np.pi / tips), inner_mm * np.sin(np.pi / tips)
    side = (notch_u - outer_mm) * v - notch_v * (u - outer_mm)
    return np.asarray(side >= -1e-12 * outer_mm**2)


def largest_inset_mm(*, tips: int, outer_mm: float, inner_mm: float) -> float:
    """Radius of the ball that fills a tip: it touches both flanks where they end, at the notches (mm)."""
    along, across = _flank(tips=tips, outer_mm=outer_mm, inner_mm=inner_mm)
    return float(np.hypot(along, across) * across / along)


def beyond_inset_star_mm(
    x: ArrayLike, y: ArrayLike, *, tips: int, outer_mm: float, inner_mm: float, inset_mm: float
) -> NDArray[np.float64]:
    """Distance from the smaller star whose flanks lie `inset_mm` within those of a star.

    Points up to `inset_mm` from it are the star with rounded tips: all that a disc of this radius covers
    whose centre stays in the smaller star.

    Parameters
    ----------
    x, y : array_like
        Points (mm), broadcast against each other.
    tips : int
        Number of tips, one of them at +y, see `inside_star`.
    outer_mm, inner_mm : float
        Radius of the tips and of the notches (mm).
    inset_mm : float
        Distance between the flanks (mm), below `largest_inset_mm`.

    Returns
    -------
    ndarray
        Distance in mm, zero on the smaller star.
    """
    u, v = _in_half_sector(x, y, tips=tips)
    along, across = _flank(tips=tips, outer_mm=outer_mm, inner_mm=inner_mm)
    # From the tip along the flank, and from the flank into the star.
    run = ((outer_mm - u) * along + v * across) / np.hypot(along, across)
    depth = ((outer_mm - u) * across - v * along) / np.hypot(along, across)
    smaller_tip = inset_mm * along / across
    return np.asarray(np.hypot(np.maximum(smaller_tip - run, 0.0), np.maximum(inset_mm - depth, 0.0)))


def _in_half_sector(
    x: ArrayLike, y: ArrayLike, *, tips: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fold points by the symmetry of a star into the half sector from a tip, on the u axis, to a notch."""
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    step = 2 * np.pi / tips
    from_tip = np.arctan2(-x, y)
    folded = np.abs(from_tip - step * np.round(from_tip / step))
    radius = np.hypot(x, y)
    return radius * np.cos(folded), radius * np.sin(folded)


def _flank(*, tips: int, outer_mm: float, inner_mm: float) -> tuple[float, float]:
    """How far a notch lies from its tip, along the tip's axis and across it (mm)."""
    return outer_mm - inner_mm * np.cos(np.pi / tips), inner_mm * np.sin(np.pi / tips)
