"""Light straight from the LEDs through core and gel, summed over the directions in which they appear.

Boundaries bend the way of light and squeeze the image of an LED's face, sometimes into two. From points of
the membrane lines of sight are followed in small cells of direction. Where each meets the plane of the LED,
and its neighbours do, tells how much of the cell the face fills: light behind glass has no grain.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from designlab.press import Surface
from designlab.render.direct import visible
from designlab.render.gather import on_membrane
from designlab.render.nodes import Nodes, Response
from designlab.render.sight import Last, Sight
from designlab.render.straight import Straight, node_axes
from designlab.render.tables import bilinear, held
from designlab.render.walls import FURTHEST_MM
from designlab.scene import Light, Scene

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Indices = NDArray[np.int64]
NODE_MM = 1.0  # between the points that look at the LEDs
CELLS = (32, 120)  # of slant and azimuth, all around: 3 deg wide
SPANS = np.radians(94.0), 2 * np.pi  # on a dome light can come from slightly below the apex plane
PARTS = 3  # of a cell that an LED may fill in part, along each side
MARGIN = 0.6  # of the change to the next cells: within it a face may reach into a cell
STEP = 0.1  # of such a part, between rays whose ends are compared
LEAST_MM = 1e-6
PATCH_MM = 1.5  # a face is divided into patches no larger than this
SLACK_MM = 0.05  # by which a face may lie behind what ends a line of sight
OFF_MM = 0.01  # of the membrane, where lines of sight start
AT_ONCE = 300  # points looked from at once; bounds memory


class Refracted(Straight):
    """Light of one LED group that comes straight from its faces through core and gel.

    Parameters
    ----------
    untouched : Surface
        The undeformed membrane on the grid that all presses share.
    light : array, shape (patches, 3, rows, columns)
        Light of each patch of the faces as a vector (1/mm2).
    faces : array, shape (patches, 4)
        Centre of each patch, and half of its extent down the face (mm; softens the edge of shadows).
    corner_mm : array, shape (2,)
        x and y of the first node.
    """

    def __init__(self, untouched: Surface, light: Single, faces: Array, corner_mm: Array) -> None:
        shines = light.any(axis=(1, 2, 3))
        self._light, self._faces = light[shines], faces[shines]
        super().__init__(untouched, light.sum(axis=0), corner_mm, NODE_MM)

    def arriving(self, points: Array) -> tuple[Array, Array]:
        """Unit vectors towards the light, shape (points, patches, 3), and their fluence at points (mm)."""
        rows, columns = self._light.shape[2:]
        cells = np.rint((points[:, :2] - self._corner) / NODE_MM).astype(int)
        column, row = np.clip(cells, 0, (columns - 1, rows - 1)).T
        vector = np.moveaxis(self._light[:, :, row, column], 2, 0).astype(float)
        fluence = np.linalg.norm(vector, axis=2)
        return vector / np.maximum(fluence, 1e-30)[..., None], fluence

    def light(self, nodes: Nodes, horizon: Any | None, response: Response) -> Any:
        """Sum of `response` (to the unit vector towards the light) times the fluence at every membrane node.

        Nothing but the indentation's horizon is in the way, if one is given.
        """
        import drjit as dr
        import mitsuba as mi

        count, number = dr.width(nodes.x), held(len(self._light))
        if not len(self._light):
            return dr.zeros(mi.Float, count)
        rows, columns = (held(n) for n in self._light.shape[2:])
        size = rows * columns
        table = mi.Float(self._light.ravel())
        faces = [mi.Float(column.astype(np.float32)) for column in self._faces.T]
        x_mm, y_mm = (held(float(c)) for c in self._corner)
        node = dr.arange(mi.UInt32, count)

        def at(k: Any, x: Any, y: Any) -> Any:
            u, v = (x - x_mm) / NODE_MM, (y - y_mm) / NODE_MM
            return mi.Vector3f(*(bilinear(table, u, v, rows, columns, (3 * k + c) * size) for c in range(3)))

        def going(k: Any, _: Any) -> Any:
            return k < number

        def step(k: Any, total: Any) -> Any:
            # Light that reaches a lifted point would have met the undeformed membrane further away.
            way = at(k, nodes.x, nodes.y)
            sinking = dr.maximum(way.z - nodes.base_p * way.x - nodes.base_q * way.y, 1e-3 * dr.norm(way))
            across = dr.sqrt(way.x * way.x + way.y * way.y)
            drift = dr.minimum(
                nodes.height / dr.maximum(sinking, 1e-30), FURTHEST_MM / dr.maximum(across, 1e-30)
            )
            way = at(k, nodes.x - drift * way.x, nodes.y - drift * way.y)
            fluence = dr.norm(way)
            towards = way / dr.maximum(fluence, 1e-30)
            value = dr.select(fluence > 0, fluence * response(towards), 0.0)
            if horizon is not None:
                cx, cy, cz, half = (dr.gather(mi.Float, c, k) for c in faces)
                distance = dr.norm(mi.Vector3f(cx - nodes.x, cy - nodes.y, cz - nodes.z))
                value = value * visible(horizon, node, distance * towards, half)
            return k + 1, total + value

        _, total = dr.while_loop((dr.zeros(mi.UInt32, count), dr.zeros(mi.Float, count)), going, step)
        return total


def refracted(scene: Scene, untouched: Surface) -> list[Refracted]:
    """Straight light of every LED group behind glass."""
    low, high = scene.membrane.vertices.min(axis=0), scene.membrane.vertices.max(axis=0)
    look = _Look(scene, *node_axes(low, high, NODE_MM))
    # Beside the membrane goes on what is on its edge, so that nothing rings there.
    _, nearest = distance_transform_edt(~look.there, return_indices=True)
    found = []
    for group in range(scene.groups):
        planes = _planes(scene, group)
        places = np.concatenate([face.places for plane in planes for face in plane.faces])
        found.append(Refracted(untouched, look.at(planes)[:, :, *nearest], places, low[:2]))
    return found


@dataclass(frozen=True, eq=False)
class _Face:
    """An LED's face in the plane it lies in: `centre` and `half` sides (mm) along and down."""

    light: Light
    centre: tuple[float, float]
    half: tuple[float, float]

    @cached_property
    def counts(self) -> tuple[int, int]:
        """Patches along and down."""
        along, down = (max(int(np.ceil(2 * half / PATCH_MM)), 1) for half in self.half)
        return along, down

    @property
    def places(self) -> Array:
        """Centre of every patch and half of its extent down (mm), shape (patches, 4)."""
        along, down = ((2 * np.arange(n) + 1) / n - 1 for n in self.counts)
        down, along = (axis.ravel()[:, None] for axis in np.meshgrid(down, along, indexing="ij"))
        light = self.light
        aside = self.half[0] * along * light.across + self.half[1] * down * light.down
        place = np.array(light.centre_mm) + aside
        return np.column_stack([place, np.full(len(place), self.half[1] / self.counts[1])])


