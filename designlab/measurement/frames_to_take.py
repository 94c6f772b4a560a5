"""Frames that could be taken next of a sensor: with other light, or once more at places that were pressed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from designlab.measurement.shots import Shot
from designlab.measurement.usable_frames import end_at_zero
from designlab.simulation.contact.press import Press

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


def frames_to_take(shots: Sequence[Shot], names: Sequence[str]) -> list[Action]:
    """List frames that could be taken of a measurement's sensor.

    Parameters
    ----------
    shots : sequence of Shot
        Those there are, an untouched gel with light among them.
    names : sequence of str
        Names of the LED groups.
    """
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
            **({} if press.direction == "axis" else {"direction": press.direction}),
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


def in_words(actions: Sequence[Action]) -> str:
    """Write frames one after the other, those that differ by their LED group alone as one."""
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
