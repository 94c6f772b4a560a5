"""Light kept by place and direction, summed over its directions at points of the membrane."""

from functools import cached_property
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from designlab.core.types import Array, Mask, Single
from designlab.simulation.contact.surface import Surface
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.lightfield import AZIMUTHS, CELL_MM, NODES_PER_CELL, Bins, Field
from designlab.simulation.render.nodes import Nodes, Response, base_normals, facing, nodes_of
from designlab.simulation.render.tables import bilinear, held, on_device
from designlab.simulation.render.walls import FURTHEST_MM


class Binned:
    """Light of one LED group from a field of direction bins.

    Parameters
    ----------
    field : Field
        The light.
    group : int
        LED group.
    untouched : Surface
        The undeformed membrane on the grid that all presses share.
    fine : bool
        Keep the bins that hold images of the LEDs apart.

    Attributes
    ----------
    irradiance : array, shape (rows, columns)
        Of the undeformed membrane (1/mm2), from cells finer than those of the bins.
    """

    def __init__(self, field: Field, group: int, untouched: Surface, *, fine: bool = True) -> None:
        self._x_mm, self._y_mm, self._fine = field.x_mm, field.y_mm, fine
        self._field, self._group, self._untouched = field, group, untouched
        self._curved = bool(np.nan_to_num(untouched.base_p).any())
        self.irradiance = self.irradiance_at(untouched.x_mm, untouched.y_mm)

    @cached_property
    def _bins(self) -> Bins:
        """Directions; the untouched gel alone needs none."""
        return self._field.bins(self._group, fine=self._fine)

    @cached_property
    def _tables(self) -> list[Any]:
        """The directions on the device: fluence, lower and upper tangent, azimuth, and components."""
        bins = self._bins
        return [on_device(c) for c in (bins.power, bins.lower, bins.upper, bins.azimuth, *bins.direction.T)]

    @cached_property
    def vector(self) -> Single:
        """Light on every grid node, shape (3, rows, columns): its product with a normal is the irradiance.

        As far as no light is cut off at the tangent.
        """
        return self._on_grid(self._field.vector(self._group))

    @cached_property
    def _summed(self) -> Single:
        """Irradiance of the whole grid at rest, by the same sum as `light`, for a flat membrane."""
        vector = self._on_grid(self._bins.vector)
        summed = np.einsum("krc,krc->rc", base_normals(self._untouched), vector)
        return np.asarray(summed, dtype=np.float32)

    def _on_grid(self, nodes: Single) -> Single:
        """Interpolate images at the nodes of the field to the grid, as `light` does."""
        x, y = np.meshgrid(self._untouched.x_mm, self._untouched.y_mm)
        pitch_mm = CELL_MM / NODES_PER_CELL
        at = [(y - self._y_mm) / pitch_mm, (x - self._x_mm) / pitch_mm]
        return np.array([map_coordinates(image, at, order=1, mode="nearest") for image in nodes])

    def irradiance_at(self, x: Array, y: Array) -> Single:
        """Irradiance (1/mm2) of the undeformed membrane on a grid (mm), shape (y, x)."""
        return np.asarray(np.maximum(self._field.irradiance_at(self._group, x, y), 0.0), dtype=np.float32)

    def at_rest(self, chosen: Mask) -> Single:
        """Irradiance of chosen grid nodes without a press, by the same sum as `light`."""
        if not self._curved:  # nothing is cut off at the tangent: the sum is that of vectors
            return np.asarray(self._summed[chosen])
        nodes = nodes_of(self._untouched, chosen)
        return np.asarray(self.light(nodes, None, facing(nodes)))

    def arriving(self, points: Array) -> tuple[Array, Array]:
        """Unit vectors towards the light, shape (points, bins, 3), and fluence of each bin at points (mm)."""
        bins = self._bins
        cells = (points[:, (1, 0)] - (self._y_mm, self._x_mm)) / bins.pitch_mm
        row, column = np.clip(np.rint(cells), 0, np.array(bins.power.shape[1:]) - 1).astype(int).T
        towards = np.broadcast_to(bins.direction, (len(points), *bins.direction.shape))
        return towards, np.asarray(bins.power[:, row, column].T, dtype=float)

    def light(self, nodes: Nodes, horizon: Any | None, response: Response) -> Any:
        """Sum of `response` (to the unit vector towards the light) times the fluence at every membrane node.

        One kernel with a loop over the bins that hold light.
        """
        bins, count = self._bins, dr.width(nodes.x)
        if not len(bins.azimuth):
            return dr.zeros(mi.Float, count)
        rows, columns, number = (held(n) for n in (*bins.power.shape[1:], len(bins.azimuth)))
        x_mm, y_mm = held(self._x_mm), held(self._y_mm)
        power, low, high, azimuth, *directions = self._tables
        node = dr.arange(mi.UInt32, count)

        def going(k: Any, _: Any) -> Any:
            return k < number

        def step(k: Any, total: Any) -> Any:
            towards = mi.Vector3f(*(dr.gather(mi.Float, c, k) for c in directions))
            # Light that reaches a lifted point would have met the undeformed membrane further away, that of
            # a lowered one nearer by.
            sinking = dr.maximum(towards.z - nodes.base_p * towards.x - nodes.base_q * towards.y, 1e-3)
            across = dr.maximum(dr.sqrt(towards.x * towards.x + towards.y * towards.y), 1e-3)
            furthest = FURTHEST_MM / across
            drift = dr.maximum(dr.minimum(nodes.height / sinking, furthest), -furthest)
            u = (nodes.x - drift * towards.x - x_mm) / bins.pitch_mm
            v = (nodes.y - drift * towards.y - y_mm) / bins.pitch_mm
            value = bilinear(power, u, v, rows, columns, k * (rows * columns)) * response(towards)
            # What a lifted point of a dome sees below the tangent of its place is the membrane itself.
            rim = (nodes.base_p * towards.x + nodes.base_q * towards.y) / across
            if horizon is not None:
                around = dr.gather(mi.Float, horizon, node * AZIMUTHS + dr.gather(mi.UInt32, azimuth, k))
                rim = dr.maximum(rim, around)
            lower, upper = dr.gather(mi.Float, low, k), dr.gather(mi.Float, high, k)
            value = value * dr.clip((upper - rim) / (upper - lower), 0.0, 1.0)
            return k + 1, total + value

        _, total = dr.while_loop(
            (dr.zeros(mi.UInt32, count), dr.zeros(mi.Float, count)), going, step, labels=("k", "total")
        )
        return total
