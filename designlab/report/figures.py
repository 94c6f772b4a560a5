"""New figures, and the one way in which figures become files."""

import io
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from designlab.core.store import write_atomic

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOTS_PER_INCH = 110
MARGIN_IN = 0.08  # around a figure whose empty border is cut off


def new_figure(
    width_in: float,
    height_in: float,
    *,
    layout: Literal["constrained", "compressed"] = "constrained",
    dots_per_inch: int = DOTS_PER_INCH,
) -> "Figure":
    """Return an empty figure that belongs to no window and to no global state."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width_in, height_in), layout=layout, dpi=dots_per_inch)


def write_figure(figure: "Figure", path: str | Path, *, trimmed: bool = False) -> Path:
    """Write a figure as PNG, whole or not at all.

    Parameters
    ----------
    figure : Figure
        What a plotting function returned.
    path : path
        PNG to write; its folder is made if absent.
    trimmed : bool
        Whether the empty border is cut off.

    Raises
    ------
    OSError
        If it cannot be written; the text names the path.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", bbox_inches="tight" if trimmed else None, pad_inches=MARGIN_IN)
    return write_atomic(path, buffer.getvalue())
