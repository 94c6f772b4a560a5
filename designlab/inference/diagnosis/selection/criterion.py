"""The criterion says what an effect must show to join a model, and which effects are not told apart."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from designlab.inference.diagnosis.likelihood.fixed_pattern import in_few_places, in_few_waves
from designlab.inference.diagnosis.selection.held_out import FittedModel, Gain, Stand
from designlab.simulation.effects import effect

S = TypeVar("S", bound=FittedModel)

SURE_SE = 2.0  # standard errors from which evidence is sure: 95 % of normal errors
LEAST_SHARE = 0.03  # of the gap that is left: an effect that closes less may be there, but is of no use
LEAST_OF_FIRST = 0.005  # of the first gap: pictures of an effect that is not exact may miss as much
LIKE_DIRT = "no larger than what dirt makes of it"  # why a candidate does not join
AGAINST = "what was held out speaks against it"  # begins why a candidate does not join
TINY = 1e-9  # log score of shots that leave no more than noise
MOST_IN_WAVES = 0.25  # of the fine energy of a pattern; of white noise it is 0.09, of moire or JPEG most
MOST_IN_PLACES = 0.25  # likewise; 0.08 in patterns of the calibration pool, 0.85 and more in reflections


class Evidence(NamedTuple):
    """Difference of the log scores of two fits, and its standard error by the spread between parts.

    The parts are held-out presses, or blocks of a single picture.
    """

    value: float
    se: float

    @property
    def sure(self) -> bool:
        """Whether one fit surely does better."""
        return self.value > SURE_SE * self.se


@dataclass(frozen=True, eq=False)
class JudgedCandidate(Generic[S]):
    """One candidate, fitted and judged.

    `evidence` is for it against the model without it, on what it was fitted to and on what judges together,
    less its `price` for the freedom that it brings; `held_out` is the part of what judges; `left` is the
    gap that it began from, as a share of the first; `smooth` the evidence for the smooth errors of light that
    it leaves; `seconds` is what a first attempt took.
    """

    name: str
    stand: S
    gain: Gain
    evidence: Evidence
    held_out: float
    left: float
    price: float = 0.0
    smooth: float = 0.0
    seconds: float | None = None


@dataclass(frozen=True)
class Criterion:
    """Numbers of a search.

    Attributes
    ----------
    evidence, later : float
        From which an effect counts as seen, alone and beside others.
    as_good : float
        Evidence within which effects are not told apart, however small its error.
    contending : float
        Of the most evidence, from which a candidate may turn out to be the best.
    likely : bool
        Whether an effect must have values that are likely of built sensors, unless it closes the gap.
    of_smooth : float
        Share of the evidence for smooth errors of light that evidence for an effect must exceed as well.
    most_effects : int
        That may join.
    """

    evidence: float
    later: float
    as_good: float
    contending: float
    likely: bool
    of_smooth: float
    most_effects: int

    def refused(self, attempt: JudgedCandidate[S]) -> str:
        """Why a candidate does not join the model; empty if it does."""
        return self.unproven(attempt) or self.unusual(attempt)

    def unproven(self, attempt: JudgedCandidate[S]) -> str:
        """Why the shots do not show that a candidate is there; empty if they do."""
        value, se = attempt.evidence
        needed = self.evidence if len(attempt.stand.state.values) <= 1 else self.later
        # What is taken for a smooth error may hold as much of an effect that is not there.
        needed += self.of_smooth * max(attempt.smooth, 0.0)
        if value <= needed:
            return f"evidence {value:.3g}, below {needed:.3g}"
        if not attempt.evidence.sure:
            return f"evidence {value:.3g} is not sure, give or take {se:.2g}"
        if attempt.held_out <= 0:
            return f"{AGAINST}, with an evidence of {-attempt.held_out:.3g}"
        others = attempt.stand.state.without(attempt.name).values
        missed = 0.0 if all(effect(name).exact for name in others) else LEAST_OF_FIRST
        share, least = attempt.gain.value, max(LEAST_SHARE * attempt.left, missed)
        if share < least:
            gone = f"closes {share:.1%}" if share >= 0 else f"adds {-share:.1%} instead of closing any"
            return f"{gone} of the gap, less than {least:.1%}"
        pattern = attempt.stand.state.patterns.get(attempt.name)
        if pattern is not None and (waves := in_few_waves(pattern)) > MOST_IN_WAVES:
            return f"{waves:.0%} of it lie in few waves, which no sensor's own pattern does"
        if pattern is not None and (places := in_few_places(pattern)) > MOST_IN_PLACES:
            return f"{places:.0%} of it lie in few places: a reflection, marks or hot pixels"
        if pattern is not None and (rounding := _no_more_than_rounding(attempt)):
            return f"no more than the rounding of these files, {rounding:.2%} of their light"
        # The last, since what is refused for this alone stands before others, see `acceptance.accepted`.
        if not attempt.stand.fitter.beyond_dirt(attempt.stand.fit, attempt.name):
            return LIKE_DIRT
        return ""

    def unusual(self, attempt: JudgedCandidate[S]) -> str:
        """What of a candidate's values is not likely of built sensors; empty if nothing is."""
        fitter, state = attempt.stand.fitter, attempt.stand.state
        if bound := fitter.at_bound(state, attempt.name):
            return f"at the bound of {', '.join(bound)}"
        if self.likely and (far := fitter.beyond_prior(attempt.stand.fit, attempt.name)):
            return f"beyond what is likely of {', '.join(far)}"
        return ""

    def chosen(
        self,
        passed: Sequence[JudgedCandidate[S]],
        lead: Callable[[JudgedCandidate[S], JudgedCandidate[S]], Evidence],
    ) -> tuple[JudgedCandidate[S], tuple[JudgedCandidate[S], ...]]:
        """Choose among candidates that pass.

        Parameters
        ----------
        lead : callable
            Evidence for one of them against another.

        Returns
        -------
        JudgedCandidate, tuple of JudgedCandidate
            The simplest of those that are not surely behind the most likely, and all that do as well, itself
            first.
        """
        most_likely = max(passed, key=lambda attempt: attempt.evidence.value)
        behind = {a.name: lead(most_likely, a) for a in passed if a is not most_likely}
        equal = [a for a in passed if a.name not in behind or not behind[a.name].sure]
        best = min(equal, key=lambda a: (len(a.stand.state.values[a.name]), -a.evidence.value))
        close = [a for a in passed if a not in equal and behind[a.name].value <= self.as_good]
        others = [a for a in (*equal, *close) if a is not best]
        return best, (best, *sorted(others, key=lambda a: -a.evidence.value))


