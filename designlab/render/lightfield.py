"""Light that falls on the undeformed membrane, traced once per design and kept by place and direction."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.render import photons as tracing
from designlab.render.tables import held
from designlab.scene import Scene

Array = NDArray[np.float64]
Single = NDArray[np.float32]
STEEPEST_COSINE = 0.02  # light more grazing than this weighs as if it came at this angle
AZIMUTHS, SLANTS, CELL_MM = 48, 33, 1.0
FINE_CELL_MM = 0.5  # of the irradiance: where light ends sharply, as at the edge of a refracted beam
PILOT_SHARE = 0.2  # of the photons, traced beforehand to learn where on the LEDs others are best started
WIDEST_SLANT_DEG = 99.0  # on a dome light can come from slightly below the apex plane
NODES_PER_CELL = 2
BRIGHT_BIN = 1e-3  # bins with a smaller share of the group's light are merged
BLOCK = 3  # bins merged along slant and azimuth


@dataclass(frozen=True, eq=False)
class Bins:
    """Direction bins of one LED group that hold light.

    Attributes
    ----------
    power : array, shape (bins, rows, columns)
        Fluence at unit flux (1/mm2) at nodes `pitch_mm` apart, the first one where the field's first cell is.
    direction : array, shape (bins, 3)
        Unit vectors towards the light.
    lower, upper : array, shape (bins,)
        Tangent of the elevation of each bin's edges.
    azimuth : array, shape (bins,)
        Number of each bin's azimuth.
    """

    power: Single
    direction: Array
    lower: Array
    upper: Array
    azimuth: NDArray[np.int64]
    pitch_mm: float

    @cached_property
    def vector(self) -> Single:
        """Vector irradiance, shape (3, rows, columns): its product with a normal is the irradiance."""
        return np.asarray(np.einsum("brc,bk->krc", self.power, self.direction), dtype=np.float32)


@dataclass(frozen=True, eq=False)
class LightField:
    """Light on the undeformed membrane.

    Attributes
    ----------
    power : array, shape (groups, y cells, x cells, slants, azimuths)
        Mean fluence per cell and bin at unit flux: power over projected area, 1/mm2.
    irradiance : array, shape (groups, y fine cells, x fine cells)
        Mean irradiance of the undeformed membrane at unit flux, 1/mm2, in finer cells.
    x_mm, y_mm : float
        Centre of the first cell of either kind.
    """

    power: Single
    irradiance: Single
    x_mm: float
    y_mm: float

    def irradiance_at(self, group: int, x: Array, y: Array) -> Array:
        """Irradiance (1/mm2) of the undeformed membrane at points (mm), interpolated smoothly."""
        table, pitch_mm = self.irradiance[group], FINE_CELL_MM / NODES_PER_CELL
        for axis in (0, 1):
            table = _at_nodes(table, axis)
        at = [(y - self.y_mm) / pitch_mm, (x - self.x_mm) / pitch_mm]
        return np.asarray(map_coordinates(table, at, order=3, mode="nearest"))

    def bins(self, group: int) -> Bins:
        """Direction bins of one group, cell means turned into values between which one may interpolate.

        Bright bins, which hold the images of the LEDs, stay as they are; the dim rest, light that bounced
        from the membrane before, is merged into blocks.
        """
        power = self.power[group].transpose(2, 3, 0, 1)
        total = power.sum(axis=(2, 3), dtype=float)
        bright = total > BRIGHT_BIN * max(float(total.sum()), 1e-300)
        slants, azimuths = np.nonzero(bright)
        fine = power[bright], slants, slants + 1, azimuths, _directions()[bright]
        blocks = (SLANTS // BLOCK, BLOCK, AZIMUTHS // BLOCK, BLOCK)
        rest = np.where(bright[..., None, None], np.float32(0), power)
        dim = np.where(bright, 0.0, total)[..., None] * _directions()
        merged = rest.reshape(*blocks, *power.shape[2:]).sum(axis=(1, 3))
        mean = dim.reshape(*blocks, 3).sum(axis=(1, 3))
        used = merged.sum(axis=(2, 3)) > 0
        first, turn = np.nonzero(used)
        mean = mean[used] / np.linalg.norm(mean[used], axis=-1, keepdims=True)
        coarse = merged[used], BLOCK * first, BLOCK * (first + 1), BLOCK * turn + BLOCK // 2, mean
        table, low, high, azimuth, direction = (
            np.concatenate(pair) for pair in zip(fine, coarse, strict=True)
        )
        for axis in (1, 2):
            table = _at_nodes(table, axis)
        edge = np.radians(WIDEST_SLANT_DEG / SLANTS)
        return Bins(
            power=np.ascontiguousarray(table, dtype=np.float32),
            direction=direction,
            lower=np.tan(np.pi / 2 - high * edge),
            upper=np.tan(np.pi / 2 - np.maximum(low * edge, 1e-3)),
            azimuth=azimuth,
            pitch_mm=CELL_MM / NODES_PER_CELL,
        )


def mean(fields: Sequence[LightField]) -> LightField:
    """Mean of independent light fields of one scene."""
    power, irradiance = (
        np.asarray(np.mean([getattr(field, name) for field in fields], axis=0), dtype=np.float32)
        for name in ("power", "irradiance")
    )
    return LightField(power, irradiance, fields[0].x_mm, fields[0].y_mm)


def _directions() -> Array:
    """Unit vectors towards the light, shape (slants, azimuths, 3)."""
    slant = np.radians((np.arange(SLANTS) + 0.5) * WIDEST_SLANT_DEG / SLANTS)
    azimuth = (np.arange(AZIMUTHS) + 0.5) * 2 * np.pi / AZIMUTHS
    s, a = np.meshgrid(slant, azimuth, indexing="ij")
    return np.stack([np.sin(s) * np.cos(a), np.sin(s) * np.sin(a), np.cos(s)], axis=-1)


def _at_nodes(means: Single, axis: int) -> Single:
    """Values at cell centres and half-way between from cell means, exact for quadratics.

    A quadratic spline with these coefficients has the given means: its smoothing and that of the mean, 1/8
    and 1/24 of the second difference, are taken off beforehand.
    """
    means = np.moveaxis(means, axis, 0)
    padded = np.concatenate([means[:1], means, means[-1:]])
    spline = means - (padded[2:] - 2 * means + padded[:-2]) / 6
    padded = np.concatenate([spline[:1], spline, spline[-1:]])
    centres = (padded[2:] + 6 * spline + padded[:-2]) / 8
    found = np.empty((2 * len(means) - 1, *means.shape[1:]), dtype=np.float32)
    found[::2] = centres
    found[1::2] = (spline[1:] + spline[:-1]) / 2
    return np.moveaxis(found, 0, axis)


def bake(scene: Scene, *, photons: int, seed: int) -> LightField:
    """Trace the light field of an undeformed scene, every LED group at unit flux.

    Where light runs straight from LED to membrane, that direct light is left out: it is integrated over the
    LED's face, which is exact.

    Parameters
    ----------
    scene : Scene
        The undeformed scene.
    photons : int
        Photons for each LED group.
    seed : int
        Seed of the random numbers.
    """
    import drjit as dr
    import mitsuba as mi

    low, high = scene.membrane.vertices.min(axis=0), scene.membrane.vertices.max(axis=0)
    coarse, fine = (_cells(low, high, cell_mm) for cell_mm in (CELL_MM, FINE_CELL_MM))
    bins = SLANTS * AZIMUTHS
    first = 0 if scene.refracts else 1
    powers, irradiances = [], []
    for group in range(scene.groups):
        table, light = dr.zeros(mi.Float, coarse[0] * coarse[1] * bins), dr.zeros(mi.Float, fine[0] * fine[1])

        def record(arrival: tracing.Arrival, active: Any, *, table: Any = table, light: Any = light) -> None:
            position, normal, towards = arrival.at.p, arrival.at.n, arrival.towards
            cell, inside = _cell(position, low, CELL_MM, coarse)
            slant = mi.Int32(dr.rad2deg(dr.safe_acos(towards.z)) / WIDEST_SLANT_DEG * SLANTS)
            turn = dr.atan2(towards.y, towards.x) / (2 * dr.pi)
            azimuth = dr.minimum(mi.Int32((turn - dr.floor(turn)) * AZIMUTHS), AZIMUTHS - 1)
            index = (cell * SLANTS + slant) * AZIMUTHS + azimuth
            cosine = dr.maximum(dr.dot(normal, towards), STEEPEST_COSINE)
            # A tilted cell has more area than its projection, which cancels one of the two cosines.
            kept = active & (arrival.bounces >= first)
            shared = arrival.power * dr.abs(normal.z)
            dr.scatter_add(table, shared / cosine, mi.UInt32(index), kept & inside & (slant < SLANTS))
            cell, inside = _cell(position, low, FINE_CELL_MM, fine)
            dr.scatter_add(light, shared, mi.UInt32(cell), kept & inside)

        if scene.path_length - 1 > first:  # else nothing but direct light counts
            _trace(scene, group, photons, seed, first, record)
        powers.append(np.asarray(table, dtype=np.float32).reshape(*coarse, SLANTS, AZIMUTHS) / CELL_MM**2)
        irradiances.append(np.asarray(light, dtype=np.float32).reshape(fine) / FINE_CELL_MM**2)
    shares = _filled(scene, low, CELL_MM, coarse)[..., None, None], _filled(scene, low, FINE_CELL_MM, fine)
    power, irradiance = (
        np.asarray(np.stack(tables) / share, dtype=np.float32)
        for tables, share in zip((powers, irradiances), shares, strict=True)
    )
    return LightField(power, irradiance, float(low[0]), float(low[1]))


def _trace(scene: Scene, group: int, photons: int, seed: int, first: int, record: tracing.Record) -> None:
    """Trace photons that start where a pilot run found that they reach the membrane."""
    import drjit as dr

    def worth(arrival: tracing.Arrival, active: Any) -> Any:
        return dr.select(active & (arrival.bounces >= first), arrival.power, 0.0)

    loaded = tracing.load(scene, group)
    pilot = min(tracing.PILOT, max(1, round(PILOT_SHARE * photons)))
    guide = tracing.learn(scene, group=group, seed=seed, worth=worth, loaded=loaded, photons=pilot)
    tracing.trace(scene, group=group, photons=photons, seed=seed, record=record, loaded=loaded, guide=guide)


def _cells(low: Array, high: Array, cell_mm: float) -> tuple[int, int]:
    """Rows and columns of cells over the membrane, the first one centred at its lowest x and y."""
    columns, rows = (int(np.ceil((high[k] - low[k]) / cell_mm)) + 1 for k in (0, 1))
    return rows, columns


def _cell(position: Any, low: Array, cell_mm: float, shape: tuple[int, int]) -> tuple[Any, Any]:
    """Number of the cell that a point lies in, and whether there is one."""
    import drjit as dr
    import mitsuba as mi

    column = mi.Int32(dr.floor((position.x - held(float(low[0]))) / cell_mm + 0.5))
    row = mi.Int32(dr.floor((position.y - held(float(low[1]))) / cell_mm + 0.5))
    inside = (column >= 0) & (column < shape[1]) & (row >= 0) & (row < shape[0])
    return row * shape[1] + column, inside


def _filled(scene: Scene, low: Array, cell_mm: float, shape: tuple[int, int]) -> Array:
    """Share of each cell that the membrane fills, at least half: the others hold too little light."""
    fine = round(8 * cell_mm / CELL_MM)
    rows, columns = shape
    offsets = (np.arange(fine) + 0.5) / fine - 0.5
    x = low[0] + (np.arange(columns)[:, None] + offsets).ravel() * cell_mm
    y = low[1] + (np.arange(rows)[:, None] + offsets).ravel() * cell_mm
    inside = on_membrane(scene, *np.meshgrid(x, y))
    return np.asarray(np.maximum(inside.reshape(rows, fine, columns, fine).mean(axis=(1, 3)), 0.5))


def on_membrane(scene: Scene, x: Array, y: Array) -> NDArray[np.bool_]:
    """Points within the outline of the membrane."""
    from scipy.spatial import ConvexHull

    triangles = scene.membrane.vertices[scene.membrane.faces][:, :, :2]
    outline = triangles.reshape(-1, 2)
    hull = ConvexHull(outline[:: max(1, len(outline) // 200_000)])
    points = np.stack([x, y], axis=-1)
    return np.asarray((points @ hull.equations[:, :2].T + hull.equations[:, 2] <= 1e-9).all(axis=-1))
