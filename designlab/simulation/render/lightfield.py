"""Light that falls on the undeformed membrane, kept by place and direction, and photon by photon."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from designlab.core.types import Array, Mask, Single
from designlab.simulation.scene.scene import Scene

AZIMUTHS, SLANTS, CELL_MM = 48, 33, 1.0
FINE_CELL_MM = 0.35  # of the irradiance: where light ends sharply, as at the edge of a refracted beam
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
class Field:
    """Light on the undeformed membrane by place and direction.

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
        """Irradiance (1/mm2) of the undeformed membrane on a grid (mm), shape (y, x), by cubic splines."""
        table, pitch_mm = self.irradiance[group], FINE_CELL_MM / NODES_PER_CELL
        for axis in (0, 1):
            table = _at_nodes(table, axis)
        for axis, at in enumerate(((y - self.y_mm) / pitch_mm, (x - self.x_mm) / pitch_mm)):
            last = table.shape[axis] - 1
            spline = make_interp_spline(np.arange(last + 1), table, axis=axis)
            table = spline(np.clip(at, 0, last))
        return np.asarray(table)

    def vector(self, group: int) -> Single:
        """Vector irradiance at nodes as of `Bins`, shape (3, rows, columns), no bins merged."""
        cells, bins = self.power[group].shape[:2], SLANTS * AZIMUTHS
        summed = self.power[group].reshape(-1, bins) @ _directions().reshape(bins, 3).astype(np.float32)
        found = np.moveaxis(summed.reshape(*cells, 3), -1, 0)
        for axis in (1, 2):
            found = _at_nodes(found, axis)
        return np.asarray(found, dtype=np.float32)

    def bins(self, group: int, *, fine: bool) -> Bins:
        """Direction bins of one group, cell means turned into values between which one may interpolate.

        If `fine`, bright bins, which hold the images of the LEDs, stay as they are; the dim rest is merged
        into blocks.
        """
        power = self.power[group].transpose(2, 3, 0, 1)
        total = power.sum(axis=(2, 3), dtype=float)
        bright = (total > BRIGHT_BIN * max(float(total.sum()), 1e-300)) & fine
        slants, azimuths = np.nonzero(bright)
        single = power[bright], slants, slants + 1, azimuths, _directions()[bright]
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
            np.concatenate(pair) for pair in zip(single, coarse, strict=True)
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


@dataclass(frozen=True, eq=False)
class LightField:
    """Light on the undeformed membrane.

    Attributes
    ----------
    first : Field or None
        Light that comes to the membrane for the first time, scattered by no haze; None where it is integrated
        over the LEDs' faces instead, which is exact.
    again : Field
        Light that was at the membrane before, or that haze has scattered; in air, all that did not come
        straight from an LED.
    landings : tuple of array, shape (7, photons)
        The photons that `first` is the sum of, or some of them, for each group: place on the membrane (mm),
        unit vector back towards the light, and power (mW, of the 1 mW that the group emits).
    """

    first: Field | None
    again: Field
    landings: tuple[Single, ...]


def mean(fields: Sequence[LightField]) -> LightField:
    """Mean of independent light fields of one scene."""
    if len(fields) == 1:
        return fields[0]

    def of(parts: Sequence[Field]) -> Field:
        power, irradiance = (
            np.asarray(sum(getattr(part, name) for part in parts) / np.float32(len(parts)))
            for name in ("power", "irradiance")
        )
        return Field(power, irradiance, parts[0].x_mm, parts[0].y_mm)

    # Together they are photons of one trace, each of which carries less.
    share = np.array([1] * 6 + [1 / len(fields)], dtype=np.float32)[:, None]
    lots = zip(*(field.landings for field in fields), strict=True)
    landings = tuple(share * np.concatenate(lot, axis=1) for lot in lots)
    first = [field.first for field in fields if field.first is not None]
    return LightField(of(first) if first else None, of([field.again for field in fields]), landings)


def packed(fields: Sequence[LightField]) -> dict[str, NDArray[Any]]:
    """Light fields as named arrays."""
    arrays: dict[str, NDArray[Any]] = {}
    for k, field in enumerate(fields):
        for name, part in (("first", field.first), ("again", field.again)):
            if part is not None:
                arrays[f"{k} {name} power"], arrays[f"{k} {name} irradiance"] = part.power, part.irradiance
                arrays[f"{k} {name} corner"] = np.array([part.x_mm, part.y_mm])
        for group, lot in enumerate(field.landings):
            arrays[f"{k} landings {group}"] = lot
    return arrays


def unpacked(arrays: Mapping[str, NDArray[Any]]) -> list[LightField]:
    """Light fields from the arrays that `packed` made."""

    def part(name: str) -> Field | None:
        if f"{name} power" not in arrays:
            return None
        x_mm, y_mm = (float(v) for v in arrays[f"{name} corner"])
        return Field(arrays[f"{name} power"], arrays[f"{name} irradiance"], x_mm, y_mm)

    fields: list[LightField] = []
    while (again := part(f"{len(fields)} again")) is not None:
        k, lots = len(fields), list[Single]()
        while (lot := arrays.get(f"{k} landings {len(lots)}")) is not None:
            lots.append(lot)
        fields.append(LightField(part(f"{k} first"), again, tuple(lots)))
    return fields


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


def on_membrane(scene: Scene, x: Array, y: Array) -> Mask:
    """Points within the outline of the membrane."""
    from scipy.spatial import ConvexHull

    triangles = scene.membrane.vertices[scene.membrane.faces][:, :, :2]
    outline = triangles.reshape(-1, 2)
    hull = ConvexHull(outline[:: max(1, len(outline) // 200_000)])
    inside = np.ones(np.shape(x), dtype=bool)
    for across, along, offset in hull.equations:
        inside &= across * x + along * y + offset <= 1e-9
    return inside
