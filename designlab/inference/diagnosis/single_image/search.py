"""The race on one picture: effects are fitted to some blocks and judged on others.

Unlike the race over many presses, departures may be large: a picture without a background is often one of a
sensor that nobody has measured. So pictures are rendered anew about whatever has been found, after each
effect that joins.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.render_cache import Renders
from designlab.inference.diagnosis.emulator.snapshots import Snapshot
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fit
from designlab.inference.diagnosis.result import Candidate
from designlab.inference.diagnosis.selection.forward_selection import PROMISING, fitted
from designlab.inference.diagnosis.selection.held_out import LEAST_SHARE, Gain, standard_error
from designlab.inference.diagnosis.selection.screening import screen
from designlab.inference.diagnosis.single_image.blocks import (
    SCALE,
    SELECT,
    TRAIN,
    FrameFitter,
    block_numbers,
    centred,
)
from designlab.measurement.shots import POSE, Shot
from designlab.simulation.effects import SensorModel, effect

MOST_EFFECTS = 6  # beside the scale
ENVELOPE = 1.3  # mean squared residual over the floor below which no further effect is looked for
FITTED = 8  # candidates of a round that are fitted to the end
SETTLING = 4  # times that pictures are rendered anew about what was found


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A fit with the pictures it is combined from."""

    fitter: FrameFitter
    fit: Fit

    @property
    def state(self) -> State:
        """Where the fit ended."""
        return self.fit.state


@dataclass(frozen=True, eq=False)
class FittedCandidate:
    """A candidate, fitted, its misfit on the blocks that judge, and its evidence by linear approximation."""

    name: str
    fit: Fit
    blocks: Array
    gain: Gain
    evidence: float


