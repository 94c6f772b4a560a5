"""Seats in the housing for gelcore and LED boards.

Everything grows from the camera plate or the tube's wall, so that the body prints on its upper face without
support. What stands inside is rings and upright prisms, which light sees as they are built.
"""

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometries import gelcore
from geometries.blocks import Prism, Ring, disc, grown, prism, ring, slab
from geometries.camera_head import BESIDE_LENS_MM, CHAMFER_MM, Box, Mount, camera_seat, lid_outline
from geometries.gelcore import Gelcore
from geometries.housing import Housing
from geometries.leds import LedArray, bodies
from geometries.outline import reach_mm

if TYPE_CHECKING:
    import cadquery

Array = NDArray[np.float64]

TAB_MM, TAB_HEIGHT_MM = 5.0, 4.0
"""Width of a tab along the wall, and how far it reaches down beside the core."""
LEAST_TAB = 0.4  # of that width, where LEDs leave no more
LEDGE_MM = 1.2  # of a tab over the core's window where there is no collar
BESIDE_LEDS_MM = 2.5  # kept free beside an LED: the board's edge, and the cheek of its pocket
BESIDE_FEET_MM, LEAST_FOOT_MM, WIDEST_FOOT_DEG = 0.5, 0.5, 40.0
WIDEST_OPEN_DEG = 175.0
"""Between neighbouring feet or tabs: a core that is held on half a turn only tips or slides out."""
CHEEK_MM = 1.0  # on both sides of a board
BELOW_BOARD_MM = 0.2  # that its floor reaches below it
LEAST_CHAMFER_MM = 0.1
FAR_MM = 400.0
INTO_WALL_MM = 0.3  # what grows from the wall begins inside it
RIM_MM = 1.0  # of the head around the lid
CABLE_MM = 4.0
"""Width and height of the hole for wires where no board says where they begin, and under a level board."""
WALL_BESIDE_MM = 1.2  # of the wall behind a groove for wires
LEAST_WALL_MM = 0.8
"""Two lines of a 0.4 mm nozzle: the thinnest wall that common printers close reliably."""
GEL_RING_MM, SHOULDER_WALL_MM = 1.0, 0.8
"""Thickness of the ring around the gel, and how deep its shoulder cuts into the wall."""
OPEN_MM = 1.0  # between gel and bore: what sealant closes without a ring
CORE_RING_MM = 2.0
SHOULDER_MM = 2.6
"""Width of what carries a peg behind a level board: within the room of a screw's head."""
PEG_PLAY_MM = 0.2  # on the diameter: a board turns by less than half a degree
FRONT_MM = 4.0  # kept free before a board: LEDs and wires


class Inside(NamedTuple):
    """What stands inside a housing with seats, but for the seats of boards."""

    collar: Ring | None
    feet: tuple[Prism, ...]
    tabs: tuple[Prism, ...]
    tabs_deg: tuple[float, ...]
    cable_deg: float


class Plate(NamedTuple):
    """A flat board: its front's frame in the sensor frame, and its outline in it (mm).

    `bounds` is (x from, y from, x to, y to). `behind` are boxes at its back that are kept free, (x from,
    x to, y from, y to, depth). A ring lies about the axis, with a bore; pegs in its `holes`, each (x, y,
    diameter), keep it from turning. `pads` are the middles of the pads that wires are soldered to.
    """

    name: str
    origin: tuple[float, float, float]
    x: tuple[float, float, float]
    y: tuple[float, float, float]
    normal: tuple[float, float, float]
    bounds: tuple[float, float, float, float]
    thickness_mm: float
    behind: tuple[Box, ...]
    ring: bool = False
    holes: tuple[tuple[float, float, float], ...] = ()
    pads: tuple[tuple[float, float], ...] = ()

    @property
    def upright(self) -> bool:
        """Whether it stands along the axis, so that it slides into its pocket from the gel's side."""
        return abs(self.normal[2]) < 1e-6


class WireHole(NamedTuple):
    """A hole through the wall for the wires of a board: a level tunnel, in the sensor frame (mm).

    It begins at `start`, the middle of its cross-section, and leads along `way`, a level unit vector.
    """

    start: tuple[float, float, float]
    way: tuple[float, float, float]
    width_mm: float
    height_mm: float