@dataclass(frozen=True, eq=False)
class _Plane:
    """Faces of one LED group that lie in one plane."""

    faces: tuple[_Face, ...]

    @property
    def first(self) -> Light:
        """LED whose face is the plane's origin."""
        return self.faces[0].light

    @property
    def inside(self) -> bool:
        """Whether the faces shine within the core."""
        return self.first.inside

    @property
    def patches(self) -> int:
        """Patches of all faces."""
        return sum(face.counts[0] * face.counts[1] for face in self.faces)

    def near(self, place: Single, margin: Sequence[Single] | Array) -> NDArray[np.bool_]:
        """Whether places (2, ...) in the plane lie on a face or within margins (mm) beside it."""
        found = np.zeros(place[0].shape, dtype=bool)
        for face in self.faces:
            beside = [
                np.abs(p - c) <= h + m
                for p, c, h, m in zip(place, face.centre, face.half, margin, strict=True)
            ]
            found |= beside[0] & beside[1]
        return found

    def meets(self, last: Last) -> tuple[Single, Single]:
        """Where lines of sight meet the plane's front: mm along and down (2, n), and how far that is (mm).

        Not a number where they do not.
        """
        first = self.first
        axes = np.array([first.across, first.down, first.normal], dtype=np.float32)
        start = axes @ (last.origin - np.array(first.centre_mm, dtype=np.float32)[:, None])
        going = axes @ last.direction
        with np.errstate(divide="ignore", invalid="ignore"):
            length = -start[2] / going[2]
            length = np.where((going[2] < 0) & (length > 0) & (last.passed > 0), length, np.float32(np.nan))
            return start[:2] + length * going[:2], length


