"""Whether two designs differ: scores of the same presses, seeds and noise held against each other."""

from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from designlab.bench import sub_seed
from designlab.evaluate import Score
from designlab.scores import BOOTSTRAPS, PRESS_FIGURES, pooled

LEVEL = 0.95


class Difference(NamedTuple):
    """Score of the second design minus that of the first, with its standard error, both in `unit`.

    `least` is the difference that chance alone exceeds once in twenty times.
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

    Equal seeds make equal random numbers: the same probes at the same places (in shares of the sensing area),
    the same noise. Scores of presses are compared press by press, so that what makes a press hard for both
    designs cancels (paired bootstrap). Render noise of the two counts as independent.

    Raises
    ------
    ValueError
        If the two were not evaluated with the same seed and fidelity.
    """
    for name in ("seed", "fidelity"):
        a, b = getattr(first, name), getattr(second, name)
        if a != b:
            raise ValueError(f"{name}: must be the same for both designs, got {a!r} and {b!r}")
    chosen = _paired(first, second)
    found = {}
    for name, a in first.scores.items():
        b = second.scores.get(name)
        if b is None:
            continue
        freedom: float = np.inf
        if name in chosen:
            freedom = len(first.presses[PRESS_FIGURES[0]]) - 1
            se = float(np.hypot(chosen[name], np.hypot(a.bias_bound or 0.0, b.bias_bound or 0.0)))
        else:
            se = float(np.hypot(a.se, b.se))
        least = float(student.ppf((1 + LEVEL) / 2, freedom)) * se
        found[name] = Difference(b.value - a.value, se, least, a.unit)
    return found


def _paired(first: Score, second: Score) -> dict[str, float]:
    """Error of each difference by the choice of presses, the same draws for both designs."""
    a, b = (np.array([score.presses[name] for name in PRESS_FIGURES]).T for score in (first, second))
    count = len(a)
    random = np.random.default_rng(sub_seed(first.seed, 6, 1))
    draws = [random.integers(0, count, count) for _ in range(BOOTSTRAPS)]
    changes = [(pooled(a[draw]), pooled(b[draw])) for draw in draws]
    # The spread of a bootstrap falls short of that of the sample by (n - 1) / n.
    short = np.sqrt(count / (count - 1))
    return {
        name: short * float(np.nanstd([two[name] - one[name] for one, two in changes])) for name in pooled(a)
    }
