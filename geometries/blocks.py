"""Discs, slabs, rings and upright prisms that printed parts are put together from, in the sensor frame."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import cadquery

Rectangle = tuple[float, float, float, float]
"""A rectangle seen along the axis: x from, x to, y from, y to (mm)."""


class Ring(NamedTuple):
    """Tube around the axis whose lower end may rise along y, mm a mm."""

    inner_mm: float
    outer_mm: float
    low_mm: float
    high_mm: float
    slope: float = 0.0


class Prism(NamedTuple):
    """Upright prism over an outline, counter-clockwise, shape (n, 2), in mm."""

    outline: NDArray[np.float64]
    low_mm: float
    high_mm: float


def grown(box: Rectangle, by_mm: float) -> Rectangle:
    """The rectangle grown on all sides."""
    return box[0] - by_mm, box[1] + by_mm, box[2] - by_mm, box[3] + by_mm


def slab(box: Rectangle, low_mm: float, high_mm: float) -> "cadquery.Workplane":
    """Block over a rectangle between two heights (mm)."""
    import cadquery

    x0, x1, y0, y1 = box
    plane = cadquery.Workplane("XY", origin=((x0 + x1) / 2, (y0 + y1) / 2, low_mm))
    return plane.rect(x1 - x0, y1 - y0).extrude(high_mm - low_mm)


def disc(radius_mm: float, low_mm: float, high_mm: float) -> "cadquery.Workplane":
    """Disc about the axis between two heights (mm)."""
    import cadquery

    return cadquery.Workplane("XY", origin=(0, 0, low_mm)).circle(radius_mm).extrude(high_mm - low_mm)


def prism(part: Prism) -> "cadquery.Workplane":
    """The prism as a solid."""
    import cadquery

    plane = cadquery.Workplane("XY", origin=(0, 0, part.low_mm))
    return plane.polyline(part.outline.tolist()).close().extrude(part.high_mm - part.low_mm)


def ring(part: Ring) -> "cadquery.Workplane":
    """The ring as a solid."""
    import cadquery

    lowest = part.low_mm - abs(part.slope) * part.outer_mm
    work = disc(part.outer_mm, lowest, part.high_mm).cut(disc(part.inner_mm, lowest - 1, part.high_mm + 1))
    if part.slope:
        reach, rise = 2 * part.outer_mm, 2 * part.outer_mm * part.slope
        corners = [(-reach, lowest - 9), (reach, lowest - 9)]
        corners += [(reach, part.low_mm + rise), (-reach, part.low_mm - rise)]
        below = cadquery.Workplane("YZ").polyline(corners).close().extrude(reach, both=True)
        work = work.cut(below)
    return work