def _planes(scene: Scene, group: int) -> list[_Plane]:
    """Planes of the faces of one group."""

    def plane(light: Light) -> tuple[float, ...]:
        axes = np.round([*light.normal, *light.across], 6) + 0.0
        return *axes, round(float(np.dot(light.normal, light.centre_mm)), 6)

    def face(light: Light, first: Light) -> _Face:
        offset = np.subtract(light.centre_mm, first.centre_mm)
        centre = float(offset @ np.array(first.across)), float(offset @ np.array(first.down))
        return _Face(light, centre, (light.half_width_mm, light.half_height_mm))

    lights = sorted((light for light in scene.lights if light.group == group), key=plane)
    planes = [tuple(same) for _, same in groupby(lights, key=plane)]
    return [_Plane(tuple(face(light, same[0]) for light in same)) for same in planes]


class _Look:
    """Looks at LEDs from points of the membrane.

    Parameters
    ----------
    scene : Scene
        The undeformed scene.
    x, y : array
        Places of nodes (mm).

    Attributes
    ----------
    there : bool array, shape (rows, columns)
        Nodes that lie on the membrane.
    """

    def __init__(self, scene: Scene, x: Array, y: Array) -> None:
        points, normals = on_membrane(scene, *(axis.ravel() for axis in np.meshgrid(x, y)))
        self.there = np.isfinite(points[:, 2]).reshape(len(y), len(x))
        self._normals = normals[self.there.ravel()]
        self._points = (points + OFF_MM * normals)[self.there.ravel()]
        self._scene = scene

    def at(self, planes: list[_Plane]) -> Single:
        """Light of the patches of one group as vectors (1/mm2), shape (patches, 3, rows, columns)."""
        first = planes[0].first
        sight = Sight(self._scene, first.group, first.inside)
        light = np.zeros((sum(plane.patches for plane in planes), 3, *self.there.shape), dtype=np.float32)
        place = np.nonzero(self.there)
        for start in range(0, len(self._points), AT_ONCE):
            some = slice(start, start + AT_ONCE)
            points, normals = self._points[some], self._normals[some]
            last = self._all_around(sight, points)
            found = [
                _summed(sight, plane, points, normals, _chosen(plane, last, len(points))) for plane in planes
            ]
            light[:, :, place[0][some], place[1][some]] = np.concatenate(found)
        return light

    def _all_around(self, sight: Sight, points: Array) -> Last:
        """Lines of sight in all directions."""
        slant, turn = ((np.arange(n) + 0.5) * span / n for n, span in zip(CELLS, SPANS, strict=True))
        towards = _towards(slant[:, None], turn[None, :]).reshape(3, 1, -1)
        start = np.repeat(points.T, towards.shape[2], axis=1)
        return sight.last(start, np.broadcast_to(towards, (3, len(points), towards.shape[2])).reshape(3, -1))


def _chosen(plane: _Plane, last: Last, points: int) -> "_Cells":
    """Cells of direction that a face may fill in part."""
    place = plane.meets(last)[0].reshape(2, points, *CELLS)
    margin = [MARGIN * _furthest(p) for p in place]
    chosen = plane.near(place, margin)
    return _Cells(np.nonzero(chosen), np.stack([m[chosen] for m in margin]))


