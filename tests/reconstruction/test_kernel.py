"""Kernel regression and its weights, against pictures whose shape is known in closed form."""

import numpy as np
import pytest

from designlab.core.metrics import normal_error_deg
from designlab.reconstruction import fit_kernel, integrate, normals
from designlab.reconstruction.balls import ball_gradients
from designlab.reconstruction.markers import FILLED

SHAPE, PITCH_MM, RADIUS_MM = (100, 120), 0.1, 2.0
AZIMUTHS = np.radians([90.0, 210.0, 330.0])
ROWS, COLUMNS = np.indices(SHAPE)
X_MM, Y_MM = (COLUMNS - 59.5) * PITCH_MM, (49.5 - ROWS) * PITCH_MM
LEVEL = np.stack([1 + 0.05 * (np.cos(a) * X_MM + np.sin(a) * Y_MM) for a in AZIMUTHS], axis=-1)
SLANT = np.radians(55)
TOWARD = np.stack(
    [np.sin(SLANT) * np.cos(AZIMUTHS), np.sin(SLANT) * np.sin(AZIMUTHS), np.full(3, np.cos(SLANT))]
)


def picture(p, q, seed=0, noise=0.002):
    """Lambert's law for three lights, dark where a slope turns away from one (attached shadow)."""
    light = LEVEL * np.maximum(normals(p, q) @ TOWARD, 0)
    return light + noise * np.random.default_rng(seed).standard_normal(light.shape)


def cap(centre_px, contact_px):
    """Height and slopes of a spherical cap; steep at its edge, where lights are shadowed."""
    p, q, r_px = ball_gradients(SHAPE, centre_px, ball_radius_mm=RADIUS_MM, mm_per_px=PITCH_MM)
    inside = r_px < contact_px
    height = np.sqrt(np.maximum(RADIUS_MM**2 - (r_px * PITCH_MM) ** 2, 0)) - np.sqrt(
        RADIUS_MM**2 - (contact_px * PITCH_MM) ** 2
    )
    return np.where(inside, height, 0), np.where(inside, p, 0), np.where(inside, q, 0)


FLAT = np.zeros(SHAPE)
BACKGROUND = LEVEL * np.cos(SLANT)
CENTRES = [(c, r) for c in (28, 60, 92) for r in (26, 50, 74)]
CAPS = [cap(centre, 15.0 - 2.0 * (k % 3)) for k, centre in enumerate(CENTRES)]


@pytest.fixture(scope="module")
def calibration():
    images = [picture(p, q, seed=k) for k, (_, p, q) in enumerate(CAPS)]
    return fit_kernel(images, BACKGROUND, [p for _, p, _ in CAPS], [q for *_, q in CAPS], X_MM, Y_MM)


@pytest.mark.slow
def test_a_cap_at_a_new_place_is_recovered(calibration):
    height, p, q = cap((45, 60), 13.0)
    found = calibration.estimate(picture(p, q, seed=50))
    error = normal_error_deg(normals(found.p, found.q), normals(p, q))
    assert error[height > 0].mean() < 1.5
    assert error[height == 0].mean() < 0.5
    assert np.abs(found.height_mm(pitch_mm=PITCH_MM) - height)[height > 0].mean() < 0.02


@pytest.mark.slow
def test_noisy_pictures_are_read_better_when_they_are_smoothed():
    noise = 0.1  # 17 % of the light
    images = [picture(p, q, seed=k, noise=noise) for k, (_, p, q) in enumerate(CAPS)]
    slopes = [p for _, p, _ in CAPS], [q for *_, q in CAPS]
    height, p, q = cap((45, 60), 13.0)
    inner = height > 0.5 * height.max()
    seen, errors = picture(p, q, seed=50, noise=noise), []
    for smoothing_px in (0.0, 2.0):
        found = fit_kernel(images, BACKGROUND, *slopes, X_MM, Y_MM, smoothing_px=smoothing_px).estimate(seen)
        errors.append(normal_error_deg(normals(found.p, found.q), normals(p, q))[inner].mean())
    assert errors[1] < 0.5 * errors[0]


def test_the_left_out_error_foretells_that_of_new_presses(calibration):
    errors = []
    for seed in range(4):
        centre = tuple(np.random.default_rng(seed).uniform((35, 35), (85, 65)))
        height, p, q = cap(centre, 13.0)
        found = calibration.estimate(picture(p, q, seed=60 + seed))
        errors.append(normal_error_deg(normals(found.p, found.q), normals(p, q))[height > 0].mean())
    assert 0.4 * np.mean(errors) < calibration.error_deg < 2.5 * np.mean(errors)


def test_the_untouched_gel_is_flat(calibration):
    found = calibration.estimate(BACKGROUND)
    np.testing.assert_allclose([found.p, found.q], 0, atol=1e-4)  # single precision
    assert found.weights.min() > 0.2


def test_pixels_that_err_weigh_less(calibration):
    """The inverse of the weight rises with the squared error of presses not calibrated on."""
    height, p, q = cap((70, 40), 14.0)
    found = calibration.estimate(picture(p, q, seed=70))
    error = (np.hypot(found.p - p, found.q - q) ** 2)[height > 0]
    weight = found.weights[height > 0]
    light, heavy = weight < np.median(weight), weight >= np.median(weight)
    assert error[light].mean() > 2 * error[heavy].mean()


def test_masked_markers_are_bridged(calibration):
    height, p, q = cap((60, 50), 13.0)
    image, mask = picture(p, q, seed=72), np.ones(SHAPE, dtype=bool)
    for column, row in ((55, 45), (65, 52), (58, 58)):
        spot = np.hypot(COLUMNS - column, ROWS - row) < 2.5
        image[spot], mask = 0.0, mask & ~spot
    found = calibration.estimate(image, mask=mask)
    assert not found.weights[~mask].any()
    filled = calibration.estimate(image, filled=~mask)
    assert (filled.weights[mask] == found.weights[mask]).all()
    usual = calibration.estimate(image).weights
    np.testing.assert_allclose(filled.weights[~mask], FILLED * usual[~mask])
    even = integrate(found.p, found.q, pitch_mm=PITCH_MM, boundary="dirichlet")
    bridged, spotted = (
        np.abs(h - height)[height > 0].mean() for h in (found.height_mm(pitch_mm=PITCH_MM), even)
    )
    assert bridged < 0.03
    assert bridged < 0.5 * spotted


def test_bad_input_is_refused(calibration):
    images, p, q = [BACKGROUND] * 2, [CAPS[0][1]] * 2, [CAPS[0][2]] * 2
    with pytest.raises(ValueError, match="at least 2 presses"):
        fit_kernel(images[:1], BACKGROUND, p[:1], q[:1], X_MM, Y_MM)
    with pytest.raises(ValueError, match="each press must slope"):
        fit_kernel(images, BACKGROUND, [FLAT, FLAT], [FLAT, FLAT], X_MM, Y_MM)
    with pytest.raises(ValueError, match="must change colour"):
        fit_kernel(images, BACKGROUND, p, q, X_MM, Y_MM)
    with pytest.raises(ValueError, match="image: must have shape"):
        calibration.estimate(BACKGROUND[:-1])
    with pytest.raises(ValueError, match="mask: must be bool"):
        calibration.estimate(BACKGROUND, mask=np.ones((3, 3), dtype=bool))
