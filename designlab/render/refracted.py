"""Light straight from the LEDs through core and gel, summed over the directions in which they appear.

Boundaries bend the way of light and squeeze the image of an LED's face, sometimes into two. From points of
the membrane lines of sight are followed in small cells of direction. Where each meets the plane of the LED,
and its neighbours do, tells how much of the cell the face fills: light behind glass has no grain.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import binary_dilation, distance_transform_edt, maximum_filter

from designlab.press import Surface
from designlab.render.direct import visible
from designlab.render.emitters import Directions
from designlab.render.gather import on_membrane
from designlab.render.nodes import Nodes, Response
from designlab.render.sight import Last, Sight
from designlab.render.straight import Straight, node_axes
from designlab.render.tables import bilinear, held
from designlab.render.walls import FURTHEST_MM
from designlab.scene import Light, Scene

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Mask = NDArray[np.bool_]
NODE_MM = 0.5  # between the points that look at the LEDs
BENT = 0.1  # of the mean: where the fourth difference of light is more, all points look
CELLS = (32, 120)  # of slant and azimuth, all around: 3 deg wide
# On a dome light can come from slightly below the apex plane.
SIZES = float(np.radians(94.0)) / CELLS[0], 2 * float(np.pi) / CELLS[1]
PARTS = 3  # of a cell that an LED may fill in part, along each side
MARGIN = 0.6  # of the change to the next cells: within it a face may reach into a cell
STEP = 0.1  # of such a part, between rays whose ends are compared
JUMP_MM = 10.0  # from cell to cell, on the plane of an LED, over the edge of an image
LEAST_MM, LEAST_SHARE = 1e-4, 0.2
# A patch is kept once as it appears through boundaries alone, and mirrored by how often and whence it comes.
SECTORS, ORDERS = 8, 2
IMAGES = 1 + ORDERS * SECTORS
PATCH_MM = 1.5  # a face is divided into patches no larger than this
SLACK_MM = 0.05  # by which a face may lie behind what ends a line of sight
OFF_MM = 0.01  # of the membrane, where lines of sight start
AT_ONCE = 300  # points looked from at once; bounds memory


class Images(NamedTuple):
    """Where the faces of one LED group appear to points of the membrane.

    Attributes
    ----------
    light : array, shape (images, 4, rows, columns)
        Light of each image of a patch of the faces as a vector (1/mm2), and its fluence times how far away
        it appears (1/mm).
    faces : array, shape (images, 4)
        Centre of each patch (mm), and half of its extent down the face (mm; softens the edge of shadows).
    corner_mm : array, shape (2,)
        x and y of the first point.
    """

    light: Single
    faces: Array
    corner_mm: Array


class Refracted(Straight):
    """Light of one LED group that comes straight from its faces through core and gel.

    Parameters
    ----------
    untouched : Surface
        The undeformed membrane on the grid that all presses share.
    images : Images
        Of the faces.
    """

    def __init__(self, untouched: Surface, images: Images) -> None:
        self._light, self._faces = images.light, images.faces
        super().__init__(untouched, images.light[:, :3].sum(axis=0), images.corner_mm, NODE_MM)

    def arriving(self, points: Array) -> tuple[Array, Array]:
        """Unit vectors towards the light, shape (points, images, 3), and their fluence at points (mm)."""
        rows, columns = self._light.shape[2:]
        cells = np.rint((points[:, :2] - self._corner) / NODE_MM).astype(int)
        column, row = np.clip(cells, 0, (columns - 1, rows - 1)).T
        vector = np.moveaxis(self._light[:, :3, row, column], 2, 0).astype(float)
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
            found = [bilinear(table, u, v, rows, columns, (4 * k + c) * size) for c in range(4)]
            return mi.Vector3f(*found[:3]), found[3]

        def going(k: Any, _: Any) -> Any:
            return k < number

        def step(k: Any, total: Any) -> Any:
            # Light that reaches a lifted point would have met the undeformed membrane further away.
            way, _ = at(k, nodes.x, nodes.y)
            towards = way / dr.maximum(dr.norm(way), 1e-30)
            sinking = dr.maximum(towards.z - nodes.base_p * towards.x - nodes.base_q * towards.y, 1e-3)
            across = dr.maximum(dr.sqrt(towards.x * towards.x + towards.y * towards.y), 1e-3)
            drift = dr.minimum(nodes.height / sinking, FURTHEST_MM / across)
            way, reach = at(k, nodes.x - drift * towards.x, nodes.y - drift * towards.y)
            fluence = dr.norm(way)
            towards, reach = way / dr.maximum(fluence, 1e-30), reach / dr.maximum(fluence, 1e-30)
            nearer = reach / dr.maximum(reach - drift, LEAST_SHARE * reach + 1e-6)
            value = dr.select(fluence > 0, fluence * dr.square(nearer) * response(towards), 0.0)
            if horizon is not None:
                cx, cy, cz, half = (dr.gather(mi.Float, c, k) for c in faces)
                distance = dr.norm(mi.Vector3f(cx - nodes.x, cy - nodes.y, cz - nodes.z))
                value = value * visible(horizon, node, distance * towards, half)
            return k + 1, total + value

        _, total = dr.while_loop((dr.zeros(mi.UInt32, count), dr.zeros(mi.Float, count)), going, step)
        return total


def images(scene: Scene, *, fine: bool = True) -> list[Images]:
    """Look for the LEDs of every group from points all over the membrane.

    Parameters
    ----------
    scene : Scene
        The undeformed scene.
    fine : bool
        Whether to look from more points where light changes sharply, which takes up to three times as long.
    """
    low, high = scene.membrane.vertices.min(axis=0), scene.membrane.vertices.max(axis=0)
    look = _Look(scene, *node_axes(low, high, NODE_MM))
    # Beside the membrane goes on what is on its edge, so that nothing rings there.
    _, nearest = distance_transform_edt(~look.there, return_indices=True)
    found = []
    for group in range(scene.groups):
        planes = _planes(scene, group)
        places = np.concatenate([f.places for plane in planes for _ in range(IMAGES) for f in plane.faces])
        light = look.at(planes, fine=fine)[:, :, *nearest]
        shines = light.any(axis=(1, 2, 3))
        found.append(Images(light[shines], places[shines], low[:2]))
    return found


@dataclass(frozen=True, eq=False)
class _Face:
    """An LED's face in the plane it lies in: `centre` and `half` sides (mm) along and down."""

    light: Light
    centre: tuple[float, float]
    half: tuple[float, float]

    def radiance(self, leaving: Any) -> Any:
        """Radiance of the face (1/mm2/sr) in directions, when its group emits one unit."""
        import drjit as dr
        import mitsuba as mi

        light = self.light
        axes = (mi.Vector3f(*map(held, axis)) for axis in (light.across, light.down, light.normal))
        local = mi.Vector3f(*(dr.dot(axis, leaving) for axis in axes))
        density = Directions(light.profile).density(local) / dr.maximum(local.z, 1e-6)
        return density * held(light.flux_mw / (4 * light.half_width_mm * light.half_height_mm))

    @property
    def held_centre(self) -> Any:
        """Its centre, on the device."""
        import mitsuba as mi

        return mi.Point2f(*map(held, self.centre))

    @property
    def held_half(self) -> Any:
        """Its half sides, on the device."""
        import mitsuba as mi

        return mi.Point2f(*map(held, self.half))

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

    def meets(self, last: Last) -> tuple[Any, Any]:
        """Where lines of sight meet the plane's front (mm along and down), and how far that is (mm).

        Not a number where they do not.
        """
        import drjit as dr
        import mitsuba as mi

        axes = [
            mi.Vector3f(*map(held, axis)) for axis in (self.first.across, self.first.down, self.first.normal)
        ]
        start = last.ray.o - mi.Point3f(*map(held, self.first.centre_mm))
        away = dr.dot(last.ray.d, axes[2])
        length = -dr.dot(start, axes[2]) / away
        length = dr.select((away < 0) & (length > 0) & (last.passed > 0), length, dr.nan)
        place = start + length * last.ray.d
        return mi.Point2f(*(dr.dot(place, axis) for axis in axes[:2])), length

    def near(self, place: Any, margin: Any) -> Any:
        """Whether places in the plane lie on a face or within margins (mm) beside it."""
        import drjit as dr
        import mitsuba as mi

        found = mi.Bool(False)
        for face in self.faces:
            beside = dr.abs(place - face.held_centre) <= face.held_half + margin
            found = found | dr.all(beside)
        return found


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
        self._scene = scene
        points, normals = on_membrane(scene, *(axis.ravel() for axis in np.meshgrid(x, y)))
        self.there = np.isfinite(points[:, 2]).reshape(len(y), len(x))
        self._points = (points + OFF_MM * normals).reshape(*self.there.shape, 3)
        self._normals = normals.reshape(*self.there.shape, 3)

    def at(self, planes: list[_Plane], *, fine: bool) -> Single:
        """Light of the images of one group's patches as in `Refracted`, shape (images, 4, rows, columns).

        Every second node looks first; if `fine`, those between where light does not vary smoothly.
        """
        images = IMAGES * sum(plane.patches for plane in planes)
        light = np.zeros((images, 4, *self.there.shape), dtype=np.float32)
        sparse = np.zeros_like(self.there)
        sparse[::2, ::2] = True
        self._look(planes, sparse, light)
        light = _between(light)
        if not fine:
            return light
        whole = np.linalg.norm(light[:, :3].sum(axis=0), axis=0)
        bend = _bend(whole[::2, ::2]) > BENT * whole.mean()
        bent = np.zeros_like(sparse)
        bent[::2, ::2] = bend
        self._look(planes, binary_dilation(bent, np.ones((3, 3))) & ~sparse, light)
        return light

    def _look(self, planes: list[_Plane], nodes: Mask, light: Single) -> None:
        """Fill in the light at nodes, as far as they lie on the membrane."""
        sight = Sight(self._scene, planes[0].first.group, planes[0].first.inside)
        row, column = np.nonzero(nodes & self.there)
        for start in range(0, len(row), AT_ONCE):
            at = row[start : start + AT_ONCE], column[start : start + AT_ONCE]
            points, normals = (
                np.ascontiguousarray(a[at].T, np.float32) for a in (self._points, self._normals)
            )
            light[:, :, *at] = _seen(sight, planes, points, normals)


