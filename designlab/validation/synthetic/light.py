"""Irradiance on the membrane: direct light, light off the LED boards, and light off the membrane itself."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.validation.synthetic import kernels
from designlab.validation.synthetic.generator_sensor import Cells, Rig, cells
from designlab.validation.synthetic.shadow import Horizon
from designlab.validation.synthetic.surface import Box, HeightField
from geometries import elastomer

EMITTER_SPACING_MM = 1.2
BOARD_SPACING_MM = 2.4
COARSE_MM = 1.2  # patches of the whole membrane
FINE_PATCHES = 40  # patches along each side of the box around an indentation
FINE_MARGIN_MM = 0.8
BETWEEN_PITCH_MM = 0.12  # of the horizon that tells which patches see each other
STEPS, GRAZING_MM = 24, 2e-3  # along the way between two patches; what rises less above it does not count
CHUNK = 400_000  # pairs of points and cells handled at once, small enough for the processor's cache


class Patches(NamedTuple):
    """Pieces of diffuse surface: centre and normal (n, 3), area (n,) in mm2."""

    centre: Array
    normal: Array
    area: Array

    def beside(self, others: "Patches") -> "Patches":
        """These patches, then others."""
        return Patches(*(np.concatenate(parts) for parts in zip(self, others, strict=True)))


class PatchGrid(NamedTuple):
    """Regular grid of patch centres: first centre, pitch, rows (ascending y) and columns."""

    x0_mm: float
    y0_mm: float
    pitch_x_mm: float
    pitch_y_mm: float
    rows: int
    columns: int

    @property
    def box(self) -> Box:
        """Box from the first centre to the last."""
        right = self.x0_mm + (self.columns - 1) * self.pitch_x_mm
        return Box(self.x0_mm, right, self.y0_mm, self.y0_mm + (self.rows - 1) * self.pitch_y_mm)

    def centres(self) -> tuple[Array, Array]:
        """Centres of the patches: x and y, shape (rows * columns,) each."""
        x = self.x0_mm + np.arange(self.columns) * self.pitch_x_mm
        y = self.y0_mm + np.arange(self.rows) * self.pitch_y_mm
        grid_x, grid_y = np.meshgrid(x, y)
        return grid_x.ravel(), grid_y.ravel()

    def place(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Row and column of points, as fractions."""
        return (y - self.y0_mm) / self.pitch_y_mm, (x - self.x0_mm) / self.pitch_x_mm


