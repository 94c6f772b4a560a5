"""The tail of a contact is the gel's bulge, which decays with the distance outside the contact."""

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.validation.synthetic.indenter import Indenter
from geometries.elastomer import Elastomer
from geometries.probes import Probe

LEAST_MM = 5e-4  # height below which the tail ends
CORNERS = 3  # of a triangle


def reach_mm(tail_share: float, tail_mm: float, depth_mm: float) -> float:
    """Distance from the contact at which the tail ends."""
    return tail_mm * max(float(np.log(max(tail_share * depth_mm, 1e-12) / LEAST_MM)), 0.0)


def outside_mm(elastomer: Elastomer, indenter: Indenter, contact: Array, x: Array, y: Array) -> Array:
    """Distance of points from a contact, in the plane z = 0, zero within it.

    On a flat gel a ball touches within a circle and a triangle within its own outline, of which the distance
    is known; of other contacts it is the distance from the border of the touched cells.

    Parameters
    ----------
    elastomer : Elastomer
        The gel.
    indenter : Indenter
        What is pressed.
    contact : array, shape (rows, columns)
        Share of every cell that is touched.
    x, y : array, shape (rows, columns)
        Centres of the cells (mm).
    """
    if elastomer.radius_mm is None and indenter.other is None and indenter.probe.edge_radius_mm == 0:
        turn = np.exp(-1j * np.radians(indenter.yaw_deg))
        local = turn * ((x - indenter.centre_mm[0]) + 1j * (y - indenter.centre_mm[1]))
        if indenter.probe.kind == "sphere":
            return np.asarray(
                np.maximum(np.abs(local) - _cap_radius_mm(indenter.probe, indenter.depth_mm), 0)
            )
        if indenter.probe.kind == "triangle":
            corners = (
                indenter.probe.size_mm / np.sqrt(3) * np.exp(1j * np.pi * (0.5 + 2 / 3 * np.arange(CORNERS)))
            )
            return _outside_polygon_mm(local, corners)
    return outside_cells_mm(contact, x, y)


def _cap_radius_mm(probe: Probe, depth_mm: float) -> float:
    """Radius of the circle in which a plane cuts a ball, `depth_mm` from its foremost point."""
    radius = probe.size_mm / 2
    return float(np.sqrt(radius**2 - max(radius - depth_mm, 0.0) ** 2))


def _outside_polygon_mm(point: NDArray[np.complex128], corners: NDArray[np.complex128]) -> Array:
    """Distance from a convex polygon, corners counter-clockwise, as complex numbers."""
    nearest = np.full(point.shape, np.inf)
    inside = np.ones(point.shape, dtype=bool)
    for start, end in zip(corners, np.roll(corners, -1), strict=True):
        along = (end - start) / abs(end - start)
        local = (point - start) * np.conj(along)
        past = local.real - np.clip(local.real, 0.0, abs(end - start))
        nearest = np.minimum(nearest, np.hypot(past, local.imag))
        inside &= local.imag >= 0
    return np.where(inside, 0.0, nearest)


def outside_cells_mm(contact: Array, x: Array, y: Array) -> Array:
    """Distance from the line along which half of a cell is touched, found between the cells' centres."""
    from scipy.spatial import cKDTree

    inside = contact >= 0.5
    border = []
    for axis in (0, 1):
        first, second = (np.take(contact, np.arange(n, contact.shape[axis] - 1 + n), axis) for n in (0, 1))
        crossed = (first >= 0.5) != (second >= 0.5)
        share = (0.5 - first[crossed]) / (second - first)[crossed]
        ends = [
            [np.take(part, np.arange(n, part.shape[axis] - 1 + n), axis)[crossed] for part in (x, y)]
            for n in (0, 1)
        ]
        border.append(np.stack([a + share * (b - a) for a, b in zip(*ends, strict=True)], axis=1))
    distance = np.zeros(x.shape)
    if not inside.any():
        middle = np.unravel_index(int(contact.argmax()), contact.shape)
        return np.asarray(np.hypot(x - x[middle], y - y[middle]))
    away = ~inside
    found, _ = cKDTree(np.concatenate(border)).query(np.stack([x[away], y[away]], axis=1))
    distance[away] = found
    return distance
