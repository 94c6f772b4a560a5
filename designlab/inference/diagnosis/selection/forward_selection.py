"""Forward selection fits effects to some shots and judges them on others; the best joins the model."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from designlab.core.progress import Work
from designlab.inference.diagnosis.emulator.rendering import fill
from designlab.inference.diagnosis.emulator.state import FRINGES, SIZE, State
from designlab.inference.diagnosis.likelihood.fit import Fit, Fitter, with_strength
from designlab.inference.diagnosis.likelihood.fixed_pattern import found_pattern
from designlab.inference.diagnosis.result import Candidate
from designlab.inference.diagnosis.selection.acceptance import (
    DECISIVE,
    JudgedCandidate,
    as_good,
    closes_more,
    least_lead,
    refused,
)
from designlab.inference.diagnosis.selection.confounding import Overlaps, overlaps
from designlab.inference.diagnosis.selection.held_out import Gain, Judged, all_leave_much, gain, judge
from designlab.inference.diagnosis.selection.recentring import (
    beyond,
    exact_fitter,
    is_exact,
    is_far,
    looks_elsewhere,
)
from designlab.inference.diagnosis.selection.screening import price_of_scan, scan_of, screen, with_scanned
from designlab.simulation.effects import effect
from designlab.simulation.render_cache import Renders

MOST_EFFECTS = 4
FITTED = 6  # candidates of a round that are fitted to the end
PROMISING = 5.0  # logarithm of the Bayes factor by linear approximation from which a candidate is fitted
TRIED_ANYWAY = 2  # most promising ones that are fitted whatever that says, where much is left
CONTENDING = 0.5  # of the highest such logarithm from which a candidate may turn out to be the best
MOVER_CONTENDING = 0.1  # likewise of one that moves edges, of which pictures about null tell little
RECENTRINGS = 2  # times that pictures of one that may win are rendered anew where it stands
OVERLAP = 0.95  # share of a signature from which another effect can stand for it
RIVAL = "numerical"


@dataclass(frozen=True, eq=False)
class Winner:
    """An effect that was accepted, and the share of the gap it closed.

    `equals` are the attempts that do as well, its own first; `rivals` those that might have been accepted in
    its place, and where their fits ended.
    """

    name: str
    equals: tuple[JudgedCandidate, ...]
    gain: float
    rivals: Mapping[str, State] = field(default_factory=dict)

    @property
    def coherence_set(self) -> tuple[str, ...]:
        """Names of effects that do as well, its own first."""
        return tuple(attempt.name for attempt in self.equals)


@dataclass
class ForwardSelection:
    """Forward selection of effects.

    Parameters
    ----------
    fitter : Fitter
        Shots and pictures.
    names : sequence of str
        Effects to try.
    train, select : sequence of int
        Shots to fit to, and to judge by.
    source : Renders, optional
        Where pictures of what was fitted far from null come from; those about null must do when absent.
    work : Work, optional
        What the search is the current part of; its unit is a usual picture.
    """

    fitter: Fitter
    names: Sequence[str]
    train: Sequence[int]
    select: Sequence[int]
    source: Renders | None = None
    tried: list[Candidate] = field(default_factory=list)
    winners: list[Winner] = field(default_factory=list)
    overlaps: Overlaps = field(default_factory=dict)
    gap: float = 0.0
    work: Work = field(default_factory=Work)
    screened: list[dict[str, float]] = field(default_factory=list)
    _reached: dict[str, State] = field(default_factory=dict)
    given: Fitter = field(init=False)
    _whole: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.given = self.fitter

    def run(self, state: State) -> tuple[Fit, Judged, Judged]:
        """Add effects until none passes.

        Returns
        -------
        Fit, Judged, Judged
            The last fit, and the held-out shots before and after.
        """
        best = self.fitter.fit(state, (), self.train)
        first = now = judge(self.fitter, best.state, self.select)
        self.gap = first.gap
        for number in range(1, MOST_EFFECTS + 1):
            attempt = self._round(number, best, now)
            if attempt is None:
                break
            self.fitter = attempt.fitter
            best, now = self._pruned(number, attempt.fit, attempt.judged)
        self._drop_named()
        return best, first, now

    def _round(self, number: int, base: Fit, now: Judged) -> JudgedCandidate | None:
        self.work.tell("screening effects")
        screened, overlapping = screen(self.fitter, base.state, self.names, self.train)
        self.work.step(len(self.train))
        self.overlaps = self.overlaps or overlapping
        self.screened.append(screened)
        amount = {f"{RIVAL}.amount": base.state.numerical}
        amount[f"{FRINGES}.red"] = base.state.fringes
        amount |= {f"{SIZE}.{probe}": larger for probe, larger in base.state.sizes.items()}
        self.tried.append(Candidate(number, RIVAL, "fitted with every candidate", parameters=amount))
        order = sorted(screened, key=lambda name: -screened[name])
        least = TRIED_ANYWAY if all_leave_much(now) else 0
        promising = [n for k, n in enumerate(order[:FITTED]) if k < least or screened[n] >= PROMISING]
        self._know(promising)
        attempts = [self._attempt(name, base, now) for name in promising]
        # What is screened tells little of what moves edges: that is tried wherever much is left.
        for mover in self._movers:
            if mover in promising or mover not in order:
                continue
            if all_leave_much(now, *(a.judged for a in attempts)):
                attempts.append(self._attempt(mover, base, now))
        tried = {attempt.name for attempt in attempts}
        for name in order:
            if name not in tried:
                self.tried.append(Candidate(number, name, "screened out", evidence=screened[name]))
        if attempts:
            self.work.tell("trying the best again")
        attempts, own, base, now = self._contended(attempts, base, now)
        most = max((attempt.evidence for attempt in attempts), default=0.0)
        rivals = {a.name: a.judged.state for a in attempts if self._contends(a, most)}
        passed = self._passed(number, attempts, base.state, own)
        if not passed:
            return None
        leading = self._leading(passed)
        most_likely = max(leading, key=lambda attempt: attempt.evidence)
        equal = [a for a in passed if as_good(a, most_likely, self.gap)]
        # Of effects that explain as much, the simplest: another has parameters for what nobody has listed.
        as_much = [a for a in equal if a in leading and not closes_more(most_likely, a, self.gap)]
        best = min(as_much, key=lambda a: (len(self.fitter.forward.parameters[a.name]), -a.evidence))
        alike = self._alike(best, base, [a.name for a in passed])
        equal += [a for a in passed if a.name in alike and a not in equal]
        equal.sort(key=lambda a: (a is not best, -a.evidence))
        self.winners.append(Winner(best.name, tuple(equal), best.gain.value, rivals))
        near = self._near(best.fitter, best.judged.state, exactly=True)
        return best if near is None else self._judged(best.name, base, now, best.fit.state, near)

    def _know(self, names: Sequence[str]) -> None:
        """Render either side of null of effects to be fitted; to screen them one was enough."""
        missing = [n for n in names if n not in self._whole and effect(n).rendered]
        if self.source is None or not missing:
            return
        self._whole.update(missing)
        bank = self.given.bank
        better = fill(self.source, bank.model, bank.shots, missing, finer=False)
        alone = self.fitter is self.given
        self.given = self.given.of(bank.with_changes(better), self.given.noises)
        self.fitter = (
            self.given if alone else self.fitter.of(self.fitter.bank.with_changes(better), self.fitter.noises)
        )

    def _passed(
        self, number: int, attempts: Sequence[JudgedCandidate], base: State, own: Fitter
    ) -> list[JudgedCandidate]:
        """Attempts that pass; why others do not is noted."""
        reasons = self._reasons(attempts, base, own)
        for reason, attempt in zip(reasons, attempts, strict=True):
            self._note(number, attempt, reason or "passed")
        return [attempt for reason, attempt in zip(reasons, attempts, strict=True) if not reason]

    def _reasons(self, attempts: Sequence[JudgedCandidate], base: State, own: Fitter) -> list[str]:
        """Why attempts at the same place do not pass; empty for those that do.

        Where one passes whose gain is sure, that of others need not be.
        """
        reasons = [refused(each, base, own, self.train, self.gap) for each in attempts]
        if all(reasons):
            return reasons
        return [refused(each, base, own, self.train, self.gap, surely=False) for each in attempts]

    def _contended(
        self, attempts: list[JudgedCandidate], base: Fit, now: Judged
    ) -> tuple[list[JudgedCandidate], Fitter, Fit, Judged]:
        """Fit those that may win again where they stand, if pictures about null are far from there.

        What these lack there grows with an effect, until another one seems to be more likely. Pictures
        rendered where presses stand fit better whatever the effect: then all that may win get such, and so
        does the model without any. What may win even then and has moved on gets them once more.

        Returns
        -------
        list of JudgedCandidate, Fitter, Fit, Judged
            The attempts, and the model without any with what it was fitted with.
        """
        most = max((attempt.evidence for attempt in attempts), default=0.0)
        near = {a.name: self._near(a.fitter, a.judged.state) for a in attempts if self._contends(a, most)}
        if not any(near.values()):
            return attempts, self.fitter, base, now
        own, base, now = self._standing(base, now)
        found = {attempt.name: attempt for attempt in attempts}
        fitters: dict[str, Fitter | None] = {name: fitter or own for name, fitter in near.items()}
        for turn in range(RECENTRINGS):
            if turn:
                # Only what was judged anew can be compared: what others have is against another model.
                most = max(found[name].evidence for name in near)
                fitters = {name: None for name in fitters if self._contends(found[name], most)}
            for name, fitter in fitters.items():
                begun, before = time.perf_counter(), found[name]
                if turn:
                    fitter = self._near(before.fitter, before.judged.state)
                if fitter is not None:
                    again = self._judged(name, base, now, before.fit.state, fitter)
                    seconds = (before.seconds or 0.0) + time.perf_counter() - begun
                    found[name] = replace(again, seconds=seconds)
        return list(found.values()), own, base, now

    def _standing(self, base: Fit, now: Judged) -> tuple[Fitter, Fit, Judged]:
        """Fit a model with pictures that are rendered where it has the presses."""
        own = self._exact(self.fitter, now.state)
        fit = own.fit(now.state, list(base.state.values), self.train)
        return own, fit, judge(own, fit.state, self.select)

    def _contends(self, attempt: JudgedCandidate, most: float) -> bool:
        """Whether a candidate may turn out to be the best beside one with most evidence."""
        share = MOVER_CONTENDING if attempt.name == self._mover else CONTENDING
        return attempt.evidence >= max(share * most, DECISIVE)

    @property
    def _movers(self) -> list[str]:
        """Effects that move edges, the simplest first."""
        parameters = self.fitter.forward.parameters
        return sorted((n for n in self.names if effect(n).warps), key=lambda name: len(parameters[name]))

    @property
    def _mover(self) -> str:
        """Simplest effect that moves edges.

        What pictures about null tell of it is little, so it is looked at where it stands even where others
        seem to be better.
        """
        return next(iter(self._movers), "")

    def _near(self, fitter: Fitter, state: State, *, exactly: bool = False) -> Fitter | None:
        """Fitter whose pictures are rendered where a state stands; None if its own are near enough.

        Parameters
        ----------
        exactly : bool
            Whether only pictures of all that is rendered together are near enough: what is tried beside it
            gets these, and must not take up what others lack.
        """
        shots = [*self.train, *self.select]
        if self.source is None:
            return None
        missing = exactly and not fitter.bank.stands.keys() >= state.rendered.keys()
        far = missing or is_far(fitter, state) or looks_elsewhere(fitter, state, shots)
        return self._exact(fitter, state) if far or beyond(fitter, state, shots) else None

    def _exact(self, fitter: Fitter, state: State) -> Fitter:
        """Fitter whose pictures are rendered where a state stands."""
        assert self.source is not None
        return exact_fitter(self.source, fitter, state, [*self.train, *self.select])

    def _leading(self, passed: Sequence[JudgedCandidate]) -> list[JudgedCandidate]:
        """Those that no other which may be the best surely surpasses on held-out shots.

        One press may hold most of the evidence. Far less evidence surpasses nothing: frames of other light or
        exposure, which all are fitted to, tell what presses cannot.
        """

        def surpassed(a: JudgedCandidate) -> bool:
            rivals = [other for other in passed if other.evidence >= CONTENDING * a.evidence]
            return any(closes_more(other, a, self.gap) for other in rivals)

        return [a for a in passed if not surpassed(a)]

    def _alike(self, best: JudgedCandidate, base: Fit, passed: Sequence[str]) -> set[str]:
        """Effects that bring about nearly all of what the best one was found to do.

        Which of them fits better is decided by what no catalogue lists.
        """
        linear = [name for name in passed if not effect(name).drawn]
        if best.name not in linear or len(linear) < 2:
            return set()
        unknowns = self.fitter.unknowns(base.state, [*base.state.values, *linear], self.train)
        found = self.fitter.system(base.state, self.train, unknowns)
        # How far the best one was found to lie from null, in prior standard deviations.
        values = best.fit.state.values[best.name]
        step = np.array([p.coordinate(values[p.name]) for p in self.fitter.forward.parameters[best.name]])
        table = overlaps(found, linear, {best.name: step})
        return {name for name in linear if table.get((best.name, name), 0.0) >= OVERLAP}

    def _pruned(self, number: int, best: Fit, now: Judged) -> tuple[Fit, Judged]:
        """Drop effects of earlier rounds that the later ones have made needless, or put better ones there.

        What explains most alone need not do so beside another, nor need what does as well alone.
        """
        for winner in self.winners[:-1]:
            state = best.state.without(winner.name)
            names = list(state.values)
            own = self.given
            without = own.fit(state, names, self.train)
            judged = judge(own, without.state, self.select)
            near = self._near(own, judged.state, exactly=True)
            if near is None and is_exact(self.fitter):
                near = self._exact(own, judged.state)
            if near is not None:
                own = near
                without = own.fit(without.state, names, self.train)
                judged = judge(own, without.state, self.select)
            evidence = 0.5 * (without.objective - best.objective) - self._occam(best, winner.name)
            evidence += 0.5 * float((judged.objective - now.objective).sum())
            made = gain(judged, now, self.gap)
            attempt = JudgedCandidate(winner.name, judged.gap, self.fitter, best, now, made, evidence)
            rivals = self._rivals(winner, attempt, without, judged, own)
            reason, *others = self._reasons([attempt, *rivals], without.state, own)
            if reason:
                self._note(number, attempt, f"dropped: {reason}")
                self.winners.remove(winner)
                best, now, self.fitter = without, judged, own
                self._inherit(number, winner, best.state)
                continue
            rivals = [rival for rival, why in zip(rivals, others, strict=True) if not why]
            found = self._beside(winner, attempt, rivals, without)
            if found.name != winner.name:
                leader = found.equals[0]
                self._note(number, attempt, f"dropped: {leader.name} does more beside the others")
                self._note(number, leader, "passed")
                best, now, self.fitter = leader.fit, leader.judged, leader.fitter
            self.winners[self.winners.index(winner)] = found
        return best, now

    def _drop_named(self) -> None:
        """Drop alternatives that are winners themselves: each was found to be needed beside the others."""
        names = {winner.name for winner in self.winners}
        self.winners = [
            replace(w, equals=tuple(a for a in w.equals if a.name == w.name or a.name not in names))
            for w in self.winners
        ]

    def _beside(
        self, winner: Winner, attempt: JudgedCandidate, rivals: Sequence[JudgedCandidate], without: Fit
    ) -> Winner:
        """A winner, or what surely does more beside the effects found since, with what does as well."""
        passed = [attempt, *rivals]
        best = max(passed, key=lambda a: a.evidence)
        if best.evidence <= attempt.evidence + least_lead(attempt.evidence):
            best = attempt
        alike = self._alike(best, without, [a.name for a in passed])
        equal = [a for a in passed if a.name in alike or as_good(a, best, self.gap)]
        equal.sort(key=lambda a: (a is not best, -a.evidence))
        return replace(winner, name=best.name, equals=tuple(equal))

    def _rivals(
        self, winner: Winner, attempt: JudgedCandidate, without: Fit, base: Judged, own: Fitter
    ) -> list[JudgedCandidate]:
        """Rivals of a winner, fitted in its place beside the effects found since.

        Parameters
        ----------
        attempt : JudgedCandidate
            The winner, judged against the model without it.
        without, base : Fit, Judged
            That model.
        own : Fitter
            What it was fitted with.
        """
        rivals = []
        for name, ended in winner.rivals.items():
            if name != winner.name and name not in without.state.values:
                begin = replace(ended, values={**without.state.values, name: ended.values[name]})
                # Only what moves edges may look far worse in pictures that are not rendered where it stands.
                near = self._near(own, begin, exactly=True) if name == self._mover else None
                rival = self._judged(name, without, base, begin, near or own)
                if near is None and self._contends(rival, attempt.evidence):
                    near = self._near(own, rival.judged.state, exactly=True)
                    if near is not None:
                        rival = self._judged(name, without, base, rival.fit.state, near)
                rivals.append(rival)
        return rivals

    def _inherit(self, number: int, dropped: Winner, state: State) -> None:
        """Count what a dropped effect had closed as closed by the newest, which made it needless."""
        newest = replace(self.winners[-1], gain=self.winners[-1].gain + dropped.gain)
        self.winners[-1] = newest
        own = [c for c in self.tried if c.name in (newest.name, dropped.name) and c.outcome == "passed"]
        evidence = sum(c.evidence or 0.0 for c in own)
        values = {f"{newest.name}.{p}": float(v) for p, v in state.values[newest.name].items()}
        last = replace(own[-1], round=number, gain=newest.gain, evidence=evidence, parameters=values)
        self.tried.append(replace(last, name=newest.name, seconds=None))

    def _attempt(self, name: str, base: Fit, now: Judged) -> JudgedCandidate:
        begun = time.perf_counter()
        self.work.tell(f"trying {name}")
        found = self._judged(name, base, now, self._beginning(name, base.state), self.fitter)
        self.work.step(len(self.train) / 4)
        return replace(found, seconds=time.perf_counter() - begun)

    def _judged(self, name: str, base: Fit, now: Judged, begin: State, fitter: Fitter) -> JudgedCandidate:
        """Fit a candidate with the pictures of a fitter, from a state on, and judge it."""
        present = list(base.state.values)
        if effect(name).per_pixel:
            pattern = found_pattern(fitter, base.state, self.train)
            state = base.state.with_pattern(name, pattern.values, pattern.rms)
            found = fitter.fit(state, present, self.train)
            evidence = pattern.evidence
        else:
            found = fitter.fit(begin, [*present, name], self.train)
            evidence = 0.5 * (base.objective - found.objective) - self._occam(found, name)
            evidence -= price_of_scan(name)
        found = replace(found, state=with_strength(found.state, name))
        if not fitter.at_bound(found.state, name):
            self._reached[name] = found.state
        judged = judge(fitter, found.state, self.select)
        evidence += 0.5 * float((now.objective - judged.objective).sum())
        return JudgedCandidate(name, now.gap, fitter, found, judged, gain(now, judged, self.gap), evidence)

    def _occam(self, found: Fit, name: str) -> float:
        """Half the logarithm of how much narrower the fit has made an effect's parameters."""
        places = [k for k, u in enumerate(found.system.unknowns) if u.effect == name]
        if not places:
            return 0.0  # a pattern has taken its price already
        information, _ = found.system.reduced(places)
        return float(0.5 * np.linalg.slogdet(information + np.eye(len(places)))[1])

    def _beginning(self, name: str, base: State) -> State:
        """Where the fit of a candidate begins: at its null, in later rounds at what it reached before."""
        if effect(name).per_pixel:
            return base
        if scan_of(name) is not None:
            return replace(with_scanned(self.fitter, base, name, self.train), poses={})
        if name not in self._reached:
            return replace(base, poses={})  # a wrong model may have driven poses far off
        before = self._reached[name]
        return replace(base.with_values(name, before.values[name]), poses=before.poses)

    def _note(self, number: int, attempt: JudgedCandidate, outcome: str) -> None:
        values = attempt.fit.state.values.get(attempt.name, {})
        self.tried.append(
            fitted(number, attempt.name, outcome, attempt.gain, values, attempt.evidence, attempt.seconds)
        )


def fitted(
    number: int,
    name: str,
    outcome: str,
    gain: Gain,
    values: Mapping[str, float],
    evidence: float,
    seconds: float | None,
) -> Candidate:
    """Record of a candidate that was fitted to the end."""
    fall, se, improved = gain.value, gain.se, gain.improved
    parameters = {f"{name}.{p}": float(v) for p, v in values.items()}
    seconds = None if seconds is None else round(seconds, 2)
    return Candidate(number, name, outcome, fall, se, improved, parameters, evidence, seconds)