def _summed(sight: Sight, plane: _Plane, points: Array, normals: Array, cells: "_Cells") -> Array:
    """Light of every patch of a plane from chosen cells, shape (patches, 3, points)."""
    of, slant, turn, size = cells.parts()
    towards = _towards(slant, turn)
    last = sight.last(points[of].T, towards)
    place, length = plane.meets(last)
    clear = (np.einsum("kn,nk->n", towards, normals[of]) > 0) & (length <= last.reach + SLACK_MM)
    some = np.flatnonzero(clear & plane.near(place, np.repeat(cells.margin, PARTS**2, axis=1) / PARTS))
    of, slant, turn, towards = of[some], slant[some], turn[some], towards[:, some]
    last, place, length = last.some(some), place[:, some], length[some]
    # How place changes across a part: from rays a little aside.
    aside = [(slant + STEP * size[0], turn), (slant, turn + STEP * size[1])]
    changes = [
        np.abs(plane.meets(sight.last(points[of].T, _towards(*way)))[0] - place) / STEP for way in aside
    ]
    solid = (np.cos(slant - size[0] / 2) - np.cos(slant + size[0] / 2)) * size[1]
    light = []
    for face in plane.faces:
        share = np.ones(len(of))
        for k, (c, h) in enumerate(zip(face.centre, face.half, strict=True)):
            a, b = (change[k] for change in changes)
            share *= _below(c + h - place[k], a, b) - _below(c - h - place[k], a, b)
        at = np.flatnonzero(np.nan_to_num(share) > 0)
        value = share[at] * solid[at] * sight.radiance(face.light, last.some(at), length[at])
        along, down = (
            np.clip(((place[k, at] - face.centre[k]) / face.half[k] + 1) / 2 * n, 0, n - 1).astype(int)
            for k, n in enumerate(face.counts)
        )
        count = face.counts[0] * face.counts[1]
        index = (down * face.counts[0] + along) * len(points) + of[at]
        sums = [np.bincount(index, value * axis[at], count * len(points)) for axis in towards]
        light.append(np.stack(sums, axis=1).reshape(count, len(points), 3).swapaxes(1, 2))
    return np.concatenate(light)


def _towards(slant: Array, turn: Array) -> Array:
    """Unit vectors (3, ...) from slant and azimuth."""
    level = np.sin(slant)
    return np.stack(np.broadcast_arrays(level * np.cos(turn), level * np.sin(turn), np.cos(slant)))


class _Cells(NamedTuple):
    """Cells of direction: points, rows and columns, and margins (mm) about the places of their centres."""

    at: tuple[Indices, ...]
    margin: Single

    def parts(self) -> tuple[Indices, Array, Array, tuple[float, float]]:
        """Point, slant and azimuth of every part of all cells, and the parts' size in both."""
        of, row, column = self.at
        i, j = (axis.ravel() for axis in np.indices((PARTS, PARTS)))
        sizes = SPANS[0] / CELLS[0] / PARTS, SPANS[1] / CELLS[1] / PARTS
        slant = ((row[:, None] * PARTS + i + 0.5) * sizes[0]).ravel()
        turn = ((column[:, None] * PARTS + j + 0.5) * sizes[1]).ravel()
        return np.repeat(of, PARTS**2), np.asarray(slant), np.asarray(turn), sizes


def _furthest(place: Single) -> Single:
    """Most that a coordinate changes from cell to cell, (points, slants, azimuths); endless where unknown."""
    total = np.zeros_like(place)
    before, after = np.diff(place, axis=1, prepend=np.nan), np.diff(place, axis=1, append=np.nan)
    total += np.nan_to_num(np.fmax(np.abs(before), np.abs(after)), nan=np.inf)
    before, after = place - np.roll(place, 1, axis=2), place - np.roll(place, -1, axis=2)
    total += np.nan_to_num(np.fmax(np.abs(before), np.abs(after)), nan=np.inf)
    return total


def _below(edge: Array, a: Array, b: Array) -> Array:
    """Share of a cell in which a coordinate lies below an edge, that far from its value at the centre.

    Across the cell it changes by a one way and by b the other: it is spread like a sum of two even draws.
    """
    wide, narrow = np.maximum(np.maximum(a, b), 2 * LEAST_MM), np.maximum(np.minimum(a, b), LEAST_MM)
    ends = (wide + narrow) / 2, (wide - narrow) / 2
    outer, inner = (np.maximum(edge + end, 0.0) ** 2 for end in ends)
    inner_far, outer_far = (np.maximum(edge - end, 0.0) ** 2 for end in ends[::-1])
    return np.asarray(np.clip((outer - inner - inner_far + outer_far) / (2 * wide * narrow), 0.0, 1.0))
