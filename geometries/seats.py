"""Seats in the housing for gelcore, LED boards and camera, and the lid over the camera.

Everything grows from the camera plate or the tube's wall, so that the body prints on its upper face without
support. What stands inside is rings and upright prisms, which light sees as they are built.
"""

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from geometries import gelcore
from geometries.gelcore import Gelcore
from geometries.housing import Housing, Seats
from geometries.leds import LedArray, bodies
from geometries.mesh import solids
from geometries.outline import reach_mm

if TYPE_CHECKING:
    import cadquery

Array = NDArray[np.float64]
Box = tuple[float, float, float, float, float]

TAB_MM, TAB_HEIGHT_MM = 5.0, 4.0
"""Width of a tab along the wall, and how far it reaches down beside the core."""
LEAST_TAB = 0.4  # of that width, where LEDs leave no more
LEDGE_MM = 1.2  # of a tab over the core's window where there is no collar
BESIDE_LEDS_MM = 2.5  # kept free beside an LED: the board's edge, and the cheek of its pocket
BESIDE_FEET_MM, LEAST_FOOT_MM, WIDEST_FOOT_DEG = 0.5, 0.5, 40.0
WIDEST_OPEN_DEG = 175.0
"""Between neighbouring feet or tabs: a core that is held on half a turn only tips or slides out."""
CHEEK_MM = 1.0  # on both sides of a board
FAR_MM = 400.0
INTO_WALL_MM = 0.3  # what grows from the wall begins inside it
BESIDE_LENS_MM = 0.3
LID_WALL_MM, LID_TOP_MM, LID_AIR_MM = 2.0, 1.6, 0.8
TONGUE_MM, TONGUE_HEIGHT_MM, GROOVE_MM = 0.8, 1.0, 1.2
RIM_MM = 1.0  # of the head around the lid
POST_MM = 4.4  # width of the lid's posts, which press the camera board down
CHAMFER_MM = 0.5
CABLE_MM = 4.0
"""Width and height of the hole for the LEDs' wires."""
CORE_RING_MM = 2.0
FRONT_MM = 4.0  # kept free before a board: LEDs and wires


class Ring(NamedTuple):
    """Tube around the axis whose lower end may rise along y, mm a mm."""

    inner_mm: float
    outer_mm: float
    low_mm: float
    high_mm: float
    slope: float = 0.0


class Prism(NamedTuple):
    """Upright prism over an outline, counter-clockwise, shape (n, 2), in mm."""

    outline: Array
    low_mm: float
    high_mm: float


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
    x to, y from, y to, depth). A ring lies about the axis, with a bore.
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

    @property
    def upright(self) -> bool:
        """Whether it stands along the axis, so that it slides into its pocket from the gel's side."""
        return abs(self.normal[2]) < 1e-6


class CameraBoard(NamedTuple):
    """A camera board about its lens axis (mm), see ``designlab/sensor/data/camera_modules.toml``.

    The board's lens side is the plane 0; `base_mm` is the width of the lens's square base, `barrel_mm` the
    diameter of what reaches beyond it, `lens_height_mm` where that ends, `pupil_mm` the height of the
    entrance pupil. Boxes are (x from, x to, y from, y to, height). `ribbon_mm` is width, thickness and height
    of the cable behind the board; it leaves towards -y.
    """

    name: str
    title: str
    number: str
    sources: tuple[str, ...]
    board_mm: tuple[float, float, float, float]
    thickness_mm: float
    holes_mm: tuple[tuple[float, float], ...]
    hole_diameter_mm: float
    base_mm: float
    base_height_mm: float
    barrel_mm: float
    lens_height_mm: float
    pupil_mm: float
    front: tuple[Box, ...]
    back: tuple[Box, ...]
    ribbon_mm: tuple[float, float, float]
    assumed: tuple[str, ...]


class Fastener(NamedTuple):
    """A screw and what it goes into (mm), see ``designlab/sensor/data/fasteners.toml``."""

    title: str
    insert_title: str
    thread_mm: float
    clearance_mm: float
    tap_mm: float
    head_mm: float
    head_height_mm: float
    insert_hole_mm: float
    insert_length_mm: float
    lengths_mm: tuple[float, ...]
    assumed: tuple[str, ...]


