"""Each geometric rule can be broken by one change, which it then names; simple margins in closed form."""

import numpy as np
import pytest

from designlab.sensor import feasibility
from designlab.sensor.design import InfeasibleDesign, preset
from designlab.sensor.feasibility import RULES

FLAT, DOME, CORE = (preset(name) for name in ("gelsight-2020-flat", "gelsight-2020-dome", "default"))
TIP = preset("pbr-fingertip-like")
MIRROR = {"centre_mm": (0.0, 0.0, 18.0), "tilt_deg": (-45.0, 0.0), "width_mm": 12.0, "height_mm": 12.0}
FOLDED = CORE.replace(
    {
        "housing.seats": None,
        "camera.position_mm": (0.0, -6.0, 18.0),
        "camera.tilt_deg": (90.0, 0.0),
        "camera.mirror": MIRROR,
    }
)

BREAKING = {
    "leds_inside_housing": (FLAT, {"housing.inner_radius_mm": 13.0}),
    "leds_below_plate": (FLAT, {"leds.height_mm": 37.0}),
    "leds_above_membrane": (FLAT, {"leds.height_mm": 2.0}),
    "leds_clear_of_core": (CORE, {"leds.radius_mm": 12.5}),
    "leds_clear_of_each_other": (CORE, {"leds.pitch_mm": 2.9}),
    "leds_outside_view": (FLAT, {"leds.radius_mm": 6.0}),
    "core_inside_housing": (CORE, {"gelcore.width_mm": 29.0}),
    "core_below_plate": (CORE, {"gelcore.height_mm": 20.5}),
    "elastomer_on_core": (CORE, {"elastomer.width_mm": 26.5}),
    "core_sides": (CORE, {"gelcore.draft_deg": 30.0, "gelcore.height_mm": 22.0}),
    "core_radius": (DOME, {"gelcore.radius_mm": 15.0}),
    "core_height": (DOME, {"gelcore.height_mm": 4.0}),
    "cavity_in_core": (TIP, {"gelcore.cavity_depth_mm": 12.0}),
    "dome_radius": (DOME, {"elastomer.radius_mm": 15.0}),
    "dome_core": (DOME, {"gelcore.radius_mm": 33.2}),
    "sensing_area_on_membrane": (FLAT, {"elastomer.width_mm": 14.0}),
    "camera_sees_membrane": (FLAT, {"camera.horizontal_fov_deg": 20.0}),
    "camera_above_core": (FLAT, {"camera.position_mm": (0.0, 0.0, 13.0)}),
    "camera_clears_plate": (FLAT, {"camera.body_radius_mm": 4.6}),
    "view_through_window": (CORE, {"gelcore.window_diameter_mm": 8.0}),
    "view_through_plate": (FLAT, {"camera.position_mm": (1.103, 1.324, 60.0)}),
    "mirror_fills_view": (FOLDED, {"camera.mirror.width_mm": 2.0}),
    "mirror_above_core": (FOLDED, {"camera.mirror.height_mm": 24.0}),
    "seats_hold_core": (CORE, {"gelcore.window_diameter_mm": 30.0}),
    "seats_centre_core": (CORE, {"leds.groups.0.azimuth_deg": (30.0, 90.0, 150.0, 270.0)}),
    "seats_outside_view": (CORE, {"gelcore.window_diameter_mm": 8.0}),
    "seats_clear_of_leds": (TIP, {"housing.seats.collar_wall_mm": 2.0}),
    "camera_board_fits": (CORE, {"camera.body_radius_mm": 3.0}),
    "camera_board_above_plate": (CORE, {"housing.top_mm": 25.0}),
    "camera_board_above_core": (CORE, {"camera.position_mm": (0.0, 0.0, 11.0)}),
    "minimum_wall": (FLAT, {"housing.wall_mm": 0.7}),
    "minimum_gel": (FLAT, {"elastomer.thickness_mm": 0.4}),
}


def test_every_rule_has_a_case():
    assert set(BREAKING) == set(RULES)


@pytest.mark.parametrize("rule", RULES)
def test_one_change_breaks_a_rule_which_is_named(rule):
    start, change = BREAKING[rule]
    assert start.margins()[rule] <= 0
    broken = start.replace(change)
    assert broken.margins()[rule] > 0
    with pytest.raises(InfeasibleDesign, match=f"{rule}: "):
        broken.require_feasible()


@pytest.mark.parametrize("design", [FLAT, DOME, CORE], ids=lambda d: d.name)
def test_presets_are_feasible(design):
    design.require_feasible()
    assert all(np.isfinite(m) and m <= 0 for m in design.margins().values())


def test_a_margin_grows_with_its_cause():
    steps = [FLAT.replace({"leds.radius_mm": r}).margins()["leds_inside_housing"] for r in (12, 16, 20, 24)]
    assert np.all(np.diff(steps) > 0)


