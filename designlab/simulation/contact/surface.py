"""The deformed membrane: the surface rendered, and the truth that reconstruction is judged by."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.core.types import Array

ROUNDING_MM = 1e-6  # nearer to the undeformed membrane than this nothing has moved


@dataclass(frozen=True)
class Mechanics:
    """What a press of an elastic gel takes.

    Attributes
    ----------
    depth_mm : float
        Largest penetration below the undeformed membrane, along the press (mm).
    force_n : float
        Force along the press, z but where it is made along the normal (N).
    shear_force_n : (float, float)
        Force along x and y on the gel, turned with the press (N).
    contact_area_mm2, contact_radius_mm : float
        Area of the contact, and radius of a circle of that area.
    bulge_um : float
        How far the membrane bulges below its undeformed shape at most, where the surface shows it (um).
    converged : bool
        Always true: a contact that was not solved gives no surface.
    """

    depth_mm: float
    force_n: float
    shear_force_n: tuple[float, float]
    contact_area_mm2: float
    contact_radius_mm: float
    bulge_um: float
    converged: bool = True

    def to_json(self) -> dict[str, Any]:
        """Figures as plain data."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface is the membrane on a regular grid: row 0 at +y, heights above the undeformed base.

    Attributes
    ----------
    x_mm, y_mm : array, shapes (columns,) and (rows,)
        Grid coordinates in mm; `y_mm` descends.
    height_mm : array, shape (rows, columns)
        Indentation in mm, positive towards the camera. Negative where gel bulges away from it, as around
        contacts of a layer that keeps its volume, out to the border of the grid.
    base_mm : array, shape (rows, columns)
        Height of the undeformed membrane in mm; NaN where there is none.
    base_p, base_q : array, shape (rows, columns)
        Slopes dz/dx and dz/dy of the undeformed membrane.
    contact : bool array, shape (rows, columns)
        Whether the probe touches the membrane.
    mechanics : Mechanics or None
        What the press takes; None for an untouched gel, and where no force is known.
    warnings : tuple of str
        Where the model of contact is used beyond what it holds for.
    moved : callable, optional
        Gives how far the skin moved along x and y (mm), two arrays; it stays in place when absent.
    """

    x_mm: Array
    y_mm: Array
    height_mm: Array
    base_mm: Array
    base_p: Array
    base_q: Array
    contact: NDArray[np.bool_]
    mechanics: Mechanics | None = None
    warnings: tuple[str, ...] = ()
    moved: Callable[[], tuple[Array, Array]] | None = None

    @property
    def pitch_mm(self) -> float:
        """Distance of neighbouring grid points (mm)."""
        return float(self.x_mm[1] - self.x_mm[0])

    @cached_property
    def sideways_mm(self) -> tuple[Array, Array]:
        """How far the skin moved along x and y (mm), two arrays of shape (rows, columns)."""
        if self.moved is None:
            return np.zeros_like(self.height_mm), np.zeros_like(self.height_mm)
        return self.moved()

    @cached_property
    def bulges(self) -> bool:
        """Whether gel stands lower than undeformed; a bulge is smooth, and may cover the whole grid."""
        return bool(self.height_mm.min() < -ROUNDING_MM)

    @cached_property
    def z_mm(self) -> Array:
        """Height of the membrane in the sensor frame (mm), shape (rows, columns)."""
        return self.base_mm + self.height_mm

    @cached_property
    def indentation_gradient(self) -> tuple[Array, Array]:
        """Slopes dz/dx and dz/dy of the indentation alone (central differences)."""
        along_y, along_x = np.gradient(self.height_mm, self.y_mm, self.x_mm)
        return np.asarray(along_x), np.asarray(along_y)

    @cached_property
    def gradient(self) -> tuple[Array, Array]:
        """Slopes p = dz/dx and q = dz/dy of the whole membrane."""
        p, q = self.indentation_gradient
        return self.base_p + p, self.base_q + q

    @cached_property
    def normals(self) -> Array:
        """Unit normals towards the camera, shape (rows, columns, 3)."""
        p, q = self.gradient
        normals = np.stack([-p, -q, np.ones_like(p)], axis=-1)
        return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))

    def sample(self, field: NDArray[np.floating], x_mm: Array, y_mm: Array) -> Array:
        """Interpolate a grid field linearly at points; beyond the grid the nearest edge value holds."""
        columns = (x_mm - self.x_mm[0]) / self.pitch_mm
        rows = (self.y_mm[0] - y_mm) / self.pitch_mm
        return np.asarray(map_coordinates(field, [rows, columns], order=1, mode="nearest"), dtype=float)
