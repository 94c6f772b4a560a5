"""A wedge core: rays against Snell's law in its plane, light against the path tracer, solid and rules."""

import numpy as np
import pytest

from designlab.sensor.camera import View
from designlab.sensor.design import DesignError, dumps, loads, preset
from designlab.simulation.optics.viewing_rays import rays
from designlab.simulation.simulator import Simulator
from geometries import gelcore

SLAB = preset("default").replace(
    {
        "gelcore.shape": "slab",
        "gelcore.width_mm": 26.0,
        "gelcore.length_mm": 22.0,
        "elastomer.outline": "rectangle",
        "elastomer.width_mm": 26.0,
        "elastomer.length_mm": 22.0,
        "leds.radius_mm": 13.5,
        "leds.height_mm": 4.5,
        "leds.groups.0.azimuth_deg": (0.0,),
        "leds.groups.1.azimuth_deg": (180.0,),
        "leds.groups.2.azimuth_deg": (90.0,),
        "housing.inner_radius_mm": 20.0,
        "housing.camera_hole_mm": 20.0,
        "gelcore.window_diameter_mm": 22.0,
        "gelcore.side_finish": "painted",
    }
)


def wedge(deg, **camera):
    return SLAB.replace(
        {"gelcore.wedge_deg": deg, **{f"camera.{name}": value for name, value in camera.items()}}
    )


@pytest.mark.physics
@pytest.mark.parametrize("deg", [-15.0, 8.0, 20.0])
@pytest.mark.parametrize("tilt_deg", [0.0, 12.0])
def test_rays_through_a_wedge_follow_snells_law_in_its_plane(deg, tilt_deg):
    design = wedge(deg, tilt_deg=(tilt_deg, 0.0), position_mm=(0.0, -2.0, 24.0))
    camera, glass = design.camera, design.glass
    # one column through the axis of the picture
    found = rays(design, View(camera.centre_px[0] - 0.5, 0.0, 1.0, 1232.0, 1, 1232))
    y0, z0 = camera.position_mm[1:]
    for row in (250, 616, 950):
        angle = np.radians(tilt_deg) - np.arctan((row + 0.5 - camera.centre_px[1]) / camera.focal_rows_px)
        # The wedge's face leans by `lean` from level; angles are counted from straight down towards +y.
        lean = np.radians(deg)
        # its normal, downwards, points towards +y by the same angle
        inside = lean + np.arcsin(np.sin(angle - lean) / glass.core_index)
        gel = np.arcsin(glass.core_index * np.sin(inside) / glass.gel_index)
        slope = np.tan(lean)
        drop = (z0 - glass.window_mm - slope * y0) / (1 + slope * np.tan(angle))
        y, z = y0 + drop * np.tan(angle), z0 - drop
        y += (z - glass.interface_mm) * np.tan(inside) + glass.interface_mm * np.tan(gel)
        assert found.y_mm[row, 0] == pytest.approx(y, abs=1e-9)
        assert found.x_mm[row, 0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.physics
@pytest.mark.parametrize("deg", [-12.0, 5.0, 15.0])
def test_points_are_seen_where_the_rays_to_them_leave_from(deg):
    design = wedge(deg)
    view = View(300.0, 200.0, 1000.0, 800.0, 5, 4)
    column, row = view.centres()
    seen = rays(design, view)
    for x, y, c, r in zip(seen.x_mm.flat, seen.y_mm.flat, column.flat, row.flat, strict=True):
        np.testing.assert_allclose(design.project_px(x, y), (c, r), atol=1e-5)


@pytest.mark.physics
def test_a_wedge_that_is_hardly_one_is_a_slab():
    view = SLAB.view(12)
    plane, hardly = rays(SLAB, view), rays(wedge(1e-6), view)
    np.testing.assert_allclose(hardly.x_mm, plane.x_mm, atol=1e-6)
    np.testing.assert_allclose(hardly.y_mm, plane.y_mm, atol=1e-6)


@pytest.mark.parametrize("deg", [-15.0, 10.0, 25.0])
def test_the_solid_is_the_block_below_the_inclined_plane(deg):
    core = wedge(deg).gelcore
    solid = gelcore.solid(core).val()
    assert solid.isValid()
    assert solid.Volume() == pytest.approx(core.width_mm * core.length_mm * core.height_mm)
    centre = core.length_mm**2 * np.tan(np.radians(deg)) / 12 / core.height_mm
    assert solid.Center().y == pytest.approx(centre)


@pytest.mark.physics
@pytest.mark.renders
@pytest.mark.usefixtures("backend")
@pytest.mark.full
@pytest.mark.parametrize("deg", [-15.0, 10.0, 20.0])
def test_light_in_a_wedge_is_that_of_mitsubas_path_tracer(deg):
    design = wedge(deg).replace({"optics.path_length": 10})
    design.require_feasible()
    view = design.view(16)
    photons = Simulator(design, view=view, samples=256, seed=2).frame(None).basis.mean((1, 2))
    paths = (
        Simulator(design, view=view, samples=40000, seed=2, estimator="path").frame(None).basis.mean((1, 2))
    )
    np.testing.assert_allclose(photons.sum(), paths.sum(), rtol=0.01)


def test_a_wedge_is_written_and_read_and_others_keep_their_digest():
    design = wedge(10.0)
    assert loads(dumps(design)) == design
    assert design.digest != SLAB.digest


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"leds.height_mm": 9.0, "leds.radius_mm": 10.0}, "leds_clear_of_core"),
        ({"housing.top_mm": 11.0}, "core_below_plate"),
        ({"gelcore.window_diameter_mm": 6.0}, "view_through_window"),
        ({"camera.position_mm": (0.0, 8.0, 11.0)}, "camera_above_core"),
    ],
)
def test_the_rules_know_the_wedge(changes, rule):
    design = wedge(20.0)
    assert design.margins()[rule] <= 0
    assert design.replace(changes).margins()[rule] > 0


@pytest.mark.faults
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"gelcore.wedge_deg": 50.0}, ["wedge_deg", "thin end", "height_mm"]),
        ({"gelcore.shape": "hexagonal"}, ["wedge_deg", "slab"]),
        ({"gelcore.draft_deg": 5.0}, ["wedge_deg", "draft_deg"]),
        ({"optics.gelcore_scattering_per_mm": 0.01}, ["gelcore.wedge_deg", "scattering", "0.01"]),
        ({"optics.housing_reflectance": (0.5,)}, ["gelcore.wedge_deg", "housing_reflectance", "0.5"]),
    ],
)
def test_a_wedge_that_cannot_be_meant_is_refused(changes, words):
    with pytest.raises(DesignError) as refused:
        wedge(10.0).replace(changes)
    for word in words:
        assert word in str(refused.value)
