"""The noise limit of slopes against the closed form for distant lights."""

import numpy as np
import pytest

from designlab.evaluation.noise_limit import noise_limit_deg, pressed_limit_deg, responses

X, Y = np.meshgrid(np.linspace(-7, 7, 70), np.linspace(5, -5, 50))


def lights(slant_deg, azimuths_deg):
    slant, azimuth = np.radians(slant_deg), np.radians(azimuths_deg)
    return np.stack(
        [
            np.sin(slant) * np.cos(azimuth),
            np.sin(slant) * np.sin(azimuth),
            np.full(len(azimuth), np.cos(slant)),
        ],
        axis=1,
    )


def ball(x0, y0, radius=6.0):
    """Slopes of a spherical cap of 1.6 mm radius."""
    dx, dy = X - x0, Y - y0
    down = np.sqrt(np.maximum(radius**2 - dx**2 - dy**2, 1.0))
    touched = np.hypot(dx, dy) < 1.6
    return np.where(touched, -dx / down, 0.0), np.where(touched, -dy / down, 0.0)


def picture(p, q, light, level):
    normal = np.stack([-p, -q, np.ones_like(p)], axis=-1) / np.sqrt(1 + p**2 + q**2)[..., None]
    return level[..., None] * np.maximum(normal @ light.T, 0.0)


PRESSES = [ball(x, y) for x in (-4, 0, 4) for y in (-3, 0, 3)]


@pytest.mark.parametrize("slant_deg", [30.0, 54.7, 75.0])
def test_three_even_lights_reach_the_closed_form(slant_deg):
    light = lights(slant_deg, [90.0, 210.0, 330.0])
    level = np.ones_like(X)
    found, *_ = responses(
        [picture(p, q, light, level) for p, q in PRESSES],
        picture(0 * X, 0 * Y, light, level),
        PRESSES,
        X,
        Y,
    )
    # dI/dp = -l_x and dI/dq = -l_y on a flat membrane
    np.testing.assert_allclose(found[25, 35], -light[:, :2], atol=0.01)
    sigma = 0.004
    limit = noise_limit_deg(found, np.full((*X.shape, 3), sigma))
    # trace of the covariance: 4 sigma^2 / (k sin^2 slant) for k lights of unit signal at equal azimuths
    expected = np.degrees(sigma * np.sqrt(4 / 3) / np.sin(np.radians(slant_deg)))
    np.testing.assert_allclose(limit, expected, rtol=0.02)


def test_the_limit_follows_the_light_that_falls_off():
    light = lights(60.0, [90.0, 210.0, 330.0])
    level = np.exp(0.08 * X - 0.05 * Y)
    found, *_ = responses(
        [picture(p, q, light, level) for p, q in PRESSES],
        picture(0 * X, 0 * Y, light, level),
        PRESSES,
        X,
        Y,
    )
    limit = noise_limit_deg(found, np.full((*X.shape, 3), 0.004))
    np.testing.assert_allclose(limit * level, np.median(limit * level), rtol=0.02)


def test_scatter_of_least_squares_reaches_the_limit():
    random = np.random.default_rng(3)
    jacobian = random.normal(size=(3, 2))
    sigma = np.array([0.01, 0.02, 0.015])
    noise = random.standard_normal((200_000, 3)) * sigma
    weights = np.linalg.pinv(jacobian / sigma[:, None])
    slopes = (noise / sigma) @ weights.T
    scatter = np.degrees(np.sqrt((slopes**2).sum(axis=1).mean()))
    limit = noise_limit_deg(jacobian[None, None], sigma[None, None])
    assert limit[0, 0] == pytest.approx(scatter, rel=0.01)


def test_lights_in_one_plane_carry_no_information():
    light = lights(60.0, [90.0, 90.0, 270.0])
    flat = np.broadcast_to(-light[:, :2], (*X.shape, 3, 2)).round(12)
    assert (noise_limit_deg(flat, np.full((*X.shape, 3), 0.004)) == 90.0).all()