OF_PRESSES = Criterion(
    evidence=10.0,
    later=24.0,
    as_good=6.0,
    contending=0.33,
    likely=True,
    of_smooth=0.002,
    most_effects=4,
)
"""Of 22 generated clean sets that hide nothing, the largest evidence for any effect, by linear approximation,
was 4.2, so that none was fitted. What models of other effects miss has a shape that a later one may take up,
which is why more is asked of it. By how much values err alike is a round number, and evidence with it: hence
6. The other numbers are estimates."""
OF_BLOCKS = Criterion(
    evidence=5.0,
    later=5.0,
    as_good=0.0,
    contending=0.25,
    likely=False,
    of_smooth=0.0,
    most_effects=6,
)
"""Five is very strong (Kass and Raftery 1995); how much values err alike is measured in the picture."""


def _no_more_than_rounding(attempt: JudgedCandidate[S]) -> float:
    """Relative error of rounding if a pattern is no stronger; 0 if it is.

    Where nothing is pressed all pictures are rounded alike.
    """
    state, shots = attempt.stand.state, attempt.stand.fitter.bank.shots
    rounding = float(np.median([shot.rounding for shot in shots if shot.lit.any()]))
    strength = state.values[attempt.name][effect(attempt.name).per_pixel]
    return rounding if strength <= rounding else 0.0


def difference(one: Stand, other: Stand, *, price: float = 0.0) -> Evidence:
    """Evidence for one fit of several shots against another.

    Presses differ in how much they show of an effect. So they are expected to gain alike or in proportion to
    what the other fit lacks of each, whichever fits better; the error is what is left (that of a ratio
    estimate, Cochran 1977, chapter 6).

    Parameters
    ----------
    price : float
        Logarithm of evidence that the freedom of the first, beyond that of the other, takes.
    """
    apart, lost = one.judged.scores - other.judged.scores, np.maximum(other.judged.lost, TINY)
    value = one.score - other.score + float(apart.sum()) - price
    if len(apart) < 2:
        return Evidence(value, 0.0)
    spreads = [apart - part * (apart.sum() / part.sum()) for part in (np.ones(len(apart)), lost)]
    least = min(float((spread**2).sum()) for spread in spreads)
    # Shots fitted to differ as held-out ones do.
    shots = len(one.train) + len(apart)
    return Evidence(value, float(np.sqrt(least / (len(apart) - 1) * shots)))


def lead(one: JudgedCandidate[Stand], other: JudgedCandidate[Stand]) -> Evidence:
    """Evidence for one candidate of several presses against another."""
    return difference(one.stand, other.stand, price=one.price - other.price)
