import numpy as np
import pytest

from designlab.core.metrics import normal_error_deg
from designlab.reconstruction import blended, gradients_of, integrate, normals


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
    error_um = 1000 * np.abs(recovered - height)[height > 0]
    # the slope jumps from 1.02 to 0 at the rim: half a pixel of it is 20 um
    assert error_um.max() < 20
    assert error_um.mean() < 5


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


@pytest.mark.parametrize("grain", [0.0, 0.005, 0.02])
def test_blended_slopes_err_less_than_those_read_and_those_of_the_height(random, grain):
    """The steep side of a press is read too steep or too flat, as light that grazes it makes it."""
    pitch = 0.05
    x, y = grid(121, 121, pitch, pitch)
    _, p, q = gaussian(x, y)
    near = np.hypot(x - 0.5, y + 0.8) < 2.0
    steep = 0.2 * (p**2 + q**2) / np.hypot(p, q).max()
    read = p + steep + grain * random.normal(size=p.shape), q + grain * random.normal(size=q.shape)
    height = integrate(*read, pitch_mm=pitch, boundary="dirichlet")

    def error_deg(slopes):
        return normal_error_deg(normals(*slopes), normals(p, q))[near].mean()

    found = error_deg(blended(*read, height, pitch_mm=pitch))
    assert found < error_deg(read)
    assert found < error_deg(gradients_of(height, pitch_mm=pitch))


@pytest.mark.parametrize(("pitch", "count"), [((0.05, 0.07), 160), ((0.3, 0.25), 60)])
def test_blended_slopes_of_a_surface_are_its_own_however_coarse(pitch, count):
    """Differences of a height alone err by 0.17 on the coarse grid."""
    _, p, q = gaussian(*grid(count, count, *pitch), centre_mm=(0.1, -0.2))
    height = integrate(p, q, pitch_mm=pitch, boundary="dirichlet")
    found = np.array(blended(p, q, height, pitch_mm=pitch))
    assert np.abs(found - (p, q)).max() < 0.01


def test_blended_slopes_of_a_plane_are_its_own_up_to_the_border():
    x, y = grid(12, 15, 0.1, 0.2)
    p, q = np.full(x.shape, 0.3), np.full(x.shape, -0.2)
    found = blended(p, q, 0.3 * x - 0.2 * y, pitch_mm=(0.1, 0.2))
    np.testing.assert_allclose(found, (p, q), atol=1e-12)


def test_blended_slopes_of_covered_pixels_are_those_of_the_height():
    pitch = (0.05, 0.07)
    height, p, q = gaussian(*grid(120, 90, *pitch))
    mask = np.ones(p.shape, dtype=bool)
    mask[40:60, 30:50] = False
    wrong = np.where(mask, p, 5.0), np.where(mask, q, -5.0)
    found = np.array(blended(*wrong, height, pitch_mm=pitch, mask=mask))
    own = np.gradient(height, pitch[0], axis=1), -np.gradient(height, pitch[1], axis=0)
    np.testing.assert_allclose(found[:, ~mask], np.array(own)[:, ~mask], atol=1e-12)
    np.testing.assert_allclose(found, (p, q), atol=0.02)  # differences blur by the square of the pitch


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
