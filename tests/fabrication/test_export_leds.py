"""Exports of designs whose LEDs are glued to the core, cast into it, or bought by name."""

import pytest

from designlab.fabrication import export
from designlab.fabrication.parts import parts
from designlab.fabrication.tables import bill, led_rows
from designlab.sensor.design import InfeasibleDesign, preset
from tests.helpers.shared_packages import APART, shared

CORE = preset("default")
EMBEDDED = CORE.replace({"leds.coupling": "embedded", "leds.radius_mm": 11.5})


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("embedded") / "out"
    return export(EMBEDDED, folder), folder


def test_the_core_has_the_cavities_of_leds_cast_into_it():
    plain, cast = (parts(design)["gelcore"].Volume() for design in (CORE, EMBEDDED))
    assert plain - cast == pytest.approx(9 * 3.0 * 2.8 * 1.0, rel=1e-6)


@pytest.mark.slow
def test_a_core_with_cavities_exports_and_passes_every_check(exported):
    manifest, folder = exported
    assert all(check["ok"] for check in manifest["checks"])
    readme = (folder / "README.txt").read_text()
    assert "embedding: the LEDs are cast into the gelcore" in readme
    assert "bonding" not in readme


def test_the_bill_names_the_part_that_is_bought():
    design = CORE.replace({"leds.part": "kingbright-aptf1616"})
    rows = {row["item"]: row for row in bill(design, parts(design))}
    assert rows["led_red"]["material"].startswith("Kingbright APTF1616LSEKJ3ZGKQBC, 640 nm")


SHARED = shared(CORE)
PARTLY = shared(CORE, {"leds.groups.2.azimuth_deg": (90.0, 30.0, 150.0)})


@pytest.mark.parametrize(
    ("design", "expected"),
    [
        (SHARED, {"led_red_green_blue": 9}),
        (PARTLY, {"led_red_green_blue": 3, "led_red_green": 6, "led_blue": 6}),
        (CORE, {"led_red": 3, "led_green": 3, "led_blue": 3}),
    ],
)
def test_packages_are_bought_and_drawn_once(design, expected):
    shapes = parts(design)
    rows = {row["item"]: row for row in bill(design, shapes) if row["item"].startswith("led")}
    assert {item: row["count"] for item, row in rows.items()} == expected
    assert len(shapes["led_array"].Solids()) == sum(expected.values())
    assert shapes["led_array"].Volume() == pytest.approx(sum(expected.values()) * 3.0 * 2.8 * 1.0)


def test_a_package_of_several_channels_says_so():
    row = next(row for row in bill(SHARED, parts(SHARED)) if row["item"].startswith("led"))
    assert row["material"] == "625, 525 and 465 nm smd, 3 x 2.8 x 1 mm, 3.333, 3.333 and 3.333 mW each"
    assert row["note"] == "3 channels; places in leds.csv"
    bought = SHARED.replace({"leds.part": "kingbright-aptf1616"})
    row = next(row for row in bill(bought, parts(bought)) if row["item"].startswith("led"))
    assert row["material"].count("Kingbright APTF1616LSEKJ3ZGKQBC") == 1


def test_channels_of_a_package_have_its_number_in_the_table():
    rows = led_rows(shared(CORE, APART))
    assert len(rows) == 27
    for led in range(1, 10):
        own = [row for row in rows if row["led"] == led]
        assert [row["group"] for row in own] == ["red", "green", "blue"]
        assert {row["strip"] for row in own} == {1}
        assert len({(row["x_mm"], row["y_mm"], row["z_mm"]) for row in own}) == 3  # chips lie apart
    assert sum(row["flux_mw"] for row in rows) == pytest.approx(30.0 * 3, abs=1e-4)
    places = {(row["x_mm"], row["y_mm"], row["z_mm"]) for row in led_rows(SHARED)}
    assert len(places) == 9


@pytest.mark.full
def test_a_sensor_with_shared_packages_exports_and_passes_every_check(tmp_path):
    manifest = export(SHARED, tmp_path / "out")
    assert all(check["ok"] for check in manifest["checks"])
    assert manifest["led_count"] == 9
    assert "led_001_red_green_blue" in (tmp_path / "out" / "assembly.step").read_text()


@pytest.mark.full
def test_groups_that_stand_elsewhere_are_made_there(tmp_path):
    higher = CORE.replace({"leds.groups.1.height_mm": 7.0, "leds.groups.1.radius_mm": 14.0})
    manifest = export(higher, tmp_path / "out", boards=False)  # its housing leaves no room for one
    assert all(check["ok"] for check in manifest["checks"])
    rows = [row for row in led_rows(higher) if row["group"] == "green"]
    assert {row["z_mm"] for row in rows} == {7.0}
    boxes = [solid.BoundingBox() for solid in parts(higher)["led_array"].Solids()[3:6]]
    assert [round((box.zmin + box.zmax) / 2, 6) for box in boxes] == [7.0] * 3


@pytest.mark.parametrize("allowed", [False, True])
@pytest.mark.parametrize(
    ("design", "change", "rule"),
    [
        ("gelsight-2020-dome-core", {"gelcore.radius_mm": 15.0}, "core_radius"),
        ("pbr-fingertip-like", {"gelcore.height_mm": 8.0}, "core_height"),
        ("default", {"gelcore.draft_deg": 30.0, "gelcore.height_mm": 23.0}, "core_sides"),
        ("gelsight-2020-dome", {"elastomer.radius_mm": 15.0}, "dome_radius"),
    ],
)
@pytest.mark.faults
def test_a_part_without_a_shape_is_refused_by_name_whatever_is_allowed(
    design, change, rule, allowed, tmp_path
):
    broken = preset(design).replace(change)
    with pytest.raises(InfeasibleDesign, match=f"infeasible: .*{rule}: "):
        export(broken, tmp_path / "out", allow_infeasible=allowed)
    assert not (tmp_path / "out").exists()
