"""Which of the candidates of a round may join the model, beside what a lab's dirt does too."""

from collections.abc import Sequence
from typing import NamedTuple

from designlab.inference.diagnosis.selection.criterion import LIKE_DIRT, OF_PRESSES, JudgedCandidate
from designlab.inference.diagnosis.selection.held_out import CLOSED, Stand
from designlab.inference.diagnosis.selection.recentring import is_exact

FAR_AHEAD = 2.0  # times the evidence of any other that values not likely of built sensors have to show
Attempt = JudgedCandidate[Stand]
"""A candidate of several presses."""


class Accepted(NamedTuple):
    """Candidates that may join.

    Attributes
    ----------
    passed : list of JudgedCandidate
        Those that pass.
    unusual : JudgedCandidate or None
        The one that does so far ahead of all, though its values are not likely of built sensors.
    reasons : list of str
        Of each candidate, why it does not join; empty if it may.
    """

    passed: list[Attempt]
    unusual: Attempt | None
    reasons: list[str]


def accepted(attempts: Sequence[Attempt]) -> Accepted:
    """Sort out the candidates of a round."""
    reasons = [OF_PRESSES.refused(attempt) for attempt in attempts]
    dirt = [a for a, reason in zip(attempts, reasons, strict=True) if reason == LIKE_DIRT]
    likeliest = max(dirt, key=lambda a: a.evidence.value, default=None)
    if likeliest is not None:
        reasons = [reason or _behind(a, likeliest) for a, reason in zip(attempts, reasons, strict=True)]
    passed = [attempt for reason, attempt in zip(reasons, attempts, strict=True) if not reason]
    unusual = _closing(attempts)
    reasons = ["" if a is unusual else reason for a, reason in zip(attempts, reasons, strict=True)]
    return Accepted(passed, unusual, reasons)


def leads_like_dirt(attempt: Attempt, attempts: Sequence[Attempt]) -> bool:
    """Whether the candidate with most evidence is no larger than what dirt makes of it, and far from null.

    A size that is still on its way to where the pictures are exact says too little. Pictures about null
    are left as they are, or the leader alone would have exact ones.
    """
    leads = attempt is max(attempts, key=lambda a: a.evidence.value)
    seen = attempt.evidence.value > OF_PRESSES.evidence
    fitter = attempt.stand.fitter
    return leads and seen and is_exact(fitter) and not fitter.beyond_dirt(attempt.stand.fit, attempt.name)


def _closing(attempts: Sequence[Attempt]) -> Attempt | None:
    """Attempt with values that are not likely of built sensors that closes the gap as no other does."""
    if not attempts:
        return None
    first, *others = sorted(attempts, key=lambda attempt: -attempt.evidence.value)
    ahead = all(first.evidence.value > FAR_AHEAD * other.evidence.value for other in others)
    closes = first.stand.judged.excess < CLOSED and not OF_PRESSES.unproven(first)
    return first if ahead and closes and OF_PRESSES.unusual(first) else None


def _behind(attempt: Attempt, dirt: Attempt) -> str:
    """Why a candidate does not join beside dirt that looks like another; empty if it does as well."""
    if attempt.evidence.value > dirt.evidence.value - OF_PRESSES.as_good:
        return ""
    return f"less evidence than {dirt.name}, which dirt makes"
