"""Grain of single frames is told from all else that is fine."""

import numpy as np
import pytest

from designlab.measurement.grain import grain_variances

SHAPE = (72, 96, 3)


def left_of(rms: float, *, states: int = 8, seed: int = 0) -> list[np.ndarray]:
    """What a model leaves of several states: grain, a fixed pattern, a smooth error, the edge of a press."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:72, :96]
    waves = np.sin(x / 40) * np.cos(y / 30)
    pattern = 0.02 * random.standard_normal(SHAPE) + 0.05 * waves[..., None]
    found = []
    for _ in range(states):
        smooth = 0.005 * random.standard_normal() * waves
        edge = 0.2 * ((abs(np.hypot(x - random.uniform(20, 70), y - random.uniform(20, 50)) - 4)) < 1)
        found.append(rms * random.standard_normal(SHAPE) + pattern + (smooth + edge)[..., None])
    return found


@pytest.mark.parametrize("rms", [0.003, 0.01, 0.02])
def test_grain_is_found_beside_a_fixed_pattern_smooth_errors_and_edges(rms: float) -> None:
    found = grain_variances(left_of(rms), [np.zeros(SHAPE)] * 8)
    assert np.sqrt(np.median(found)) == pytest.approx(rms, rel=0.15)


def test_noise_of_the_camera_is_no_grain() -> None:
    found = grain_variances(left_of(0.01), [np.full(SHAPE, 0.01**2)] * 8)
    assert abs(np.median(found)) < (0.3 * 0.01) ** 2


def test_pixels_that_tell_nothing_are_left_out() -> None:
    left = left_of(0.01)
    for number, one in enumerate(left):
        one[:, : 10 + number] = np.nan
        one[30:40, 50:60] = 5.0 * number  # a press, hidden in part
        one[25:45, 45:65] = np.nan
    found = grain_variances(left, [np.zeros(SHAPE)] * 8)
    assert np.sqrt(np.median(found)) == pytest.approx(0.01, rel=0.15)


def test_two_states_do_not_tell_grain_from_a_pattern() -> None:
    assert grain_variances(left_of(0.01, states=2), [np.zeros(SHAPE)] * 2) == []
