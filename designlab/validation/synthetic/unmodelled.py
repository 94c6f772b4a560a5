"""Unmodelled departures are in no catalogue: small ones that every set has, large ones not to be named."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from designlab.validation.synthetic.generator_sensor import Rig

Values = dict[str, Any]
Change = Callable[[Rig, float, np.random.Generator], tuple[Rig, Values]]

WEAKEST, STRONGEST = 0.1, 0.3  # of an unlisted effect, over its usual size
PRINTED_MM = (2.0, 0.5)  # pitch and diameter of printed dots


def outside_kinds() -> tuple[str, ...]:
    """Kinds of large departures that the catalogue does not know."""
    return tuple(_OUTSIDE)


def unlisted_kinds() -> tuple[str, ...]:
    """Kinds of small departures that a set has without mention."""
    return tuple(_UNLISTED)


def add_outside(rig: Rig, kinds: Mapping[str, float], *, random: np.random.Generator) -> tuple[Rig, Values]:
    """Put departures that the catalogue does not know into a sensor.

    Parameters
    ----------
    rig : Rig
        The sensor.
    kinds : mapping
        Kind to strength; at 1 the pictures change clearly.
    random : Generator
        Source of places and phases.

    Returns
    -------
    Rig, dict
        The changed sensor, and what each kind was drawn to be.

    Raises
    ------
    ValueError
        Naming kind, value and rule.
    """
    for kind, strength in kinds.items():
        if kind in _OUTSIDE and not 0 <= strength <= 2:
            raise ValueError(f"outside {kind}: strength lies between 0 and 2, got {strength:g}")
    return _added(rig, kinds, _OUTSIDE, "outside", random)


def add_unlisted(
    rig: Rig, kinds: Mapping[str, float] | None = None, *, random: np.random.Generator
) -> tuple[Rig, Values]:
    """Put one or two small departures into a sensor, or those asked for.

    Raises
    ------
    ValueError
        If a kind is unknown.
    """
    if kinds is None:
        chosen = random.choice(list(_UNLISTED), size=int(random.integers(1, 3)), replace=False)
        kinds = {str(kind): float(random.uniform(WEAKEST, STRONGEST)) for kind in sorted(chosen)}
    return _added(rig, kinds, _UNLISTED, "unlisted", random)


def _added(
    rig: Rig, kinds: Mapping[str, float], known: Mapping[str, Change], field: str, random: np.random.Generator
) -> tuple[Rig, Values]:
    found: Values = {}
    for kind, strength in kinds.items():
        if kind not in known:
            raise ValueError(f"{field}: {kind!r} is unknown; known are {', '.join(known)}")
        rig, values = known[kind](rig, strength, random)
        found[kind] = {"strength": float(strength), **values}
    return rig, found


def _waviness(rig: Rig, strength: float, random: np.random.Generator) -> tuple[Rig, Values]:
    """Ripples of a cast membrane, 6 um rms over 3 to 6 mm: 1.0 % of the median signal."""
    length_mm = random.uniform(3, 6, 8)
    direction, phase = random.uniform(0, 2 * np.pi, (2, 8))
    amplitude = np.full(8, strength * 0.006 / np.sqrt(8 / 2))
    number = 2 * np.pi / length_mm * np.exp(1j * direction)
    waves = np.stack([number.real, number.imag, amplitude, phase], axis=1)
    return replace(rig, waves=np.concatenate([rig.waves, waves])), {"rms_um": 6.0 * strength}


def _probe_size(rig: Rig, strength: float, random: np.random.Generator) -> tuple[Rig, Values]:
    """Probes 4 % larger or smaller than stated: 0.8 % of the median signal for a ball, 2.7 % for a prism."""
    scale = 1 + 0.04 * strength * float(random.choice([-1, 1]))
    whole = rig.contact.probe_scale * scale
    return replace(rig, contact=replace(rig.contact, probe_scale=whole)), {"scale": scale}


def _lateral_colour(rig: Rig, strength: float, random: np.random.Generator) -> tuple[Rig, Values]:
    """Lens that magnifies red and blue differently, by 1 % each way: 0.5 to 1.2 % of the median signal."""
    shift = 0.01 * strength * float(random.choice([-1, 1]))
    return replace(rig, lens=replace(rig.lens, colour_shift=shift)), {"share": shift}


def _printed_markers(rig: Rig, strength: float, random: np.random.Generator) -> tuple[Rig, Values]:
    """Grid of dark dots printed on the membrane."""
    return replace(rig, coat=replace(rig.coat, markers=(*PRINTED_MM, min(0.85 * strength, 1.0)))), {}


def _debris(rig: Rig, strength: float, random: np.random.Generator) -> tuple[Rig, Values]:
    """Grain on the gel, dark and casting shadows."""
    half = rig.coat.half_mm
    x, y = (float(random.uniform(-0.5, 0.5) * h) for h in half)
    size = float(np.sqrt(strength)) * min(half) / 6
    if size <= 0:
        return rig, {}
    return replace(rig, grain=(x, y, 0.6 * size, 0.5 * size)), {"place_mm": [x, y], "height_mm": 0.5 * size}


def _second_contact(rig: Rig, strength: float, random: np.random.Generator) -> tuple[Rig, Values]:
    """Something else touches the gel whenever the probe does."""
    half = rig.coat.half_mm
    turn = random.uniform(0, 2 * np.pi)
    x, y = float(0.6 * half[0] * np.cos(turn)), float(0.6 * half[1] * np.sin(turn))
    diameter, depth = min(half) / 2, 0.12 * min(half) * strength / 2
    if depth <= 0:
        return rig, {}
    second = (x, y, diameter, depth)
    return replace(rig, contact=replace(rig.contact, second=second)), {"place_mm": [x, y], "depth_mm": depth}


def _wrong_object(rig: Rig, strength: float, random: np.random.Generator) -> tuple[Rig, Values]:
    """Another probe than stated."""
    return replace(rig, contact=replace(rig.contact, wrong=min(strength, 1.0))), {}


def _water_drop(rig: Rig, strength: float, random: np.random.Generator) -> tuple[Rig, Values]:
    """Drop on the lens that blurs and shifts a part of the picture."""
    x, y = float(random.uniform(0.3, 0.7)), float(random.uniform(0.25, 0.5))
    drop = (x, y, 0.22 * np.sqrt(max(strength, 1e-6)), 0.06 * strength)
    return replace(rig, lens=replace(rig.lens, drop=drop)), {"place": [x, y]}


def _in_proportion(part: str, field: str, at_one: float, *, told: bool = False) -> Change:
    """Change of a field of a part of the rig in proportion to strength; told as a share, if so."""

    def change(rig: Rig, strength: float, random: np.random.Generator) -> tuple[Rig, Values]:
        value = at_one * strength
        changed: dict[str, Any] = {part: replace(getattr(rig, part), **{field: value})}
        return replace(rig, **changed), {"share": value} if told else {}

    return change


_UNLISTED: dict[str, Change] = {
    "membrane_waviness": _waviness,
    "probe_size": _probe_size,
    # Light smeared along the columns during read-out, 2 % of their mean: 2.5 % of the median signal.
    "column_smear": _in_proportion("sensor", "smear", 0.02, told=True),
    "lateral_colour": _lateral_colour,
    # Supply that sags: 2 % less light where all groups are on, 2.7 % of the median signal.
    "supply_sag": _in_proportion("sensor", "sag", 0.02, told=True),
}
_OUTSIDE: dict[str, Change] = {
    "printed_markers": _printed_markers,
    "debris": _debris,
    "second_contact": _second_contact,
    # Mirror images of the LEDs from reflections between lenses.
    "lens_ghost": _in_proportion("lens", "ghost", 0.3),
    "wrong_object": _wrong_object,
    # Pictures that went through a coarse block transform.
    "jpeg_blocks": _in_proportion("sensor", "jpeg", 1.0),
    # Coloured fringes.
    "moire": _in_proportion("sensor", "moire", 0.04),
    "water_drop": _water_drop,
}
