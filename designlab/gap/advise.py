"""What to measure next."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.gap.evidence import system
from designlab.gap.fit import Fitter
from designlab.gap.forward import Forward, State
from designlab.gap.noise import noise
from designlab.gap.result import Advice, Verdict
from designlab.gap.search import Search
from designlab.measurement.shots import Observations, Shot

Array = NDArray[np.float64]

FEW_HELD_OUT = 4
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
    """The frame on which the effects of the last coherence set differ most for its time."""
    pairs = list(combinations(search.alternatives.values(), 2))
    worth = []
    for action in _actions(fitter, seen):
        least = min(separation(fitter, action, *pair) for pair in pairs)
        worth.append((least / np.sqrt(action.minutes), least, action))
    _, apart, best = max(worth, key=lambda each: each[0])
    return Advice(best.text, apart, best.minutes, (best.frame,))


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
    pressed = [n for n in lit if shots[n].press is not None and shots[n].use == "train"]
    deepest = max(pressed, key=lambda n: shots[n].press.depth_mm if shots[n].press else 0.0)  # type: ignore[union-attr]
    press = shots[deepest].press
    assert press is not None
    fields = {
        "kind": "press",
        "probe": press.probe.text,
        "depth_mm": press.depth_mm,
        "centre_mm": list(press.centre_mm),
        "yaw_deg": press.yaw_deg,
    }
    for group, name in enumerate(names):
        shot = replace(shots[deepest], lit=np.eye(len(names))[group])
        text = f"{press.probe.text} pressed {press.depth_mm:g} mm deep with the {name} LEDs alone"
        found.append(Action(text, shot, deepest, 2.0, {**fields, "leds": [name]}))
    return found


def separation(fitter: Fitter, action: Action, first: State, second: State) -> float:
    """How far two states are apart in a frame, in standard deviations, gains and pose fitted anew."""
    bank = fitter.bank
    number = len(bank.shots)
    place = bank.place[action.like]
    shown = Forward(replace(bank, shots=(*bank.shots, action.shot), place=(*bank.place, place)))
    signal = shown.predict(first, number)
    shot = replace(action.shot, signal=signal, valid=np.ones(signal.shape, dtype=bool))
    bank = replace(bank, shots=(*bank.shots, shot), place=(*bank.place, place))
    taken = Fitter(bank)
    taken.noises = [
        *fitter.noises,
        noise(shot, signal, shown.untouched(first, number), shown.black, fitter.noises[action.like].grain),
    ]
    unknowns = taken.unknowns(second, (), [number])
    found = system(taken.forward, second, [number], unknowns, taken.noises, np.zeros(len(unknowns)))
    _, fallen = found.step(*taken.bounds(unknowns))
    return float(np.sqrt(max(found.misfit - fallen, 0.0)))
