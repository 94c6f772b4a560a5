"""Blur of a lens against the thin-lens equation and against averages over its opening."""

import numpy as np
import pytest

from designlab.sensor.camera import Camera
from designlab.sensor.design import preset
from designlab.sensor.refraction import apparent_distance_mm
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.optics.defocus import blur, radius_px
from designlab.simulation.optics.viewing_rays import rays
from geometries.probes import parse

CORE, FLAT, DOME = preset("default"), preset("gelsight-2020-flat"), preset("gelsight-2020-dome")
BALL = Press(probe=parse("sphere:5"), depth_mm=0.8, centre_mm=(2.0, 1.0))
FISHEYE = {"camera.lens": "fisheye", "camera.horizontal_fov_deg": 100.0}


def surface_of(design, press=None):
    return indent(design.elastomer, design.contact, press, area_mm=(26.0, 22.0), pitch_mm=0.05)


def focused(design, share, aperture_mm):
    """Sharp at a share of the apparent distance of the membrane."""
    distance = apparent_distance_mm(design.layers_to_camera(0.0))
    return design.replace({"camera.focus_mm": share * distance, "camera.aperture_mm": aperture_mm})


def opening(count):
    """Points evenly over the opening of a lens of radius 1."""
    axis = (np.arange(count) + 0.5) / count * 2 - 1
    return [(u, v) for u in axis for v in axis if u * u + v * v <= 1]


def pattern(x, y):
    """Radiance on the membrane with detail of 1.5 mm and finer."""
    ring = 0.5 * np.exp(-((x - 3) ** 2 + (y - 2) ** 2) / 0.3)
    return 1 + 0.3 * np.sin(2 * np.pi * x / 1.5) * np.cos(2 * np.pi * y / 2.1) + ring


@pytest.mark.parametrize("design", [FLAT, CORE], ids=lambda d: d.name)
@pytest.mark.parametrize("focus_mm", [12.0, 17.0, 35.0, 300.0])
def test_the_blur_disc_is_the_circle_of_confusion_of_a_thin_lens(design, focus_mm):
    focal_mm, f_number = 3.04, 2.0
    design = design.replace(
        {
            "camera.focal_length_mm": focal_mm,
            "camera.f_number": f_number,
            "camera.focus_mm": focus_mm,
            "camera.position_mm": (0.0, 0.0, design.camera.position_mm[2]),
        }
    )
    distance = apparent_distance_mm(design.layers_to_camera(0.0))
    # Gaussian optics: images of the plane of focus and of the membrane lie at v = 1 / (1 / f - 1 / u)
    sensor_mm, image_mm = (1 / (1 / focal_mm - 1 / u) for u in (focus_mm, distance))
    circle_mm = focal_mm / f_number * abs(sensor_mm - image_mm) / image_mm
    pixel_mm = sensor_mm / design.camera.focal_px
    view = design.view(161)
    found = radius_px(design, view, surface_of(design))
    middle = found[found.shape[0] // 2, 80] * view.width_px / view.columns
    assert middle == pytest.approx(circle_mm / 2 / pixel_mm, rel=2e-3)


def test_without_a_plane_of_focus_all_is_sharp():
    open_lens = CORE.replace({"camera.aperture_mm": 2.0})
    assert open_lens.camera.defocus is None
    assert not radius_px(open_lens, open_lens.view(40), surface_of(open_lens)).any()
    sharp, aside = (
        rays(open_lens, open_lens.view(40)),
        rays(open_lens, open_lens.view(40), lens_point=(1.0, 0.0)),
    )
    np.testing.assert_array_equal(sharp.x_mm, aside.x_mm)


def test_rays_of_a_pixel_meet_in_the_plane_of_focus():
    design = FLAT.replace({"camera.focus_mm": 25.0, "camera.aperture_mm": 3.0})
    view = design.view(30)
    z = design.camera.position_mm[2] - 25.0
    meeting = []
    for point in ((0.0, 0.0), (1.0, 0.0), (-0.6, 0.8)):
        seen = rays(design, view, lens_point=point)
        meeting.append(np.stack([seen.x_mm + z * seen.slope_x, seen.y_mm + z * seen.slope_y]))
        start = seen.x_mm + design.camera.position_mm[2] * seen.slope_x
        np.testing.assert_allclose(start, design.camera.position_mm[0] + 1.5 * point[0], atol=1e-9)
    np.testing.assert_allclose(meeting[1], meeting[0], atol=1e-9)
    np.testing.assert_allclose(meeting[2], meeting[0], atol=1e-9)


@pytest.mark.parametrize("design", [FLAT, DOME, CORE], ids=lambda d: d.name)
@pytest.mark.parametrize("lens", [{}, FISHEYE], ids=["pinhole", "fisheye"])
@pytest.mark.parametrize(("share", "aperture_mm", "limit"), [(0.5, 1.5, 4e-3), (0.8, 1.0, 1.2e-3)])
def test_the_blurred_picture_is_the_average_over_the_opening(design, lens, share, aperture_mm, limit):
    design = focused(design.replace(lens), share, aperture_mm)
    view, surface = design.view(100), surface_of(design, BALL)
    exact = np.mean(
        [pattern(*rays(design, view, lens_point=point).hit(surface)) for point in opening(10)], axis=0
    )
    sharp = pattern(*rays(design, view).hit(surface)).astype(np.float32)
    radius = radius_px(design, view, surface)
    inside = np.s_[9:-9, 9:-9]  # what lies around the picture is not known to `blur`
    error = (blur(sharp[None], radius)[0] / exact - 1)[inside]
    assert error.std() < limit
    assert abs(error.mean()) < limit / 4
    assert (sharp / exact - 1)[inside].std() > 5 * error.std()


@pytest.mark.parametrize("radius", [0.3, 0.8, 1.0, 1.4, 3.0, 7.3])
def test_a_point_becomes_a_disc_of_its_radius(radius):
    image = np.zeros((1, 41, 41), dtype=np.float32)
    image[0, 20, 20] = 1.0
    spread = blur(image, np.full((41, 41), radius))[0].astype(float)
    offset = np.arange(41) - 20.0
    assert spread.sum() == pytest.approx(1.0, rel=1e-6)
    assert (spread >= 0).all()
    for axis in (0, 1):  # variance of a disc along a diameter
        assert (spread.sum(axis=axis) * offset**2).sum() == pytest.approx(radius**2 / 4, rel=0.03)


def test_a_slope_is_kept_up_to_the_edge():
    ramp = np.broadcast_to(1 + 0.1 * np.arange(30.0), (20, 30)).astype(np.float32)
    found = blur(ramp[None], np.broadcast_to(np.linspace(0.0, 4.0, 30), (20, 30)))[0]
    np.testing.assert_allclose(found, ramp, rtol=1e-5)


def test_the_opening_is_focal_length_over_f_number():
    camera = Camera(focal_length_mm=4.0, f_number=2.5, focus_mm=20.0)
    assert camera.opening_mm == pytest.approx(1.6)
    assert camera.defocus == pytest.approx((0.8, 20.0))
