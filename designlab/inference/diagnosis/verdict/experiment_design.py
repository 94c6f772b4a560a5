"""Experiment design chooses the frames that tell apart, in least time, what a measurement does not."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.noise import noise
from designlab.inference.diagnosis.result import Advice
from designlab.inference.diagnosis.selection.criterion import OF_PRESSES, SURE_SE, JudgedCandidate, lead
from designlab.inference.diagnosis.selection.held_out import Stand
from designlab.measurement.frames_to_take import Action, frames_to_take, in_words
from designlab.measurement.usable_frames import without_cut

MOST_FRAMES = 12
LEAST_USE = 0.1  # rise of the logarithm of the Bayes factor below which no frame is asked for
SURELY = 1.5  # times what is needed: predicted frames do not have what the model lacks in all real ones


def separating(fitter: Fitter, equals: Sequence[JudgedCandidate[Stand]]) -> Advice:
    """Frames that would leave one of several effects, whichever is true, in the least time.

    Parameters
    ----------
    fitter : Fitter
        What is fitted to the frames there are.
    equals : sequence of JudgedCandidate
        Fits of effects that do as well as each other, more than one.

    Returns
    -------
    Advice
        The frames, and by how many standard deviations the closest two would differ there.
    """
    actions = frames_to_take(fitter.bank.shots, fitter.forward.design.group_names)
    doubts = [doubt_of(*pair, actions) for pair in permutations(equals, 2)]
    chosen = _chosen(doubts, [action.minutes for action in actions])
    if not chosen:
        return Advice("no frame is known that would tell apart what does as well")
    taken = [actions[number] for number in chosen]
    leads = [doubt.lead(chosen) for doubt in doubts]
    enough = all(lead >= doubt.needed for lead, doubt in zip(leads, doubts, strict=True))
    return Advice(
        in_words(taken) + ("" if enough else "; even that may not tell them apart"),
        float(np.sqrt(2 * max(min(leads), 0.0))),
        sum(action.minutes for action in taken),
        tuple(action.frame for action in taken),
    )


def _chosen(doubts: Sequence["Doubt"], minutes: Sequence[float]) -> list[int]:
    """Numbers of frames, by what each tells for its minutes, until they suffice or none tells more."""
    chosen: list[int] = []
    told = _told(doubts, chosen)
    while len(chosen) < MOST_FRAMES:
        use = {n: _told(doubts, [*chosen, n]) - told for n in range(len(minutes)) if n not in chosen}
        best = max(use, key=lambda number: use[number] / minutes[number], default=-1)
        if use.get(best, 0.0) < LEAST_USE:
            break
        chosen.append(best)
        told += use[best]
    return chosen


def _told(doubts: Sequence["Doubt"], chosen: Sequence[int]) -> float:
    """What frames tell of all doubts, of each no more than surely suffices."""
    return sum(min(doubt.lead(chosen), SURELY * doubt.needed) for doubt in doubts)


@dataclass(frozen=True, eq=False)
class Doubt:
    """What frames would tell if one effect is true and another is fitted in its place.

    Attributes
    ----------
    needed : float
        By how much the logarithm of the Bayes factor must rise until the wrong one counts as worse.
    before : array, shape (n, n)
        Information about what all shots share in the fit of the wrong one, from the shots there are.
    frames : list of (array of shape (n, n), array of shape (n,), float)
        Of each frame: information, right side, and misfit at that fit.
    """

    needed: float
    before: Array
    frames: Sequence[tuple[Array, Array, float]]

    def lead(self, chosen: Sequence[int]) -> float:
        """Rise of the logarithm of the Bayes factor by some of the frames, the wrong effect fitted anew."""
        matrix, right, misfit = self.before, np.zeros(len(self.before)), 0.0
        for information, side, missed in (self.frames[number] for number in chosen):
            matrix, right, misfit = matrix + information, right + side, misfit + missed
        return 0.5 * float(misfit - right @ np.linalg.solve(matrix, right))


def doubt_of(true: JudgedCandidate[Stand], wrong: JudgedCandidate[Stand], actions: Sequence[Action]) -> Doubt:
    """What frames would tell if one attempt is true and another is wrong."""
    here = range(len(wrong.stand.fitter.bank.shots), len(wrong.stand.fitter.bank.shots) + len(actions))
    told = _taking(true.stand.fitter, actions)
    taken, noises = [], [*wrong.stand.fitter.noises]
    for number, action in zip(here, actions, strict=True):
        state = true.stand.state
        signal = told.predict(state, number)
        shot = without_cut(replace(action.shot, signal=signal, valid=np.ones(signal.shape, dtype=bool)))
        random, grain = wrong.stand.fitter.noises[action.like].random, wrong.stand.fitter.grain
        bare = told.untouched(state, number)
        of_groups = told.of_groups(state, number) if wrong.stand.fitter.fits_smooth else None
        noises.append(noise(shot, signal, bare, of_groups, told.black, random, grain=grain))
        taken.append(replace(action, shot=shot))
    state, found = wrong.stand.state, wrong.stand.fit.system
    fitter = wrong.stand.fitter.of(_taking(wrong.stand.fitter, taken).bank, noises).given(found.shared)
    right = true.stand.fitter.of(_taking(true.stand.fitter, taken).bank, noises)
    right = right.given(true.stand.fit.system.shared)
    shared = [k for k, u in enumerate(found.unknowns) if u.shot < 0]
    information, _ = found.reduced(shared)
    ours = [found.unknowns[k] for k in shared]
    frames = []
    for number in here:
        own = [u for u in fitter.unknowns(state, state.values, [number], gains=False) if u.shot == number]
        both = replace(fitter.system(state, [number], [*ours, *own]), now=np.zeros(len(ours) + len(own)))
        _, fallen = both.only(lambda u: u.shot >= 0).step(*fitter.bounds(own))
        # The true effect misses nothing; what the freedom of its smooth error costs is no lead of it.
        missed = both.misfit - fallen - right.system(true.stand.state, [number], ()).logdet
        frames.append((*both.reduced(range(len(ours))), missed))
    ahead = lead(true, wrong)
    needed = max(OF_PRESSES.as_good, SURE_SE * ahead.se) - ahead.value
    return Doubt(needed, information + np.eye(len(shared)), frames)


def _taking(fitter: Fitter, actions: Sequence[Action]) -> Forward:
    """Forward model of a fitter's pictures with frames besides its own shots."""
    bank = fitter.bank
    shots = (*bank.shots, *(action.shot for action in actions))
    return Forward(replace(bank, shots=shots, place=(*bank.place, *(bank.place[a.like] for a in actions))))
