"""Interpolation in tables on the device."""

from typing import Any


def bilinear(table: Any, u: Any, v: Any, rows: int, columns: int, first: Any = 0) -> Any:
    """Interpolate a table (rows, columns) at fractional column u and row v.

    Beyond the table its nearest edge value holds. `first` is the index of its first value.
    """
    import drjit as dr
    import mitsuba as mi

    u, v = dr.clip(u, 0.0, columns - 1.001), dr.clip(v, 0.0, rows - 1.001)
    column, row = mi.UInt32(u), mi.UInt32(v)
    a, b = u - mi.Float(column), v - mi.Float(row)
    index = first + row * columns + column
    top = dr.lerp(dr.gather(mi.Float, table, index), dr.gather(mi.Float, table, index + 1), a)
    bottom = dr.lerp(
        dr.gather(mi.Float, table, index + columns), dr.gather(mi.Float, table, index + columns + 1), a
    )
    return dr.lerp(top, bottom, b)
