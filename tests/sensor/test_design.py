"""Designs: validation, files, digests, changes, and where the membrane appears on the sensor."""

import subprocess
import sys
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from designlab.sensor.design import (
    Design,
    DesignError,
    InfeasibleDesign,
    dumps,
    load,
    loads,
    preset,
    preset_text,
)

FLAT = preset("gelsight-2020-flat")
CORE = preset("default")
ONE_GROUP = """
mixing = [[1.0], [0.5], [0.2]]
[leds]
[[leds.groups]]
name = "white"
azimuth_deg = [90.0]
"""


def refused(text):
    with pytest.raises(DesignError) as caught:
        loads(text, source="my.toml")
    return str(caught.value)


def test_a_short_file_gets_every_default():
    design = loads(ONE_GROUP)
    assert design.group_names == ("white",)
    np.testing.assert_array_equal(design.mixing_matrix, [[1.0], [0.5], [0.2]])
    assert design.per_group("membrane_albedo") == (0.5,)


def test_written_text_reads_back_as_the_same_design():
    design = CORE.replace({"leds.tilt_deg": 12.5, "camera.exposure": 0.25, "optics.membrane_albedo": (0.3,)})
    again = loads(dumps(design))
    assert again == design
    assert again.digest == design.digest


def test_the_digest_is_of_the_content_alone():
    assert FLAT.replace({"name": "other", "description": "x"}).digest == FLAT.digest
    assert FLAT.replace({"leds.tilt_deg": 19.0}).digest == FLAT.digest
    changes = [{"leds.tilt_deg": 19.000001}, {"camera.bit_depth": 11}, {"mixing": None}]
    assert len({FLAT.replace(change).digest for change in changes} | {FLAT.digest}) == 4


def test_the_digest_is_the_same_in_every_process():
    program = "from designlab.sensor.design import preset; print(preset('gelsight-2020-flat').digest)"
    for hash_seed in ("1", "2"):
        answer = subprocess.run(
            [sys.executable, "-c", program],
            env={"PYTHONHASHSEED": hash_seed},
            capture_output=True,
            text=True,
            check=True,
        )
        assert answer.stdout.strip() == FLAT.digest


@given(tilt=st.floats(-90, 90), flux=st.floats(1e-3, 1e6))
def test_replacing_sets_exactly_what_was_asked(tilt, flux):
    changed = FLAT.replace({"leds.tilt_deg": tilt, "leds.groups.1.flux_mw": flux})
    assert changed.leds.tilt_deg == tilt
    assert [g.flux_mw for g in changed.leds.groups] == [660.4, flux, 862.4]
    assert changed.camera == FLAT.camera
    assert FLAT.leds.tilt_deg == 19.0


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"leds.tild_deg": 30}, "leds.tild_deg"),
        ({"leds.groups.3.flux_mw": 1.0}, "leds.groups.3.flux_mw"),
        ({"leds.groups.red.flux_mw": 1.0}, "leds.groups.red.flux_mw"),
        ({"camera": {"width_px": 8}}, "camera.width_px"),
        ({"leds.tilt_deg": 91}, "leds.tilt_deg"),
        ({"leds.tilt_deg": float("nan")}, "leds.tilt_deg"),
        ({"optics.membrane_albedo": (0.5, 1.5, 0.5)}, "optics.membrane_albedo"),
        ({"optics.membrane_albedo": (0.5, 0.5)}, "optics.membrane_albedo"),
        ({"optics.gelcore_material": "diamond"}, "optics.gelcore_material"),
        ({"sensing_area_mm": (0.1, 5.0)}, "sensing_area_mm"),
        ({"mixing": ((1.0, 0.0), (0.0, 1.0), (0.0, 0.0))}, "mixing"),
        ({"gelcore.shape": "dome", "gelcore.radius_mm": 30.0, "gelcore.draft_deg": 0.0}, "elastomer.shape"),
    ],
)
def test_a_change_that_is_refused_names_its_field(changes, named):
    with pytest.raises(DesignError, match=named.replace(".", r"\.")):
        FLAT.replace(changes)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("name = ", ("my.toml", "TOML")),
        (ONE_GROUP + "colour = 'red'", ("my.toml", "leds.groups.0.colour", "unknown field")),
        (ONE_GROUP.replace("[90.0]", "90.0"), ("my.toml", "leds.groups.0.azimuth_deg", "90.0")),
        (ONE_GROUP + "flux_mw = -3.0", ("leds.groups.0.flux_mw", "greater than 0", "-3.0")),
        (ONE_GROUP.replace("mixing", "# mixing"), ("mixing", "required unless there are three")),
        ("[camera]\nbit_depth = 10\n", ("my.toml", "leds", "required")),
    ],
)
def test_a_file_that_is_refused_names_field_rule_and_value(text, parts):
    message = refused(text)
    for part in parts:
        assert part in message
    assert "\n" not in message


def test_several_problems_are_counted():
    assert refused(ONE_GROUP + "flux_mw = -3.0\nwavelength_nm = 5.0").endswith("got -3.0 (and 1 more)")


