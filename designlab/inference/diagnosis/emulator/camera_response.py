"""What pixels report in the mean: noise comes before a curve, and before counts are cut at zero."""

import math
from dataclasses import dataclass

import numpy as np

from designlab.core.memory import remembered
from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.state import Key, Values, key
from designlab.sensor.design import Design
from designlab.simulation.effects import CATALOGUE, SensorModel, Sight
from designlab.simulation.effects.base import Light, Signal
from designlab.simulation.imaging import Capture, expected, mean_answers

REACHES = 8  # of sampled curves, in each doubling of the brightest light
LEAST_BRIGHTEST = 1e-6
CURVES_KEPT = 64


class Answers:
    """What a camera's pixels report in the mean, by a model and the effects on the signal added to it.

    Parameters
    ----------
    model : SensorModel
        The model.
    design : Design
        What it makes of its design.

    Attributes
    ----------
    effects : tuple of str
        Effects on the signal, which show in a frame without light too.
    """

    def __init__(self, model: SensorModel, design: Design) -> None:
        self.model, self.camera = model, design.camera
        self.effects = tuple(e.name for e in CATALOGUE if "signal" in e.changes)
        self._kept: dict[tuple[int, Key], tuple[Array, Array]] = {}

    def reported(self, values: Values, mixed: Array) -> Array:
        """Signal of the camera for mixed light, (..., 3): what its pixels report in the mean.

        Every pixel of the sensor has its noise before it answers by a curve, frames are means of pixels. No
        pixel collects less than nothing, whatever a mixing that is negative takes from it.
        """
        effects = _Effects(self.model, values)
        if not effects.curved:
            return expected(mixed, Capture(self.camera, effects))
        lifted = expected(mixed, Capture(self.camera))
        if not np.isfinite(lifted).all():  # a fit that runs away
            return np.full_like(lifted, np.nan)
        levels, curves = self._curves(values, float(lifted.max()))
        means = [np.interp(lifted[..., c], levels, curves[:, c]) for c in range(3)]
        return np.stack(means, axis=-1)

    def curved(self, values: Values) -> bool:
        """Whether pixels answer otherwise than in proportion."""
        return self.model.curved or _Effects(self.model, values).curved

    def _curves(self, values: Values, brightest: float) -> tuple[Array, Array]:
        """Levels up to the brightest of a picture or a little more, and the mean answers to them, (n, 3).

        All pictures of a fit have the same curves but for how far these must reach.
        """
        octaves = math.ceil(math.log2(max(brightest, LEAST_BRIGHTEST)) * REACHES)
        answered, reach = _Effects(self.model, values).on_signal, 2.0 ** (octaves / REACHES)
        place = octaves, key(values, self.effects)
        return remembered(
            self._kept, place, lambda: mean_answers(answered, self.camera, reach), most=CURVES_KEPT
        )


@dataclass(frozen=True)
class _Effects:
    """Effects of a model and those that a state adds; light has passed them already."""

    model: SensorModel
    values: Values

    @property
    def curved(self) -> bool:
        """Whether an effect of the state is."""
        return any(e.curved and e.name in self.values for e in CATALOGUE)

    def on_light(self, light: Light, sight: Sight) -> Light:
        """Return the light as it is."""
        return light

    def on_signal(self, signal: Signal) -> Array:
        """Return the signal after the effects on it."""
        signal = self.model.on_signal(signal)
        for e in CATALOGUE:
            if e.name in self.values:
                signal = e.on_signal(signal, self.values[e.name])
        return np.asarray(signal, dtype=float)
