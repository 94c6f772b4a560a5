"""Which points of a pressed membrane are shaded, and the membrane's grid as tables on the device."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt

from designlab.core.types import Array, Mask, Single
from designlab.simulation.contact.surface import Surface
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.tables import bilinear, held, on_device

RAISED_MM = 1e-3  # lower indentations cast no shadow worth counting
FINE_MM = 0.2  # around the indentation every grid node is shaded
RIM_MM = 0.4  # likewise around the contact with gel that bulges, which falls off gently beyond it
TAIL_RIM_MM = 0.8  # likewise with gel that does not: kernels are narrower, only their tails go on, gently
STRIDE = 3  # further out one node in this many, along each axis
WIDE_STRIDE = 4 * STRIDE  # likewise all over a grid whose gel bulges
Response = Callable[[Any], Any]
"""Weight of light by the unit vector towards it, at every node."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """Membrane points that are shaded: Dr.Jit arrays of one value a node."""

    x: Any
    y: Any
    z: Any
    height: Any
    normal: Any
    base_p: Any
    base_q: Any


def nodes_of(surface: Surface, chosen: Mask) -> Nodes:
    """Chosen nodes of a surface's grid."""

    def column(values: Array) -> Any:
        return on_device(values[chosen])

    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    normals = surface.normals
    return Nodes(
        x=column(x),
        y=column(y),
        z=column(surface.z_mm),
        height=column(surface.height_mm),
        normal=mi.Vector3f(*(column(normals[..., k]) for k in range(3))),
        base_p=column(surface.base_p),
        base_q=column(surface.base_q),
    )


def facing(nodes: Nodes) -> Response:
    """Cosine between the membrane's normal and the light: what makes fluence irradiance."""
    return lambda towards: dr.maximum(dr.dot(nodes.normal, towards), 0.0)


def base_normals(surface: Surface) -> Array:
    """Normals of the undeformed membrane, shape (3, rows, columns)."""
    p, q = np.nan_to_num(surface.base_p), np.nan_to_num(surface.base_q)
    return np.stack([-p, -q, np.ones_like(p)]) / np.sqrt(1 + p**2 + q**2)


@dataclass(frozen=True, eq=False)
class Choice:
    """Grid nodes that are shaded: all those on and beside the indentation, every few ones around it.

    Gel that bulges is raised far beyond its contact too, but is smooth there: that all nodes only near the
    contact are shaded changes pictures by about 1 % of what a sharp press does, and less under a ball.

    Attributes
    ----------
    fine, coarse : bool array, shape (rows, columns)
        Nodes of either kind; the coarse ones lie `STRIDE` apart.
    wide : bool array, shape (rows, columns)
        Nodes `WIDE_STRIDE` apart, of the whole membrane where gel bulges, else none.
    """

    fine: Mask
    coarse: Mask
    wide: Mask

    @property
    def nodes(self) -> Mask:
        """Nodes of all kinds."""
        return self.fine | self.coarse | self.wide

    @staticmethod
    def near(surface: Surface, reach_mm: float) -> "Choice | None":
        """Nodes that an indentation may lift, lower, tilt, shadow or light; None where there is none."""
        raised = surface.height_mm > RAISED_MM
        there = np.isfinite(surface.base_mm)
        wide = np.zeros_like(raised)
        if surface.bulges:
            wide[::WIDE_STRIDE, ::WIDE_STRIDE] = there[::WIDE_STRIDE, ::WIDE_STRIDE]
        if not raised.any():
            return Choice(np.zeros_like(raised), np.zeros_like(raised), wide) if surface.bulges else None
        distance_mm = distance_transform_edt(~raised) * surface.pitch_mm
        fine = (distance_mm <= FINE_MM) & there
        if surface.contact.any():
            rim_mm = RIM_MM if surface.bulges else TAIL_RIM_MM
            fine &= distance_transform_edt(~surface.contact) * surface.pitch_mm <= rim_mm
        around = (distance_mm <= max(reach_mm, 2 * FINE_MM)) & there
        lattice = np.zeros_like(raised)
        lattice[::STRIDE, ::STRIDE] = True
        cell = np.ones((2 * STRIDE - 1, 2 * STRIDE - 1), dtype=bool)
        coarse = lattice & binary_dilation(around & ~fine, structure=cell) & there
        return Choice(fine, coarse, wide)

    def spread(self, values: NDArray[np.floating], outside: float) -> Single:
        """Values at the nodes as a whole grid: linear between coarse nodes, `outside` elsewhere."""
        grid = np.full(self.fine.shape, outside, dtype=np.float32)
        grid[self.nodes] = values
        lattice: NDArray[np.floating] = grid[::STRIDE, ::STRIDE]
        if self.wide.any():
            between = _refined(grid[::WIDE_STRIDE, ::WIDE_STRIDE], WIDE_STRIDE // STRIDE, lattice.shape)
            lattice = np.where((self.fine | self.coarse)[::STRIDE, ::STRIDE], lattice, between)
        return np.where(self.fine, grid, _refined(lattice, STRIDE, grid.shape)).astype(np.float32)


def _refined(lattice: NDArray[np.floating], stride: int, shape: tuple[int, ...]) -> NDArray[np.floating]:
    """Interpolate linearly between the points of a lattice `stride` apart."""
    found = lattice
    for axis, count in enumerate(shape):
        found = _linear(found, np.arange(count) / stride, axis)
    return found


def _linear(values: NDArray[np.floating], at: Array, axis: int) -> NDArray[np.floating]:
    """Interpolate linearly along one axis at fractional positions."""
    first = np.minimum(at.astype(int), values.shape[axis] - 1)
    second = np.minimum(first + 1, values.shape[axis] - 1)
    share = np.expand_dims(at - first, 1 - axis)
    return np.asarray(np.take(values, first, axis) * (1 - share) + np.take(values, second, axis) * share)


@dataclass(frozen=True, eq=False)
class NodeTables:
    """A surface's grid as Dr.Jit tables; `z` and `raised` are one table where the gel is flat."""

    left_mm: Any
    top_mm: Any
    pitch_mm: Any
    rows: Any
    columns: Any
    z: Any
    raised: Any

    @staticmethod
    def of(surface: Surface) -> "NodeTables":
        """Take a surface to the device."""
        corner = held(float(surface.x_mm[0])), held(float(surface.y_mm[0])), held(surface.pitch_mm)
        above = np.nan_to_num(surface.z_mm)
        z = on_device(above)
        raised = z if np.array_equal(above, surface.height_mm) else on_device(surface.height_mm)
        rows, columns = surface.height_mm.shape
        return NodeTables(*corner, held(rows), held(columns), z, raised)

    def place(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Fractional column and row of a point."""
        return (x - self.left_mm) / self.pitch_mm, (self.top_mm - y) / self.pitch_mm

    def above(self, x: Any, y: Any) -> tuple[Any, Any]:
        """Height of the membrane, and how far it is raised, at points (mm)."""
        z = self.sample(self.z, x, y)
        return z, z if self.raised is self.z else self.sample(self.raised, x, y)

    def sample(self, table: Any, x: Any, y: Any) -> Any:
        """Interpolate a table of the grid at points (mm)."""
        return bilinear(table, *self.place(x, y), self.rows, self.columns)
