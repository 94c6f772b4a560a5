"""Light straight from the LEDs on the undeformed membrane, kept as a vector at points of it."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.press import Surface
from designlab.render.nodes import Nodes, Response, facing, nodes_of

Array = NDArray[np.float64]
Single = NDArray[np.float32]


class Straight:
    """Light of one LED group that nothing throws aside on its way.

    Parameters
    ----------
    untouched : Surface
        The undeformed membrane on the grid that all presses share.
    vectors : array, shape (3, rows, columns)
        Light (1/mm2) at nodes as a vector: its product with a normal is the irradiance.
    corner_mm : array, shape (2,)
        x and y of the first node.
    node_mm : float
        Between nodes.

    Attributes
    ----------
    irradiance : array, shape (rows, columns)
        Of the undeformed membrane (1/mm2), shadowed by what stands between it and the LEDs.
    """

    def __init__(self, untouched: Surface, vectors: Single, corner_mm: Array, node_mm: float) -> None:
        self._untouched, self._vectors = untouched, vectors
        self._corner, self._node_mm = corner_mm, node_mm
        self.irradiance = self.irradiance_at(untouched.x_mm, untouched.y_mm)

    def irradiance_at(self, x: Array, y: Array) -> Single:
        """Irradiance (1/mm2) of the undeformed membrane on a grid (mm), shape (y, x)."""
        x, y = np.meshgrid(x, y)
        vector = self._vector_at(x, y)
        surface = self._untouched
        p, q = (surface.sample(np.nan_to_num(slope), x, y) for slope in (surface.base_p, surface.base_q))
        light = (vector[2] - p * vector[0] - q * vector[1]) / np.sqrt(1 + p**2 + q**2)
        return np.asarray(np.maximum(light, 0.0), dtype=np.float32)

    @cached_property
    def vector(self) -> Single:
        """Light on every grid node, shape (3, rows, columns): its product with a normal is the irradiance."""
        return self._vector_at(*np.meshgrid(self._untouched.x_mm, self._untouched.y_mm))

    def _vector_at(self, x: Array, y: Array) -> Single:
        at = [(y - self._corner[1]) / self._node_mm, (x - self._corner[0]) / self._node_mm]
        return np.array([map_coordinates(v, at, order=3, mode="nearest") for v in self._vectors])

    def at_rest(self, chosen: NDArray[np.bool_]) -> Single:
        """Irradiance of chosen grid nodes without a press, by the same sum as `light`."""
        nodes = nodes_of(self._untouched, chosen)
        return np.asarray(self.light(nodes, None, facing(nodes)))

    def arriving(self, points: Array) -> tuple[Array, Array]:
        """Unit vectors towards the light, shape (points, patches, 3), and their fluence at points (mm)."""
        raise NotImplementedError

    def light(self, nodes: Nodes, horizon: Any | None, response: Response) -> Any:
        """Sum of `response` (to the unit vector towards the light) times the fluence at every membrane node.

        Nothing but the indentation's horizon is in the way, if one is given.
        """
        raise NotImplementedError


def node_axes(low: Array, high: Array, node_mm: float) -> tuple[Array, Array]:
    """Places of nodes along x and y (mm) that reach from one corner over the other."""
    columns, rows = (2 * int(np.ceil((high[k] - low[k]) / (2 * node_mm))) + 1 for k in (0, 1))
    return low[0] + node_mm * np.arange(columns), low[1] + node_mm * np.arange(rows)
