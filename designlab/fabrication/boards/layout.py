"""Where the parts of a board go, and how it is outlined; its tracks are those of `routing`."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from shapely.geometry import LineString, Point, Polygon, box

from designlab.fabrication.boards.circuit import BoardError, Channel
from designlab.fabrication.boards.drawn import MARK_MM, SIDES, Board, Component, Pad, Side, extent
from designlab.fabrication.boards.planes import Blank, Place
from designlab.fabrication.boards.routing import Land, NoWay, route
from designlab.fabrication.boards.stock import (
    CLEARANCE_MM,
    EDGE_MM,
    HEADER,
    HOLE_MM,
    LAND_PATTERNS,
    STOCK,
    WIRE_PAD,
    LandPattern,
)

Spot = tuple[float, float, float]
SUPPLY_NET = "V+"
APART_MM = 0.35
"""Between components, at least: room for one track."""
MOST_TRIES = 6
"""With more and more room between the parts of a strip."""
BESIDE_MM = 0.8
"""From the LEDs to the edge of a strip: one track passes them."""
HEAD_MM = 3.0
"""Diameter kept free around a mounting hole for the screw's head."""
STEP_MM = 0.2
TALLEST_TAIL_MM = 25.0
SEAT_MM = 0.2
"""Between a board and the housing's inner wall."""
MOST_HOLES = 3
RIM_MM = 1.0
"""Kept beside a hole of a ring for the tracks that pass it."""


class Room(NamedTuple):
    """What the housing leaves a board: largest distance from the axis and range of heights (mm)."""

    radius_mm: float
    bottom_mm: float
    top_mm: float
    bore_mm: float


def draw(blank: Blank, chosen: Sequence[Channel], room: Room) -> Board:
    """Draw a board: place its parts, connect them, and check that it fits.

    Parameters
    ----------
    blank : Blank
        The board's plane and LEDs.
    chosen : sequence of Channel
        Drive of each group.
    room : Room
        What the housing leaves.

    Raises
    ------
    BoardError
        If LEDs overlap, or it does not fit; names board, figure and rule.
    """
    leds = _strung(blank, chosen)
    _require_apart(blank, leds)
    groups = sorted({group for place in blank.places for group in place.groups})
    nets = [SUPPLY_NET, *(_return(chosen[group]) for group in groups)]
    if blank.kind == "ring":
        return _ring(blank, chosen, leds, nets, room)
    return _strip(blank, chosen, leds, nets, room)


def _return(channel: Channel) -> str:
    return f"{channel.group.name}-"


def _strung(blank: Blank, chosen: Sequence[Channel]) -> list[Component]:
    """LEDs of a board; in a string, each feeds the next."""
    leds: list[Component] = []
    strung: Counter[int] = Counter()
    feeds: dict[int, str] = {}
    for number, place in enumerate(blank.places, start=1):
        leds.append(_led(f"D{number}", place, chosen, [feeds.get(g, SUPPLY_NET) for g in place.groups]))
        for group in place.groups:
            strung[group] += 1
            channel = chosen[group]
            last = strung[group] % channel.in_series == 0
            feeds[group] = SUPPLY_NET if last else f"D{number}.{channel.cathode}"
    return leds


def _led(designator: str, place: Place, chosen: Sequence[Channel], feeds: Sequence[str]) -> Component:
    """Place an LED, its anodes on the nets `feeds`.

    Where its upside does not matter, its cathodes look to the resistors above.
    """
    held = [chosen[group] for group in place.groups]
    first = held[0]
    land = LAND_PATTERNS[str(first.part.land)]
    turn = math.radians(place.turn_deg)
    rise = sum(
        math.sin(turn) * land.pads[c.cathode][0] + math.cos(turn) * land.pads[c.cathode][1] for c in held
    )
    if rise < -1e-9 and all(channel.group.offset_mm is None for channel in held):
        place = place._replace(turn_deg=place.turn_deg + 180.0)
    nets: dict[str, str] = {}
    for channel, feed in zip(held, feeds, strict=True):
        if nets.setdefault(channel.cathode, f"{designator}.{channel.cathode}") == feed:
            raise BoardError(f"part {channel.name!r}: pad {channel.cathode} is anode and cathode at once")
        if nets.setdefault(channel.anode, feed) != feed:
            raise BoardError(f"part {channel.name!r}: pad {channel.anode} is anode and cathode at once")
    if len({channel.cathode for channel in held}) < len(held):
        raise BoardError(f"part {first.name!r}: chips share a cathode; boards switch cathodes apart")
    pads = _pads(land, nets, designator, "top", place.x, place.y, place.turn_deg)
    return Component(
        designator,
        "led",
        " + ".join(channel.group.name for channel in held),
        first.part.maker,
        first.number,
        "top",
        place.x,
        place.y,
        place.turn_deg,
        land,
        pads,
        first.cathode,
        place.groups,
    )


