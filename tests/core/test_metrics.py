import json

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from designlab.core.metrics import (
    compare,
    gradient_nonuniformity,
    normal_error_deg,
    remove_quadratic_field,
    rgb_to_normal,
    uniformity_cv,
    uniformity_min_max,
    uniformity_nine_point,
    uniformity_u0,
)

RANDOM = np.random.default_rng(5)
REAL = RANDOM.random((24, 31, 3)) + 0.5


def written_out_ssim(s, r, data_range):
    """The published formula, with sample covariance, over every full 7 x 7 window."""

    def mean(a):
        return uniform_filter(a, 7)[3:-3, 3:-3]

    sample = 49 / 48
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    var_s = sample * (mean(s * s) - mean(s) ** 2)
    var_r = sample * (mean(r * r) - mean(r) ** 2)
    cov = sample * (mean(s * r) - mean(s) * mean(r))
    top = (2 * mean(s) * mean(r) + c1) * (2 * cov + c2)
    return np.mean(top / ((mean(s) ** 2 + mean(r) ** 2 + c1) * (var_s + var_r + c2)))


def test_a_scaled_image_has_closed_forms():
    result = compare(0.9 * REAL, REAL)
    assert result["mse"] == pytest.approx(0.01 * np.mean(REAL**2))
    assert result["snr_db"] == pytest.approx(20.0)
    assert result["smape"] == pytest.approx(2 * 0.1 / 1.9)
    assert result["structure_corr"] == pytest.approx(1.0)
    assert result["structure_snr_db"] == pytest.approx(20.0)
    for channel in result["channels"].values():
        assert channel["snr_db"] == pytest.approx(20.0)
        assert channel["smape"] == pytest.approx(2 * 0.1 / 1.9)


def test_snr_and_mse_pool_the_channels_while_ssim_and_structure_average_them():
    simulated = REAL.copy()
    simulated[..., 0] *= 0.5
    result = compare(simulated, REAL)
    power = np.sum(REAL**2, axis=(0, 1))
    assert result["snr_db"] == pytest.approx(10 * np.log10(power.sum() / (0.25 * power[0])))
    assert result["channels"]["R"]["snr_db"] == pytest.approx(20 * np.log10(2))
    assert result["channels"]["G"]["snr_db"] == np.inf
    assert result["ssim"] == pytest.approx(np.mean([c["ssim"] for c in result["channels"].values()]))
    assert result["channels"]["B"]["ssim"] == pytest.approx(1.0)


def test_ssim_is_the_published_formula_with_each_channel_of_its_own_range():
    real = REAL * np.array([0.01, 1.0, 100.0])
    simulated = real + 0.3 * RANDOM.normal(size=real.shape) * np.array([0.01, 1.0, 100.0])
    result = compare(simulated, real)
    expected = [written_out_ssim(simulated[..., c], real[..., c], np.ptp(real[..., c])) for c in range(3)]
    np.testing.assert_allclose([result["channels"][name]["ssim"] for name in "RGB"], expected, rtol=1e-9)
    assert result["ssim"] == pytest.approx(np.mean(expected))


def test_equal_images_are_perfect():
    result = compare(REAL, REAL)
    assert result["mse"] == 0
    assert result["smape"] == 0
    assert result["snr_db"] == np.inf
    assert result["ssim"] == pytest.approx(1.0)
    assert result["structure_corr"] == pytest.approx(1.0)


def test_an_opposite_image_has_the_greatest_smape():
    assert compare(-REAL, REAL)["smape"] == pytest.approx(2.0)
    assert compare(np.zeros_like(REAL), REAL)["snr_db"] == pytest.approx(0.0)


def test_structure_ignores_any_quadratic_field():
    y, x = np.mgrid[:24, :31]
    field = 0.3 + 0.02 * x - 0.01 * y + 0.001 * x * x + 0.002 * x * y - 0.003 * y * y
    np.testing.assert_allclose(remove_quadratic_field(field), 0.0, atol=1e-12)
    plain, shifted = compare(0.9 * REAL, REAL), compare(0.9 * REAL + field[..., None], REAL)
    assert shifted["structure_corr"] == pytest.approx(plain["structure_corr"])
    assert shifted["structure_snr_db"] == pytest.approx(plain["structure_snr_db"])
    assert shifted["snr_db"] < plain["snr_db"] - 10


