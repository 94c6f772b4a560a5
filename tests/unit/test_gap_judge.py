import numpy as np
import pytest

from designlab.gap.judge import Judged, gain, threshold, winning_frequency
from designlab.gap.problem import BLOCK_PX, State, blocks, clipped, halves, moved
from designlab.press import Press
from geometries.probes import parse

NOWHERE = State(model=None, gains=np.ones(3), poses={})  # type: ignore[arg-type]  # not looked at here


def judged(level: float, *, shots: int, blocks_each: int = 50, noise: float = 0.1, seed: int = 0) -> Judged:
    random = np.random.default_rng(seed)
    means = level + noise * random.standard_normal((shots, blocks_each))
    return Judged(NOWHERE, tuple(means / blocks_each))


def test_mean_is_that_of_the_shots() -> None:
    assert judged(2.0, shots=3, noise=0.0).mean == pytest.approx(2.0)


@pytest.mark.parametrize("shots", [3, 12])
def test_error_of_a_gain_is_its_spread_over_repetitions(shots) -> None:
    found = [
        gain(judged(2.0, shots=shots, seed=2 * k), judged(1.5, shots=shots, seed=2 * k + 1))
        for k in range(300)
    ]
    values = np.array([g.value for g in found])
    assert values.mean() == pytest.approx(0.5, abs=0.005)
    assert np.mean([g.se for g in found]) == pytest.approx(values.std(), rel=0.15)


def test_share_of_presses_improved() -> None:
    base = judged(1.0, shots=4, noise=0.0)
    other = Judged(NOWHERE, (*judged(0.5, shots=3, noise=0.0).sums, *judged(1.5, shots=1, noise=0.0).sums))
    assert gain(base, other).improved == 0.75


def test_threshold_is_the_larger_of_significance_and_size() -> None:
    noisy = gain(judged(1.0, shots=4), judged(1.0, shots=4, seed=1))
    assert threshold(noisy, 1e-6) == pytest.approx(2 * noisy.se)
    assert threshold(noisy, 10.0) == pytest.approx(0.3)


def test_confidence_of_a_clear_winner_is_limited_by_the_number_of_presses() -> None:
    base = judged(2.0, shots=4)
    rivals = {"right": judged(1.0, shots=4, seed=1), "wrong": judged(1.8, shots=4, seed=2)}
    assert winning_frequency(base, rivals, "right", gap=1.0, seed=0) == pytest.approx(5 / 6)
    assert winning_frequency(base, rivals, "wrong", gap=1.0, seed=0) < 0.01


def test_confidence_is_shared_by_equal_rivals() -> None:
    base = judged(2.0, shots=12)
    rivals = {name: judged(1.0, shots=12, seed=seed) for seed, name in enumerate("ab", start=1)}
    found = [winning_frequency(base, rivals, name, gap=1.0, seed=0) for name in "ab"]
    assert sum(found) == pytest.approx(1.0, abs=0.02)


def test_halves_part_the_blocks() -> None:
    shape = (50, 70)
    label, half = blocks(shape), halves(shape)
    assert 0.4 < half.mean() < 0.6
    for number in np.unique(label):
        assert len(np.unique(half[label == number])) == 1
    assert (label == 0).sum() == BLOCK_PX**2


def test_clipped_mean_agrees_with_drawn_counts() -> None:
    sigma, signal = np.array([0.02, 0.0, 0.01]), np.array([-0.01, -0.01, 0.013]).reshape(1, 1, 3)
    draws = np.random.default_rng(0).standard_normal((400_000, 3)) * sigma + signal.ravel()
    expected = np.where(sigma > 0, np.maximum(draws, 0).mean(axis=0), signal.ravel())
    np.testing.assert_allclose(clipped(signal, sigma).ravel(), expected, atol=1e-4)


def test_clipping_vanishes_far_above_the_noise() -> None:
    signal = np.full((2, 2, 3), 0.5)
    np.testing.assert_allclose(clipped(signal, np.full(3, 0.01)), signal, rtol=1e-12)


def test_a_press_moves_by_its_pose_error() -> None:
    press = Press(probe=parse("triangle:5"), depth_mm=0.5, centre_mm=(1.0, 2.0), yaw_deg=10.0)
    there = moved(press, np.array([0.1, -0.2, 0.05, 3.0]))
    assert there is not None
    assert there.centre_mm == pytest.approx((1.1, 1.8))
    assert (there.depth_mm, there.yaw_deg) == pytest.approx((0.55, 13.0))
    assert moved(None, np.ones(4)) is None
