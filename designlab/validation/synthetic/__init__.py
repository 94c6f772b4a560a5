"""The generator makes measurements with its own surface, light, camera rays and effects.

Nothing of the renderer, of the effects that analysis fits, or of the contact model is shared with it, so that
a mistake there cannot cancel against the same mistake here.
"""

from designlab.validation.synthetic.generate import answer_path, plant, seal_path, unseal

__all__ = ["answer_path", "plant", "seal_path", "unseal"]
