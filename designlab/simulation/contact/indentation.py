"""The membrane under a press, by whichever model of contact the design has."""

import numpy as np

from designlab.core.types import Array
from designlab.sensor.contact import Contact, KernelContact
from designlab.simulation.contact import along_normal, kernel, layer
from designlab.simulation.contact.along_normal import Turn
from designlab.simulation.contact.approach import named, require_thick
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Surface
from geometries.elastomer import Elastomer, base_gradient, base_mm


def indent(
    elastomer: Elastomer,
    contact: Contact,
    press: Press | None,
    *,
    area_mm: tuple[float, float],
    pitch_mm: float,
) -> Surface:
    """Deform the membrane by a press (none: the untouched gel) over an area centred on the origin.

    Parameters
    ----------
    elastomer : Elastomer
        The gel.
    contact : KernelContact or LayerContact
        How the gel answers a press.
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
        If the press does not touch the membrane within the area, is deeper than the gel or the probe is
        thick, or breaks a rule of the model of contact.
    NotConverged
        If no solution was found for an elastic gel.
    """
    untouched = _undeformed(elastomer, area_mm, pitch_mm)
    if press is None:
        return untouched
    surface = deform(untouched, elastomer, contact, press)
    depth_mm = press.depth_mm if surface.mechanics is None else surface.mechanics.depth_mm
    require_thick(press, depth_mm or 0.0)
    if not surface.contact.any():
        x_mm, y_mm = press.centre_mm
        raise ValueError(
            f"press.centre_mm: {named(press)} at ({x_mm:g}, {y_mm:g}) mm does not touch the "
            f"membrane within the simulated area of {2 * untouched.x_mm[-1]:g} x "
            f"{2 * untouched.y_mm[0]:g} mm"
        )
    return surface


def deform(untouched: Surface, elastomer: Elastomer, contact: Contact, press: Press) -> Surface:
    """Deform an undeformed membrane by a press along the axis or along the normal.

    Raises
    ------
    ValueError, NotConverged
        As `indent`, but for a press that touches nowhere on the surface.
    """
    turn = along_normal.turn_of(elastomer, press)
    if turn is None:
        return _deform(untouched, elastomer, contact, press, None)
    reach = 2 * along_normal.reach_mm(untouched, elastomer, turn)
    apex = _undeformed(elastomer, (reach, reach), untouched.pitch_mm)
    centred = press.model_copy(update={"centre_mm": (0.0, 0.0)})
    made = _deform(apex, elastomer, contact, centred, turn)
    return along_normal.turned(made, untouched, elastomer, turn, press)


def _deform(
    untouched: Surface, elastomer: Elastomer, contact: Contact, press: Press, turn: Turn | None
) -> Surface:
    if isinstance(contact, KernelContact):
        return kernel.deform(untouched, elastomer, contact, press)
    return layer.deform(untouched, elastomer, contact, press, turn=turn)


def _undeformed(elastomer: Elastomer, area_mm: tuple[float, float], pitch_mm: float) -> Surface:
    x, y = _axis(area_mm[0], pitch_mm), _axis(area_mm[1], pitch_mm)[::-1]
    grid_x, grid_y = np.meshgrid(x, y)
    base_p, base_q = base_gradient(elastomer, grid_x, grid_y)
    # On a sphere's equator the membrane is vertical, which no height over (x, y) can tell.
    upright = np.isfinite(base_p) & np.isfinite(base_q)
    base, base_p, base_q = (
        np.where(upright, field, np.nan) for field in (base_mm(elastomer, grid_x, grid_y), base_p, base_q)
    )
    return Surface(x, y, np.zeros_like(base), base, base_p, base_q, np.zeros(base.shape, dtype=bool))


def _axis(length_mm: float, pitch_mm: float) -> Array:
    """Distances from the middle of a grid, in both directions."""
    steps = int(np.ceil(length_mm / 2 / pitch_mm))
    return np.asarray(np.arange(-steps, steps + 1) * pitch_mm, dtype=float)
