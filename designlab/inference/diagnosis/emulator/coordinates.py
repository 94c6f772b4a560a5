"""Coordinates of parameters have priors of unit variance, and pictures are nearly linear in them."""

import numpy as np

from designlab.simulation.effects import EffectParameter


def coordinate(p: EffectParameter, value: float) -> float:
    """Distance of a value from null in prior standard deviations; of a squared parameter its square."""
    t = (value - p.null) / p.sd
    return t * t if p.squared else t


def value_at(p: EffectParameter, t: float) -> float:
    """Value of a parameter at a coordinate, within its bounds."""
    away = np.sqrt(max(t, 0.0)) if p.squared else t
    return float(np.clip(p.null + away * p.sd, p.low, p.high))
