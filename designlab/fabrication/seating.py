"""Parts of a housing with seats: body, lid, camera and fasteners, fitted to the LED boards as drawn."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from shapely.geometry import MultiPoint, Point, Polygon
from shapely.geometry import box as rectangle

from designlab.core.types import Array
from designlab.fabrication.boards.drawn import Board
from designlab.fabrication.checks import Wall, thinnest_wall
from designlab.sensor import seating
from designlab.sensor.design import Design
from designlab.sensor.feasibility import MINIMUM_WALL_MM
from geometries import camera_head, elastomer, gelcore, seats
from geometries.blocks import Prism
from geometries.camera_head import Mount
from geometries.leds import Body, bodies
from geometries.mesh import solids
from geometries.seats import GelRing, Plate, WireHole

if TYPE_CHECKING:
    import cadquery

BOUGHT = ("camera", "screws", "inserts")
"""Parts that are bought."""
PRINTED = ("housing", "lid", "core_ring", "gel_ring")
FACETS_MM = 0.02  # by which a wall between round faces seems thinner
POST_MM, POST_INTO_MM = 4.0, 1.4
"""Width of what a level board rests on, and how far it reaches under the board's rim."""
MOST_POSTS = 4
WIRES_MM = 1.6
"""Depth kept free behind a connector for wires."""
BESIDE_MM = 0.4
OFF_BOARD_MM = 0.05  # from where the way of a wire is followed
REST_MM = 0.2  # of the ring around the gel on its shoulder, at least
SMOOTH_MM = 0.005  # to which the ring around the gel follows a round outline
TIP_MM = 0.5  # of material left under a screw


WIRE_MM, WIRE_PLAY_MM = 0.6, 0.4
"""Diameter of a wire with its insulation, and what its way is wider."""
TURNS_DEG = tuple(sorted(range(-175, 181, 5), key=abs))  # tried for the hole of a level board


class SeatError(ValueError):
    """A design whose parts find no seat; names part, value and rule."""


def plates(boards: Iterable[Board]) -> list[Plate]:
    """Boards as the housing seats them.

    Raises
    ------
    SeatError
        If a board is flexible: it has no seat.
    """
    found = []
    for board in boards:
        if board.blank.kind == "flex":
            raise SeatError(
                f"housing.seats: {board.name} is a flexible board, which no seat holds; take seats away and "
                'glue it to the wall, or give leds.layout = "edge"'
            )
        frame = board.blank.frames[0]
        ring = board.blank.kind == "ring"
        behind, pads = [], []
        for component in board.components:
            if component.kind in ("connector", "wire"):
                pads += [(pad.x, pad.y) for pad in component.pads]
            if component.kind in ("connector", "wire") or component.side == "bottom":
                x0, y0, x1, y1 = component.extent.buffer(BESIDE_MM, join_style="mitre").bounds
                # Over the board's edge a groove would leave its stop as thin as the board.
                y1 = y1 if board.blank.kind == "ring" else min(y1, board.outline.bounds[3])
                behind.append((x0, x1, y0, y1, WIRES_MM))
        origin, x, y, normal = (
            (float(a), float(b), float(c)) for a, b, c in (frame.origin, frame.x, frame.y, frame.normal)
        )
        bounds = board.outline.bounds
        thickness, holes = board.thickness_mm, board.holes
        found.append(
            Plate(
                board.name, origin, x, y, normal, bounds, thickness, tuple(behind), ring, holes, tuple(pads)
            )
        )
    return found


def wire_holes(design: Design, found: Sequence[Plate]) -> dict[str, WireHole]:
    """Hole in the wall for the wires of each board, by its name; one named "" where there is no board.

    Behind an upright board the hole leads straight out. Wires of a level one rise behind it, then run
    straight to a hole under the camera plate, past collar and pegs.

    Raises
    ------
    SeatError
        If the wires of a level board find no such way.
    """
    within = seating.inside(design)
    assert within is not None
    if not found:
        return {"": seats.level_hole(design.housing, within.cable_deg)}
    holes = {}
    for plate in found:
        holes[plate.name] = _level_hole(design, plate) if plate.ring else seats.hole_behind(plate)
    return holes


