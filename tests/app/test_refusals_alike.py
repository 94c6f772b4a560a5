"""What one command accepts or refuses of a design, all do, by the same line: render, evaluate and export."""

from itertools import combinations

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from designlab.app.cli import main
from designlab.fabrication.checks import check_overlaps
from designlab.fabrication.parts import CASTING_PARTS, SENSOR_PARTS, parts
from designlab.sensor.design import Design, DesignError, dumps, preset
from designlab.sensor.feasibility import RULES
from designlab.simulation.simulator import Simulator

BASES = {
    name: preset(name)
    for name in (
        "default",
        "gelsight-2020-flat-core",
        "gelsight-2020-dome-core",
        "gelsight-mini-like",
        "pbr-fingertip-like",
    )
}
LENGTHS = (
    "gelcore.width_mm", "gelcore.length_mm", "gelcore.height_mm", "gelcore.radius_mm",
    "gelcore.window_diameter_mm", "gelcore.cavity_radius_mm", "gelcore.cavity_depth_mm",
    "elastomer.width_mm", "elastomer.length_mm", "elastomer.thickness_mm", "elastomer.radius_mm",
    "leds.radius_mm", "leds.height_mm", "leds.pitch_mm", "leds.body_width_mm", "leds.body_height_mm",
    "leds.body_thickness_mm", "leds.groups.0.radius_mm", "leds.groups.0.height_mm", "leds.groups.1.pitch_mm",
    "housing.inner_radius_mm", "housing.wall_mm", "housing.bottom_mm", "housing.top_mm", "housing.plate_mm",
    "housing.camera_hole_mm", "camera.position_mm.2", "camera.body_radius_mm", "camera.horizontal_fov_deg",
    "sensing_area_mm.0", "sensing_area_mm.1",
)  # fmt: skip
"""Numbers that are drawn around those of a base."""
ABSENT = {
    "gelcore.radius_mm": 15.0,
    "elastomer.radius_mm": 17.0,
    "gelcore.cavity_radius_mm": 6.0,
    "gelcore.cavity_depth_mm": 5.0,
    "leds.groups.0.radius_mm": 14.0,
    "leds.groups.0.height_mm": 6.0,
    "leds.groups.1.pitch_mm": 4.0,
}
"""What stands for those that a base leaves out."""
WHOLE = {
    "gelcore.draft_deg": st.floats(0.0, 30.0),
    "leds.tilt_deg": st.floats(-90.0, 90.0),
    "leds.groups.0.tilt_deg": st.floats(-90.0, 90.0),
    "leds.groups.1.azimuth_deg": st.just((90.0,)),
    "leds.layout": st.sampled_from(["edge", "ring"]),
    "leds.coupling": st.sampled_from(["air_gap", "bonded", "embedded"]),
    "gelcore.shape": st.sampled_from(["slab", "hexagonal", "dome"]),
    "elastomer.shape": st.sampled_from(["flat", "dome"]),
    "elastomer.outline": st.sampled_from(["rectangle", "hexagon", "round"]),
}
FACTORS = st.one_of(st.floats(0.9995, 1.0005), st.floats(0.9, 1.1), st.floats(0.3, 2.5))


def value_of(design: Design, path: str) -> float | None:
    content = design.model_dump()
    for key in path.split("."):
        content = content[int(key) if isinstance(content, list | tuple) else key]
    return content


@st.composite
def designs(draw: st.DrawFn) -> Design | None:
    """A sensor near a preset, in some fields far from it; None where its fields do not go together."""
    base = BASES[draw(st.sampled_from(sorted(BASES)))]
    changes = {}
    for path in draw(st.lists(st.sampled_from([*LENGTHS, *WHOLE]), unique=True, max_size=4)):
        if path in WHOLE:
            changes[path] = draw(WHOLE[path])
        else:
            changes[path] = (value_of(base, path) or ABSENT.get(path, 5.0)) * draw(FACTORS)

    def now(path: str) -> float | None:
        return changes.get(path, value_of(base, path))

    if now("gelcore.radius_mm") is not None and draw(st.booleans()):  # spheres that stay together, or nearly
        apart = draw(st.one_of(st.just(0.0), st.floats(-0.02, 0.02)))
        changes["elastomer.radius_mm"] = now("gelcore.radius_mm") + now("elastomer.thickness_mm") + apart
    if draw(st.booleans()):  # a gel that ends where its core does
        changes["elastomer.width_mm"] = now("gelcore.width_mm")
    try:
        return base.replace(changes)
    except DesignError:
        return None