class Lighting:
    """Light of every LED group at unit flux on a membrane, in mW/mm2 per mW.

    Paths run from an emitter over boards and membrane to the membrane point that the camera sees;
    `path_length` of the rig counts their segments, the last one to the camera included. Left out: LED bodies
    that stand in each other's light, walls of an indentation in a flat gel that stand between two others, and
    the change of the boards' own light by an indentation. Bumps shade the light of emitters and boards, and
    on a dome that of the membrane beyond them.

    Parameters
    ----------
    rig : Rig
        The sensor.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._groups = len(rig.flux_mw)
        self._emitters = cells(rig.emitters, spacing_mm=EMITTER_SPACING_MM, exponent=rig.exponent)
        self._boards = cells(rig.boards, spacing_mm=BOARD_SPACING_MM)
        self.cells = Cells(
            *(np.concatenate(parts) for parts in zip(self._emitters, self._boards, strict=True))
        )
        self.coarse = coarse_grid(rig)
        self._board_patches = Patches(self._boards.centre, self._boards.normal, self._boards.area)
        self._bounces = rig.path_length - 2
        # Radiosity of the boards by light that met a surface 1, 2, ... times, (groups, boards) each.
        self._board_radiosity: list[Array] = []
        untouched = HeightField(rig.elastomer.radius_mm, waves=rig.waves)
        self._board_radiosity = self._settle_boards(untouched)
        self.untouched = Pressed(self, untouched)

    def pressed(self, surface: HeightField) -> "Pressed":
        """Light on a membrane with an indentation."""
        return Pressed(self, surface)

    def power(self, orders: int) -> Array:
        """Radiance times area of every cell, (groups, cells); of boards, light of up to `orders` bounces."""
        groups = np.arange(self._groups)[:, None]
        own = self._emitters.group[None, :] == groups
        total = np.where(own, self._emitters.area[None, :], 0.0).sum(axis=1, keepdims=True)
        shone = self._emitters.area * self._rig.face_flux[self._emitters.rectangle]
        emitted = np.where(own, shone / (np.pi * total), 0.0)
        back = np.sum(self._board_radiosity[:orders], axis=0) if orders and self._board_radiosity else 0.0
        returned = np.broadcast_to(back * self._boards.area / np.pi, (self._groups, len(self._boards.area)))
        return np.concatenate([emitted, returned], axis=1)

    def _order_power(self, order: int) -> Array:
        """As `power`, but only light that met exactly `order` surfaces (0: straight from emitters)."""
        if order == 0:
            return self.power(0)
        return self.power(order) - self.power(order - 1)

    def _settle_boards(self, surface: HeightField) -> list[Array]:
        """Radiosity of the boards for 1, 2, ... met surfaces, on the untouched membrane."""
        membrane = coarse_patches(self._rig, surface, self.coarse, without=None)
        boards = self._board_patches
        albedo = reflectances(self._rig, surface, membrane.centre[:, 0], membrane.centre[:, 1])
        reflectance = self._rig.board_reflectance[:, None]
        lit, power = self._emitters, self.power(0)[:, : len(self._emitters.area)]
        on_membrane = albedo * irradiance(membrane.centre, membrane.normal, lit, power)
        on_boards = reflectance * irradiance(boards.centre, boards.normal, lit, power)
        orders = [on_boards]
        everything = membrane.beside(boards)
        exchange = form_factors(everything, everything).T
        both = np.concatenate([albedo, np.broadcast_to(reflectance, on_boards.shape)], axis=1)
        radiosity = np.concatenate([on_membrane, on_boards], axis=1)
        for _ in range(self._bounces - 1):
            radiosity = both * (radiosity @ exchange)
            orders.append(radiosity[:, len(membrane.area) :])
        return orders[: max(self._bounces, 0)]


class Pressed:
    """Light on one shape of the membrane."""

    def __init__(self, lighting: Lighting, surface: HeightField) -> None:
        self.surface = surface
        self._lighting = lighting
        self._rig = lighting._rig
        self.horizon = None if surface.height_mm is None else Horizon(surface, lighting.cells)
        self._coarse_field, self._fine_field, self._fine = self._between_membrane()

    @property
    def window(self) -> Box | None:
        """Box within which the indentation changes the direct light, None without one."""
        if self.horizon is None:
            return None
        return self.horizon.window.joined(self.surface.changed)

    def irradiance(self, x: Array, y: Array, *, eye: Array | None = None) -> Array:
        """Total irradiance at membrane points given by x and y (mm), shape (groups, points).

        With the place of an eye (3,), light that a shining coat sends there counts by what a diffuse coat
        would need to look as bright. Light from membrane to membrane is wide, so that it counts as it is.
        """
        lighting = self._lighting
        power = lighting.power(lighting._bounces)
        return self.from_cells(x, y, power, eye=eye) + self.from_membrane(x, y)

    def from_cells(self, x: Array, y: Array, power: Array, *, eye: Array | None = None) -> Array:
        """Irradiance by emitters and boards of given radiance times area, shape (groups, points)."""
        coat = self._rig.coat
        z, normals = self.surface.z(x, y), self.surface.normals(x, y)
        points = np.stack([x, y, z], axis=-1)
        total = np.empty((len(power), len(x)))
        sources = self._lighting.cells
        for part in _parts(len(x), len(sources.area)):
            kernel = _exchange(points[part], normals[part], sources)
            if self.horizon is not None:
                near = self.horizon.window.contains(x[part], y[part])
                place = x[part][near], y[part][near], z[part][near]
                kernel[near] *= self.horizon.visible_share(*place, sources)
            if eye is not None and coat.specular:
                lobe = coat.lobe(
                    points[part], normals[part], sources.centre, np.broadcast_to(eye, points.shape)[part]
                )
                kernel *= 1 - coat.specular + coat.specular * lobe
            total[:, part] = power @ kernel.T
        return total

    def from_membrane(self, x: Array, y: Array) -> Array:
        """Irradiance by other parts of the membrane, shape (groups, points), interpolated between patches."""
        total = np.stack([_interpolate(self._lighting.coarse, field, x, y) for field in self._coarse_field])
        if self._fine is not None and self._fine_field is not None:
            near = self._fine.box.contains(x, y)
            for group, field in enumerate(self._fine_field):
                total[group, near] = _interpolate(self._fine, field, x[near], y[near])
        return total

    def _between_membrane(self) -> tuple[Array, Array | None, PatchGrid | None]:
        """Irradiance that patches of the membrane send each other, all orders that count, on both grids."""
        rig, lighting = self._rig, self._lighting
        fine_box = None if self.surface.height_mm is None else self.surface.bump.grown(FINE_MARGIN_MM)
        patches = coarse_patches(rig, self.surface, lighting.coarse, without=fine_box)
        coarse_count, grid = len(patches.area), None
        if fine_box is not None:
            fine, grid = fine_patches(rig, self.surface, fine_box)
            patches = patches.beside(fine)
        x, y = patches.centre[:, 0], patches.centre[:, 1]
        total = np.zeros((len(rig.flux_mw), len(x)))
        between = np.zeros_like(total)
        curved = rig.elastomer.radius_mm is not None or self.surface.height_mm is not None
        if curved and lighting._bounces:
            exchange = form_factors(patches, patches)
            if rig.elastomer.radius_mm is not None and self.surface.height_mm is not None:
                places, place = _representatives(coarse_count)
                some = Patches(*(part[places] for part in patches))
                seen = self._past_the_bump(some, exchange[np.ix_(places, places)])
                exchange *= seen[np.ix_(place, place)]
            power = np.concatenate([lighting._order_power(order) for order in range(lighting._bounces)])
            albedo = reflectances(rig, self.surface, x, y)
            for arriving in self.from_cells(x, y, power).reshape(lighting._bounces, *total.shape):
                between = albedo * (arriving + between) @ exchange.T
                total += between
        shape = lighting.coarse.rows, lighting.coarse.columns
        coarse_field = total[:, :coarse_count].reshape(-1, *shape)
        if grid is None:
            return coarse_field, None, None
        return coarse_field, total[:, coarse_count:].reshape(-1, grid.rows, grid.columns), grid

    def _past_the_bump(self, patches: Patches, exchange: Array) -> Array:
        """Whether each receiver sees each sender past the indentation, (receivers, senders).

        The horizon tells which it sees for certain. Of the others some stand before the indentation, not
        behind it: where they exchange light, the way between the two is walked.
        """
        x, y, z = patches.centre.T
        flat, number = np.zeros((len(x), 3)), np.zeros(len(x), dtype=int)
        cells = Cells(number, patches.centre, patches.normal, flat, patches.area, np.ones(len(x)), number)
        horizon = Horizon(self.surface, cells, pitch_mm=BETWEEN_PITCH_MM)
        seen = np.ones((len(x), len(x)))
        near = np.flatnonzero(horizon.window.contains(x, y))
        for part in _parts(len(near), len(x)):
            some = near[part]
            seen[some] = horizon.visible_share(x[some], y[some], z[some], cells)
        doubtful = (np.maximum(seen, seen.T) < 1) & (exchange > 0)
        receivers, senders = np.nonzero(np.triu(doubtful))
        seen = np.ones_like(seen)
        share = (np.arange(STEPS) + 0.5) / STEPS
        for part in _parts(len(receivers), STEPS):
            here, there = patches.centre[receivers[part]], patches.centre[senders[part]]
            way = here[:, None] + share[:, None] * (there - here)[:, None]
            over = self.surface.z(way[..., 0], way[..., 1]) - way[..., 2]
            clear = over.max(axis=1) < GRAZING_MM
            seen[receivers[part], senders[part]] = seen[senders[part], receivers[part]] = clear
        return seen


def _representatives(coarse: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Coarse patches and every fourth of the fine ones behind them; which of these stands for each patch."""
    row, column = np.indices((FINE_PATCHES, FINE_PATCHES)) // 2 * 2
    fine = coarse + (row * FINE_PATCHES + column).ravel()
    return np.unique(np.concatenate([np.arange(coarse), fine]), return_inverse=True)


