"""A paired comparison tells from scores with the same presses, seeds and noise whether designs differ."""

from typing import NamedTuple

import numpy as np

from designlab.evaluation.press_plan import TEST_PROBES, PressPlan
from designlab.evaluation.press_scores import PRESS_FIGURES, press_chances
from designlab.evaluation.score import Score
from designlab.simulation.effects.model import SensorModel

LEVEL = 0.95


class Difference(NamedTuple):
    """Score of the second design minus that of the first, with its standard error, both in `unit`.

    `least` is the difference that chance alone exceeds in some score of all once in twenty times.
    """

    value: float
    se: float
    least: float
    unit: str

    @property
    def differs(self) -> bool:
        """Whether it is more than chance would make."""
        return abs(self.value) > self.least


def differences(first: Score, second: Score) -> dict[str, Difference]:
    """Differences of all scores that two designs share.

    Equal plans and seeds make equal presses (the same probes at the same places, equally deep) and the same
    noise. Scores of presses are compared press by press, so that what makes a press hard for both designs
    cancels. Render noise of the two counts as independent. What counts as a difference allows for the number
    of scores that are compared (Bonferroni).

    Raises
    ------
    ValueError
        If the two were not evaluated with the same presses, seed and fidelity.
    """
    from scipy.stats import t as student  # with much else, which takes a second

    for name in ("seed", "fidelity", "press_plan"):
        a, b = getattr(first, name), getattr(second, name)
        if a != b:
            raise ValueError(f"{name}: must be the same for both designs, got {a!r} and {b!r}")
    chosen = _paired(first, second)
    found = {}
    shared = sum(name in second.scores for name in first.scores)
    tail = (1 - LEVEL) / 2 / max(shared, 1)
    for name, a in first.scores.items():
        b = second.scores.get(name)
        if b is None:
            continue
        freedom: float = np.inf
        if name in chosen:
            # One factor or six means were taken off.
            count = len(first.presses[PRESS_FIGURES[0]])
            freedom = count - 1 if count == len(TEST_PROBES) else count - len(TEST_PROBES)
            se = float(np.hypot(chosen[name], np.hypot(a.bias_bound or 0.0, b.bias_bound or 0.0)))
        else:
            se = float(np.hypot(a.se, b.se))
        least = float(student.isf(tail, freedom)) * se
        found[name] = Difference(b.value - a.value, se, least, a.unit)
    return found


def same_presses(first: SensorModel, second: SensorModel, plan: PressPlan) -> bool:
    """Whether effects of two models, a stage's offset for example, leave the presses of a plan alike."""
    presses = plan.presses(rounds=1, seed=0)
    return all(
        first.on_press(press) == second.on_press(press) for press in (*presses.calibration, *presses.test)
    )


def _paired(first: Score, second: Score) -> dict[str, float]:
    """Error of each difference by the choice of presses, which both designs share."""
    a, b = (
        press_chances(np.array([score.presses[name] for name in PRESS_FIGURES]).T)
        for score in (first, second)
    )
    return {name: float(np.linalg.norm(b[name] - a[name])) for name in a}