def _level_hole(design: Design, plate: Plate) -> WireHole:
    """Hole for a level board at the azimuth nearest to its connector where nothing stands in the way."""
    within = seating.inside(design)
    assert within is not None
    pads = _in_plan(plate, plate.pads)
    middle = pads.mean(axis=0)
    towards = math.degrees(math.atan2(middle[1], middle[0]))
    room = [Point(*at).buffer(seats.SHOULDER_MM / 2) for at in _in_plan(plate, [h[:2] for h in plate.holes])]
    room += [Point(0.0, 0.0).buffer(0.0 if within.collar is None else within.collar.outer_mm)]
    for turn in TURNS_DEG:
        hole = seats.level_hole(design.housing, towards + turn)
        if not any(_corridor(pads, hole).intersects(other) for other in room):
            return hole
    raise SeatError(
        f"housing.seats: the wires of {plate.name} find no straight way to the wall past collar and pegs; "
        "raise housing.inner_radius_mm"
    )


def _in_plan(plate: Plate, points: Sequence[tuple[float, ...]]) -> np.ndarray:
    """Points of a board seen along the axis (mm), shape (n, 2)."""
    x, y = np.asarray(plate.x[:2]), np.asarray(plate.y[:2])
    return np.array([np.asarray(plate.origin[:2]) + a * x + b * y for a, b in points]).reshape(-1, 2)


def _corridor(pads: np.ndarray, hole: WireHole) -> Polygon:
    """What is kept free between the pads of a level board and its hole, seen along the axis."""
    half = (WIRE_MM + WIRE_PLAY_MM) / 2
    ends = [*pads, np.asarray(hole.start[:2]) + 2.0 * np.asarray(hole.way[:2])]
    return MultiPoint([Point(*end) for end in ends]).convex_hull.buffer(half)


def wire_paths(plate: Plate, hole: WireHole, outside_mm: float) -> list[Array]:
    """Way of each wire of a board, (points, 3) in mm: off its pad's back, to its hole and out of it."""
    normal, start, way = (np.asarray(v) for v in (plate.normal, hole.start, hole.way))
    across = np.array([-way[1], way[0], 0.0])
    half = (WIRE_MM + WIRE_PLAY_MM) / 2
    found = []
    for a, b in plate.pads:
        pad = np.asarray(plate.origin) + a * np.asarray(plate.x) + b * np.asarray(plate.y)
        off = pad - (plate.thickness_mm + half + OFF_BOARD_MM) * normal
        if plate.ring:
            aside = np.clip((pad - start) @ across, half - hole.width_mm / 2, hole.width_mm / 2 - half)
            above, mouth = np.array([off[0], off[1], start[2]]), start + aside * across
            points = [off, above, mouth]
        else:
            points = [off]
        points.append(points[-1] + outside_mm * way)
        found.append(np.array(points))
    return found


def gel_ring(design: Design, found: Sequence[Plate]) -> GelRing | None:
    """Ring that closes the bore around gel and core against daylight; None where nothing is open.

    It lies below boards and LEDs, beside the lower part of a flat gel or below the edge of a dome. Nearly all
    of what it stops would have left through the bore, so light is simulated without it.

    Raises
    ------
    SeatError
        If wall or boards leave it no room; names field, value and rule.
    """
    housing, gel, core = design.housing, design.elastomer, design.gelcore
    if seats.rings(design.leds):  # the core's own ring closes the bore
        return None
    assert housing.seats is not None
    gap, inner = housing.seats.gap_mm, housing.inner_radius_mm
    outline = elastomer.polygon(gel)
    around = MultiPoint([*outline, *gelcore.polygon(core)]).convex_hull
    hole = around.buffer(gap, join_style="mitre").simplify(SMOOTH_MM)
    corners = np.asarray(hole.exterior.coords)[:-1]
    widest = float(np.hypot(*corners.T).max())
    if inner - hole.exterior.distance(Point(0.0, 0.0)) < seats.OPEN_MM:
        return None
    shoulder = min(max(seats.SHOULDER_WALL_MM, gap + 2 * REST_MM), housing.wall_mm - MINIMUM_WALL_MM)
    outer = inner + shoulder - gap
    if shoulder < gap + REST_MM - 1e-9:
        raise SeatError(
            f"housing.wall_mm: {housing.wall_mm:g} mm leaves no shoulder for the ring around the gel, which "
            f"keeps daylight from the LEDs; give {MINIMUM_WALL_MM + gap + REST_MM:.3g} mm or more"
        )
    if outer - widest < MINIMUM_WALL_MM:
        raise SeatError(
            f"housing.inner_radius_mm: {inner:g} mm leaves the ring around the gel {outer - widest:.3g} mm "
            f"at the gel's corners, {MINIMUM_WALL_MM:g} mm or more must be; give "
            f"{inner + MINIMUM_WALL_MM - outer + widest:.4g} mm or more"
        )
    edge = elastomer.base_mm(gel, 0.999 * outline[:, 0], 0.999 * outline[:, 1])
    lowest = min(
        [float(body.centre_mm[2]) - _reach_down(body) for body in bodies(design.leds)]
        + [_lowest_mm(plate) - seats.BELOW_BOARD_MM for plate in found]
    )
    bottom = housing.bottom_mm
    high = min(max(bottom + seats.GEL_RING_MM, float(edge.min())), lowest - gap)
    if high - bottom < MINIMUM_WALL_MM:
        raise SeatError(
            f"housing.bottom_mm: {bottom:g} mm leaves {max(high - bottom, 0.0):.3g} mm below the LEDs for "
            f"the ring around the gel, {MINIMUM_WALL_MM:g} mm or more must be; lower "
            "housing.bottom_mm or raise leds.height_mm"
        )
    low = max(bottom, high - seats.GEL_RING_MM)
    return GelRing(outer, corners, low, high)


