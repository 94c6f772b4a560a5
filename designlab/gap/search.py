"""The race: candidates are fitted on some presses and judged on others; the best joins the model."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from designlab.gap.fit import Fit, fit, free_parameters, screen
from designlab.gap.floor import Floor, floor
from designlab.gap.judge import (
    LEAST_IMPROVED,
    LEAST_SHARE,
    Gain,
    Judged,
    counted,
    gain,
    judge,
    threshold,
    winning_frequency,
)
from designlab.gap.problem import Problem, State
from designlab.gap.result import Candidate

MOST_EFFECTS = 3
HOPELESS = 0.5  # of the best fall of the mean squared residual: below, a candidate is not fitted to the end
RIVAL = "numerical"


@dataclass(frozen=True, eq=False)
class Winner:
    """An effect that was accepted, with the effects that do as well."""

    name: str
    confidence: float
    coherence_set: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Attempt:
    name: str
    fit: Fit
    judged: Judged
    gain: Gain


@dataclass
class Search:
    """Forward selection of effects.

    Parameters
    ----------
    problem : Problem
        Shots and renderer.
    catalogue : sequence of str
        Effects to try.
    train, select : sequence of int
        Shots to fit to, and to judge by.
    seed : int
        Seed of the bootstrap.
    """

    problem: Problem
    catalogue: Sequence[str]
    train: Sequence[int]
    select: Sequence[int]
    seed: int
    tried: list[Candidate] = field(default_factory=list)
    winners: list[Winner] = field(default_factory=list)
    alternatives: dict[str, State] = field(default_factory=dict)
    gap: float = 0.0

    def run(self, state: State) -> tuple[Fit, Judged, Judged]:
        """Add effects until the floor is reached or none passes.

        Returns
        -------
        Fit, Judged, Judged
            The last fit, and the select shots before and after.
        """
        self._stage("match before", 2 * len(self.select))
        first = judge(self.problem, state, self.select)
        self.gap = max(first.mean - self.floor(state).mean, 0.0)
        best, now = Fit(state, (), np.zeros((0, 0)), 0.0, {}), first
        for number in range(1, MOST_EFFECTS + 1):
            if now.mean <= self.floor(best.state).envelope:
                break
            attempt = self._round(number, best.state, now)
            if attempt is None:
                break
            best, now = attempt.fit, attempt.judged
        return best, first, now

    def floor(self, state: State) -> Floor:
        """Mean squared residual of a perfect model on the select shots."""
        judged = [counted(self.problem, number) for number in self.select]
        return floor(self.problem, state, self.select, judged, seed=self.seed)

    def _round(self, number: int, state: State, now: Judged) -> _Attempt | None:
        attempts = self._attempts(number, state, now)
        if not attempts:
            return None
        self._stage("numerical rival", len(self.select))
        fine = judge(self.problem, now.state, self.select, register=False, variant="fine")
        rival = gain(now, fine)
        passed = []
        for attempt in attempts:
            reason = self._refused(attempt, rival)
            self._note(number, attempt, reason or "passed")
            if not reason:
                passed.append(attempt)
        self.tried.append(Candidate(number, RIVAL, "rival", rival.value, rival.se, rival.improved))
        if not passed:
            return None
        best = max(passed, key=lambda attempt: attempt.gain.value)
        equal = [attempt for attempt in passed if self._as_good(attempt, best)]
        chosen = min(equal, key=lambda attempt: (len(attempt.fit.free), -attempt.gain.value))
        rivals = {attempt.name: attempt.judged for attempt in attempts} | {RIVAL: fine}
        frequency = winning_frequency(now, rivals, chosen.name, gap=self.gap, seed=self.seed)
        names = tuple(attempt.name for attempt in sorted(equal, key=lambda attempt: -attempt.gain.value))
        self.winners.append(Winner(chosen.name, frequency, names))
        self.alternatives = {attempt.name: attempt.fit.state for attempt in equal}
        return chosen

    def _attempts(self, number: int, state: State, now: Judged) -> list[_Attempt]:
        """Screen all candidates, then fit them to the end, the most promising first."""
        named = [winner.name for winner in self.winners]
        present = {applied.name for applied in state.model.effects}
        names = [name for name in self.catalogue if name not in present]
        frees = {name: free_parameters(state, [*named, name]) for name in names}
        self._stage("screening", sum(len(free) for free in frees.values()) * len(self.train))
        screened = {name: screen(self.problem, state, free=frees[name], shots=self.train) for name in names}
        attempts: list[_Attempt] = []
        best = 0.0
        for name in sorted(names, key=lambda name: -screened[name].predicted):
            predicted = screened[name].predicted
            if predicted < max(LEAST_SHARE * self.gap, HOPELESS * best):
                self.tried.append(
                    Candidate(
                        number,
                        name,
                        f"screened out: could lower the residual by {max(predicted, 0.0):.3g} only",
                    )
                )
                continue
            self._stage(f"fitting {name}", 4 * len(self.train) + 3 * len(self.select))
            found = fit(self.problem, state, free=frees[name], shots=self.train, start=screened[name])
            judged = judge(self.problem, found.state, self.select)
            attempts.append(_Attempt(name, found, judged, gain(now, judged)))
            best = max(best, self._fallen(state, found.state))
        return attempts

    def _fallen(self, old: State, new: State) -> float:
        """Fall of the mean squared residual of the training shots."""
        falls = [
            (self.problem.residual(old, n) ** 2).mean() - (self.problem.residual(new, n) ** 2).mean()
            for n in self.train
        ]
        return float(np.mean(falls))

    def _refused(self, attempt: _Attempt, rival: Gain) -> str:
        """Why a candidate does not pass; empty if it does."""
        least = threshold(attempt.gain, self.gap)
        bound = attempt.fit.at_bound()
        if attempt.gain.value < least:
            return f"gain below {least:.3g}"
        if attempt.gain.improved < LEAST_IMPROVED:
            return f"only {attempt.gain.improved:.0%} of the held-out presses improve"
        if bound:
            return f"at the bound of {', '.join(bound)}"
        if attempt.gain.value < rival.value + least:
            return "no better than a finer simulation"
        return ""

    def _as_good(self, attempt: _Attempt, best: _Attempt) -> bool:
        difference = gain(attempt.judged, best.judged)
        return attempt is best or difference.value <= threshold(difference, self.gap)

    def _note(self, number: int, attempt: _Attempt, outcome: str) -> None:
        values = {
            f"{f.effect}.{f.parameter.name}": attempt.fit.values(f.effect)[f.parameter.name]
            for f in attempt.fit.free
        }
        g = attempt.gain
        self.tried.append(Candidate(number, attempt.name, outcome, g.value, g.se, g.improved, values))

    def _stage(self, what: str, expected: int) -> None:
        self.problem.renders.begin(what, expected)
