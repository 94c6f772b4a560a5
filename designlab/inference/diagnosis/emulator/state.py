"""A state holds the values of all that is fitted; an unknown is one column of a linear fit."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.snapshots import Bank
from designlab.measurement.shots import POSE
from designlab.simulation.effects import AppliedEffect, SensorModel, effect

Values = Mapping[str, Mapping[str, float]]
Key = tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
"""Values of some effects, as a key of what is kept."""
SIZE = "own_size"
FRINGES = "lateral_colour"


class Unknown(NamedTuple):
    """One column of a linear fit: a parameter, the gain of an LED group, or what one shot has alone.

    `shot` is its number, or -1 where all shots share it. `sd` is the prior standard deviation in the unit of
    the state; columns are per standard deviation.
    """

    effect: str
    name: str
    sd: float
    shot: int = -1


@dataclass(frozen=True, eq=False)
class State:
    """Values of all unknowns.

    Attributes
    ----------
    values : mapping of effect to values
        Effects added to the model of the bank.
    gains : array, shape (groups,)
        Of the LED groups.
    poses : mapping of int to array
        Departure of a shot's pose from the stated one: x, y, depth (mm), yaw (deg).
    drawn : mapping of effect to mapping of int to array
        What a shot has alone, in units of the effect's strength: gain, or sine and cosine of its bands.
    patterns : mapping of effect to array, shape (rows, columns, 3)
        Relative patterns that all shots carry, of unit strength.
    numerical : float
        How far light goes from that of the membrane's mesh to that of a finer one; beyond 1 it extrapolates.
    sizes : mapping of str to float
        By how much probes are larger than stated, relative, by their text.
    fringes : float
        By how much the lens magnifies red more, and blue less, than green, relative.
    smooth_rms : float
        Size of the smooth error of light that all shots share, beyond what is granted, relative.
    """

    gains: Array
    values: Values = field(default_factory=dict)
    poses: Mapping[int, Array] = field(default_factory=dict)
    drawn: Mapping[str, Mapping[int, Array]] = field(default_factory=dict)
    patterns: Mapping[str, Array] = field(default_factory=dict)
    numerical: float = 0.0
    sizes: Mapping[str, float] = field(default_factory=dict)
    fringes: float = 0.0
    smooth_rms: float = 0.0

    def pose(self, number: int) -> Array:
        """Departure of a shot's pose."""
        return self.poses.get(number, np.zeros(len(POSE)))

    @property
    def rendered(self) -> Values:
        """Values of the effects that are rendered."""
        return {name: own for name, own in self.values.items() if effect(name).rendered}

    def with_values(self, name: str, values: Mapping[str, float]) -> "State":
        """Give an effect other values."""
        return replace(self, values={**self.values, name: dict(values)})

    def with_pattern(self, name: str, pattern: Array, strength: float) -> "State":
        """Give an effect that is a pattern of pixels another one, of unit strength, and its strength."""
        patterned = replace(self, patterns={**self.patterns, name: pattern})
        return patterned.with_values(name, {effect(name).per_pixel: strength})

    def without(self, name: str) -> "State":
        """Take an effect away."""
        values = {n: v for n, v in self.values.items() if n != name}
        drawn = {n: v for n, v in self.drawn.items() if n != name}
        patterns = {n: p for n, p in self.patterns.items() if n != name}
        return replace(self, values=values, drawn=drawn, patterns=patterns)

    def model(self, bank: Bank) -> SensorModel:
        """Model with the added effects, those that are at their null left out."""
        found = bank.model
        for name, values in self.values.items():
            if effect(name).acts(values, bank.model.design):
                found = found.with_effect(AppliedEffect(name=name, values=dict(values)))
        return found


def key(values: Values, names: Sequence[str]) -> Key:
    """Values of those effects, of some, that a state has."""
    return tuple((name, tuple(values[name].items())) for name in names if name in values)
