"""Compiled loops of planted measurements, against the same in arrays or another library."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from designlab.validation.synthetic import kernels

RANDOM = np.random.default_rng(5)


def directions(count: int) -> np.ndarray:
    found = RANDOM.standard_normal((count, 3))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


POINTS, NORMALS = RANDOM.uniform(-10, 10, (40, 3)), directions(40)
CENTRES, FACING = RANDOM.uniform(-10, 10, (30, 3)), directions(30)
WAY = CENTRES[None] - POINTS[:, None]
SQUARE = (WAY**2).sum(axis=-1)
HERE = np.maximum((WAY * NORMALS[:, None]).sum(axis=-1), 0)
THERE = np.maximum(-(WAY * FACING[None]).sum(axis=-1), 0)


@pytest.mark.parametrize("exponent", [1.0, 0.5, 4.0])
def test_exchange_of_points_and_cells(exponent: float) -> None:
    found = kernels.exchange(POINTS, NORMALS, CENTRES, FACING, np.full(30, exponent))
    beam = (exponent + 1) / 2 * np.maximum(THERE / np.sqrt(SQUARE), 1e-9) ** (exponent - 1)
    assert found == pytest.approx(HERE * THERE / SQUARE**2 * beam, rel=1e-9)
    assert 0.1 < (found > 0).mean() < 0.5


def test_discs_see_each_other() -> None:
    areas = RANDOM.uniform(0.1, 2, 30)
    found = kernels.form_factors(POINTS, NORMALS, CENTRES, FACING, areas)
    assert found == pytest.approx(HERE * THERE * areas / (SQUARE * (np.pi * SQUARE + areas)), rel=1e-6)


@pytest.mark.parametrize("nearest", [False, True])
def test_values_between_grid_points(nearest: bool) -> None:
    grid = RANDOM.standard_normal((7, 5))
    row, column = RANDOM.uniform(-1.5, 8, 500), RANDOM.uniform(-1.5, 6, 500)
    mode = "nearest" if nearest else "constant"
    expected = map_coordinates(grid, [row, column], order=1, mode=mode)
    assert kernels.bilinear(grid, row, column, nearest) == pytest.approx(expected, abs=1e-12)
    edge = kernels.bilinear(grid, np.array([0.0, 6.0]), np.array([0.0, 4.0]), nearest)
    assert edge == pytest.approx([grid[0, 0], grid[6, 4]])


def test_steepest_slope_to_a_later_point() -> None:
    z = RANDOM.standard_normal((6, 30)).astype(np.float32)
    strides = np.array([1, 2, 3, 5, 8])
    found = kernels.steepest(z, strides, 0.1, -10.0)
    for k in range(30):
        seen = [(z[:, k + s] - z[:, k]) / (0.1 * s) for s in strides if k + s < 30]
        assert found[:, k] == pytest.approx(np.max([np.full(6, -10.0), *seen], axis=0), rel=1e-5)


def test_share_of_cells_above_the_horizon() -> None:
    turns = 24
    step = 2 * np.pi / turns
    table = RANDOM.uniform(-1, 1, (40, turns))
    column = np.concatenate([np.arange(turns), [0, 1]])
    half_down = RANDOM.uniform(-2, 2, (30, 3))
    found = kernels.visible_share(POINTS, table, column, CENTRES, half_down, step)
    run = np.hypot(WAY[..., 0], WAY[..., 1])
    angle = np.arctan2(WAY[..., 1], WAY[..., 0]) % (2 * np.pi)
    horizon = np.stack(
        [
            np.interp(own, step * np.arange(turns + 1), np.append(row, row[0]))
            for own, row in zip(angle, table, strict=True)
        ]
    )
    along = (WAY[..., :2] * half_down[None, :, :2]).sum(axis=-1) / run
    half = np.abs(half_down[:, 2] - WAY[..., 2] / run * along) / run
    expected = np.clip((WAY[..., 2] / run - horizon + half) / (2 * half), 0, 1)
    assert found == pytest.approx(expected, abs=1e-3)
    assert ((found > 0) & (found < 1)).mean() > 0.05
    lifted = kernels.visible_share(POINTS, table - 1e3, column, CENTRES, half_down, step)
    assert (lifted == 1).all()