def test_a_smooth_image_has_no_structure_however_good_its_snr():
    y, x = np.mgrid[:40, :40]
    field = 1 + 0.01 * x + 0.02 * y
    press = np.where(np.hypot(x - 20, y - 20) < 5, 0.05, 0.0)
    real = np.stack([field + press] * 3, axis=-1)
    result = compare(np.stack([field] * 3, axis=-1), real)
    assert result["snr_db"] > 35
    assert result["structure_corr"] == pytest.approx(0.0, abs=1e-6)
    assert result["structure_snr_db"] == pytest.approx(0.0, abs=1e-6)
    without = compare(real, np.stack([field] * 3, axis=-1))
    assert np.isnan(without["structure_corr"])
    assert np.isnan(compare(real, np.ones_like(real))["ssim"])


def test_pure_noise_does_not_correlate():
    result = compare(RANDOM.random((200, 200, 3)), RANDOM.random((200, 200, 3)))
    # standard deviation of each channel's correlation is 1 / 200
    assert abs(result["structure_corr"]) < 5 / 200 / np.sqrt(3)


def test_the_result_is_plain_numbers_under_the_documented_names():
    result = compare(0.9 * REAL, REAL)
    figures = {"mse", "snr_db", "smape", "ssim", "structure_corr", "structure_snr_db"}
    assert set(json.loads(json.dumps(result))) == figures | {"channels"}
    assert list(result["channels"]) == ["R", "G", "B"]
    assert all(set(channel) == figures for channel in result["channels"].values())
    assert list(compare(REAL[..., 0], REAL[..., 1])["channels"]) == ["Y"]


def test_compare_refuses_what_cannot_be_compared():
    with pytest.raises(ValueError, match=r"real image \(24, 31, 3\), got \(23, 31, 3\)"):
        compare(REAL[1:], REAL)
    with pytest.raises(ValueError, match="real: must have light somewhere"):
        compare(REAL, 0 * REAL)
    with pytest.raises(
        ValueError, match=r"simulated: must be at least 7 x 7 pixels .* got shape \(6, 31, 3\)"
    ):
        compare(REAL[:6], REAL[:6])
    bad = REAL.copy()
    bad[0, 0, 0] = np.nan
    with pytest.raises(ValueError, match="simulated: values must be finite, 1 are not"):
        compare(bad, REAL)


def test_uniformity_of_a_ramp_has_closed_forms():
    columns, slope = 300, 0.8
    ramp = np.tile(1 + slope * (np.arange(columns) + 0.5) / columns, (90, 1))
    mean = 1 + slope / 2
    assert uniformity_u0(ramp) == pytest.approx((1 + 0.01 * slope) / mean, abs=2e-3)
    assert uniformity_cv(ramp) == pytest.approx(slope / np.sqrt(12) / mean, rel=1e-4)
    assert uniformity_min_max(ramp) == pytest.approx((1 + slope * 0.5 / 300) / (1 + slope * 299.5 / 300))
    assert uniformity_nine_point(ramp) == pytest.approx((1 + slope / 6) / (1 + slope * 5 / 6))
    assert gradient_nonuniformity(ramp) == pytest.approx(slope / mean)


def test_uniformity_counts_the_mask_alone():
    image = RANDOM.random((30, 40))
    mask = np.zeros((30, 40), dtype=bool)
    mask[6:24, 8:32] = True
    image[mask] = 2.5
    image[~mask] = np.nan
    assert uniformity_u0(image, mask) == 1
    assert uniformity_cv(image, mask) == 0
    assert uniformity_min_max(image, mask) == 1
    assert uniformity_nine_point(image, mask) == 1
    assert gradient_nonuniformity(image, mask) == 0
    with pytest.raises(ValueError, match="values inside must be finite, 768 of 1200 are not"):
        uniformity_cv(image)


def test_one_dark_pixel_does_not_decide_u0():
    image = np.full((50, 50), 2.0)
    image[7, 7] = 0.0
    assert uniformity_min_max(image) == 0
    assert uniformity_u0(image) == pytest.approx(1.0, rel=1e-3)


def test_masks_are_checked():
    image = np.ones((9, 9))
    with pytest.raises(ValueError, match="mask: must hold pixels"):
        uniformity_u0(image, np.zeros((9, 9), dtype=bool))
    with pytest.raises(ValueError, match=r"mask: must be bool of shape \(9, 9\), got float64"):
        uniformity_u0(image, np.ones((9, 9)))
    ring = np.zeros((9, 9), dtype=bool)
    ring[0] = ring[-1] = ring[:, 0] = ring[:, -1] = True
    with pytest.raises(ValueError, match="one holds none"):
        uniformity_nine_point(image, ring)
    with pytest.raises(ValueError, match="3 x 3 pixels"):
        gradient_nonuniformity(image, ring)


