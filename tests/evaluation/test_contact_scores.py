"""Force, force resolution, saturation and lateral resolution, against closed forms and made pictures."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import erf

from designlab.evaluation.contact_scores import (
    BALL_DEPTH_MM,
    BALL_FORCE_N,
    DEEPEST,
    DIP,
    LOST_SHARE,
    OWN_PRESSES,
    force_scores,
    lateral_resolution,
    saturation_depth,
)
from designlab.evaluation.evaluate import evaluate
from designlab.evaluation.illumination_scores import SCORES, Estimate
from designlab.evaluation.protocol import EvaluationProtocol, error_region
from designlab.sensor.design import preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.validation.synthetic.elastic_contact import ElasticBase, press_ball
from geometries.probes import parse

ELASTIC = preset("gelsight-2020-flat-elastic").replace({"elastomer.thickness_mm": 2.0})
RMSE = Estimate(20.0, 2.0, "um")


def gel(**changes):
    contact = {"model": "layer", "gel": "custom", "modulus_mpa": 0.4, "poisson": 0.499, "skin_length_mm": 0.0}
    return ELASTIC.replace({"contact": contact | changes})


def reconstructed(design, press, error_um):
    surface = indent(design.elastomer, design.contact, press, area_mm=(12.0, 12.0), pitch_mm=0.05)
    frame = SimpleNamespace(press=press, surface=surface)
    return SimpleNamespace(frame=frame, height_error_um=np.full(50, error_um))


def test_force_and_depth_of_the_ball_are_those_of_the_exact_contact():
    press = Press(probe=parse("sphere:4"), depth_mm=0.5)
    found = force_scores(gel(), [reconstructed(gel(), press, 20.0)], RMSE)
    base = ElasticBase(modulus_mpa=0.4, poisson=0.499, thickness_mm=2.0)

    def force_n(depth_mm):
        return press_ball(base, ball_radius_mm=2.0, depth_mm=depth_mm).force_n

    force, depth = found["force_at_depth_n"], found["depth_at_force_mm"]
    assert force.value == pytest.approx(force_n(BALL_DEPTH_MM), rel=0.01)
    exact = brentq(lambda d: force_n(d) - BALL_FORCE_N, 0.3, 1.0, xtol=1e-4)
    assert depth.value == pytest.approx(exact, rel=0.01)
    # an error of the grid, not far from what it is
    assert abs(force.value - force_n(BALL_DEPTH_MM)) < 3 * force.se
    assert force.se < 0.02 * force.value
    # 20 um of a contact that takes so much more force a micrometre deeper
    stiffness = (force_n(0.505) - force_n(0.495)) / 0.01
    assert found["force_resolution_mn"].value == pytest.approx(20.0 * stiffness, rel=0.03)
    assert found["force_resolution_mn"].se == pytest.approx(0.1 * found["force_resolution_mn"].value)


def test_hardness_scales_force_and_its_resolution():
    press = Press(probe=parse("sphere:4"), depth_mm=0.5)
    soft, hard = (
        force_scores(one, [reconstructed(one, press, 20.0)], RMSE) for one in (gel(), gel(modulus_mpa=0.8))
    )
    for name in ("force_at_depth_n", "force_resolution_mn"):
        assert hard[name].value == pytest.approx(2 * soft[name].value, rel=1e-6)
    assert hard["depth_at_force_mm"].value < 0.75 * soft["depth_at_force_mm"].value


def test_what_a_gel_does_not_reach_is_no_score():
    thin = gel(modulus_mpa=0.02).replace({"elastomer.thickness_mm": 0.4})
    press = Press(probe=parse("sphere:4"), depth_mm=0.2)
    assert set(force_scores(thin, [reconstructed(thin, press, 20.0)], RMSE)) == {"force_resolution_mn"}
    assert force_scores(preset("gelsight-2020-flat"), [], RMSE) == {}


def grid(pixel_mm=0.05, half_mm=6.0):
    axis = np.arange(-half_mm, half_mm + pixel_mm / 2, pixel_mm)
    x_mm, y_mm = np.meshgrid(axis, -axis)
    return SimpleNamespace(x_mm=x_mm, y_mm=y_mm, pitch_mm=(pixel_mm, pixel_mm), binned=1.0)


class Blurred:
    """A sensor that shows bars blurred by a Gaussian, with noise."""

    def __init__(self, blur_mm, noise_mm=0.0):
        self.design, self.blur_mm, self.noise_mm = ELASTIC, blur_mm, noise_mm

    def reconstruct(self, calibration, frames, *, numbers):
        assert len(set(numbers)) == len(frames)
        noise = [
            np.random.default_rng(n).normal(0, self.noise_mm, frames[0].rays.x_mm.shape) for n in numbers
        ]
        height = self.profile(frames[0].rays.x_mm, frames[0].rays.y_mm, frames[0].press)
        return [SimpleNamespace(height_mm=height + one) for one in noise]

    def profile(self, x_mm, y_mm, press):
        across = x_mm if press.yaw_deg == 0 else y_mm
        return 0.25 * blurred_bars(across / press.probe.size_mm * 2, self.blur_mm / press.probe.size_mm * 2)


def blurred_bars(x, blur):
    """Two bars of unit width about -1 and 1, blurred."""
    edges = ((-1.5, -0.5), (0.5, 1.5))
    return sum((erf((x - a) / blur / 2**0.5) - erf((x - b) / blur / 2**0.5)) / 2 for a, b in edges)


def told_width_mm(sensor):
    def picture(press):
        return SimpleNamespace(press=press, rays=grid())

    found = lateral_resolution(sensor, None, picture, pixel_mm=0.05)
    return found["lateral_resolution_mm"] if found else None


@pytest.mark.parametrize("blur_mm", [0.1, 0.2, 0.4])
def test_bars_are_told_apart_at_the_width_at_which_blur_leaves_a_fifth_of_the_dip(blur_mm):
    stripe = np.linspace(-0.25, 0.25, 5)

    def dip(width_mm):
        blur = blur_mm / width_mm
        return 1 - blurred_bars(stripe, blur).mean() / blurred_bars(1 + stripe, blur).mean() - DIP

    found = told_width_mm(Blurred(blur_mm))
    # searched to a 32nd of the logarithm of 1.5 / 0.05 mm: 11 %, told as the error of the score
    assert found.value == pytest.approx(brentq(dip, 0.2 * blur_mm, 3 * blur_mm), rel=0.07)
    assert 0.005 * found.value < found.se < 0.05 * found.value


def test_noise_and_blur_without_end_cost_resolution():
    clean, noisy = told_width_mm(Blurred(0.1)), told_width_mm(Blurred(0.1, noise_mm=0.25))
    assert noisy.value > 1.1 * clean.value
    assert told_width_mm(Blurred(5.0)) is None


def bright(share_per_mm):
    """A sensor of whose contact a share that grows with depth is at full scale."""
    protocol = EvaluationProtocol(ELASTIC, 1.0, seed=0)

    def picture(press):
        rays = grid()
        away = np.hypot(rays.x_mm - press.centre_mm[0], rays.y_mm - press.centre_mm[1])
        frame = SimpleNamespace(rays=rays, contact=away < 1.0, weights=np.eye(3))
        region = error_region(frame)
        most = round(share_per_mm * press.depth_mm * region.sum())
        lit = np.full(away.shape, 0.3)
        lit.flat[np.flatnonzero(region)[:most]] = 1.5
        frame.basis = np.stack(3 * [lit])
        return frame

    return protocol, picture


def test_saturation_is_where_the_share_of_lost_pixels_passes_its_limit():
    found = saturation_depth(*bright(0.06))["saturation_depth_mm"]
    step = DEEPEST * 2.0 / 16
    assert found.value == pytest.approx(LOST_SHARE / 0.06, abs=step / 2 + 0.01)
    assert 0.1 * step < found.se < step
    never = saturation_depth(*bright(0.001))["saturation_depth_mm"]
    assert never.value == pytest.approx(DEEPEST * 2.0)


@pytest.mark.slow
@pytest.mark.renders
@pytest.mark.llvm
def test_an_evaluation_of_an_elastic_gel_has_these_scores_and_their_seconds():
    score = evaluate(ELASTIC, all_scores=True, seed=1).score
    for name in (*OWN_PRESSES, "force_at_depth_n", "depth_at_force_mm", "force_resolution_mn"):
        assert score.scores[name].unit == SCORES[name]
        assert 0 < score.scores[name].se < 0.5 * score.scores[name].value
    assert score.seconds["presses of their own"] > 0
    assert 0.05 < score.lateral_resolution_mm.value < 1.0
