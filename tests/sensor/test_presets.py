"""Presets against the published figures of the sensors they stand for."""

import re

import numpy as np
import pytest

from designlab.sensor.design import (
    assumed_fields,
    assumptions,
    dumps,
    loads,
    preset,
    preset_names,
    preset_text,
)
from designlab.simulation.optics.viewing_rays import rays
from geometries.leds import emitters

PUBLISHED = ("gelsight-2020-flat", "gelsight-2020-dome")
CORES = tuple(f"{name}-core" for name in PUBLISHED)
# arXiv 2012.13184 and the public scene files: radiance of each panel in its own colour, and its azimuth
RADIANCE = {"red": 5.237, "green": 6.735, "blue": 6.839}
AZIMUTH_DEG = {"red": 90.0, "green": 210.0, "blue": 330.0}
PIXEL_MM = 0.0159
LIKE = (
    "difftactile-dome-like",
    "digit-like",
    "digit360-like",
    "gelsight-mini-like",
    "gelsight-wedge-like",
    "gelslim-3-like",
    "pbr-fingertip-like",
    "rainbowsight-like",
)


def test_names():
    assert preset_names() == (
        "default",
        "difftactile-dome-like",
        "digit-like",
        "digit360-like",
        "gelsight-2020-dome",
        "gelsight-2020-dome-core",
        "gelsight-2020-dome-core-elastic",
        "gelsight-2020-dome-elastic",
        "gelsight-2020-flat",
        "gelsight-2020-flat-core",
        "gelsight-2020-flat-core-elastic",
        "gelsight-2020-flat-elastic",
        "gelsight-mini-like",
        "gelsight-wedge-like",
        "gelslim-3-like",
        "pbr-fingertip-like",
        "rainbowsight-like",
    )


@pytest.mark.parametrize("name", preset_names())
def test_a_preset_is_feasible_named_and_reads_back(name):
    design = preset(name)
    assert design.name == name
    assert design.description
    design.require_feasible()
    assert loads(dumps(design)) == design


@pytest.mark.parametrize("name", [*PUBLISHED, *CORES, *LIKE])
def test_every_figure_of_a_published_sensor_says_where_it_is_from(name):
    choices = (
        "package",
        "layout",
        "shape",
        "outline",
        "name",
        "description",
        "model",
        "gel",
        "kernel_m",
        "pitch_mm",
        "light_path",
    )
    whole_table = False
    for line in preset_text(name).splitlines():
        if line.startswith("["):
            whole_table = "assumption" in line or "[P]" in line
        if "=" not in line or line.startswith(("#", "name", "description")) or whole_table:
            continue
        if line.split("=")[0].strip() in (*choices, "mixing"):
            continue
        assert re.search(
            r"\[[A-Z]\]|assumption|radiance|measured|as above|default preset|presets of", line
        ), line


@pytest.mark.parametrize("name", PUBLISHED)
def test_with_the_core_in_the_path_of_light_only_what_must_differ_does(name):
    released, core = (preset(n).model_dump() for n in (name, f"{name}-core"))
    different = set()
    for part, content in released.items():
        if not isinstance(content, dict):
            continue
        different |= {f"{part}.{field}" for field in content if content[field] != core[part][field]}
    assert different - {"housing.inner_radius_mm"} == {
        "leds.radius_mm",
        "leds.coupling",
        "optics.light_path",
        "optics.path_length",
        "camera.exposure",
    } - ({"leds.coupling"} if name == "gelsight-2020-dome" else set())
    assert released["leds"]["groups"] == core["leds"]["groups"]


@pytest.mark.parametrize("name", PUBLISHED)
def test_panels_have_the_published_radiance(name):
    design = preset(name)
    area = {group: 0.0 for group in design.group_names}
    for strip in emitters(design.leds):
        area[design.group_names[strip.group]] += strip.area_mm2
    for group in design.leds.groups:
        # two strips of 9.0 x 2.23 mm, Lambertian: flux = pi x area x radiance
        assert area[group.name] == pytest.approx(2 * 9.0 * 2.23)
        radiance = group.flux_mw / (np.pi * area[group.name])
        assert radiance == pytest.approx(RADIANCE[group.name], rel=1e-4)


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_green_panels_red_light(name):
    design = preset(name)
    red, green, _ = design.per_group("membrane_albedo")
    # 0.171 of red from the green panel falls on the red albedo, the basis image has the green one
    expected = 0.171 / 6.735 * red / green
    assert design.mixing_matrix[0, 1] == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("name", PUBLISHED)
