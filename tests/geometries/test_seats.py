"""Seats in the housing: where they stand, and that what is built of them is one closed solid."""

import numpy as np
import pytest
from pydantic import ValidationError

from designlab.sensor import seating
from designlab.sensor.design import preset
from geometries import camera_head, gelcore, seats
from geometries.blocks import Ring, ring
from geometries.housing import Housing, Seats
from geometries.mesh import from_solid

SEATED = ("default", "gelsight-mini-like", "gelsight-2020-dome-core-elastic", "pbr-fingertip-like")


@pytest.mark.parametrize(
    ("given", "fit", "gap"),
    [({}, "fdm", 0.2), ({"fit": "sla"}, "sla", 0.1), ({"clearance_mm": 0.3}, "fdm", 0.3)],
)
def test_the_fit_gives_the_gap(given, fit, gap):
    found = Housing(seats=given).seats
    assert found.fit == fit
    assert found.gap_mm == gap


def test_a_switch_takes_the_defaults_and_a_housing_without_it_is_a_tube():
    assert Housing(seats=True).seats == Seats()
    assert Housing(seats=False) == Housing()
    assert Housing().seats is None


@pytest.mark.faults
@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"fit": "cnc"}, "fit"),
        ({"collar_wall_mm": 0.2}, "collar_wall_mm"),
        ({"clearance_mm": 0.0}, "clearance_mm"),
        ({"stops": "tabs"}, "stops"),
    ],
)
def test_what_is_no_seat_is_refused_by_field(given, named):
    with pytest.raises(ValidationError, match=named):
        Housing(seats=given)


@pytest.mark.parametrize("name", SEATED)
def test_the_collar_stands_around_the_clear_window_on_the_core(name):
    design = preset(name)
    within = seating.inside(design)
    window_mm = design.elastomer.thickness_mm + design.gelcore.height_mm
    collar = within.collar
    assert collar.inner_mm == design.gelcore.window_diameter_mm / 2
    assert collar.high_mm == design.housing.top_mm
    reached = min([collar.low_mm, *(foot.low_mm for foot in within.feet)])
    assert reached == pytest.approx(window_mm)


@pytest.mark.parametrize("name", SEATED[:3])
def test_tabs_keep_the_gap_to_the_core_and_stand_beside_no_led(name):
    design = preset(name)
    within, gap = seating.inside(design), design.housing.seats.gap_mm
    outline = gelcore.polygon(design.gelcore)
    edge = np.roll(outline, -1, axis=0) - outline
    outward = np.column_stack([edge[:, 1], -edge[:, 0]]) / np.linalg.norm(edge, axis=1, keepdims=True)
    assert len(within.tabs_deg) >= 3
    for tab in within.tabs:
        if tab.high_mm < design.housing.top_mm:  # beside the core
            beyond = ((tab.outline[:, None] - outline[None]) * outward[None]).sum(-1).max(axis=1)
            assert beyond.min() == pytest.approx(gap, abs=2e-3)
    azimuths = [group_deg for group in design.leds.groups for group_deg in group.azimuth_deg]
    for place in within.tabs_deg:
        assert min(abs((place - azimuth + 180) % 360 - 180) for azimuth in azimuths) > 10


def test_light_from_above_leaves_feet_between_the_rows():
    within = seating.inside(preset("pbr-fingertip-like"))
    assert len(within.feet) == 3
    assert within.collar.low_mm == pytest.approx(15.645)  # the fronts of its LEDs


@pytest.mark.parametrize(
    ("places", "gap"), [((), 360.0), ((20.0,), 360.0), ((0.0, 180.0), 180.0), ((10.0, 100.0, 250.0), 150.0)]
)
def test_the_widest_gap_between_places(places, gap):
    assert seats.widest_gap_deg(places) == pytest.approx(gap)


@pytest.mark.slow
@pytest.mark.parametrize("fit", ["fdm", "sla"])
@pytest.mark.parametrize("outline", ["round", "rectangle"])
@pytest.mark.parametrize("fastening", ["insert", "self_tapping"])
def test_body_and_lid_are_one_closed_solid_each_whose_holes_are_the_designs(fit, outline, fastening):
    options = {"fit": fit, "outline": outline, "fastening": fastening}
    design = preset("default").replace({"housing.seats": options})
    mount = seating.mount(design)
    body = seats.body(design.housing, seating.inside(design), [], [], mount)
    lid = camera_head.lid(design.housing, mount)
    for work in (body, lid):
        assert len(work.vals()) == 1
        assert work.val().isValid()
        assert from_solid(work, tolerance_mm=0.02).is_watertight
    box = body.val().BoundingBox()
    assert (box.zmin, box.zmax) == pytest.approx((design.housing.bottom_mm, mount.seat_mm), abs=1e-6)
    holes = [face for face in body.val().Faces() if face.geomType() == "CYLINDER"]
    hole_mm = camera_head.screw_hole_mm(design.housing.seats, mount)[0]
    radii = [face._geomAdaptor().Cylinder().Radius() for face in holes]
    assert sum(abs(radius - hole_mm / 2) < 1e-6 for radius in radii) == len(mount.board.holes_mm)
    reach = design.housing.inner_radius_mm + design.housing.wall_mm
    assert box.xmax >= reach - 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("slope_deg", [-10.0, 5.0, 20.0])
def test_the_collar_follows_a_sloping_window(slope_deg):
    slope = np.tan(np.radians(slope_deg))
    collar = ring(Ring(8.0, 9.2, 10.0, 20.0, slope)).val()
    assert collar.isValid()
    mean_height = 20.0 - 10.0  # the plane cuts as much off one side as it leaves on the other
    assert collar.Volume() == pytest.approx(np.pi * (9.2**2 - 8.0**2) * mean_height, rel=1e-6)