def test_margins_are_distances_in_mm():
    # an upright LED of 3 x 2.8 x 1 mm at 13.3 mm, rows of three at 4 mm pitch: the corner of the outer one
    # lies 14.3 mm out and 5.5 mm aside
    m = CORE.margins()
    assert m["leds_inside_housing"] == pytest.approx(np.hypot(14.3, 5.5) - 16.0)
    assert m["leds_below_plate"] == pytest.approx(6.0 + 1.4 - 22.0)
    assert m["leds_above_membrane"] == pytest.approx(-(6.0 - 1.4))
    assert m["leds_clear_of_core"] == pytest.approx(-0.3)
    assert m["leds_clear_of_each_other"] == pytest.approx(3.0 - 4.0)
    assert m["core_inside_housing"] == pytest.approx(13.0 / np.cos(np.pi / 6) - 16.0)
    assert m["core_below_plate"] == pytest.approx(10.0 - 22.0)
    assert m["camera_above_core"] == pytest.approx(10.0 - 24.0)
    assert m["camera_clears_plate"] == pytest.approx(8.0 - 9.0)
    assert m["minimum_wall"] == pytest.approx(0.8 - 2.0)
    assert m["minimum_gel"] == pytest.approx(0.5 - 2.0)
    # the sensing area's corner against the hexagon's upper flat (13 mm) and its slanted sides
    slanted = 7.0 * np.cos(np.pi / 6) + 5.25 * 0.5
    assert m["sensing_area_on_membrane"] == pytest.approx(slanted - 13.0, abs=2e-3)
    assert "dome_radius" not in m


def test_view_margins_follow_refraction():
    m = CORE.margins()
    # Follow the ray from the camera, 14 mm above the window, through 8 mm of acrylic and 2 mm of silicone:
    # it must end at the corner of the sensing area.
    at_window = m["view_through_window"] + 10.0
    sine = at_window / np.hypot(at_window, 14.0)
    end = at_window + 8 * np.tan(np.arcsin(sine / 1.49)) + 2 * np.tan(np.arcsin(sine / 1.41))
    assert end == pytest.approx(np.hypot(7.0, 5.25), rel=1e-9)
    # it leaves the camera at this angle, against half the field of view; in mm at the apparent distance
    tangent, half = at_window / 14.0, np.tan(np.radians(31.1))
    beyond = max(tangent * 7.0 / 8.75 - half, tangent * 5.25 / 8.75 - half * 1232 / 1640)
    assert m["camera_sees_membrane"] == pytest.approx(beyond * (14 + 8 / 1.49 + 2 / 1.41), rel=1e-9)


def test_a_narrow_window_is_too_narrow_only_because_of_refraction():
    # A straight line to the corner would pass the window 8.75 * 14 / 24 = 5.1 mm from the axis.
    narrow = CORE.replace({"gelcore.window_diameter_mm": 10.6})
    assert narrow.margins()["view_through_window"] > 0


def test_a_wide_board_before_the_view_intrudes_although_its_corners_do_not():
    wide = {"leds.body_width_mm": 40.0, "leds.radius_mm": 5.0, "leds.groups.0.azimuth_deg": (90.0,)}
    m = FLAT.replace(wide).margins()["leds_outside_view"]
    assert m > 0


def test_an_edge_of_the_core_may_pierce_a_wide_board():
    # A board of 26 mm before a hexagon's edge: every corner of the board is outside the core.
    reach = 13.0 / np.cos(np.pi / 6)
    alone = CORE.replace({"leds.groups": CORE.leds.groups[:1], "mixing": ((1.0,),) * 3})
    board = {"leds.groups.0.azimuth_deg": (0.0,), "leds.groups.0.count": 1, "leds.body_width_mm": 26.0}
    one = alone.replace(board)
    for radius, broken in ((reach - 0.2, True), (reach + 0.2, False)):
        margin = one.replace({"leds.radius_mm": radius}).margins()["leds_clear_of_core"]
        assert (margin > 0) == broken
        assert margin == pytest.approx(reach - radius, abs=1e-6)


def test_light_in_air_with_a_dome_sees_its_nearer_corner_wider():
    # corner of the 16 x 12 mm area: 10 mm from the axis, 35 - sqrt(35^2 - 10^2) nearer to the camera
    m = DOME.margins()["camera_sees_membrane"]
    x_c, y_c, z_c = DOME.camera.position_mm
    depth = z_c - (35 - np.sqrt(35**2 - 10**2))
    half = np.tan(np.radians(53.3 / 2))
    beyond = max((8 + x_c) / depth - half, (6 + y_c) / depth - half * 1944 / 2592)
    assert m == pytest.approx(beyond * z_c, rel=1e-9)