class Mount(NamedTuple):
    """A camera board in its place: the lens axis and the height of the board's lens side (mm)."""

    x_mm: float
    y_mm: float
    seat_mm: float
    board: CameraBoard
    fastener: Fastener


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
    housing: Housing, within: Inside, plates: Sequence[Plate], posts: Iterable[Prism], mount: Mount
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
    block = block.faces("<Z").chamfer(min(CHAMFER_MM, housing.wall_mm / 4))
    x0, x1, y0, y1 = _grown(_lid_outline(mount, gap), RIM_MM)
    head = _slab((x0, x1, y0, y1), top, mount.seat_mm).edges("|Z").fillet(2.0)
    block = block.union(head).faces(">Z").chamfer(CHAMFER_MM)
    block = block.cut(_disc(inner, low - 1, top))
    seats = [_prism(part) for part in (*within.tabs, *posts)]
    seats += [_pad(plate, gap, inner, low, top) for plate in plates if not plate.ring]
    for seat in seats:
        for plate in plates:
            if not plate.ring:
                seat = seat.cut(_kept_free(plate, gap))
        block = block.union(seat)
    for plate in plates:
        for box in plate.behind if not plate.ring else ():
            block = block.cut(_wire_way(plate, box, inner, housing.wall_mm, top))
    if within.collar is not None:
        collar = _ring(within.collar)
        for foot in within.feet:
            collar = collar.union(_prism(foot))
        block = block.union(collar)
    turn = math.radians(within.cable_deg)
    way = (math.cos(turn), math.sin(turn), 0.0)
    start = cadquery.Vector((inner - 1.0) * way[0], (inner - 1.0) * way[1], top - CABLE_MM / 2 - 0.6)
    hole = cadquery.Plane(origin=start, xDir=(0, 0, 1), normal=way)
    block = block.cut(cadquery.Workplane(hole).rect(CABLE_MM, CABLE_MM).extrude(FAR_MM / 4))
    block = _camera_seat(block, housing, mount, gap)
    return block.solids()


def _camera_seat(
    block: "cadquery.Workplane", housing: Housing, mount: Mount, gap: float
) -> "cadquery.Workplane":
    """Cut room for lens, parts, screws and the lid's tongue into the head."""
    board, seat = mount.board, mount.seat_mm
    half = board.base_mm / 2 + BESIDE_LENS_MM
    floor = seat - board.base_height_mm - BESIDE_LENS_MM
    block = block.cut(_slab(_placed((-half, half, -half, half), mount), floor, seat + 1))
    barrel = _disc(board.barrel_mm / 2 + BESIDE_LENS_MM, seat - board.lens_height_mm - BESIDE_LENS_MM, seat)
    block = block.cut(barrel.translate((mount.x_mm, mount.y_mm, 0)))
    block = block.cut(_disc(housing.camera_hole_mm / 2, housing.top_mm - 1, floor))
    for x0, x1, y0, y1, height in board.front:
        room = _grown(_placed((x0, x1, y0, y1), mount), BESIDE_LENS_MM)
        block = block.cut(_slab(room, seat - height - BESIDE_LENS_MM, seat + 1))
    assert housing.seats is not None
    diameter, depth = screw_hole_mm(housing.seats, mount)
    for x, y in screw_places(mount):
        block = block.cut(_disc(diameter / 2, seat - depth, seat + 1).translate((x, y, 0)))
    middle = _grown(_lid_outline(mount, gap), -LID_WALL_MM / 2)
    groove = _slab(_grown(middle, TONGUE_MM / 2 + gap), seat - GROOVE_MM, seat + 1)
    groove = groove.cut(_slab(_grown(middle, -TONGUE_MM / 2 - gap), seat - GROOVE_MM - 1, seat + 2))
    return block.cut(groove)


def screw_places(mount: Mount) -> list[tuple[float, float]]:
    """Axes of the screws through lid and camera board (mm)."""
    return [(mount.x_mm + x, mount.y_mm + y) for x, y in mount.board.holes_mm]


def screw_hole_mm(seats: Seats, mount: Mount) -> tuple[float, float]:
    """Diameter and depth of a hole that a screw goes into."""
    fastener = mount.fastener
    if seats.fastening == "insert":
        return fastener.insert_hole_mm, fastener.insert_length_mm + 0.5
    return fastener.tap_mm, fastener.insert_length_mm + 0.5


def lid_top_mm(mount: Mount) -> float:
    """Height of the lid's outer face."""
    tallest = max((height for *_, height in mount.board.back), default=0.0)
    return mount.seat_mm + mount.board.thickness_mm + tallest + LID_AIR_MM + LID_TOP_MM


