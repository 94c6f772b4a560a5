"""Maps as pixels, without axes, for pages that change while one looks; colours as in the reports."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.report.evaluation_plots import normal_colours

Pixels = NDArray[np.uint8]

HEIGHT_MAP, RESIDUAL_MAP = "viridis", "RdBu_r"


def height_colours(height_mm: Array, span_mm: tuple[float, float]) -> Pixels:
    """Heights in the colours of reports, shape (rows, columns, 3); ends of the scale in mm."""
    low, high = span_mm
    return _mapped(HEIGHT_MAP, (np.nan_to_num(height_mm) - low) / max(high - low, 1e-12))


def residual_colours(residual: Array, limit: float) -> Pixels:
    """Differences from minus `limit` to `limit`, white at none, shape (rows, columns, 3)."""
    return _mapped(RESIDUAL_MAP, 0.5 + np.nan_to_num(residual) / max(2 * limit, 1e-12))


def normal_pixels(normals: Array) -> Pixels:
    """Normals, shape (rows, columns, 3), in the colours of reports."""
    return np.asarray(np.round(255 * np.clip(normal_colours(normals), 0.0, 1.0)), dtype=np.uint8)


def scale_css(name: str = HEIGHT_MAP, steps: int = 12) -> str:
    """The colours of a map from left to right, as a gradient of a style sheet."""
    shades = _mapped(name, np.linspace(0.0, 1.0, steps))
    told = ", ".join(f"rgb({r} {g} {b})" for r, g, b in shades)
    return f"linear-gradient(90deg, {told})"


def _mapped(name: str, share: NDArray[Any]) -> Pixels:
    places = np.clip(np.round(255 * share), 0, 255).astype(np.intp)
    return np.asarray(_table(name)[places])


@cache
def _table(name: str) -> Pixels:
    from matplotlib import colormaps

    return np.asarray(np.round(255 * colormaps[name](np.linspace(0, 1, 256))[:, :3]), dtype=np.uint8)