@pytest.mark.parametrize("slant_deg", [20.0, 30.0, 40.0, 50.0, 54.7356, 60.0, 70.0, 80.0])
def test_noise_gain_with_known_and_unknown_albedo_follows_theory(slant_deg):
    """Tr Cov of the normal for k lights at equal slant and azimuths (Drbohlav and Chantler, ICCV 2005)."""
    light = lights(slant_deg, [90.0, 210.0, 330.0])
    level, flat, sigma = np.ones((5, 5)), np.zeros((5, 5)), 0.001
    step = 1e-4
    slopes_p = (picture(flat + step, flat, light, level) - picture(flat - step, flat, light, level)) / (
        2 * step
    )
    slopes_q = (picture(flat, flat + step, light, level) - picture(flat, flat - step, light, level)) / (
        2 * step
    )
    limit = noise_limit_deg(np.stack([slopes_p, slopes_q], axis=-1), np.full((5, 5, 3), sigma))
    gain = (np.radians(limit) / sigma) ** 2
    sine, cosine = np.sin(np.radians(slant_deg)), np.cos(np.radians(slant_deg))
    # albedo known from the untouched gel: 4 / (k sin^2 slant), down to grazing light
    np.testing.assert_allclose(gain, 4 / (3 * sine**2), rtol=0.01)
    # albedo unknown: noise thrown at linear photometric stereo, best at 54.7 deg
    random = np.random.default_rng(3)
    seen = light @ [0.0, 0.0, 1.0] + sigma * random.normal(size=(200_000, 3))
    found = np.linalg.solve(light, seen.T).T
    np.testing.assert_allclose(
        found.var(axis=0).sum() / sigma**2, (4 / sine**2 + 1 / cosine**2) / 3, rtol=0.01
    )


def test_the_pressed_limit_is_that_of_finite_differences_of_the_shading():
    light = lights(50.0, [80.0, 210.0, 330.0]) * [[1.0], [0.7], [1.3]]
    mix = np.array([[0.5, 0.05, 0.0], [0.1, 0.6, 0.02], [0.0, 0.1, 0.4]])

    def sigma(signal):
        return 0.002 + 0.004 * np.sqrt(signal)

    found = pressed_limit_deg(light[None, :, 2], -light[None, :, :2], mix, sigma, steepest_deg=30.0)

    def signal(normal):
        return mix @ np.maximum(light @ normal, 0.0)

    limits = []
    for ring in range(3):
        slope = np.radians(30.0) * np.sqrt((ring + 0.5) / 3)
        for azimuth in (np.arange(8) + 0.5 * (ring % 2)) * np.pi / 4:
            downhill = np.array([-np.cos(azimuth), -np.sin(azimuth), 0.0])
            normal = np.cos(slope) * np.array([0.0, 0.0, 1.0]) + np.sin(slope) * downhill
            # Two directions at right angles to the normal and to each other.
            sides = np.linalg.svd(normal[None])[2][1:]
            step = 1e-5
            jacobian = np.stack(
                [(signal(normal + step * s) - signal(normal - step * s)) for s in sides], axis=1
            )
            weighted = jacobian / (2 * step) / sigma(signal(normal))[:, None]
            limits.append(np.degrees(np.sqrt(np.trace(np.linalg.inv(weighted.T @ weighted)))))
    assert found[0] == pytest.approx(np.exp(np.mean(np.log(limits))), rel=1e-6)


def test_shadow_and_saturation_take_the_pressed_limit_away():
    light = lights(75.0, [90.0, 210.0, 330.0])

    def limit(level):
        def sigma(signal):
            return np.where(signal < 1.0, 0.004, np.inf)

        scale = level / light[0, 2]
        args = scale * light[None, :, 2], -scale * light[None, :, :2], np.eye(3), sigma
        return pressed_limit_deg(*args, steepest_deg=30.0)[0]

    assert limit(0.2) < 1.0
    # What grazes the gel doubles and more on slopes that face it: a well exposed untouched gel is too bright.
    assert limit(0.7) > 3 * limit(0.2)
