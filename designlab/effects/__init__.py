"""Physical effects a sensor model may lack: named, bounded, each the identity at its null value.

Adding one is a class in the module of its stage and an entry in `catalogue.CATALOGUE`.
"""

from designlab.effects.base import Effect, Parameter, Sight
from designlab.effects.catalogue import CATALOGUE
from designlab.effects.model import AppliedEffect, ModelError, SensorModel, effect, load_model

__all__ = [
    "CATALOGUE",
    "AppliedEffect",
    "Effect",
    "ModelError",
    "Parameter",
    "SensorModel",
    "Sight",
    "effect",
    "load_model",
]
