"""The acceptance rules say what a fitted and judged candidate must show to join the model."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fit, Fitter
from designlab.inference.diagnosis.likelihood.fixed_pattern import in_few_waves
from designlab.inference.diagnosis.selection.held_out import (
    LEAST_IMPROVED,
    LEAST_SHARE,
    Gain,
    Judged,
    gain,
    squared,
)
from designlab.simulation.effects import effect

DECISIVE = 16.0  # logarithm of the Bayes factor from which an effect counts as seen
LATER_DECISIVE = 30.0  # likewise beside other effects
AS_GOOD = 6.0  # difference of such logarithms within which effects are not told apart
AS_GOOD_SHARE = 0.1  # likewise, of the whole: how many values count as one is known no better
LEAST_OWN = 0.1  # of the own gap of a press, in the mean, where few presses show most of an effect
SURE_SE = 1.5  # standard errors that a gain must be beyond: presses differ in how much they show of an effect
LEAST_OF_FIRST = 0.005  # of the first gap that any later effect must close
MOST_IN_WAVES = 0.25  # of the energy of a fixed pattern in its strongest waves


@dataclass(frozen=True, eq=False)
class JudgedCandidate:
    """One candidate, fitted and judged.

    `evidence` is the logarithm of the Bayes factor against the model without it, on the shots fitted to and
    on held-out ones together; `left` is the gap it began from, `fitter` has the pictures it was fitted with;
    `seconds` is what a first attempt took.
    """

    name: str
    left: float
    fitter: Fitter
    fit: Fit
    judged: Judged
    gain: Gain
    evidence: float
    seconds: float | None = None


def refused(
    attempt: JudgedCandidate,
    base: State,
    fitter: Fitter,
    train: Sequence[int],
    gap: float,
    *,
    surely: bool = True,
) -> str:
    """Why a candidate does not pass, beside a state fitted with a fitter's pictures; empty if it does.

    Parameters
    ----------
    surely : bool
        Whether its gain must be sure. Once another passes, something is missing for certain, and what takes
        away as much may be it, however much presses differ.
    """
    if reason := unsure(attempt, gap, later=bool(base.values), surely=surely):
        return reason
    drawn = effect(attempt.name).draws is not None
    settles = attempt.gain.settles_poses
    if attempt.gain.squares < LEAST_SHARE and not settles:
        taken = f"takes {attempt.gain.squares:.1%} of the squared residual beyond noise away"
        return f"{taken}, less than {LEAST_SHARE:.1%}"
    # Some draws of a single shot are small, and some errors of a press's own pose make up for what all have
    # in common: not every one can gain.
    if not (drawn or settles) and attempt.gain.improved < LEAST_IMPROVED:
        return f"only {attempt.gain.improved:.0%} of the held-out presses improve"
    if (worse := _untouched_worse(attempt, base, fitter, train)) > LEAST_SHARE:
        return f"adds {worse:.1%} to the residual of the untouched gel"
    if bound := fitter.at_bound(attempt.fit.state, attempt.name):
        return f"at the bound of {', '.join(bound)}"
    pattern = attempt.fit.state.patterns.get(attempt.name)
    if pattern is not None and (share := in_few_waves(pattern)) > MOST_IN_WAVES:
        return f"{share:.0%} of it lie in few waves, which no sensor's own pattern does"
    if far := fitter.beyond_prior(attempt.fit.state, attempt.name):
        return f"beyond what is likely of {', '.join(far)}"
    return ""


def unsure(attempt: JudgedCandidate, gap: float, *, later: bool, surely: bool = True) -> str:
    """Why evidence and gain of a candidate do not suffice; empty if they do.

    Beside other effects more is asked: what their models miss has a shape, which another may take up.
    """
    needed = LATER_DECISIVE if later else DECISIVE
    if attempt.evidence < needed:
        return f"evidence {attempt.evidence:.3g}, below {needed:g}"
    least = max(LEAST_SHARE * attempt.left / gap, LEAST_OF_FIRST)
    share, se = attempt.gain.value, attempt.gain.se
    if share < least:
        gone = f"closes {share:.1%}" if share >= 0 else f"adds {-share:.1%} instead of closing any"
        return f"{gone} of the gap, less than {least:.1%}"
    # Draws of shots differ by their nature, and poses are judged together: the spread is no error there.
    joint = effect(attempt.name).draws is not None or attempt.gain.settles_poses
    sure = share - SURE_SE * se >= least
    sure_own = attempt.gain.own - SURE_SE * attempt.gain.own_se >= LEAST_OWN
    if surely and not (joint or sure or sure_own):
        return f"closes {share:.1%} of the gap, give or take {se:.1%}: {least:.1%} are not sure"
    return ""


def _untouched_worse(attempt: JudgedCandidate, base: State, fitter: Fitter, train: Sequence[int]) -> float:
    """Rise of the squared residual of the untouched gel, as a share of it or of the floor.

    No effect may explain presses by what the gel does not show without them.
    """
    taken = fitter.bank.shots
    shots = [n for n in train if taken[n].press is None and taken[n].valid.any()]
    before, after = (
        np.mean([squared(own, state, n) for n in shots], axis=0)
        for own, state in ((fitter, base), (attempt.fitter, attempt.fit.state))
    )
    return float((after[0] - before[0]) / max(before))


def closes_more(one: JudgedCandidate, other: JudgedCandidate, gap: float) -> bool:
    """Whether one candidate surely closes more of the first gap than another, press by press."""
    more = gain(other.judged, one.judged, gap)
    least = LEAST_SHARE * one.left / gap
    return more.value >= least and more.value > SURE_SE * more.se


def as_good(one: JudgedCandidate, most_likely: JudgedCandidate, gap: float) -> bool:
    """Whether a candidate explains as much as the most likely one, as far as the shots tell.

    A lead of evidence that is small beside the whole tells candidates apart only where held-out presses,
    one by one, say the same.
    """
    lead = most_likely.evidence - one.evidence
    if lead <= AS_GOOD:
        return True
    return lead <= least_lead(most_likely.evidence) and not closes_more(most_likely, one, gap)


def least_lead(evidence: float) -> float:
    """By how much the evidence of an effect must be ahead of another's for the other to count as worse."""
    return max(AS_GOOD, AS_GOOD_SHARE * evidence)
