"""How much repeats tell of the light that moves from frame to frame."""

import numpy as np
import pytest

from designlab.inference.diagnosis.likelihood.repeats import ERRORS, LEAST, most_likely

FREEDOM = 4


@pytest.mark.parametrize("error", [3e-4, 1e-3, 3e-3])
def test_the_error_that_values_were_drawn_with_is_found(error: float) -> None:
    rng = np.random.default_rng(1)
    smooth = 1e7 * rng.exponential(size=(80, 3))
    white = np.array([0.4, 0.6, 1.0])
    draws = rng.normal(size=(FREEDOM, 80, 3)) * np.sqrt(white + error**2 * smooth)
    found = most_likely((draws**2).sum(axis=0), white, smooth, FREEDOM)
    assert found == pytest.approx(error, rel=0.12)


def test_repeats_that_differ_by_noise_alone_have_the_least() -> None:
    rng = np.random.default_rng(2)
    draws = rng.normal(size=(FREEDOM, 80, 3))
    found = most_likely((draws**2).sum(axis=0), np.ones(3), 1e7 * np.ones((80, 3)), FREEDOM)
    assert found <= 1.3 * LEAST
    assert ERRORS[0] == LEAST
