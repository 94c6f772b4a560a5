"""Lens models against OpenCV, and against themselves on the way back."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from designlab.sensor.camera import Camera, View, Vignetting
from designlab.sensor.design import DesignError, dumps, loads, preset
from designlab.simulation.optics.viewing_rays import rays

FLAT, DOME, CORE = preset("gelsight-2020-flat"), preset("gelsight-2020-dome"), preset("default")
BARREL = {"k1": -0.32, "k2": 0.11, "k3": -0.012}
PINHOLES = {
    "barrel": (62.0, BARREL),
    "pincushion": (62.0, {"k1": 0.21, "k2": 0.05}),
    "tangential": (70.0, {"k1": -0.2, "k2": 0.05, "k3": 0.003, "p1": 0.004, "p2": -0.007}),
}
FISHEYES = {
    "equidistant": (150.0, {}),
    "narrow": (80.0, {"k1": 0.05}),
    "calibrated": (160.0, {"k1": -0.021, "k2": 0.008, "k3": -0.004, "k4": 0.0006}),
    "beyond the half-space": (200.0, {"k1": -0.01, "k2": -0.002}),
}


def camera_of(lens, fov, coefficients, **fields):
    return Camera(
        width_px=1640,
        height_px=1232,
        horizontal_fov_deg=fov,
        lens=lens,
        distortion=coefficients,
        **fields,
    )


CAMERAS = {f"pinhole {name}": camera_of("pinhole", *case) for name, case in PINHOLES.items()}
CAMERAS |= {f"fisheye {name}": camera_of("fisheye", *case) for name, case in FISHEYES.items()}
CAMERAS["fisheye off centre"] = camera_of("fisheye", 130.0, {"k1": 0.02}, principal_point_px=(800.5, 655.0))
CAMERAS["pinhole off centre"] = camera_of("pinhole", 60.0, {"k1": -0.1}, principal_point_px=(870.0, 590.25))
CAMERAS["plain"] = camera_of("pinhole", 62.0, {})
CAMERAS |= {
    f"pixels {aspect:g}, {name}": camera_of(*case, pixel_aspect=aspect, principal_point_px=(830.0, 600.5))
    for name, aspect, case in (
        ("plain", 0.994, ("pinhole", 62.0, {})),
        ("barrel", 1.02, ("pinhole", 62.0, BARREL)),
        ("tangential", 0.8, ("pinhole", *PINHOLES["tangential"])),
        ("fisheye", 0.9, ("fisheye", *FISHEYES["calibrated"])),
        ("wide fisheye", 1.25, ("fisheye", *FISHEYES["beyond the half-space"])),
    )
}


def opencv(camera):
    """Matrix and coefficients of a camera as OpenCV has them; its places count like those of `Camera`."""
    f, k = camera.focal_px, camera.distortion
    x_c, y_c = camera.principal_point_px or (camera.width_px / 2, camera.height_px / 2)
    matrix = np.array([[f, 0, x_c], [0, f * camera.pixel_aspect, y_c], [0, 0, 1.0]])
    if camera.lens == "fisheye":
        return matrix, np.array([k.k1, k.k2, k.k3, k.k4])
    return matrix, np.array([k.k1, k.k2, k.p1, k.p2, k.k3])


def seen_by_opencv(camera, right, up, forward):
    points = np.stack([right, -up, forward], axis=-1).reshape(-1, 1, 3)
    project = cv2.fisheye.projectPoints if camera.lens == "fisheye" else cv2.projectPoints
    found, _ = project(points, np.zeros(3), np.zeros(3), *opencv(camera))
    return found.reshape(-1, 2)


def picture(camera, step=37):
    column, row = np.meshgrid(
        np.append(np.arange(0.0, camera.width_px, step), camera.width_px),
        np.append(np.arange(0.0, camera.height_px, step), camera.height_px),
    )
    return column.ravel(), row.ravel()


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_every_place_of_the_picture_is_where_opencv_puts_its_direction(camera):
    column, row = picture(camera)
    right, up, forward = camera.unproject(column, row)
    front = forward > 1e-3 * np.hypot(right, up)  # OpenCV knows no direction from the side
    assert front.mean() > 0.6
    expected = seen_by_opencv(camera, right[front], up[front], forward[front])
    np.testing.assert_allclose(np.stack([column, row], axis=-1)[front], expected, atol=1e-6)
    found = camera.project(right[front], up[front], forward[front])
    np.testing.assert_allclose(np.stack(found, axis=-1), expected, atol=1e-6)


@pytest.mark.parametrize("name", ["barrel", "pincushion"])
def test_pinhole_directions_are_those_opencv_finds(name):
    camera = CAMERAS[f"pinhole {name}"]
    column, row = picture(camera)
    matrix, coefficients = opencv(camera)
    points = np.stack([column, row], axis=-1).reshape(-1, 1, 2)
    # OpenCV iterates a fixed point; inside the picture's middle it has converged
    middle = np.hypot(column - 820, row - 616) < 500
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-12)
    found = cv2.undistortPoints(points[middle], matrix, coefficients, criteria=criteria).reshape(-1, 2)
    right, up, forward = camera.unproject(column[middle], row[middle])
    np.testing.assert_allclose(np.stack([right / forward, -up / forward], axis=-1), found, atol=1e-9)


def test_fisheye_directions_are_those_opencv_finds():
    camera = CAMERAS["fisheye calibrated"]
    column, row = picture(camera)
    matrix, coefficients = opencv(camera)
    right, up, forward = camera.unproject(column, row)
    front = forward > 0.2
    points = np.stack([column, row], axis=-1).reshape(-1, 1, 2)[front]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    found = cv2.fisheye.undistortPoints(points, matrix, coefficients, criteria=criteria).reshape(-1, 2)
    seen = np.stack([right / forward, -up / forward], axis=-1)[front]
    np.testing.assert_allclose(seen, found, rtol=1e-8, atol=1e-9)


COEFFICIENT = st.floats(-0.6, 0.6)


@given(
    lens=st.sampled_from(["pinhole", "fisheye"]),
    fov=st.floats(20.0, 150.0),
    radial=st.tuples(COEFFICIENT, COEFFICIENT, COEFFICIENT),
    tangential=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
)
def test_any_lens_is_refused_or_inverted(lens, fov, radial, tangential):
    coefficients = dict(zip(("k1", "k2", "k3"), radial, strict=True))
    if lens == "pinhole":
        coefficients |= dict(zip(("p1", "p2"), tangential, strict=True))
    refused = ""
    try:
        camera = camera_of(lens, fov, coefficients)
    except ValueError as error:
        refused = str(error)
    if refused:
        assert "must be invertible over the picture" in refused
        return
    column, row = picture(camera, step=200)
    np.testing.assert_allclose(camera.project(*camera.unproject(column, row)), (column, row), atol=1e-6)
    # the picture is not folded: places further right look further right
    right, _, _ = camera.unproject(np.linspace(0, 1640, 60), 616.0)
    assert (np.diff(right) > 0).all()


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_the_way_there_is_the_way_back(camera):
    column, row = picture(camera)
    found = camera.project(*camera.unproject(column, row))
    np.testing.assert_allclose(found, (column, row), atol=1e-6)


def test_field_of_view_of_a_fisheye_is_the_true_one():
    for name in FISHEYES:
        camera = CAMERAS[f"fisheye {name}"]
        right, up, forward = camera.unproject(np.array([0.0, 1640.0]), np.array([616.0, 616.0]))
        across = np.degrees(np.arctan2(right, forward))
        assert across[1] - across[0] == pytest.approx(camera.horizontal_fov_deg, abs=1e-6)
        np.testing.assert_allclose(up, 0.0, atol=1e-12)


def test_field_of_view_of_a_pinhole_is_that_of_its_focal_length():
    for name in PINHOLES:
        camera = CAMERAS[f"pinhole {name}"]
        assert camera.focal_px == pytest.approx(820 / np.tan(np.radians(camera.horizontal_fov_deg / 2)))
        # a small angle in the middle of the picture is its tangent times the focal length
        column, row = camera.project(1e-6, 2e-6)
        assert column - 820 == pytest.approx(1e-6 * camera.focal_px, rel=1e-4)
        assert 616 - row == pytest.approx(2e-6 * camera.focal_px, rel=1e-4)


@pytest.mark.parametrize("aspect", [0.8, 0.994, 1.1])
def test_pixel_aspect_is_that_of_opencv_and_counts_rows(aspect):
    # cv2.calibrationMatrixValues: aspectRatio is fy / fx; the horizontal field of view is that of fx
    camera = CAMERAS["plain"].model_copy(update={"pixel_aspect": aspect})
    matrix, _ = opencv(camera)
    fov_x, fov_y, _, _, ratio = cv2.calibrationMatrixValues(matrix, (1640, 1232), 1.0, 1.0)
    assert ratio == pytest.approx(aspect)
    assert fov_x == pytest.approx(62.0, abs=1e-9)
    column, row = camera.project(0.0, np.array([np.tan(np.radians(fov_y / 2)), 0.0]))
    np.testing.assert_allclose(column, 820.0)
    np.testing.assert_allclose(row, [0.0, 616.0], atol=1e-9)
    # vignetting is round in space: the same at the same angle along columns and rows
    dim = camera.model_copy(update={"vignetting": Vignetting(cosine_power=3.0, a1=-0.2)})
    at = [
        dim.vignette(View(x, y, 1e-6, 1e-6, 1, 1))[0, 0] for x, y in ((1220, 616), (820, 616 + 400 * aspect))
    ]
    assert at[0] == pytest.approx(at[1], rel=1e-8)
    assert at[0] < 0.99


def test_square_pixels_leave_digests_as_they_were():
    # recorded before pixels had an aspect
    assert FLAT.digest == "7e757fc64975dd2224b6ea1ccf8492edfd47b2c2990e47920fe6bb612eff6547"
    assert "pixel_aspect" not in repr(FLAT.camera)
    wide = FLAT.replace({"camera.pixel_aspect": 1.02})
    assert wide.digest != FLAT.digest
    assert "pixel_aspect=1.02" in repr(wide.camera)
    assert wide.replace({"camera.pixel_aspect": 1.0}) == FLAT
    assert loads(dumps(wide)) == wide


def test_what_lies_far_outside_does_not_fold_into_the_picture():
    # a strong barrel's polynomial turns back: naive use would put tangent 2 near the centre
    camera = CAMERAS["pinhole barrel"]
    tangent = np.linspace(0.8, 6.0, 60)
    column, _ = camera.project(tangent, 0.0)
    assert (np.diff(column) > 0).all()
    assert (column[tangent > 1.5] > 1640).all()
    assert np.isnan(camera.project(0.1, 0.1, -1.0)).all()


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"camera.distortion.k1": -0.9}, ["distortion", "invertible over the picture", "turns back"]),
        ({"camera.distortion.p1": 0.9}, ["distortion", "invertible over the picture", "tangential"]),
        ({"camera.distortion.k4": 0.1}, ["distortion.k4", "pinhole", "0.1"]),
        (
            {"camera.lens": "fisheye", "camera.distortion.p2": 0.01},
            ["distortion.p2", "fisheye", "0.01"],
        ),
        (
            {"camera.lens": "fisheye", "camera.horizontal_fov_deg": 150.0, "camera.distortion.k1": -0.3},
            ["distortion", "turns back at", "deg from the axis"],
        ),
        ({"camera.lens": "fisheye", "camera.horizontal_fov_deg": 290.0}, ["180 deg"]),
        ({"camera.horizontal_fov_deg": 171.0}, ["horizontal_fov_deg", "170 deg", "171"]),
        ({"camera.lens": "mirror"}, ["camera.lens", "pinhole", "mirror"]),
        ({"camera.vignetting.a1": -1.2}, ["vignetting", "above 0", "-0.2"]),
        (
            {
                "camera.lens": "fisheye",
                "camera.horizontal_fov_deg": 200.0,
                "camera.vignetting.cosine_power": 4.0,
            },
            ["vignetting.cosine_power", "90 deg"],
        ),
        ({"camera.principal_point_px": (2600.0, 900.0)}, ["principal_point_px", "on the sensor", "2600"]),
        ({"camera.pixel_aspect": 1.3}, ["camera.pixel_aspect", "1.25", "1.3"]),
        ({"camera.pixel_aspect": 0.5}, ["camera.pixel_aspect", "0.8", "0.5"]),
        ({"camera.focus_mm": 30.0}, ["focus_mm", "aperture_mm"]),
        ({"camera.f_number": 2.0}, ["focal_length_mm", "together"]),
        (
            {"camera.f_number": 2.0, "camera.focal_length_mm": 3.0, "camera.aperture_mm": 1.0},
            ["aperture_mm", "both"],
        ),
        ({"camera.response.curve": "table"}, ["table", "at least 2"]),
        ({"camera.response": {"curve": "table", "table": (0.0, 0.6, 0.5, 1.0)}}, ["table", "grow", "0.5"]),
        ({"camera.response": {"curve": "table", "table": (0.1, 1.0)}}, ["table", "from 0 to 1", "0.1"]),
        ({"camera.response": {"table": (0.0, 1.0)}}, ["table", "curve"]),
        ({"camera.response": {"curve": "gamma", "gamma": 0.0}}, ["response.gamma", "0.2"]),
    ],
)
def test_bad_values_are_refused_by_name(changes, named):
    with pytest.raises(DesignError) as caught:
        FLAT.replace(changes)
    for text in named:
        assert text in str(caught.value)


LENSES = {
    "barrel": {"camera.distortion": BARREL},
    "fisheye": {"camera.lens": "fisheye", "camera.horizontal_fov_deg": 120.0},
    "wide pixels": {"camera.pixel_aspect": 1.1},
    "high pixels": {"camera.pixel_aspect": 0.9, "camera.distortion": BARREL},
}


@pytest.mark.parametrize("design", [FLAT, CORE], ids=lambda d: d.name)
@pytest.mark.parametrize("changes", LENSES.values(), ids=LENSES)
def test_a_seen_point_is_projected_back_to_its_pixel(design, changes):
    design = design.replace(changes)
    view = design.view(24)
    seen = rays(design, view)
    column, row = view.centres()
    for place in ((0, 0), (3, 17), (view.rows - 1, view.columns - 1), (view.rows // 2, 12)):
        found = design.project_px(seen.x_mm[place], seen.y_mm[place])
        assert found == pytest.approx((column[place], row[place]), abs=1e-6)


@pytest.mark.parametrize("design", [FLAT, CORE, DOME], ids=lambda d: d.name)
@pytest.mark.parametrize("changes", LENSES.values(), ids=LENSES)
def test_the_view_shows_the_whole_sensing_area_and_no_more(design, changes):
    design = design.replace(changes)
    view = design.view(100)
    width, height = design.sensing_area_mm
    random = np.random.default_rng(1)
    along = random.uniform(-0.5, 0.5, (200, 2)) * (width, height)
    on_edge = np.concatenate([along] * 2)
    on_edge[:200, 0], on_edge[200:, 1] = width / 2, -height / 2
    seen = np.array([design.project_px(x, y) for x, y in on_edge])
    pixel = view.width_px / view.columns
    assert seen[:, 0].max() == pytest.approx(view.x_px + view.width_px, abs=pixel)
    assert seen[:, 1].max() == pytest.approx(view.y_px + view.height_px, abs=pixel)
    assert seen[:, 0].max() < view.x_px + view.width_px + 0.05 * pixel


def test_barrel_distortion_moves_the_bounds_of_what_the_camera_sees():
    # a barrel lens shows more than its focal length says, a pincushion less: margins count the true picture
    plain = FLAT.replace({"camera.horizontal_fov_deg": 22.0})
    assert plain.margins()["camera_sees_membrane"] > 0
    barrel = plain.replace({"camera.distortion.k1": -1.5})
    pincushion = plain.replace({"camera.distortion.k1": 3.0})
    sees = "camera_sees_membrane"
    assert barrel.margins()[sees] < plain.margins()[sees] < pincushion.margins()[sees]
    # the corner of the sensing area in the plain camera, moved by the distortion's closed form
    x_c, y_c, z_c = FLAT.camera.position_mm
    far_x, far_y = 8.0 + x_c, 6.0 + y_c
    half = z_c * np.tan(np.radians(11.0))
    for k1, design in ((0.0, plain), (3.0, pincushion)):
        radial = 1 + k1 * (far_x**2 + far_y**2) / z_c**2
        beyond = max(far_x * radial - half, far_y * radial - 0.75 * half)
        assert design.margins()[sees] == pytest.approx(beyond, rel=1e-9)
