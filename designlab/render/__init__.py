"""Rendering: the only part of designlab that imports Mitsuba and Dr.Jit."""

import numpy as np
from numpy.typing import NDArray

from designlab.scene import Scene


def transport(scene: Scene, *, samples: int, seed: int) -> NDArray[np.float32]:
    """Radiance of every LED group at unit flux, shape (groups, rows, columns), in mW/mm2/sr per mW.

    Parameters
    ----------
    scene : Scene
        What to render.
    samples : int
        Samples per pixel and LED group.
    seed : int
        Same seed, same numbers, on one back end.
    """
    from designlab.render import path

    return path.radiance(scene, samples=samples, seed=seed)
