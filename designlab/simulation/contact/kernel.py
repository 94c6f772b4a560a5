"""Contact by geometry: the probe displaces the gel, and a kernel smooths the step at its rim."""

from dataclasses import replace

import numpy as np

from designlab.core.types import Array
from designlab.sensor.contact import KernelContact
from designlab.simulation.contact.approach import above_mm, first_touch_mm, reach_mm, require_room, room_mm
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Surface
from geometries.elastomer import Elastomer

SUBSAMPLES = 3  # along each side of a grid cell
MOST_SHARE = 0.5  # of the gel's thickness
TOO_DEEP = (
    "the press is {depth_mm:.3g} mm deep in a gel of {room_mm:.3g} mm; beyond half of the thickness a real "
    "gel gives way around the probe, which contact.model = 'kernel' does not show"
)


def deform(untouched: Surface, elastomer: Elastomer, contact: KernelContact, press: Press) -> Surface:
    """Deform the membrane by a press.

    The probe displaces the gel where it would otherwise penetrate it; the step at its rim is then smoothed
    by the kernel (m + 1) / (m + exp(r / length)), cut at r = 6 lengths and normalised (arXiv 2012.13184).
    A contact with a tail raises the gel around the probe before.

    Parameters
    ----------
    untouched : Surface
        The undeformed membrane.
    elastomer, contact, press : Elastomer, KernelContact, Press
        The gel, how it smooths an indentation, and the indentation.

    Returns
    -------
    Surface
        The pressed membrane; it touches nowhere if the press lies beside the surface.

    Raises
    ------
    ValueError
        If the press states no depth, is deeper than the gel is thick, or moves sideways.
    """
    if press.depth_mm is None:
        raise ValueError(
            "press.force_n: contact.model = 'kernel' knows no force; state depth_mm, or use a gel with "
            "contact.model = 'layer'"
        )
    if press.moves_sideways:
        raise ValueError(
            "press.shear_mm, press.twist_deg: contact.model = 'kernel' knows no shear; use a gel with "
            "contact.model = 'layer' and contact.friction above 0"
        )
    depth_mm, pitch_mm, room = press.depth_mm, untouched.pitch_mm, room_mm(press, elastomer)
    require_room(press, room)
    x, y = np.meshgrid(untouched.x_mm, untouched.y_mm)
    penetration = _penetration(press, depth_mm, elastomer, untouched.base_mm, x, y, pitch_mm)
    height = _smooth(_with_tail(penetration, contact, depth_mm, pitch_mm), contact, pitch_mm)
    warnings = (TOO_DEEP.format(depth_mm=depth_mm, room_mm=room),) if depth_mm > MOST_SHARE * room else ()
    return replace(untouched, height_mm=height, contact=penetration > 0, warnings=warnings)


def _offsets(steps: int, pitch_mm: float) -> Array:
    """Distances from the middle of a grid, in both directions."""
    return np.asarray(np.arange(-steps, steps + 1) * pitch_mm, dtype=float)


def _penetration(
    press: Press, depth_mm: float, elastomer: Elastomer, base: Array, x: Array, y: Array, pitch_mm: float
) -> Array:
    """How far the probe's upper side stands above the undeformed membrane, zero where it does not reach it.

    Averaged over sub-samples of each grid cell, so that sharp rims do not turn into stairs.
    """
    offsets = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
    shift_x, shift_y = (shift.reshape(-1, 1, 1) for shift in np.meshgrid(offsets, offsets, indexing="ij"))
    reach = reach_mm(press) + pitch_mm
    near = np.ix_(np.abs(y[:, 0] - press.centre_mm[1]) <= reach, np.abs(x[0] - press.centre_mm[0]) <= reach)
    fine_x, fine_y = x[near] + shift_x * pitch_mm, y[near] + shift_y * pitch_mm
    raised = above_mm(press, base[near], fine_x, fine_y)  # at once: a mesh is gone through only once
    lifted = depth_mm - first_touch_mm(press, elastomer)
    penetration = np.zeros(base.shape)
    penetration[near] = np.maximum(raised + lifted, 0.0).mean(axis=0)
    return penetration


def _with_tail(penetration: Array, contact: KernelContact, depth_mm: float, pitch_mm: float) -> Array:
    """Raise the gel around the probe: tail_share x depth at its outline, falling exponentially outside."""
    if contact.tail_share == 0:
        return penetration
    from scipy.ndimage import distance_transform_edt

    # To the edge of the touched cells, which lies half a cell before the centres of the nearest untouched.
    away_mm = np.maximum(distance_transform_edt(penetration == 0) - 0.5, 0.0) * pitch_mm
    tail = contact.tail_share * depth_mm * np.exp(-away_mm / contact.tail_mm)
    return np.asarray(np.maximum(penetration, tail))


def _smooth(height: Array, contact: KernelContact, pitch_mm: float) -> Array:
    from scipy.signal import fftconvolve  # with much else, which takes a second

    if contact.kernel_length_mm == 0:
        return height
    reach = int(np.ceil(6 * contact.kernel_length_mm / pitch_mm))
    kernel = _cell_average(_offsets(reach, pitch_mm), pitch_mm, contact)
    smoothed = fftconvolve(np.pad(height, reach, mode="edge"), kernel, mode="valid")
    return np.asarray(np.maximum(smoothed, 0.0))


def _cell_average(offsets: Array, pitch_mm: float, contact: KernelContact) -> Array:
    """Kernel averaged over grid cells, so that its width does not depend on the pitch."""
    split = 8
    fine = (np.arange(split) + 0.5) / split - 0.5
    points = (offsets[:, None] + fine[None, :] * pitch_mm).ravel()
    r = np.hypot(points[:, None], points[None, :]) / contact.kernel_length_mm
    weight = np.where(r <= 6.0, (contact.kernel_m + 1) / (contact.kernel_m + np.exp(np.minimum(r, 6.0))), 0.0)
    size = len(offsets)
    kernel = weight.reshape(size, split, size, split).mean(axis=(1, 3))
    return np.asarray(kernel / kernel.sum())
