"""The response of an elastic layer on a regular grid: in wave numbers, and to the load of one cell."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.ndimage import map_coordinates

from designlab.core.types import Array
from designlab.mechanics.layer import ElasticLayer

MARGIN = 5.0  # thicknesses; the response decays as exp(-0.74 r / h), so a repeated load is not felt further
MOST_POINTS = 1536  # a side, of a grid that a response is taken from
SMOOTH, EDGE, REPEAT = 1.4, 4, 40.0  # coarse points, points, widths: where waves are parted by their length


@lru_cache(maxsize=24)
def kernel(layer: ElasticLayer, pitch_mm: float, size: int, part: str) -> tuple[NDArray[Any], int]:
    """Spectrum of the response on a grid of `size` points a side, padded so that nothing wraps around."""
    padded = fft.next_fast_len(2 * size - 1, real=True)
    offsets = np.r_[0 : padded - size + 1, 1 - size : 0]
    return np.asarray(fft.rfft2(_table(layer, pitch_mm, offsets, part))), padded


def _table(layer: ElasticLayer, pitch_mm: float, offsets: NDArray[np.int_], part: str) -> Array:
    """Response to the load of a cell, so many rows and columns away from it.

    It is taken from a grid so large that repeats of the load are not felt. Of a thick layer on a fine grid
    that grid would be huge: waves that are long for the pitch have a coarser one there.
    """
    reach = 2 * int(np.abs(offsets).max())
    wide = math.ceil(reach + 2 * MARGIN * layer.thickness_mm / pitch_mm)
    if wide <= MOST_POINTS:
        return _periodic(symbol(layer, pitch_mm, *_square(wide), part), wide)[np.ix_(offsets, offsets)]
    coarser = math.ceil(wide / (MOST_POINTS - 2 * EDGE))
    width = SMOOTH * coarser * pitch_mm
    near = math.ceil(reach + REPEAT * width / pitch_mm)
    short = symbol(layer, pitch_mm, *_square(near), part)
    q = wavenumber(pitch_mm, *_square(near))[2]
    fine = _periodic(short * -np.expm1(-((q * width) ** 2) / 2), near)[np.ix_(offsets, offsets)]
    count = math.ceil(wide / coarser) + 2 * EDGE
    spacing = coarser * pitch_mm
    along_x, along_y, q = wavenumber(spacing, *_square(count))
    even = _even(along_x, along_y, pitch_mm) / coarser**2  # of the load of a coarse cell
    long = even * _response(layer, along_x, along_y, q, part) * np.exp(-((q * width) ** 2) / 2)
    coarse = np.roll(_periodic(long, count), _square(count)[0] // 2, axis=(0, 1))
    at = offsets / coarser + _square(count)[0] // 2
    return np.asarray(fine + map_coordinates(coarse, np.meshgrid(at, at, indexing="ij"), order=3))


def _square(points: int) -> tuple[int, int]:
    """Rows and columns of a square grid of at least so many points a side that transforms are fast on."""
    side = fft.next_fast_len(points, real=True)
    return side, side


def _periodic(symbol: NDArray[Any], points: int) -> Array:
    """Response on a periodic grid."""
    return np.asarray(fft.irfft2(symbol, s=_square(points), workers=2))


@lru_cache(maxsize=12)
def symbol(layer: ElasticLayer, pitch_mm: float, rows: int, columns: int, part: str) -> NDArray[Any]:
    """Response in wave numbers of a periodic grid, for `fft.rfft2`; "xz" is x displacement by pressure.

    A load is even over each cell of the grid. Loads between whose points a wave is laid instead leave the
    edge of a flat punch 1 % too soft at 20 cells of radius.
    """
    along_x, along_y, q = wavenumber(pitch_mm, rows, columns)
    return np.asarray(_even(along_x, along_y, pitch_mm) * _response(layer, along_x, along_y, q, part))


def _even(along_x: Array, along_y: Array, cell_mm: float) -> Array:
    """Spectrum of a load that is even over a cell."""
    return np.asarray(np.sinc(along_x * cell_mm / (2 * np.pi)) * np.sinc(along_y * cell_mm / (2 * np.pi)))


def _response(layer: ElasticLayer, along_x: Array, along_y: Array, q: Array, part: str) -> NDArray[Any]:
    """Response of a layer at wave numbers, without the shape of the load."""
    if part == "zz":
        return layer.normal(q)
    unit = np.where(q > 0, q, 1.0)
    x, y = along_x / unit, along_y / unit
    # Odd functions have no value at the highest wave number of an even grid.
    odd = (np.abs(along_x) < np.abs(along_x).max()) & (np.abs(along_y) < np.abs(along_y).max())
    if "z" in part:
        sign = -1j if part[1] == "z" else 1j
        return np.asarray(np.where(odd, sign * layer.coupling(q) * (x if "x" in part else y), 0.0))
    along, across = layer.along(q), layer.across(q)
    if part == "xy":
        return np.asarray(np.where(odd, x * y * (along - across), 0.0))
    share = {"xx": x, "yy": y}[part] ** 2
    return np.asarray(share * along + (1 - share) * across)


def wavenumber(pitch_mm: float, rows: int, columns: int) -> tuple[Array, Array, Array]:
    """Wave number along columns, along rows and in all, of `fft.rfft2` (1/mm)."""
    along_y = 2 * np.pi * fft.fftfreq(rows, pitch_mm)[:, None]
    along_x = 2 * np.pi * fft.rfftfreq(columns, pitch_mm)[None, :]
    return along_x, along_y, np.hypot(along_x, along_y)
