"""Parts of a housing with seats: body, lid, camera and fasteners, fitted to the LED boards as drawn."""

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from shapely.geometry import Point
from shapely.geometry import box as rectangle

from designlab.fabrication.boards.drawn import Board
from designlab.sensor import seating
from designlab.sensor.design import Design
from geometries import camera_head, seats
from geometries.blocks import Prism
from geometries.camera_head import Mount
from geometries.leds import bodies
from geometries.mesh import solids
from geometries.seats import Plate

if TYPE_CHECKING:
    import cadquery

BOUGHT = ("camera", "screws", "inserts")
"""Parts that are bought."""
POST_MM, POST_INTO_MM = 4.0, 1.4
"""Width of what a level board rests on, and how far it reaches under the board's rim."""
MOST_POSTS = 4
WIRES_MM = 1.6
"""Depth kept free behind a connector for wires."""
BESIDE_MM = 0.4
TIP_MM = 0.5  # of material left under a screw


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
        behind = []
        for component in board.components:
            if component.kind in ("connector", "wire") or component.side == "bottom":
                x0, y0, x1, y1 = component.extent.buffer(BESIDE_MM, join_style="mitre").bounds
                behind.append((x0, x1, y0, y1, WIRES_MM))
        origin, x, y, normal = (
            (float(a), float(b), float(c)) for a, b, c in (frame.origin, frame.x, frame.y, frame.normal)
        )
        bounds = board.outline.bounds
        thickness, holes = board.thickness_mm, board.holes
        found.append(Plate(board.name, origin, x, y, normal, bounds, thickness, tuple(behind), ring, holes))
    return found


def posts(design: Design, plate: Plate) -> list[Prism]:
    """What a level board rests on: posts from the plate at its rim, where no part stands behind it.

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
    free = []
    for step in range(72):
        turn = math.radians(5.0 * step)
        angles = turn + np.linspace(-half, half, 7)
        way = np.column_stack([np.cos(angles), np.sin(angles)])
        under = np.concatenate([radius * way, (radius - POST_INTO_MM) * way[::-1]])
        on_board = (under - plate.origin[:2]) @ turned.T
        shape = rectangle(*_bounds(on_board))
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
    rests = [post for plate in found_plates if plate.ring for post in posts(design, plate)]
    length = screw_length_mm(mount, housing.top_mm)
    body = seats.body(housing, within, found_plates, rests, mount)
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
    made["camera"] = camera_head.camera_solid(mount)
    found: dict[str, cadquery.Shape] = {name: solids(work)[0] for name, work in made.items()}
    compound = cadquery.Compound.makeCompound
    if housing.seats.fastening == "insert":
        found["inserts"] = compound(camera_head.insert_solids(mount))
    found["screws"] = compound(camera_head.screw_solids(housing.seats, mount, length))
    return found
