"""The sensing area: the part of the membrane, seen along z, over which a sensor is judged."""

from typing import Literal, NamedTuple

import numpy as np

from designlab.core.types import Array, Mask

Shape = Literal["rectangle", "ellipse"]

OUTLINE_POINTS = 180  # of an ellipse: its chords leave out less than 2 um of one of 20 mm


class SensingArea(NamedTuple):
    """A rectangle or ellipse about the axis; on a curved membrane, all that lies over it.

    Parameters
    ----------
    width_mm, height_mm : float
        Sides of a rectangle, full axes of an ellipse, along x and y (mm).
    shape : {"rectangle", "ellipse"}
        Which of them.
    """

    width_mm: float
    height_mm: float
    shape: Shape = "rectangle"

    @property
    def ends_mm(self) -> Array:
        """Corners of a rectangle, ends of the axes of an ellipse (mm), counter-clockwise, shape (4, 2)."""
        if self.shape == "ellipse":
            signs = [(-1, 0), (0, -1), (1, 0), (0, 1)]
        else:
            signs = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
        return np.array(signs) * (self.width_mm / 2, self.height_mm / 2)

    def outline_mm(self, per_side: int = 2) -> Array:
        """Points of the outline (mm), counter-clockwise, shape (n, 2).

        Parameters
        ----------
        per_side : int
            Points of each side of a rectangle, its corners included.
        """
        half_w, half_h = self.width_mm / 2, self.height_mm / 2
        if self.shape == "ellipse":
            turn = np.linspace(0.0, 2 * np.pi, OUTLINE_POINTS, endpoint=False)
            return np.column_stack([half_w * np.cos(turn), half_h * np.sin(turn)])
        x, y = np.linspace(-half_w, half_w, per_side), np.linspace(-half_h, half_h, per_side)
        sides = ((x[:-1], -half_h), (half_w, y[:-1]), (x[:0:-1], half_h), (-half_w, y[:0:-1]))
        return np.concatenate([np.column_stack(np.broadcast_arrays(*side)) for side in sides])

    def holds(self, x_mm: Array, y_mm: Array) -> Mask:
        """Which points (mm) lie in the area, its border included."""
        if self.shape == "ellipse":
            return np.asarray(np.hypot(2 * x_mm / self.width_mm, 2 * y_mm / self.height_mm) <= 1.0)
        return np.asarray((np.abs(x_mm) <= self.width_mm / 2) & (np.abs(y_mm) <= self.height_mm / 2))

    def __str__(self) -> str:
        """Size and, of an ellipse, shape, for people."""
        size = f"{self.width_mm:.4g} x {self.height_mm:.4g} mm"
        return f"ellipse of {size}" if self.shape == "ellipse" else size
