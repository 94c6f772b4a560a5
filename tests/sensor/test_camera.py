"""Noise, quantisation and clipping of the camera against their statistics."""

import numpy as np
import pytest
from scipy import stats

from designlab.core.images import to_srgb
from designlab.sensor.camera import Camera, View
from designlab.sensor.response_curve import Response
from designlab.simulation import imaging

MIXING = next(step for step in imaging.CHAIN if isinstance(step, imaging.Mixing))

PIXELS = 100_000


def flat(value, count=PIXELS):
    return np.full((count, 1, 1), value)


def encoded(camera, radiance, *, seed=1, **options):
    """What the camera reports, its curve not undone."""
    seen = radiance
    for step in imaging.CHAIN[imaging.CHAIN.index(MIXING) + 1 : -1]:
        seen = step.apply(seen, imaging.Capture(camera, seed=seed, **options))
    return seen


def expose(camera, signal, *, seed=1, count=PIXELS, **options):
    return encoded(camera, flat(signal, count), seed=seed, **options).astype(float).ravel()


def sigma_of(camera, light, **options):
    """Standard deviation of what the camera reports, its curve not undone."""
    mean, variance = np.array([light]), np.zeros(1)
    for step in imaging.CHAIN[imaging.CHAIN.index(MIXING) + 1 : -1]:
        mean, variance = step.moments(mean, variance, imaging.Capture(camera, **options))
    return float(np.sqrt(variance[0]))


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
    sigma = sigma_of(camera, light, binned=binned)
    assert_variance(seen, sigma)
    assert seen.mean() == pytest.approx(light + camera.black_level, abs=4 * sigma / np.sqrt(PIXELS))


def test_noise_is_shot_read_and_rounding_noise():
    # Janesick's photon transfer: at 1000 e- the shot noise is sqrt(1000) e-, rounding is step / sqrt(12).
    camera = Camera(full_well_e=10_000, read_noise_e=30, bit_depth=8)
    step_e = 10_000 / 255
    expected_e = np.sqrt(1000 + 30**2 + step_e**2 / 12)
    assert sigma_of(camera, 0.1) == pytest.approx(expected_e / 10_000, rel=1e-12)


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
    assert (expose(camera, 3.0, count=10, seed=None) == 1.0).all()
    dark = expose(camera, 0.0)
    assert dark.min() == 0.0
    # without a black level the negative half of the read noise is lost
    assert np.mean(dark == 0.0) == pytest.approx(0.5, abs=0.05)


def test_black_level_keeps_the_noise_of_the_dark():
    camera = Camera(read_noise_e=20, full_well_e=4700, black_level=0.1, bit_depth=12)
    dark = expose(camera, 0.0)
    assert dark.mean() == pytest.approx(0.1, abs=5 * 20 / 4700 / np.sqrt(PIXELS))
    assert_variance(dark, sigma_of(camera, 0.0))


def test_without_noise_only_exposure_black_level_and_clipping_act():
    camera = Camera(black_level=0.1, bit_depth=4)
    ramp = np.linspace(0, 2, 50).reshape(5, 10, 1)
    seen = encoded(camera, ramp, exposure=0.35, seed=None)
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


GAMMA = {"curve": "gamma", "gamma": 2.2}
SRGB = {"curve": "srgb"}
# steep in the dark, a knee at a quarter, flat above
TABLE = {"curve": "table", "table": (0.0, 0.55, 0.75, 0.88, 1.0)}


@pytest.mark.parametrize("response", [GAMMA, SRGB, TABLE], ids=["gamma", "srgb", "table"])
@pytest.mark.parametrize("bit_depth", [8, 12])
@pytest.mark.parametrize("binned", [1.0, 2.0, 6.25, 64.0])
@pytest.mark.parametrize("light", [0.0, 0.02, 0.21, 0.7])
def test_noise_behind_a_curve_has_the_stated_standard_deviation(light, binned, bit_depth, response):
    camera = Camera(
        full_well_e=4700, read_noise_e=20, black_level=0.03, bit_depth=bit_depth, response=response
    )
    seen = expose(camera, light, binned=binned)
    sigma = sigma_of(camera, light, binned=binned)
    assert_variance(seen, sigma)


