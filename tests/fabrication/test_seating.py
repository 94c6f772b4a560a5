"""Housings with seats: every part is held, goes in along its way, and is named in bill and guide."""

import csv
import json
import math
import re
import shlex
import tomllib
from collections import Counter
from itertools import combinations
from pathlib import Path
from typing import Any

import cadquery
import numpy as np
import pytest
from OCP.BRepAdaptor import BRepAdaptor_Surface
from shapely.geometry import MultiPoint, Polygon

from designlab.app import cli
from designlab.app.cli import arguments
from designlab.fabrication import Built, assembly, boards, export
from designlab.fabrication.boards import Board, orders
from designlab.fabrication.boards.files import bill_row
from designlab.fabrication.boards.orders import solid
from designlab.fabrication.checks import Wall, overlap_mm3, thinnest_wall
from designlab.fabrication.parts import built_leds, parts
from designlab.fabrication.seating import (
    SeatError,
    gel_ring,
    plates,
    screw_length_mm,
    thin_walls,
    walls,
    wire_holes,
    wire_paths,
)
from designlab.fabrication.tables import bill, gel_to_buy, mixed_masses, numbered
from designlab.fabrication.triangles import THINNING_MM, read
from designlab.report import build_guide
from designlab.sensor import seating
from designlab.sensor.design import Design, dumps, load, preset
from designlab.sensor.refraction import apparent_distance_mm
from geometries import camera_head, elastomer, gelcore
from geometries.blocks import ring
from geometries.leds import bodies
from geometries.mesh import from_solid

SEATED = ("default", "gelsight-mini-like", "gelsight-2020-dome-core-elastic", "pbr-fingertip-like")
Shapes = dict[str, cadquery.Shape]


@pytest.fixture(scope="module", params=SEATED)
def sensor(request: pytest.FixtureRequest) -> tuple[Design, tuple[Board, ...], Shapes]:
    """A seated preset, its boards, and the solids of all its parts."""
    design = preset(request.param)
    made = boards.boards(design).boards
    shapes = parts(design, boards=made) | {board.name: solid(board) for board in made}
    return design, made, shapes


@pytest.mark.slow
def test_every_part_is_held_and_all_hang_together(sensor: Any) -> None:
    design, made, shapes = sensor
    checks = assembly.check_contacts(design, shapes, made)
    assert [check for check in checks if not check.ok] == []
    held = {check.part.split("/")[0] for check in checks}
    assert {name for name in shapes if "mould" not in name} - held == {"housing", "led_array"}


@pytest.mark.slow
def test_every_part_goes_in_along_its_way_and_nothing_overlaps(sensor: Any) -> None:
    design, made, shapes = sensor
    order = assembly.steps(design, shapes, made)
    carried = assembly.leds_on(made, design)
    assert sorted(n for numbers in carried.values() for n in numbers) == list(
        range(len(shapes["led_array"].Solids()))
    )
    checks = assembly.check_order(design, shapes, order, carried)
    assert [check for check in checks if not check.ok] == []
    names = [name for name in shapes if "mould" not in name]
    for first, second in combinations(names, 2):
        assert overlap_mm3(shapes[first], shapes[second]) < 0.1, (first, second)


# ---------------------------------------------------------------- the solids against the design's numbers


def volume_between(low: Any, high: Any, radius_mm: float) -> float:
    """Volume between two heights over the distance from the axis, by the trapezium rule (mm3)."""
    r = radius_mm * np.sin(np.linspace(0, np.pi / 2, 4001))  # dense at the rim, where spheres are steep
    return float(np.trapezoid(2 * np.pi * r * (high(r) - low(r)), r))


def volumes_by_hand(design: Design) -> tuple[float, float]:
    """Volumes of gelcore and gel by their formulas (mm3)."""
    core, gel = design.gelcore, design.elastomer
    area = {"hexagonal": math.sqrt(3) / 2 * core.width_mm**2, "slab": core.width_mm * core.length_mm}
    if core.radius_mm is None or gel.radius_mm is None:
        return area[core.shape] * core.height_mm, area[core.shape] * gel.thickness_mm
    inner, outer = gel.radius_mm - gel.thickness_mm, gel.radius_mm

    def sphere(radius: float) -> Any:
        return lambda r: outer - np.sqrt(np.maximum(radius**2 - r**2, 0.0))

    hollow = 2 / 3 * np.pi * core.cavity[0] ** 2 * core.cavity[1] if core.cavity else 0.0
    top = gel.thickness_mm + core.height_mm
    solid_core = volume_between(sphere(core.radius_mm), lambda r: top + 0 * r, core.width_mm / 2)
    return solid_core - hollow, volume_between(sphere(outer), sphere(inner), gel.width_mm / 2)


@pytest.mark.slow
def test_core_and_gel_have_the_volumes_of_their_formulas(sensor: Any) -> None:
    design, _, shapes = sensor
    core, gel = volumes_by_hand(design)
    assert shapes["gelcore"].Volume() == pytest.approx(core, rel=1e-4)
    assert shapes["elastomer"].Volume() == pytest.approx(gel, rel=1e-4)


