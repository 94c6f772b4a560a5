"""Force from the shape of a gel, against contacts that were solved for it, with noise and an offset."""

import numpy as np
import pytest

from designlab.mechanics.contact import press
from designlab.mechanics.layer import ElasticLayer
from designlab.mechanics.surface_pressure import pressure_under

PITCH_MM, SIZE = 0.15, 81
X_MM, Y_MM = np.meshgrid(*[(np.arange(SIZE) - SIZE // 2) * PITCH_MM] * 2)
R_MM = np.hypot(X_MM, Y_MM)
with np.errstate(invalid="ignore"):
    GAPS = {
        "ball": np.where(R_MM < 3, 3 - np.sqrt(np.maximum(9 - R_MM**2, 0)), np.inf),
        "punch": np.where(R_MM < 2, 0.0, np.inf),
        "ridge": np.where((np.abs(X_MM) < 1) & (np.abs(Y_MM) < 3), np.abs(X_MM), np.inf),
    }


def surface(probe, poisson, thickness_mm, depth_mm, friction=0.0):
    layer = ElasticLayer(1.0, poisson, thickness_mm)
    solved = press(GAPS[probe], layer, pitch_mm=PITCH_MM, depth_mm=depth_mm, friction=friction)
    return solved, solved.displacement((SIZE, SIZE), (0, 0), smoothing_mm=0.05)


@pytest.mark.physics
@pytest.mark.slow
@pytest.mark.parametrize("probe", list(GAPS))
@pytest.mark.parametrize(("poisson", "thickness_mm"), [(0.49, 2.0), (0.5, 2.0), (0.49, 4.0)])
def test_force_is_found_from_the_surface(probe, poisson, thickness_mm):
    solved, height_mm = surface(probe, poisson, thickness_mm, 0.5)
    noisy = height_mm + 0.005 * np.random.default_rng(0).normal(size=height_mm.shape) + 0.01
    found = pressure_under(noisy, poisson=poisson, thickness_mm=thickness_mm, pitch_mm=PITCH_MM)
    assert found.sliding_force_n(1.0) == pytest.approx(solved.force_n, rel=0.04)
    assert found.offset_mm == pytest.approx(0.01, abs=0.003)
    assert found.rest_mm == pytest.approx(0.005, rel=0.1)
    assert (found.pressure >= 0).all()


@pytest.mark.physics
@pytest.mark.slow
@pytest.mark.parametrize("probe", list(GAPS))
@pytest.mark.parametrize("share", [0.1, 0.25, 0.5])
def test_force_of_a_probe_that_sticks_is_found_from_the_surface(probe, share):
    """Up to half the thickness, where it is well above that of one which slides."""
    solved, height_mm = surface(probe, 0.49, 2.0, 2.0 * share, friction=np.inf)
    noisy = height_mm + 0.005 * np.random.default_rng(0).normal(size=height_mm.shape) + 0.01
    found = pressure_under(noisy, poisson=0.49, thickness_mm=2.0, pitch_mm=PITCH_MM)
    assert found.force_n(1.0) == pytest.approx(solved.force_n, rel=0.08)
    assert found.sliding_force_n(1.0) < found.force_n(1.0)
    value, low, high = found.force_range(1.0, 0.1)
    assert low < solved.force_n < high
    assert low < found.sliding_force_n(1.0) < value < high
    assert found.force_range(1.0).high < high


@pytest.mark.slow
def test_contact_is_where_it_was_and_force_grows_with_the_modulus():
    solved, height_mm = surface("punch", 0.49, 2.0, 0.5)
    found = pressure_under(height_mm, poisson=0.49, thickness_mm=2.0, pitch_mm=PITCH_MM)
    assert (found.contact ^ solved.touched).sum() < 0.15 * solved.touched.sum()
    assert found.contact_area_mm2 == pytest.approx(solved.contact_area_mm2, rel=0.15)
    assert found.force_n(0.3) == pytest.approx(0.3 * found.force_n(1.0))


def test_a_surface_that_only_bulges_is_refused():
    with pytest.raises(ValueError, match="nothing is pressed in"):
        pressure_under(np.full((20, 20), -0.1), poisson=0.49, thickness_mm=2.0, pitch_mm=0.1)
