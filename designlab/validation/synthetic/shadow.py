"""Cast shadows follow from the horizon of a height field, for every point and azimuth."""

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
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
        self._pitch_mm = pitch_mm
        bump = surface.above(LOWEST_MM)
        self._centre = complex(bump.left + bump.right, bump.bottom + bump.top) / 2
        self._half = complex(bump.right - bump.left, bump.top - bump.bottom) / 2
        self._reach_mm = shadow_length_mm(surface, cells)
        self.window = bump.grown(self._reach_mm)
        self._maps = {number: self._map(surface, number) for number in self._azimuths(cells)}

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
        offset = x + 1j * y - self._centre
        for place, (number, (along_mm, across_mm, horizon)) in enumerate(self._maps.items()):
            column[number] = place
            turned = np.exp(-1j * np.radians(number * STEP_DEG)) * offset
            row, step = (turned.imag - across_mm) / self._pitch_mm, (turned.real - along_mm) / self._pitch_mm
            rows, steps = horizon.shape
            near = (row >= 0) & (row <= rows - 1) & (step >= 0) & (step <= steps - 1)
            table[near, place] = kernels.bilinear(horizon, row[near], step[near], False)
        column[-2:] = column[:2]  # 360 deg and beyond are 0 deg and beyond
        return table, column

    def _map(self, surface: HeightField, number: int) -> tuple[float, float, Array]:
        """Slope of the horizon towards one azimuth: first place along and across the light (mm), grid."""
        along_mm, across_mm, _, horizon = horizon_map(
            surface,
            np.exp(1j * np.radians(number * STEP_DEG)),
            centre=self._centre,
            half=self._half,
            reach_mm=self._reach_mm,
            pitch_mm=self._pitch_mm,
        )
        return along_mm, across_mm, horizon

    def _azimuths(self, cells: Cells) -> list[int]:
        """Numbers of the azimuths at which cells are seen from the window, and their neighbours."""
        left, right, bottom, top = self.window
        found: set[int] = set()
        count = int(360 / STEP_DEG)
        for x, y, _ in cells.centre:
            if left <= x <= right and bottom <= y <= top:
                return list(range(count))
            middle = np.arctan2(y - self._centre.imag, x - self._centre.real)
            corners = np.array([np.arctan2(y - b, x - a) for a in (left, right) for b in (bottom, top)])
            apart = (corners - middle + np.pi) % (2 * np.pi) - np.pi
            first = int(np.floor(np.degrees(middle + apart.min()) / STEP_DEG))
            last = int(np.ceil(np.degrees(middle + apart.max()) / STEP_DEG))
            found |= {number % count for number in range(first, last + 2)}
        return sorted(found)


def horizon_map(
    surface: HeightField,
    turn: complex,
    *,
    centre: complex,
    half: complex,
    reach_mm: float,
    pitch_mm: float = PITCH_MM,
) -> tuple[float, float, float, Array]:
    """Slope of the horizon towards one azimuth, behind and over an indentation.

    Parameters
    ----------
    turn : complex
        Unit vector x + i y towards the light.
    centre, half : complex
        Middle and half size of the indentation's bounding box (mm).
    reach_mm : float
        How far behind it the horizon is looked at.

    Returns
    -------
    along_mm, across_mm, pitch_mm : float
        First place along and across the light, from `centre`, and distance of grid points.
    horizon : array (across, along)
        Slope to the highest point towards the light; `NONE` at the last one.
    """
    half_along = abs(turn.real) * half.real + abs(turn.imag) * half.imag + 2 * pitch_mm
    half_across = abs(turn.imag) * half.real + abs(turn.real) * half.imag + 2 * pitch_mm
    along = np.arange(-half_along - reach_mm, half_along + pitch_mm, pitch_mm)
    across = np.arange(-half_across, half_across + pitch_mm, pitch_mm)
    points = centre + turn * (along[None, :] + 1j * across[:, None])
    z = surface.z(points.real, points.imag).astype(np.float32)
    strides = np.array(_strides(int(np.ceil(reach_mm / pitch_mm)), z.shape[1] - 1), dtype=np.int64)
    return float(along[0]), float(across[0]), pitch_mm, kernels.steepest(z, strides, pitch_mm, NONE)


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
