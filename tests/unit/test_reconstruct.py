import csv

import numpy as np
import pytest

from designlab.images import read_image
from designlab.metrics import height_error, normal_error_deg
from designlab.reconstruct import Terms, fit_calibration, integrate, normals


@pytest.fixture
def random():
    return np.random.default_rng(11)


def grid(rows, columns, pitch_x_mm, pitch_y_mm):
    """Positions (mm) with row 0 at +y, the origin in the middle."""
    x = (np.arange(columns) - (columns - 1) / 2) * pitch_x_mm
    y = ((rows - 1) / 2 - np.arange(rows)) * pitch_y_mm
    return np.meshgrid(x, y)


def consistent_gradients(height, pitch_x_mm, pitch_y_mm):
    """Gradients whose means between neighbours are the exact differences of the height."""
    p, q = np.zeros_like(height), np.zeros_like(height)
    for column in range(height.shape[1] - 1):
        step = (height[:, column + 1] - height[:, column]) / pitch_x_mm
        p[:, column + 1] = 2 * step - p[:, column]
    for row in range(height.shape[0] - 1):
        step = (height[row] - height[row + 1]) / pitch_y_mm
        q[row + 1] = 2 * step - q[row]
    return p, q


def gaussian(x, y, *, depth_mm=0.7, sigma_mm=0.6, centre_mm=(0.5, -0.8)):
    dx, dy = x - centre_mm[0], y - centre_mm[1]
    height = depth_mm * np.exp(-(dx**2 + dy**2) / (2 * sigma_mm**2))
    return height, -dx / sigma_mm**2 * height, -dy / sigma_mm**2 * height


@pytest.mark.parametrize("boundary", ["neumann", "dirichlet"])
@pytest.mark.parametrize("pitch_mm", [(0.05, 0.05), (0.05, 0.07)])
def test_consistent_gradients_give_any_height_back(random, boundary, pitch_mm):
    height = np.zeros((41, 58))
    height[1:-1, 1:-1] = random.random((39, 56))
    p, q = consistent_gradients(height, *pitch_mm)
    recovered = integrate(p, q, pitch_mm=pitch_mm, boundary=boundary)
    np.testing.assert_allclose(recovered, height, atol=1e-9)


@pytest.mark.parametrize("boundary", ["neumann", "dirichlet"])
def test_closed_form_gradients_converge_with_the_square_of_the_pitch(boundary):
    errors = []
    for count in (80, 160, 320):
        pitch = 8.0 / count
        height, p, q = gaussian(*grid(count, count + 10, pitch, pitch))
        recovered = integrate(p, q, pitch_mm=pitch, boundary=boundary)
        errors.append(np.abs(recovered - height).max())
    # 0.05 mm pitch: below 2 um
    assert errors[1] < 0.002
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.1)


def test_a_sphere_cap_keeps_its_depth():
    radius_mm, depth_mm, pitch = 2.0, 0.6, 0.04
    x, y = grid(201, 231, pitch, pitch)
    r_squared = x**2 + y**2
    sphere = np.sqrt(np.maximum(radius_mm**2 - r_squared, 1e-9))
    height = np.maximum(sphere - (radius_mm - depth_mm), 0)
    p, q = np.where(height > 0, -x / sphere, 0), np.where(height > 0, -y / sphere, 0)
    recovered = integrate(p, q, pitch_mm=pitch, boundary="dirichlet")
    error = height_error(recovered, height, height > 0)
    # the slope jumps from 1.02 to 0 at the rim: half a pixel of it is 20 um
    assert error.max_um < 20
    assert error.mae_um < 5


def test_a_tilted_plane_rises_towards_plus_x_and_plus_y():
    x, y = grid(30, 40, 0.1, 0.1)
    recovered = integrate(np.full((30, 40), 0.2), np.full((30, 40), 0.3), pitch_mm=0.1, boundary="neumann")
    np.testing.assert_allclose(recovered, 0.2 * x + 0.3 * y, atol=1e-12)
    assert recovered[0, -1] == recovered.max()  # the upper right corner


def test_curl_is_left_out():
    # a field that no height has, divergence-free between the pixels, leaves the height alone
    x, y = grid(50, 50, 0.1, 0.1)
    height, p, q = gaussian(x, y)
    bump = np.exp(-(x**2 + y**2))
    swirl = integrate(p - 2 * y * bump, q + 2 * x * bump, pitch_mm=0.1) - integrate(p, q, pitch_mm=0.1)
    assert np.abs(swirl).max() < 0.02 * np.abs(height).max()