def lid(housing: Housing, mount: Mount) -> "cadquery.Workplane":
    """Lid over the camera board: a cap with a tongue, posts around its screws and a slot for the ribbon."""
    assert housing.seats is not None
    gap, seat, board = housing.seats.gap_mm, mount.seat_mm, mount.board
    top, outline = lid_top_mm(mount), _lid_outline(mount, gap)
    cap = _slab(outline, seat, top).edges("|Z").fillet(1.5).faces(">Z").chamfer(CHAMFER_MM)
    cap = cap.cut(_slab(_grown(outline, -LID_WALL_MM), seat - 1, top - LID_TOP_MM))
    middle = _grown(outline, -LID_WALL_MM / 2)
    tongue = _slab(_grown(middle, TONGUE_MM / 2), seat - TONGUE_HEIGHT_MM, seat + 0.2)
    tongue = tongue.cut(_slab(_grown(middle, -TONGUE_MM / 2), seat - TONGUE_HEIGHT_MM - 1, seat + 1))
    cap = cap.union(tongue)
    bottom = seat + board.thickness_mm
    for x, y in screw_places(mount):
        # A post reaches into the wall beside it.
        half = POST_MM / 2
        from_x, to_x = (x - half, outline[1] - LID_WALL_MM / 2)
        if x < mount.x_mm:
            from_x, to_x = outline[0] + LID_WALL_MM / 2, x + half
        cap = cap.union(_slab((from_x, to_x, y - half, y + half), bottom, top - LID_TOP_MM / 2))
    for x, y in screw_places(mount):
        cap = cap.cut(_disc(mount.fastener.clearance_mm / 2, seat - 1, top + 1).translate((x, y, 0)))
    width, thickness, height = board.ribbon_mm
    high = bottom + height + thickness / 2 + gap
    slot = (
        mount.x_mm - width / 2 - gap,
        mount.x_mm + width / 2 + gap,
        outline[2] - 1,
        outline[2] + LID_WALL_MM + 0.5,
    )
    # Open at the joint: the ribbon is laid in before the lid comes down.
    return cap.cut(_slab(slot, seat - TONGUE_HEIGHT_MM - 1, high)).solids()


def core_ring(
    housing: Housing, core: Gelcore, leds: LedArray, *, window_mm: float, board_mm: float
) -> "cadquery.Workplane":
    """Ring that centres the core under a level LED board, put in after it and before the core.

    Outside the LEDs it rises to the board's front, at the height `board_mm`.
    """
    import cadquery

    assert housing.seats is not None
    gap, outer = housing.seats.gap_mm, housing.inner_radius_mm - housing.seats.gap_mm
    low = window_mm - min(CORE_RING_MM, 0.6 * gelcore.side_height_mm(core))
    reach = max(float(np.hypot(*body.centre_mm[:2])) + math.hypot(*body.half_mm[:2]) for body in bodies(leds))
    upper = _disc(outer, low, board_mm).cut(
        _disc(min(reach + BESIDE_LENS_MM, outer - 0.8), low - 1, board_mm + 1)
    )
    ring = _disc(outer, low, window_mm)
    gap += max(core.side_bulge_mm or 0.0, 0.0)
    if core.shape == "dome":
        return upper.union(ring.cut(_disc(core.width_mm / 2 + gap, low - 1, window_mm + 1))).solids()
    beside = gelcore.polygon_at(core, max(low - window_mm + core.height_mm, 0.0))
    angles = np.linspace(-np.pi, np.pi, 360, endpoint=False)
    angles = np.unique(np.concatenate([angles, np.arctan2(beside[:, 1], beside[:, 0])]))
    way = np.column_stack([np.cos(angles), np.sin(angles)])
    hole = way * reach_mm(beside, way, grown_mm=gap)[:, None]
    plane = cadquery.Workplane("XY", origin=(0, 0, low - 1))
    return upper.union(ring.cut(plane.polyline(hole.tolist()).close().extrude(window_mm - low + 2))).solids()


def camera_solid(mount: Mount) -> "cadquery.Workplane":
    """Camera board at its place: board with holes, lens, and the boxes on both sides."""
    board, seat = mount.board, mount.seat_mm
    back = seat + board.thickness_mm
    work = _slab(_placed(board.board_mm, mount), seat, back)
    half = board.base_mm / 2
    work = work.union(_slab(_placed((-half, half, -half, half), mount), seat - board.base_height_mm, seat))
    barrel = _disc(board.barrel_mm / 2, seat - board.lens_height_mm, seat)
    work = work.union(barrel.translate((mount.x_mm, mount.y_mm, 0)))
    for x0, x1, y0, y1, height in board.front:
        work = work.union(_slab(_placed((x0, x1, y0, y1), mount), seat - height, seat))
    for x0, x1, y0, y1, height in board.back:
        work = work.union(_slab(_placed((x0, x1, y0, y1), mount), back, back + height))
    for x, y in screw_places(mount):
        work = work.cut(_disc(board.hole_diameter_mm / 2, seat - 1, back + 1).translate((x, y, 0)))
    return work.solids()


