"""Response curves of a camera: from the linear signal of the sensor to the signal that is quantised."""

from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from designlab.core.types import Array
from geometries.spec import Spec, quantity

SLOPE_STEP = 1e-6


class Response(Spec):
    """A growing curve from 0..1 to 0..1; signals are shares of full scale, the black level included."""

    curve: Literal["linear", "gamma", "srgb", "table"] = "linear"
    """linear; gamma: signal^(1/gamma); srgb: IEC 61966-2-1; table: linear between `table`."""
    gamma: float = quantity(2.2, unit="1", ge=0.2, le=5)
    """Exponent of the gamma curve."""
    table: tuple[float, ...] = ()
    """Values of the curve at evenly spaced signals from 0 to 1; growing from 0 to 1."""

    @model_validator(mode="after")
    def _table_is_a_curve(self) -> Self:
        if self.curve == "table":
            if len(self.table) < 2:
                raise ValueError(f"table: at least 2 values are needed, got {len(self.table)}")
            if self.table[0] != 0 or self.table[-1] != 1:
                raise ValueError(f"table: must run from 0 to 1, got {self.table[0]:g} to {self.table[-1]:g}")
            if (np.diff(self.table) <= 0).any():
                place = int(np.argmax(np.diff(self.table) <= 0)) + 1
                raise ValueError(f"table: must grow, got {self.table[place]:g} at position {place}")
        elif self.table:
            raise ValueError(f"table: only with curve = 'table', got curve = {self.curve!r}")
        return self

    @property
    def is_linear(self) -> bool:
        """Whether signals pass unchanged."""
        return self.curve == "linear"

    @property
    def label(self) -> str:
        """Name of the curve in a measurement's metadata; unknown where they have none."""
        if self.curve == "table":
            return "unknown"
        return f"gamma:{self.gamma:.6g}" if self.curve == "gamma" else self.curve

    def encode(self, signal: NDArray[np.floating]) -> Array:
        """Signal behind the curve; below 0 and above 1 it is clipped (a linear response clips nothing)."""
        if self.is_linear:
            return np.asarray(signal, dtype=float)
        x = np.clip(np.asarray(signal, dtype=float), 0.0, 1.0)
        if self.curve == "gamma":
            return np.asarray(x ** (1 / self.gamma))
        if self.curve == "srgb":
            bright = 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055
            return np.asarray(np.where(x <= 0.0031308, 12.92 * x, bright))
        return np.asarray(np.interp(x, np.linspace(0, 1, len(self.table)), self.table))

    def decode(self, encoded: NDArray[np.floating]) -> Array:
        """Linear signal before the curve."""
        if self.is_linear:
            return np.asarray(encoded, dtype=float)
        y = np.clip(np.asarray(encoded, dtype=float), 0.0, 1.0)
        if self.curve == "gamma":
            return np.asarray(y**self.gamma)
        if self.curve == "srgb":
            bright = ((y + 0.055) / 1.055) ** 2.4
            return np.asarray(np.where(y <= 12.92 * 0.0031308, y / 12.92, bright))
        return np.asarray(np.interp(y, self.table, np.linspace(0, 1, len(self.table))))

    def slope(self, signal: NDArray[np.floating]) -> Array:
        """Derivative of the curve, by central differences inside 0..1."""
        x = np.clip(np.asarray(signal, dtype=float), SLOPE_STEP, 1 - SLOPE_STEP)
        if self.is_linear:
            return np.ones_like(x)
        return np.asarray((self.encode(x + SLOPE_STEP) - self.encode(x - SLOPE_STEP)) / (2 * SLOPE_STEP))
