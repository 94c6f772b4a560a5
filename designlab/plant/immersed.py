"""Irradiance on a membrane behind glass, from the light field within its gel."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.plant.backlight import LightField, directions, light_field
from designlab.plant.light import FINE_MARGIN_MM, Grid, Patches, coarse_patches, fine_patches, form_factors
from designlab.plant.light import coarse_grid
from designlab.plant.rig import Rig
from designlab.plant.shadow import NONE, horizon_map
from designlab.plant.surface import Box, HeightField
from designlab.plant.tracing import AZIMUTHS, COLATITUDES

Array = NDArray[np.float64]

CHUNK = 4_000_000  # pairs of points and cells handled at once
SHADOW_SLOPE = 0.12  # light that arrives flatter than this beside an indentation casts no shadow
LONGEST_MM = 8.0
FAR_MM = 0.5  # grid of the shade beyond the indentation
NEAR_MM = 1.5  # around the indentation every point has its own horizon
ORDERS = 4  # of light between parts of the membrane


class Immersed:
    """Light of every LED group at unit flux on a membrane behind glass, in mW/mm2 per mW.

    The light field of the untouched membrane says what arrives from every direction at every place in the gel.
    An indentation hides part of it from its surroundings and from its own flanks, and in its place sends light
    itself: both count. Left out is that an indentation changes the light that leaves the gel and returns.

    Parameters
    ----------
    rig : Rig
        A sensor with glass.
    """

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.field = light_field(rig)
        self.coarse = coarse_grid(rig)
        self.directions, share = directions()
        self.share = float(share[0])
        self.untouched = Bathed(self, HeightField(rig.elastomer.radius_mm))

    def pressed(self, surface: HeightField) -> "Bathed":
        """Light on a membrane with an indentation."""
        return Bathed(self, surface)

    def arriving(self, surface: HeightField, x: Array, y: Array, sky: "Sky | None") -> Array:
        """Irradiance straight from the light field, shape (groups, points); where the sky is hidden, less."""
        base = HeightField(surface.radius_mm)
        height = np.maximum(surface.z(x, y) - base.z(x, y), 0.0)
        normals = surface.normals(x, y).astype(np.float32)
        towards = self.directions.T.astype(np.float32)
        found = np.empty((len(self.rig.flux_mw), len(x)))
        (column, weight_x), (row, weight_y), (_, weight_z) = self.field.along(x, y, height)
        if not height.any():
            weight_z = weight_z[:, :1]
        groups, levels, _, _, cells = self.field.radiance.shape
        levels = weight_z.shape[1]
        key = row * len(self.field.x_mm) + column
        order = np.argsort(key, kind="stable")
        for part in _runs(key[order], max(1, CHUNK // cells)):
            at = order[part]
            received = np.maximum(normals[at] @ towards, 0.0)
            if sky is not None:
                received *= sky.visible(x[at], y[at])
            first_row, first_column = row[at[0]], column[at[0]]
            rows, columns = weight_y.shape[1], weight_x.shape[1]
            nodes = self.field.radiance[
                :, :levels, first_row : first_row + rows, first_column : first_column + columns
            ]
            sums = received @ nodes.reshape(-1, cells).T
            sums = sums.reshape(len(at), groups, levels, rows, columns)
            found[:, at] = self.share * np.einsum(
                "pglrc,pl,pr,pc->gp", sums, weight_z[at], weight_y[at], weight_x[at], optimize=True
            )
        return found


class Bathed:
    """Light on one shape of the membrane."""

    def __init__(self, light: Immersed, surface: HeightField) -> None:
        self._light, self.surface = light, surface
        self.sky = None if surface.height_mm is None else Sky(surface)
        self._between: tuple[Grid, Array, Grid, Array] | None = None
        self._shade: tuple[Grid, Array] | None = None
        if self.sky is not None:
            self._shade = self._far_shade()
            self._between = self._between_membrane()

    @property
    def window(self) -> Box | None:
        """Box within which the indentation changes the light field's part, None without one."""
        return None if self.sky is None else self.sky.window

    def irradiance(self, x: Array, y: Array) -> Array:
        """Total irradiance at membrane points given by x and y (mm), shape (groups, points)."""
        return self.arriving(x, y) + self.from_membrane(x, y)

    def arriving(self, x: Array, y: Array) -> Array:
        """Irradiance from the light field, shape (groups, points)."""
        light = self._light
        if self.sky is None or self._shade is None:
            return light.arriving(self.surface, x, y, None)
        found = np.empty((len(light.rig.flux_mw), len(x)))
        near = self.sky.near.contains(x, y)
        found[:, near] = light.arriving(self.surface, x[near], y[near], self.sky)
        far = ~near
        found[:, far] = light.arriving(self.surface, x[far], y[far], None)
        far &= self.sky.window.contains(x, y)
        grid, shade = self._shade
        found[:, far] -= _interpolated(grid, shade, x[far], y[far])
        return found

    def from_membrane(self, x: Array, y: Array) -> Array:
        """Change of the light from other parts of the membrane, within the gel, shape (groups, points)."""
        groups = len(self._light.rig.flux_mw)
        if self._between is None:
            return np.zeros((groups, len(x)))
        coarse, coarse_field, fine, fine_field = self._between
        found = _interpolated(coarse, coarse_field, x, y)
        near = _extent(fine).contains(x, y)
        found[:, near] = _interpolated(fine, fine_field, x[near], y[near])
        return found

    def _far_shade(self) -> tuple[Grid, Array]:
        """What the indentation hides from its surroundings, on a grid over the window."""
        assert self.sky is not None
        box = self.sky.window
        columns = int(np.ceil((box.right - box.left) / FAR_MM)) + 1
        rows = int(np.ceil((box.top - box.bottom) / FAR_MM)) + 1
        pitch = (box.right - box.left) / (columns - 1), (box.top - box.bottom) / (rows - 1)
        grid = Grid(box.left, box.bottom, *pitch, rows, columns)
        x, y = (a.ravel() for a in np.meshgrid(box.left + np.arange(columns) * pitch[0],
                                               box.bottom + np.arange(rows) * pitch[1]))  # fmt: skip
        shade = np.zeros((len(self._light.rig.flux_mw), len(x)))
        inner = self.sky.near.grown(-2 * FAR_MM)
        at = ~inner.contains(x, y)
        light = self._light
        shade[:, at] = light.arriving(self.surface, x[at], y[at], None)
        shade[:, at] -= light.arriving(self.surface, x[at], y[at], self.sky)
        return grid, shade.reshape(-1, rows, columns)

    def _between_membrane(self) -> tuple[Grid, Array, Grid, Array]:
        """Change of the irradiance by other parts of the membrane, all orders, on a coarse and a fine grid.

        On a dome the light field holds what the untouched membrane sends itself within the gel; here counts
        the difference, from the same patches before and after.
        """
        rig, coarse = self._light.rig, self._light.coarse
        box = self.surface.bump.grown(FINE_MARGIN_MM)
        base = HeightField(rig.elastomer.radius_mm)
        after, fine = _patches(rig, self.surface, coarse, box)
        before, _ = _patches(rig, base, coarse, box)
        x, y = after.centre[:, 0], after.centre[:, 1]
        albedo = rig.albedo[:, None]
        exchange = form_factors(after, after).T
        sent = albedo * self._light.untouched.arriving(x, y)
        lacking = sent @ form_factors(before, before).T if rig.elastomer.radius_mm is not None else 0.0
        arriving = self.arriving(x, y)
        change = np.zeros_like(arriving)
        for _ in range(ORDERS):
            change = albedo * (arriving + change) @ exchange - lacking
        count = coarse.rows * coarse.columns
        return (
            coarse,
            change[:, :count].reshape(-1, coarse.rows, coarse.columns),
            fine,
            change[:, count:].reshape(-1, fine.rows, fine.columns),
        )


