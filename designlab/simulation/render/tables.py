"""Numbers and tables on the device."""

from typing import Any


def held(value: int | float) -> Any:
    """Return a number that kernels read from memory, so that another value needs no other kernel."""
    import drjit as dr
    import mitsuba as mi

    return dr.opaque(mi.UInt32 if isinstance(value, int) else mi.Float, value)


def bilinear(table: Any, u: Any, v: Any, rows: Any, columns: Any, first: Any = 0) -> Any:
    """Interpolate a table (rows, columns) at fractional column u and row v.

    Beyond the table its nearest edge value holds. `first` is the index of its first value. Counts are numbers
    or `held`.
    """
    import drjit as dr
    import mitsuba as mi

    u, v = dr.clip(u, 0.0, mi.Float(columns) - 1.001), dr.clip(v, 0.0, mi.Float(rows) - 1.001)
    column, row = mi.UInt32(u), mi.UInt32(v)
    a, b = u - mi.Float(column), v - mi.Float(row)
    index = first + row * columns + column
    top = dr.lerp(dr.gather(mi.Float, table, index), dr.gather(mi.Float, table, index + 1), a)
    bottom = dr.lerp(
        dr.gather(mi.Float, table, index + columns), dr.gather(mi.Float, table, index + columns + 1), a
    )
    return dr.lerp(top, bottom, b)