class GelRing(NamedTuple):
    """A flat ring that closes the bore around the gel: its heights, and its hole's outline, (n, 2), in mm."""

    outer_mm: float
    hole: Array
    low_mm: float
    high_mm: float


def inside(housing: Housing, core: Gelcore, leds: LedArray, *, window_mm: float) -> Inside:
    """Collar and tabs of a housing with seats.

    Parameters
    ----------
    housing : Housing
        The housing; it has seats.
    core : Gelcore
        What is seated.
    leds : LedArray
        LEDs, beside which no tab stands.
    window_mm : float
        Height of the gelcore's window on the axis.
    """
    assert housing.seats is not None
    seats, clear_mm = housing.seats, core.window_diameter_mm / 2
    collar: Ring | None = None
    feet: list[Prism] = []
    if seats.stop == "collar":
        outer = clear_mm + seats.collar_wall_mm
        collar = Ring(clear_mm, outer, window_mm, housing.top_mm, core.window_slope)
        if feet := _feet(collar, leds):
            collar = collar._replace(low_mm=feet[0].high_mm)
    gaps = _free_deg(leds, BESIDE_LEDS_MM)
    widest_deg = math.degrees(TAB_MM / 2 / housing.inner_radius_mm)
    lower_mm = min(TAB_HEIGHT_MM, 0.6 * gelcore.side_height_mm(core))
    low_mm = window_mm - lower_mm - abs(core.window_slope) * core.length_mm / 2
    tabs, places = [], []
    for start, width in gaps if not rings(leds) else ():  # under a level board the core has a ring of its own
        half_deg = min(widest_deg, width / 2)
        count = 0 if half_deg < LEAST_TAB * widest_deg else max(1, round(width / 150.0))
        for place in (start + width * (2 * k + 1) / (2 * count) for k in range(count)):
            places.append(place)
            tabs += _tab(housing, core, place, half_deg, low_mm, window_mm)
    start, width = max(gaps, key=lambda gap: gap[1], default=(0.0, 360.0))
    aside = widest_deg + math.degrees(CABLE_MM / housing.inner_radius_mm)
    cable_deg = (start + width / 2 + (aside if places else 0.0)) % 360.0
    return Inside(collar, tuple(feet), tuple(tabs), tuple(places), cable_deg)


def _feet(collar: Ring, leds: LedArray) -> list[Prism]:
    """Feet of a collar beneath LEDs that shine down on the core's rim, where none of these stands.

    The collar itself ends where the light begins. None where LEDs stand lower, or where feet would stand
    on one side only.
    """
    if not rings(leds):
        return []
    lit_mm = min(body.centre_mm[2] - body.half_mm[2] for body in bodies(leds))
    if lit_mm < collar.low_mm + LEAST_FOOT_MM or lit_mm > collar.high_mm - LEAST_FOOT_MM:
        return []
    found, places = [], []
    for start, width in _free_deg(leds, BESIDE_FEET_MM):
        half = min(width / 2, WIDEST_FOOT_DEG / 2)
        if math.radians(2 * half) * collar.inner_mm < LEAST_FOOT_MM:
            continue
        turns = np.radians(start + width / 2 + np.linspace(-half, half, 13))
        way = np.column_stack([np.cos(turns), np.sin(turns)])
        outline = np.concatenate([collar.outer_mm * way, collar.inner_mm * way[::-1]])
        found.append(Prism(outline, collar.low_mm, lit_mm))
        places.append(start + width / 2)
    return found if widest_gap_deg(places) < WIDEST_OPEN_DEG else []


def widest_gap_deg(places_deg: Sequence[float]) -> float:
    """Widest range of azimuths without a place (deg); a whole turn of one place or none."""
    around = sorted(place % 360.0 for place in places_deg)
    gaps = [(b - a) % 360.0 for a, b in zip(around, [*around[1:], *around[:1]], strict=True)]
    return max(gaps, default=360.0) or 360.0


def rings(leds: LedArray) -> bool:
    """Whether the LEDs stand on a level board, over which the core cannot be held at the wall."""
    return all(abs(body.normal[2]) > 1 - 1e-6 for body in bodies(leds))


