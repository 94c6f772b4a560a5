"""A user's own parts: read from a file, kept in the design, refused by file, field, value and rule."""

import json
import re

import numpy as np
import pytest

from designlab.app.cli import main
from designlab.sensor.design import DesignError, dumps, load, loads
from designlab.sensor.led_catalogue import PARTS
from designlab.sensor.parts_file import load_parts

PARTS_TEXT = """
[leds.lab-white]
maker = "Lab"
number = "W-1"
viewing_deg = 100.0
size_mm = [1.6, 0.8]
chips.white = { spectrum = "lab-phosphor", flux_mw = 12.0 }

[leds.lab-red]
number = "R-2"
chips.red = { wavelength_nm = 640.0, width_nm = 18.0, flux_mw = 5.0 }

[spectra.lab-phosphor]
wavelength_nm = [400, 450, 500, 600, 700]
power = [0.0, 1.0, 0.3, 0.6, 0.0]

[filters.lab-filter]
wavelength_nm = [380, 590, 600, 780]
transmittance = [0.9, 0.9, 0.1, 0.1]

[gels.lab-gel]
modulus_mpa = 0.12
method = "indentation"
source = "our press"
"""
DESIGN_TEXT = """
parts = "mine/parts.toml"
camera = { sensitivity = "imx219", filter = "lab-filter" }
contact = { model = "layer", gel = "lab-gel" }
[leds]
part = "lab-white"
[[leds.groups]]
name = "white"
azimuth_deg = [0.0, 180.0]
count = 2
[[leds.groups]]
name = "red"
part = "lab-red"
azimuth_deg = [90.0]
"""


def write(folder, text=PARTS_TEXT):
    (folder / "mine").mkdir(exist_ok=True)
    (folder / "mine" / "parts.toml").write_text(text, encoding="utf-8")
    (folder / "design.toml").write_text(DESIGN_TEXT, encoding="utf-8")
    return folder / "design.toml"


def test_parts_of_ones_own_fill_a_design_as_those_of_the_catalogue_do(tmp_path):
    design = load(write(tmp_path))
    white, red = design.leds.groups
    assert white.spectrum.power[1] == 1.0
    assert white.flux_mw == 12.0 * 4
    assert (red.wavelength_nm, red.width_nm, red.flux_mw) == (640.0, 18.0, 5.0)
    assert design.leds.profile.beam_deg == 100.0
    assert (design.leds.body_width_mm, design.leds.body_height_mm) == (1.6, 0.8)
    assert design.camera.filter.transmittance[0] == 0.9
    assert (design.contact.gel, design.contact.modulus_mpa) == ("custom", 0.12)
    assert design.mixing_matrix.shape == (3, 2)
    assert design.led_part("lab-white").maker == "Lab"


def test_a_design_stays_whole_without_the_file(tmp_path):
    path = write(tmp_path)
    design = load(path)
    (tmp_path / "mine" / "parts.toml").unlink()
    again = loads(dumps(design))
    assert again.digest == design.digest
    np.testing.assert_array_equal(again.mixing_matrix, design.mixing_matrix)
    hash(again)  # caches ask for it
    assert again.replace({"leds.groups.1.part": "lab-white", "leds.groups.1.name": "white2"}) != again


def test_the_names_of_the_catalogue_still_hold_beside_them(tmp_path):
    path = write(tmp_path)
    path.write_text(DESIGN_TEXT.replace('part = "lab-red"', 'part = "kingbright-apt1608ec"'))
    assert load(path).leds.groups[1].wavelength_nm == 627.0
    with pytest.raises(DesignError, match="known are lab-white"):
        load(path).replace({"leds.groups.1.part": "nothing"})


def test_a_file_of_parts_is_listed(tmp_path, capsys):
    write(tmp_path)
    assert main(["parts", str(tmp_path / "mine" / "parts.toml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [part["name"] for part in found["parts"]] == ["lab-white", "lab-red"]
    assert found["filters"] == ["lab-filter"]
    assert found["gels"] == ["lab-gel"]
    assert main(["parts", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["parts"]) == len(PARTS)


@pytest.mark.faults
@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("viewing_deg = 100.0", "viewing_deg = 200.0", ["leds.lab-white.viewing_deg", "200", "180"]),
        ("viewing_deg = 100.0", "angle = 100.0", ["leds.lab-white.angle", "unknown field"]),
        ("flux_mw = 12.0", 'flux_mw = "bright"', ["leds.lab-white.chips.white.flux_mw", "bright", "number"]),
        ("[0.9, 0.9, 0.1, 0.1]", "[90, 90, 10, 10]", ["filters.lab-filter", "transmittance", "90"]),
        ("[400, 450, 500, 600, 700]", "[400, 450]", ["spectra.lab-phosphor", "power", "each of the 2"]),
        ("modulus_mpa = 0.12", "modulus_mpa = -1.0", ["gels.lab-gel.modulus_mpa", "-1"]),
        ("[leds.lab-red]", "[leds.osram-lrtb-g6tg]", ["leds", "osram-lrtb-g6tg", "name of the catalogue"]),
        ("[gels.lab-gel]", "[gel.lab-gel]", ["gel", "unknown field"]),
        ("[leds.lab-white]", "[leds.lab-white", ["not valid TOML"]),
        (PARTS_TEXT, "", ["holds no parts", "[leds.NAME]"]),
    ],
)
def test_a_parts_file_that_is_refused_names_file_field_value_and_rule(tmp_path, old, new, words):
    path = write(tmp_path, PARTS_TEXT.replace(old, new))
    for read in (lambda: load(path), lambda: load_parts(tmp_path / "mine" / "parts.toml")):
        with pytest.raises(ValueError, match=re.escape("parts.toml")) as refused:
            read()
        for word in ["parts.toml", *words]:
            assert word in str(refused.value)


@pytest.mark.faults
@pytest.mark.parametrize("name", ["nowhere.toml", "mine", "../x/parts.toml"])
def test_a_parts_file_that_cannot_be_read_is_named(tmp_path, capsys, name):
    path = write(tmp_path)
    path.write_text(DESIGN_TEXT.replace("mine/parts.toml", name))
    assert main(["evaluate", str(path)]) == 2
    assert name in capsys.readouterr().err
