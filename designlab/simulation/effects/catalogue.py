"""Every known effect, in one place: what the module of each stage lists."""

from designlab.simulation.effects import camera, contact, emission, geometry, lens, material, transport
from designlab.simulation.effects.base import Effect

CATALOGUE: tuple[Effect, ...] = (
    *geometry.EFFECTS,
    *emission.EFFECTS,
    *transport.EFFECTS,
    *material.EFFECTS,
    *contact.EFFECTS,
    *lens.EFFECTS,
    *camera.EFFECTS,
)
"""Every known effect, in pipeline order: geometry, emission, transport, material, contact, camera."""

UNASKED: tuple[str, ...] = tuple(effect.name for effect in CATALOGUE if not effect.by_name)
"""Names of those that a diagnosis tries without being asked."""