def build(design: Design) -> None:
    """Lay out what render and evaluate trace light through, and make what export writes."""
    simulator = Simulator(design, columns=8, seed=0, pitch_mm=0.5)
    assert len(simulator.undeformed.shapes) > 1
    shapes = parts(design)
    pairs = [*combinations(SENSOR_PARTS, 2), *combinations(CASTING_PARTS, 2)]
    assert [check for check in check_overlaps(design, shapes, pairs) if not check.ok] == []
    assert [name for name, shape in shapes.items() if not shape.isValid() or shape.Volume() <= 0] == []


@pytest.mark.slow
@settings(max_examples=25, suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow])
@given(design=designs())
def test_what_breaks_no_rule_can_be_laid_out_and_made(design: Design | None) -> None:
    assume(design is not None)
    assume(not design.broken())  # margins of any design that can be read are told, without an exception
    build(design)


@pytest.mark.parametrize("away_mm", [-0.02, -0.009, 0.0, 0.0006, 0.002, 0.009, 0.02])
@pytest.mark.parametrize("name", ["pbr-fingertip-like", "gelsight-2020-dome-core"])
@pytest.mark.slow
def test_a_core_that_fits_its_gel_by_the_rules_does_so_as_made(name: str, away_mm: float) -> None:
    base = BASES[name]
    design = base.replace({"gelcore.radius_mm": base.gelcore.radius_mm + away_mm})
    if design.broken():
        assert set(design.broken()) == {"dome_core"}
        assert away_mm != 0
    else:
        build(design)


BROKEN = {
    "core_radius": ("gelsight-2020-dome-core", {"gelcore.radius_mm": 15.0}),
    "core_height": ("gelsight-2020-dome-core", {"gelcore.height_mm": 4.0}),
    "core_sides": ("default", {"gelcore.draft_deg": 30.0, "gelcore.height_mm": 23.0}),
    "dome_radius": ("gelsight-2020-dome-core", {"elastomer.radius_mm": 15.0}),
    "dome_core": ("pbr-fingertip-like", {"elastomer.thickness_mm": 2.5}),
    "cavity_in_core": ("pbr-fingertip-like", {"gelcore.cavity_depth_mm": 12.0}),
    "leds_clear_of_each_other": ("default", {"leds.groups.1.azimuth_deg": (91.0,)}),
    "leds_clear_of_core": ("default", {"leds.groups.2.radius_mm": 12.0}),
    "leds_below_plate": ("default", {"leds.groups.0.height_mm": 22.0}),
    "camera_sees_membrane": ("default", {"camera.horizontal_fov_deg": 30.0}),
}


@pytest.mark.faults
@pytest.mark.parametrize("rule", BROKEN)
def test_all_commands_refuse_by_the_same_line(rule, tmp_path, capsys):
    name, change = BROKEN[rule]
    file, out = tmp_path / "broken.toml", tmp_path / "out"
    file.write_text(dumps(preset(name).replace(change)))
    lines = set()
    for words in (
        ["render", str(file), "-o", str(tmp_path / "picture.png")],
        ["evaluate", str(file), "--fidelity", "fast"],
        ["export", str(file), "--out", str(out)],
    ):
        assert main(words) == 2
        lines.add(capsys.readouterr().err.strip().splitlines()[-1])
    assert len(lines) == 1
    (line,) = lines
    assert line.startswith(f"designlab: {file}: design ")
    assert f"{rule}: {RULES[rule]} (violated by " in line
    assert [path.name for path in tmp_path.iterdir()] == ["broken.toml"]
