"""What to measure next."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.gap.fit import Fitter
from designlab.gap.forward import Forward
from designlab.gap.noise import noise
from designlab.gap.result import Advice, Verdict
from designlab.gap.search import Attempt, Search, least_lead
from designlab.measurement.shots import Observations, Shot

Array = NDArray[np.float64]

FEW_HELD_OUT = 4
MOST_FRAMES = 12
SURELY = 1.5  # times what is needed, since what is predicted leaves out what no model knows
DARK = {"kind": "dark", "leds": []}


@dataclass(frozen=True, eq=False)
class Action:
    """A frame that could be taken: in words, in fields, as a shot with the picture of another; minutes."""

    text: str
    shot: Shot
    like: int
    minutes: float
    frame: Mapping[str, Any]


def advise(fitter: Fitter, seen: Observations, search: Search, verdict: Verdict) -> Advice:
    """Name the measurement that would help most; without text where none is needed."""
    if verdict == "ambiguous":
        return _separating(fitter, seen, search)
    if not seen.repeats:
        return Advice("repeat the background twice: the noise floor is only assumed so far", minutes=1.0)
    if not seen.dark:
        return Advice(
            "one frame with the LEDs off: without it an additive floor hides in other effects",
            minutes=0.5,
            frames=(DARK,),
        )
    single = {int(np.argmax(s.lit)) for s in seen.shots if s.press is None and (s.lit > 0).sum() == 1}
    names = fitter.forward.design.group_names
    missing = [name for group, name in enumerate(names) if group not in single]
    if verdict in ("unexplained", "partial") and missing:
        return Advice(
            "one background for each LED group alone: it separates effects of light from those of the camera",
            minutes=float(len(missing)),
            frames=tuple({"kind": "background", "leds": [name]} for name in missing),
        )
    if verdict == "partial" and any(len(winner.coherence_set) > 1 for winner in search.winners):
        return _separating(fitter, seen, search)
    if verdict == "unexplained":
        return Advice(
            "the same press at two more depths, and turned by 180 deg with the gel: the first tells effects "
            "of contact from effects of light, the second effects of the gel from effects of the sensor",
            minutes=15.0,
        )
    held_out = len(seen.of("select"))
    if verdict in ("named", "partial") and held_out < FEW_HELD_OUT:
        more = FEW_HELD_OUT - held_out
        return Advice(
            f"presses at more places: only {held_out} held-out presses bear the verdict", minutes=2.0 * more
        )
    return Advice("")


def _separating(fitter: Fitter, seen: Observations, search: Search) -> Advice:
    """Frames that would leave one effect of the last coherence set, whichever it is, in the least time."""
    attempts = next(w.equals for w in reversed(search.winners) if len(w.equals) > 1)
    actions = _actions(fitter, seen)
    doubts = [_doubt(*pair, actions) for pair in permutations(attempts, 2)]
    chosen: list[int] = []
    leads = [0.0] * len(doubts)
    while len(chosen) < MOST_FRAMES and any(
        lead < SURELY * doubt.needed for lead, doubt in zip(leads, doubts, strict=True)
    ):
        worth = {}
        for number in range(len(actions)):
            if number not in chosen:
                then = [doubt.lead([*chosen, number]) for doubt in doubts]
                useful = sum(
                    min(after, SURELY * doubt.needed) - min(before, SURELY * doubt.needed)
                    for before, after, doubt in zip(leads, then, doubts, strict=True)
                )
                worth[number] = useful / actions[number].minutes, then
        best = max(worth, key=lambda number: worth[number][0])
        chosen.append(best)
        leads = worth[best][1]
    taken = [actions[number] for number in chosen]
    return Advice(
        "; ".join(action.text for action in taken),
        float(np.sqrt(2 * max(min(leads), 0.0))),
        sum(action.minutes for action in taken),
        tuple(action.frame for action in taken),
    )


@dataclass(frozen=True, eq=False)
class _Doubt:
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


def _doubt(true: Attempt, wrong: Attempt, actions: Sequence[Action]) -> _Doubt:
    """What frames would tell if one attempt is true and another is wrong."""
    shots = [action.shot for action in actions]
    place = [wrong.fitter.bank.place[action.like] for action in actions]
    here = range(len(wrong.fitter.bank.shots), len(wrong.fitter.bank.shots) + len(actions))
    told = _with_shots(true.fitter, shots, place)
    seen = [
        replace(shot, signal=told.predict(true.fit.state, number), valid=np.ones(shot.valid.shape, bool))
        for number, shot in zip(here, shots, strict=True)
    ]
    forward = _with_shots(wrong.fitter, seen, place)
    fitter = wrong.fitter.of(forward.bank, [])
    fitter.noises = [
        *wrong.fitter.noises,
        *(
            noise(
                shot,
                shot.signal,
                told.untouched(true.fit.state, number),
                told.black,
                wrong.fitter.noises[action.like].grain,
            )
            for action, number, shot in zip(actions, here, seen, strict=True)
        ),
    ]
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
    return _Doubt(needed, information + np.eye(len(shared)), frames)


def _with_shots(fitter: Fitter, shots: Sequence[Shot], place: Sequence[int]) -> Forward:
    """Forward model of a fitter's pictures with further shots at places that are among them."""
    bank = fitter.bank
    return Forward(replace(bank, shots=(*bank.shots, *shots), place=(*bank.place, *place)))


