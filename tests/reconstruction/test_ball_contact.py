"""The gel under a calibration ball, against the exact integral equation, and what balls tell of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from designlab.mechanics.contact import press
from designlab.mechanics.layer import ElasticLayer
from designlab.reconstruction import normals
from designlab.reconstruction.ball_samples import known_gel
from designlab.reconstruction.ball_surface import BallSurface
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.lab import calibrate
from designlab.reconstruction.setup import Setup
from designlab.validation.synthetic.elastic_contact import ElasticBase, press_ball

RADIUS_MM, PITCH_MM, POISSON = 3.0, 0.1, 0.49
SHAPE = (150, 160)
ROWS, COLUMNS = np.indices(SHAPE)
CENTRES = [(c, r) for c in (40, 80, 120) for r in (38, 75, 112)]
DEPTHS_MM = (0.25, 0.5, 0.35, 0.6, 0.3, 0.45, 0.55, 0.4, 0.5)
AZIMUTHS = np.radians([90.0, 210.0, 330.0])
TOWARD = np.stack([0.77 * np.cos(AZIMUTHS), 0.77 * np.sin(AZIMUTHS), np.full(3, 0.64)])


@pytest.mark.parametrize("thickness_mm", [1.5, 4.0, 9.0])
@pytest.mark.parametrize("depth_mm", [0.3, 0.7, 1.1])
def test_contact_and_surface_are_those_of_another_solution(thickness_mm, depth_mm):
    exact = press_ball(ElasticBase(1.0, POISSON, thickness_mm), ball_radius_mm=RADIUS_MM, depth_mm=depth_mm)
    surface, radius = BallSurface(RADIUS_MM, thickness_mm, POISSON), exact.contact_radius_mm
    assert surface.depth_mm(radius) == pytest.approx(depth_mm, rel=5e-4)
    cut = np.sqrt(depth_mm * (2 * RADIUS_MM - depth_mm))
    assert surface.contact_share(radius) == pytest.approx(radius / cut, rel=5e-4)
    # beyond the rim itself, where slopes fall steeply
    r = np.linspace(1.01 * radius, 3 * radius, 40)
    truth = (exact.surface_mm(r + 0.002) - exact.surface_mm(r - 0.002)) / 0.004
    np.testing.assert_allclose(surface.slope(r, radius), truth, atol=1e-3)
    inside = np.array([0.0, 0.5, 0.95]) * radius
    np.testing.assert_allclose(surface.slope(inside, radius), -inside / np.sqrt(RADIUS_MM**2 - inside**2))


@pytest.mark.parametrize("thickness_mm", [2.0, 6.0])
def test_contact_is_that_of_the_solver_on_a_grid(thickness_mm):
    pitch_mm, depth_mm = 0.04, 0.6
    y, x = np.mgrid[-62:63, -62:63] * pitch_mm
    gap = RADIUS_MM - np.sqrt(np.maximum(RADIUS_MM**2 - x**2 - y**2, 0.0))
    solved = press(gap, ElasticLayer(1.0, POISSON, thickness_mm), pitch_mm=pitch_mm, depth_mm=depth_mm)
    surface = BallSurface(RADIUS_MM, thickness_mm, POISSON)
    assert surface.depth_mm(solved.contact_radius_mm) == pytest.approx(depth_mm, rel=0.02)


def picture(p, q, noise, seed):
    """Lambert's law for three lights with noise."""
    light = np.maximum(normals(p, q) @ TOWARD, 0)
    return light + noise * np.random.default_rng(seed).normal(size=light.shape)


def made(thickness_mm, bias, skin_mm=0.0):
    """Pictures of balls on a layer solved exactly, with circles read off too large and with scatter.

    A coating rounds the heights of the layer.
    """
    draw, balls = np.random.default_rng(3), []
    distances = np.linspace(0.0, 12.0, 500)
    for number, (centre, depth) in enumerate(zip(CENTRES, DEPTHS_MM, strict=True)):
        exact = press_ball(ElasticBase(1.0, POISSON, thickness_mm), ball_radius_mm=RADIUS_MM, depth_mm=depth)
        x, y = (COLUMNS - centre[0]) * PITCH_MM, (centre[1] - ROWS) * PITCH_MM
        r = np.hypot(x, y)
        ratio = np.interp(r, distances, np.gradient(exact.surface_mm(distances), distances)) / np.maximum(
            r, 1e-9
        )
        radius_px = exact.contact_radius_mm / PITCH_MM * (1 + bias) + draw.normal(scale=0.2)
        p, q = (gaussian_filter(slope, skin_mm / PITCH_MM) for slope in (ratio * x, ratio * y))
        balls.append(BallPress(picture(p, q, 0.01, number), centre, radius_px))
    return balls, picture(np.zeros(SHAPE), np.zeros(SHAPE), 0.0, 0)


