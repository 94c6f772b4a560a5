"""Values drawn towards null along what the frames leave open."""

import numpy as np
import pytest

from designlab.gap.shrink import drawn_to_null

VALLEY = np.array([[1.0, -0.98], [-0.98, 1.0]]) / 2  # two parameters that cancel each other


def errors(seed: int, size: float, draws: int = 400) -> tuple[float, float]:
    """Root mean squares of errors, before and after, of sets with two valleys in six parameters."""
    rng = np.random.default_rng(seed)
    covariance = np.kron(np.diag([0.2, 0.2, 1e-3]), VALLEY)
    before, after = [], []
    for _ in range(draws):
        truth = size * rng.normal(size=6)
        seen = truth + rng.multivariate_normal(np.zeros(6), covariance)
        before.append(seen - truth)
        after.append(drawn_to_null(seen, covariance) - truth)
    return float(np.sqrt(np.mean(np.square(before)))), float(np.sqrt(np.mean(np.square(after))))


@pytest.mark.parametrize("size", [0.02, 0.1, 0.3])
def test_of_small_effects_much_of_the_error_goes(size: float) -> None:
    before, after = errors(1, size)
    assert after < 0.75 * before
    # The best that any estimate can do is that which knows the size of the effect.
    variances = np.linalg.eigvalsh(np.kron(np.diag([0.2, 0.2, 1e-3]), VALLEY))
    known = np.sqrt(np.mean(size**2 * variances / (size**2 + variances)))
    assert after < 1.35 * known


def test_of_large_effects_nothing_is_lost() -> None:
    before, after = errors(2, 2.0)
    assert after < 1.01 * before


def test_what_is_well_known_stays() -> None:
    seen = np.array([0.3, -0.2, 0.5])
    covariance = np.diag([1e-5, 1e-5, 0.5])
    found = drawn_to_null(seen, covariance)
    assert found[:2] == pytest.approx(seen[:2], rel=1e-3)
    assert 0 < found[2] < 0.5 * seen[2]


def test_axes_of_the_parameters_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    turn, _ = np.linalg.qr(rng.normal(size=(4, 4)))
    seen, covariance = rng.normal(size=4), np.diag([0.01, 0.1, 0.5, 1.0])
    turned = drawn_to_null(turn @ seen, turn @ covariance @ turn.T)
    assert turned == pytest.approx(turn @ drawn_to_null(seen, covariance))
