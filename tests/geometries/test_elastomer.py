"""The undeformed membrane."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometries.elastomer import Elastomer, base_gradient, base_mm, inside, polygon


def dome(radius_mm: float, width_mm: float = 20.0) -> Elastomer:
    return Elastomer(shape="dome", outline="round", width_mm=width_mm, radius_mm=radius_mm)


def test_flat_membrane_is_the_plane_z_0() -> None:
    x, y = np.meshgrid(np.linspace(-30, 30, 7), np.linspace(-30, 30, 5))
    gel = Elastomer()
    assert base_mm(gel, x, y).shape == (5, 7)
    assert not base_mm(gel, x, y).any()
    assert not np.any(base_gradient(gel, x, y))


def test_points_of_a_dome_lie_on_its_sphere() -> None:
    x, y = np.meshgrid(np.linspace(-10, 10, 41), np.linspace(-10, 10, 41))
    z = base_mm(dome(15.0), x, y)
    np.testing.assert_allclose(np.hypot(np.hypot(x, y), z - 15.0), 15.0, rtol=1e-14)
    assert z[20, 20] == 0.0
    assert (z >= 0).all()
    assert (z < 15.0).all()


def test_dome_slope_is_the_derivative_of_its_height() -> None:
    gel, step = dome(15.0), 1e-4
    x, y = np.meshgrid(np.linspace(-8, 8, 17), np.linspace(-8, 8, 17))
    p, q = base_gradient(gel, x, y)
    np.testing.assert_allclose(
        p, (base_mm(gel, x + step, y) - base_mm(gel, x - step, y)) / (2 * step), atol=1e-8
    )
    np.testing.assert_allclose(
        q, (base_mm(gel, x, y + step) - base_mm(gel, x, y - step)) / (2 * step), atol=1e-8
    )


def test_normal_of_a_dome_points_to_its_centre() -> None:
    gel = dome(15.0)
    x, y = np.array([3.0, -7.0, 0.0]), np.array([4.0, 2.0, 0.0])
    p, q = base_gradient(gel, x, y)
    normal = np.stack([-p, -q, np.ones(3)]) / np.sqrt(1 + p**2 + q**2)
    to_centre = np.stack([-x, -y, 15.0 - base_mm(gel, x, y)]) / 15.0
    np.testing.assert_allclose(normal, to_centre, atol=1e-14)


@given(radius_mm=st.floats(1e3, 1e7), x=st.floats(-10, 10), y=st.floats(-10, 10))
def test_a_nearly_flat_dome_keeps_its_digits(radius_mm: float, x: float, y: float) -> None:
    """The series r^2 / 2R (1 + r^2 / 4R^2 + ...) is exact to rounding where the radius is large."""
    square = x**2 + y**2
    series = square / (2 * radius_mm) * (1 + square / (4 * radius_mm**2) + square**2 / (8 * radius_mm**4))
    assert float(base_mm(dome(radius_mm), x, y)) == pytest.approx(series, rel=1e-12, abs=0)


def test_beyond_the_sphere_there_is_no_membrane() -> None:
    gel = dome(5.0, width_mm=10.0)
    assert np.isnan(base_mm(gel, [5.01, 4.0], [0.0, 3.01])).all()
    assert np.isnan(base_gradient(gel, 5.01, 0.0)).all()
    assert float(base_mm(gel, 5.0, 0.0)) == 5.0
    assert float(base_gradient(gel, 5.0, 0.0)[0]) == np.inf


def test_inside_applies_the_outline() -> None:
    assert inside(
        Elastomer(outline="rectangle", width_mm=24, length_mm=10), [11.9, 0.0], [0.0, 5.1]
    ).tolist() == [
        True,
        False,
    ]
    # a hexagon reaches 12 mm along y, where its flats are, and 13.86 mm along x, where its corners are
    assert inside(Elastomer(width_mm=24), [13.8, 0.0, 13.9], [0.0, 12.1, 0.0]).tolist() == [
        True,
        False,
        False,
    ]
    assert inside(dome(15.0), [9.9, 7.2], [0.0, 7.2]).tolist() == [True, False]


def test_polygon_is_the_outline() -> None:
    assert np.ptp(polygon(Elastomer(outline="rectangle", width_mm=24, length_mm=10)), axis=0).tolist() == [
        24,
        10,
    ]
    np.testing.assert_allclose(np.hypot(*polygon(dome(15.0), segments=12).T), 10.0)
    assert len(polygon(dome(15.0), segments=12)) == 12