def cylinders(shape: Any) -> list[tuple[float, float, float]]:
    """Upright cylinders of a solid: x and y of the axis, radius (mm)."""
    found = []
    for face in shape.Faces():
        if face.geomType() == "CYLINDER":
            cylinder = BRepAdaptor_Surface(face.wrapped).Cylinder()
            axis = cylinder.Axis()
            if abs(axis.Direction().Z()) > 1 - 1e-9:
                found.append((axis.Location().X(), axis.Location().Y(), cylinder.Radius()))
    return found


@pytest.mark.slow
def test_holes_and_seats_of_the_body_are_where_the_design_has_them(sensor: Any) -> None:
    design, _, shapes = sensor
    housing, mount, found = design.housing, seating.mount(design), cylinders(shapes["housing"])

    def has(x: float, y: float, radius: float) -> bool:
        return any(math.dist(each, (x, y, radius)) < 1e-4 for each in found)

    hole_mm, depth_mm = camera_head.screw_hole_mm(housing.seats, mount)
    assert (hole_mm, depth_mm) == (3.2, 4.5)  # of the insert, and half a millimetre under it
    x_c, y_c, z_c = design.camera.position_mm
    for x, y in mount.board.holes_mm:
        assert has(x_c + x, y_c + y, hole_mm / 2)
    assert has(0, 0, housing.inner_radius_mm)
    assert has(0, 0, design.gelcore.window_diameter_mm / 2)  # the collar's bore
    assert has(0, 0, housing.camera_hole_mm / 2)
    box = shapes["housing"].BoundingBox(0.001)
    assert (box.zmin, box.zmax) == pytest.approx((housing.bottom_mm, z_c + mount.board.pupil_mm), abs=2e-3)
    lid, camera = cylinders(shapes["lid"]), shapes["camera"].BoundingBox(0.001)
    for x, y in mount.board.holes_mm:
        assert any(math.dist(c, (x_c + x, y_c + y, mount.fastener.clearance_mm / 2)) < 1e-4 for c in lid)
    assert camera.zmin == pytest.approx(z_c + mount.board.pupil_mm - mount.board.lens_height_mm, abs=2e-3)


# ---------------------------------------------------------------- LEDs after assembly


def flat_faces(shape: Any) -> list[tuple[np.ndarray, np.ndarray]]:
    """Plane faces of a solid: normal out of the material, and middle (mm)."""
    found = []
    for face in shape.Faces():
        if face.geomType() == "PLANE":
            normal = face.normalAt()
            found.append((np.array(normal.toTuple()), np.array(face.Center().toTuple())))
    return found


def against(faces: Any, normal: np.ndarray, at: np.ndarray, within_mm: float) -> tuple[np.ndarray, float]:
    """Of the faces that look along a normal, the nearest to a point along it: its normal and distance."""
    near = [
        (abs(float((middle - at) @ normal)), found, float((middle - at) @ normal))
        for found, middle in faces
        if found @ normal > math.cos(math.radians(2.0)) and np.linalg.norm(middle - at) < within_mm
    ]
    assert near, f"no face looks along {normal} near {at}"
    _, found, away = min(near, key=lambda each: each[0])
    return found, away


def seat_of(board: Board, body: Any) -> tuple[np.ndarray, np.ndarray, float]:
    """Where the body holds a strip: its middle, its axes in columns, and half the play along it (mm).

    Read off the body's faces alone: floor behind it, stop over it, cheeks beside it.
    """
    (plate,) = plates([board])
    x, y, n = (np.array(axis) for axis in (plate.x, plate.y, plate.normal))
    origin, (x0, y0, x1, y1), faces = np.array(plate.origin), plate.bounds, flat_faces(body)
    reach = 1.5 * math.hypot(x1 - x0, y1 - y0)
    middle = origin + (x0 + x1) / 2 * x + (y0 + y1) / 2 * y
    floor, deep = against(faces, n, middle - plate.thickness_mm * n, reach)
    stop, over = against(faces, -y, middle + (y1 - y0) / 2 * y, reach)
    _, left = against(faces, x, middle + (x0 - x1) / 2 * x, reach)
    _, right = against(faces, -x, middle + (x1 - x0) / 2 * x, reach)
    up = -stop - (-stop @ floor) * floor
    up /= np.linalg.norm(up)
    axes = np.column_stack([np.cross(up, floor), up, floor])
    # Distances count along the faces' normals: stop downwards, right cheek to the left.
    return origin + deep * n - over * y + (left - right) / 2 * x, axes, -(left + right) / 2


@pytest.mark.slow
def test_leds_are_in_their_place_after_assembly(sensor: Any) -> None:
    """Place on the board from its placement file, place of the board from the body's own faces."""
    design, made, shapes = sensor
    gap = design.housing.seats.gap_mm
    fronts: dict[int, list[np.ndarray]] = {}
    drawn = bodies(design.leds)
    for board in made:
        if board.blank.kind == "ring":
            origin, axes = ring_seat(board, shapes["housing"])
        else:
            origin, axes, play = seat_of(board, shapes["housing"])
            assert play == pytest.approx(gap, abs=1e-3)
        rows = {row["Designator"]: row for row in orders.placement_rows(board)}
        for number, place in enumerate(board.blank.places, start=1):
            row = rows[f"D{number}"]
            at = origin + axes @ np.array([row["Mid X"], row["Mid Y"], board.blank.led_mm])
            fronts.setdefault(place.body, []).append(at)
            tilt = math.degrees(math.acos(min(1.0, float(axes[:, 2] @ drawn[place.body].normal))))
            assert tilt < 0.5
    assert sorted(fronts) == list(range(len(drawn)))
    for number, places in fronts.items():
        body = drawn[number]
        front = np.asarray(body.centre_mm) + body.half_mm[2] * np.asarray(body.normal)
        if design.leds.package == "panel":
            spans = design.leds.emitting_spans_mm
            front = front + np.mean(spans) * np.asarray(body.down)
        assert np.linalg.norm(np.mean(places, axis=0) - front) < 0.05
        assert abs(np.mean(places, axis=0)[2] - front[2]) < 0.05


