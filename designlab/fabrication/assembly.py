"""How the parts of a housing with seats go together: what holds each, and in which order they are put in."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from designlab.core.types import Array
from designlab.fabrication.boards.drawn import Board
from designlab.fabrication.checks import FileCheck, overlap_mm3
from designlab.fabrication.parts import built_leds
from designlab.fabrication.seating import WIRE_MM, WIRE_PLAY_MM, plates, wire_holes, wire_paths
from designlab.sensor.design import Design

if TYPE_CHECKING:
    import cadquery

Vector = tuple[float, float, float]

CONTACT_MM2 = 1.0
GROWN_MM = 0.05
"""By which a part is pushed against what holds it; the volume shared then over this is their contact."""
SWEPT_MM3 = 0.5
STEP_MM = 2.0
"""Between the places at which a part is tried on its way in: less than any part is long."""
WIRED_MM3 = 0.01
TOOLS = ("mould_cavity", "mould_lid")
PROUD_MM = 3.0  # a part is out of the body when it is so far from it


class Step(NamedTuple):
    """Parts that are put in together, and the way that takes them out again (mm), stretch by stretch."""

    key: str
    parts: tuple[str, ...]
    way: tuple[Vector, ...]


def steps(design: Design, shapes: Mapping[str, "cadquery.Shape"], boards: Sequence[Board]) -> list[Step]:
    """Order in which parts go into the body, which comes first."""
    low = design.housing.bottom_mm - PROUD_MM
    found = [Step("body", ("housing",), ())]
    if "inserts" in shapes:
        found.append(Step("inserts", ("inserts",), (_up(12.0),)))
    for plate in plates(boards):
        out = max(shapes[plate.name].BoundingBox().zmax - low, 5.0)
        way: tuple[Vector, ...] = ((0.0, 0.0, -out),)
        if not plate.ring and not plate.upright:
            inward = plate.thickness_mm + 1.0
            n = plate.normal
            way = ((n[0] * inward, n[1] * inward, n[2] * inward), *way)
        found.append(Step("board", (plate.name,), way))
    gel_out = (0.0, 0.0, -max(shapes["gelcore"].BoundingBox().zmax - low, 5.0))
    if "core_ring" in shapes:
        out = shapes["core_ring"].BoundingBox().zmax - low
        found.append(Step("core_ring", ("core_ring",), ((0.0, 0.0, -out),)))
    found.append(Step("core", ("gelcore", "elastomer"), (gel_out,)))
    if "gel_ring" in shapes:
        out = shapes["gel_ring"].BoundingBox().zmax - low
        found.append(Step("gel_ring", ("gel_ring",), ((0.0, 0.0, -out),)))
    found.append(Step("camera", ("camera",), (_up(20.0),)))
    found.append(Step("lid", ("lid",), (_up(14.0),)))
    found.append(Step("screws", ("screws",), (_up(22.0),)))
    return found


def _up(distance: float) -> Vector:
    return 0.0, 0.0, distance


def check_contacts(
    design: Design, shapes: Mapping[str, "cadquery.Shape"], boards: Sequence[Board]
) -> list[FileCheck]:
    """Common area of every part with what holds it, and that all hang together."""
    up, down, aside = _up(1.0), _up(-1.0), (1.0, 0.0, 0.0)
    pairs: list[tuple[str, str, Vector]] = [("elastomer", "gelcore", up), ("gelcore", "housing", up)]
    for plate in plates(boards):
        pairs.append((plate.name, "housing", (-plate.normal[0], -plate.normal[1], -plate.normal[2])))
    if "core_ring" in shapes:
        pairs.append(("core_ring", next((p.name for p in plates(boards) if p.ring), "housing"), up))
    if "gel_ring" in shapes:
        pairs.append(("gel_ring", "housing", up))
    pairs += [("camera", "housing", down), ("lid", "housing", down), ("lid", "camera", down)]
    if "inserts" in shapes:
        pairs += [("inserts", "housing", aside), ("screws", "inserts", aside)]
    pairs.append(("screws", "lid", down))
    checks: list[FileCheck] = []
    held: dict[str, set[str]] = {}
    for part, holder, direction in pairs:
        area = contact_mm2(shapes[part], shapes[holder], direction)
        checks.append(
            FileCheck(f"{part}/{holder}", "", "contact", area, CONTACT_MM2, "mm2", area >= CONTACT_MM2)
        )
        if area >= CONTACT_MM2:
            held.setdefault(part, set()).add(holder)
    reached: set[str] = set()
    fresh = {"housing"}
    while fresh:
        reached |= fresh
        fresh = {part for part, holders in held.items() if part not in reached and holders & reached}
    loose = {part for pair in pairs for part in pair[:2]} - reached
    checks.append(FileCheck("assembly", "", "parts that nothing holds", len(loose), 0, "1", not loose))
    return checks


def check_wires(
    design: Design, shapes: Mapping[str, "cadquery.Shape"], boards: Sequence[Board]
) -> list[FileCheck]:
    """Sweep a wire with play from every pad of a board out of its hole in the wall, and see what it meets."""
    found = plates(boards)
    if not found:
        return []
    holes = wire_holes(design, found)
    housing = design.housing
    outside = math.sqrt(2.0) * 2 * (housing.inner_radius_mm + housing.wall_mm) + PROUD_MM
    solid_parts = [shapes[name] for name in shapes if name not in TOOLS]
    checks = []
    for plate in found:
        met = 0.0
        for path in wire_paths(plate, holes[plate.name], outside):
            wire = _swept(path, WIRE_MM + WIRE_PLAY_MM)
            met = max(met, sum(overlap_mm3(wire, part) for part in solid_parts))
        checks.append(
            FileCheck(f"{plate.name}/wires", "", "met on their way", met, WIRED_MM3, "mm3", met <= WIRED_MM3)
        )
    return checks


def _swept(path: Array, diameter_mm: float) -> "cadquery.Shape":
    """Cylinders along a path, with a ball at each bend."""
    import cadquery

    pieces: list[cadquery.Shape] = []
    for start, end in pairwise(path):
        along = end - start
        length = float(np.linalg.norm(along))
        if length < 1e-6:
            continue
        at, way = cadquery.Vector(*start), cadquery.Vector(*(along / length))
        pieces.append(cadquery.Solid.makeCylinder(diameter_mm / 2, length, at, way))
    for bend in path[1:-1]:
        ball = cadquery.Solid.makeSphere(diameter_mm / 2, angleDegrees1=-90, angleDegrees2=90)
        pieces.append(ball.moved(_shift(bend)))
    return cadquery.Compound.makeCompound(pieces)


def contact_mm2(part: "cadquery.Shape", holder: "cadquery.Shape", direction: Vector) -> float:
    """Area (mm2) on which a part lies when it is pushed along a direction, as seen along it."""
    pushed = part.moved(_shift([GROWN_MM * c for c in direction]))
    return max(overlap_mm3(pushed, holder) - overlap_mm3(part, holder), 0.0) / GROWN_MM


def check_order(
    design: Design,
    shapes: Mapping[str, "cadquery.Shape"],
    order: Sequence[Step],
    carried: Mapping[str, Sequence[int]],
) -> list[FileCheck]:
    """Move every part along its way in, and find the largest volume that it shares with what is there."""
    checks: list[FileCheck] = []
    there: list[cadquery.Shape] = []
    leds = shapes["led_array"].Solids()
    for step in order:
        moving = [shapes[part] for part in step.parts]
        moving += [leds[number] for part in step.parts for number in carried.get(part, ())]
        worst = 0.0
        for place in _places(step.way):
            for shape in moving:
                moved = shape.moved(_shift(place))
                worst = max(worst, *(overlap_mm3(moved, other) for other in there), 0.0)
        if step.way:
            checks.append(
                FileCheck(
                    "+".join(step.parts),
                    "",
                    "shared with others on its way in",
                    worst,
                    SWEPT_MM3,
                    "mm3",
                    worst <= SWEPT_MM3,
                )
            )
        there += moving
    return checks


def _places(way: Sequence[Vector]) -> list[Vector]:
    """Places on a way out, `STEP_MM` apart, the start left out."""
    found, start = [], np.zeros(3)
    for stretch in way:
        along = np.asarray(stretch)
        count = max(1, math.ceil(float(np.linalg.norm(along)) / STEP_MM))
        found += [(start + along * k / count) for k in range(1, count + 1)]
        start = start + along
    return [(float(x), float(y), float(z)) for x, y, z in found]


def _shift(by: Sequence[float]) -> "cadquery.Location":
    import cadquery

    return cadquery.Location(cadquery.Vector(*by))


def leds_on(boards: Sequence[Board], design: Design) -> dict[str, list[int]]:
    """Numbers of the LEDs on each board, in the order of `built_leds`; they go in with it."""
    found: dict[str, list[int]] = {}
    for number, led in enumerate(built_leds(design, boards)):
        if led.board:
            found.setdefault(led.board, []).append(number)
    return found


def print_turn(name: str, shape: "cadquery.Shape") -> Array:
    """Motion, shape (4, 4), that lays a part on the printer's bed: body and lid on their upper face."""
    # Corners are exact where a bounding box keeps a margin; all ends of these parts are level.
    heights, turn = [corner.Z for corner in shape.Vertices()], np.eye(4)
    if name in ("housing", "lid"):
        turn[1, 1] = turn[2, 2] = -1.0
        turn[2, 3] = max(heights)
    else:
        turn[2, 3] = -min(heights)
    return turn


def print_pose(name: str, shape: "cadquery.Shape") -> "cadquery.Shape":
    """Part as it lies on the printer's bed, see `print_turn`."""
    import cadquery

    turn = print_turn(name, shape)
    if turn[2, 2] < 0:
        shape = shape.rotate(cadquery.Vector(0, 0, 0), cadquery.Vector(1, 0, 0), 180)
    return shape.moved(_shift((0.0, 0.0, float(turn[2, 3]))))
