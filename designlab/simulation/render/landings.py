"""What a press does to light on its first way to the membrane, photon by photon.

Every photon kept of the light field came along a straight line through the gel. An indentation that rises
into that line stops the photon earlier, on the side that faces the light, and leaves the place behind it
dark. Following each photon to where it lands now needs no cells and no direction bins.

Where gel bulges photons land a little further on. That moves all of them, none by much: sums over
directions know it as well and without grain. So photons are followed there only where raised gel keeps some
of them away.
"""

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter

from designlab.core.types import Array, Mask, Single
from designlab.simulation.contact.surface import Surface
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.nodes import RAISED_MM, NodeTables, base_normals
from designlab.simulation.render.tables import on_device, within
from designlab.simulation.render.walls import FURTHEST_MM

STEP_MM = 0.06  # along a photon's way through the indentation
TOLD_SHARE = 0.02  # of the photons, which raised gel must stop or throw, for them to tell all about a place
TOLD_MM = 0.8  # side of the square around a place over which they are counted
DRIFTS = 2  # rounds in which the place is found where a photon lands on lowered gel


class IrradianceChange(NamedTuple):
    """Change of irradiance at every grid node, shape (rows, columns), grainy but right on average.

    Attributes
    ----------
    light : array
        Change of power over projected area (1/mm2).
    squares : array
        Sum of the squares of what each photon adds or takes, over projected area (1/mm2): the variance of
        the sum over any area, photons counted as independent.
    told : array or None
        Where gel bulges, how much there is to learn from photons at each place: 0 where none of them was
        stopped, up to 1. None where no gel bulges: nothing else changes light there.
    """

    light: Single
    squares: Single
    told: Single | None = None


class FirstLight:
    """Light of one LED group on its first way to the membrane.

    Parameters
    ----------
    landings : array, shape (7, photons)
        Photons on the undeformed membrane, as in a `LightField`.
    untouched : Surface
        The undeformed membrane on the grid that all presses share.
    """

    def __init__(self, landings: Single, untouched: Surface) -> None:
        self._photons = [on_device(column) for column in landings]
        self._untouched = untouched

    @cached_property
    def _at_rest(self) -> tuple[Single, Single]:
        """Power, and squared power of each photon, over projected area (1/mm2) on the undeformed membrane."""
        x, y, *_, power = self._photons
        grid, shape = NodeTables.of(self._untouched), self._untouched.height_mm.shape
        amount, square = _densities(shape, _scattered(grid, shape, x, y, power, power * power))
        return amount, square

    @cached_property
    def _around_at_rest(self) -> Single:
        """Power of the photons around each place on the undeformed membrane, over projected area (1/mm2)."""
        return self._counted(self._at_rest[0])

    @cached_property
    def _flat(self) -> Array:
        """Upward component of the undeformed membrane's normals."""
        return np.asarray(base_normals(self._untouched)[2])

    def _counted(self, density: Single) -> Single:
        return np.asarray(uniform_filter(density, round(TOLD_MM / self._untouched.pitch_mm)))

    def change(self, surface: Surface) -> IrradianceChange:
        """Change of irradiance by a press."""
        raised = surface.height_mm > RAISED_MM
        none = np.zeros(raised.shape, dtype=np.float32)
        unchanged = IrradianceChange(none, none, none if surface.bulges else None)
        if not raised.any() or not dr.width(self._photons):
            return unchanged
        enters, leaves = _box(surface, raised, *self._photons[:6])
        near = dr.compress(enters < leaves)
        if not dr.width(near):
            return unchanged
        x, y, z, dx, dy, dz, power, enters, leaves = (
            dr.gather(mi.Float, column, near) for column in (*self._photons, enters, leaves)
        )
        grid = NodeTables.of(surface)
        back = _last_crossing(grid, (x, y, z), (dx, dy, dz), enters, leaves)
        dr.eval(back)  # or the loop would run again for what is gathered of it
        stopped = dr.compress(back > 0)
        left, arrived, left_squares, arrived_squares = 4 * [none]
        if dr.width(stopped):
            x, y, dx, dy, power, back = (
                dr.gather(mi.Float, column, stopped) for column in (x, y, dx, dy, power, back)
            )
            there = x + back * dx, y + back * dy
            amounts = power, power * power
            tables = _scattered(grid, raised.shape, x, y, *amounts)
            tables += _scattered(grid, raised.shape, *there, *amounts)
            left, left_squares, arrived, arrived_squares = _densities(raised.shape, tables)
        rest, squares = self._at_rest
        told = None
        if surface.bulges:
            moved = self._counted(left + arrived) / np.maximum(TOLD_SHARE * self._around_at_rest, 1e-30)
            told = np.clip(moved, 0.0, 1.0).astype(np.float32)
            arrived = arrived + self._drifted(surface, grid, told, dr.gather(mi.UInt32, near, stopped))
        upright, flat = surface.normals[..., 2], self._flat
        on_gel = np.isfinite(surface.base_mm)
        light = (rest - left + arrived) * upright - rest * flat
        # Photons that stay count by what the slope makes of them, the others by where they come and go.
        varies = (squares - left_squares) * (upright - flat) ** 2 + arrived_squares * upright**2
        varies += left_squares * flat**2
        found = [np.where(on_gel, one, 0.0).astype(np.float32) for one in (light, varies)]
        return IrradianceChange(found[0], found[1], told)

    def _drifted(self, surface: Surface, grid: NodeTables, told: Single, stopped: Any) -> Single:
        """Power over projected area (1/mm2) that lands on lowered gel, less what would without the press.

        Of photons that nothing stops, where there is something to learn from photons. Each goes on about as
        far as its neighbours, so that their grain stays what it is.
        """
        none = np.zeros(told.shape, dtype=np.float32)
        if not (told > 0).any():
            return none
        x, y, *_ = self._photons
        free = dr.full(mi.Bool, True, dr.width(x))
        dr.scatter(free, False, stopped)
        some_x, some_y = surface.x_mm[(told > 0).any(axis=0)], surface.y_mm[(told > 0).any(axis=1)]
        margin = surface.pitch_mm
        boxed = (x >= some_x.min() - margin) & (x <= some_x.max() + margin)
        boxed &= (y >= some_y.min() - margin) & (y <= some_y.max() + margin)
        near = dr.compress(free & boxed)
        if not dr.width(near):
            return none
        x, y = (dr.gather(mi.Float, column, near) for column in (x, y))
        told_at = on_device(told)
        moving = dr.compress((grid.sample(grid.raised, x, y) < 0) & (grid.sample(told_at, x, y) > 0))
        if not dr.width(moving):
            return none
        moving = dr.gather(mi.UInt32, near, moving)
        x, y, z, dx, dy, dz, power = (dr.gather(mi.Float, column, moving) for column in self._photons)
        sinking = dz
        for slope, along in ((surface.base_p, dx), (surface.base_q, dy)):
            slope = np.nan_to_num(slope)
            if slope.any():
                sinking = sinking - grid.sample(on_device(slope), x, y) * along
        sinking = dr.maximum(sinking, 1e-3)
        furthest = FURTHEST_MM / dr.maximum(dr.sqrt(dx * dx + dy * dy), 1e-3)
        back = dr.zeros(mi.Float, dr.width(x))
        for _ in range(DRIFTS):
            gap = z + back * dz - grid.sample(grid.z, x + back * dx, y + back * dy)
            back = dr.clip(back - gap / sinking, -furthest, 0.0)
        change = _scattered(grid, told.shape, x + back * dx, y + back * dy, power)
        _scattered(grid, told.shape, x, y, -power, into=change)
        return _densities(told.shape, change)[0]