def ring_seat(board: Board, body: Any) -> tuple[np.ndarray, np.ndarray]:
    """Where the body holds a ring: the height of what it rests on, and its turn by the pegs in its holes."""
    (plate,) = plates([board])
    n, origin = np.array(plate.normal), np.array(plate.origin)
    rests = [c for normal, c in flat_faces(body) if normal @ n > 1 - 1e-6]
    rests = [c for c in rests if abs(float((c - origin) @ n) + plate.thickness_mm) < 0.05]
    assert len(rests) >= 3
    pegs = [c for c in cylinders(body) if c[2] == pytest.approx(0.8)]
    frame, turns = np.column_stack([plate.x, plate.y, plate.normal]), []
    assert len(board.holes) >= 2
    for x, y, diameter in board.holes:
        hole = origin + frame @ np.array([x, y, 0.0])
        peg = min(pegs, key=lambda c: math.dist(c[:2], hole[:2]))
        assert math.dist(peg[:2], hole[:2]) < 0.05
        assert diameter - 2 * peg[2] == pytest.approx(0.2)
        turns.append(math.atan2(peg[1], peg[0]) - math.atan2(hole[1], hole[0]))
        # Play of a peg in its hole turns the board by less than half a degree.
        assert math.degrees(0.1 / math.hypot(*hole[:2])) < 0.5
    turn = float(np.mean(turns))
    turned = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]])
    height = np.mean([c[2] for c in rests]) + n[2] * plate.thickness_mm
    return np.array([0.0, 0.0, height]), turned @ frame


# ---------------------------------------------------------------- wires


@pytest.mark.slow
def test_every_wire_passes_from_its_pad_out_of_the_housing(sensor: Any) -> None:
    design, made, shapes = sensor
    checks = assembly.check_wires(design, shapes, made)
    assert [check.part for check in checks] == [f"{board.name}/wires" for board in made]
    assert [check for check in checks if not check.ok] == []
    # By rays alone: straight from each pad's back no wall is met, or of a level board only the plate above.
    found = plates(made)
    holes = wire_holes(design, found)
    body = from_solid(cadquery.Workplane().newObject(shapes["housing"].Solids()), tolerance_mm=0.02)
    for plate in found:
        for path in wire_paths(plate, holes[plate.name], 60.0):
            assert float(np.hypot(*path[-1][:2])) > design.housing.inner_radius_mm + design.housing.wall_mm
            starts, ways = path[:-1], np.diff(path, axis=0)
            hits, rays, _ = body.ray.intersects_location(starts, ways)
            lengths = np.linalg.norm(ways, axis=1)
            assert not any(
                np.linalg.norm(h - starts[r]) < lengths[r] for h, r in zip(hits, rays, strict=True)
            )


