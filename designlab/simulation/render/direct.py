"""Light straight from the LEDs through air, integrated over their faces instead of traced."""

from functools import cache, cached_property
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from designlab.core.types import Array, Mask, Single
from designlab.simulation.contact.surface import Surface
from designlab.simulation.render import bridge
from designlab.simulation.render.emitters import Directions
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.lightfield import AZIMUTHS, CELL_MM
from designlab.simulation.render.nodes import Nodes, Response, facing, nodes_of
from designlab.simulation.render.tables import held, on_device
from designlab.simulation.scene.scene import Light, Scene

PATCH_MM = 0.5  # an LED's face is divided into patches no larger than this
MOST_PATCHES = 24  # along each side of a face
LIFTED_MM = 0.02  # starts of shadow rays off the membrane, so that it does not shadow itself
NODE_MM = CELL_MM / 2  # between the points at which what shadows the LEDs is looked for


class Direct:
    """Light of one LED group that comes straight from its faces.

    Parameters
    ----------
    scene : Scene
        The undeformed scene.
    group : int
        LED group.
    untouched : Surface
        The undeformed membrane on the grid that all presses share.

    Attributes
    ----------
    irradiance : array, shape (rows, columns)
        Of the undeformed membrane (1/mm2), shadowed by what stands between it and the LEDs.
    """

    def __init__(self, scene: Scene, group: int, untouched: Surface) -> None:
        lights = [light for light in scene.lights if light.group == group]
        self._patches, self._directions = _patches(lights), Directions(lights[0].profile)
        self._untouched = untouched
        self._corner = scene.membrane.vertices.min(axis=0)
        self._vectors = self._vector(scene, group)
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
        at = [(y - self._corner[1]) / NODE_MM, (x - self._corner[0]) / NODE_MM]
        return np.array([map_coordinates(v, at, order=3, mode="nearest") for v in self._vectors])

    def at_rest(self, chosen: Mask) -> Single:
        """Irradiance of chosen grid nodes without a press, by the same sum as `light`."""
        nodes = nodes_of(self._untouched, chosen)
        return np.asarray(self.light(nodes, None, facing(nodes)))

    def arriving(self, points: Array) -> tuple[Array, Array]:
        """Unit vectors towards the light, shape (points, patches, 3), and their fluence at points (mm)."""
        way = self._patches[None, :, :3] - points[:, None]
        distance = np.linalg.norm(way, axis=-1)
        leaving = -np.einsum("pkc,kc->pk", way, self._patches[:, 9:12]) / distance
        fluence = self._patches[None, :, 13] * np.maximum(leaving, 0.0) / np.pi / distance**2
        return way / distance[..., None], np.asarray(fluence)

    def light(self, nodes: Nodes, horizon: Any | None, response: Response) -> Any:
        """Sum of `response` (to the unit vector towards the light) times the fluence at every membrane node.

        Nothing but the indentation's horizon is in the way, if one is given.
        """
        tables = [on_device(c) for c in self._patches.T]
        count = dr.width(nodes.x)
        node = dr.arange(mi.UInt32, count)

        number = held(len(self._patches))

        def going(k: Any, _: Any) -> Any:
            return k < number

        def step(k: Any, total: Any) -> Any:
            cx, cy, cz, *axes, half, flux = (dr.gather(mi.Float, c, k) for c in tables)
            way = mi.Vector3f(cx - nodes.x, cy - nodes.y, cz - nodes.z)
            square = dr.squared_norm(way)
            towards = way * dr.rsqrt(square)
            value = flux * self._directions.density(_local(axes, -towards)) / square * response(towards)
            if horizon is not None:
                value = value * _visible(horizon, node, way, half)
            return k + 1, total + value

        _, total = dr.while_loop((dr.zeros(mi.UInt32, count), dr.zeros(mi.Float, count)), going, step)
        return total

    def _vector(self, scene: Scene, group: int) -> Single:
        """Light on the undeformed membrane as a vector, shape (3, rows, columns), at nodes `NODE_MM` apart.

        Its product with a normal is the irradiance. What stands between an LED and the membrane shadows it.
        """
        loaded = bridge.load(scene, group=group, integrator={"type": "path"}, samples=4)
        low, high = self._corner, scene.membrane.vertices.max(axis=0)
        columns, rows = (2 * int(np.ceil((high[k] - low[k]) / (2 * NODE_MM))) + 1 for k in (0, 1))
        grid_x, grid_y = np.meshgrid(
            low[0] + NODE_MM * np.arange(columns), low[1] + NODE_MM * np.arange(rows)
        )
        surface = self._untouched
        base = (surface.base_mm, surface.base_p, surface.base_q)
        tables = [grid_x, grid_y, *(surface.sample(np.nan_to_num(values), grid_x, grid_y) for values in base)]
        x, y, z, p, q = (on_device(values) for values in tables)
        normal = dr.normalize(mi.Vector3f(-p, -q, 1.0))
        count = len(self._patches)
        index = dr.arange(mi.UInt32, rows * columns * count)
        node, patch = index // count, index % count
        origin = dr.gather(mi.Point3f, mi.Point3f(x, y, z), node)
        columns_of = [dr.gather(mi.Float, on_device(c), patch) for c in self._patches.T]
        way = mi.Point3f(*columns_of[:3]) - origin
        square = dr.squared_norm(way)
        distance = dr.sqrt(square)
        towards = way / distance
        front = dr.dot(dr.gather(mi.Vector3f, normal, node), towards) > 0
        # A dome's mesh spans its curve by chords, which lie above it.
        start = origin + LIFTED_MM * dr.gather(mi.Vector3f, normal, node)
        end = origin + way * (1 - 1e-3)
        blocked = loaded.ray_test(mi.Ray3f(start, end - start, 1.0, 0.0, []), front)
        density = self._directions.density(_local(columns_of[3:12], -towards))
        value = dr.select(front & ~blocked, columns_of[13] * density / square, 0.0)
        found = []
        for component in (towards.x, towards.y, towards.z):
            table = dr.zeros(mi.Float, rows * columns)
            dr.scatter_add(table, value * component, node)
            found.append(np.asarray(table).reshape(rows, columns))
        return np.array(found)


