"""A housing of one's own from a STEP file: closed, in the rules, in the light and in the export."""

import base64
import math
import zlib
from pathlib import Path

import cadquery
import pytest

from designlab.app import cli
from designlab.fabrication.parts import parts
from designlab.sensor.design import Design, load, preset
from designlab.simulation.simulator import Simulator
from geometries import housing, step_part
from geometries.housing import Housing
from geometries.step_part import StepPart

TUBE = preset("default").replace({"housing.seats": None, "name": "tube"})


def written(work: cadquery.Workplane, folder: Path, name: str = "own.step") -> Path:
    cadquery.exporters.export(work, str(folder / name))
    return folder / name


def with_part(work: cadquery.Workplane, folder: Path) -> Design:
    return TUBE.replace({"housing.step": {"file": str(written(work, folder))}})


def tube() -> cadquery.Workplane:
    return housing.solid(TUBE.housing)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("work", "volume_mm3"),
    [
        (cadquery.Workplane("XY").sphere(5), 4 / 3 * math.pi * 125),
        (cadquery.Workplane("XY").box(9, 9, 9).cut(cadquery.Workplane("XY").box(5, 5, 5)), 729.0 - 125.0),
        (cadquery.Workplane("XY").rarray(10, 1, 2, 1).box(2, 2, 2), 16.0),
    ],
)
def test_bodies_of_a_file_are_one_closed_surface(work, volume_mm3, tmp_path):
    part = StepPart.model_validate(str(written(work, tmp_path)))
    assert step_part.mesh(part).volume == pytest.approx(volume_mm3, rel=2e-3)
    assert sum(s.Volume() for s in step_part.solid(part).vals()) == pytest.approx(volume_mm3, rel=1e-6)
    (tmp_path / "own.step").unlink()  # it is kept in the design
    assert StepPart.model_validate(part.model_dump()).data == part.data


def open_body(kind: str, folder: Path) -> Path:
    box = cadquery.Workplane("XY").box(3, 4, 5)
    if kind == "face":
        return written(cadquery.Workplane(box.faces(">Z").val()), folder)
    if kind == "shell":
        return written(cadquery.Workplane(cadquery.Shell.makeShell(box.faces("not >Z").vals())), folder)
    if kind == "edge":
        return written(cadquery.Workplane(box.edges(">Z").vals()[0]), folder)
    path = folder / "own.step"
    if kind == "cut short":
        text = written(box, folder).read_bytes()
        path.write_bytes(text[: len(text) // 2])
    elif kind == "text":
        path.write_text("a housing")
    elif kind == "large":
        path.write_bytes(b"MANIFOLD_SOLID_BREP" * 300_000)
    return path


@pytest.mark.slow
@pytest.mark.faults
@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("face", "must be closed"),
        ("shell", "must be closed"),
        ("edge", "must be closed"),
        ("text", "must be closed"),
        ("cut short", ""),
        ("large", "a part may have"),
        ("missing", "cannot be read"),
    ],
)
def test_an_open_or_damaged_file_is_refused_by_name(kind, said, tmp_path, capsys):
    path, design = open_body(kind, tmp_path), tmp_path / "design.toml"
    TUBE.save(design)
    text = design.read_text(encoding="utf-8")
    design.write_text(text.replace("[housing]\n", '[housing]\nstep = "own.step"\n'), encoding="utf-8")
    for command in (["export", str(design), "--out", str(tmp_path / "out")], ["evaluate", str(design)]):
        assert cli.main(command) == 2
        told = capsys.readouterr().err
        assert "housing.step" in told
        assert path.name in told
        assert said in told
        assert "Traceback" not in told
    assert not (tmp_path / "out").exists()


@pytest.mark.faults
def test_a_part_of_ones_own_has_no_seats(tmp_path):
    part = {"file": str(written(cadquery.Workplane("XY").box(3, 4, 5), tmp_path))}
    with pytest.raises(ValueError, match="leave out seats"):
        Housing(step=part, seats=True)


@pytest.mark.slow
def test_ones_own_tube_is_the_tube(tmp_path):
    design = with_part(tube(), tmp_path)
    (tmp_path / "own.step").unlink()
    design.save(tmp_path / "design.toml")
    again = load(tmp_path / "design.toml")
    assert again.digest == design.digest != TUBE.digest
    assert again.broken() == {}
    assert parts(again)["housing"].Volume() == pytest.approx(parts(TUBE)["housing"].Volume(), rel=1e-6)


def column(x: float, y: float, width: float, low: float, high: float) -> cadquery.Workplane:
    plane = cadquery.Workplane("XY", origin=(x, y, low))
    return plane.rect(width, width).extrude(high - low)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("post", "rule"),
    [
        (column(0.0, 14.0, 2.0, 5.0, 22.0), "leds_inside_housing"),  # through a red LED
        (column(0.0, 0.0, 0.5, 15.0, 22.0), "view_through_plate"),
        (column(14.5, 0.0, 1.0, 5.0, 22.0), ""),
    ],
)
def test_a_part_in_the_way_breaks_a_rule(post, rule, tmp_path):
    design = with_part(tube().union(post), tmp_path)
    assert list(design.broken()) == ([rule] if rule else [])
    if rule:
        assert 0.1 < design.broken()[rule] < 10


@pytest.mark.slow
@pytest.mark.renders
def test_light_sees_a_part_of_ones_own(tmp_path):
    """A black tube of one's own changes nothing; a wall before two of three red LEDs takes their light."""
    wall = cadquery.Workplane("XY", origin=(-3.0, 13.15, 6.0)).box(9.0, 0.1, 8.0)
    found = {}
    for name, design in (
        ("tube", TUBE),
        ("own", with_part(tube(), tmp_path)),
        ("walled", with_part(tube().add(wall).combine(), tmp_path)),
    ):
        found[name] = Simulator(design, columns=64, samples=64, seed=1).frame(None).basis.mean(axis=(1, 2))
    assert found["own"] == pytest.approx(found["tube"], rel=0.03)
    assert 0.1 < found["walled"][0] / found["tube"][0] < 0.6
    assert found["walled"][1:] == pytest.approx(found["tube"][1:], rel=0.05)


@pytest.mark.slow
def test_a_bright_part_is_named_as_a_housing(tmp_path):
    for reflectance, name in ((0.0, "part-step"), (0.3, "housing-step")):
        design = with_part(tube(), tmp_path).replace({"optics.housing_reflectance": (reflectance,)})
        scene = Simulator(design, columns=32, samples=4, seed=1).undeformed
        own = [shape for shape in scene.shapes if "step" in shape.name]
        assert [shape.name for shape in own] == [name]
        assert not any(shape.name.startswith("housing-tube") for shape in scene.shapes)


@pytest.mark.faults
@pytest.mark.parametrize(
    "packed", [b"", b"no zlib", zlib.compress(b"cut")[:-3], zlib.compress(bytes(5_000_000))]
)
def test_damaged_or_swollen_content_is_refused(packed):
    part = StepPart(file="own.step", content=base64.b64encode(packed).decode() or "=")
    with pytest.raises(ValueError, match=r"own\.step: its content is damaged"):
        _ = part.data