@pytest.mark.slow
def test_no_hole_for_wires_opens_into_the_camera_s_view(sensor: Any) -> None:
    """The collar between camera and window is whole: all of its wall is in the housing."""
    design, _, shapes = sensor
    within = seating.inside(design)
    assert within is not None
    assert within.collar is not None
    wall = ring(within.collar).val()
    assert overlap_mm3(wall, shapes["housing"]) == pytest.approx(wall.Volume(), rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("away_mm", [1.0, 3.0, 6.0])
def test_what_stands_in_the_way_of_a_wire_is_found(away_mm: float) -> None:
    design = preset("default")
    made = boards.boards(design).boards
    shapes = parts(design, boards=made) | {board.name: solid(board) for board in made}
    hole = wire_holes(design, plates(made))["board_green"]
    at = np.array(hole.start) + away_mm * np.array(hole.way)
    plug = cadquery.Workplane("XY", origin=tuple(at)).sphere(1.8).val()
    shapes["housing"] = cadquery.Compound.makeCompound([shapes["housing"], plug])
    failed = {check.part for check in assembly.check_wires(design, shapes, made) if not check.ok}
    assert failed == {"board_green/wires"}


# ---------------------------------------------------------------- walls, and the ring around the gel


@pytest.mark.parametrize(("inner_mm", "outer_mm"), [(5.0, 5.6), (8.0, 9.2), (10.0, 12.5)])
def test_the_thinnest_wall_of_a_tube_is_its_own(inner_mm: float, outer_mm: float) -> None:
    tube = cadquery.Workplane("XY").circle(outer_mm).circle(inner_mm).extrude(20)
    wall = thinnest_wall(tube.val())
    assert wall.thickness_mm == pytest.approx(outer_mm - inner_mm, abs=0.03)
    assert inner_mm - 0.03 < math.hypot(*wall.at_mm[:2]) < outer_mm + 0.03


@pytest.mark.parametrize("floor_mm", [0.4, 0.9, 1.7])
def test_a_thin_floor_is_a_wall_and_a_chamfer_is_none(floor_mm: float) -> None:
    block = cadquery.Workplane("XY").box(20, 20, 10, centered=(True, True, False)).faces(">Z").chamfer(1.0)
    pit = cadquery.Workplane("XY", origin=(0, 0, floor_mm)).rect(6, 6).extrude(20)
    assert thinnest_wall(block.cut(pit).val()).thickness_mm == pytest.approx(floor_mm, abs=1e-3)


@pytest.mark.slow
def test_every_wall_of_the_printed_parts_closes_in_common_printers(sensor: Any) -> None:
    design, _, shapes = sensor
    found = walls(design, shapes)
    assert {"housing", "lid"} <= set(found)
    assert thin_walls(found) == []
    assert min(wall.thickness_mm for wall in found.values()) > 0.78
    # No wall is thinner than what is told of its part, as horizontal sections of it show.
    mesh = from_solid(cadquery.Workplane().newObject(shapes["housing"].Solids()), tolerance_mm=0.02)
    thinner = (found["housing"].thickness_mm - 0.06) / 2
    for height in np.linspace(design.housing.bottom_mm + 0.4, design.housing.top_mm - 0.4, 9):
        cut = mesh.section(plane_origin=[0, 0, height], plane_normal=[0, 0, 1])
        onto = np.eye(4)
        onto[2, 3] = -height
        flat, _ = cut.to_2D(to_2D=onto)
        for shape in flat.polygons_full:
            lost = shape.difference(shape.buffer(-thinner).buffer(thinner * 1.02, quad_segs=16))
            # What is lost at corners is small and thin; a lost wall would be as wide as its thickness.
            assert lost.buffer(-0.45 * thinner).area < 0.05


@pytest.mark.faults
@pytest.mark.parametrize(("part", "thickness_mm"), [("housing", 0.59), ("lid", 0.7), ("gel_ring", 0.3)])
def test_a_wall_too_thin_is_told_by_part_value_and_rule(part: str, thickness_mm: float) -> None:
    found = {part: Wall(thickness_mm, (1.0, 2.0, 3.0)), "other": Wall(0.8, (0.0, 0.0, 0.0))}
    (said,) = thin_walls(found)
    assert said.startswith(
        f"{part}: its thinnest wall is {thickness_mm:g} mm, near (1.0, 2.0, 3.0) mm; 0.8 mm or more"
    )
    assert "housing.wall_mm" in said


@pytest.mark.faults
@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"housing.wall_mm": 1.0}, ["housing.wall_mm", "1 mm", "1.2 mm or more"]),
        ({"housing.bottom_mm": 3.4}, ["housing.bottom_mm", "3.4 mm", "0.8 mm or more must be"]),
        ({"housing.bottom_mm": 3.1, "leds.height_mm": 5.8}, ["housing.bottom_mm", "3.1 mm"]),
    ],
)
def test_a_ring_around_the_gel_without_room_is_refused(changes: dict[str, Any], named: list[str]) -> None:
    design = preset("default").replace(changes)
    with pytest.raises(SeatError) as refused:
        gel_ring(design, plates(boards.boards(design).boards))
    assert all(word in str(refused.value) for word in named), refused.value


@pytest.mark.faults
@pytest.mark.parametrize(("inner_mm", "wall_mm"), [(15.5, 1.2), (15.6, 1.3), (15.2, 1.5)])
def test_a_ring_too_thin_at_the_gel_s_corners_is_refused(inner_mm: float, wall_mm: float) -> None:
    design = preset("default").replace({"housing.inner_radius_mm": inner_mm, "housing.wall_mm": wall_mm})
    with pytest.raises(
        SeatError, match=r"housing\.inner_radius_mm: .* 0\.8 mm or more must be; give"
    ) as refused:
        gel_ring(design, [])
    enough = float(str(refused.value).split("give ")[1].split(" mm")[0]) + 0.01
    assert gel_ring(design.replace({"housing.inner_radius_mm": enough}), []) is not None


@pytest.mark.parametrize("name", SEATED[:3])
def test_the_ring_closes_the_bore_around_the_gel_and_lies_below_the_light(name: str) -> None:
    design = preset(name)
    made, housing = boards.boards(design).boards, design.housing
    assert housing.seats is not None
    gap = housing.seats.gap_mm
    found = gel_ring(design, plates(made))
    assert found is not None
    gel = MultiPoint([*elastomer.polygon(design.elastomer), *gelcore.polygon(design.gelcore)]).convex_hull
    hole = Polygon(found.hole)
    assert hole.contains(gel)
    assert hole.hausdorff_distance(gel) < 1.5 * gap  # all that is open is the gap
    assert found.outer_mm > housing.inner_radius_mm
    assert found.outer_mm + gap <= housing.inner_radius_mm + housing.wall_mm - 0.8 + 1e-9
    assert found.high_mm - found.low_mm >= 0.8
    lowest = min(body.centre_mm[2] - max(body.half_mm) for body in bodies(design.leds))
    assert housing.bottom_mm <= found.low_mm < found.high_mm < lowest
    # It is no higher than where gel and core begin, or lies beside the gel alone.
    assert found.high_mm <= max(design.elastomer.thickness_mm, 4.0)


def test_under_a_ring_of_leds_the_core_s_own_ring_closes_the_bore() -> None:
    design = preset("pbr-fingertip-like")
    assert gel_ring(design, plates(boards.boards(design).boards)) is None


