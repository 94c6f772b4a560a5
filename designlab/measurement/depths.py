"""Depths of presses that state none: by their force, or by the contact circle read off the picture."""

import math

from designlab.sensor.design import Design
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from geometries.probes import Probe

MODULUS_SHARE = 0.2  # that a gel's modulus is off by: batches of one silicone differ so (estimate)
CIRCLE_SHARE = 0.1  # that circles read off pictures are off by: those of 22 real balls were 10.4 % too large
STEP = 1.1  # ratio of forces that tells how the depth rises with them
PITCH_MM = 0.1
FINE = 15  # points of a circle's radius
ROUNDS = 6


def cap_depth_mm(probe: Probe, radius_mm: float) -> float:
    """Depth (mm) at which a ball cuts the plane of the membrane in a circle.

    Raises
    ------
    ValueError
        If the probe is no ball, or the circle is larger than the ball.

    Examples
    --------
    >>> from geometries.probes import parse
    >>> round(cap_depth_mm(parse("sphere:5"), 1.5), 3)
    0.5
    """
    if probe.kind != "sphere":
        raise ValueError(f"contact circle: tells the depth of a sphere alone, the probe is a {probe.kind}")
    ball_mm = probe.size_mm / 2
    if radius_mm >= ball_mm:
        raise ValueError(
            f"contact circle: must be below the ball's radius of {ball_mm:g} mm, is {radius_mm:.3g} mm"
        )
    return ball_mm - math.sqrt(ball_mm**2 - radius_mm**2)


def by_force(press: Press, design: Design, force_sigma_n: float) -> tuple[Press, float]:
    """Return a press by force as one to the depth that the gel lets it go, and the depth's doubt (mm).

    The doubt is that of the force and that of the gel's modulus.

    Raises
    ------
    ValueError
        If the gel is no elastic layer, or cannot take the press.
    """
    force = press.force_n
    assert force is not None  # asked for these alone
    depth_mm, deeper_mm = (_mechanics(press, design, force_n=f)[0] for f in (force, STEP * force))
    share = math.hypot(force_sigma_n / force, MODULUS_SHARE)
    rise = math.log(deeper_mm / depth_mm) / math.log(STEP)
    return _to_depth(press, depth_mm), rise * share * depth_mm


def by_circle(press: Press, design: Design, radius_mm: float) -> tuple[Press, float]:
    """Return a press of a ball to the depth at which it touches a circle, and the depth's doubt (mm).

    An elastic gel sinks around a ball, which touches a smaller circle at the same depth.

    Parameters
    ----------
    press : Press
        To the depth of the cap, see `cap_depth_mm`.
    design : Design
        The sensor.
    radius_mm : float
        Of the circle.
    """
    depth_mm = press.stated_depth_mm
    if design.contact.model == "layer":
        pitch_mm = min(PITCH_MM, radius_mm / FINE)
        for _ in range(ROUNDS):
            touched = _mechanics(press, design, depth_mm=depth_mm, pitch_mm=pitch_mm)[1]
            depth_mm *= (radius_mm / touched) ** 2  # Hertz's power; that of a thin layer is hardly another
    return _to_depth(press, depth_mm), 2 * CIRCLE_SHARE * depth_mm


def _to_depth(press: Press, depth_mm: float) -> Press:
    return press.model_copy(update={"depth_mm": depth_mm, "force_n": None})


def _mechanics(
    press: Press,
    design: Design,
    *,
    force_n: float | None = None,
    depth_mm: float | None = None,
    pitch_mm: float = PITCH_MM,
) -> tuple[float, float]:
    """Depth and contact radius (mm) of a press to another depth or with another force."""
    other = press.model_copy(update={"depth_mm": depth_mm, "force_n": force_n})
    surface = indent(
        design.elastomer, design.contact, other, area_mm=design.sensing_area_mm, pitch_mm=pitch_mm
    )
    if surface.mechanics is None:
        raise ValueError("force_n: contact by the smoothing kernel knows no force")
    return surface.mechanics.depth_mm, surface.mechanics.contact_radius_mm
