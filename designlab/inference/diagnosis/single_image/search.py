"""The race on one picture: effects are fitted to some blocks and judged on others.

Unlike the race over many presses, departures may be large: a picture without a background is often one of a
sensor that nobody has measured. So pictures are rendered anew about whatever has been found, after each
effect that joins.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.snapshots import Snapshot
from designlab.inference.diagnosis.result import Candidate
from designlab.inference.diagnosis.selection.criterion import OF_BLOCKS, Evidence, JudgedCandidate
from designlab.inference.diagnosis.selection.forward_selection import fitted
from designlab.inference.diagnosis.selection.held_out import FittedModel, Gain, standard_error
from designlab.inference.diagnosis.single_image.frame_fitter import SCALE, FrameFitter, centred
from designlab.measurement.blocks import SELECT, TRAIN, block_numbers
from designlab.measurement.shots import POSE, Shot
from designlab.simulation.effects import SensorModel, effect
from designlab.simulation.render_cache import Renders

ENVELOPE = 1.3  # mean squared residual over the floor below which no further effect is looked for
SETTLING = 4  # times that pictures are rendered anew about what was found
SETTLED = 0.05  # change of the number of values that count as one below which it stays


@dataclass(frozen=True, eq=False)
class FittedPicture(FittedModel):
    """A fit to a single picture."""

    fitter: FrameFitter


Attempt = JudgedCandidate[FittedPicture]
"""A candidate of a single picture, judged by its blocks."""


@dataclass(frozen=True, eq=False)
class Member:
    """An effect of the corrected model: what the fit loses without it, and which effects did as well.

    `beside` is the evidence for it against every other effect that was tried in its place.
    """

    name: str
    gain: Gain
    equals: tuple[str, ...]
    beside: Mapping[str, Evidence] = field(default_factory=dict)


@dataclass
class FrameSearch:
    """Forward selection of effects on the blocks of one picture.

    Parameters
    ----------
    source : Renders
        Where pictures come from.
    model : SensorModel
        The model as given.
    shots : sequence of Shot
        The blocks, with the stated press.
    names : sequence of str
        Effects to try.
    """

    source: Renders
    model: SensorModel
    shots: Sequence[Shot]
    names: Sequence[str]
    tried: list[Candidate] = field(default_factory=list)
    members: list[Member] = field(default_factory=list)
    gap: float = 1.0
    _found: dict[str, Member] = field(default_factory=dict)

    def run(self) -> tuple[FittedPicture, FittedPicture]:
        """Register, add effects until none passes, drop those that are not needed any more.

        Returns
        -------
        Stand, Stand
            The model as given, light and pose fitted; and the corrected one.
        """
        stated = self._stated()
        given = self._settled(stated, ())
        now = given
        if SCALE in self.names:
            # From the stated pose too: a wrong scale may have driven it far off.
            stated = FittedPicture(given.fitter.about(stated.fitter.bank, stated.fitter.away), stated.fit)
            starts = [self._fitted(stand, (SCALE,)) for stand in (given, stated)]
            now = self._settled(min(starts, key=lambda stand: stand.fit.objective), (SCALE,))
        # Near the floor shares of the gap would be shares of next to nothing.
        self.gap = max(float(self.blocks(now).mean()) - self.floor(now), self.floor(now))
        open_ = [name for name in self.names if not effect(name).unseen_alone and name != SCALE]
        for name in self.names:
            if why := effect(name).unseen_alone:
                self.tried.append(Candidate(0, name, f"not tried, {why}"))
        nearby = None
        for number in range(1, OF_BLOCKS.most_effects + 1):
            if float(self.blocks(now).mean()) < ENVELOPE * self.floor(now):
                break
            if nearby is None:
                nearby = self._nearby(now, open_)
                self.source.work.begin("searching")
            found = self._round(number, now, nearby, [n for n in open_ if n not in now.state.values])
            if found is None:
                break
            now = self._settled(found.stand, (*now.state.values, found.name))
        return given, self._needed(now)

    def blocks(self, stand: FittedPicture, use: int = SELECT) -> Array:
        """Mean squared residual of each block of a use, in units of noise and granted errors."""
        sums, counts = self._squares(stand, use)
        return sums / counts

    def _squares(self, stand: FittedPicture, use: int) -> tuple[Array, Array]:
        """Sum of the squared residuals of each block of a use, and how many these are."""
        shot, noise = stand.fitter.bank.shots[use], stand.fitter.noises[use]
        left = ((shot.signal - stand.fitter.forward.predict(stand.state, use)) / noise.sigma) ** 2
        row, column = block_numbers(*shot.signal.shape[:2])
        place = np.broadcast_to((row * (column.max() + 1) + column)[..., None], left.shape)[shot.valid]
        sums, counts = np.bincount(place, left[shot.valid]), np.bincount(place)
        return np.asarray(sums[counts > 0]), counts[counts > 0].astype(float)

    def floor(self, stand: FittedPicture, use: int = SELECT) -> float:
        """Mean squared residual that grain and granted errors leave."""
        shot, noise = stand.fitter.bank.shots[use], stand.fitter.noises[use]
        return float(((noise.granted / noise.sigma) ** 2)[shot.valid].mean())

    def _stated(self) -> FittedPicture:
        """Fit light and pose about the stated pose."""
        away = np.zeros(len(POSE))
        fitter = FrameFitter(centred(self.source, self.model, self.shots, (), away, {}), away)
        fit = fitter.fit(fitter.start([TRAIN]), (), [TRAIN])
        fitter.measure(fit.state)
        return FittedPicture(fitter, fitter.fit(fit.state, (), [TRAIN]))

    def _fitted(self, stand: FittedPicture, names: Sequence[str]) -> FittedPicture:
        return FittedPicture(stand.fitter, stand.fitter.fit(stand.state, names, [TRAIN]))

    def _nearby(self, stand: FittedPicture, names: Sequence[str]) -> Snapshot:
        """Render changes of the picture of a fit, that of a finer mesh too."""
        away = stand.fitter.away
        return centred(self.source, self.model, self.shots, names, away, {}, finer=True).pictures[0]

    def _about(self, stand: FittedPicture, names: Sequence[str]) -> FrameFitter:
        """Fitter about pictures rendered where a fit ended."""
        away, values = stand.fitter.stated(stand.state), stand.state.values
        bank = centred(self.source, self.model, self.shots, names, away, values)
        return stand.fitter.about(bank, away)

    def _settled(
        self, stand: FittedPicture, names: Sequence[str], *, alike: float | None = None
    ) -> FittedPicture:
        """Fit effects about pictures rendered anew where the last fit ended, until it stays within reach.

        Values count by what is left of them there, which changes with the fit in turn; where `alike` is
        given, as many count as one.
        """
        for _ in range(SETTLING):
            fitter, state = stand.fitter, stand.state
            if alike is None:
                fitter = fitter.weighed(state)
            near = fitter.reaches(state)
            if near and abs(fitter.alike / stand.fitter.alike - 1.0) < SETTLED:
                break
            if not near:
                rendered = [name for name in names if effect(name).rendered]
                fitter = self._about(FittedPicture(fitter, stand.fit), rendered)
                state = replace(state, poses={})
            stand = FittedPicture(fitter, fitter.fit(state, names, [TRAIN]))
        return stand

    def _round(
        self, number: int, now: FittedPicture, nearby: Snapshot, names: Sequence[str]
    ) -> Attempt | None:
        base = FittedPicture(now.fitter.knowing(nearby), now.fit)
        attempts = [self._attempt(name, base, base) for name in names]
        if not attempts:
            return None
        # Pictures about the model without an effect tell little of one that moves walls, say: what may be the
        # best is fitted again where it stands.
        least = OF_BLOCKS.contending * max(each.evidence.value for each in attempts)
        attempts = [
            self._attempt(each.name, base, each.stand) if each.evidence.value > least else each
            for each in attempts
        ]
        attempts.sort(key=lambda each: -each.evidence.value)
        reasons = [OF_BLOCKS.refused(attempt) for attempt in attempts]
        for reason, attempt in zip(reasons, attempts, strict=True):
            self._note(number, attempt, reason or "passed")
        passed = [attempt for reason, attempt in zip(reasons, attempts, strict=True) if not reason]
        if not passed:
            return None

        def lead(one: Attempt, other: Attempt) -> Evidence:
            return self.evidence(one.stand, other.stand)

        best, equal = OF_BLOCKS.chosen(passed, lead)
        beside = {a.name: lead(best, a) for a in attempts if a is not best}
        self._found[best.name] = Member(best.name, best.gain, tuple(a.name for a in equal), beside)
        return best

    def _attempt(self, name: str, base: FittedPicture, begin: FittedPicture) -> Attempt:
        """Fit a candidate beside the effects of a model, about where it stood before, and judge it."""
        begun = time.perf_counter()
        self.source.work.tell(f"trying {name}")
        names = (*base.state.values, name)
        if begin is base:
            stand = self._fitted(begin, names)
        else:
            stand = self._settled(begin, names, alike=base.fitter.alike)
        gain, evidence = self._gain(self.blocks(base), self.blocks(stand)), self.evidence(stand, base)
        self.source.work.step(0.5)
        left = (float(self.blocks(base).mean()) - self.floor(base)) / self.gap
        seconds = time.perf_counter() - begun
        return Attempt(name, stand, gain, evidence, held_out=gain.value, left=left, seconds=seconds)

    def evidence(self, one: FittedPicture, other: FittedPicture) -> Evidence:
        """By how much one fit of blocks explains them better than another, priors of its values included."""
        scores, priors = [], []
        for stand in (one, other):
            parts = [self._squares(stand, use)[0] for use in (TRAIN, SELECT)]
            scores.append(-0.5 * np.concatenate(parts) / other.fitter.alike)
            priors.append(-0.5 * float(stand.fit.system.now @ stand.fit.system.now))
        apart = scores[0] - scores[1]
        error = float(apart.std(ddof=1)) * np.sqrt(len(apart))
        return Evidence(float(apart.sum()) + priors[0] - priors[1], error)

    def _gain(self, before: Array, after: Array) -> Gain:
        """Fall of the misfit as a share of the gap; its error from the spread between blocks."""
        falls = (before - after) / self.gap
        return Gain(float(falls.mean()), standard_error(falls), float((falls > 0).mean()))

    def _needed(self, now: FittedPicture) -> FittedPicture:
        """Leave out effects, the least first, without which the blocks that judge are fitted as well."""
        while now.state.values:
            names = list(now.state.values)
            whole, without = self.blocks(now), {name: self._without(now, name) for name in names}
            gains = {name: self._gain(self.blocks(less), whole) for name, less in without.items()}
            self.members = [
                replace(self._found.get(n, Member(n, gains[n], (n,))), gain=gains[n]) for n in names
            ]
            evidence = {name: self.evidence(now, less) for name, less in without.items()}
            least = min(names, key=lambda name: evidence[name].value)
            if _seen(evidence[least]):
                break
            last = OF_BLOCKS.most_effects + 1
            self.tried.append(Candidate(last, least, "left out again, others do without"))
            values = {n: v for n, v in now.state.values.items() if n != least}
            less = replace(now.state, values=values)
            rendered = [name for name in values if effect(name).rendered]
            fitter = self._about(FittedPicture(now.fitter, replace(now.fit, state=less)), rendered)
            state = replace(less, poses={})
            now = self._settled(FittedPicture(fitter, fitter.fit(state, list(values), [TRAIN])), list(values))
        if not now.state.values:
            self.members = []
        return now

    def _without(self, now: FittedPicture, name: str) -> FittedPicture:
        """Fit all effects but one anew."""
        null = effect(name).null(self.model.design)
        state = now.state.with_values(name, null)
        fit = now.fitter.fit(state, [n for n in state.values if n != name], (TRAIN,))
        return FittedPicture(now.fitter, fit)

    def _note(self, number: int, attempt: Attempt, outcome: str) -> None:
        values = attempt.stand.state.values[attempt.name]
        evidence, seconds = attempt.evidence.value, attempt.seconds
        self.tried.append(fitted(number, attempt.name, outcome, attempt.gain, values, evidence, seconds))


def _seen(evidence: Evidence) -> bool:
    """Whether evidence suffices for an effect."""
    return evidence.sure and evidence.value > OF_BLOCKS.evidence