@pytest.mark.parametrize("angle_deg", [0.0, 1e-6, 0.5, 30.0, 90.0, 179.0])
def test_normal_error_is_the_angle_of_a_rotation(angle_deg):
    from scipy.spatial.transform import Rotation

    normals = RANDOM.normal(size=(6, 5, 3))
    axes = np.cross(normals, RANDOM.normal(size=(6, 5, 3))).reshape(-1, 3)
    axes *= np.radians(angle_deg) / np.linalg.norm(axes, axis=1, keepdims=True)
    turned = Rotation.from_rotvec(axes).apply(normals.reshape(-1, 3)).reshape(6, 5, 3)
    np.testing.assert_allclose(normal_error_deg(3 * turned, normals), angle_deg, rtol=1e-6, atol=2e-14)


def test_normal_error_refuses_what_is_no_normal():
    good = np.ones((2, 2, 3))
    with pytest.raises(ValueError, match=r"got \(2, 2, 3\) and \(2, 3\)"):
        normal_error_deg(good, good[0])
    with pytest.raises(ValueError, match="truth: normals must not be zero"):
        normal_error_deg(good, 0 * good)
    bad = good.copy()
    bad[1, 0, 2] = np.nan
    np.testing.assert_array_equal(np.isnan(normal_error_deg(bad, good)), [[False, False], [True, False]])


def _cap(shape=(81, 101), radius=60.0, edge=30.0):
    """Normals of a spherical cap in the middle of a plane, and its tilt (deg)."""
    rows, columns = np.indices(shape)
    dy, dx = (shape[0] - 1) / 2 - rows, columns - (shape[1] - 1) / 2
    inside = np.hypot(dx, dy) <= edge
    normals = np.stack([-dx, -dy, np.sqrt(np.maximum(radius**2 - dx**2 - dy**2, 1))], axis=-1) / radius
    normals[~inside] = (0, 0, 1)
    flat = np.zeros_like(normals)
    flat[..., 2] = 1
    return normals, flat, np.degrees(np.arccos(np.clip(normals[..., 2], -1, 1)))


def test_rgb_to_normal_is_one_where_colour_follows_the_angle_and_low_where_it_does_not():
    normals, flat, tilt = _cap()
    random = np.random.default_rng(6)
    untouched = np.broadcast_to([0.3, 0.5, 0.4], (*tilt.shape, 3))
    linear = untouched + tilt[..., None] * [0.002, -0.001, 0.003]
    assert rgb_to_normal(linear, untouched, normals, flat) == pytest.approx(1.0, abs=1e-12)
    noise = untouched + 0.01 * random.standard_normal(untouched.shape)
    # of 30 samples of unrelated noise the mean absolute correlation is sqrt(2 / (30 pi)), here the first of
    # three components
    assert rgb_to_normal(noise, untouched, normals, flat) < 0.35
    # a share of noise as large as the signal lowers a correlation to 1 / sqrt(2)
    spread = linear[tilt > 0].std(axis=0).mean()
    some = linear + spread * random.standard_normal(untouched.shape)
    assert 0.4 < rgb_to_normal(some, untouched, normals, flat) < 0.95


def test_rgb_to_normal_takes_each_contact_by_itself():
    normals, flat, tilt = _cap()
    left = 0.4 + tilt[..., None] * [0.002, 0.001, 0.0]
    right = 0.4 + tilt[..., None] * [0.0, -0.001, 0.003]  # another colour, each linear
    image, both = np.concatenate([left, right], axis=1), np.concatenate([normals, normals], axis=1)
    plane = np.concatenate([flat, flat], axis=1)
    assert rgb_to_normal(image, np.full_like(image, 0.4), both, plane) == pytest.approx(1.0, abs=1e-12)


def test_rgb_to_normal_of_nothing_is_no_number():
    normals, flat, _ = _cap()
    even = np.full((*flat.shape[:2], 3), 0.4)
    assert np.isnan(rgb_to_normal(even, even, flat, flat))
    assert np.isnan(rgb_to_normal(even, even, normals, flat))
    with pytest.raises(ValueError, match=r"image: must have the shape of its normals \(81, 101\)"):
        rgb_to_normal(even[1:], even[1:], normals, flat)