@dataclass(frozen=True, eq=False)
class Member:
    """An effect of the corrected model: what the fit loses without it, and which effects did as well."""

    name: str
    gain: Gain
    equals: tuple[str, ...]


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
    _equals: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def run(self) -> tuple[FittedModel, FittedModel]:
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
            starts = [self._fitted(stand, (SCALE,)) for stand in (given, stated)]
            now = self._settled(min(starts, key=lambda stand: stand.fit.objective), (SCALE,))
        # Near the floor shares of the gap would be shares of next to nothing.
        self.gap = max(float(self.blocks(now).mean()) - self.floor(now), self.floor(now))
        open_ = [name for name in self.names if not effect(name).unseen_alone and name != SCALE]
        for name in self.names:
            if why := effect(name).unseen_alone:
                self.tried.append(Candidate(0, name, f"not tried, {why}"))
        nearby = None
        for number in range(1, MOST_EFFECTS + 1):
            if float(self.blocks(now).mean()) < ENVELOPE * self.floor(now):
                break
            if nearby is None:
                nearby = self._nearby(now, open_)
            found = self._round(number, now, nearby, [n for n in open_ if n not in now.state.values])
            if found is None:
                break
            now = self._settled(
                FittedModel(now.fitter.knowing(nearby), found.fit), (*now.state.values, found.name)
            )
        return given, self._needed(now)

    def blocks(self, stand: FittedModel, use: int = SELECT) -> Array:
        """Mean squared residual of each block of a use, in units of noise and granted errors."""
        shot, noise = stand.fitter.bank.shots[use], stand.fitter.noises[use]
        left = ((shot.signal - stand.fitter.forward.predict(stand.state, use)) / noise.sigma) ** 2
        row, column = block_numbers(*shot.signal.shape[:2])
        place = np.broadcast_to((row * (column.max() + 1) + column)[..., None], left.shape)[shot.valid]
        sums, counts = np.bincount(place, left[shot.valid]), np.bincount(place)
        return np.asarray(sums[counts > 0] / counts[counts > 0])

    def floor(self, stand: FittedModel, use: int = SELECT) -> float:
        """Mean squared residual that grain and granted errors leave."""
        shot, noise = stand.fitter.bank.shots[use], stand.fitter.noises[use]
        return float(((noise.granted / noise.sigma) ** 2)[shot.valid].mean())

    def _stated(self) -> FittedModel:
        """Fit light and pose about the stated pose."""
        fitter = centred(self.source, self.model, self.shots, (), np.zeros(len(POSE)), {})
        fit = fitter.fit(fitter.start([TRAIN]), (), [TRAIN])
        fitter.measure(fit.state)
        return FittedModel(fitter, fitter.fit(fit.state, (), [TRAIN]))

    def _fitted(self, stand: FittedModel, names: Sequence[str]) -> FittedModel:
        return FittedModel(stand.fitter, stand.fitter.fit(stand.state, names, [TRAIN]))

    def _nearby(self, stand: FittedModel, names: Sequence[str]) -> Snapshot:
        """Render changes of the picture of a fit, that of a finer mesh too."""
        away = stand.fitter.away
        fitter = centred(self.source, self.model, self.shots, names, away, {}, finer=True)
        return fitter.bank.pictures[0]

    def _about(self, stand: FittedModel, names: Sequence[str]) -> FrameFitter:
        """Fitter about pictures rendered where a fit ended."""
        away, values = stand.fitter.stated(stand.state), stand.state.values
        fitter = centred(self.source, self.model, self.shots, names, away, values)
        fitter.noises = stand.fitter.noises
        return fitter

    def _settled(self, stand: FittedModel, names: Sequence[str]) -> FittedModel:
        """Fit effects about pictures rendered anew where the last fit ended, until it stays within reach."""
        for _ in range(SETTLING):
            if stand.fitter.reaches(stand.state):
                break
            rendered = [name for name in names if effect(name).rendered]
            fitter, state = self._about(stand, rendered), replace(stand.state, poses={})
            stand = FittedModel(fitter, fitter.fit(state, names, [TRAIN]))
        return stand

    def _round(
        self, number: int, now: FittedModel, nearby: Snapshot, names: Sequence[str]
    ) -> FittedCandidate | None:
        fitter, base = now.fitter.knowing(nearby), now.fit
        screened, _ = screen(fitter, base.state, names, (TRAIN,))
        order = sorted(screened, key=lambda name: -screened[name])
        before = self.blocks(now)
        passed = []
        for place, name in enumerate(order):
            if place >= FITTED or screened[name] < PROMISING:
                self.tried.append(Candidate(number, name, "screened out", evidence=screened[name]))
                continue
            begun = time.perf_counter()
            fit = fitter.fit(base.state, (*base.state.values, name), (TRAIN,))
            seconds = time.perf_counter() - begun
            after = self.blocks(FittedModel(fitter, fit))
            attempt = FittedCandidate(name, fit, after, self._gain(before, after), screened[name])
            reason = self._refused(fitter, attempt)
            self._note(number, attempt, reason or "passed", seconds)
            if not reason:
                passed.append(attempt)
        if not passed:
            return None
        best = max(passed, key=lambda attempt: attempt.gain.value)
        self._equals[best.name] = tuple(a.name for a in passed if _not_told_apart(best, a))
        return best

    def _gain(self, before: Array, after: Array) -> Gain:
        """Fall of the misfit as a share of the gap; its error from the spread between blocks."""
        falls = (before - after) / self.gap
        error = standard_error(falls)
        squares = 1.0 - float(after.mean() / before.mean())
        value = float(falls.mean())
        return Gain(value, error, float((falls > 0).mean()), squares, value, error)

    def _refused(self, fitter: FrameFitter, attempt: FittedCandidate) -> str:
        """Why a candidate does not pass; empty if it does."""
        least = max(2 * attempt.gain.se, LEAST_SHARE)
        if attempt.gain.value < least:
            return f"closes {attempt.gain.value:.1%} of the gap, less than {least:.1%}"
        if bound := fitter.at_bound(attempt.fit.state, attempt.name):
            return f"at the bound of {', '.join(bound)}"
        return ""

    def _needed(self, now: FittedModel) -> FittedModel:
        """Leave out effects, the least first, without which the blocks that judge are fitted as well."""
        while now.state.values:
            names = list(now.state.values)
            whole = self.blocks(now)
            gains = {name: self._gain(self._without(now, name), whole) for name in names}
            self.members = [Member(n, gains[n], self._equals.get(n, (n,))) for n in names]
            least = min(names, key=lambda name: gains[name].value)
            if gains[least].value >= max(2 * gains[least].se, LEAST_SHARE):
                break
            self.tried.append(Candidate(MOST_EFFECTS + 1, least, "left out again, others do without"))
            values = {n: v for n, v in now.state.values.items() if n != least}
            less = replace(now.state, values=values)
            rendered = [name for name in values if effect(name).rendered]
            fitter = self._about(FittedModel(now.fitter, replace(now.fit, state=less)), rendered)
            state = replace(less, poses={})
            now = self._settled(FittedModel(fitter, fitter.fit(state, list(values), [TRAIN])), list(values))
        if not now.state.values:
            self.members = []
        return now

    def _without(self, now: FittedModel, name: str) -> Array:
        """Misfit of the blocks that judge, all other effects fitted anew."""
        null = effect(name).null(self.model.design)
        state = now.state.with_values(name, null)
        fit = now.fitter.fit(state, [n for n in state.values if n != name], (TRAIN,))
        return self.blocks(FittedModel(now.fitter, fit))

    def _note(self, number: int, attempt: FittedCandidate, outcome: str, seconds: float) -> None:
        values = attempt.fit.state.values[attempt.name]
        self.tried.append(
            fitted(number, attempt.name, outcome, attempt.gain, values, attempt.evidence, seconds)
        )


def _not_told_apart(best: FittedCandidate, other: FittedCandidate) -> bool:
    """Whether the blocks differ as much about which of two effects is better as they differ on the mean."""
    apart = other.blocks - best.blocks
    return other is best or float(apart.mean()) < 2 * float(apart.std(ddof=1)) / np.sqrt(len(apart))
