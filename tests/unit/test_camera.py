"""Noise, quantisation and clipping of the camera against their statistics."""

import numpy as np
import pytest
from scipy import stats

from designlab.camera import Camera

PIXELS = 100_000


def flat(value, count=PIXELS):
    return np.full((count, 1, 1), value)


def expose(camera, signal, *, seed=1, count=PIXELS, **options):
    return camera.expose(flat(signal, count), exposure=1.0, seed=seed, **options).astype(float).ravel()


def assert_variance(values, sigma):
    """Sample variance against a predicted one: the chi-squared test, at one in 10000."""
    statistic = (len(values) - 1) * values.var(ddof=1) / sigma**2
    low, high = stats.chi2.ppf([5e-5, 1 - 5e-5], len(values) - 1)
    assert low < statistic < high, np.sqrt(statistic / len(values))


@pytest.mark.parametrize("binned", [1.0, 6.25, 64.0])
@pytest.mark.parametrize("light", [0.02, 0.15, 0.7])
def test_noise_has_the_stated_standard_deviation(light, binned):
    camera = Camera(full_well_e=4700, read_noise_e=8, black_level=0.05, bit_depth=10)
    seen = expose(camera, light, binned=binned)
    sigma = float(camera.noise_sigma(np.array(light + camera.black_level), binned=binned))
    assert_variance(seen, sigma)
    assert seen.mean() == pytest.approx(light + camera.black_level, abs=4 * sigma / np.sqrt(PIXELS))


def test_noise_is_shot_read_and_rounding_noise():
    # Janesick's photon transfer: at 1000 e- the shot noise is sqrt(1000) e-, rounding is step / sqrt(12).
    camera = Camera(full_well_e=10_000, read_noise_e=30, bit_depth=8)
    step_e = 10_000 / 255
    expected_e = np.sqrt(1000 + 30**2 + step_e**2 / 12)
    assert float(camera.noise_sigma(np.array(0.1))) == pytest.approx(expected_e / 10_000, rel=1e-12)


@pytest.mark.parametrize("bit_depth", [6, 10])
def test_a_binned_pixel_is_the_average_of_pixels(bit_depth):
    camera = Camera(full_well_e=4700, read_noise_e=60, bit_depth=bit_depth)
    nine = expose(camera, 0.4, seed=2, count=9 * 20_000).reshape(-1, 9).mean(axis=1)
    once = expose(camera, 0.4, seed=3, count=20_000, binned=9.0)
    assert once.mean() == pytest.approx(nine.mean(), abs=5 * nine.std() / np.sqrt(20_000))
    # F test of two variances, two-sided at one in 10000
    ratio = once.var(ddof=1) / nine.var(ddof=1)
    low, high = stats.f.ppf([5e-5, 1 - 5e-5], 19_999, 19_999)
    assert low < ratio < high


@pytest.mark.parametrize("electrons", [4.0, 40.0, 900.0, 1100.0])
def test_photons_follow_poisson_statistics(electrons):
    camera = Camera(full_well_e=4700, read_noise_e=0, bit_depth=16)
    seen_e = expose(camera, electrons / 4700) * 4700
    assert_variance(seen_e, np.sqrt(electrons))
    # a Poisson variable has skewness 1 / sqrt(mean); the sample skewness of n values scatters by sqrt(6 / n)
    expected = 1 / np.sqrt(electrons) if electrons < 1000 else 0.0
    assert stats.skew(seen_e) == pytest.approx(expected, abs=5 * np.sqrt(6 / PIXELS))


def test_counts_are_whole_and_read_noise_dithers_them():
    camera = Camera(full_well_e=1000, read_noise_e=3, bit_depth=6)
    counts = expose(camera, 0.3) * 63
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-4)
    assert len(np.unique(np.round(counts))) > 3


def test_signal_is_clipped_to_full_scale():
    camera = Camera(read_noise_e=20, bit_depth=12)
    assert (expose(camera, 3.0, count=1000) == 1.0).all()
    assert (expose(camera, 3.0, count=10, noise=False) == 1.0).all()
    dark = expose(camera, 0.0)
    assert dark.min() == 0.0
    # without a black level the negative half of the read noise is lost
    assert np.mean(dark == 0.0) == pytest.approx(0.5, abs=0.05)


def test_black_level_keeps_the_noise_of_the_dark():
    camera = Camera(read_noise_e=20, full_well_e=4700, black_level=0.1, bit_depth=12)
    dark = expose(camera, 0.0)
    assert dark.mean() == pytest.approx(0.1, abs=5 * 20 / 4700 / np.sqrt(PIXELS))
    assert_variance(dark, float(camera.noise_sigma(np.array(0.1))))


def test_without_noise_only_exposure_black_level_and_clipping_act():
    camera = Camera(black_level=0.1, bit_depth=4)
    ramp = np.linspace(0, 2, 50).reshape(5, 10, 1)
    seen = camera.expose(ramp, exposure=0.35, seed=0, noise=False)
    np.testing.assert_allclose(seen, np.minimum(0.35 * ramp + 0.1, 1.0), rtol=1e-6)


def test_the_seed_decides_the_noise():
    camera = Camera()
    first = expose(camera, 0.5, seed=4, count=100)
    np.testing.assert_array_equal(first, expose(camera, 0.5, seed=4, count=100))
    assert (first != expose(camera, 0.5, seed=5, count=100)).any()


def test_focal_length_spans_the_field_of_view():
    camera = Camera(width_px=1000, height_px=500, horizontal_fov_deg=90)
    assert camera.focal_px == pytest.approx(500.0)  # tan 45 deg = 1
    assert camera.full_view() == (0.0, 0.0, 1000.0, 500.0, 1000, 500)
