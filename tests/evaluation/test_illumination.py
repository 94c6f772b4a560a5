"""Figures of illumination against closed forms: even light, a ramp, a point light, a distant light."""

import math

import numpy as np
import pytest

from designlab.evaluation.illumination import (
    colour_balance,
    coverage,
    dynamic_range_use,
    evenness,
    saturated,
    shadow_share,
    slant_deg,
    stray_share,
    within,
)
from designlab.evaluation.noise_limit import responses
from designlab.sensor.sensing_area import SensingArea

X, Y = np.meshgrid((np.arange(200) - 99.5) * 0.1, (74.5 - np.arange(150)) * 0.1)


def test_even_light_has_perfect_figures():
    assert evenness(np.full((60, 80), 3.0)) == (1, 0, 1, 1, 0)


def test_a_ramp_has_closed_forms():
    slope = 0.6
    ramp = 1 + slope * (X - X.min() + 0.05) / 20
    found = evenness(ramp)
    assert found.u0 == pytest.approx((1 + 0.01 * slope) / 1.3, abs=3e-3)
    assert found.cv == pytest.approx(slope / np.sqrt(12) / 1.3, rel=1e-3)
    assert found.min_max == pytest.approx(1 / 1.6, rel=5e-3)
    assert found.nine_point == pytest.approx((1 + slope / 6) / (1 + slope * 5 / 6), rel=1e-2)
    assert found.gradient == pytest.approx(slope / 1.3)


def test_a_point_light_above_the_middle_falls_off_as_the_fourth_power_of_a_cosine():
    height = 12.0
    light = (1 + (X**2 + Y**2) / height**2) ** -1.5  # E = I h / r^3
    corner, middle = (
        (X[0, 0] ** 2 + Y[0, 0] ** 2) / height**2,
        (X[75, 100] ** 2 + Y[75, 100] ** 2) / height**2,
    )
    assert evenness(light).min_max == pytest.approx(((1 + corner) / (1 + middle)) ** -1.5)
    # the mean over a rectangle a x b: the solid angle of it, 4 atan(ab / (h sqrt(a^2 + b^2 + h^2))) h^2
    a, b = 10.0, 7.5
    mean = 4 * height**2 * np.arctan(a * b / (height * np.sqrt(a**2 + b**2 + height**2))) / (4 * a * b)
    least = np.percentile(light, 1)
    assert evenness(light).u0 == pytest.approx(least / mean, rel=1e-3)


def test_channels_are_compared_and_counted():
    signal = np.empty((*X.shape, 3))
    signal[:] = (0.2, 0.8, 0.4)
    assert colour_balance(signal) == pytest.approx(4)
    assert dynamic_range_use(signal) == pytest.approx(0.2)
    assert dynamic_range_use(10 * signal) == 1
    assert not saturated(signal).any()
    signal[:15, :, 1] = 1.0
    assert saturated(signal).mean() == pytest.approx(0.1)
    middle = np.abs(Y) < 5
    assert saturated(signal)[middle].sum() == 0
    assert colour_balance(signal, middle) == pytest.approx(4)
    with pytest.raises(ValueError, match="every channel must have light"):
        colour_balance(signal * (1, 1, 0))


def test_stray_light_is_the_share_of_what_is_added():
    straight = 1 + 0.05 * X
    assert stray_share(np.full(X.shape, 0.25), straight + 0.25) == pytest.approx(0.2)
    assert stray_share(np.zeros(X.shape), straight) == 0


def test_coverage_counts_membrane_not_pixels():
    everything = np.ones(X.shape, dtype=bool)
    assert coverage(X, Y, everything, within(X, Y, (16.0, 12.0))) == 1
    # the sensor ends at x = 4 of -8..8
    assert coverage(X, Y, X < 4, within(X, Y, (16.0, 12.0))) == pytest.approx(0.75, abs=0.01)
    # a perspective whose pixels grow to the right: x = u + 0.02 u^2, cut at x = 0, so half of -8..8
    stretched = X + 0.02 * X**2
    seen = coverage(stretched, Y, stretched < 0, within(stretched, Y, (16.0, 12.0)))
    assert seen == pytest.approx(0.5, abs=0.01)
    assert (stretched < 0)[within(stretched, Y, (16.0, 12.0))].mean() > 0.53  # of the pixels


def _ball(x0, y0, radius=6.0):
    dx, dy = X - x0, Y - y0
    down = np.sqrt(np.maximum(radius**2 - dx**2 - dy**2, 1.0))
    touched = np.hypot(dx, dy) < 1.6
    return np.where(touched, -dx / down, 0.0), np.where(touched, -dy / down, 0.0)


@pytest.mark.parametrize("slant", [20.0, 45.0, 70.0])
def test_the_slant_of_a_distant_light_is_found_from_presses(slant):
    presses = [_ball(x, y) for x in (-5, 0, 5) for y in (-4, 0, 4)]
    towards = np.array([np.sin(np.radians(slant)), 0.0, np.cos(np.radians(slant))])
    towards = towards * (0.8, 1, 1) + (0, 0.6 * towards[0], 0)  # azimuth of 36.9 deg
    level = 1 + 0.03 * X

    def picture(p, q):
        normal = np.stack([-p, -q, np.ones_like(p)], axis=-1) / np.sqrt(1 + p**2 + q**2)[..., None]
        return (level * np.maximum(normal @ towards, 0))[..., None]

    untouched = picture(0 * X, 0 * Y)
    response, *_ = responses([picture(p, q) for p, q in presses], untouched, presses, X, Y)
    np.testing.assert_allclose(slant_deg(response, untouched)[40:110, 50:150], slant, atol=0.5)


def test_two_opposite_lights_cancel():
    # E = (s, 0, c) + (-s, 0, c): only the vertical part is left
    assert slant_deg(np.array([0.9 - 0.9, 0.0]), 2 * 0.3) == 0
    assert slant_deg(np.array([1.0, 0.0]), 0.0) == 90


@pytest.mark.parametrize("slant", [10.0, 55.0, 65.0, 80.0, 89.9])
def test_attached_shadows_are_those_counted_around_the_compass(slant):
    slope = 30.0
    azimuth = np.radians(np.arange(0.005, 360, 0.01))
    a, s = np.radians(slope), np.radians(slant)
    dark = np.cos(a) * np.cos(s) + np.sin(a) * np.sin(s) * np.cos(azimuth) < 0
    assert shadow_share(slant, slope_deg=slope) == pytest.approx(dark.mean(), abs=1e-4)
    assert (shadow_share(slant, slope_deg=slope) > 0) == (slope + slant > 90)


def test_a_slope_must_be_one():
    assert shadow_share(0.0, slope_deg=30) == 0
    with pytest.raises(ValueError, match="slope_deg: must be between 0 and 90 deg, got 90"):
        shadow_share(45.0, slope_deg=90)


@pytest.mark.parametrize("size", [(16.0, 12.0), (8.0, 8.0), (5.0, 10.0)])
def test_coverage_of_an_ellipse_is_a_share_of_the_ellipse(size):
    """Closed form: the segment of a disc beyond a chord at half of its radius is not seen."""
    area = SensingArea(*size, "ellipse")
    kept = 1 - (math.acos(0.5) - 0.5 * math.sqrt(0.75)) / math.pi
    on_sensor = size[0] / 4 > X
    assert coverage(X, Y, on_sensor, area.holds(X, Y)) == pytest.approx(kept, abs=0.015)
