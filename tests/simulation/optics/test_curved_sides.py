"""A core with curved sides: solid and mesh against the arc, gaps against the solids, light against paths."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from designlab.app import cli
from designlab.fabrication.parts import parts
from designlab.sensor.design import Design, DesignError, dumps, loads, preset
from designlab.simulation.scene.static_parts import core_and_gel
from designlab.simulation.simulator import Simulator
from designlab.validation.synthetic.glass import ImmersedParts
from geometries import gelcore
from geometries.gelcore import Gelcore

HEXAGON = preset("default").replace({"leds.radius_mm": 14.5, "housing.inner_radius_mm": 18.0})
SLAB = preset("gelsight-mini-like").replace({"gelcore.height_mm": 6.0, "camera.position_mm.2": 24.0})
ROUND = preset("gelsight-2020-dome-core")
CASES = [(HEXAGON, 1.2), (HEXAGON, -0.9), (SLAB, 0.4), (SLAB, -1.0), (ROUND, 0.8), (ROUND, -1.5)]


def curved(design: Design, bulge_mm: float, **changes) -> Design:
    return design.replace({"gelcore.side_bulge_mm": bulge_mm, **changes})


def arc(height_mm: float, sagitta_mm: float, z_mm: float) -> float:
    """Distance of a circle through (0, 0), (sagitta, height / 2) and (0, height) from its chord."""
    radius = (height_mm**2 / 4 + sagitta_mm**2) / (2 * abs(sagitta_mm))
    out = math.sqrt(radius**2 - (z_mm - height_mm / 2) ** 2) - (radius - abs(sagitta_mm))
    return math.copysign(out, sagitta_mm)


@pytest.mark.parametrize(("design", "bulge_mm"), CASES)
def test_the_solid_has_the_volume_between_its_arcs(design, bulge_mm):
    core = curved(design, bulge_mm).gelcore
    cap_mm = 0.0
    if core.radius_mm is not None:
        cap_mm = core.radius_mm - math.sqrt(core.radius_mm**2 - core.width_mm**2 / 4)
    sides_mm = core.height_mm - cap_mm

    def section(z_mm: float) -> float:
        out, half = arc(sides_mm, bulge_mm, z_mm), core.width_mm / 2
        if core.shape == "slab":
            return 4 * (half + out) * (core.length_mm / 2 + out)
        return (math.pi if core.shape == "dome" else 2 * math.sqrt(3)) * (half + out) ** 2

    cap = 0.0 if core.radius_mm is None else math.pi * cap_mm**2 * (core.radius_mm - cap_mm / 3)
    solid = gelcore.solid(core).val()
    assert solid.isValid()
    assert solid.ShapeType() == "Solid"
    assert solid.Volume() == pytest.approx(quad(section, 0.0, sides_mm)[0] + cap, rel=1e-6)


@pytest.mark.parametrize(("design", "bulge_mm"), CASES)
def test_the_sides_that_light_meets_lie_on_those_of_the_solid(design, bulge_mm):
    """Vertices on the solid's surface, volume inside them that of the solid, normals across the faces."""
    design = curved(design, bulge_mm)
    solid = parts(design)["gelcore"]
    sides = [shape for shape in core_and_gel(design) if shape.name.startswith("core-side")]
    import cadquery

    for side in sides[:: max(len(sides) // 4, 1)]:
        for x, y, z in side.vertices[::7]:
            assert solid.distance(cadquery.Vertex.makeVertex(x, y, z)) < 0.02
        if side.normals is not None:
            a, b, c = (side.vertices[side.faces[:, k]] for k in range(3))
            across = np.cross(b - a, c - a)
            across /= np.linalg.norm(across, axis=1, keepdims=True)
            assert (across * side.normals[side.faces[:, 0]]).sum(axis=1).min() > 0.99


@pytest.mark.parametrize(("design", "bulge_mm"), CASES)
def test_the_gap_between_leds_and_core_is_that_of_the_solids(design, bulge_mm):
    design = curved(design, bulge_mm)
    margin = design.margins()["leds_clear_of_core"]
    shapes = parts(design)
    gap_mm = shapes["led_array"].distance(shapes["gelcore"])
    if margin > 0.01:
        assert gap_mm < 1e-9
    else:
        assert -margin <= gap_mm + 0.02


@pytest.mark.parametrize("bulge_mm", [0.3, 0.8, 1.1])
def test_leds_are_in_the_way_of_a_bulge_by_what_it_stands_out_there(bulge_mm):
    """Closed form: a row that faces a flat side is as near to it as the arc at its own height lets it be."""
    leds = {"leds.tilt_deg": 0.0, "leds.height_mm": 6.0}  # midway between gel side and window
    straight = HEXAGON.replace(leds).margins()["leds_clear_of_core"]
    margin = curved(HEXAGON, bulge_mm, **leds).margins()["leds_clear_of_core"]
    assert margin == pytest.approx(straight + bulge_mm, abs=0.02)


def test_a_hollow_side_lets_leds_in_and_is_no_narrower_than_allowed():
    near = HEXAGON.replace({"leds.radius_mm": 12.6, "leds.tilt_deg": 0.0, "leds.height_mm": 6.0})
    found = [curved(near, bulge_mm).margins()["leds_clear_of_core"] for bulge_mm in (-0.5, -1.0, -1.5)]
    assert near.margins()["leds_clear_of_core"] > found[0] > found[1] > found[2]
    margin = curved(HEXAGON, -1.5).margins()["core_sides"]
    assert margin == pytest.approx(1.0 - (HEXAGON.gelcore.width_mm - 3.0))


@pytest.mark.parametrize("bulge_mm", [0.5, 1.0, 1.9])
def test_a_bulge_needs_room_in_the_housing(bulge_mm):
    straight, bulged = HEXAGON.margins(), curved(HEXAGON, bulge_mm).margins()
    corner_mm = bulge_mm / math.cos(math.radians(30.0))
    assert bulged["core_inside_housing"] == pytest.approx(straight["core_inside_housing"] + corner_mm)


def test_a_waist_must_not_cut_the_view():
    narrow = curved(HEXAGON, -2.0, **{"gelcore.width_mm": 24.2, "elastomer.width_mm": 24.2})
    wide = narrow.replace({"sensing_area_mm": (22.0, 10.5)})
    assert narrow.margins()["view_through_window"] <= 0
    assert wide.margins()["view_through_window"] > narrow.margins()["view_through_window"]


def test_curved_sides_are_written_and_read_and_others_keep_their_digest():
    design = curved(HEXAGON, 0.7)
    assert loads(dumps(design)) == design
    assert design.digest != HEXAGON.digest
    flat = curved(HEXAGON, 0.0)
    assert flat.margins() == HEXAGON.margins()
    for own, other in zip(core_and_gel(flat), core_and_gel(HEXAGON), strict=True):
        np.testing.assert_array_equal(own.vertices, other.vertices)


@pytest.mark.faults
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"gelcore.side_bulge_mm": 2.5}, ["side_bulge_mm", "0.25 of the height", "2 mm", "2.5 mm"]),
        ({"gelcore.draft_deg": 5.0}, ["side_bulge_mm", "draft_deg"]),
        ({"gelcore.shape": "slab", "gelcore.wedge_deg": 5.0}, ["side_bulge_mm", "wedge_deg"]),
        ({"leds.coupling": "bonded"}, ["gelcore.side_bulge_mm", "leds.coupling", "'bonded'", "air_gap"]),
        ({"optics.housing_reflectance": (0.5,)}, ["gelcore.side_bulge_mm", "housing_reflectance", "0.5"]),
    ],
)
def test_curved_sides_that_cannot_be_simulated_are_refused(changes, words):
    with pytest.raises(DesignError) as refused:
        curved(HEXAGON, 1.0).replace(changes)
    for word in words:
        assert word in str(refused.value)
    with pytest.raises(ValueError, match=r"gelcore\.side_bulge_mm: measurements are generated of straight"):
        ImmersedParts.of(curved(HEXAGON, 1.0))


