"""Experiment design chooses the frames that tell apart, in least time, what a measurement does not."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.noise import noise
from designlab.inference.diagnosis.result import Advice
from designlab.inference.diagnosis.selection.acceptance import JudgedCandidate, least_lead
from designlab.measurement.shots import Shot
from designlab.measurement.usable_frames import end_at_zero, without_cut
from designlab.simulation.contact.press import Press

MOST_FRAMES = 12
LEAST_USE = 0.1  # rise of the logarithm of the Bayes factor below which no frame is asked for
SURELY = 1.5  # times what is needed: predicted frames do not have what the model lacks in all real ones
DARK = {"kind": "dark", "leds": []}


@dataclass(frozen=True, eq=False)
class Action:
    """A frame that could be taken: in words, as a shot with the picture of another, minutes, in fields.

    `alone` is the LED group that is on where the others are not.
    """

    text: str
    shot: Shot
    like: int
    minutes: float
    frame: Mapping[str, Any]
    alone: str | None = None


def separating(fitter: Fitter, equals: Sequence[JudgedCandidate]) -> Advice:
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
    actions = frames_to_take(fitter)
    doubts = [doubt_of(*pair, actions) for pair in permutations(equals, 2)]
    chosen = _chosen(doubts, [action.minutes for action in actions])
    if not chosen:
        return Advice("no frame is known that would tell apart what does as well")
    taken = [actions[number] for number in chosen]
    leads = [doubt.lead(chosen) for doubt in doubts]
    enough = all(lead >= doubt.needed for lead, doubt in zip(leads, doubts, strict=True))
    return Advice(
        _in_words(taken) + ("" if enough else "; even that may not tell them apart"),
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


def doubt_of(true: JudgedCandidate, wrong: JudgedCandidate, actions: Sequence[Action]) -> Doubt:
    """What frames would tell if one attempt is true and another is wrong."""
    here = range(len(wrong.fitter.bank.shots), len(wrong.fitter.bank.shots) + len(actions))
    told = _taking(true.fitter, actions)
    taken, noises = [], [*wrong.fitter.noises]
    for number, action in zip(here, actions, strict=True):
        signal = told.predict(true.fit.state, number)
        shot = without_cut(replace(action.shot, signal=signal, valid=np.ones(signal.shape, dtype=bool)))
        random = wrong.fitter.noises[action.like].random
        noises.append(noise(shot, signal, told.untouched(true.fit.state, number), told.black, random))
        taken.append(replace(action, shot=shot))
    fitter = wrong.fitter.of(_taking(wrong.fitter, taken).bank, noises)
    state, found = wrong.fit.state, wrong.fit.system
    shared = [k for k, u in enumerate(found.unknowns) if u.shot < 0]
    information, _ = found.reduced(shared)
    ours = [found.unknowns[k] for k in shared]
    frames = []
    for number in here:
        own = [u for u in fitter.unknowns(state, state.values, [number], gains=False) if u.shot == number]
        both = replace(fitter.system(state, [number], [*ours, *own]), now=np.zeros(len(ours) + len(own)))
        _, fallen = both.only(lambda u: u.shot >= 0).step(*fitter.bounds(own))
        frames.append((*both.reduced(range(len(ours))), both.misfit - fallen))
    needed = least_lead(true.evidence) - (true.evidence - wrong.evidence)
    return Doubt(needed, information + np.eye(len(shared)), frames)


def _taking(fitter: Fitter, actions: Sequence[Action]) -> Forward:
    """Forward model of a fitter's pictures with frames besides its own shots."""
    bank = fitter.bank
    shots = (*bank.shots, *(action.shot for action in actions))
    return Forward(replace(bank, shots=shots, place=(*bank.place, *(bank.place[a.like] for a in actions))))


def frames_to_take(fitter: Fitter) -> list[Action]:
    """Frames that could be taken of a measurement's sensor."""
    shots, names = fitter.bank.shots, fitter.forward.design.group_names
    lit = [n for n, shot in enumerate(shots) if shot.lit.any()]
    untouched = next(n for n in lit if shots[n].press is None)
    background = shots[untouched]
    everything = np.ones(len(names))

    def bare(text: str, minutes: float, fields: Mapping[str, Any], **changes: Any) -> Action:
        shot = replace(background, **changes)
        return Action(text, shot, untouched, minutes, {"kind": "background", **fields})

    found = _lit_alone("a background", background, untouched, names, 1.0, {"kind": "background"})
    turned = {"gel_rotation_deg": 180.0}
    found += [
        bare("a frame with the LEDs off", 0.5, DARK, lit=0 * everything, clips=end_at_zero(shots)),
        bare("a background at a quarter of the exposure", 0.5, {"exposure": 0.25}, lit=everything / 4),
        bare("a background with the gel turned by 180 deg", 10.0, turned, lit=everything, **turned),
    ]
    # Places keep their use: a frame at one that judges would decide nothing.
    deepest: dict[tuple[float, float], tuple[Press, int]] = {}
    for n in lit:
        if (press := shots[n].press) is not None and shots[n].use == "train":
            place = press.centre_mm
            if place not in deepest or press.stated_depth_mm > deepest[place][0].stated_depth_mm:
                deepest[place] = press, n
    for press, n in deepest.values():
        (x_mm, y_mm), probe = press.centre_mm, press.probe.text
        text = f"{probe} pressed {press.stated_depth_mm:g} mm deep at ({x_mm:g}, {y_mm:g}) mm"
        fields = {
            "kind": "press",
            "probe": probe,
            "depth_mm": press.stated_depth_mm,
            "centre_mm": [x_mm, y_mm],
            "yaw_deg": press.yaw_deg,
        }
        found += _lit_alone(text, shots[n], n, names, 2.0, fields)
    return found


def _lit_alone(
    text: str, shot: Shot, number: int, names: Sequence[str], minutes: float, fields: Mapping[str, Any]
) -> list[Action]:
    """A shot once more with each LED group alone."""
    return [
        Action(text, replace(shot, lit=lit), number, minutes, {**fields, "leds": [name]}, name)
        for lit, name in zip(np.eye(len(names)), names, strict=True)
    ]


def _in_words(actions: Sequence[Action]) -> str:
    """Frames one after the other, those that differ by their LED group alone as one."""
    groups: dict[str, list[str]] = {}
    for action in actions:
        groups.setdefault(action.text, []).extend([] if action.alone is None else [action.alone])
    return "; ".join(_with_light(text, names) for text, names in groups.items())


def _with_light(text: str, names: Sequence[str]) -> str:
    if not names:
        return text
    if len(names) == 1:
        return f"{text} with the {names[0]} LEDs alone"
    return f"{text} with the {', '.join(names[:-1])} and {names[-1]} LEDs, each alone"