def irradiance(points: Array, normals: Array, sources: Cells, power: Array) -> Array:
    """Irradiance by unobstructed cells.

    Parameters
    ----------
    points, normals : array, shape (n, 3)
        Receiving points (mm) and their unit normals.
    sources : Cells
        Emitting cells.
    power : array, shape (groups, cells)
        Radiance times area of every cell in the light of every group; where the exponent is not 1, that of
        a Lambertian cell of the same flux.

    Returns
    -------
    array, shape (groups, n)
    """
    total = np.empty((len(power), len(points)))
    for part in _parts(len(points), len(sources.area)):
        total[:, part] = power @ _exchange(points[part], normals[part], sources).T
    return total


def reflectances(rig: Rig, surface: HeightField, x: Array, y: Array) -> Array:
    """Reflectance of membrane points in the light of every group, shape (groups, points)."""
    return rig.coat.reflectance(rig.albedo, x, y, touched=surface.touched(x, y))


def form_factors(receivers: Patches, senders: Patches) -> Array:
    """Irradiance on patches per radiosity of others, (receivers, senders), by the disc approximation.

    A sender of area A at distance r counts as a disc: cos cos' A / (pi r^2 + A), exact far away and bounded
    near by (Wallace, Elmquist and Haines 1989, "A ray tracing algorithm for progressive radiosity").
    """
    return kernels.form_factors(
        receivers.centre, receivers.normal, senders.centre, senders.normal, senders.area
    )