@pytest.mark.faults
@pytest.mark.parametrize("command", ["render", "evaluate", "export"])
def test_leds_in_a_bulge_are_refused_alike(command, tmp_path, capfd):
    path = tmp_path / "own.toml"
    path.write_text(dumps(curved(preset("default"), 1.5)))
    more = {
        "render": ["-o", str(tmp_path / "a.png")],
        "evaluate": [],
        "export": ["--out", str(tmp_path / "o")],
    }
    assert cli.main([command, str(path), *more[command]]) == 2
    assert "leds_clear_of_core" in capfd.readouterr().err


def test_the_longest_bulge_is_that_of_the_sides_of_a_dome():
    core = Gelcore(shape="dome", width_mm=20.0, height_mm=12.0, radius_mm=15.0)
    sides_mm = 12.0 - (15.0 - math.sqrt(125.0))
    assert gelcore.side_height_mm(core) == pytest.approx(sides_mm)
    with pytest.raises(ValueError, match=f"{sides_mm / 4:.4g} mm, is -3 mm"):
        Gelcore(shape="dome", width_mm=20.0, height_mm=12.0, radius_mm=15.0, side_bulge_mm=-3.0)


@pytest.mark.physics
@pytest.mark.renders
@pytest.mark.usefixtures("backend")
@pytest.mark.full
@pytest.mark.parametrize(("design", "bulge_mm"), [(HEXAGON, 1.0), (HEXAGON, -1.0), (ROUND, -1.5)])
def test_light_through_curved_sides_is_that_of_mitsubas_path_tracer(design, bulge_mm):
    design = curved(design, bulge_mm, **{"optics.path_length": 10})
    design.require_feasible()
    view = design.view(16)
    photons = Simulator(design, view=view, samples=256, seed=2).frame(None).basis.mean((1, 2))
    paths = (
        Simulator(design, view=view, samples=12000, seed=2, estimator="path").frame(None).basis.mean((1, 2))
    )
    np.testing.assert_allclose(photons.sum(), paths.sum(), rtol=0.015)