def test_integrate_refuses_what_it_cannot_use():
    good = np.zeros((5, 6))
    with pytest.raises(ValueError, match=r"got \(5, 6\) and \(6, 5\)"):
        integrate(good, good.T, pitch_mm=0.1)
    with pytest.raises(ValueError, match="must be finite, 1 of 30 pixels are not"):
        integrate(np.where(np.arange(30).reshape(5, 6) == 3, np.nan, good), good, pitch_mm=0.1)
    with pytest.raises(ValueError, match="must be positive, got 0 and 0 mm"):
        integrate(good, good, pitch_mm=0.0)
    with pytest.raises(ValueError, match="neumann or dirichlet, got 'open'"):
        integrate(good, good, pitch_mm=0.1, boundary="open")


def test_normals_follow_the_sign_convention(random):
    # a surface that rises to the right faces left
    np.testing.assert_allclose(normals(1.0, 0.0), [-np.sqrt(0.5), 0, np.sqrt(0.5)])
    field = normals(random.normal(size=(4, 5)), random.normal(size=(4, 5)))
    np.testing.assert_allclose(np.linalg.norm(field, axis=-1), 1.0)


SHAPE, PITCH_MM, RADIUS_MM = (110, 130), 0.1, 3.0
X, Y = grid(*SHAPE, PITCH_MM, PITCH_MM)
ALBEDO = np.array([0.6, 0.5, 0.4])
AZIMUTHS = np.radians([0.0, 120.0, 240.0])


def ball(centre_mm, depth_mm):
    """Height, gradients and contact of a ball pressed into a gel that closes around it."""
    dx, dy = X - centre_mm[0], Y - centre_mm[1]
    sphere = np.sqrt(np.maximum(RADIUS_MM**2 - dx**2 - dy**2, 1e-9))
    height = np.maximum(sphere - (RADIUS_MM - depth_mm), 0)
    contact = height > 0
    return height, np.where(contact, -dx / sphere, 0), np.where(contact, -dy / sphere, 0), contact


def distant_lights(p, q):
    """Lambert's law for three lights at infinity, 50 deg from the normal, one a colour."""
    slant = np.radians(50)
    toward = np.stack(
        [np.sin(slant) * np.cos(AZIMUTHS), np.sin(slant) * np.sin(AZIMUTHS), np.full(3, np.cos(slant))]
    )
    return ALBEDO * np.maximum(normals(p, q) @ toward, 0)


def near_lights(p, q):
    """Lambert's law with inverse squares for three point lights 12 mm off the axis, 10 mm high."""
    channels = []
    for azimuth in AZIMUTHS:
        lamp_x, lamp_y = 12 * np.cos(azimuth), 12 * np.sin(azimuth)
        toward = np.stack([lamp_x - X, lamp_y - Y, np.full_like(X, 10.0)], axis=-1)
        distance = np.linalg.norm(toward, axis=-1)
        cosine = np.sum(normals(p, q) * toward, axis=-1) / distance
        channels.append(np.maximum(cosine, 0) * 100 / distance**2)
    return ALBEDO * np.stack(channels, axis=-1)


def calibrate_on_balls(light, presses, **options):
    flat = np.zeros(SHAPE)
    truths = [ball(*press) for press in presses]
    everywhere = np.ones(SHAPE, dtype=bool)
    return fit_calibration(
        [light(p, q) for _, p, q, _ in truths],
        light(flat, flat),
        [p for _, p, _, _ in truths],
        [q for _, _, q, _ in truths],
        [everywhere] * len(truths),
        X,
        Y,
        **options,
    )


PRESSES = [((x, y), 0.4) for x in (-3.6, 0.0, 3.6) for y in (-2.8, 0.0, 2.8)]