def _actions(fitter: Fitter, seen: Observations) -> list[Action]:
    """Frames that could be taken."""
    shots, names = fitter.bank.shots, fitter.forward.design.group_names
    lit = [n for n, shot in enumerate(shots) if shot.lit.any()]
    untouched = next(n for n in lit if shots[n].press is None)
    background = shots[untouched]
    everything = np.ones(len(names))

    def bare(text: str, minutes: float, fields: Mapping[str, Any], **changes: Any) -> Action:
        shot = replace(background, **changes)
        return Action(text, shot, untouched, minutes, {"kind": "background", **fields})

    found = [
        bare(
            f"a background with the {name} LEDs alone",
            1.0,
            {"leds": [name]},
            lit=np.eye(len(names))[group],
        )
        for group, name in enumerate(names)
    ]
    found.append(bare("a frame with the LEDs off", 0.5, DARK, lit=0 * everything))
    found.append(
        bare("a background at a quarter of the exposure", 0.5, {"exposure": 0.25}, lit=everything / 4)
    )
    found.append(
        bare(
            "a background with the gel turned by 180 deg",
            10.0,
            {"gel_rotation_deg": 180.0},
            lit=everything,
            gel_rotation_deg=180.0,
        )
    )
    # Places keep their use: a frame at one that judges would decide nothing.
    deepest: dict[tuple[float, float], int] = {}
    for n in lit:
        if (press := shots[n].press) is not None and shots[n].use == "train":
            other = shots[deepest.setdefault(press.centre_mm, n)].press
            if other is None or press.depth_mm > other.depth_mm:
                deepest[press.centre_mm] = n
    for n in deepest.values():
        found += _lit_alone(shots[n], n, names)
    return found


def _lit_alone(shot: Shot, number: int, names: Sequence[str]) -> list[Action]:
    """A press once more with each LED group alone."""
    press = shot.press
    assert press is not None
    fields = {
        "kind": "press",
        "probe": press.probe.text,
        "depth_mm": press.depth_mm,
        "centre_mm": list(press.centre_mm),
        "yaw_deg": press.yaw_deg,
    }
    x_mm, y_mm = press.centre_mm
    text = f"{press.probe.text} pressed {press.depth_mm:g} mm deep at ({x_mm:g}, {y_mm:g}) mm"
    return [
        Action(
            f"{text} with the {name} LEDs alone",
            replace(shot, lit=np.eye(len(names))[group]),
            number,
            2.0,
            {**fields, "leds": [name]},
        )
        for group, name in enumerate(names)
    ]
