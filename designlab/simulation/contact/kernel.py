"""Contact by geometry: the probe displaces the gel, and a kernel smooths the step at its rim."""

import numpy as np
from scipy.signal import fftconvolve

from designlab.core.types import Array
from designlab.sensor.design import Contact
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Surface
from geometries.elastomer import Elastomer, base_gradient, base_mm
from geometries.probes import REACH, profile_mm

SUBSAMPLES = 3  # along each side of a grid cell


def indent(
    elastomer: Elastomer,
    contact: Contact,
    press: Press | None,
    *,
    area_mm: tuple[float, float],
    pitch_mm: float,
) -> Surface:
    """Deform the membrane by a press (none: the untouched gel) over an area centred on the origin.

    The probe displaces the gel where it would otherwise penetrate it; the step at its rim is then smoothed
    by the kernel (m + 1) / (m + exp(r / length)), cut at r = 6 lengths and normalised (arXiv 2012.13184).
    A contact with a tail raises the gel around the probe before.

    Parameters
    ----------
    elastomer : Elastomer
        The gel.
    contact : Contact
        How the gel smooths an indentation.
    press : Press or None
        The indentation; None leaves the gel untouched.
    area_mm : (float, float)
        Width and height of the area (mm).
    pitch_mm : float
        Distance of neighbouring grid points (mm).

    Returns
    -------
    Surface
        The membrane over the area.

    Raises
    ------
    ValueError
        If the press does not touch the membrane within the area.
    """
    x, y = _axis(area_mm[0], pitch_mm), _axis(area_mm[1], pitch_mm)[::-1]
    grid_x, grid_y = np.meshgrid(x, y)
    base = base_mm(elastomer, grid_x, grid_y)
    base_p, base_q = base_gradient(elastomer, grid_x, grid_y)
    if press is None:
        height, touched = np.zeros_like(base), np.zeros(base.shape, dtype=bool)
    else:
        penetration = _penetration(press, elastomer, base, grid_x, grid_y, pitch_mm)
        touched = penetration > 0
        if not touched.any():
            x_mm, y_mm = press.centre_mm
            raise ValueError(
                f"press.centre_mm: the {press.probe.kind} at ({x_mm:g}, {y_mm:g}) mm does not touch the "
                f"membrane within the simulated area of {2 * x[-1]:g} x {2 * y[0]:g} mm"
            )
        height = _smooth(_with_tail(penetration, contact, press.depth_mm, pitch_mm), contact, pitch_mm)
    return Surface(x, y, height, base, base_p, base_q, touched)


def _axis(length_mm: float, pitch_mm: float) -> Array:
    return _offsets(int(np.ceil(length_mm / 2 / pitch_mm)), pitch_mm)


def _offsets(steps: int, pitch_mm: float) -> Array:
    """Distances from the middle of a grid, in both directions."""
    return np.asarray(np.arange(-steps, steps + 1) * pitch_mm, dtype=float)


def _penetration(
    press: Press, elastomer: Elastomer, base: Array, x: Array, y: Array, pitch_mm: float
) -> Array:
    """How far the probe's upper side stands above the undeformed membrane, zero where it does not reach it.

    Averaged over sub-samples of each grid cell, so that sharp rims do not turn into stairs.
    """
    offsets = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
    reach = _reach_mm(press) + pitch_mm
    near = np.ix_(np.abs(y[:, 0] - press.centre_mm[1]) <= reach, np.abs(x[0] - press.centre_mm[0]) <= reach)
    raised = [
        _above(press, base[near], x[near] + dx * pitch_mm, y[near] + dy * pitch_mm)
        for dx in offsets
        for dy in offsets
    ]
    lifted = press.depth_mm - _first_touch(press, elastomer)
    penetration = np.zeros(base.shape)
    penetration[near] = np.mean([np.maximum(r + lifted, 0.0) for r in raised], axis=0)
    return penetration


def _reach_mm(press: Press) -> float:
    """Return the largest distance from the probe's axis to its outline."""
    return REACH[press.probe.kind] * press.probe.size_mm


def _with_tail(penetration: Array, contact: Contact, depth_mm: float, pitch_mm: float) -> Array:
    """Raise the gel around the probe: tail_share x depth at its outline, falling exponentially outside."""
    if contact.tail_share == 0:
        return penetration
    from scipy.ndimage import distance_transform_edt

    # To the edge of the touched cells, which lies half a cell before the centres of the nearest untouched.
    away_mm = np.maximum(distance_transform_edt(penetration == 0) - 0.5, 0.0) * pitch_mm
    tail = contact.tail_share * depth_mm * np.exp(-away_mm / contact.tail_mm)
    return np.asarray(np.maximum(penetration, tail))


def _first_touch(press: Press, elastomer: Elastomer) -> float:
    """Greatest height of the probe over the base, wherever that is: its depth counts from there."""
    if elastomer.shape == "flat":
        return 0.0  # a profile is zero at its foremost point
    reach = _reach_mm(press)
    x, y = np.meshgrid(*(centre + np.linspace(-reach, reach, 401) for centre in press.centre_mm))
    return float(_above(press, base_mm(elastomer, x, y), x, y).max())


def _above(press: Press, base: Array, x: Array, y: Array) -> Array:
    """Height of the probe's upper side over the base at points (mm); -inf beside probe or membrane."""
    angle = np.radians(press.yaw_deg)
    dx, dy = x - press.centre_mm[0], y - press.centre_mm[1]
    local_x = np.cos(angle) * dx + np.sin(angle) * dy
    local_y = -np.sin(angle) * dx + np.cos(angle) * dy
    above = profile_mm(press.probe, local_x, local_y) - base
    return np.asarray(np.where(np.isfinite(above), above, -np.inf))


def _smooth(height: Array, contact: Contact, pitch_mm: float) -> Array:
    if contact.kernel_length_mm == 0:
        return height
    reach = int(np.ceil(6 * contact.kernel_length_mm / pitch_mm))
    kernel = _cell_average(_offsets(reach, pitch_mm), pitch_mm, contact)
    smoothed = fftconvolve(np.pad(height, reach, mode="edge"), kernel, mode="valid")
    return np.asarray(np.maximum(smoothed, 0.0))


def _cell_average(offsets: Array, pitch_mm: float, contact: Contact) -> Array:
    """Kernel averaged over grid cells, so that its width does not depend on the pitch."""
    split = 8
    fine = (np.arange(split) + 0.5) / split - 0.5
    points = (offsets[:, None] + fine[None, :] * pitch_mm).ravel()
    r = np.hypot(points[:, None], points[None, :]) / contact.kernel_length_mm
    weight = np.where(r <= 6.0, (contact.kernel_m + 1) / (contact.kernel_m + np.exp(np.minimum(r, 6.0))), 0.0)
    size = len(offsets)
    kernel = weight.reshape(size, split, size, split).mean(axis=(1, 3))
    return np.asarray(kernel / kernel.sum())