def coarse_patches(rig: Rig, surface: HeightField, grid: PatchGrid, *, without: Box | None) -> Patches:
    """Patches of the whole membrane; areas count what lies within the gel's outline and outside a box."""
    x, y = grid.centres()
    fine = (np.arange(6) + 0.5) / 6 - 0.5
    split_x, split_y = (axis.ravel() for axis in np.meshgrid(fine * grid.pitch_x_mm, fine * grid.pitch_y_mm))
    point_x, point_y = x[:, None] + split_x, y[:, None] + split_y
    counted = elastomer.inside(rig.elastomer, point_x, point_y)
    if without is not None:
        counted &= ~without.contains(point_x, point_y)
    share = counted.mean(axis=1)
    return _patches(surface, x, y, share * grid.pitch_x_mm * grid.pitch_y_mm)


def fine_patches(rig: Rig, surface: HeightField, box: Box) -> tuple[Patches, PatchGrid]:
    """Patches of a box around an indentation."""
    pitch_x, pitch_y = (box.right - box.left) / FINE_PATCHES, (box.top - box.bottom) / FINE_PATCHES
    grid = PatchGrid(
        box.left + pitch_x / 2, box.bottom + pitch_y / 2, pitch_x, pitch_y, FINE_PATCHES, FINE_PATCHES
    )
    x, y = grid.centres()
    counted = elastomer.inside(rig.elastomer, x, y)
    return _patches(surface, x, y, np.asarray(counted * (pitch_x * pitch_y), dtype=float)), grid


def _patches(surface: HeightField, x: Array, y: Array, footprint_mm2: Array) -> Patches:
    normals = surface.normals(x, y)
    return Patches(np.stack([x, y, surface.z(x, y)], axis=-1), normals, footprint_mm2 / normals[:, 2])


def coarse_grid(rig: Rig) -> PatchGrid:
    """Grid of the patches of the whole membrane."""
    outline = elastomer.polygon(rig.elastomer)
    (left, bottom), (right, top) = outline.min(axis=0), outline.max(axis=0)
    columns, rows = int(np.ceil((right - left) / COARSE_MM)), int(np.ceil((top - bottom) / COARSE_MM))
    pitch_x, pitch_y = (right - left) / columns, (top - bottom) / rows
    return PatchGrid(left + pitch_x / 2, bottom + pitch_y / 2, pitch_x, pitch_y, rows, columns)


def _interpolate(grid: PatchGrid, field: Array, x: Array, y: Array) -> Array:
    return kernels.bilinear(field, *grid.place(x, y), True)


def _exchange(points: Array, normals: Array, sources: Cells) -> Array:
    """Cosine times cosine over squared distance, shape (points, cells), see `kernels.exchange`."""
    return kernels.exchange(points, normals, sources.centre, sources.normal, sources.exponent)


def _parts(points: int, cells: int) -> Iterator[slice]:
    step = max(1, CHUNK // max(cells, 1))
    for start in range(0, points, step):
        yield slice(start, min(start + step, points))
