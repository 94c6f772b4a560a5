"""Exports of designs whose LEDs are glued to the core, cast into it, or bought by name."""

import pytest

from designlab.fabrication import export
from designlab.fabrication.parts import parts
from designlab.fabrication.tables import bill
from designlab.sensor.design import preset

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
