"""The response of a bonded layer against its limits and its own equations."""

import numpy as np
import pytest

from designlab.mechanics.layer import ElasticLayer

pytestmark = pytest.mark.physics
RATIOS = (0.1, 0.3, 0.45, 0.49, 0.5)


def layer(poisson=0.49, modulus=0.4, thickness=2.0):
    return ElasticLayer(modulus, poisson, thickness)


@pytest.mark.parametrize("poisson", RATIOS)
def test_short_waves_see_a_half_space(poisson):
    """Boussinesq and Cerruti: normal 2 / (E* q), coupling -(1 - 2 nu) / (2 G q), and shear."""
    base, q = layer(poisson), np.array([20.0, 60.0, 300.0])
    shear = base.shear_modulus_mpa
    np.testing.assert_allclose(base.normal(q), 2 * (1 - poisson**2) / (base.modulus_mpa * q), rtol=1e-9)
    np.testing.assert_allclose(base.along(q), (1 - poisson) / (shear * q), rtol=1e-9)
    np.testing.assert_allclose(base.across(q), 1 / (shear * q), rtol=1e-9)
    np.testing.assert_allclose(base.coupling(q), -(1 - 2 * poisson) / (2 * shear * q), atol=1e-9)


@pytest.mark.parametrize("poisson", RATIOS)
def test_an_even_load_compresses_and_shears_the_layer(poisson):
    base, q = layer(poisson), np.array([0.0, 1e-7])
    modulus = (
        base.modulus_mpa * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson)) if poisson < 0.5 else np.inf
    )
    np.testing.assert_allclose(base.normal(q), base.thickness_mm / modulus, rtol=1e-9, atol=1e-12)
    for response in (base.along(q), base.across(q)):
        np.testing.assert_allclose(response, base.thickness_mm / base.shear_modulus_mpa, rtol=1e-9)
    np.testing.assert_allclose(base.coupling(q), 0.0, atol=1e-5)


def test_an_incompressible_layer_keeps_its_volume():
    """Long waves move it by q2 h3 / (3 G), as lubrication theory of a soft layer says."""
    base, q = layer(0.5), np.array([0.001, 0.004, 0.02])
    expected = q**2 * base.thickness_mm**3 / (3 * base.shear_modulus_mpa)
    np.testing.assert_allclose(base.normal(q), expected, rtol=4e-3)
    assert base.normal(np.zeros(1))[0] == 0.0


@pytest.mark.parametrize("poisson", RATIOS)
def test_the_series_of_long_waves_meets_the_closed_form(poisson):
    base = layer(poisson, thickness=1.0)
    below, above = base.normal(np.array([1e-3 * (1 - 1e-9), 1e-3 * (1 + 1e-9)]))
    assert below == pytest.approx(above, rel=3e-6)


@pytest.mark.parametrize("poisson", [0.2, 0.45, 0.5])
def test_navier_equations_hold_in_a_layer_cut_into_slices(poisson):
    """Finite differences through the depth, a second method without the closed form."""
    base, q, slices = layer(min(poisson, 0.499), thickness=1.5), 1.3, 400
    nu, shear = base.poisson, base.shear_modulus_mpa
    step = base.thickness_mm / slices
    # u = U(z) sin(q x), w = W(z) cos(q x); z from the rigid base up; unknowns U, W at every node.
    count = slices + 1
    matrix, right = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    ratio = 1 / (1 - 2 * nu)
    for k in range(1, slices):
        u, w = k, count + k
        for at, weight in ((k - 1, 1.0), (k, -2.0), (k + 1, 1.0)):
            matrix[u, at] += weight / step**2
            matrix[w, count + at] += (1 + ratio) * weight / step**2
        matrix[u, k] -= q**2 * (1 + ratio)
        matrix[w, count + k] -= q**2
        for at, sign in ((k - 1, -1.0), (k + 1, 1.0)):
            matrix[u, count + at] -= sign * ratio * q / (2 * step)
            matrix[w, at] += sign * ratio * q / (2 * step)
    matrix[0, 0] = matrix[count, count] = 1.0  # bonded
    for row, field, partner in ((slices, 0, -1.0), (count + slices, count, 1.0)):
        one_sided = ((slices, 1.5), (slices - 1, -2.0), (slices - 2, 0.5))
        for at, weight in one_sided:
            matrix[row, field + at] += weight / step * (1.0 if field == 0 else 1 + ratio)
        matrix[row, (count if field == 0 else 0) + slices] += partner * q if field == 0 else (ratio - 1) * q
    right[count + slices] = -1.0 / shear  # unit pressure
    moved = np.linalg.solve(matrix, right)
    at = np.array([q])
    assert -moved[count + slices] == pytest.approx(base.normal(at)[0], rel=3e-3)
    assert moved[slices] == pytest.approx(base.coupling(at)[0], abs=3e-3 * base.normal(at)[0])


@pytest.mark.parametrize(("poisson", "decay"), [(0.5, 0.739), (0.49, 0.748), (0.45, 0.783), (0.3, 0.913)])
def test_far_from_a_load_the_surface_settles_at_its_rate(poisson, decay):
    base = layer(poisson, thickness=2.0)
    assert 2.0 * base.decay_per_mm == pytest.approx(decay, abs=1e-3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0.0, 0.49, 2.0), "modulus_mpa: must be above 0 MPa and finite, got 0"),
        ((float("nan"), 0.49, 2.0), "modulus_mpa: must be above 0 MPa"),
        ((0.4, 0.0, 2.0), "poisson: must lie above 0 and be at most 0.5, got 0"),
        ((0.4, 0.51, 2.0), "poisson: must lie above 0 and be at most 0.5, got 0.51"),
        ((0.4, 0.49, 0.0), "thickness_mm: must be above 0 mm and finite, got 0"),
        ((0.4, 0.49, float("inf")), "thickness_mm: must be above 0 mm and finite, got inf"),
    ],
)
def test_bad_values_are_named(values, message):
    with pytest.raises(ValueError, match=message):
        ElasticLayer(*values)