def _pads(
    land: LandPattern, nets: dict[str, str], designator: str, side: Side, x: float, y: float, turn: float
) -> tuple[Pad, ...]:
    """Pads of a part at its place; a pad without net has one of its own."""
    c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    mirror = 1.0 if side == "top" else -1.0
    found = []
    for name, (px, py, width, height) in land.pads.items():
        px *= mirror
        net = nets.get(name, f"{designator}.{name}")
        at = x + c * px - s * py, y + s * px + c * py
        found.append(Pad(name, net, *at, width, height, turn, land.drill_mm, side))
    return tuple(found)


def _require_apart(blank: Blank, leds: Sequence[Component]) -> None:
    """Refuse LEDs whose bodies overlap or whose pads come too near."""
    tree = shapely.STRtree([led.extent.buffer(CLEARANCE_MM) for led in leds])
    for index, led in enumerate(leds):
        for other in tree.query(led.extent):
            if other <= index:
                continue
            second = leds[other]
            between = min(a.shape.distance(b.shape) for a in led.pads for b in second.pads)
            if led.body.intersection(second.body).area > 1e-6 or between < CLEARANCE_MM:
                raise BoardError(
                    f"{blank.name}: LEDs {led.designator} ({led.value}) and {second.designator} "
                    f"({second.value}), part {led.number}, overlap on the board: their pads are "
                    f"{between:.3g} mm apart, at least {CLEARANCE_MM:g} mm must be; raise leds.pitch_mm or "
                    "name a smaller part"
                )


class _Floor:
    """Free room on both sides of a board."""

    def __init__(
        self, outline: Polygon, leds: Sequence[Component], folds: Sequence[float], apart: float
    ) -> None:
        self.apart = apart
        self.inner = outline.buffer(-EDGE_MM)
        self.taken: dict[Side, list[Any]] = {side: [] for side in SIDES}
        for led in leds:
            self.take(led.extent, ("top",))
            self.taken["top"].append(LineString(led.mark).buffer(MARK_MM))
        low, high = outline.bounds[1], outline.bounds[3]
        for fold in folds:
            self.take(box(fold - 0.1, low, fold + 0.1, high), SIDES)

    def take(self, shape: Any, sides: Sequence[Side]) -> None:
        """Occupy a place."""
        for side in sides:
            self.taken[side].append(shape.buffer(self.apart, join_style="mitre"))

    def free(self, shape: Any, sides: Sequence[Side]) -> bool:
        """Whether a shape fits at its place."""
        return bool(self.inner.contains(shape)) and not any(
            other.intersects(shape) for side in sides for other in self.taken[side]
        )

    def open_spots(self, spots: Sequence[Spot], land: LandPattern, sides: Sequence[Side]) -> list[Spot]:
        """Spots where the middle of a part is not too near to anything: a quick sieve before `free`."""
        x, y = (np.array([spot[k] for spot in spots]) for k in (0, 1))
        bounds = extent(land, 0.0, 0.0, 0.0).bounds
        half = 0.99 * min(bounds[2], bounds[3])
        good = shapely.contains_xy(self.inner.buffer(-half), x, y)
        for side in sides:
            good &= ~shapely.contains_xy(shapely.union_all(self.taken[side]).buffer(half), x, y)
        return [spot for spot, kept in zip(spots, good, strict=True) if kept]


class _Full(Exception):
    """A part found no place."""


