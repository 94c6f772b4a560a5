"""Boundary elements of the generator: their answer in closed form, and contacts that are known exactly."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import dblquad

from designlab.validation.synthetic import kernels
from designlab.validation.synthetic.boundary_elements import press_any
from designlab.validation.synthetic.elastic_contact import ElasticBase, press_ball, press_flat_punch

pytestmark = pytest.mark.physics

RADIUS, DEPTH = 2.0, 0.6


def ball(x, y):
    r2 = x**2 + y**2
    cap = DEPTH - RADIUS + np.sqrt(np.maximum(RADIUS**2 - r2, 0.0))
    return np.where(r2 < RADIUS**2, cap, -np.inf)


def punch(x, y):
    return np.where(x**2 + y**2 < RADIUS**2, DEPTH, -np.inf)


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (0.05, 0.02), (0.1, 0.0), (0.3, -0.2), (0.9, 0.4)])
def test_a_square_of_pressure_sinks_a_half_space_as_the_integral_tells(x, y):
    size = 0.2
    found = kernels.sinking(np.array([[x, y]]), np.zeros((1, 2)), np.array([size]), np.zeros(1000), 0.01)
    # In quarters about the point, so that 1 / r is singular at corners alone.
    half = size / 2
    edges = [sorted({-half, half, min(max(at, -half), half)}) for at in (x, y)]
    expected = sum(
        dblquad(lambda v, u: 1 / max(np.hypot(u - x, v - y), 1e-12), left, right, low, high)[0]
        for left, right in pairwise(edges[0])
        for low, high in pairwise(edges[1])
    )
    assert found[0, 0] == pytest.approx(expected, rel=3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.49, 0.5])
@pytest.mark.parametrize("thickness_mm", [1.0, 4.0])
def test_a_ball_is_pressed_as_the_integral_equation_tells(thickness_mm, poisson):
    base = ElasticBase(0.4, poisson, thickness_mm)
    exact = press_ball(base, ball_radius_mm=RADIUS, depth_mm=DEPTH)
    found = press_any(base, ball, middle_mm=(0.0, 0.0), half_mm=RADIUS, depth_mm=DEPTH)
    assert found.force_n == pytest.approx(exact.force_n, rel=0.005)
    radius = np.sqrt(found.contact_area_mm2 / np.pi)
    assert radius == pytest.approx(exact.contact_radius_mm, rel=0.02)
    r = np.linspace(0.0, 8.0, 200)
    for turn in (0.0, 0.4):
        surface = found.surface_mm(r * np.cos(turn), r * np.sin(turn))
        np.testing.assert_allclose(surface, exact.surface_mm(r), atol=4e-3)


@pytest.mark.slow
@pytest.mark.parametrize("thickness_mm", [1.0, 4.0])
def test_a_punch_with_a_sharp_edge_is_as_stiff_as_exactly(thickness_mm):
    base = ElasticBase(0.4, 0.49, thickness_mm)
    exact = press_flat_punch(base, punch_radius_mm=RADIUS, depth_mm=DEPTH)
    found = press_any(base, punch, middle_mm=(0.0, 0.0), half_mm=1.05 * RADIUS, depth_mm=DEPTH)
    assert found.force_n == pytest.approx(exact.force_n, rel=0.01)
    r = np.linspace(1.25 * RADIUS, 8.0, 100)
    bulge, _ = exact.bulge_mm
    np.testing.assert_allclose(found.surface_mm(r, 0 * r), exact.surface_mm(r), atol=0.03 * bulge)


def test_pressure_pushes_and_nothing_is_pierced():
    base = ElasticBase(0.4, 0.49, 2.0)

    def two(x, y):
        return np.maximum(ball(x - 1.5, y), ball(x + 1.5, y) - 0.1)

    found = press_any(base, two, middle_mm=(0.0, 0.0), half_mm=3.5, depth_mm=DEPTH)
    assert found.pressure_mpa.min() > 0
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(-3, 3, 41), np.linspace(-2, 2, 31)))
    height, probe = found.surface_mm(x, y), two(x, y)
    # Between the middles of elements the surface follows a curved probe to some micrometres.
    assert (height - probe).min() > -5e-3
    left, right = (np.count_nonzero(found.touched(x, y) & (side * x > 0)) for side in (-1, 1))
    assert right > left > 0
