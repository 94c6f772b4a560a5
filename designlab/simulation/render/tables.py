"""Numbers and tables on the device."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.simulation.render.engine import dr, mi

ALIGNED = 64  # bytes, that vector instructions load at once


def held(value: int | float) -> Any:
    """Return a number that kernels read from memory, so that another value needs no other kernel."""
    return dr.opaque(mi.UInt32 if isinstance(value, int) else mi.Float, value)


def on_device(values: NDArray[Any]) -> Any:
    """Take an array to the device as one column of numbers, unsigned whole ones if it holds whole numbers.

    Kernels are compiled for the alignment of what they read. NumPy's memory is aligned by chance, which would
    have the same kernel compiled over and over; this is a copy, aligned like all others.
    """
    whole = np.issubdtype(values.dtype, np.integer)
    dtype = np.dtype(np.uint32 if whole else np.float32)
    spare = ALIGNED // dtype.itemsize
    memory = np.empty(values.size + spare, dtype=dtype)
    first = -memory.ctypes.data % ALIGNED // dtype.itemsize
    column = memory[first : first + values.size]
    column.reshape(values.shape)[...] = values
    return (mi.UInt32 if whole else mi.Float)(column)


def within(bounds: Iterable[tuple[Any, Any, float, float]]) -> tuple[Any, Any]:
    """Distances at which rays enter and leave a box; where they miss it they leave before they enter.

    Parameters
    ----------
    bounds : iterable of tuple
        For each axis, start and direction of the rays, and the lower and upper side of the box.
    """
    enters, leaves = 0.0, float("inf")
    for start, direction, low, high in bounds:
        safe = dr.select(dr.abs(direction) < 1e-6, 1e-6, direction)
        a, b = ((held(float(side)) - start) / safe for side in (low, high))
        enters = dr.maximum(enters, dr.minimum(a, b))
        leaves = dr.minimum(leaves, dr.maximum(a, b))
    return enters, leaves


def cell(u: Any, v: Any, rows: Any, columns: Any) -> tuple[Any, Any]:
    """Index of the entry of a table (rows, columns) next to column u and row v, and whether there is one.

    Counts are numbers or `held`.
    """
    column, row = mi.Int32(dr.floor(u + 0.5)), mi.Int32(dr.floor(v + 0.5))
    rows, columns = mi.Int32(rows), mi.Int32(columns)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    return mi.UInt32(dr.maximum(row * columns + column, 0)), inside


def bilinear(table: Any, u: Any, v: Any, rows: Any, columns: Any, first: Any = 0) -> Any:
    """Interpolate a table (rows, columns) at fractional column u and row v.

    Beyond the table its nearest edge value holds. `first` is the index of its first value. Counts are numbers
    or `held`.
    """
    u, v = dr.clip(u, 0.0, mi.Float(columns) - 1.001), dr.clip(v, 0.0, mi.Float(rows) - 1.001)
    column, row = mi.UInt32(u), mi.UInt32(v)
    a, b = u - mi.Float(column), v - mi.Float(row)
    index = first + row * columns + column
    top = dr.lerp(dr.gather(mi.Float, table, index), dr.gather(mi.Float, table, index + 1), a)
    bottom = dr.lerp(
        dr.gather(mi.Float, table, index + columns), dr.gather(mi.Float, table, index + columns + 1), a
    )
    return dr.lerp(top, bottom, b)
