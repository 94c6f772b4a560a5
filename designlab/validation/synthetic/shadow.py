"""Cast shadows follow from the horizon of a height field, for every point and azimuth."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array, Mask
from designlab.validation.synthetic import kernels
from designlab.validation.synthetic.generator_sensor import Cells
from designlab.validation.synthetic.surface import Box, HeightField

STEP_DEG = 3.0
PITCH_MM = 0.05
LONGEST_SHADOW_MM = 20.0
LOWEST_MM = 0.04  # what lies lower throws shadows that change a picture by 1e-5 of its mean
NONE = -10.0  # slope of the horizon where nothing can stand in the way


class Horizon:
    """Slope of the horizon around an indentation, seen towards light cells.

    For an azimuth the height field is resampled on a grid turned so that light comes along its rows, which
    span the indentation and the longest shadow behind it; the slope from each point to every later one then
    needs shifted slices only. Between azimuths, `STEP_DEG` apart, the horizon is interpolated linearly.
    """

    def __init__(self, surface: HeightField, cells: Cells, *, pitch_mm: float = PITCH_MM) -> None:
        bump, reach_mm = surface.above(LOWEST_MM), shadow_length_mm(surface, cells)
        self.window = bump.grown(reach_mm)
        self._maps = {}
        for number in self._azimuths(bump.centre, cells):
            turn = np.exp(1j * np.radians(number * STEP_DEG))
            self._maps[number] = horizon_map(surface, turn, bump, reach_mm=reach_mm, pitch_mm=pitch_mm)

    def visible_share(self, x: Array, y: Array, z: Array, cells: Cells) -> Array:
        """Share of every cell that stands above the horizon, shape (points, cells), for points in the window.

        A cell counts by its extent in elevation, so that the edge of a penumbra is smooth.
        """
        share = np.ones((len(x), len(cells.area)))
        table, column = self._table(x, y)
        shaded = table.max(axis=1) > NONE
        if not shaded.any():
            return share
        points = np.stack([x, y, z], axis=-1)[shaded]
        step_rad = float(np.radians(STEP_DEG))
        share[shaded] = kernels.visible_share(
            points, table[shaded], column, cells.centre, cells.half_down, step_rad
        )
        return share

    def _table(self, x: Array, y: Array) -> tuple[Array, NDArray[np.int64]]:
        """Horizon at points for every azimuth that was prepared, and the column of each azimuth's number."""
        table = np.full((len(x), len(self._maps)), NONE)
        column = np.zeros(int(360 / STEP_DEG) + 2, dtype=int)
        for place, (number, horizon) in enumerate(self._maps.items()):
            column[number] = place
            near, row, step = horizon.place(x, y)
            table[near, place] = kernels.bilinear(horizon.slope, row, step, False)
        column[-2:] = column[:2]  # 360 deg and beyond are 0 deg and beyond
        return table, column

    def _azimuths(self, centre: complex, cells: Cells) -> list[int]:
        """Numbers of the azimuths at which cells are seen from the window, and their neighbours."""
        left, right, bottom, top = self.window
        found: set[int] = set()
        count = int(360 / STEP_DEG)
        for x, y, _ in cells.centre:
            if left <= x <= right and bottom <= y <= top:
                return list(range(count))
            middle = np.arctan2(y - centre.imag, x - centre.real)
            corners = np.array([np.arctan2(y - b, x - a) for a in (left, right) for b in (bottom, top)])
            apart = (corners - middle + np.pi) % (2 * np.pi) - np.pi
            first = int(np.floor(np.degrees(middle + apart.min()) / STEP_DEG))
            last = int(np.ceil(np.degrees(middle + apart.max()) / STEP_DEG))
            found |= {number % count for number in range(first, last + 2)}
        return sorted(found)


class HorizonMap(NamedTuple):
    """Slope of the horizon towards one azimuth, on a grid turned so that light comes along its rows.

    Attributes
    ----------
    centre, turn : complex
        Origin of the grid (mm), and unit vector x + i y towards the light.
    along_mm, across_mm, pitch_mm : float
        First place along and across the light, from `centre`, and distance of grid points.
    slope : array (across, along)
        Slope to the highest point towards the light; `NONE` at the last one.
    """

    centre: complex
    turn: complex
    along_mm: float
    across_mm: float
    pitch_mm: float
    slope: Array

    def place(self, x: Array, y: Array) -> tuple[Mask, Array, Array]:
        """Tell which points lie on the grid, and the row and the column of these."""
        turned = np.conj(self.turn) * (x + 1j * y - self.centre)
        row = (turned.imag - self.across_mm) / self.pitch_mm
        column = (turned.real - self.along_mm) / self.pitch_mm
        rows, columns = self.slope.shape
        near = (row >= 0) & (row <= rows - 1) & (column >= 0) & (column <= columns - 1)
        return near, row[near], column[near]


def horizon_map(
    surface: HeightField, turn: complex, bump: Box, *, reach_mm: float, pitch_mm: float
) -> HorizonMap:
    """Slope of the horizon towards one azimuth, behind and over an indentation.

    Parameters
    ----------
    turn : complex
        Unit vector x + i y towards the light.
    bump : Box
        Bounding box of the indentation.
    reach_mm : float
        How far behind it the horizon is looked at.
    pitch_mm : float
        Distance of grid points.
    """
    half_x, half_y = (bump.right - bump.left) / 2, (bump.top - bump.bottom) / 2
    half_along = abs(turn.real) * half_x + abs(turn.imag) * half_y + 2 * pitch_mm
    half_across = abs(turn.imag) * half_x + abs(turn.real) * half_y + 2 * pitch_mm
    along = np.arange(-half_along - reach_mm, half_along + pitch_mm, pitch_mm)
    across = np.arange(-half_across, half_across + pitch_mm, pitch_mm)
    points = bump.centre + turn * (along[None, :] + 1j * across[:, None])
    z = surface.z(points.real, points.imag).astype(np.float32)
    strides = np.array(_strides(int(np.ceil(reach_mm / pitch_mm)), z.shape[1] - 1), dtype=np.int64)
    slope = kernels.steepest(z, strides, pitch_mm, NONE)
    return HorizonMap(bump.centre, turn, float(along[0]), float(across[0]), pitch_mm, slope)


def shadow_length_mm(surface: HeightField, cells: Cells) -> float:
    """Length of the longest shadow an indentation casts behind itself."""
    bump: Box = surface.above(LOWEST_MM)
    corners = np.array([(x, y) for x in bump[:2] for y in bump[2:]])
    lowest = cells.centre[:, 2] - np.abs(cells.half_down[:, 2])
    run = np.hypot(*(cells.centre[None, :, :2] - corners[:, None]).transpose(2, 0, 1))
    base = surface.z(corners[:, 0], corners[:, 1])
    grazing = np.maximum((lowest[None, :] - base[:, None] - surface.peak_mm) / run, 1e-3)
    return min(surface.peak_mm / float(grazing.min()), LONGEST_SHADOW_MM) + 0.1


def _strides(longest: int, most: int) -> list[int]:
    """Distances to look along the light, in grid steps: every one at first, then 2 % apart."""
    strides = [1]
    while strides[-1] < longest:
        strides.append(max(strides[-1] + 1, round(1.02 * strides[-1])))
    return [stride for stride in strides if stride <= most]
