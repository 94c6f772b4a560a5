import numpy as np
import pytest

from designlab.gap.judge import Judged, gain, threshold, winning_frequency
from designlab.gap.problem import BLOCK_PX, State, blocks, clipped, halves, moved
from designlab.press import Press
from geometries.probes import parse

NOWHERE = State(model=None, gains=np.ones(3), poses={})  # type: ignore[arg-type]  # not looked at here


def judged(level: float, *, shots: int, noise: Judged | None = None, seed: int = 0) -> Judged:
    """Noise correlated within blocks, plus a misfit of constant size and drawn sign in each block."""
    random = np.random.default_rng(seed)
    label = np.repeat(np.arange(60), 40)
    parts = []
    for shot in range(shots):
        if noise is None:
            own = random.standard_normal(len(label)) + 0.5 * random.standard_normal(60)[label]
        else:
            own = noise.residuals[shot]
        parts.append(own + level * np.where(random.random(60) < 0.5, 1, -1)[label])
    return Judged(NOWHERE, tuple(parts), (label,) * shots)


def pair(misfit: float, *, shots: int, seed: int = 0) -> tuple[Judged, Judged]:
    """A state with a misfit and one without, on the same noise."""
    right = judged(0.0, shots=shots, seed=seed)
    return judged(misfit, shots=shots, noise=right, seed=seed + 10_000), right


def test_mean_is_that_of_the_shots() -> None:
    even = Judged(NOWHERE, (np.full(5, 2.0), np.full(50, 1.0)), (np.zeros(5, int), np.zeros(50, int)))
    assert even.mean == pytest.approx((4 + 1) / 2)


@pytest.mark.parametrize("shots", [3, 12])
def test_error_of_a_gain_is_its_spread_over_repetitions(shots) -> None:
    found = [gain(*pair(0.7, shots=shots, seed=k)) for k in range(300)]
    values = np.array([g.value for g in found])
    assert values.mean() == pytest.approx(0.49, abs=0.02)
    assert np.mean([g.se for g in found]) == pytest.approx(values.std(), rel=0.15)


def test_a_local_misfit_is_as_significant_as_a_spread_one() -> None:
    errors = []
    for share in (0.1, 1.0):  # the same sum of squares in a few blocks or in all
        found = []
        for seed in range(100):
            right = judged(0.0, shots=2, seed=seed)
            offset = np.where(right.block[0] < share * 60, 0.5 / np.sqrt(share), 0.0)
            found.append(
                gain(Judged(NOWHERE, tuple(r + offset for r in right.residuals), right.block), right)
            )
        assert np.mean([g.value for g in found]) == pytest.approx(0.25, abs=0.02)
        errors.append(np.sqrt(np.mean([g.se**2 for g in found])))
    assert errors[0] == pytest.approx(errors[1], rel=0.1)


def test_gain_of_the_worse_state_is_the_negative_of_that_of_the_better() -> None:
    wrong, right = pair(0.5, shots=3)
    there, back = gain(wrong, right), gain(right, wrong)
    assert back.value == pytest.approx(-there.value)
    assert back.se == pytest.approx(there.se)


def test_share_of_presses_improved() -> None:
    wrong, right = pair(1.0, shots=4)
    mixed = Judged(NOWHERE, (*wrong.residuals[:1], *right.residuals[1:]), right.block)
    other = Judged(NOWHERE, (*right.residuals[:1], *wrong.residuals[1:]), right.block)
    assert gain(other, mixed).improved == 0.75


def test_threshold_is_the_larger_of_significance_and_size() -> None:
    found = gain(*pair(0.1, shots=4))
    assert threshold(found, 1e-6) == pytest.approx(2 * found.se)
    assert threshold(found, 10.0) == pytest.approx(0.3)


def test_confidence_of_a_clear_winner_is_limited_by_the_number_of_presses() -> None:
    base, right = pair(1.0, shots=4)
    rivals = {"right": right, "wrong": judged(0.8, shots=4, noise=right, seed=7)}
    assert winning_frequency(base, rivals, "right", gap=1.0, seed=0) == pytest.approx(5 / 6)
    assert winning_frequency(base, rivals, "wrong", gap=1.0, seed=0) < 0.01


def test_confidence_is_shared_by_equal_rivals() -> None:
    base, right = pair(1.0, shots=12)
    rivals = {"a": right, "b": right}
    found = [winning_frequency(base, rivals, name, gap=1.0, seed=0) for name in "ab"]
    assert sum(found) == pytest.approx(1.0, abs=0.02)
    assert 0.3 < found[0] < 0.7


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
