"""How the probe comes to the undeformed membrane: where its upper side is, and where it touches first."""

import numpy as np

from designlab.core.types import Array
from designlab.simulation.contact.press import Press
from geometries.elastomer import Elastomer, base_mm
from geometries.probes import REACH, profile_mm


def reach_mm(press: Press) -> float:
    """Return the largest distance from the probe's axis to its outline (mm)."""
    return REACH[press.probe.kind] * press.probe.size_mm


def first_touch_mm(press: Press, elastomer: Elastomer) -> float:
    """Greatest height of the probe over the base, wherever that is: its depth counts from there."""
    if elastomer.shape == "flat":
        return 0.0  # a profile is zero at its foremost point
    reach = reach_mm(press)
    x, y = np.meshgrid(*(centre + np.linspace(-reach, reach, 401) for centre in press.centre_mm))
    return float(above_mm(press, base_mm(elastomer, x, y), x, y).max())


def above_mm(press: Press, base: Array, x: Array, y: Array) -> Array:
    """Height of the probe's upper side over the base at points (mm); -inf beside probe or membrane."""
    angle = np.radians(press.yaw_deg)
    dx, dy = x - press.centre_mm[0], y - press.centre_mm[1]
    local_x = np.cos(angle) * dx + np.sin(angle) * dy
    local_y = -np.sin(angle) * dx + np.cos(angle) * dy
    above = profile_mm(press.probe, local_x, local_y) - base
    return np.asarray(np.where(np.isfinite(above), above, -np.inf))