@pytest.mark.slow
@pytest.mark.parametrize("part", ["gelcore", "camera", "lid"])
def test_a_part_away_from_its_seat_is_found(part: str) -> None:
    design = preset("default")
    shapes = parts(design)
    shapes[part] = shapes[part].moved(
        cadquery.Location(cadquery.Vector(0, 0, -0.3 if part == "gelcore" else 0.3))
    )
    failed = {check.part for check in assembly.check_contacts(design, shapes, ()) if not check.ok}
    assert f"{part}/housing" in failed


@pytest.mark.slow
@pytest.mark.parametrize("part", ["gelcore", "camera", "lid"])
def test_what_stands_in_the_way_of_a_part_is_found(part: str) -> None:
    design = preset("default")
    shapes = parts(design)
    far = {"gelcore": -6.0, "camera": 12.0, "lid": 12.0}[part]
    box = shapes[part].BoundingBox()
    z = (box.zmin if far < 0 else box.zmax) + far / 2
    obstacle = cadquery.Workplane("XY", origin=(0, 0, z)).box(3, 3, 1).val()
    shapes["housing"] = cadquery.Compound.makeCompound([shapes["housing"], obstacle])
    order = assembly.steps(design, shapes, ())
    failed = [check.part for check in assembly.check_order(design, shapes, order, {}) if not check.ok]
    assert any(part in name for name in failed)


@pytest.mark.parametrize(("area", "size"), [(4.0, (2.0, 2.0)), (0.5, (0.5, 1.0)), (30.0, (5.0, 6.0))])
def test_contact_is_the_area_on_which_a_part_lies(area: float, size: tuple[float, float]) -> None:
    floor = cadquery.Workplane("XY").box(20, 20, 2, centered=(True, True, False)).val()
    part = cadquery.Workplane("XY", origin=(0, 0, 2)).rect(*size).extrude(3).val()
    assert assembly.contact_mm2(part, floor, (0.0, 0.0, -1.0)) == pytest.approx(area, rel=1e-6)
    apart = part.moved(cadquery.Location(cadquery.Vector(0, 0, 0.1)))
    assert assembly.contact_mm2(apart, floor, (0.0, 0.0, -1.0)) == 0


@pytest.mark.parametrize("name", SEATED)
def test_screws_end_inside_the_body(name: str) -> None:
    design = preset(name)
    mount = seating.mount(design)
    length = screw_length_mm(mount, design.housing.top_mm)
    tip = camera_head.lid_top_mm(mount) - length
    assert design.housing.top_mm < tip < mount.seat_mm - 2


