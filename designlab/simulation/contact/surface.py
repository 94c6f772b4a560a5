"""The deformed membrane: the surface rendered, and the truth that reconstruction is judged by."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.core.types import Array


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface is the membrane on a regular grid: row 0 at +y, heights above the undeformed base.

    Attributes
    ----------
    x_mm, y_mm : array, shapes (columns,) and (rows,)
        Grid coordinates in mm; `y_mm` descends.
    height_mm : array, shape (rows, columns)
        Indentation in mm, positive towards the camera.
    base_mm : array, shape (rows, columns)
        Height of the undeformed membrane in mm; NaN where there is none.
    base_p, base_q : array, shape (rows, columns)
        Slopes dz/dx and dz/dy of the undeformed membrane.
    base_p, base_q : array, shape (rows, columns)
        Slopes dz/dx and dz/dy of the undeformed membrane.
    contact : bool array, shape (rows, columns)
        Whether the probe touches the membrane.
    """

    x_mm: Array
    y_mm: Array
    height_mm: Array
    base_mm: Array
    base_p: Array
    base_q: Array
    contact: NDArray[np.bool_]

    @property
    def pitch_mm(self) -> float:
        """Distance of neighbouring grid points (mm)."""
        return float(self.x_mm[1] - self.x_mm[0])

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
