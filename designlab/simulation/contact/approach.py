"""How the probe comes to the undeformed membrane: where its upper side is, and where it touches first."""

import math

import numpy as np

from designlab.core.types import Array
from designlab.simulation.contact.press import Press
from geometries.elastomer import Elastomer, base_mm, interface_mm
from geometries.probes import REACH, profile_mm, thickness_mm


def reach_mm(press: Press) -> float:
    """Return the largest distance from the probe's axis to its outline (mm)."""
    return REACH[press.probe.kind] * press.probe.size_mm


def named(press: Press) -> str:
    """What the probe is called in messages: a mesh by its file, size and side."""
    probe = press.probe
    if probe.file is None:
        return f"the {probe.kind}"
    return f"{probe.file} ({probe.size_mm:.4g} mm, {probe.side} side)"


def first_touch_mm(press: Press, elastomer: Elastomer) -> float:
    """Greatest height of the probe over the base, wherever that is: its depth counts from there."""
    if elastomer.shape == "flat":
        return 0.0  # a profile is zero at its foremost point
    x, y = over_gel_mm(press, elastomer, 401)
    return float(above_mm(press, base_mm(elastomer, x, y), x, y).max())


def over_gel_mm(press: Press, elastomer: Elastomer, points: int) -> tuple[Array, Array]:
    """Square grid of points (mm) around the probe's axis; of a probe larger than the gel, those over it."""
    reach, half = reach_mm(press), math.hypot(elastomer.width_mm, elastomer.length_mm) / 2
    steps = np.linspace(-1.0, 1.0, points)
    if reach <= half:
        x, y = (centre + reach * steps for centre in press.centre_mm)
    else:
        x, y = half * steps, half * steps
    grid_x, grid_y = np.meshgrid(x, y)
    return grid_x, grid_y


def room_mm(press: Press, elastomer: Elastomer) -> float:
    """Thickness of the gel along z where the probe touches first: it meets the core at this depth (mm)."""
    if elastomer.shape == "flat":
        return float(interface_mm(elastomer, *press.centre_mm))
    x, y = over_gel_mm(press, elastomer, 201)
    base = base_mm(elastomer, x, y)
    above = above_mm(press, base, x, y)
    first = int(above.argmax())
    if not np.isfinite(above.flat[first]):
        return np.inf  # beside the gel, which is refused elsewhere
    straight = float(interface_mm(elastomer, x.flat[first], y.flat[first])) - float(base.flat[first])
    foremost = float(interface_mm(elastomer, *press.centre_mm)) + first_touch_mm(press, elastomer)
    return min(straight, foremost)


def above_mm(press: Press, base: Array, x: Array, y: Array) -> Array:
    """Height of the probe's upper side over the base at points (mm); -inf beside probe or membrane."""
    angle = np.radians(press.yaw_deg)
    dx, dy = x - press.centre_mm[0], y - press.centre_mm[1]
    local_x = np.cos(angle) * dx + np.sin(angle) * dy
    local_y = -np.sin(angle) * dx + np.cos(angle) * dy
    above = profile_mm(press.probe, local_x, local_y) - base
    return np.asarray(np.where(np.isfinite(above), above, -np.inf))


def require_room(press: Press, room: float) -> None:
    """Raise `ValueError` unless a press ends before the core, which lies `room` (mm) below first touch."""
    if press.depth_mm is not None and press.depth_mm >= room:
        along = "z" if press.direction == "axis" else "its normal"
        raise ValueError(
            f"press.depth_mm: must be less than the gel is thick there, {room:.4g} mm along {along}, or the "
            f"probe meets the core; is {press.depth_mm:g} mm"
        )


def require_thick(press: Press, depth_mm: float) -> None:
    """Raise `ValueError` if a mesh is thinner than it is pressed deep (mm), as one in a wrong unit is."""
    if press.probe.kind == "mesh" and (thick := thickness_mm(press.probe)) < depth_mm:
        raise ValueError(
            f"press.depth_mm: {press.probe.file} is {thick:.4g} mm thick, less than the press is deep "
            f"({depth_mm:.4g} mm); press less deep, choose the side that presses (--probe-side), or state "
            "the unit of the file (--probe-unit)"
        )
