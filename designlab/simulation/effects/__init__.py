"""Physical effects a sensor model may lack: named, bounded, each the identity at its null value.

Adding one is a class in the module of its stage, and its place among `EFFECTS` there.
"""

from designlab.simulation.effects.base import Effect, EffectParameter, Sight
from designlab.simulation.effects.catalogue import CATALOGUE, UNASKED
from designlab.simulation.effects.model import AppliedEffect, ModelError, SensorModel, effect, load_model

__all__ = [
    "CATALOGUE",
    "UNASKED",
    "AppliedEffect",
    "Effect",
    "EffectParameter",
    "ModelError",
    "SensorModel",
    "Sight",
    "effect",
    "load_model",
]
