"""Light in closed form, against exact values and another solver."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from designlab.measurement.transfer import normal_equations, predicted, transfer_and_floor

TRANSFER = np.array([[900.0, 40.0, 0.0], [150.0, 1400.0, 90.0], [0.0, 60.0, 2000.0]])
FLOOR = np.array([0.01, 0.02, 0.0])


def light_of(*shots):
    return transfer_and_floor(normal_equations(*shot) for shot in zip(*shots, strict=True))


@pytest.fixture
def pictures():
    rng = np.random.default_rng(3)
    bases = [rng.uniform(0.1, 1.0, (3, 12, 15)) * 1e-4 for _ in range(3)]
    lits = [np.ones(3), np.array([1.0, 0.0, 0.0]), np.array([0.0, 2.0, 2.0])]
    signals = [predicted(TRANSFER, FLOOR, lit, basis) for lit, basis in zip(lits, bases, strict=True)]
    sigmas = [rng.uniform(0.5, 2.0, signal.shape) * 0.01 for signal in signals]
    valids = [rng.uniform(size=signal.shape) > 0.2 for signal in signals]
    return bases, lits, signals, sigmas, valids


def test_exact_pictures_give_exact_values_whatever_is_not_valid(pictures):
    bases, lits, signals, sigmas, valids = pictures
    spoilt = [np.where(valid, signal, 9.0) for signal, valid in zip(signals, valids, strict=True)]
    transfer, floor = light_of(bases, lits, spoilt, sigmas, valids)
    np.testing.assert_allclose(transfer, TRANSFER, rtol=1e-6, atol=1e-4)
    np.testing.assert_allclose(floor, FLOOR, rtol=1e-6, atol=1e-9)


def test_noisy_pictures_give_what_a_bounded_solver_finds_on_all_values(pictures):
    bases, lits, signals, sigmas, valids = pictures
    rng = np.random.default_rng(4)
    noisy = [s + e * rng.standard_normal(s.shape) for s, e in zip(signals, sigmas, strict=True)]
    transfer, floor = light_of(bases, lits, noisy, sigmas, valids)
    scale = 1e4  # of the columns, for the other solver's tolerances
    for channel in range(3):
        rows, right = [], []
        for basis, lit, signal, sigma, valid in zip(bases, lits, noisy, sigmas, valids, strict=True):
            used = valid[..., channel]
            columns = [scale * lit[g] * basis[g][used] for g in range(3)] + [np.ones(used.sum())]
            rows.append(np.stack(columns, axis=1) / sigma[..., channel][used][:, None])
            right.append(signal[..., channel][used] / sigma[..., channel][used])
        other = lsq_linear(np.concatenate(rows), np.concatenate(right), (0, np.inf), tol=1e-13).x
        np.testing.assert_allclose(transfer[channel], scale * other[:3], rtol=1e-4, atol=1e-2)
        np.testing.assert_allclose(floor[channel], other[3], rtol=1e-4, atol=1e-6)


def test_a_group_that_never_shines_gets_nothing(pictures):
    bases, lits, signals, sigmas, valids = pictures
    lits = [lit * (1, 1, 0) for lit in lits]
    signals = [predicted(TRANSFER, FLOOR, lit, basis) for lit, basis in zip(lits, bases, strict=True)]
    transfer, _ = light_of(bases, lits, signals, sigmas, valids)
    assert not transfer[:, 2].any()
    np.testing.assert_allclose(transfer[:, :2], TRANSFER[:, :2], rtol=1e-6, atol=1e-4)
