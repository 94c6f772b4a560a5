"""Every known effect, in one place."""

from designlab.effects.base import Effect
from designlab.effects.camera import BlackLevel, ColourMixing
from designlab.effects.contact import ContactKernel
from designlab.effects.emission import LedPosition

CATALOGUE: tuple[Effect, ...] = (LedPosition(), ContactKernel(), ColourMixing(), BlackLevel())
"""Every known effect, in pipeline order: emission, contact, camera."""