def _free_deg(leds: LedArray, beside_mm: float) -> list[tuple[float, float]]:
    """Azimuths without LEDs: start and width of each range (deg)."""
    taken = []
    for body in bodies(leds):
        axes = np.array([body.across, body.down, body.normal]) * np.array(body.half_mm)[:, None]
        signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
        corners = np.asarray(body.centre_mm) + signs @ axes
        middle = math.atan2(body.centre_mm[1], body.centre_mm[0])
        around = np.angle(np.exp(1j * (np.arctan2(corners[:, 1], corners[:, 0]) - middle)))
        beside = beside_mm / float(np.hypot(corners[:, 0], corners[:, 1]).min())
        half = float(np.abs(around).max()) + beside
        taken.append((math.degrees(middle - half) % 360.0, math.degrees(2 * half)))
    taken.sort()
    gaps, reached = [], taken[0][0]
    for start, width in [*taken, (taken[0][0] + 360.0, 0.0)]:
        if start > reached:
            gaps.append((reached, start - reached))
        reached = max(reached, start + width)
    return gaps


def _tab(
    housing: Housing, core: Gelcore, place_deg: float, half_deg: float, low_mm: float, window_mm: float
) -> list[Prism]:
    """Fill between wall and core at an azimuth, and its ledge over the core where that is the stop."""
    seats = housing.seats
    assert seats is not None
    beside = gelcore.polygon_at(core, max(low_mm - window_mm + core.height_mm, 0.0))
    turns = np.radians(place_deg + np.linspace(-half_deg, half_deg, 13))
    corners = np.arctan2(beside[:, 1], beside[:, 0])
    if core.shape != "dome":
        apart = np.angle(np.exp(1j * (corners - math.radians(place_deg))))
        turns = np.sort(
            np.concatenate([turns, math.radians(place_deg) + apart[np.abs(apart) < math.radians(half_deg)]])
        )
    way = np.column_stack([np.cos(turns), np.sin(turns)])
    outer = (housing.inner_radius_mm + INTO_WALL_MM) * way
    bulge_mm = max(core.side_bulge_mm or 0.0, 0.0)
    reach = reach_mm(beside, way, grown_mm=seats.gap_mm + bulge_mm)
    # Above the core a tab is a column up to the plate, so that it prints without support.
    upper = reach
    if seats.stop == "tabs":
        rim = reach_mm(gelcore.polygon_at(core, core.height_mm), way)
        upper = np.maximum(rim - LEDGE_MM, core.window_diameter_mm / 2)
    found = []
    for near, low, high in ((reach, low_mm, window_mm), (upper, window_mm, housing.top_mm)):
        near = np.minimum(near, housing.inner_radius_mm + INTO_WALL_MM / 2)
        if float(near.min()) < housing.inner_radius_mm - 0.05:
            found.append(Prism(np.concatenate([outer, (near[:, None] * way)[::-1]]), low, high))
    return found


def body(
    housing: Housing,
    within: Inside,
    plates: Sequence[Plate],
    posts: Iterable[Prism],
    mount: Mount,
    *,
    holes: Iterable[WireHole] = (),
    gel_ring: GelRing | None = None,
) -> "cadquery.Workplane":
    """Body of the housing as one CadQuery solid in the sensor frame (mm).

    Parameters
    ----------
    housing : Housing
        The housing; it has seats.
    within : Inside
        What stands inside.
    plates : sequence of Plate
        Boards to seat.
    posts : iterable of Prism
        What a level board rests on.
    mount : Mount
        The camera board on the plate.
    holes : iterable of WireHole
        Where wires leave.
    gel_ring : GelRing, optional
        What the lower rim has a shoulder for.
    """
    import cadquery

    assert housing.seats is not None
    gap, top, low = housing.seats.gap_mm, housing.top_mm, housing.bottom_mm
    inner, outer = housing.inner_radius_mm, housing.inner_radius_mm + housing.wall_mm
    base = cadquery.Workplane("XY", origin=(0, 0, low))
    height = mount.seat_mm - low
    if housing.seats.outline == "round":
        block = base.circle(outer).extrude(height)
    else:
        block = base.rect(2 * outer, 2 * outer).extrude(height).edges("|Z").fillet(min(2.0, housing.wall_mm))
    cut_mm = 0.0 if gel_ring is None else gel_ring.outer_mm + gap - inner
    chamfer = min(CHAMFER_MM, housing.wall_mm / 4, housing.wall_mm - cut_mm - LEAST_WALL_MM)
    if chamfer > LEAST_CHAMFER_MM:
        block = block.faces("<Z").chamfer(chamfer)
    x0, x1, y0, y1 = grown(lid_outline(mount, gap), RIM_MM)
    head = slab((x0, x1, y0, y1), top, mount.seat_mm).edges("|Z").fillet(2.0)
    block = block.union(head).faces(">Z").chamfer(CHAMFER_MM)
    block = block.cut(disc(inner, low - 1, top))
    if gel_ring is not None:
        block = block.cut(disc(gel_ring.outer_mm + gap, low - 1, gel_ring.high_mm))
    seats = [prism(part) for part in (*within.tabs, *posts)]
    seats += [_pad(plate, gap, inner, low, top) for plate in plates if not plate.ring]
    for seat in seats:
        for plate in plates:
            if not plate.ring:
                seat = seat.cut(_kept_free(plate, gap))
        block = block.union(seat)
    for plate in plates:
        for drilled in plate.holes if plate.ring else ():
            block = block.union(_peg(plate, drilled, top))
        for box in plate.behind if not plate.ring else ():
            block = block.cut(_wire_way(plate, box, inner, housing.wall_mm, top))
    for hole in holes:
        block = block.cut(wire_tunnel(hole))
    if within.collar is not None:
        collar = ring(within.collar)
        for foot in within.feet:
            collar = collar.union(prism(foot))
        block = block.union(collar)
    block = camera_seat(block, housing, mount, gap)
    return block.solids()