@pytest.mark.faults
@pytest.mark.parametrize("below_mm", [1.5, 2.0, 2.4])
def test_a_screw_that_would_come_through_into_the_light_is_refused(below_mm: float) -> None:
    mount = seating.mount(preset("default"))
    with pytest.raises(SeatError, match=r"housing\.top_mm: no screw .* out of the light path"):
        screw_length_mm(mount, mount.seat_mm - below_mm)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An export of the default preset with its guide, without pictures, and what it was built of."""
    out = tmp_path_factory.mktemp("seated") / "out"

    def described(built: Built, inside: Path) -> list[str]:
        found = build_guide.chapters(built, drawn=False)
        steps = next(chapter.steps for chapter in found if chapter.steps)
        (inside / "guide.json").write_text(json.dumps([step._asdict() for step in steps]))
        return []

    export(preset("default"), out, describe=described, probes=["sphere:4"])
    return out


def built_of(sensor: Any) -> Built:
    """What an export would have built of a sensor."""
    design, made, shapes = sensor
    whole = boards.boards(design)
    own = {name: shape for name, shape in shapes.items() if not name.startswith("board")}
    bought = numbered([*bill(design, own, whole), *map(bill_row, made)])
    order, carried = assembly.steps(design, shapes, made), assembly.leds_on(made, design)
    told = {"bom": bought, "drive": [channel.told() for channel in whole.channels]}
    return Built(design, shapes, built_leds(design, made), order, carried, whole, told)


def all_text(found: Any) -> list[str]:
    """Every sentence, table cell and caption of a guide."""
    texts = [line for chapter in found for line in chapter.text]
    texts += [str(cell) for chapter in found for row in chapter.rows for cell in (*row, *row.values())]
    texts += [caption for chapter in found for _, caption in chapter.pictures]
    for step in (step for chapter in found for step in chapter.steps):
        texts += [step.title, *step.text, *(caption for _, caption in step.pictures)]
    return texts


@pytest.mark.slow
def test_commands_of_the_guide_run_on_what_init_makes(
    sensor: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = build_guide.chapters(built_of(sensor), drawn=False)
    quoted = [text for line in all_text(found) for text in re.findall(r"`(designlab [^`]+)`", line)]
    commands = [shlex.split(text)[1:] for text in quoted if " " in text[10:]]
    assert [command[0] for command in commands] == ["init", "import", "compare", "calibrate", "calibrate"]
    monkeypatch.chdir(tmp_path)
    assert cli.main(commands[0]) == 0
    assert f"--preset {sensor[0].name}" in " ".join(commands[0])
    (tmp_path / "sensor" / "design.toml").write_text(dumps(sensor[0]), encoding="utf-8")
    template = tmp_path / "sensor" / "measurement" / "measurement.toml"
    assert load(tmp_path / "sensor" / "design.toml").digest == sensor[0].digest
    there = {"sensor/design.toml", "sensor/measurement"}
    assert all((tmp_path / path).exists() for path in there)
    for command in commands[1:]:
        args = vars(arguments.parser().parse_args(command))
        used = {text for text in command if text.startswith("sensor/")}
        assert used - {args["out"]} <= there, command
        there |= {args["out"]}
    # The files that are named exist, and the pictures that are asked for are those of the template.
    named = {path for line in all_text(found) for path in re.findall(r"`(sensor/[^` ]+)`", line)}
    assert all((tmp_path / path).exists() for path in named), named
    frames = tomllib.loads(template.read_text(encoding="utf-8"))["frame"]
    kinds = Counter((frame["kind"], "leds" in frame) for frame in frames)
    assert set(kinds) == {
        ("dark", True),
        ("background", True),
        ("background", False),
        ("light_probe", False),
        ("press", False),
    }
    balls = {frame["probe"] for frame in frames if "probe" in frame}
    assert balls == {"sphere:4.0"}
    assert any("ball of a bearing, 4 mm" in text for text in all_text(found))


@pytest.mark.slow
def test_the_guide_says_where_each_board_and_its_wires_go_and_in_which_order(sensor: Any) -> None:
    _, made, _ = sensor
    steps = build_guide.steps(built_of(sensor), drawn=False)
    titles = [step.title for step in steps]
    assert titles.index("Bond the gel to the gelcore") < titles.index("Coat the membrane")
    assert titles.index("Try and focus the camera") < titles.index("Lay the camera in")
    for board in made:
        (text,) = [" ".join(step.text) for step in steps if step.title == f"Put {board.name} in"]
        assert (
            text.lower().index("thread")
            < text.index("sealant")
            < max(text.find("Slide it in"), text.find("Push it"), text.find("Bring it"))
        )
    connect = " ".join(next(step.text for step in steps if step.title == "Connect the LEDs"))
    total = sum(
        d["current_ma"] * sum(k in p.groups for b in made for p in b.blank.places) / d["in_series"]
        for k, d in enumerate(built_of(sensor).manifest["drive"])
    )
    (limit,) = re.findall(r"limit to (\d+) mA", connect)
    assert total < int(limit) < 1.4 * total + 1


@pytest.mark.slow
def test_units_and_quantities_of_guide_and_bill_are_written_out(sensor: Any) -> None:
    built = built_of(sensor)
    found = build_guide.chapters(built, drawn=False)
    for text in all_text(found):
        assert not re.search(r"mm2|mm3|\d um\b|\d C\b|\d deg C|mass_g|upper body|\b[Bb]ody\b", text), text
    # What is bought by the amount states it.
    for row in built.manifest["bom"]:
        if row["item"] in STOCK_ITEMS:
            assert re.search(r"\d", row["material"]) or row["count"] > 1 or row["item"] == "computer", row
    camera = " ".join(next(chapter.text for chapter in found if chapter.title == "Camera settings"))
    design, board = sensor[0], seating.mount(sensor[0]).board
    assert f"--mode {design.camera.width_px}:{design.camera.height_px}:{board.raw_bits}" in camera
    assert "µs" in camera
    seen = apparent_distance_mm(design.layers_to_camera(0.0)) - board.lens_height_mm + board.pupil_mm
    assert f"{seen:.3g} mm before the front of the lens" in camera


STOCK_ITEMS = (
    "silicone",
    "pigment",
    "solvent",
    "isopropanol",
    "masking",
    "primer",
    "lacquer",
    "paint",
    "adhesive",
    "wire",
    "switches",
    "tape",
    "computer",
    "ribbon",
    "grey_card",
    "ball",
)


@pytest.mark.parametrize(
    ("gel", "named", "in_sensors"),
    [
        ("gelsight-mini", False, True),
        ("xp-565", False, True),
        ("dragon-skin-20", True, False),
        ("solaris-slacker-1-1-1", True, True),
    ],
)
def test_a_silicone_that_the_program_chooses_is_one_that_cameras_look_through(
    gel: str, named: bool, in_sensors: bool
) -> None:
    silicone, own = gel_to_buy(preset("default").replace({"contact.gel": gel}))
    assert silicone is not None
    assert (own, silicone.in_sensors) == (named, in_sensors)
    assert silicone.mixing_ratio


@pytest.mark.parametrize(
    ("ratio", "masses"),
    [
        ("1:1", "5.0 g and 5.0 g"),
        ("10:1", "9.1 g and 0.9 g"),
        ("Solaris A : B : Slacker 1:1:2 by mass", "2.5 g, 2.5 g and 5.0 g"),
        ("by its sheet", ""),
    ],
)
def test_masses_of_a_batch_follow_from_the_ratio(ratio: str, masses: str) -> None:
    assert mixed_masses(ratio, 10.0) == masses


@pytest.mark.parametrize(
    ("x", "y", "said"),
    [(1.0, 0.0, "3 o'clock"), (0.0, 1.0, "12 o'clock"), (-1.0, -1.0, "7.5 o'clock"), (0.0, 0.0, "all sides")],
)
def test_where_a_picture_is_brightest_is_told_by_the_clock(x: float, y: float, said: str) -> None:
    row, column = np.mgrid[0:40, 0:40]
    light = (1.0 + 0.5 * (x * (column - 19.5) - y * (row - 19.5)) / 20).astype(np.float32)
    assert said in build_guide._brightest(light)


@pytest.mark.slow
def test_every_part_of_the_bill_is_in_a_step_of_each_guide_and_the_other_way_round(sensor: Any) -> None:
    built = built_of(sensor)
    bought = built.manifest["bom"]
    found = build_guide.chapters(built, drawn=False)
    steps = next(chapter.steps for chapter in found if chapter.steps)
    assert {part for step in steps for part in step.parts} == {row["part"] for row in bought}
    assert all(step.parts and step.text for step in steps)
    # What a step puts in was made, bought or wired in an earlier one, unless it is bought ready.
    titles = [step.title for step in steps]
    assert titles.index("Order and wire the LED boards") < min(
        number for number, title in enumerate(titles) if title.startswith("Put board")
    )
    text = " ".join(line for chapter in found for line in chapter.text)
    for word in ("Degas", "Cure", "Mix", "pigment", "3D printer", "Focus", "designlab init", "nozzle", "pip"):
        assert word in text
    assert not re.search(r"[{}]", text + " ".join(line for step in steps for line in step.text))


@pytest.mark.slow
def test_every_part_of_the_bill_is_in_a_step_and_the_other_way_round(folder: Path) -> None:
    with (folder / "bom.csv").open(encoding="utf-8") as file:
        numbers = [row["part"] for row in csv.DictReader(file)]
    used = {part for step in json.loads((folder / "guide.json").read_text()) for part in step["parts"]}
    assert len(set(numbers)) == len(numbers)
    assert used == set(numbers)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["housing", "lid"])
def test_prints_lie_on_their_upper_face(folder: Path, name: str) -> None:
    printed, built = read(folder / "3mf" / f"{name}.3mf"), read(folder / "stl" / f"{name}.stl")
    assert printed.is_watertight
    assert printed.bounds[0, 2] == pytest.approx(0.0, abs=THINNING_MM)
    assert printed.volume == pytest.approx(built.volume, rel=1e-5)  # files round
    # what was on top is below: the largest level face is on the bed
    level = printed.face_normals[:, 2] < -0.999
    on_bed = level & (np.abs(printed.triangles_center[:, 2]) < THINNING_MM)
    assert printed.area_faces[on_bed].sum() > 0.5 * printed.area_faces[level].sum()


def placed_parts(path: Path) -> dict[str, tuple[float, tuple[float, ...]]]:
    """Solids of a STEP file of an assembly, read again: by name, volume and middle (mm)."""
    found = {}
    for node in cadquery.Assembly.importStep(str(path)).traverse():
        _, part = node
        if part.obj is not None and part.shapes:
            whole = cadquery.Compound.makeCompound(part.shapes).moved(part.loc)
            found[part.name] = (whole.Volume(), cadquery.Shape.centerOfMass(whole).toTuple())
    return found


@pytest.mark.slow
def test_the_assembly_read_again_has_every_part_by_name_in_its_place(folder: Path) -> None:
    design = preset("default")
    made = boards.boards(design).boards
    shapes = parts(design, boards=made) | {board.name: solid(board) for board in made}
    leds = {led.name: led.solid for led in built_leds(design, made)}
    wanted = {name: shape for name, shape in shapes.items() if "mould" not in name and name != "led_array"}
    for name in ("screws", "inserts"):
        each = enumerate(wanted.pop(name).Solids(), start=1)
        wanted |= {f"{name[:-1]}_{number}": one for number, one in each}
    wanted |= leds
    found = placed_parts(folder / "assembly.step")
    assert set(wanted) <= set(found)
    for name, shape in wanted.items():
        volume, middle = found[name]
        assert volume == pytest.approx(shape.Volume(), rel=1e-6)
        assert middle == pytest.approx(cadquery.Shape.centerOfMass(shape).toTuple(), abs=1e-3)
    with (folder / "leds.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    with (folder / "bom.csv").open(encoding="utf-8") as file:
        items = {row["part"]: row["item"] for row in csv.DictReader(file)}
    assert {items[row["part"]] for row in rows} == {"led_red", "led_green", "led_blue"}
    assert all(items[row["part"]] == f"led_{row['group']}" for row in rows)
    # An LED's front is where the table has its emitting face.
    for row in rows:
        name = f"led_{int(row['led']):03d}_{row['group']}"
        normal = np.array([float(row[f"normal_{axis}"]) for axis in "xyz"])
        face = np.array([float(row[f"{axis}_mm"]) for axis in "xyz"])
        thickness_mm = leds[name].Volume() / 1.6**2
        assert np.linalg.norm(np.array(found[name][1]) + thickness_mm / 2 * normal - face) < 0.05


@pytest.mark.full
@pytest.mark.parametrize("name", SEATED[1:])
def test_files_of_the_other_seated_presets_are_closed_and_whole(name: str, tmp_path: Path) -> None:
    """The default one is checked by `folder`; an export reads all files again and fails where one is off."""
    manifest = export(preset(name), tmp_path / "out")
    assert all(check["ok"] for check in manifest["checks"])
    for path in [*(tmp_path / "out" / "stl").iterdir(), *(tmp_path / "out" / "3mf").iterdir()]:
        assert read(path).is_watertight, path.name
    names = set(placed_parts(tmp_path / "out" / "assembly.step"))
    assert {"housing", "lid", "camera", "gelcore", "elastomer", "screw_4"} <= names
    assert {board["name"] for board in manifest["boards"]} <= names
    assert sum(name.startswith("led_0") for name in names) == sum(b["leds"] for b in manifest["boards"])


@pytest.mark.slow
def test_meshes_of_the_seated_default_are_closed(folder: Path) -> None:
    for path in [*(folder / "stl").iterdir(), *(folder / "3mf").iterdir()]:
        assert read(path).is_watertight, path.name


@pytest.mark.slow
def test_what_is_assumed_of_camera_and_screws_is_told(folder: Path) -> None:
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    assert "camera raspberry-pi-camera-2: pupil_mm" in manifest["assumed"]
    assert any(check["name"] == "contact" for check in manifest["checks"])


@pytest.mark.faults
@pytest.mark.parametrize(
    ("changes", "named"),
    [
        (
            {"housing.seats": {"camera": "webcam"}},
            ["housing.seats.camera", "webcam", "raspberry-pi-camera-1"],
        ),
        ({"camera.body_radius_mm": 2.0}, ["camera_board_fits", "3.5 mm"]),
        ({"leds.radius_mm": 16.2}, ["leds_inside_housing"]),
        ({"housing.top_mm": 26.5}, ["camera_board_above_plate", "2.5 mm"]),
    ],
)
def test_what_cannot_be_seated_is_refused_before_anything_is_written(
    changes: dict[str, Any], named: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (Path(seating.__file__).parent / "presets" / "default.toml").read_text(encoding="utf-8")
    for path, value in changes.items():
        *_, table, field = ("", *path.split("."))
        if isinstance(value, dict):
            text = text.replace('camera = "raspberry-pi-camera-2"', f'camera = "{value["camera"]}"')
        else:
            head, tail = text.split(f"[{table}]\n")
            lines = [
                f"{field} = {value}" if line.startswith(f"{field} =") else line for line in tail.splitlines()
            ]
            cut = next(k for k, line in enumerate(tail.splitlines()) if line.startswith(f"{field} ="))
            text = f"{head}[{table}]\n" + "\n".join([*lines[: cut + 1], *tail.splitlines()[cut + 1 :]])
    design = tmp_path / "design.toml"
    design.write_text(text, encoding="utf-8")
    assert cli.main(["export", str(design), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in named), said
    assert not (tmp_path / "out").exists()


@pytest.mark.faults
@pytest.mark.parametrize(
    ("changes", "options", "named"),
    [
        ({"leds.radius_mm": 16.2}, [], ["leds_inside_housing", "inner radius", "violated by 2.06 mm"]),
        (
            {"housing.inner_radius_mm": 15.45},
            [],
            ["board_red", "15.64 mm from the axis", "housing.inner_radius_mm", "15.25 mm"],
        ),
        ({}, ["--supply-v", "2.5"], ["kingbright-aptf1616", "forward voltage 2.65 V", "supply_v is 2.5 V"]),
        ({"housing.top_mm": 25.0}, [], ["its screws hold and end short of the light", "violated by 1 mm"]),
        ({"camera.body_radius_mm": 2.0}, [], ["housing.seats.camera", "its lens", "violated by 3.5 mm"]),
        ({"camera.position_mm": (0.0, 0.0, 21.5)}, [], ["camera_board_above_plate", "5 mm or more"]),
        ({"housing.inner_radius_mm": 14.0}, [], ["core_inside_housing", "violated by 1.01 mm"]),
        (
            {"housing.wall_mm": 1.1},
            [],
            ["housing.wall_mm", "1.1 mm", "ring around the gel", "1.2 mm or more"],
        ),
    ],
)
def test_bad_input_names_part_value_and_rule_and_leaves_nothing(
    changes: dict[str, Any],
    options: list[str],
    named: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    design = tmp_path / "design.toml"
    preset("default").replace(changes).save(design)
    out = tmp_path / "out"
    assert cli.main(["export", str(design), "--out", str(out), *options]) == 2
    said = capsys.readouterr().err
    assert all(word in said for word in named), said
    assert "Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == ["design.toml"]


@pytest.mark.renders
@pytest.mark.slow
def test_the_guide_has_its_pages_and_the_expected_picture(folder: Path, tmp_path: Path) -> None:
    design = preset("default")
    out = tmp_path / "out"
    manifest = export(design, out, boards=False, describe=build_guide.write)
    page, text = ((out / name).read_text(encoding="utf-8") for name in ("guide.html", "guide.md"))
    assert "1. Print" in page
    assert "## Gel" in text
    assert (out / "guide" / "first-picture.png").stat().st_size > 1000
    assert "guide/first-picture.png" in manifest["files"]
    drawn = list((out / "guide").glob("step-*.png"))
    assert drawn or any("no pictures" in warning for warning in manifest["warnings"])
    colours = len(design.leds.groups)
    assert len(list((out / "guide").glob("first-picture-*.png"))) == colours
    assert text.count("![") == len(drawn) + (2 if drawn else 1) + colours
    # A step's picture has the number of the step.
    for number, name in re.findall(
        r"^### (\d+)\. .*?\n(?:(?!^###).*\n)*?!\[.*\]\(guide/step-(\d+)", text, re.MULTILINE
    ):
        assert int(number) == int(name)
