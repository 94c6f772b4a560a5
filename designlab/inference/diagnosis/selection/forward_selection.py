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
from designlab.inference.diagnosis.likelihood.normal_equations import log_evidence
from designlab.inference.diagnosis.result import Candidate
from designlab.inference.diagnosis.selection.acceptance import Attempt, accepted, leads_like_dirt
from designlab.inference.diagnosis.selection.confounding import Overlaps
from designlab.inference.diagnosis.selection.criterion import (
    OF_PRESSES,
    JudgedCandidate,
    difference,
    lead,
)
from designlab.inference.diagnosis.selection.held_out import (
    Gain,
    Stand,
    all_leave_much,
    gain,
    judge,
)
from designlab.inference.diagnosis.selection.recentring import (
    FAR_SD,
    beyond,
    exact_fitter,
    is_exact,
    is_far,
    looks_elsewhere,
)
from designlab.inference.diagnosis.selection.screening import price_of_scan, scan_of, screen, with_scanned
from designlab.simulation.effects import effect
from designlab.simulation.render_cache import Renders

FITTED = 6  # candidates of a round that are fitted to the end
PROMISING = 5.0  # logarithm of the Bayes factor by linear approximation from which a candidate is fitted
TRIED_ANYWAY = 2  # most promising ones that are fitted whatever that says, where much is left
MOVER_CONTENDING = 0.1  # of the most evidence: pictures about null tell little of what moves edges
RECENTRINGS = 2  # times that pictures of one that may win are rendered anew where it stands
SETTLINGS = 3  # likewise, of the one that joins
STAYS_SD = 0.1  # prior standard deviations that its values may still be from where its pictures are exact
RIVAL = "numerical"


