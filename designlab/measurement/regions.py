"""Regions of a picture as someone at the bench names them.

They are named by the imprint, by the LEDs that a camera channel answers to, and by the edge of the picture.
"""

import numpy as np
from scipy.ndimage import distance_transform_edt

from designlab.core.types import Array, Mask
from designlab.sensor.design import Design
from designlab.simulation.simulator import Frame

WALL_SLOPE = 0.15
RIM_MM = 0.5
AROUND_MM = 2.0
FACING = 0.5  # cosine between a wall's downhill direction and the way to the LEDs
CORNER = 0.8  # of the way from the middle of the picture to its corner


def regions(frame: Frame, design: Design, channel: int) -> dict[str, Mask]:
    """Regions of a picture as one channel sees it; every pixel lies in exactly one.

    Walls of an imprint are lit or unlit by the LED group that the channel answers to most.
    """
    own = design.leds.groups[int(np.abs(design.mixing_matrix[channel]).argmax())]
    azimuth = np.radians(own.azimuth_deg)
    towards = np.stack([np.cos(azimuth), np.sin(azimuth)])
    x, y = frame.seen_mm
    near = np.max(x[..., None] * towards[0] + y[..., None] * towards[1], axis=-1)
    low, high = np.quantile(near, (0.2, 0.8))
    p, q = frame.gradient
    slope = np.hypot(p, q)
    facing = np.max(-(p[..., None] * towards[0] + q[..., None] * towards[1]), axis=-1) / np.maximum(
        slope, 1e-9
    )
    wall = slope > WALL_SLOPE
    away_mm = _distance_mm(frame)
    far = np.hypot(x - x.mean(), y - y.mean())
    candidates = {
        f"slope of the imprint that faces the {own.name} LEDs": wall & (facing > FACING),
        f"slope of the imprint that faces away from the {own.name} LEDs": wall & (facing < -FACING),
        f"slope of the imprint sideways to the {own.name} LEDs": wall,
        "flat part of the imprint": frame.contact,
        "rim of the imprint, up to 0.5 mm outside": away_mm <= RIM_MM,
        "around the imprint, 0.5 to 2 mm outside": away_mm <= AROUND_MM,
        "corners of the picture": far > CORNER * far.max(),
        f"gel next to the {own.name} LEDs": near >= high,
        f"gel far from the {own.name} LEDs": near <= low,
        "rest of the gel": np.ones(near.shape, dtype=bool),
    }
    taken = np.zeros(near.shape, dtype=bool)
    atlas = {}
    for name, place in candidates.items():
        atlas[name] = place & ~taken
        taken |= place
    return atlas


def _distance_mm(frame: Frame) -> Array:
    """Distance of every pixel from the contact; infinite without one."""
    if not frame.contact.any():
        return np.full(frame.contact.shape, np.inf)
    pitch = np.abs(np.diff(frame.rays.y_mm, axis=0)).mean(), np.abs(np.diff(frame.rays.x_mm, axis=1)).mean()
    return np.asarray(distance_transform_edt(~frame.contact, sampling=pitch))