def _strip(
    blank: Blank, chosen: Sequence[Channel], leds: Sequence[Component], nets: Sequence[str], room: Room
) -> Board:
    """Draw a strip, rigid or flexible: LEDs at the lower edge, resistors above, connector and holes on top.

    Above the LEDs it is as tall as its parts and tracks need.
    """
    bounds = shapely.union_all([led.extent for led in leds]).bounds
    margin = BESIDE_MM
    low_x, low_y, high_x, top = bounds[0] - margin, bounds[1] - margin, bounds[2] + margin, bounds[3]
    folds: list[float] = []
    if blank.kind == "flex":
        low_x, high_x = min(low_x, blank.facets[0][0]), max(high_x, blank.facets[-1][1])
        folds = [high for _, high in blank.facets[:-1]]
    least = HOLE_MM + 2 * (EDGE_MM + APART_MM) if blank.kind == "strip" else 0.0
    widen = max(0.0, least - (high_x - low_x)) / 2
    low_x, high_x = low_x - widen, high_x + widen
    stock = STOCK["flex" if blank.kind == "flex" else "board"]
    _require_within(blank, box(low_x, low_y, high_x, top), min(stock["thicknesses_mm"]), room)
    tail, apart, tries = margin + 1.5, APART_MM, 0
    while tail <= TALLEST_TAIL_MM and tries < MOST_TRIES:
        outline = box(low_x, low_y, high_x, top + tail)
        try:
            return _filled(blank, chosen, leds, nets, room, outline, folds, apart=apart)
        except _Full:
            tail += 0.5
        except NoWay:  # more room between the parts, before more room above them
            apart, tries = apart + 0.2, tries + 1
    raise BoardError(
        f"{blank.name}: {high_x - low_x:.3g} mm is too narrow for its tracks and its connector of "
        f"{len(nets)} pins; raise leds.pitch_mm"
    )


def _ring(
    blank: Blank, chosen: Sequence[Channel], leds: Sequence[Component], nets: Sequence[str], room: Room
) -> Board:
    """Draw a flat ring around the axis: LEDs in front, resistors behind them."""
    shapes = [led.extent for led in leds]
    axis = Point(0, 0)
    inner = min(shape.distance(axis) for shape in shapes) - EDGE_MM
    outer = max(shape.hausdorff_distance(axis) for shape in shapes) + EDGE_MM
    if outer > room.radius_mm + 1e-9:
        raise BoardError(
            f"{blank.name}: is wider than the housing: it needs {outer:.4g} mm from the axis for its LEDs, "
            f"housing.inner_radius_mm less {SEAT_MM:g} mm leaves {room.radius_mm:.4g} mm"
        )
    tried = set()
    for spare in (2.0, 4.0, 6.0, 9.0):
        bore = min(inner, max(room.bore_mm, inner - spare))
        rim = max(outer, min(room.radius_mm, outer + spare))
        if (bore, rim) in tried:
            break
        tried.add((bore, rim))
        if bore <= 0:
            outline = axis.buffer(rim, quad_segs=90)
        else:
            outline = axis.buffer(rim, quad_segs=90).difference(axis.buffer(bore, quad_segs=90))
        for drilled in (True, False):
            try:
                return _filled(blank, chosen, leds, nets, room, outline, [], drilled=drilled)
            except (_Full, NoWay):
                continue
    raise BoardError(
        f"{blank.name}: between {bore:.4g} and {rim:.4g} mm from the axis no way is left for resistors and "
        "tracks; raise housing.inner_radius_mm or leds.pitch_mm"
    )


def _filled(
    blank: Blank,
    chosen: Sequence[Channel],
    leds: Sequence[Component],
    nets: Sequence[str],
    room: Room,
    outline: Polygon,
    folds: Sequence[float],
    *,
    drilled: bool = True,
    apart: float = APART_MM,
) -> Board:
    """Place connector and resistors on an outline, `apart` (mm), and connect them.

    `drilled`, with holes and pin header.
    """
    thickness = _thickness(blank, outline, room)
    floor = _Floor(outline, leds, folds, apart)
    behind: Side = "bottom" if blank.kind == "ring" else "top"
    drilled = drilled and blank.kind != "flex"
    holes = _holes(blank, outline, floor) if drilled else []
    connector: list[Component] = []
    if blank.kind == "strip":  # beside the holes; a ring has room for it anywhere
        connector = _connector(blank, outline, floor, nets, behind, header=drilled)
    resistors: list[Component] = []
    held = Counter(pad.net for led in leds for pad in led.pads)
    for led in leds:
        for group in led.groups:
            if held[f"{led.designator}.{chosen[group].cathode}"] > 1:
                continue  # it feeds the next of its string
            designator = f"R{len(resistors) + 1}"
            resistors.append(_resistor(designator, led, chosen[group], outline, floor, behind))
    if not connector:
        connector = _connector(blank, outline, floor, nets, behind, header=drilled)
    components = [*leds, *resistors, *connector]
    lands = [Land(pad.shape, pad.net, pad.layers) for component in components for pad in component.pads]
    tracks, vias = route(outline, holes, lands)
    notes = [] if holes else ["no mounting holes: no room for one, or a flexible board; glue it"]
    return Board(
        blank,
        outline,
        tuple(holes),
        tuple(components),
        tuple(tracks),
        tuple(vias),
        thickness,
        tuple(nets),
        tuple(notes),
    )