def _local(axes: Any, direction: Any) -> Any:
    """Components along the face, down the face and away from it."""
    return mi.Vector3f(*(dr.dot(mi.Vector3f(*axes[3 * k : 3 * k + 3]), direction) for k in range(3)))


def _visible(horizon: Any, node: Any, way: Any, half_mm: Any) -> Any:
    """Share of a patch above the horizon, which is linear between the azimuths it is known at."""
    across = dr.maximum(dr.sqrt(way.x * way.x + way.y * way.y), 1e-3)
    turn = dr.atan2(way.y, way.x) / (2 * dr.pi)
    place = (turn - dr.floor(turn)) * AZIMUTHS + (AZIMUTHS - 0.5)
    first = mi.UInt32(place)
    share = place - mi.Float(first)
    low = dr.gather(mi.Float, horizon, node * AZIMUTHS + first % AZIMUTHS)
    high = dr.gather(mi.Float, horizon, node * AZIMUTHS + (first + 1) % AZIMUTHS)
    rim = dr.lerp(dr.maximum(low, -100.0), dr.maximum(high, -100.0), share)
    return dr.clip((way.z - rim * across) / (2 * half_mm) + 0.5, 0.0, 1.0)


def _patches(lights: list[Light]) -> Array:
    """Divide the emitting faces of a group into patches, by the rule of Gauss and Legendre.

    Shape (patches, 14): centre (mm), unit vectors along the face, down the face and away from it, half of the
    patch's extent down the face (mm; softens the edge of shadows), and share of the group's flux.
    """
    patches = []
    for light in lights:
        columns, rows = (
            int(np.clip(np.ceil(2 * half / PATCH_MM), 2, MOST_PATCHES))
            for half in (light.half_width_mm, light.half_height_mm)
        )
        axes = (light.across, light.down, light.normal)
        across, down = light.half_width_mm * np.asarray(axes[0]), light.half_height_mm * np.asarray(axes[1])
        # Centres of equal patches would be a percent off within a few millimetres of an LED.
        for u, width in zip(*_rule(columns), strict=True):
            for v, height in zip(*_rule(rows), strict=True):
                patch = [light.half_height_mm * height / 2, light.flux_mw * width * height / 4]
                patches.append(np.concatenate([light.centre_mm + u * across + v * down, *axes, patch]))
    return np.array(patches)


@cache
def _rule(number: int) -> tuple[Array, Array]:
    """Places, -1 to 1, and weights of the rule of Gauss and Legendre."""
    return np.polynomial.legendre.leggauss(number)
