"""Housings with seats: every part is held, goes in along its way, and is named in bill and guide."""

import csv
import json
from pathlib import Path
from typing import Any

import cadquery
import numpy as np
import pytest

from designlab.app import cli
from designlab.fabrication import Built, assembly, boards, export
from designlab.fabrication.boards import Board
from designlab.fabrication.boards.orders import solid
from designlab.fabrication.checks import overlap_mm3
from designlab.fabrication.parts import parts
from designlab.fabrication.seating import SeatError, screw_length_mm
from designlab.fabrication.triangles import THINNING_MM, read
from designlab.report import build_guide
from designlab.sensor import seating
from designlab.sensor.design import Design, preset
from geometries import camera_head

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
    for number, first in enumerate(names):
        for second in names[number + 1 :]:
            if "led_array" not in (first, second) or "board" not in first + second:
                assert overlap_mm3(shapes[first], shapes[second]) < 0.1, (first, second)


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


@pytest.mark.slow
def test_the_assembly_names_every_part(folder: Path) -> None:
    text = (folder / "assembly.step").read_text(encoding="utf-8")
    for name in (
        "housing",
        "lid",
        "camera",
        "screw_1",
        "screw_4",
        "insert_1",
        "board_red",
        "gelcore",
        "elastomer",
    ):
        assert f"'{name}'" in text


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
    assert text.count("![") == len(drawn) + (2 if drawn else 1)
