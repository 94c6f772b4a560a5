"""Whether two designs differ: paired presses, common random numbers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from designlab.evaluation.illumination_scores import Estimate, TransportError
from designlab.evaluation.paired_comparison import differences
from designlab.evaluation.press_plan import PressPlan
from designlab.evaluation.press_scores import PRESS_FIGURES, pooled
from designlab.evaluation.score import Score

PLAN = PressPlan(area_mm=(16.0, 12.0))


def score(figures, *, uniformity=(0.5, 0.01), seed=3, plan=PLAN):
    """A score as of presses with these figures, shape (presses, figures)."""
    each = np.asarray(figures, dtype=float)
    spread = each.std(axis=0, ddof=1) / np.sqrt(len(each))
    estimates = {
        name: Estimate(value, float(se), "deg", 0.0)
        for (name, value), se in zip(pooled(each).items(), spread, strict=True)
    }
    return Score(
        design="a",
        digest="d",
        fidelity="fast",
        seed=seed,
        press_plan=plan,
        scores=estimates | {"uniformity_u0": Estimate(*uniformity, "1")},
        margins={},
        light=TransportError(0.0, 0.0, 0.0),
        presses=dict(zip(PRESS_FIGURES, each.T.tolist(), strict=True)),
    )


def presses(seed, count=6):
    return np.random.default_rng(seed).uniform(1.0, 6.0, size=(count, len(PRESS_FIGURES)))


def test_what_makes_presses_hard_for_both_designs_cancels():
    hard = presses(0)
    one, other = score(hard), score(hard + 0.2 + presses(1) / 100)
    found = differences(one, other)["normal_error_mean_deg"]
    assert found.value == pytest.approx(0.2 + (presses(1) / 100).mean(axis=0)[1])
    assert found.differs
    # each score alone is not known that well
    assert found.se < 0.1 * np.hypot(one.normal_error_mean_deg.se, other.normal_error_mean_deg.se)


def test_scores_of_the_untouched_gel_count_as_independent():
    figures = presses(0)
    one, other = score(figures, uniformity=(0.5, 0.03)), score(figures, uniformity=(0.59, 0.04))
    found = differences(one, other)["uniformity_u0"]
    assert found.se == pytest.approx(0.05)
    assert not found.differs
    assert differences(one, score(figures, uniformity=(0.65, 0.04)))["uniformity_u0"].differs


def test_the_least_difference_allows_for_the_number_of_scores():
    one, other = score(presses(0)), score(presses(0), uniformity=(0.59, 0.04))
    found = differences(one, other)["uniformity_u0"]
    assert found.least / found.se == pytest.approx(norm.isf(0.025 / len(one.scores)))


def test_designs_that_do_not_differ_are_called_different_once_in_twenty_times():
    calls = []
    for seed in range(300):
        base = presses(seed)
        noise = np.random.default_rng([seed, 1]).normal(0.0, 0.5, size=(2, *base.shape))
        found = differences(score(base + noise[0]), score(base + noise[1]))
        calls.append(any(each.differs for each in found.values()))
    # 300 comparisons, at most 5 % expected: within three standard errors, and not far below
    assert 0.005 < np.mean(calls) < 0.05 + 0.038


def test_other_seeds_are_refused():
    figures = presses(0)
    with pytest.raises(ValueError, match="seed: must be the same for both designs, got 3 and 4"):
        differences(score(figures), score(figures, seed=4))
    with pytest.raises(ValueError, match="fidelity"):
        differences(score(figures), replace(score(figures), fidelity="standard"))


def test_other_presses_are_refused():
    figures = presses(0)
    deeper = PressPlan(area_mm=(16.0, 12.0), depth_mm=1.0)
    with pytest.raises(ValueError, match="press_plan: must be the same for both designs"):
        differences(score(figures), score(figures, plan=deeper))
