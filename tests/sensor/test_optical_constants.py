"""Reflectance of clear surfaces: the quadrature against closed forms and published values."""

import numpy as np
import pytest

from designlab.sensor.optical_constants import fresnel_reflectance, internal_reflectance


def from_outside(n):
    """Diffuse reflectance from the thinner side, in closed form (Walsh 1926, as Duntley 1942 prints it)."""
    s = n**2
    return (
        0.5
        + (n - 1) * (3 * n + 1) / (6 * (n + 1) ** 2)
        + s * (s - 1) ** 2 / (s + 1) ** 3 * np.log((n - 1) / (n + 1))
        - 2 * n**3 * (s + 2 * n - 1) / ((s + 1) * (s**2 - 1))
        + 8 * s**2 * (s**2 + 1) / ((s + 1) * (s**2 - 1) ** 2) * np.log(n)
    )


@pytest.mark.parametrize("index", [1.1, 1.33, 1.41, 1.5, 1.8])
def test_diffuse_light_inside_is_sent_back_as_the_law_of_reciprocity_asks(index):
    # what enters is spread over n^2 times as little solid angle and leaves as it came
    assert internal_reflectance(index) == pytest.approx(1 - (1 - from_outside(index)) / index**2, abs=1e-5)


def test_published_values():
    assert internal_reflectance(1.5) == pytest.approx(0.596, abs=5e-4)  # Judd 1942
    assert fresnel_reflectance(np.ones(1), 1.5)[0] == pytest.approx(0.04)


def test_nothing_is_sent_back_where_nothing_changes():
    assert internal_reflectance(1.0 + 1e-9) == pytest.approx(0.0, abs=1e-4)