def _reach_down(body: Body) -> float:
    axes = np.array([body.across, body.down, body.normal])
    return float(np.abs(axes[:, 2]) @ np.asarray(body.half_mm))


def _lowest_mm(plate: Plate) -> float:
    """Height of a board's lowest corner (mm)."""
    _, y0, _, _ = plate.bounds
    return plate.origin[2] + y0 * plate.y[2] - max(0.0, plate.normal[2]) * plate.thickness_mm


def posts(design: Design, plate: Plate, hole: WireHole) -> list[Prism]:
    """What a level board rests on: posts from the plate at its rim, clear of parts and wires behind it.

    Raises
    ------
    SeatError
        If no two such places are found.
    """
    inner = design.housing.inner_radius_mm
    radius = plate.bounds[2]
    back = plate.origin[2] - plate.normal[2] * plate.thickness_mm
    taken = [rectangle(x0, y0, x1, y1) for x0, x1, y0, y1, _ in plate.behind]
    turned = np.array([plate.x[:2], plate.y[:2]])
    for body in bodies(design.leds):
        at = turned @ (np.asarray(body.centre_mm[:2]) - plate.origin[:2])
        taken.append(Point(*at).buffer(math.hypot(*body.half_mm[:2])))
    half = math.atan2(POST_MM / 2, radius)
    wires = _corridor(_in_plan(plate, plate.pads), hole)
    free = []
    for step in range(72):
        turn = math.radians(5.0 * step)
        angles = turn + np.linspace(-half, half, 7)
        way = np.column_stack([np.cos(angles), np.sin(angles)])
        under = np.concatenate([radius * way, (radius - POST_INTO_MM) * way[::-1]])
        on_board = (under - plate.origin[:2]) @ turned.T
        shape = rectangle(*_bounds(on_board))
        if wires.intersects(MultiPoint([Point(*at) for at in under]).convex_hull):
            continue
        if not any(shape.intersects(other) for other in taken):
            free.append((turn, way))
    chosen: list[tuple[float, np.ndarray]] = []
    while free and len(chosen) < MOST_POSTS:
        turn, way = max(free, key=lambda f: min((_apart(f[0], c[0]) for c in chosen), default=-f[0]))
        if min((_apart(turn, c[0]) for c in chosen), default=math.pi) < 3 * half:
            break
        chosen.append((turn, way))
    if len(chosen) < 2:
        raise SeatError(
            f"housing.seats: {plate.name} has no two free places of {POST_MM:g} mm at its rim to rest on; "
            "raise housing.inner_radius_mm"
        )
    outer = inner + seats.INTO_WALL_MM
    return [
        Prism(np.concatenate([outer * way, (radius - POST_INTO_MM) * way[::-1]]), back, design.housing.top_mm)
        for _, way in chosen
    ]