def test_the_view_runs_straight_from_the_camera_through_the_plates_hole():
    # corner (-8, -6) of the flat sensor's area is the one farthest from the axis at the plate
    x_c, y_c, z_c = FLAT.camera.position_mm
    share = (z_c - FLAT.housing.top_mm) / z_c
    corners = [
        (x_c + share * (sx * 8 - x_c), y_c + share * (sy * 6 - y_c)) for sx in (-1, 1) for sy in (-1, 1)
    ]
    expected = max(np.hypot(*corner) for corner in corners) - 4.5
    assert FLAT.margins()["view_through_plate"] == pytest.approx(expected, rel=1e-9)
    below = FLAT.replace({"camera.position_mm": (0.0, 0.0, 37.0)})
    assert "view_through_plate" not in below.margins()


def test_leds_of_a_ring_are_checked_against_each_other():
    ring = CORE.replace({"leds.layout": "ring", "leds.pitch_mm": 2.0})
    # The front corners of neighbours of 3 mm on a circle of 13.3 mm meet at this pitch along the arc.
    touching = 2 * 13.3 * np.arctan(1.5 / 13.3)
    for pitch, broken in ((touching - 0.01, True), (touching + 0.01, False)):
        margin = ring.replace({"leds.pitch_mm": pitch}).margins()["leds_clear_of_each_other"]
        assert (margin > 0) == broken


def test_light_in_air_does_not_know_the_core():
    moved = FLAT.replace({"leds.radius_mm": 8.0})
    assert "leds_clear_of_core" not in moved.margins()
    assert "view_through_window" not in moved.margins()


@pytest.mark.parametrize(
    ("changes", "margins"),
    [
        ({"gelcore.width_mm": 17.0, "gelcore.radius_mm": 8.0}, {"core_radius": 0.5}),
        ({"gelcore.radius_mm": 13.0}, {"core_radius": 15.7 - 13.0}),
        ({"gelcore.radius_mm": 15.7, "gelcore.height_mm": 15.7}, {"core_radius": 0.0, "core_height": 0.1}),
        ({"gelcore.width_mm": 24.0, "gelcore.radius_mm": 13.0}, {"core_height": 8.0 + 0.1 - 11.5}),
    ],
)
def test_margins_of_a_domes_core_in_closed_form(changes, margins):
    found = DOME.replace(changes).margins()
    assert {rule: found[rule] for rule in margins} == pytest.approx(margins, abs=1e-12)
    assert "core_sides" not in found


@pytest.mark.parametrize(("shape", "narrowest"), [("hexagonal", 26.0), ("slab", 20.0)])
@pytest.mark.parametrize(("draft_deg", "height_mm"), [(0.0, 8.0), (10.0, 12.0), (30.0, 17.0)])
def test_sides_of_a_drafted_core_leave_a_top(shape, narrowest, draft_deg, height_mm):
    change = {"gelcore.shape": shape, "gelcore.draft_deg": draft_deg, "gelcore.height_mm": height_mm}
    margin = CORE.replace(change).margins()["core_sides"]
    top = narrowest - 2 * height_mm * np.tan(np.radians(draft_deg))
    assert margin == pytest.approx(1.0 - top)
    assert "core_radius" not in CORE.margins()


def test_a_margin_that_cannot_be_told_is_a_broken_rule(monkeypatch):
    monkeypatch.setattr(feasibility, "_camera_margins", lambda design: dict.fromkeys(RULES, np.nan))
    assert set(CORE.broken()) == set(RULES)


SHARED = CORE.replace({f"leds.groups.{k}.azimuth_deg": (90.0, 210.0, 330.0) for k in range(3)})


def test_leds_of_several_groups_share_a_package_where_they_coincide():
    SHARED.require_feasible()
    alone = CORE.replace({"leds.groups": CORE.leds.groups[:1], "mixing": ((1.0,),) * 3})
    rows = alone.replace({"leds.groups.0.azimuth_deg": (90.0, 210.0, 330.0)})
    found, expected = SHARED.margins(), rows.margins()
    assert {rule: found[rule] for rule in expected} == pytest.approx(expected)


@pytest.mark.parametrize(
    "change",
    [
        {"leds.groups.1.azimuth_deg": (91.0, 210.0, 330.0)},
        {"leds.groups.1.height_mm": 6.01},
        {"leds.groups.1.radius_mm": 13.31},
        {"leds.groups.1.tilt_deg": 0.1},
        {"leds.groups.1.pitch_mm": 4.2},
        {"leds.groups.1.azimuth_deg": (90.0, 90.0, 330.0)},
        {"leds.groups.1.count": 4},
    ],
)
def test_leds_that_coincide_only_nearly_overlap(change):
    broken = SHARED.replace(change)
    assert broken.margins()["leds_clear_of_each_other"] > 0
    with pytest.raises(InfeasibleDesign, match="LEDs of different groups share one where place and tilt are"):
        broken.require_feasible()
