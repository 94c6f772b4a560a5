"""Irradiance on a membrane behind glass, from the light field within its gel."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.core.types import Array
from designlab.validation.synthetic.backlight import directions, light_field
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.light import (
    FINE_MARGIN_MM,
    Patches,
    PatchGrid,
    coarse_grid,
    coarse_patches,
    fine_patches,
    form_factors,
    reflectances,
)
from designlab.validation.synthetic.shadow import NONE, horizon_map
from designlab.validation.synthetic.surface import Box, HeightField, base_z
from designlab.validation.synthetic.tracing import AZIMUTHS, COLATITUDES

CHUNK = 4_000_000  # pairs of points and cells handled at once
FAR_AWAY_MM = 1e6
SHADOW_SLOPE = 0.12  # light that arrives flatter than this beside an indentation casts no shadow
LONGEST_MM = 8.0
HIDING_MM = 0.01  # lower parts of an indentation hide nothing
PITCH_MM = 0.08  # of the horizon
TABLE_MM = 0.25  # of the irradiance of the untouched membrane
FAR_MM = 0.6  # of the shade beyond the indentation
NEAR_MM = 1.0  # around the indentation every point has its own horizon
ORDERS = 4  # of light between parts of the membrane


class ImmersedLighting:
    """Light of every LED group at unit flux on a membrane behind glass, in mW/mm2 per mW.

    The light field of the untouched membrane says what arrives from every direction at every place in the
    gel. An indentation hides part of it from its surroundings and from its own flanks, and in its place sends
    light itself: both count. Left out is that it changes the light that leaves the gel and returns: less than
    1 % of the mean beside and on a ball of 4 mm pressed 0.8 mm, by brute force.

    Parameters
    ----------
    rig : Rig
        A sensor with glass.
    seed : int
        Seed of the light field.
    """

    def __init__(self, rig: Rig, *, seed: int = 1) -> None:
        self.rig = rig
        self.field = light_field(rig, seed=seed)
        self.coarse = coarse_grid(rig)
        towards, share = directions()
        self._share = float(share[0])
        self._towards = towards.astype(np.float32)
        # Blocks of 2 x 2 cells: fine enough for the lobe of a shining coat.
        blocks = towards.reshape(COLATITUDES // 2, 2, AZIMUTHS // 2, 2, 3).mean(axis=(1, 3)).reshape(-1, 3)
        self._far = FAR_AWAY_MM * blocks / np.linalg.norm(blocks, axis=1, keepdims=True)
        self.untouched = ImmersedMembraneLight(self, HeightField(rig.elastomer.radius_mm, waves=rig.waves))

    def pressed(self, surface: HeightField) -> "ImmersedMembraneLight":
        """Light on a membrane with an indentation."""
        return ImmersedMembraneLight(self, surface)

    def arriving(
        self,
        surface: HeightField,
        x: Array,
        y: Array,
        sky: "HorizonMaps | None" = None,
        *,
        eye: Array | None = None,
    ) -> Array:
        """Irradiance straight from the light field, shape (groups, points); where the sky is hidden, less.

        With the places of eyes (points, 3), light that a shining coat sends there counts by what a diffuse
        coat would need to look as bright.
        """
        field, coat = self.field, self.rig.coat
        z, normals = surface.z(x, y), surface.normals(x, y)
        points = np.stack([x, y, z], axis=-1)
        shining = eye is not None and coat.specular > 0
        height = np.maximum(z - base_z(surface.radius_mm, x, y), 0.0)
        across, up, over = field.along(x, y, height)
        levels = over.weight.shape[1] if height.any() else 1
        groups, cells = len(field.radiance), field.radiance.shape[-1]
        slopes = None if sky is None else sky.slopes(x, y)
        found = np.empty((groups, len(x)))
        key = up.first * len(field.x_mm) + across.first
        order = np.argsort(key, kind="stable")
        for part in _runs(key[order], max(1, CHUNK // cells)):
            at = order[part]
            received = np.maximum(normals[at].astype(np.float32) @ self._towards.T, 0.0)
            if slopes is not None:
                received *= visible_share(slopes[at])
            if shining and eye is not None:
                lobe = coat.lobe(points[at], normals[at], self._far, eye[at]).astype(np.float32)
                lobe = lobe.reshape(len(at), COLATITUDES // 2, AZIMUTHS // 2)
                lobe = lobe.repeat(2, axis=1).repeat(2, axis=2).reshape(len(at), -1)
                received *= 1 - coat.specular + coat.specular * lobe
            rows, columns = (slice(first, first + 4) for first in (up.first[at[0]], across.first[at[0]]))
            nodes = field.radiance[:, :levels, rows, columns].reshape(-1, cells)
            weights = np.einsum("pl,pr,pc->plrc", over.weight[at, :levels], up.weight[at], across.weight[at])
            sums = (received @ nodes.T).reshape(len(at), groups, -1)
            found[:, at] = self._share * np.einsum("pgk,pk->gp", sums, weights.reshape(len(at), -1))
        return found


class ImmersedMembraneLight:
    """Light on one shape of the membrane."""

    def __init__(self, light: ImmersedLighting, surface: HeightField) -> None:
        self._light, self.surface = light, surface
        self._groups = len(light.rig.flux_mw)
        self._between: tuple[PatchGrid, Array, PatchGrid, Array] | None = None
        self.sky: HorizonMaps | None = None
        if surface.height_mm is None:
            self._table = self._tabulated()
            return
        self.sky = HorizonMaps(surface)
        self._shade = self._far_shade()
        self._between = self._between_membrane()

    @property
    def window(self) -> Box | None:
        """Box within which the indentation changes the light field's part, None without one."""
        return None if self.sky is None else self.sky.window

    def irradiance(self, x: Array, y: Array, *, eye: Array | None = None) -> Array:
        """Total irradiance at membrane points given by x and y (mm), shape (groups, points).

        `eye` is as in `ImmersedLighting.arriving`. Light between parts of the membrane counts as it is.
        """
        return self.arriving(x, y, eye=eye) + self.from_membrane(x, y)

    def arriving(self, x: Array, y: Array, *, eye: Array | None = None) -> Array:
        """Irradiance from the light field, shape (groups, points)."""
        light = self._light
        shining = light.rig.coat.specular > 0 and eye is not None
        if self.sky is None:
            if shining or len(light.rig.waves):
                return light.arriving(self.surface, x, y, eye=eye)
            return _interpolated(*self._table, x, y, order=3)
        found = np.empty((self._groups, len(x)))
        near = self.sky.near.contains(x, y)
        seen = None if eye is None else eye[near]
        found[:, near] = light.arriving(self.surface, x[near], y[near], self.sky, eye=seen)
        far = ~near
        seen = None if eye is None else eye[far]
        found[:, far] = light.untouched.arriving(x[far], y[far], eye=seen)
        far &= self.sky.window.contains(x, y)
        found[:, far] -= _interpolated(*self._shade, x[far], y[far])
        return found

    def from_membrane(self, x: Array, y: Array) -> Array:
        """Change of the light from other parts of the membrane, within the gel, shape (groups, points)."""
        if self._between is None:
            return np.zeros((self._groups, len(x)))
        coarse, coarse_field, fine, fine_field = self._between
        found = _interpolated(coarse, coarse_field, x, y)
        near = fine.box.contains(x, y)
        found[:, near] = _interpolated(fine, fine_field, x[near], y[near])
        return found

    def _tabulated(self) -> tuple[PatchGrid, Array]:
        """Irradiance of the untouched membrane on a grid over the light field."""
        field = self._light.field
        box = Box(field.x_mm[0], field.x_mm[-1], field.y_mm[0], field.y_mm[-1])
        grid, x, y = _grid(box, TABLE_MM)
        found = self._light.arriving(HeightField(self.surface.radius_mm), x, y)
        return grid, found.reshape(-1, grid.rows, grid.columns)

    def _far_shade(self) -> tuple[PatchGrid, Array]:
        """What the indentation hides from its surroundings, on a grid over the window."""
        assert self.sky is not None
        light, base = self._light, HeightField(self.surface.radius_mm)
        grid, x, y = _grid(self.sky.window, FAR_MM)
        shade = np.zeros((self._groups, len(x)))
        at = ~self.sky.near.grown(-2 * FAR_MM).contains(x, y)
        shade[:, at] = light.arriving(base, x[at], y[at])
        shade[:, at] -= light.arriving(base, x[at], y[at], self.sky)
        return grid, shade.reshape(-1, grid.rows, grid.columns)

    def _between_membrane(self) -> tuple[PatchGrid, Array, PatchGrid, Array]:
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
        exchange = form_factors(after, after).T
        lacking: Array | float = 0.0
        if rig.elastomer.radius_mm is not None:
            sent = reflectances(rig, base, x, y) * self._light.untouched.arriving(x, y)
            lacking = sent @ form_factors(before, before).T
        albedo, arriving = reflectances(rig, self.surface, x, y), self.arriving(x, y)
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