@pytest.mark.parametrize("response", [GAMMA, SRGB, TABLE], ids=["gamma", "srgb", "table"])
@pytest.mark.parametrize("light", [0.0, 0.004, 0.3])
def test_a_binned_pixel_behind_a_curve_is_the_average_of_pixels(light, response):
    # without a black level half of the dark noise is cut off before the curve
    camera = Camera(full_well_e=4700, read_noise_e=25, bit_depth=10, response=response)
    nine = expose(camera, light, seed=2, count=9 * 20_000).reshape(-1, 9).mean(axis=1)
    once = expose(camera, light, seed=3, count=20_000, binned=9.0)
    assert once.mean() == pytest.approx(nine.mean(), abs=5 * nine.std() / np.sqrt(20_000))
    ratio = once.var(ddof=1) / nine.var(ddof=1)
    low, high = stats.f.ppf([5e-5, 1 - 5e-5], 19_999, 19_999)
    assert low < ratio < high


def test_far_from_the_knees_noise_is_scaled_by_the_slope_of_the_curve():
    # first-order propagation: gamma 2 at a signal of 1/4 has slope 1
    linear = Camera(full_well_e=1e6, read_noise_e=300, bit_depth=16)
    for signal, slope in ((0.25, 1.0), (0.0625, 2.0)):
        curved = linear.model_copy(update={"response": Response(curve="gamma", gamma=2.0)})
        assert float(curved.response.slope(np.array(signal))) == pytest.approx(slope, rel=1e-6)
        ratio = sigma_of(curved, signal) / sigma_of(linear, signal)
        assert ratio == pytest.approx(slope, rel=2e-3)


def test_gain_and_read_noise_follow_from_a_photon_transfer_curve():
    # variance over mean of pairs of flat pictures: slope 1 / full well, offset the read noise
    camera = Camera(full_well_e=8000, read_noise_e=12, black_level=0.05, bit_depth=12)
    levels = np.linspace(0.05, 0.8, 12)
    pairs = [[expose(camera, level, seed=2 * k + s) for s in (0, 1)] for k, level in enumerate(levels)]
    variance = [np.var(a - b) / 2 for a, b in pairs]
    mean = [(a + b).mean() / 2 - 0.05 for a, b in pairs]
    slope, offset = np.polyfit(mean, variance, 1, w=1 / levels)
    assert 1 / slope == pytest.approx(8000, rel=0.01)
    assert np.sqrt(offset) * 8000 == pytest.approx(12, rel=0.1)


@pytest.mark.parametrize("response", [GAMMA, SRGB, TABLE], ids=["gamma", "srgb", "table"])
def test_a_response_curve_is_undone(response):
    curve = Response(**response)
    signal = np.linspace(0, 1, 1001)
    encoded = curve.encode(signal)
    assert (np.diff(encoded) > 0).all()
    assert encoded[[0, -1]] == pytest.approx([0, 1])
    np.testing.assert_allclose(curve.decode(encoded), signal, atol=1e-12)


def test_srgb_is_the_encoding_of_pictures():
    # IEC 61966-2-1: 18 % grey is 0.4613, the linear toe ends at 0.04045
    curve = Response(curve="srgb")
    assert float(curve.encode(np.array(0.18))) == pytest.approx(0.46136, abs=1e-5)
    assert float(curve.encode(np.array(0.0031308))) == pytest.approx(0.04045, abs=1e-5)
    np.testing.assert_allclose(curve.encode(np.linspace(0, 1, 64)), to_srgb(np.linspace(0, 1, 64)), atol=2e-6)


def test_quantisation_comes_after_the_curve():
    # 4 bits behind gamma 2: levels lie at (k / 15)^2 of the linear signal
    camera = Camera(
        read_noise_e=0.0, full_well_e=1e7, bit_depth=4, response=Response(curve="gamma", gamma=2.0)
    )
    seen = encoded(camera, np.linspace(0, 1, 4000).reshape(-1, 1, 1)).ravel()
    counts = np.unique(np.round(seen * 15, 4))
    np.testing.assert_array_equal(counts, np.arange(16))
    # steps lie half-way between levels: the first count ends at (1.5 / 15)^2
    first = np.linspace(0, 1, 4000)[np.round(seen * 15) == 1].max()
    assert first == pytest.approx((1.5 / 15) ** 2, abs=1e-3)