def screw_solids(seats: Seats, mount: Mount, length_mm: float) -> "list[cadquery.Solid]":
    """Screws at their places: cap heads on the lid, shanks as thick as what they go into is drawn."""
    fastener, top = mount.fastener, lid_top_mm(mount)
    shank = fastener.thread_mm if seats.fastening == "insert" else fastener.tap_mm
    found: list[cadquery.Solid] = []
    for x, y in screw_places(mount):
        screw = _disc(fastener.head_mm / 2, top, top + fastener.head_height_mm)
        screw = screw.union(_disc(shank / 2, top - length_mm, top))
        found += solids(screw.translate((x, y, 0)))
    return found


def insert_solids(mount: Mount) -> "list[cadquery.Solid]":
    """Threaded inserts at their places, as wide as their holes: they are melted in."""
    fastener, seat = mount.fastener, mount.seat_mm
    found: list[cadquery.Solid] = []
    for x, y in screw_places(mount):
        insert = _disc(fastener.insert_hole_mm / 2, seat - fastener.insert_length_mm, seat)
        insert = insert.cut(_disc(fastener.thread_mm / 2, seat - fastener.insert_length_mm - 1, seat + 1))
        found += solids(insert.translate((x, y, 0)))
    return found


def _lid_outline(mount: Mount, gap: float) -> tuple[float, float, float, float]:
    """Outside of the lid: around the camera board, with room for its gap and the lid's wall."""
    return _grown(_placed(mount.board.board_mm, mount), gap + LID_WALL_MM)


def _placed(box: tuple[float, float, float, float], mount: Mount) -> tuple[float, float, float, float]:
    """A rectangle (x from, x to, y from, y to) about the lens axis in the sensor frame."""
    return box[0] + mount.x_mm, box[1] + mount.x_mm, box[2] + mount.y_mm, box[3] + mount.y_mm


def _grown(box: tuple[float, float, float, float], by_mm: float) -> tuple[float, float, float, float]:
    return box[0] - by_mm, box[1] + by_mm, box[2] - by_mm, box[3] + by_mm


def _slab(box: tuple[float, float, float, float], low_mm: float, high_mm: float) -> "cadquery.Workplane":
    import cadquery

    x0, x1, y0, y1 = box
    plane = cadquery.Workplane("XY", origin=((x0 + x1) / 2, (y0 + y1) / 2, low_mm))
    return plane.rect(x1 - x0, y1 - y0).extrude(high_mm - low_mm)


def _disc(radius_mm: float, low_mm: float, high_mm: float) -> "cadquery.Workplane":
    import cadquery

    return cadquery.Workplane("XY", origin=(0, 0, low_mm)).circle(radius_mm).extrude(high_mm - low_mm)


def _prism(part: Prism) -> "cadquery.Workplane":
    import cadquery

    plane = cadquery.Workplane("XY", origin=(0, 0, part.low_mm))
    return plane.polyline(part.outline.tolist()).close().extrude(part.high_mm - part.low_mm)


def _ring(part: Ring) -> "cadquery.Workplane":
    import cadquery

    lowest = part.low_mm - abs(part.slope) * part.outer_mm
    work = _disc(part.outer_mm, lowest, part.high_mm).cut(_disc(part.inner_mm, lowest - 1, part.high_mm + 1))
    if part.slope:
        reach, rise = 2 * part.outer_mm, 2 * part.outer_mm * part.slope
        corners = [(-reach, lowest - 9), (reach, lowest - 9)]
        corners += [(reach, part.low_mm + rise), (-reach, part.low_mm - rise)]
        below = cadquery.Workplane("YZ").polyline(corners).close().extrude(reach, both=True)
        work = work.cut(below)
    return work


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
    seat = _box_on(plate, (*wide, y0 - 0.2, FAR_MM / 4), -FAR_MM / 8, 0.0)
    seat = seat.intersect(_disc(inner + INTO_WALL_MM, low, top))
    # Over a board that leans inwards the stop rises straight.
    edge = np.asarray(plate.origin) + y1 * np.asarray(plate.y)
    return seat.cut(_disc(float(np.hypot(*edge[:2])), edge[2], top + 1)) if not plate.upright else seat


def _kept_free(plate: Plate, gap: float) -> "cadquery.Workplane":
    """Where a board lies and from where it is put in."""
    x0, _, x1, y1 = plate.bounds
    return _box_on(plate, (x0 - gap, x1 + gap, -FAR_MM / 4, y1), -plate.thickness_mm, FRONT_MM)


def _wire_way(plate: Plate, box: Box, inner: float, wall: float, top: float) -> "cadquery.Workplane":
    """Groove behind a board from its connector up to the plate, as deep as the wall allows."""
    x0, x1, y0, _, depth = box
    groove = _box_on(plate, (x0, x1, y0, FAR_MM / 4), -plate.thickness_mm - depth, -plate.thickness_mm + 0.01)
    return groove.intersect(_disc(inner + max(wall - 1.2, 0.0), -FAR_MM / 8, top))