@dataclass(frozen=True, eq=False)
class Winner:
    """An effect that was accepted, and the share of the gap it closed.

    `equals` are the attempts that do as well, its own first; `rivals` those that might have been accepted in
    its place, and where their fits ended; `unusual` says that its values are not likely of built sensors.
    """

    name: str
    equals: tuple[Attempt, ...]
    gain: float
    rivals: Mapping[str, State] = field(default_factory=dict)
    unusual: bool = False

    def refused(self, attempt: Attempt) -> str:
        """Why it does not stay in the model; empty if it does."""
        return OF_PRESSES.unproven(attempt) if self.unusual else OF_PRESSES.refused(attempt)

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

    def run(self, state: State) -> tuple[Stand, Stand]:
        """Add effects until none passes.

        Returns
        -------
        Stand, Stand
            The model as given, and the last fit.
        """
        first = best = self._stand(self.fitter, state, ())
        self.gap = first.judged.gap
        for number in range(1, OF_PRESSES.most_effects + 1):
            attempt = self._round(number, best)
            if attempt is None:
                break
            best = self._pruned(number, attempt.stand)
            self.fitter = best.fitter
        self._drop_named()
        return replace(first, fitter=self.given), best

    def _stand(self, fitter: Fitter, state: State, names: Sequence[str]) -> Stand:
        """Fit effects with the pictures of a fitter, and judge the held-out shots."""
        fit = fitter.fit(state, names, self.train)
        return Stand(fitter, fit, self.train, judge(fitter, fit, self.select))

    def _round(self, number: int, base: Stand) -> Attempt | None:
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
        least = TRIED_ANYWAY if all_leave_much(base.judged) else 0
        promising = [n for k, n in enumerate(order[:FITTED]) if k < least or screened[n] >= PROMISING]
        base = replace(base, fitter=self._knowing(promising))
        attempts = [self._attempt(name, base) for name in promising]
        # What is screened tells little of what moves edges: that is tried wherever much is left.
        for mover in self._movers:
            if mover in promising or mover not in order:
                continue
            if all_leave_much(base.judged, *(a.stand.judged for a in attempts)):
                attempts.append(self._attempt(mover, base))
        tried = {attempt.name for attempt in attempts}
        for name in order:
            if name not in tried:
                self.tried.append(Candidate(number, name, "screened out", evidence=screened[name]))
        if attempts:
            self.work.tell("trying the best again")
        attempts, base = self._contended(attempts, base)
        attempts = [
            replace(self._settled(a, base), seconds=a.seconds) if leads_like_dirt(a, attempts) else a
            for a in attempts
        ]
        most = max((attempt.evidence.value for attempt in attempts), default=0.0)
        rivals = {a.name: a.stand.judged.state for a in attempts if self._contends(a, most)}
        passed, unusual, reasons = accepted(attempts)
        for attempt, reason in zip(attempts, reasons, strict=True):
            self._note(number, attempt, reason or "passed")
        if unusual is None and not passed:
            return None
        best, equal = self._best(passed) if unusual is None else (unusual, (unusual,))
        self.winners.append(Winner(best.name, equal, best.gain.value, rivals, unusual is not None))
        return self._settled(best, base)

    def _settled(self, best: Attempt, base: Stand) -> Attempt:
        """The best candidate with pictures rendered where it stands, until it stays there.

        What pictures rendered elsewhere lack of it must not pass for a further effect.
        """
        for _ in range(SETTLINGS):
            stand = best.stand
            near = self._near(stand.fitter, stand.judged.state, exactly=True, reach=STAYS_SD)
            if near is None:
                break
            best = self._judged(best.name, base, stand.state, near)
        return best

    def _knowing(self, names: Sequence[str]) -> Fitter:
        """Render either side of null of effects to be fitted; to screen them one was enough."""
        missing = [n for n in names if n not in self._whole and effect(n).rendered]
        if self.source is not None and missing:
            self._whole.update(missing)
            bank = self.given.bank
            better = fill(self.source, bank.model, bank.shots, missing, finer=False)
            alone = self.fitter is self.given
            self.given = self.given.of(bank.with_changes(better), self.given.noises)
            own = self.fitter.of(self.fitter.bank.with_changes(better), self.fitter.noises)
            self.fitter = self.given if alone else own
        return self.fitter

    def _best(self, passed: Sequence[Attempt]) -> tuple[Attempt, tuple[Attempt, ...]]:
        """The best of those that pass, and all that do as well, itself first."""
        return OF_PRESSES.chosen(passed, lead)

    def _contended(self, attempts: list[Attempt], base: Stand) -> tuple[list[Attempt], Stand]:
        """Fit those that may win again where they stand, if pictures about null are far from there.

        What these lack there grows with an effect, until another one seems to be more likely. Pictures
        rendered where presses stand fit better whatever the effect: then all that may win get such, and so
        does the model without any. What may win even then and has moved on gets them once more.

        Returns
        -------
        list of JudgedCandidate, Stand
            The attempts, and the model without any.
        """
        most = max((attempt.evidence.value for attempt in attempts), default=0.0)
        contending = [attempt for attempt in attempts if self._contends(attempt, most)]
        near = {a.name: self._near(a.stand.fitter, a.stand.judged.state) for a in contending}
        if not any(near.values()):
            return attempts, base
        own = self._exact(base.fitter, base.judged.state)
        base = self._stand(own, base.judged.state, list(base.state.values))
        found = {attempt.name: attempt for attempt in attempts}
        fitters: dict[str, Fitter | None] = {name: fitter or own for name, fitter in near.items()}
        for turn in range(RECENTRINGS):
            if turn:
                # Only what was judged anew can be compared: what others have is against another model.
                most = max(found[name].evidence.value for name in near)
                fitters = {name: None for name in fitters if self._contends(found[name], most)}
            for name, fitter in fitters.items():
                begun, before = time.perf_counter(), found[name]
                if turn:
                    fitter = self._near(before.stand.fitter, before.stand.judged.state)
                if fitter is not None:
                    again = self._judged(name, base, before.stand.state, fitter)
                    seconds = (before.seconds or 0.0) + time.perf_counter() - begun
                    found[name] = replace(again, seconds=seconds)
        return list(found.values()), base

    def _contends(self, attempt: Attempt, most: float) -> bool:
        """Whether a candidate may turn out to be the best beside one with most evidence."""
        share = MOVER_CONTENDING if attempt.name == self._mover else OF_PRESSES.contending
        return attempt.evidence.value >= max(share * most, OF_PRESSES.evidence)

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

    def _near(
        self, fitter: Fitter, state: State, *, exactly: bool = False, reach: float = FAR_SD
    ) -> Fitter | None:
        """Fitter whose pictures are rendered where a state stands; None if its own are near enough.

        Parameters
        ----------
        exactly : bool
            Whether only pictures of all that is rendered together are near enough: what is tried beside it
            gets these, and must not take up what others lack.
        reach : float
            How far values may be from where pictures were rendered anew, in prior standard deviations.
        """
        shots = [*self.train, *self.select]
        if self.source is None:
            return None
        missing = exactly and not fitter.bank.stands.keys() >= state.rendered.keys()
        far = missing or is_far(fitter, state, reach) or looks_elsewhere(fitter, state, shots)
        return self._exact(fitter, state) if far or beyond(fitter, state, shots) else None

    def _exact(self, fitter: Fitter, state: State) -> Fitter:
        """Fitter whose pictures are rendered where a state stands."""
        assert self.source is not None
        return exact_fitter(self.source, fitter, state, [*self.train, *self.select])

    def _pruned(self, number: int, best: Stand) -> Stand:
        """Drop effects of earlier rounds that the later ones have made needless, or put better ones there.

        What explains most alone need not do so beside another, nor need what does as well alone.
        """
        for winner in self.winners[:-1]:
            without = self._without(best, winner.name)
            attempt = self._compared(winner.name, without, best)
            rivals = self._rivals(winner, attempt, without)
            if reason := winner.refused(attempt):
                self._note(number, attempt, f"dropped: {reason}")
                self.winners.remove(winner)
                best = without
                self._inherit(number, winner, best.state)
                continue
            passed = [rival for rival in rivals if not OF_PRESSES.refused(rival)]
            leader, equal = self._best([attempt, *passed])
            if attempt in equal:
                leader, equal = attempt, (attempt, *(a for a in equal if a is not attempt))
            else:
                self._note(number, attempt, f"dropped: {leader.name} does more beside the others")
                self._note(number, leader, "passed")
                best = leader.stand
            unusual = winner.unusual and leader is attempt
            found = replace(winner, name=leader.name, equals=equal, unusual=unusual)
            self.winners[self.winners.index(winner)] = found
        return best

    def _without(self, best: Stand, name: str) -> Stand:
        """Fit all effects but one anew, with pictures as good as those of all."""
        state = best.state.without(name)
        names = list(state.values)
        without = self._stand(self.given, state, names)
        near = self._near(self.given, without.judged.state, exactly=True)
        if near is None and is_exact(best.fitter):
            near = self._exact(self.given, without.judged.state)
        return without if near is None else self._stand(near, without.state, names)

    def _drop_named(self) -> None:
        """Drop alternatives that are winners themselves: each was found to be needed beside the others."""
        names = {winner.name for winner in self.winners}
        self.winners = [
            replace(w, equals=tuple(a for a in w.equals if a.name == w.name or a.name not in names))
            for w in self.winners
        ]

    def _rivals(self, winner: Winner, attempt: Attempt, without: Stand) -> list[Attempt]:
        """Rivals of a winner, fitted in its place beside the effects found since.

        Parameters
        ----------
        attempt : JudgedCandidate
            The winner, judged against the model without it.
        without : Stand
            That model.
        """
        rivals = []
        own = without.fitter
        for name, ended in winner.rivals.items():
            if name != winner.name and name not in without.state.values:
                begin = replace(ended, values={**without.state.values, name: ended.values[name]})
                # Only what moves edges may look far worse in pictures that are not rendered where it stands.
                near = self._near(own, begin, exactly=True) if name == self._mover else None
                rival = self._judged(name, without, begin, near or own)
                if near is None and self._contends(rival, attempt.evidence.value):
                    near = self._near(own, rival.stand.judged.state, exactly=True)
                    if near is not None:
                        rival = self._judged(name, without, rival.stand.state, near)
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

    def _attempt(self, name: str, base: Stand) -> Attempt:
        begun = time.perf_counter()
        self.work.tell(f"trying {name}")
        found = self._judged(name, base, self._beginning(name, base.state), base.fitter)
        self.work.step(len(self.train) / 4)
        return replace(found, seconds=time.perf_counter() - begun)

    def _judged(self, name: str, base: Stand, begin: State, fitter: Fitter) -> Attempt:
        """Fit a candidate with the pictures of a fitter, from a state on, and judge it."""
        present = list(base.state.values)
        price = None
        if effect(name).per_pixel:
            pattern = found_pattern(fitter, base.state, self.train)
            begin = base.state.with_pattern(name, pattern.values, pattern.rms)
            found = fitter.fit(begin, present, self.train)
            price = 0.5 * (base.fit.objective - found.objective) - pattern.evidence
        else:
            found = fitter.fit(begin, [*present, name], self.train)
        found = replace(found, state=with_strength(found.state, name))
        if not fitter.at_bound(found.state, name):
            self._reached[name] = found.state
        stand = Stand(fitter, found, self.train, judge(fitter, found, self.select))
        return self._in_finer_form(self._compared(name, base, stand, price=price), base)

    def _in_finer_form(self, attempt: Attempt, base: Stand) -> Attempt:
        """The candidate with the parameters of its finer form, if these surely do better than without.

        They are not fitted where derivatives at the candidate tell that they do not.
        """
        fitter, state, name = attempt.stand.fitter, attempt.stand.state, attempt.name
        values = state.values[name]
        finer = {p.name: p.null for p in fitter.forward.parameters[name] if p.name not in values}
        # Where no smooth error takes up what a form misses, that may hide what the form explains.
        if not finer or (fitter.fits_smooth and attempt.evidence.value <= OF_PRESSES.as_good):
            return attempt
        begin = state.with_values(name, {**values, **finer})
        unknowns = fitter.unknowns(begin, list(begin.values), self.train)
        places = [k for k, u in enumerate(unknowns) if u.effect == name and u.name in finer]
        # What they explain may have been taken for a smooth error, which is smaller then.
        sizes = (state.smooth_rms, state.smooth_rms / 2, 0.0)
        systems = [fitter.system(replace(begin, smooth_rms=size), self.train, unknowns) for size in sizes]
        told = [log_evidence(*each.reduced(places)) - each.misfit / 2 for each in systems]
        if max(told) + systems[0].misfit / 2 <= 0:
            return attempt
        found = fitter.fit(begin, list(begin.values), self.train)
        stand = Stand(fitter, found, self.train, judge(fitter, found, self.select))
        other = self._compared(name, base, stand)
        return other if other.evidence.value > attempt.evidence.value + OF_PRESSES.as_good else attempt

    def _compared(self, name: str, base: Stand, stand: Stand, *, price: float | None = None) -> Attempt:
        """A candidate against the model without it."""
        if price is None:
            price = self._occam(stand.fit, name) + price_of_scan(name)
        return JudgedCandidate(
            name,
            stand,
            gain(base.judged, stand.judged, self.gap),
            difference(stand, base, price=price),
            held_out=float((stand.judged.scores - base.judged.scores).sum()),
            left=base.judged.gap / self.gap,
            price=price,
            smooth=stand.fitter.of_smooth(stand.fit),
        )

    def _occam(self, found: Fit, name: str) -> float:
        """Half the logarithm of how much narrower the fit has made an effect's parameters."""
        places = [k for k, u in enumerate(found.system.unknowns) if u.effect == name]
        if not places:
            return 0.0
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
        values = {p: before.values[name][p] for p in effect(name).null(self.fitter.bank.model.design)}
        return replace(base.with_values(name, values), poses=before.poses)

    def _note(self, number: int, attempt: Attempt, outcome: str) -> None:
        values = attempt.stand.state.values.get(attempt.name, {})
        evidence = attempt.evidence.value
        self.tried.append(
            fitted(number, attempt.name, outcome, attempt.gain, values, evidence, attempt.seconds)
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