@pytest.mark.parametrize(
    ("light", "mean_deg", "worst_deg"), [(distant_lights, 0.2, 1.0), (near_lights, 0.5, 2.5)]
)
def test_lambertian_balls_and_a_new_shape_are_recovered(light, mean_deg, worst_deg):
    calibration = calibrate_on_balls(light, PRESSES)
    assert calibration.error_deg < 2 * mean_deg
    for truth in (
        ball((1.3, -1.1), 0.35),
        (*gaussian(X, Y, sigma_mm=1.1, depth_mm=0.8), np.ones(SHAPE, dtype=bool)),
    ):
        height, p, q, contact = truth
        estimated = calibration.gradients(light(p, q))
        error_deg = normal_error_deg(normals(*estimated), normals(p, q))[contact]
        assert error_deg.mean() < mean_deg
        assert error_deg.max() < worst_deg
        recovered = integrate(*estimated, pitch_mm=PITCH_MM, boundary="dirichlet")
        assert height_error(recovered, height, contact).rmse_um < 0.03 * 1000 * height.max()


def test_the_untouched_gel_is_flat_whatever_the_noise_of_the_calibration(random):
    def noisy(p, q):
        return near_lights(p, q) + 0.002 * random.normal(size=(*SHAPE, 3))

    calibration = calibrate_on_balls(noisy, PRESSES)
    p, q = calibration.gradients(calibration.background)
    assert np.abs(p).max() == 0
    assert np.abs(q).max() == 0


def test_the_scale_of_the_images_does_not_matter():
    plain = calibrate_on_balls(near_lights, PRESSES)
    scaled = calibrate_on_balls(lambda p, q: 1e-4 * near_lights(p, q), PRESSES)
    _, p, q, _ = ball((1.0, 1.0), 0.3)
    for a, b in zip(
        plain.gradients(near_lights(p, q)), scaled.gradients(1e-4 * near_lights(p, q)), strict=True
    ):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_left_out_error_foretells_the_error_on_new_presses(random):
    def noisy(p, q):
        return near_lights(p, q) * (1 + 0.03 * random.normal(size=(*SHAPE, 3)))

    def random_presses(count):
        return [((random.uniform(-4.5, 4.5), random.uniform(-3.5, 3.5)), 0.4) for _ in range(count)]

    calibration = calibrate_on_balls(noisy, random_presses(16))
    errors = []
    for press in random_presses(16):
        _, p, q, contact = ball(*press)
        error_deg = normal_error_deg(normals(*calibration.gradients(noisy(p, q))), normals(p, q))
        errors.append(error_deg[contact].mean())
    assert np.mean(errors) == pytest.approx(calibration.error_deg, rel=0.15)


def test_rich_terms_are_chosen_only_where_they_pay(random):
    def linear(p, q):
        """Intensity proportional to the gradients, a little noisy."""
        clean = 1 + 0.2 * np.stack([p, q, p + q], axis=-1)
        return clean + 0.005 * random.normal(size=clean.shape)

    options = {"signals": ["difference"], "position_degrees": [(1,), (4, 4, 4)], "ridges": [1e-8]}
    few = PRESSES[::3]
    assert calibrate_on_balls(linear, few, **options).terms == Terms("difference", (1,))
    options["position_degrees"] = [(1,), (1, 1, 1)]
    assert calibrate_on_balls(distant_lights, PRESSES, **options).terms == Terms("difference", (1, 1, 1))


def test_fit_refuses_what_it_cannot_use():
    flat = np.zeros(SHAPE)
    image = distant_lights(flat, flat)
    _, p, q, _ = ball((0, 0), 0.4)
    mask = np.ones(SHAPE, dtype=bool)

    def fit(images=(image, image), background=image, p=(p, p), q=(q, q), masks=(mask, mask), x=X, **options):
        return fit_calibration(images, background, p, q, masks, x, Y, **options)

    with pytest.raises(ValueError, match="at least 2 presses and equally many, got 1, 2, 2, 2"):
        fit(images=[image])
    with pytest.raises(ValueError, match=r"images\[1\]: must have shape .* got \(110, 129, 3\)"):
        fit(images=[image, image[:, 1:]])
    with pytest.raises(ValueError, match=r"images\[0\]: values must be finite, 42900 are not"):
        fit(images=[image * np.nan, image])
    with pytest.raises(ValueError, match="each press must slope somewhere within its mask"):
        fit(p=[p, flat], q=[q, flat])
    with pytest.raises(ValueError, match="must be finite within the mask"):
        fit(p=[p, p * np.nan])
    with pytest.raises(ValueError, match="background: each channel must have light"):
        fit(background=image * [1, 0, 1])
    with pytest.raises(ValueError, match="x_mm: must vary over the image, it is 0 mm everywhere"):
        fit(x=flat)
    with pytest.raises(ValueError, match="must each hold a candidate"):
        fit(ridges=[])
    with pytest.raises(ValueError, match="difference or ratio, got 'log'"):
        fit(signals=["log"])
    with pytest.raises(ValueError, match=r"image: must have shape .* got \(5, 5, 3\)"):
        fit().gradients(np.ones((5, 5, 3)))