def level_hole(housing: Housing, at_deg: float) -> WireHole:
    """A hole through the wall under the camera plate, at an azimuth (deg)."""
    turn, inner = math.radians(at_deg), housing.inner_radius_mm
    way = (math.cos(turn), math.sin(turn), 0.0)
    start = (inner - 1.0) * way[0], (inner - 1.0) * way[1], housing.top_mm - CABLE_MM / 2 - 0.6
    return WireHole(start, way, CABLE_MM, CABLE_MM)


def hole_behind(plate: Plate) -> WireHole:
    """Hole straight out through the wall behind the connector of an upright or leaning board."""
    x0, x1, y0, y1, depth = plate.behind[0]
    x, y, normal = (np.asarray(axis) for axis in (plate.x, plate.y, plate.normal))
    out = -normal * (1.0, 1.0, 0.0)
    out /= np.linalg.norm(out)
    back = plate.thickness_mm
    ends = np.array(
        [
            plate.origin + (x0 + x1) / 2 * x + v * y - d * normal
            for v in (y0, y1)
            for d in (back, back + depth)
        ]
    )
    along = ends @ out
    begin = float(along[[0, 2]].max())  # at the board's back, where it stands farthest out
    low, high = float(ends[:, 2].min()), float(ends[:, 2].max())
    across = np.array([-out[1], out[0], 0.0])
    start = begin * out + float(ends[0] @ across) * across
    return WireHole(
        (float(start[0]), float(start[1]), (low + high) / 2),
        (float(out[0]), float(out[1]), 0.0),
        x1 - x0,
        high - low,
    )


def wire_tunnel(hole: WireHole) -> "cadquery.Workplane":
    """The hole as the solid that is cut away."""
    import cadquery

    plane = cadquery.Plane(origin=hole.start, xDir=(0, 0, 1), normal=hole.way)
    return cadquery.Workplane(plane).rect(hole.height_mm, hole.width_mm).extrude(FAR_MM / 4)


def gel_ring(spec: GelRing) -> "cadquery.Workplane":
    """The ring around the gel, put in last from the gel's side, against the shoulder in the wall."""
    import cadquery

    plane = cadquery.Workplane("XY", origin=(0, 0, spec.low_mm - 1))
    hole = plane.polyline(spec.hole.tolist()).close().extrude(spec.high_mm - spec.low_mm + 2)
    return disc(spec.outer_mm, spec.low_mm, spec.high_mm).cut(hole).solids()