@pytest.mark.parametrize("power", [3.0, 4.0])
def test_natural_vignetting_is_a_power_of_the_cosine(power):
    camera = Camera(horizontal_fov_deg=90.0, vignetting={"cosine_power": power})
    view = camera.full_view()._replace(columns=41, rows=31)
    factor = camera.vignette(view)
    column, _ = view.centres()
    tangent = (column[15] - 820) / 820  # on the row through the centre
    np.testing.assert_allclose(factor[15], (1 + tangent**2) ** (-power / 2), rtol=1e-9)
    assert factor.max() == pytest.approx(1.0)


def test_polynomial_vignetting_is_one_at_the_centre_and_counts_half_diagonals():
    camera = Camera(
        width_px=1600,
        height_px=1200,
        vignetting={"a1": -0.3, "a2": -0.1, "a3": 0.05},
        horizontal_fov_deg=60.0,
    )
    corner = camera.vignette(View(0.0, 0.0, 0.002, 0.002, 1, 1))
    assert float(corner[0, 0]) == pytest.approx(0.65, abs=1e-5)
    edge = camera.vignette(View(1599.999, 600.0, 0.002, 0.002, 1, 1))  # 0.8 half diagonals away
    assert float(edge[0, 0]) == pytest.approx(1 - 0.3 * 0.64 - 0.1 * 0.64**2 + 0.05 * 0.64**3, abs=1e-5)
    assert float(camera.vignette(View(799.5, 599.5, 1.0, 1.0, 1, 1))[0, 0]) == pytest.approx(1.0)


@pytest.mark.parametrize("position", [(9_192_492.0, 0.0, 24.0), (0.0, 0.0, 3.5e15), (0.0, -4001.0, 24.0)])
def test_a_camera_out_of_reach_is_refused(position):
    with pytest.raises(ValueError, match="position_mm"):
        Camera(position_mm=position)


TILTS = [(4.0, 0.0), (0.0, -7.0), (12.0, 5.0)]
TILTED = {"position_mm": (0.0, 0.0, 30.0), "principal_point_px": (800.0, 630.0)}


@pytest.mark.slow
@pytest.mark.parametrize("tilt_deg", TILTS)
@pytest.mark.parametrize("lens", ["pinhole", "fisheye"])
def test_a_tilted_camera_sees_where_it_projects(tilt_deg, lens):
    camera = Camera(tilt_deg=tilt_deg, lens=lens, distortion={"k1": -0.05}, **TILTED)
    column, row = camera.full_view()._replace(columns=9, rows=7).centres()
    found = camera.project(*camera.unproject(column, row))
    np.testing.assert_allclose(found, (column, row), atol=1e-6)
    with_turn, without = (
        c.vignette(c.full_view()) for c in (camera, camera.model_copy(update={"tilt_deg": (0, 0)}))
    )
    np.testing.assert_array_equal(with_turn, without)


@pytest.mark.parametrize("tilt_deg", TILTS)
def test_the_axis_of_a_tilted_camera_meets_the_principal_point(tilt_deg):
    camera = Camera(tilt_deg=tilt_deg, **TILTED)
    a, b = np.radians(tilt_deg)
    # Straight down, raised towards +y by a, and then carried towards +x about the y axis by b.
    axis = np.array([np.cos(a) * np.sin(b), np.sin(a), np.cos(a) * np.cos(b)])  # x, y, -z
    assert camera.project(*(7.0 * axis)) == pytest.approx((800.0, 630.0), abs=1e-9)
    right, up, forward = camera.unproject(800.0, 630.0)
    np.testing.assert_allclose(
        np.array([right, up, forward]) / np.linalg.norm([right, up, forward]), axis, atol=1e-12
    )