def _bounds(points: np.ndarray) -> tuple[float, float, float, float]:
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    return float(x0), float(y0), float(x1), float(y1)


def _apart(a: float, b: float) -> float:
    return abs(math.remainder(a - b, math.tau))


def screw_length_mm(mount: Mount, top_mm: float) -> float:
    """Longest screw whose tip stays inside the body.

    Raises
    ------
    SeatError
        If even the shortest does not.
    """
    room = camera_head.lid_top_mm(mount) - (top_mm + TIP_MM)
    deep = mount.fastener.insert_length_mm + 0.5
    least = camera_head.lid_top_mm(mount) - mount.seat_mm + mount.fastener.thread_mm
    fit = [length for length in mount.fastener.lengths_mm if least <= length <= min(room, least + deep)]
    if not fit:
        raise SeatError(
            f"housing.top_mm: no screw {mount.fastener.title} holds the lid and stays out of the light path: "
            f"it must be {least:.3g} to {room:.3g} mm long; lower housing.top_mm, or raise camera.position_mm"
        )
    reach = camera_head.lid_top_mm(mount) - mount.seat_mm + deep
    return max((length for length in fit if length <= reach), default=fit[0])


def walls(design: Design, shapes: "Mapping[str, cadquery.Shape]") -> dict[str, Wall]:
    """Thinnest wall of every printed part of the housing, by its name; of a plain tube as its fields say."""
    housing = design.housing
    if housing.seats is None:
        return {"housing": Wall(min(housing.wall_mm, housing.plate_mm), (0.0, 0.0, housing.bottom_mm))}
    return {name: thinnest_wall(shapes[name]) for name in PRINTED if name in shapes}


def thin_walls(found: Mapping[str, Wall]) -> list[str]:
    """What is thinner than common printers close: part, value and rule."""
    return [
        f"{name}: its thinnest wall is {wall.thickness_mm:.2g} mm, near "
        f"({', '.join(f'{c:.1f}' for c in wall.at_mm)}) mm; {MINIMUM_WALL_MM:g} mm or more must be; raise "
        "housing.wall_mm, housing.inner_radius_mm or housing.seats.collar_wall_mm, or move the LEDs"
        for name, wall in found.items()
        if wall.thickness_mm < MINIMUM_WALL_MM - FACETS_MM
    ]


def seated_parts(design: Design, boards: Sequence[Board]) -> dict[str, "cadquery.Shape"]:
    """Body, lid, camera, screws and what else a housing with seats has, in the sensor frame (mm).

    Raises
    ------
    SeatError
        If a part finds no seat; names part, value and rule.
    """
    import cadquery

    housing, within = design.housing, seating.inside(design)
    assert housing.seats is not None
    assert within is not None
    mount = seating.mount(design)
    found_plates = plates(boards)
    holes = wire_holes(design, found_plates)
    rests = [post for p in found_plates if p.ring for post in posts(design, p, holes[p.name])]
    around = gel_ring(design, found_plates)
    length = screw_length_mm(mount, housing.top_mm)
    body = seats.body(housing, within, found_plates, rests, mount, holes=holes.values(), gel_ring=around)
    if len(body.vals()) > 1:
        raise SeatError(
            f"housing.seats: the body falls into {len(body.vals())} pieces; raise housing.wall_mm or give "
            "the boards more room"
        )
    made = {"housing": body, "lid": camera_head.lid(housing, mount)}
    if seats.rings(design.leds):
        window_mm = design.elastomer.thickness_mm + design.gelcore.height_mm
        board_mm = next((plate.origin[2] for plate in found_plates if plate.ring), window_mm)
        ring = seats.core_ring(housing, design.gelcore, design.leds, window_mm=window_mm, board_mm=board_mm)
        made["core_ring"] = ring
    if around is not None:
        made["gel_ring"] = seats.gel_ring(around)
    made["camera"] = camera_head.camera_solid(mount)
    found: dict[str, cadquery.Shape] = {name: solids(work)[0] for name, work in made.items()}
    compound = cadquery.Compound.makeCompound
    if housing.seats.fastening == "insert":
        found["inserts"] = compound(camera_head.insert_solids(mount))
    found["screws"] = compound(camera_head.screw_solids(housing.seats, mount, length))
    return found