def core_ring(
    housing: Housing, core: Gelcore, leds: LedArray, *, window_mm: float, board_mm: float
) -> "cadquery.Workplane":
    """Ring that centres the core under a level LED board, put in after it and before the core.

    Outside the LEDs it rises to the board's front, at the height `board_mm`.
    """
    import cadquery

    assert housing.seats is not None
    gap, outer = housing.seats.gap_mm, housing.inner_radius_mm - housing.seats.gap_mm
    low = window_mm - max(LEAST_WALL_MM, min(CORE_RING_MM, 0.6 * gelcore.side_height_mm(core)))
    reach = max(float(np.hypot(*body.centre_mm[:2])) + math.hypot(*body.half_mm[:2]) for body in bodies(leds))
    upper = disc(outer, low, board_mm).cut(
        disc(min(reach + BESIDE_LENS_MM, outer - LEAST_WALL_MM), low - 1, board_mm + 1)
    )
    ring = disc(outer, low, window_mm)
    gap += max(core.side_bulge_mm or 0.0, 0.0)
    if core.shape == "dome":
        return upper.union(ring.cut(disc(core.width_mm / 2 + gap, low - 1, window_mm + 1))).solids()
    beside = gelcore.polygon_at(core, max(low - window_mm + core.height_mm, 0.0))
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    angles = np.unique(np.concatenate([angles, np.arctan2(beside[:, 1], beside[:, 0])]))
    way = np.column_stack([np.cos(angles), np.sin(angles)])
    hole = way * reach_mm(beside, way, grown_mm=gap)[:, None]
    plane = cadquery.Workplane("XY", origin=(0, 0, low - 1))
    return upper.union(ring.cut(plane.polyline(hole.tolist()).close().extrude(window_mm - low + 2))).solids()


def _on(plate: Plate) -> "cadquery.Plane":
    import cadquery

    return cadquery.Plane(origin=plate.origin, xDir=plate.x, normal=plate.normal)


def _box_on(
    plate: Plate, box: tuple[float, float, float, float], low: float, high: float
) -> "cadquery.Workplane":
    """Box over a rectangle (x from, x to, y from, y to) of a board, between two heights over its front."""
    import cadquery

    x0, x1, y0, y1 = box
    plane = cadquery.Workplane(_on(plate)).workplane(offset=low)
    return plane.center((x0 + x1) / 2, (y0 + y1) / 2).rect(x1 - x0, y1 - y0).extrude(high - low)


def _pad(plate: Plate, gap: float, inner: float, low: float, top: float) -> "cadquery.Workplane":
    """What holds an upright or leaning board: floor at its back, cheeks beside it and a stop over it."""
    x0, y0, x1, y1 = plate.bounds
    wide = x0 - gap - CHEEK_MM, x1 + gap + CHEEK_MM
    seat = _box_on(plate, (*wide, y0 - BELOW_BOARD_MM, FAR_MM / 4), -FAR_MM / 8, 0.0)
    seat = seat.intersect(disc(inner + INTO_WALL_MM, low, top))
    # Over a board that leans inwards the stop rises straight.
    edge = np.asarray(plate.origin) + y1 * np.asarray(plate.y)
    return seat.cut(disc(float(np.hypot(*edge[:2])), edge[2], top + 1)) if not plate.upright else seat


def _peg(plate: Plate, hole: tuple[float, float, float], top: float) -> "cadquery.Workplane":
    """Column from the camera plate down to a level board's back, and its peg through a hole of the board."""
    x, y, diameter = hole
    at = np.asarray(plate.origin) + x * np.asarray(plate.x) + y * np.asarray(plate.y)
    front, back = at[2], at[2] - plate.normal[2] * plate.thickness_mm
    column = disc(SHOULDER_MM / 2, back, top).union(disc((diameter - PEG_PLAY_MM) / 2, front, top))
    return column.translate((float(at[0]), float(at[1]), 0.0))


def _kept_free(plate: Plate, gap: float) -> "cadquery.Workplane":
    """Where a board lies and from where it is put in."""
    x0, _, x1, y1 = plate.bounds
    return _box_on(plate, (x0 - gap, x1 + gap, -FAR_MM / 4, y1), -plate.thickness_mm, FRONT_MM)


def _wire_way(plate: Plate, box: Box, inner: float, wall: float, top: float) -> "cadquery.Workplane":
    """Groove behind a board for its soldered wires, as deep as the wall allows.

    Below the connector it is open, since an upright board is slid in from there. Nothing stands before it
    above the board, and no light of the LEDs reaches it: it lies behind them and their board.
    """
    x0, x1, y0, y1, depth = box
    low = plate.bounds[1] - BELOW_BOARD_MM if plate.upright else y0
    groove = _box_on(plate, (x0, x1, low, y1), -plate.thickness_mm - depth, -plate.thickness_mm + 0.01)
    return groove.intersect(disc(inner + max(wall - WALL_BESIDE_MM, 0.0), -FAR_MM / 8, top))