def _spots(outline: Polygon, *, polar: bool) -> Iterator[Spot]:
    """Places to try (mm), with the direction that lies along the board there (deg)."""
    low_x, low_y, high_x, high_y = outline.bounds
    if not polar:
        for row in range(int((high_y - low_y) / STEP_MM) + 1):
            for column in range(int((high_x - low_x) / STEP_MM) + 1):
                yield low_x + column * STEP_MM, low_y + row * STEP_MM, 0.0
        return
    inner = min((math.hypot(x, y) for ring in outline.interiors for x, y in ring.coords), default=0.0)
    for ring_number in range(int((high_x - inner) / STEP_MM) + 1):
        radius = inner + ring_number * STEP_MM
        for step in range(180):
            angle = math.radians(2 * step)
            yield radius * math.cos(angle), radius * math.sin(angle), 2.0 * step + 90.0


def _holes(blank: Blank, outline: Polygon, floor: _Floor) -> list[tuple[float, float, float]]:
    """Mounting holes: two in a strip's upper corners, one where it is narrow; up to three around a ring."""
    low_x, _, high_x, top = outline.bounds
    found: list[tuple[float, float]] = []
    if blank.kind == "strip":
        inset = EDGE_MM + APART_MM + HOLE_MM / 2
        corners = [(low_x + inset, top - inset), (high_x - inset, top - inset)]
        if corners[1][0] - corners[0][0] < HEAD_MM:
            corners = [((low_x + high_x) / 2, top - inset)]
        for x, y in corners:
            if not floor.free(Point(x, y).buffer(HOLE_MM / 2), SIDES):
                raise _Full
            found.append((x, y))
    else:
        bore = min((math.hypot(x, y) for ring in outline.interiors for x, y in ring.coords), default=0.0)
        places = [
            (x, y)
            for x, y, _ in _spots(outline, polar=True)
            if max(math.hypot(x, y) - bore, high_x - math.hypot(x, y)) >= RIM_MM + HOLE_MM / 2
            and floor.free(Point(x, y).buffer(HOLE_MM / 2), SIDES)
        ]
        while places and len(found) < MOST_HOLES:
            # The next hole lies farthest from those before it.
            x, y = max(places, key=lambda p: min((math.dist(p, f) for f in found), default=p[1]))
            if min((math.dist((x, y), f) for f in found), default=HEAD_MM) < HEAD_MM:
                break
            found.append((x, y))
    for x, y in found:
        floor.take(Point(x, y).buffer(HOLE_MM / 2), ("top",))
        floor.take(Point(x, y).buffer(HEAD_MM / 2 - APART_MM), ("bottom",))
    return [(x, y, HOLE_MM) for x, y in found]


