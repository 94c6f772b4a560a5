"""Standard errors of the scores of test presses, against the scatter of synthetic presses."""

import numpy as np
import pytest

from designlab.evaluation.press_scores import PRESS_FIGURES, TYPICAL, pooled, press_chances

NAMES = ("normal_error_median_deg", "height_mae_um", "height_rmse_um", "normals_within_5deg")
FALLING = [PRESS_FIGURES.index(name) for name in ("normals_within_5deg", "rgb2normal")]


def presses(kinds, rounds, random):
    """Figures of presses whose errors scatter by 15 % about those of their kind."""
    amiss = np.tile(kinds, (rounds, 1)) * np.exp(
        random.normal(0.0, 0.15, (rounds * len(kinds), kinds.shape[1]))
    )
    amiss[:, FALLING] = 1 - amiss[:, FALLING]
    return amiss


@pytest.mark.parametrize("rounds", [1, 2, 4])
def test_the_stated_error_is_the_scatter_over_places(rounds):
    random = np.random.default_rng(rounds)
    kinds = 0.05 * TYPICAL
    if rounds > 1:  # any difficulty of the probes will do
        kinds = kinds * np.exp(random.normal(0.0, 0.7, kinds.shape))
    values, errors = [], []
    for _ in range(400):
        each = presses(kinds, rounds, random)
        values.append([pooled(each)[name] for name in NAMES])
        errors.append([np.linalg.norm(press_chances(each)[name]) for name in NAMES])
    scatter, stated = np.std(values, axis=0), np.sqrt(np.mean(np.square(errors), axis=0))
    # 400 draws tell a scatter to 3.5 %
    np.testing.assert_allclose(stated, scatter, rtol=0.12 if rounds > 1 else 0.25)


def test_probes_of_other_difficulty_do_not_pass_for_chance():
    random = np.random.default_rng(0)
    each = presses(0.05 * TYPICAL, 2, random)
    bootstrap = each[:, 0].std(ddof=1) / np.sqrt(len(each))
    assert np.linalg.norm(press_chances(each)["normal_error_median_deg"]) < 0.6 * bootstrap


def test_a_figure_that_a_press_does_not_have_is_left_out():
    each = presses(0.05 * TYPICAL, 2, np.random.default_rng(0))
    each[3, PRESS_FIGURES.index("rgb2normal")] = np.nan
    chances = press_chances(each)
    assert chances["rgb2normal"][3] == 0
    assert np.isfinite(np.linalg.norm(chances["rgb2normal"]))


def test_half_a_round_is_refused():
    with pytest.raises(ValueError, match="whole rounds of 6 presses, got 5"):
        press_chances(np.ones((5, len(PRESS_FIGURES))))