class HorizonMaps:
    """Horizon that an indentation makes, seen from points around it, in the azimuths of the cells."""

    def __init__(self, surface: HeightField) -> None:
        bump = surface.above(HIDING_MM)
        near = surface.bump.grown(NEAR_MM)
        window = near.joined(bump.grown(min(surface.peak_mm / SHADOW_SLOPE, LONGEST_MM)))
        reach = max(window.right - bump.right, bump.left - window.left)
        # Bulges turn towards other light, and throw no shadows.
        self.near, self.window = (box.joined(surface.changed) for box in (near, window))
        turns = np.exp(2j * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS)
        self._maps = [horizon_map(surface, turn, bump, reach_mm=reach, pitch_mm=PITCH_MM) for turn in turns]

    def slopes(self, x: Array, y: Array) -> NDArray[np.float32]:
        """Slope of the horizon at points, shape (points, azimuths)."""
        slope = np.full((len(x), AZIMUTHS), NONE, dtype=np.float32)
        for number, horizon in enumerate(self._maps):
            near, row, column = horizon.place(x, y)
            slope[near, number] = map_coordinates(horizon.slope, [row, column], order=1)
        return slope


def visible_share(slopes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Share of every cell above horizons (points, azimuths), shape (points, cells)."""
    # Cells stand in rows of equal height on the unit sphere.
    edge = COLATITUDES * slopes / np.sqrt(1.0 + slopes**2)
    rows = np.arange(1, COLATITUDES + 1, dtype=np.float32)
    share: NDArray[np.float32] = np.clip(rows[None, :, None] - edge[:, None, :], 0.0, 1.0)
    return share.reshape(len(slopes), -1)


def _grid(box: Box, pitch_mm: float) -> tuple[PatchGrid, Array, Array]:
    """Grid that spans a box, at most `pitch_mm` apart, and its points."""
    columns = int(np.ceil((box.right - box.left) / pitch_mm)) + 1
    rows = int(np.ceil((box.top - box.bottom) / pitch_mm)) + 1
    x, y = np.linspace(box.left, box.right, columns), np.linspace(box.bottom, box.top, rows)
    grid = PatchGrid(box.left, box.bottom, float(x[1] - x[0]), float(y[1] - y[0]), rows, columns)
    along, up = (axis.ravel() for axis in np.meshgrid(x, y))
    return grid, along, up


def _patches(rig: Rig, surface: HeightField, coarse: PatchGrid, box: Box) -> tuple[Patches, PatchGrid]:
    inner, fine = fine_patches(rig, surface, box)
    return coarse_patches(rig, surface, coarse, without=box).beside(inner), fine


def _interpolated(grid: PatchGrid, field: Array, x: Array, y: Array, order: int = 1) -> Array:
    place = grid.place(x, y)
    return np.stack([map_coordinates(layer, place, order=order, mode="nearest") for layer in field])


def _runs(key: NDArray[np.int64], longest: int) -> Iterator[slice]:
    """Pieces of a sorted array that hold one value each, at most `longest` long."""
    ends = np.append(np.nonzero(np.diff(key))[0] + 1, len(key))
    start = 0
    for end in ends if len(key) else []:
        for first in range(start, int(end), longest):
            yield slice(first, min(first + longest, int(end)))
        start = int(end)