def _connector(
    blank: Blank, outline: Polygon, floor: _Floor, nets: Sequence[str], side: Side, *, header: bool
) -> list[Component]:
    """Pin header if wanted and where it fits, else pads for wires, one a net."""
    low_x, _, high_x, top = outline.bounds
    target = ((low_x + high_x) / 2, top)
    spots = sorted(_spots(outline, polar=blank.kind == "ring"), key=lambda s: math.dist(s[:2], target))
    if blank.kind == "flex":
        spots = sorted(_spots(outline, polar=False), key=lambda s: (s[0], -s[1]))
    row = HEADER.row(len(nets))
    numbered = {str(k + 1): net for k, net in enumerate(nets)}
    if header:
        for x, y, along in floor.open_spots(spots, row, SIDES):
            for turn in (along, along + 90.0):
                shape = extent(row, x, y, turn)
                if floor.free(shape, SIDES):
                    floor.take(shape, SIDES)
                    pads = _pads(row, numbered, "J1", side, x, y, turn)
                    value = f"pin header 1x{len(nets):02d}, 1.27 mm, or wires"
                    return [Component("J1", "connector", value, "", "", side, x, y, turn, row, pads)]
        if blank.kind == "strip":
            raise _Full
    found = []
    for k, net in enumerate(nets):
        designator = f"W{k + 1}"
        place = next(
            (
                (x, y, turn)
                for x, y, along in floor.open_spots(spots, WIRE_PAD, (side,))
                for turn in (along, along + 90.0)
                if floor.free(extent(WIRE_PAD, x, y, turn), (side,))
            ),
            None,
        )
        if place is None:
            raise _Full
        floor.take(extent(WIRE_PAD, *place), (side,))
        pads = _pads(WIRE_PAD, {"1": net}, designator, side, *place)
        found.append(Component(designator, "wire", f"wire {net}", "", "", side, *place, WIRE_PAD, pads))
    return found


def _resistor(
    designator: str, led: Component, channel: Channel, outline: Polygon, floor: _Floor, side: Side
) -> Component:
    """Resistor of a chip, at the free place nearest to the chip's cathode."""
    land = channel.resistor.land
    cathode = next(pad for pad in led.pads if pad.name == channel.cathode)
    polar = side == "bottom"
    if polar:
        spots = sorted(_spots(outline, polar=True), key=lambda s: math.dist(s[:2], (cathode.x, cathode.y)))
    else:
        top = led.extent.bounds[3]  # above its LED, in line with it
        above = (spot for spot in _spots(outline, polar=False) if spot[1] > top)
        spots = sorted(above, key=lambda s: (math.hypot(2 * (s[0] - led.x), s[1] - top), s))
    for x, y, along in floor.open_spots(spots, land, (side,)):
        for turn in (along, along + 90.0) if polar else (along + 90.0, along):
            shape = extent(land, x, y, turn)
            if not floor.free(shape, (side,)):
                continue
            nets = {"1": f"{led.designator}.{channel.cathode}", "2": _return(channel)}
            ways = [_pads(land, nets, designator, side, x, y, turn + half) for half in (0.0, 180.0)]
            pads = min(ways, key=lambda p: math.dist((p[0].x, p[0].y), (cathode.x, cathode.y)))
            floor.take(shape, (side,))
            return Component(
                designator,
                "resistor",
                channel.resistor.value,
                STOCK["resistor"]["maker"],
                channel.resistor.number,
                side,
                x,
                y,
                pads[0].turn_deg % 360.0,
                land,
                pads,
            )
    raise _Full


def _thickness(blank: Blank, outline: Polygon, room: Room) -> float:
    """Thickest board of the trade that fits the housing."""
    kinds = STOCK["flex" if blank.kind == "flex" else "board"]["thicknesses_mm"]
    if blank.kind == "ring":
        kinds = [t for t in kinds if t <= 1.0]
    for thickness in kinds:
        try:
            _require_within(blank, outline, thickness, room)
        except BoardError:
            continue
        return float(thickness)
    _require_within(blank, outline, kinds[-1], room)
    raise AssertionError


def _require_within(blank: Blank, outline: Polygon, thickness: float, room: Room) -> None:
    """Refuse a board that reaches beyond the housing's inner wall, camera plate or lower rim."""
    for x, y in outline.exterior.coords:
        for depth in (0.0, -thickness):
            frame, along = blank.frame_at(x)
            px, py, pz = frame.point(along, y, depth)
            if math.hypot(px, py) > room.radius_mm + 1e-6:
                raise BoardError(
                    f"{blank.name}: is wider than the housing: with {thickness:g} mm of thickness its corner "
                    f"lies {math.hypot(px, py):.4g} mm from the axis, housing.inner_radius_mm less "
                    f"{SEAT_MM:g} mm leaves {room.radius_mm:.4g} mm; raise it, or shorten the row of LEDs"
                )
            if pz > room.top_mm + 1e-6:
                raise BoardError(
                    f"{blank.name}: reaches up to {pz:.4g} mm, into the camera plate; housing.top_mm is "
                    f"{room.top_mm:g} mm, raise it"
                )
