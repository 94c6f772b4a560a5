"""Outlines against matplotlib's polygon test and textbook areas."""

import numpy as np
import pytest
from matplotlib.path import Path
from numpy.typing import NDArray

from geometries.outline import (
    OutlineName,
    inside_outline,
    inside_star,
    outline_polygon,
    regular_polygon,
    star_polygon,
)

GRID = np.meshgrid(np.linspace(-15, 15, 211), np.linspace(-15, 15, 223))
AREAS = {
    "rectangle": 24.0 * 18.0,
    "hexagon": np.sqrt(3) / 2 * 24.0**2,
    "round": 360 / 2 * 12.0**2 * np.sin(2 * np.pi / 360),
}


def shoelace(corners: NDArray[np.float64]) -> float:
    """Signed area of a polygon: positive when its corners run counter-clockwise."""
    x, y = corners.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2)


def near_border(corners: NDArray[np.float64], distance: float) -> NDArray[np.bool_]:
    """Grid points within `distance` of a polygon's sides."""
    points = np.column_stack([GRID[0].ravel(), GRID[1].ravel()])
    nearest = np.full(len(points), np.inf)
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        share = np.clip((points - start) @ (end - start) / np.sum((end - start) ** 2), 0, 1)
        nearest = np.minimum(nearest, np.linalg.norm(points - start - share[:, None] * (end - start), axis=1))
    return (nearest < distance).reshape(GRID[0].shape)


def contained(corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    points = np.column_stack([GRID[0].ravel(), GRID[1].ravel()])
    return np.asarray(Path(corners).contains_points(points)).reshape(GRID[0].shape)


@pytest.mark.parametrize("outline", ["rectangle", "hexagon", "round"])
def test_polygon_has_the_textbook_area_and_runs_counter_clockwise(outline: OutlineName) -> None:
    corners = outline_polygon(outline, width_mm=24.0, length_mm=18.0)
    assert shoelace(corners) == pytest.approx(AREAS[outline], rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("outline", ["rectangle", "hexagon", "round"])
def test_inside_agrees_with_the_polygon(outline: OutlineName) -> None:
    corners = outline_polygon(outline, width_mm=24.0, length_mm=18.0, segments=2000)
    inside = inside_outline(outline, *GRID, width_mm=24.0, length_mm=18.0)
    sure = ~near_border(corners, 1e-4)
    assert sure.mean() > 0.99
    np.testing.assert_array_equal(inside[sure], contained(corners)[sure])


@pytest.mark.parametrize("outline", ["rectangle", "hexagon", "round"])
def test_the_border_belongs_to_the_outline(outline: OutlineName) -> None:
    corners = outline_polygon(outline, width_mm=24.0, length_mm=18.0)
    assert inside_outline(outline, *corners.T, width_mm=24.0, length_mm=18.0).all()
    assert not inside_outline(outline, *(1.001 * corners).T, width_mm=24.0, length_mm=18.0).any()


def test_hexagon_turns_a_flat_to_plus_y_and_a_corner_to_plus_x() -> None:
    corners = outline_polygon("hexagon", width_mm=24.0, length_mm=1.0)
    edge = np.roll(corners, -1, axis=0) - corners
    azimuth = np.rad2deg(np.arctan2(-edge[:, 0], edge[:, 1])) % 360
    np.testing.assert_allclose(np.sort(azimuth), [30, 90, 150, 210, 270, 330], atol=1e-9)
    assert corners[:, 1].max() == pytest.approx(12.0)
    assert corners[:, 0].max() == pytest.approx(24.0 / np.sqrt(3))


@pytest.mark.parametrize(("tips", "share"), [(3, 0.5), (5, 0.45), (7, 0.6)])
def test_star_agrees_with_its_polygon(tips: int, share: float) -> None:
    corners = star_polygon(tips=tips, outer_mm=12.0, inner_mm=share * 12.0)
    assert shoelace(corners) == pytest.approx(tips * share * 12.0**2 * np.sin(np.pi / tips))
    inside = inside_star(*GRID, tips=tips, outer_mm=12.0, inner_mm=share * 12.0)
    sure = ~near_border(corners, 1e-6)
    np.testing.assert_array_equal(inside[sure], contained(corners)[sure])
    assert corners[0] == pytest.approx([0.0, 12.0])
    assert inside_star(*corners.T, tips=tips, outer_mm=12.0, inner_mm=share * 12.0).all()


def test_regular_polygon_starts_at_its_azimuth() -> None:
    corners = regular_polygon(corners=3, radius_mm=2.0, azimuth_deg=90.0)
    np.testing.assert_allclose(corners, [(0, 2), (-np.sqrt(3), -1), (np.sqrt(3), -1)], atol=1e-12)
