"""Boards as drawn: outline, holes, components, pads, nets and tracks, all in mm in the board's own plane.

x and y are as seen from the front, the side with the LEDs. The origin of a ring is the sensor's axis, that of
a strip the middle of its LEDs, that of a flexible board the left end of its line of LEDs.
"""

import math
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
import shapely
from shapely import affinity
from shapely.geometry import Polygon, box

from designlab.core.types import Array
from designlab.fabrication.boards.planes import Blank
from designlab.fabrication.boards.routing import Track, Via
from designlab.fabrication.boards.stock import LandPattern

Side = Literal["top", "bottom"]
Line = tuple[tuple[float, float], tuple[float, float]]
MARK_MM = 0.15
"""Of the polarity mark: its width, and half its distance from body and pads."""
SECTORS = 72  # convex pieces that a ring is taken apart into
PROUD_MM = 1.0
"""Over the front of a board that its resistors and solder reach at most."""
SIDES: tuple[Side, Side] = ("top", "bottom")


class Pad(NamedTuple):
    """One pad: name, net, middle, size, turn of its component (deg); drilled ones lie on both layers."""

    name: str
    net: str
    x: float
    y: float
    width: float
    height: float
    turn_deg: float
    drill_mm: float
    side: Side

    @property
    def shape(self) -> Polygon:
        """Its copper."""
        flat = box(-self.width / 2, -self.height / 2, self.width / 2, self.height / 2)
        return affinity.translate(affinity.rotate(flat, self.turn_deg, origin=(0, 0)), self.x, self.y)

    @property
    def layers(self) -> tuple[int, ...]:
        """Copper layers that it lies on: 0 front, 1 back."""
        return (0, 1) if self.drill_mm else (SIDES.index(self.side),)


class Component(NamedTuple):
    """One part on a board. `cathode` is the pad that the polarity mark stands at, of an LED."""

    designator: str
    kind: Literal["led", "resistor", "connector", "wire"]
    value: str
    maker: str
    number: str
    side: Side
    x: float
    y: float
    turn_deg: float
    land: LandPattern
    pads: tuple[Pad, ...]
    cathode: str = ""
    groups: tuple[int, ...] = ()

    @property
    def body(self) -> Polygon:
        """Outline of the part."""
        width, height = self.land.body_mm
        flat = box(-width / 2, -height / 2, width / 2, height / 2)
        return affinity.translate(affinity.rotate(flat, self.turn_deg, origin=(0, 0)), self.x, self.y)

    @property
    def extent(self) -> Polygon:
        """Smallest rectangle, turned as the part is, around body and pads."""
        return extent(self.land, self.x, self.y, self.turn_deg)

    @property
    def mark(self) -> Line:
        """Polarity mark of an LED: a line beside its cathode, outside body and pads; its two ends (mm)."""
        _, _, cathode_width, cathode_height = self.land.pads[self.cathode]
        along, up = self.land.pads[self.cathode][:2]
        bounds = extent(self.land, 0.0, 0.0, 0.0).bounds
        if abs(along) / bounds[2] >= abs(up) / bounds[3]:
            x = math.copysign(bounds[2] + 2 * MARK_MM, along)
            ends = ((x, up - cathode_height / 2), (x, up + cathode_height / 2))
        else:
            y = math.copysign(bounds[3] + 2 * MARK_MM, up)
            ends = ((along - cathode_width / 2, y), (along + cathode_width / 2, y))
        c, s = math.cos(math.radians(self.turn_deg)), math.sin(math.radians(self.turn_deg))
        first, second = ((self.x + c * x - s * y, self.y + s * x + c * y) for x, y in ends)
        return first, second


class Board(NamedTuple):
    """A board, complete."""

    blank: Blank
    outline: Polygon
    holes: tuple[tuple[float, float, float], ...]
    components: tuple[Component, ...]
    tracks: tuple[Track, ...]
    vias: tuple[Via, ...]
    thickness_mm: float
    pins: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def name(self) -> str:
        """Name, such as board_red."""
        return self.blank.name

    @property
    def pads(self) -> list[Pad]:
        """Pads of all components."""
        return [pad for component in self.components for pad in component.pads]

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height."""
        low_x, low_y, high_x, high_y = self.outline.bounds
        return high_x - low_x, high_y - low_y

    def copper(self, layer: int) -> dict[str, Any]:
        """Copper of a layer (0 front, 1 back) by net."""
        shapes: dict[str, list[Any]] = {}
        for pad in self.pads:
            if layer in pad.layers:
                shapes.setdefault(pad.net, []).append(pad.shape)
        for track in self.tracks:
            if track.layer == layer:
                shapes.setdefault(track.net, []).append(track.shape)
        for via in self.vias:
            shapes.setdefault(via.net, []).append(via.shape)
        return {net: shapely.union_all(parts) for net, parts in shapes.items()}


def bodies(board: Board) -> list[Array]:
    """Corners of convex pieces that make up a board and what stands on it, each (8, 3), sensor frame (mm)."""
    blank, (low_x, low_y, high_x, high_y) = board.blank, board.outline.bounds
    pieces: list[list[tuple[float, float]]] = []
    if blank.kind == "ring":
        bore = max((ring.bounds[2] for ring in board.outline.interiors), default=0.0)
        turns = np.linspace(0.0, 2 * np.pi, SECTORS + 1)
        for a, b in pairwise(turns):
            rays = [(math.cos(t), math.sin(t)) for t in (a, b)]
            pieces.append([(r * c, r * s) for r in (bore, high_x) for c, s in rays])
    else:
        for low, high in blank.facets or ((low_x, high_x),):
            pieces.append([(x, y) for x in (low, high) for y in (low_y, high_y)])
    depths = (-board.thickness_mm, PROUD_MM)
    found = []
    for piece in pieces:
        frame, middle = blank.frame_at(sum(x for x, _ in piece) / len(piece))
        shift = middle - sum(x for x, _ in piece) / len(piece)
        found.append(np.array([frame.point(x + shift, y, z) for x, y in piece for z in depths]))
    return found


def extent(land: LandPattern, x: float, y: float, turn: float) -> Polygon:
    """Smallest rectangle, turned as the part is, around body and pads of a part at its place."""
    width = max([land.body_mm[0] / 2, *(abs(px) + w / 2 for px, _, w, _ in land.pads.values())])
    height = max([land.body_mm[1] / 2, *(abs(py) + h / 2 for _, py, _, h in land.pads.values())])
    return affinity.translate(affinity.rotate(box(-width, -height, width, height), turn, origin=(0, 0)), x, y)