def test_panels_stand_where_published(name):
    design = preset(name)
    for strip in emitters(design.leds):
        azimuth = np.radians(AZIMUTH_DEG[design.group_names[strip.group]])
        outward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        # panels face the axis, tilted 19 deg towards the membrane
        tilt = np.radians(19.0)
        np.testing.assert_allclose(strip.normal, -np.cos(tilt) * outward - [0, 0, np.sin(tilt)], atol=1e-12)
        # strips at -3.12..-0.89 and 0.94..3.17 along the height, from a centre 12.59 mm out and 8.79 mm up
        along = (np.array(strip.centre_mm) - (12.59 * outward + [0, 0, 8.79])) @ np.array(strip.down)
        low, high = along - strip.half_height_mm, along + strip.half_height_mm
        assert (round(low, 6), round(high, 6)) in {(-3.12, -0.89), (0.94, 3.17)}
        assert strip.down[2] < 0


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_pixel_sees_the_published_length(name):
    design = preset(name)
    seen = rays(design, design.camera.full_view()._replace(columns=1296, rows=972))
    assert seen.pitch_mm == pytest.approx((2 * PIXEL_MM, 2 * PIXEL_MM), rel=3e-3)


def test_the_published_crop_shows_the_published_press():
    # A crop of 600 x 600 px at column 1324, row 970 is centred on a triangle pressed at (1.510, 1.353) mm,
    # to a few pixels of 0.016 mm.
    design = preset("gelsight-2020-flat")
    column, row = design.project_px(1.510, 1.353)
    assert column == pytest.approx(1324, abs=4)
    assert row == pytest.approx(970, abs=4)


@pytest.mark.parametrize(
    ("name", "across_mm"),
    [
        # 12.3 px per mm in a frame of 320 px, measured by others on a Mini (paulotto/canfnet)
        ("gelsight-mini-like", 320 / 12.3),
        # 16 mm across, by the paper on DIGIT
        ("digit-like", 16.0),
    ],
)
def test_a_camera_sees_as_much_of_the_gel_as_the_sensors_does(name, across_mm):
    design = preset(name)
    seen = rays(design, design.camera.full_view()._replace(columns=80, rows=60))
    middle = seen.x_mm[seen.x_mm.shape[0] // 2]
    pitch = np.diff(middle).mean()
    assert np.ptp(middle) + pitch == pytest.approx(across_mm, rel=0.06)


@pytest.mark.parametrize("name", LIKE)
def test_what_a_preset_assumes_is_a_field_of_it_and_is_listed(name):
    content = preset(name).model_dump()
    found = assumptions(name)
    assert len(found) >= 10
    for path in found:
        node = content
        for key in path.split("."):
            node = node[int(key)] if key.isdigit() else node[key]


@pytest.mark.parametrize("name", ["digit360-like", "gelsight-wedge-like", "rainbowsight-like"])
def test_a_figure_that_was_measured_is_no_longer_assumed(name):
    design = preset(name)
    assert "elastomer.thickness_mm" in assumed_fields(design)
    changed = design.replace({"contact.modulus_mpa": 0.3, "optics.membrane_albedo": (0.41,)})
    assert set(assumed_fields(design)) - set(assumed_fields(changed)) == {"optics.membrane_albedo"}
    assert assumed_fields(preset("default")) == assumptions("default")


def test_the_domes_from_public_files_have_their_radii():
    digit, soft = preset("digit360-like"), preset("difftactile-dome-like")
    assert digit.elastomer.radius_mm == 12.5
    assert digit.elastomer.thickness_mm + digit.gelcore.height_mm == 17.5 + 8.5
    assert (soft.elastomer.radius_mm, soft.gelcore.radius_mm) == (15.0, 7.5)
    assert soft.camera.focal_px == pytest.approx(173913.04 * 8.627e-4, rel=1e-3)