def test_load_takes_presets_and_files(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text(preset_text("default"))
    assert load("default") == load(file) == load(str(file)) == CORE


def test_load_says_what_is_missing(tmp_path):
    with pytest.raises(DesignError, match=r"no such file, and no preset of that name.*gelsight-2020-flat"):
        load("gelsight-2021")
    with pytest.raises(DesignError, match="cannot be read as text"):
        load(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DesignError, match=r"binary\.toml: cannot be read as text"):
        load(tmp_path / "binary.toml")
    with pytest.raises(DesignError, match="known are default"):
        preset_text("none")


def test_designs_cannot_be_changed_in_place():
    with pytest.raises(ValueError, match="frozen"):
        FLAT.name = "x"  # type: ignore[misc]


def test_every_infeasible_rule_is_named_at_once():
    design = FLAT.replace({"camera.body_radius_mm": 5.0, "housing.wall_mm": 0.3})
    with pytest.raises(InfeasibleDesign, match=r"clears_plate.*violated by 1 mm.*minimum_wall.*0\.5 mm"):
        design.require_feasible()


def test_a_point_in_air_appears_where_a_pinhole_puts_it():
    x_c, y_c, z_c = FLAT.camera.position_mm
    focal = 2592 / 2 / np.tan(np.radians(53.3) / 2)
    column, row = FLAT.project_px(3.0, -2.0)
    assert column == pytest.approx(1296 + focal * (3.0 - x_c) / z_c, rel=1e-9)
    assert row == pytest.approx(972 - focal * (-2.0 - y_c) / z_c, rel=1e-9)


def test_on_a_dome_a_point_is_nearer_to_the_camera():
    dome = preset("gelsight-2020-dome")
    x_c, _, z_c = dome.camera.position_mm
    height = 35 - np.sqrt(35**2 - 6.0**2)
    column, _ = dome.project_px(6.0, 0.0)
    assert column == pytest.approx(1296 + dome.camera.focal_px * (6.0 - x_c) / (z_c - height), rel=1e-9)
    with pytest.raises(InfeasibleDesign, match=r"\(40, 0\) mm lies outside the curved membrane"):
        dome.project_px(40.0, 0.0)


@pytest.mark.parametrize("design", [FLAT, CORE, preset("gelsight-2020-dome")], ids=lambda d: d.name)
@pytest.mark.parametrize("columns", [40, 163])
def test_a_view_covers_the_sensing_area_in_square_pixels(design, columns):
    view = design.view(columns)
    pixel = view.width_px / columns
    assert view.columns == columns
    assert view.height_px / view.rows == pytest.approx(pixel, rel=1e-12)
    half_w, half_h = design.sensing_area_mm[0] / 2, design.sensing_area_mm[1] / 2
    corners = np.array([design.project_px(x, y) for x in (-half_w, half_w) for y in (-half_h, half_h)])
    assert view.x_px == pytest.approx(corners[:, 0].min())
    assert view.x_px + view.width_px == pytest.approx(corners[:, 0].max())
    assert view.y_px == pytest.approx(corners[:, 1].min(), abs=pixel / 4 + 1e-9)
    assert view.y_px + view.height_px == pytest.approx(corners[:, 1].max(), abs=pixel / 4 + 1e-9)


def test_a_camera_below_the_window_cannot_see():
    low = CORE.replace({"camera.position_mm": (0.0, 0.0, 9.0)})
    with pytest.raises(InfeasibleDesign, match="above the window at 10 mm, is 9 mm"):
        low.view(40)


def test_a_design_needs_light_sources():
    with pytest.raises(ValueError, match="leds"):
        Design.model_validate({})


@pytest.mark.parametrize("name", ["default", "gelsight-2020-flat", "digit-like"])
def test_fields_that_groups_may_have_of_their_own_are_not_written_when_absent(name):
    design = preset(name)
    own = ("radius_mm", "height_mm", "tilt_deg", "pitch_mm", "offset_mm")
    groups = tomllib.loads(dumps(design))["leds"]["groups"]
    assert all(field not in group for group in groups for field in own)
    nothing = {f"leds.groups.{k}.{field}": None for k in range(3) for field in own}
    assert design.replace(nothing) == design


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("radius_mm", 13.5),
        ("height_mm", 5.5),
        ("tilt_deg", -4.0),
        ("pitch_mm", 4.5),
        ("offset_mm", (0.1, -0.05)),
    ],
)
def test_groups_keep_their_own_fields_in_files(field, value):
    design = preset("default").replace({f"leds.groups.1.{field}": value})
    assert design.digest != preset("default").digest
    assert loads(dumps(design)) == design
    assert design.changes == {
        f"leds.groups.1.{field}": (None, list(value) if field == "offset_mm" else value)
    }


@pytest.mark.faults
@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("radius_mm", -1.0, "greater than 0"),
        ("height_mm", 300.0, "less than or equal to 200"),
        ("tilt_deg", 95.0, "less than or equal to 90"),
        ("pitch_mm", "wide", "valid number"),
        ("offset_mm", (3.0, 0.0), "must stay on the body of 3 x 2.8 mm, got (3, 0) mm"),
    ],
)
def test_fields_of_a_group_are_refused_by_name(field, value, told):
    with pytest.raises(DesignError, match=rf"groups\.1\.{field}: ") as refused:
        preset("default").replace({f"leds.groups.1.{field}": value})
    assert told in str(refused.value)
