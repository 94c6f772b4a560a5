"""Viewing rays against pinhole geometry and Snell's law."""

import numpy as np
import pytest

from designlab.sensor.design import preset
from designlab.sensor.refraction import apparent_distance_mm, apparent_tangent, crossing_mm
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.optics.viewing_rays import rays
from geometries.probes import parse

FLAT, CORE, DOME = preset("gelsight-2020-flat"), preset("default"), preset("gelsight-2020-dome")


def surface_of(design, press=None, *, area_mm=(18.0, 14.0), pitch_mm=0.05):
    return indent(design.elastomer, design.contact, press, area_mm=area_mm, pitch_mm=pitch_mm)


def test_in_air_a_pixel_sees_along_a_straight_line():
    seen = rays(FLAT, FLAT.camera.full_view()._replace(columns=324, rows=243))
    x_c, y_c, z_c = FLAT.camera.position_mm
    focal = 1296 / np.tan(np.radians(53.3 / 2))
    # output pixel (10, 20) is 8 sensor pixels wide and high
    assert seen.x_mm[10, 20] == pytest.approx(x_c + (20.5 * 8 - 1296) / focal * z_c)
    assert seen.y_mm[10, 20] == pytest.approx(y_c - (10.5 * 8 - 972) / focal * z_c)
    assert seen.slope_x[10, 20] == pytest.approx(-(20.5 * 8 - 1296) / focal)
    assert seen.binned == pytest.approx(64.0)


def test_rows_run_down_and_columns_right():
    for design in (FLAT, CORE, DOME):
        seen = rays(design, design.view(30))
        assert (np.diff(seen.x_mm, axis=1) > 0).all()
        assert (np.diff(seen.y_mm, axis=0) < 0).all()


@pytest.mark.parametrize("design", [FLAT, CORE], ids=lambda d: d.name)
def test_a_seen_point_is_projected_back_to_its_pixel(design):
    view = design.view(24)
    seen = rays(design, view)
    pixel = view.width_px / view.columns
    for row, column in ((0, 0), (3, 17), (view.rows - 1, view.columns - 1), (view.rows // 2, 12)):
        found = design.project_px(seen.x_mm[row, column], seen.y_mm[row, column])
        expected = view.x_px + (column + 0.5) * pixel, view.y_px + (row + 0.5) * pixel
        assert found == pytest.approx(expected, abs=1e-6)


def test_rays_obey_snells_law_at_every_boundary():
    seen = rays(CORE, CORE.view(40))
    x_c, y_c, _ = CORE.camera.position_mm
    in_gel = np.hypot(seen.slope_x, seen.slope_y)
    sine = 1.41 * np.sin(np.arctan(in_gel))  # n sin(theta): silicone, acrylic, air
    lateral = 2 * in_gel + 8 * np.tan(np.arcsin(sine / 1.49)) + 14 * np.tan(np.arcsin(sine))
    np.testing.assert_allclose(np.hypot(seen.x_mm - x_c, seen.y_mm - y_c), lateral, rtol=1e-12)


def test_glass_brings_things_nearer_by_its_thickness_times_one_minus_one_over_n():
    layers = [(8.0, 1.49), (14.0, 1.0)]
    assert apparent_distance_mm(layers) == pytest.approx(22.0 - 8.0 * (1 - 1 / 1.49))
    # near the axis a sideways distance appears at that distance
    lateral, slope = crossing_mm(np.array([1e-5, 0.0]), layers)
    np.testing.assert_allclose(lateral, apparent_distance_mm(layers), rtol=1e-9)
    np.testing.assert_allclose(slope, 1 / 1.49, rtol=1e-9)


@pytest.mark.parametrize("tangent", [1e-6, 0.1, 1.0, 5.0])
def test_the_way_there_is_the_way_back(tangent):
    layers = [(2.0, 1.41), (8.0, 1.49), (14.0, 1.0)]
    lateral, _ = crossing_mm(np.array(tangent), layers)
    assert apparent_tangent(float(lateral) * tangent, layers) == pytest.approx(tangent, rel=1e-8)


def test_a_ray_meets_the_membrane_on_itself():
    press = Press(probe=parse("sphere:5"), depth_mm=0.8, centre_mm=(5.0, -3.0))
    for design in (FLAT, CORE):
        surface = surface_of(design, press)
        seen = rays(design, design.view(60))
        x, y = seen.hit(surface)
        z = surface.sample(surface.z_mm, x, y)
        np.testing.assert_allclose(x, seen.x_mm + seen.slope_x * z, atol=1e-4)
        np.testing.assert_allclose(y, seen.y_mm + seen.slope_y * z, atol=1e-4)
        assert z.max() > 0.7


def test_on_a_dome_a_pixel_sees_where_the_line_meets_the_sphere():
    seen = rays(DOME, DOME.view(20))
    x, y = seen.hit(surface_of(DOME, pitch_mm=0.1, area_mm=(22.0, 18.0)))
    camera = np.array(DOME.camera.position_mm)
    direction = np.stack([seen.x_mm - camera[0], seen.y_mm - camera[1], np.full_like(x, -camera[2])], axis=-1)
    # line and sphere of radius 35 about (0, 0, 35): the far solution of the quadratic equation
    to_camera = camera - (0, 0, 35.0)
    a, b = (direction**2).sum(-1), direction @ to_camera
    t = (-b + np.sqrt(b**2 - a * (to_camera @ to_camera - 35.0**2))) / a
    np.testing.assert_allclose(x, camera[0] + t * direction[..., 0], atol=2e-4)
    np.testing.assert_allclose(y, camera[1] + t * direction[..., 1], atol=2e-4)


@pytest.mark.parametrize("name", ["pbr-fingertip-like", "digit360-like", "difftactile-dome-like"])
def test_steep_flanks_are_met_where_they_are(name):
    """Rays in the gel are straight: of a sphere they meet what the quadratic equation says."""
    design = preset(name)
    radius, width = design.elastomer.radius_mm, design.elastomer.width_mm
    seen = rays(design, design.view(40))
    x, y = seen.hit(surface_of(design, pitch_mm=0.05, area_mm=(width, width)))
    # (x0 + a z)^2 + (y0 + b z)^2 + (z - R)^2 = R^2, the lower solution
    a = 1 + seen.slope_x**2 + seen.slope_y**2
    b = radius - seen.x_mm * seen.slope_x - seen.y_mm * seen.slope_y
    c = seen.x_mm**2 + seen.y_mm**2
    meets = b**2 > a * c
    z = (b - np.sqrt(np.where(meets, b**2 - a * c, 0.0))) / a
    at = np.hypot(seen.x_mm + seen.slope_x * z, seen.y_mm + seen.slope_y * z)
    looked = meets & (at < radius * np.sin(np.radians(60.0))) & (at < 0.47 * width)
    assert np.degrees(np.arcsin(at[looked].max() / radius)) > 20.0
    off = np.hypot(x - seen.x_mm - seen.slope_x * z, y - seen.y_mm - seen.slope_y * z)
    assert off[looked].max() < 2e-3