class Sky:
    """What an indentation leaves visible of the cells of direction, seen from points around it."""

    def __init__(self, surface: HeightField) -> None:
        bump = surface.bump
        self.near = bump.grown(NEAR_MM)
        self.window = bump.grown(max(min(surface.peak_mm / SHADOW_SLOPE, LONGEST_MM), NEAR_MM))
        self._centre = complex(bump.left + bump.right, bump.bottom + bump.top) / 2
        half = complex(bump.right - bump.left, bump.top - bump.bottom) / 2
        reach = self.window.right - bump.right
        self._turns = np.exp(2j * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS)
        self._maps = [
            horizon_map(surface, turn, centre=self._centre, half=half, reach_mm=reach) for turn in self._turns
        ]

    def visible(self, x: Array, y: Array) -> NDArray[np.float32]:
        """Share of every cell above the horizon, shape (points, cells)."""
        slope = np.full((len(x), AZIMUTHS), NONE, dtype=np.float32)
        offset = x + 1j * y - self._centre
        for number, (turn, (along_mm, across_mm, pitch_mm, horizon)) in enumerate(
            zip(self._turns, self._maps, strict=True)
        ):
            turned = np.conj(turn) * offset
            row, step = (turned.imag - across_mm) / pitch_mm, (turned.real - along_mm) / pitch_mm
            rows, steps = horizon.shape
            near = (row >= 0) & (row <= rows - 1) & (step >= 0) & (step <= steps - 1)
            slope[near, number] = map_coordinates(horizon, [row[near], step[near]], order=1)
        # Cells are COLATITUDES rows of equal height on the unit sphere.
        edge = COLATITUDES * slope / np.sqrt(1.0 + slope**2)
        rows = np.arange(1, COLATITUDES + 1, dtype=np.float32)
        share = np.clip(rows[None, :, None] - edge[:, None, :], 0.0, 1.0)
        return share.reshape(len(x), -1)


def _patches(rig: Rig, surface: HeightField, coarse: Grid, box: Box) -> tuple[Patches, Grid]:
    outer = coarse_patches(rig, surface, coarse, without=box)
    inner, fine = fine_patches(rig, surface, box)
    return Patches(*(np.concatenate(parts) for parts in zip(outer, inner, strict=True))), fine


def _interpolated(grid: Grid, field: Array, x: Array, y: Array) -> Array:
    place = [(y - grid.y0_mm) / grid.pitch_y_mm, (x - grid.x0_mm) / grid.pitch_x_mm]
    return np.stack([map_coordinates(layer, place, order=1, mode="nearest") for layer in field])


def _extent(grid: Grid) -> Box:
    right = grid.x0_mm + (grid.columns - 1) * grid.pitch_x_mm
    return Box(grid.x0_mm, right, grid.y0_mm, grid.y0_mm + (grid.rows - 1) * grid.pitch_y_mm)


def _runs(key: NDArray[np.int64], longest: int) -> Iterator[slice]:
    """Pieces of a sorted array that hold one value each, at most `longest` long."""
    ends = np.append(np.nonzero(np.diff(key))[0] + 1, len(key))
    start = 0
    for end in ends if len(key) else []:
        for first in range(start, int(end), longest):
            yield slice(first, min(first + longest, int(end)))
        start = int(end)
