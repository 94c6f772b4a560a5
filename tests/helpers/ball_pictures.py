"""Pictures of ball presses as a camera stores them, whose shape is known, for calibrations on balls."""

import numpy as np

from designlab.reconstruction.height import normals
from designlab.reconstruction.methods import Kernel
from tests.reconstruction.test_lab import AZIMUTHS, BACKGROUND, LEVEL, SLANT, picture, slopes

FULL = 1.4  # brightest value of the pictures
QUICK = Kernel(features=150)


def exposed(image):
    return np.clip(image / FULL, 0, 1).astype(np.float32)


def pressed(centre=(55, 45), contact_px=12.0):
    p, q, _ = slopes(centre, contact_px)
    return exposed(picture(p, q))


def pressed_twice(first, second):
    """Two balls at once, far enough from each other that their surfaces add up."""
    (p, q, _), (more_p, more_q, _) = slopes(*first), slopes(*second)
    return exposed(picture(p + more_p, q + more_q))


def of_other_sensor(p, q, *, turned_deg=0.0, colours=((1, 0, 0), (0, 1, 0), (0, 0, 1)), gradient=1.0):
    """The same shapes seen by a sensor whose lights stand elsewhere, mix or fall off otherwise."""
    azimuth = AZIMUTHS + np.radians(turned_deg)
    toward = np.stack(
        [np.sin(SLANT) * np.cos(azimuth), np.sin(SLANT) * np.sin(azimuth), np.full(3, np.cos(SLANT))]
    )
    level = 1 + gradient * (LEVEL[::-1, ::-1] - 1)
    return exposed(np.clip(level * np.maximum(normals(p, q) @ toward, 0) @ np.array(colours, float), 0, FULL))


def coin(shape, depth=0.15):
    """Slopes of a struck coin: a round rim, and letters of ridges within."""
    rows, columns = np.indices(shape)
    r = np.hypot(rows - shape[0] / 2, columns - shape[1] / 2)
    relief = depth / (1 + np.exp((r - 50) / 1.5))
    relief += 0.3 * depth * np.exp(-(((r - 44) / 2) ** 2))
    relief += 0.2 * depth * (np.sin(columns / 3) * np.sin(rows / 4) > 0.3) * (r < 36)
    down, across = np.gradient(relief, 0.1)
    return across, -down


UNTOUCHED = exposed(BACKGROUND)