@pytest.mark.slow
@pytest.mark.parametrize(("thickness_mm", "bias"), [(2.0, 0.1), (3.5, 0.0), (8.0, 0.1)])
def test_thickness_and_bias_are_recovered(thickness_mm, bias):
    balls, background = made(thickness_mm, bias)
    _, setup, fit = known_gel(balls, background, Setup(RADIUS_MM, PITCH_MM, smoothing_px=1.0))
    print(fit.thickness_mm, fit.label_bias)
    assert fit.thickness_mm.low <= thickness_mm <= fit.thickness_mm.high
    assert fit.label_bias.low <= bias <= fit.label_bias.high
    assert setup.thickness_mm == pytest.approx(thickness_mm, rel=0.15)
    assert setup.label_bias == pytest.approx(bias, abs=0.015)
    # what scatters from ball to ball is put right
    truth = [
        press_ball(
            ElasticBase(1.0, POISSON, thickness_mm), ball_radius_mm=RADIUS_MM, depth_mm=depth
        ).contact_radius_mm
        for depth in DEPTHS_MM
    ]
    np.testing.assert_allclose(fit.contact_radii_px * PITCH_MM, truth, rtol=0.02)


@pytest.mark.slow
def test_a_coating_that_rounds_the_rim_is_allowed_for():
    balls, background = made(2.0, 0.1, skin_mm=0.3)
    setup = Setup(RADIUS_MM, PITCH_MM, smoothing_px=1.0, thickness_mm=2.0)
    truth = [
        press_ball(ElasticBase(1.0, POISSON, 2.0), ball_radius_mm=RADIUS_MM, depth_mm=depth).contact_radius_mm
        for depth in DEPTHS_MM
    ]
    bare, coated = (known_gel(balls, background, setup._replace(skin_mm=skin)).fit for skin in (0.0, 0.3))
    off, rest = (np.abs(fit.contact_radii_px * PITCH_MM / truth - 1) for fit in (bare, coated))
    print(off.mean(), rest.mean())
    assert rest.max() < 0.02
    assert rest.mean() < off.mean() / 2


def contact_radii_px(thickness_mm):
    """True contact radii of the balls that `made` presses."""
    gel = ElasticBase(1.0, POISSON, thickness_mm)
    exact = [press_ball(gel, ball_radius_mm=RADIUS_MM, depth_mm=depth) for depth in DEPTHS_MM]
    return np.array([contact.contact_radius_mm for contact in exact]) / PITCH_MM


@pytest.mark.slow
def test_contacts_are_as_large_where_light_differs_from_place_to_place():
    balls, background = made(2.0, 0.1)
    light = (1 + 0.5 * np.sin(2 * np.pi * COLUMNS / 40))[..., None]
    lit = [replace(ball, image=light * ball.image) for ball in balls]
    setup = Setup(RADIUS_MM, PITCH_MM, smoothing_px=1.0, thickness_mm=2.0)
    found = known_gel(lit, light * background, setup).fit.contact_radii_px / contact_radii_px(2.0)
    print(found)
    assert np.abs(found - 1).max() < 0.01


@pytest.mark.slow
def test_what_is_known_of_the_gel_is_kept():
    balls, background = made(2.0, 0.1)
    setup = Setup(RADIUS_MM, PITCH_MM, smoothing_px=1.0)
    _, known, fit = known_gel(balls, background, setup._replace(thickness_mm=2.0))
    assert known.thickness_mm == 2.0
    assert fit.thickness_mm == pytest.approx((2.0, 2.0, 2.0))
    assert fit.label_bias.low <= 0.1 <= fit.label_bias.high
    _, known, fit = known_gel(balls, background, setup._replace(label_bias=0.1))
    assert known.label_bias == 0.1
    assert fit.label_bias == pytest.approx((0.1, 0.1, 0.1))
    assert fit.thickness_mm.low <= 2.0 <= fit.thickness_mm.high
    known = known._replace(thickness_mm=2.0)
    assert known_gel(balls, background, known) == (balls, known, None)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"thickness_mm": 0.0}, "thickness_mm: must be above 0 mm"),
        ({"thickness_mm": np.nan}, "thickness_mm: must be above 0 mm"),
        ({"ball_radius_mm": -1.0}, "ball_radius_mm: must be above 0 mm"),
        ({"poisson": 0.6}, "poisson: must lie above 0 and be at most 0.5"),
        ({"label_bias": -0.7}, "label_bias: must lie between -0.5 and 1"),
        ({"ball_radius_mm": 0.9}, r"balls\[1\].contact_radius_px: must be above 0 and below 0.9"),
    ],
)
def test_a_gel_that_cannot_be_is_refused_by_name(change, text):
    shape = (40, 40, 3)
    balls = [BallPress(np.ones(shape), (20.0, 20.0), radius) for radius in (5.0, 9.0, 6.0)]
    setup = Setup(RADIUS_MM, PITCH_MM)._replace(**change)
    with pytest.raises(ValueError, match=text):
        calibrate(balls, np.ones(shape), setup)


def test_a_fit_of_the_gel_needs_three_balls():
    draw = np.random.default_rng(0)
    balls = [BallPress(draw.uniform(0.5, 1, (40, 40, 3)), (20.0, 20.0), radius) for radius in (5.0, 9.0)]
    with pytest.raises(ValueError, match="balls: at least 3 are needed to fit thickness_mm"):
        calibrate(balls, np.ones((40, 40, 3)), Setup(RADIUS_MM, PITCH_MM))
