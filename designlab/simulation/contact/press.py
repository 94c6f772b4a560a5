"""A press: which probe, how deep, and where."""

from geometries.probes import Probe
from geometries.spec import Spec, quantity


class Press(Spec):
    """A press is one indentation: which probe, how deep, where, and how it is turned.

    Parameters
    ----------
    probe : Probe
        The indenter.
    depth_mm : float
        Largest penetration below the undeformed membrane, along z, in mm; at most 20.
    centre_mm : tuple of two float
        Where the probe's axis meets the membrane, (x, y) in mm.
    yaw_deg : float
        Rotation about z in degrees, counter-clockwise in the image.

    Raises
    ------
    pydantic.ValidationError
        If a value is out of its bounds.
    """

    probe: Probe
    """The indenter."""
    depth_mm: float = quantity(unit="mm", gt=0, le=20)
    """Largest penetration below the undeformed membrane, along z."""
    centre_mm: tuple[float, float] = (0.0, 0.0)
    """Where the probe's axis meets the membrane (x, y) (mm)."""
    yaw_deg: float = quantity(0.0, unit="deg", ge=-360, le=360)
    """Rotation about z, counter-clockwise in the image."""
