"""The LED library: what it holds, and which fields of a design it fills."""

import json
import math

import pytest

from designlab.app import cli
from designlab.sensor.design import DesignError, dumps, loads
from designlab.sensor.led_catalogue import PARTS, flux_mw
from designlab.sensor.spectra import luminous_efficacy_lm_w

HEAD = """
[leds]
part = "kingbright-aptf1616"
radius_mm = 13.3
"""
GROUPS = """
[[leds.groups]]
name = "red"
azimuth_deg = [90.0]
[[leds.groups]]
name = "green"
azimuth_deg = [210.0]
wavelength_nm = 530.0
[[leds.groups]]
name = "blue"
azimuth_deg = [330.0]
"""


def test_a_part_fills_what_is_not_given():
    leds = loads(HEAD + "body_thickness_mm = 1.1" + GROUPS).leds
    assert (leds.body_width_mm, leds.body_height_mm, leds.body_thickness_mm) == (1.6, 1.6, 1.1)
    assert (leds.emitting_width_mm, leds.emitting_spans_mm) == (1.6, ((-0.8, 0.8),))
    assert [group.wavelength_nm for group in leds.groups] == [640.0, 530.0, 460.0]
    assert [group.width_nm for group in leds.groups] == [20.0, 35.0, 25.0]
    assert leds.profile.is_lambertian  # the sheet's angle is not known


def test_a_design_with_parts_is_whole_and_reads_back():
    design = loads(HEAD + GROUPS)
    again = loads(dumps(design))
    assert again == design
    assert again.digest == design.digest
    # what the part has filled is given now, and stays
    assert design.replace({"leds.tilt_deg": 3.0}).leds.groups == design.leds.groups


def test_naming_another_part_replaces_what_the_first_has_filled():
    design = loads(HEAD + GROUPS)
    other = design.replace({"leds.part": "vishay-vlm1300"})
    fresh = loads((HEAD + GROUPS).replace("kingbright-aptf1616", "vishay-vlm1300"))
    assert other.leds.body_height_mm == 0.8
    assert other.leds.profile.beam_deg == 130.0
    assert [group.wavelength_nm for group in other.leds.groups] == [631.0, 525.0, 470.0]
    assert other.leds.radius_mm == design.leds.radius_mm
    assert other.leds.profile == fresh.leds.profile
    both = design.replace({"leds.part": "vishay-vlm1300", "leds.body_height_mm": 0.9})
    assert both.leds.body_height_mm == 0.9


def test_a_group_may_name_its_own_part():
    own = GROUPS.replace('name = "blue"', 'name = "back"\npart = "osram-gf-cs8pm1"\ncount = 2')
    leds = loads("[camera]\n" + HEAD.replace('part = "kingbright-aptf1616"', "") + own).leds
    assert [group.wavelength_nm for group in leds.groups] == [530.0, 530.0, 730.0]
    assert leds.groups[2].flux_mw == 2 * 231.0
    # half the intensity at half of 80 deg
    assert leds.profile_of(2).power == pytest.approx(math.log(0.5) / math.log(math.cos(math.radians(40.0))))
    assert leds.profile_of(0).is_lambertian


def test_flux_follows_from_intensity_angle_and_spectrum():
    # 405 mcd of a Lambertian red face: pi times that in lumen, at some 220 lm/W
    ws = PARTS["worldsemi-ws2812b"]
    efficacy = luminous_efficacy_lm_w(622.5)
    assert flux_mw(ws, ws.chips["red"]) == pytest.approx(405.0 * math.pi / efficacy, rel=5e-3)
    assert 5.0 < flux_mw(ws, ws.chips["red"]) < 6.5
    stated = PARTS["osram-gf-cs8pm1"]
    assert flux_mw(stated, stated.chips["infrared"]) == 231.0
    unknown = PARTS["kingbright-apfa3010"]  # no wavelength
    assert flux_mw(unknown, unknown.chips["red"]) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAD.replace("aptf1616", "aptf9999") + GROUPS, ["leds.part", "aptf9999", "kingbright-aptf1616"]),
        (HEAD + GROUPS.replace('"red"', '"crimson"'), ["leds.groups.0.wavelength_nm", "red, green, blue"]),
        (
            HEAD.replace("aptf1616", "apfa3010") + GROUPS,
            ["leds.groups.0.wavelength_nm", "no wavelength of APFA3010"],
        ),
        (GROUPS.replace("330.0]", '330.0]\npart = "led"'), ["leds.groups.2.part", "'led'"]),
        ("[leds]\npart = 7\n" + GROUPS, ["leds.part", "string", "7"]),
    ],
)
def test_a_part_that_does_not_do_is_named(text, words):
    with pytest.raises(DesignError) as caught:
        loads(text, source="my.toml")
    for word in ("my.toml", *words):
        assert word in str(caught.value)


@pytest.mark.parametrize("name", PARTS)
def test_every_part_makes_a_design(name):
    entry = PARTS[name]
    groups = "".join(
        f'[[leds.groups]]\nname = "{colour}"\nazimuth_deg = [{120 * k}.0]\n'
        + ("wavelength_nm = 500.0\n" if chip.wavelength_nm is None else "")
        for k, (colour, chip) in enumerate(entry.chips.items())
    )
    mixing = f"mixing = {[[1.0] * len(entry.chips)] * 3}\n"
    leds = loads(f'{mixing}[leds]\npart = "{name}"\n{groups}').leds
    assert entry.source
    if entry.viewing_deg is not None:
        half = leds.profile_of(0).share_per_sr(entry.viewing_deg / 2)
        assert half == pytest.approx(leds.profile_of(0).share_per_sr(0.0) / 2, rel=1e-6)


def test_the_command_lists_every_part_with_its_source(capsys):
    assert cli.main(["parts", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["parts"]
    assert [entry["name"] for entry in listed] == list(PARTS)
    assert cli.main(["parts", "kingbright-aptf1616"]) == 0
    shown = capsys.readouterr().out
    assert "DSAO4460" in shown
    assert "640" in shown
    assert cli.main(["parts", "nope"]) == 2
