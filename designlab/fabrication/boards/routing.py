"""Tracks of a two-layer board: a maze router on a grid, one path after another, widest detours allowed.

Each net grows from its first pad to the nearest of its others. Copper of other nets blocks what lies nearer
than the clearance. A net that finds no way goes first in the next try.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import LineString, Point, Polygon

from designlab.fabrication.boards.stock import CLEARANCE_MM, EDGE_MM, TRACK_MM, VIA_MM

GRID_MM = 0.1
SAG_MM = 0.005  # a step from one grid point to the next cuts across the round edge of a hole
SLACK_MM = 0.02
"""Kept over the clearance, for what rounding to the grid and to the file takes."""
VIA_COST = 12.0
"""A via costs as much as this many steps."""
MOST_TRIES = 8
BLOCKED = -1.0
Mask = NDArray[np.bool_]


class Land(NamedTuple):
    """Copper that is there before the tracks: shape, net, and layers (0 front, 1 back)."""

    shape: Polygon
    net: str
    layers: tuple[int, ...]

    @property
    def centre(self) -> tuple[float, float]:
        """Middle, where tracks end (mm)."""
        return float(self.shape.centroid.x), float(self.shape.centroid.y)


class Track(NamedTuple):
    """A line of copper: its net, layer and corners (mm)."""

    net: str
    layer: int
    points: tuple[tuple[float, float], ...]

    @property
    def shape(self) -> Polygon:
        """Its copper."""
        return LineString(self.points).buffer(TRACK_MM / 2)


class Via(NamedTuple):
    """A plated hole that joins the layers: its net and place (mm)."""

    net: str
    x: float
    y: float

    @property
    def shape(self) -> Polygon:
        """Its copper on either layer."""
        return Point(self.x, self.y).buffer(VIA_MM / 2)


class NoWay(Exception):
    """No path was found for a net."""


def route(
    outline: Polygon, holes: Sequence[tuple[float, float, float]], lands: Sequence[Land]
) -> tuple[list[Track], list[Via]]:
    """Connect all lands of equal net.

    Parameters
    ----------
    outline : Polygon
        The board (mm).
    holes : sequence of (x, y, diameter)
        Holes without copper (mm).
    lands : sequence of Land
        Pads; lands whose net occurs once stay alone.

    Returns
    -------
    tracks : list of Track
    vias : list of Via

    Raises
    ------
    NoWay
        If a net finds no path.
    """
    reach: dict[str, float] = {}
    for net in {land.net for land in lands}:
        points = [land.centre for land in lands if land.net == net]
        if len(points) > 1:
            reach[net] = LineString(points).length
    order = sorted(reach, key=lambda net: (reach[net], net))
    for _ in range(MOST_TRIES):
        maze = _Maze(outline, holes, lands)
        failed = next((net for net in order if not maze.connect(net)), None)
        if failed is None:
            return maze.tracks, maze.vias
        if order[0] == failed:
            break
        order.remove(failed)
        order.insert(0, failed)
    raise NoWay(failed)


class _Maze:
    """Grid over a board: what each net may use, and the copper laid so far."""

    def __init__(
        self, outline: Polygon, holes: Sequence[tuple[float, float, float]], lands: Sequence[Land]
    ) -> None:
        low_x, low_y, high_x, high_y = outline.bounds
        self.x = np.arange(low_x + GRID_MM / 2, high_x, GRID_MM)
        self.y = np.arange(low_y + GRID_MM / 2, high_y, GRID_MM)
        self.lands = lands
        self.tracks: list[Track] = []
        self.vias: list[Via] = []
        size = (len(self.y), len(self.x))
        self.taken: dict[str, NDArray[np.bool_]] = {}
        self.count = np.zeros((4, *size), dtype=np.int32)  # tracks front, back; vias front, back
        free = outline
        for x, y, diameter in holes:
            free = free.difference(Point(x, y).buffer(diameter / 2 + SAG_MM))
        self.room = [
            self._inside(free.buffer(-(EDGE_MM + width / 2))) for width in (TRACK_MM, VIA_MM)
        ]  # where a track, a via may lie at all
        for land in lands:
            self._add(land.net, land.layers, land.shape)
            # A via in a pad would drain its solder.
            self._block(self.room[1], land.shape.buffer(VIA_MM / 2 + SLACK_MM))

    def connect(self, net: str) -> bool:
        """Lay the tracks of a net; whether all its pads were reached."""
        from skimage.graph import MCP_Geometric

        pads = [self._cells(land) for land in self.lands if land.net == net]
        joined, waiting = list(pads[0]), pads[1:]
        blocked = (self.count - self.taken[net]) > 0
        costs = np.ones((3, *self.room[0].shape))
        costs[0][blocked[0] | ~self.room[0]] = BLOCKED
        costs[2][blocked[1] | ~self.room[0]] = BLOCKED
        drilled = -1
        while waiting:
            if drilled != len(self.vias):  # its own vias keep apart too
                costs[1] = np.where(blocked[2] | blocked[3] | ~self.room[1], BLOCKED, VIA_COST)
                maze, drilled = MCP_Geometric(costs, offsets=_STEPS), len(self.vias)
            ends = [cell for cells in waiting for cell in cells]
            found, _ = maze.find_costs(joined, ends, find_all_ends=False)
            reached = min(ends, key=lambda cell: found[cell])
            if not np.isfinite(found[reached]):
                return False
            path = [(int(z), int(y), int(x)) for z, y, x in maze.traceback(reached)]
            self._lay(net, path)
            joined += [cell for cell in path if cell[0] != 1]
            hit = next(cells for cells in waiting if reached in cells)
            joined += hit
            waiting.remove(hit)
        return True

    def _cells(self, land: Land) -> list[tuple[int, int, int]]:
        x, y = land.centre
        column = int(np.argmin(np.abs(self.x - x)))
        row = int(np.argmin(np.abs(self.y - y)))
        return [(2 * layer, row, column) for layer in land.layers]

    def _lay(self, net: str, path: Sequence[tuple[int, ...]]) -> None:
        """Turn a path of cells into tracks and vias."""
        run: list[tuple[int, ...]] = []
        for cell in path:
            if cell[0] == 1:
                via = Via(net, *self._at(cell))
                self.vias.append(via)
                self._add(net, (0, 1), via.shape)
                # The holes of two vias keep apart, whatever their nets.
                self._block(self.room[1], via.shape.buffer(VIA_MM / 2 + CLEARANCE_MM))
                self._end(net, run)
                run = []
            else:
                run.append(cell)
        self._end(net, run)

    def _end(self, net: str, run: Sequence[tuple[int, ...]]) -> None:
        if len(run) < 2:
            return
        corners = [run[0]]
        for before, here, after in zip(run, run[1:], run[2:], strict=False):
            turn = [(here[k] - before[k], after[k] - here[k]) for k in (1, 2)]
            if any(a != b for a, b in turn):
                corners.append(here)
        corners.append(run[-1])
        track = Track(net, run[0][0] // 2, tuple(self._at(cell) for cell in corners))
        self.tracks.append(track)
        self._add(net, (track.layer,), track.shape)

    def _at(self, cell: Sequence[int]) -> tuple[float, float]:
        return round(float(self.x[cell[2]]), 4), round(float(self.y[cell[1]]), 4)

    def _add(self, net: str, layers: Iterable[int], shape: Polygon) -> None:
        """Keep other nets away from new copper."""
        own = self.taken.setdefault(net, np.zeros(self.count.shape, dtype=bool))
        for layer in layers:
            for kind, width in ((layer, TRACK_MM), (2 + layer, VIA_MM)):
                before = own[kind].copy()
                self._block(own[kind], shape.buffer(CLEARANCE_MM + SLACK_MM + width / 2), value=True)
                self.count[kind] += own[kind] & ~before

    def _block(self, mask: Mask, shape: Any, *, value: bool = False) -> None:
        low_x, low_y, high_x, high_y = shape.bounds
        columns = slice(*np.searchsorted(self.x, (low_x, high_x)))
        rows = slice(*np.searchsorted(self.y, (low_y, high_y)))
        x, y = np.meshgrid(self.x[columns], self.y[rows])
        mask[rows, columns][shapely.contains_xy(shape, x, y)] = value

    def _inside(self, shape: Any) -> Mask:
        x, y = np.meshgrid(self.x, self.y)
        return np.asarray(shapely.contains_xy(shape, x, y))


_STEPS = [(0, dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if (dx, dy) != (0, 0)]
_STEPS += [(-1, 0, 0), (1, 0, 0)]