PITCH_PX_MM, BALL_RADIUS_MM, TRUSTED = 0.0592592593, 2.92, 0.85


def cap(centre_px, contact_radius_px, shape):
    """Gradients of the ball, height above its contact circle, and where that truth holds."""
    rows, columns = np.indices(shape)
    dx, dy = (columns - centre_px[0]) * PITCH_PX_MM, (centre_px[1] - rows) * PITCH_PX_MM
    r = np.hypot(dx, dy)
    sphere = np.sqrt(np.maximum(BALL_RADIUS_MM**2 - r**2, 1e-9))
    contact = r < contact_radius_px * PITCH_PX_MM
    rim = np.sqrt(BALL_RADIUS_MM**2 - (contact_radius_px * PITCH_PX_MM) ** 2)
    height = np.where(contact, sphere - rim, 0)
    return np.where(contact, -dx / sphere, 0), np.where(contact, -dy / sphere, 0), height, r / PITCH_PX_MM


def calibrate_on_measured_balls(folder):
    background = read_image(folder / "background.png")
    images, p, q, masks = [], [], [], []
    with (folder / "balls.csv").open() as file:
        for row in csv.DictReader(file):
            radius_px = float(row["contact_radius_px"])
            centre_px = float(row["centre_column_px"]), float(row["centre_row_px"])
            ball_p, ball_q, _, r_px = cap(centre_px, radius_px, background.shape[:2])
            images.append(read_image(folder / row["file"]))
            p.append(ball_p)
            q.append(ball_q)
            # around the contact the membrane sags, unknown how much; far away it is flat
            masks.append((r_px < TRUSTED * radius_px) | (r_px > 2.5 * radius_px))
    x_mm, y_mm = grid(*background.shape[:2], PITCH_PX_MM, PITCH_PX_MM)
    return fit_calibration(images, background, p, q, masks, x_mm, y_mm)


@pytest.mark.measured
def test_measured_presses_of_known_depth(measured_dir):
    """Balls calibrate, presses of known depth judge.

    The gel follows the ball only up to about sqrt(R d) (Hertz). Beyond it the membrane is flatter than the
    cap that counts as truth, which the wider circle includes.
    """
    folder = measured_dir / "thu"
    calibration = calibrate_on_measured_balls(folder)
    rmse_mm, angle_deg, hertz_deg = [], [], []
    for depth_mm in (0.25, 0.5, 0.75, 1.0):
        p, q = calibration.gradients(read_image(folder / f"press_sphere_{depth_mm}.png"))
        contact_px = np.sqrt(depth_mm * (2 * BALL_RADIUS_MM - depth_mm)) / PITCH_PX_MM
        true_p, true_q, true_mm, r_px = cap((208, 166), contact_px, p.shape)
        inside = r_px < TRUSTED * contact_px
        error_deg = normal_error_deg(normals(p, q), normals(true_p, true_q))
        angle_deg.append(error_deg[inside].mean())
        hertz_px = np.sqrt(BALL_RADIUS_MM * depth_mm) / PITCH_PX_MM
        hertz_deg.append(error_deg[r_px < TRUSTED * hertz_px].mean())
        height_mm = integrate(p, q, pitch_mm=PITCH_PX_MM, boundary="dirichlet")
        rmse_mm.append(height_error(height_mm, true_mm, inside).rmse_um / 1000)
        p, q = calibration.gradients(read_image(folder / f"press_prism_{depth_mm}.png"))
        face = np.zeros(p.shape, dtype=bool)
        face[114:221, 172:243] = True
        height_mm = integrate(p, q, pitch_mm=PITCH_PX_MM, boundary="dirichlet")
        rmse_mm.append(height_error(height_mm, np.full(p.shape, depth_mm), face).rmse_um / 1000)
    print(
        f"height RMSE {np.mean(rmse_mm):.4f} mm, normals {np.mean(angle_deg):.2f} deg, "
        f"within the Hertz circle {np.mean(hertz_deg):.2f} deg"
    )
    assert np.mean(rmse_mm) <= 0.052
    assert np.mean(angle_deg) <= 5.2
    assert np.mean(hertz_deg) <= 3.8