def _between(light: Single) -> Single:
    """Light at all nodes from that at every second one along both axes, by cubic splines."""
    for axis in (2, 3):
        known = np.arange(0, light.shape[axis], 2)
        spline = make_interp_spline(known, np.take(light, known, axis=axis), axis=axis)
        light = spline(np.arange(light.shape[axis])).astype(np.float32)
    return light


def _bend(values: Single) -> Single:
    """Largest fourth difference along either axis, here or beside: 1/43 of it is what cubic splines miss."""
    found = np.zeros_like(values)
    for axis in (0, 1):
        fourth = np.abs(np.diff(values, 4, axis=axis))
        found = np.maximum(found, np.pad(fourth, [(2, 2) if k == axis else (0, 0) for k in (0, 1)]))
    return np.asarray(maximum_filter(found, 3))


def _seen(sight: Sight, planes: list[_Plane], points: Single, normals: Single) -> Single:
    """Light of the images of one group's patches at points, both (3, n), shape (images, 4, n)."""
    import drjit as dr
    import mitsuba as mi

    count = points.shape[1]
    place, normal = mi.Point3f(*points), mi.Normal3f(*normals)
    index = dr.arange(mi.UInt32, count * CELLS[0] * CELLS[1])
    point, cell = index // (CELLS[0] * CELLS[1]), index % (CELLS[0] * CELLS[1])
    angles = [
        (mi.Float(k) + 0.5) * size for k, size in zip((cell // CELLS[1], cell % CELLS[1]), SIZES, strict=True)
    ]
    last = sight.last(dr.gather(mi.Point3f, place, point), _towards(*angles))
    dr.eval(*last)
    found = []
    for plane in planes:
        met, _ = plane.meets(last)
        dr.eval(met)
        furthest = _furthest(met)
        margin = MARGIN * furthest
        near = plane.near(met, margin)
        dr.eval(near, furthest)
        chosen = dr.compress(_with_beside(near, furthest))
        light = dr.zeros(mi.Float, IMAGES * plane.patches * 4 * count)
        if dr.width(chosen):
            cells = [dr.gather(type(a), a, chosen) for a in (point, *angles, margin / PARTS)]
            _add(light, sight, plane, place, normal, cells)
        found.append(np.asarray(light).reshape(IMAGES * plane.patches, 4, count))
    return np.concatenate(found)


def _add(light: Any, sight: Sight, plane: _Plane, place: Any, normal: Any, cells: list[Any]) -> None:
    """Add the light of a plane's patches from cells: points, slants, azimuths, and margins of parts."""
    import drjit as dr
    import mitsuba as mi

    index = dr.arange(mi.UInt32, dr.width(cells[0]) * PARTS**2)
    point, slant, turn, margin = (dr.gather(type(a), a, index // PARTS**2) for a in cells)
    sizes = [size / PARTS for size in SIZES]
    part = index % PARTS**2
    slant += (mi.Float(part // PARTS) - (PARTS - 1) / 2) * sizes[0]
    turn += (mi.Float(part % PARTS) - (PARTS - 1) / 2) * sizes[1]
    origin, facing = dr.gather(mi.Point3f, place, point), dr.gather(mi.Normal3f, normal, point)
    towards = _towards(slant, turn)
    last = sight.last(origin, towards)
    met, length = plane.meets(last)
    clear = (dr.dot(towards, facing) > 0) & (length <= last.reach + SLACK_MM) & plane.near(met, margin)
    dr.eval(*last, met, length, clear, point, slant, turn, origin, towards)
    some = dr.compress(clear)
    if not dr.width(some):
        return
    point, slant, turn, origin, towards, met, length = (
        dr.gather(type(a), a, some) for a in (point, slant, turn, origin, towards, met, length)
    )
    last = Last(*(dr.gather(type(a), a, some) for a in last))

    def change(down: float, aside: float) -> Any:
        """How place changes across a part, from the ray a little to one or the other side that changes less.

        Beyond the edge of an image the other one may have met something else.
        """
        ends = [
            dr.abs(
                plane.meets(sight.last(origin, _towards(slant + sign * down, turn + sign * aside)))[0] - met
            )
            for sign in (STEP, -STEP)
        ]
        return mi.Point2f(*(_less(a, b) / STEP for a, b in zip(*ends, strict=True)))

    changes = change(sizes[0], 0.0), change(0.0, sizes[1])
    solid = (dr.cos(slant - sizes[0] / 2) - dr.cos(slant + sizes[0] / 2)) * sizes[1]
    sector = mi.UInt32(dr.floor(turn / (2 * dr.pi) * SECTORS)) % SECTORS
    image = dr.select(last.mirrors == 0, 0, 1 + dr.minimum(last.mirrors - 1, ORDERS - 1) * SECTORS + sector)
    image *= held(plane.patches)
    kept, first = solid * sight.kept(last, length), 0
    for face in plane.faces:
        share = mi.Float(1.0)
        number = mi.UInt32(0)
        for k in (1, 0):
            beside, half = met[k] - face.held_centre[k], face.held_half[k]
            share *= _below(half - beside, *(c[k] for c in changes)) - _below(
                -half - beside, *(c[k] for c in changes)
            )
            count = held(face.counts[k])
            at = dr.clip((beside / half + 1) / 2 * mi.Float(count), 0.0, mi.Float(count) - 0.5)
            number = number * count + mi.UInt32(at)
        value = dr.select(share > 0, share * kept * face.radiance(-last.ray.d), 0.0)
        for k, part in enumerate((*towards, sight.apparent(last, length))):
            dr.scatter_add(
                light,
                value * part,
                ((image + held(first) + number) * 4 + k) * held(dr.width(place)) + point,
            )
        first += face.counts[0] * face.counts[1]


def _towards(slant: Any, turn: Any) -> Any:
    """Unit vectors from slant and azimuth."""
    import drjit as dr
    import mitsuba as mi

    level = dr.sin(slant)
    return mi.Vector3f(level * dr.cos(turn), level * dr.sin(turn), dr.cos(slant))


def _neighbours(count: int) -> list[tuple[Any, Any]]:
    """Number of each cell's neighbour above, below and to either side, and whether there is one."""
    import drjit as dr
    import mitsuba as mi

    index, (rows, columns) = dr.arange(mi.UInt32, count), CELLS
    row, column = (index // columns) % rows, index % columns
    start = index - column
    return [
        (dr.select(row > 0, index - columns, index), row > 0),
        (dr.select(row + 1 < rows, index + columns, index), row + 1 < rows),
        (start + (column + columns - 1) % columns, mi.Bool(True)),
        (start + (column + 1) % columns, mi.Bool(True)),
    ]


def _furthest(place: Any) -> Any:
    """Most that places change from cell to cell; endless where neighbours do not tell."""
    import drjit as dr
    import mitsuba as mi

    steps = [
        dr.select(there, dr.abs(dr.gather(mi.Point2f, place, cell) - place), dr.nan)
        for cell, there in _neighbours(dr.width(place))
    ]
    sums = []
    for k in (0, 1):
        total = _more(steps[0][k], steps[1][k]) + _more(steps[2][k], steps[3][k])
        sums.append(dr.select(dr.isnan(total), dr.inf, total))
    return mi.Point2f(*sums)


def _with_beside(near: Any, furthest: Any) -> Any:
    """Cells near a face, and those beside them whose centre sees something else, for instance mirrored."""
    import drjit as dr
    import mitsuba as mi

    beside = mi.Bool(False)
    for cell, there in _neighbours(dr.width(near)):
        beside = beside | (there & dr.gather(mi.Bool, near, cell))
    return near | (beside & ~dr.all(furthest < JUMP_MM))


def _more(a: Any, b: Any) -> Any:
    """Greater one of two numbers, or the one there is."""
    import drjit as dr

    return dr.select(dr.isnan(a) | (b > a), b, a)


def _less(a: Any, b: Any) -> Any:
    """Smaller one of two numbers, or the one there is."""
    import drjit as dr

    return dr.select(dr.isnan(a) | (b < a), b, a)


def _below(edge: Any, a: Any, b: Any) -> Any:
    """Share of a cell in which a coordinate lies below an edge, that far from its value at the centre.

    Across the cell it changes by a one way and by b the other: it is spread like a sum of two even draws.
    """
    import drjit as dr

    wide = dr.maximum(dr.maximum(a, b), 2 * LEAST_MM)
    narrow = dr.clip(dr.minimum(a, b), LEAST_MM, wide)
    ramp, flat = (wide + narrow) / 2, (wide - narrow) / 2

    def square(x: Any) -> Any:
        return dr.square(dr.maximum(x, 0.0))

    total = square(edge + ramp) - square(edge + flat) - square(edge - flat) + square(edge - ramp)
    return dr.clip(total / (2 * wide * narrow), 0.0, 1.0)
