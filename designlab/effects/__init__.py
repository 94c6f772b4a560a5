"""Physical effects a sensor model may lack: named, bounded, each the identity at its null value.

Adding one is a class in the module of its stage and an entry in `catalogue.CATALOGUE`.
"""

from designlab.effects.base import Effect, Parameter
from designlab.effects.camera import ColourMixing
from designlab.effects.catalogue import CATALOGUE
from designlab.effects.contact import ContactKernel
from designlab.effects.emission import LedPosition
from designlab.effects.model import AppliedEffect, ModelError, SensorModel, load_model

__all__ = [
    "CATALOGUE",
    "AppliedEffect",
    "ColourMixing",
    "ContactKernel",
    "Effect",
    "LedPosition",
    "ModelError",
    "Parameter",
    "SensorModel",
    "load_model",
]