def _box(
    surface: Surface, raised: Mask, x: Any, y: Any, z: Any, dx: Any, dy: Any, dz: Any
) -> tuple[Any, Any]:
    """Distances from the membrane at which a photon's way enters and leaves the box around an indentation."""
    at_x, at_y = surface.x_mm[raised.any(axis=0)], surface.y_mm[raised.any(axis=1)]
    margin = surface.pitch_mm
    return within(
        (
            (x, dx, at_x.min() - margin, at_x.max() + margin),
            (y, dy, at_y.min() - margin, at_y.max() + margin),
            (z, dz, -np.inf, surface.z_mm[raised].max()),
        )
    )


def _last_crossing(grid: NodeTables, place: Any, way: Any, enters: Any, leaves: Any) -> Any:
    """How far back along its way a photon meets the pressed membrane; zero where it lands as before."""
    (x, y, z), (dx, dy, dz) = place, way

    def above(s: Any) -> Any:
        return z + s * dz - grid.sample(grid.z, x + s * dx, y + s * dy)

    def going(s: Any, *_: Any) -> Any:
        return s < leaves

    def step(s: Any, before: Any, found: Any) -> Any:
        s = s + STEP_MM
        gap = above(s)
        crosses = (before < 0) & (gap >= 0)
        return s, gap, dr.select(crosses, s - STEP_MM * gap / dr.maximum(gap - before, 1e-9), found)

    start = (enters, above(enters), dr.zeros(mi.Float, dr.width(x)))
    _, _, found = dr.while_loop(start, going, step, labels=("s", "gap", "found"))
    return found


def _densities(shape: tuple[int, ...], tables: list[Any]) -> list[Single]:
    """Tables that `_scattered` made as images."""
    dr.eval(*tables)  # in one kernel
    return [np.asarray(table).reshape(shape) for table in tables]


def _scattered(
    grid: NodeTables, shape: tuple[int, ...], x: Any, y: Any, *amounts: Any, into: list[Any] | None = None
) -> list[Any]:
    """Tables of amounts over projected area (1/mm2), each photon's shared among the four nodes around it.

    They are not evaluated yet; given some, amounts are added to these.
    """
    rows, columns = shape
    tables = [dr.zeros(mi.Float, rows * columns) for _ in amounts] if into is None else into
    u, v = grid.place(x, y)
    column, row = mi.Int32(dr.floor(u)), mi.Int32(dr.floor(v))
    a, b = u - mi.Float(column), v - mi.Float(row)
    shares = [amount / (grid.pitch_mm * grid.pitch_mm) for amount in amounts]
    for i, down in ((0, 1 - b), (1, b)):
        for j, across in ((0, 1 - a), (1, a)):
            r, c = row + i, column + j
            inside = (r >= 0) & (r < mi.Int32(grid.rows)) & (c >= 0) & (c < mi.Int32(grid.columns))
            index = mi.UInt32(dr.maximum(r * mi.Int32(grid.columns) + c, 0))
            for table, share in zip(tables, shares, strict=True):
                dr.scatter_add(table, share * down * across, index, inside)
    return tables
