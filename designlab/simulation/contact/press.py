"""A press: which probe, how deep, and where."""

from pydantic import Field

from geometries.probes import Probe
from geometries.spec import Spec, quantity


class Press(Spec):
    """One indentation: which probe, how deep, where, and how it is turned."""

    probe: Probe = Field(description="The indenter.")
    depth_mm: float = quantity(
        unit="mm", gt=0, le=20, description="Largest penetration below the undeformed membrane, along z."
    )
    centre_mm: tuple[float, float] = Field(
        (0.0, 0.0), description="Where the probe's axis meets the membrane (x, y) (mm)."
    )
    yaw_deg: float = quantity(
        0.0, unit="deg", ge=-360, le=360, description="Rotation about z, counter-clockwise in the image."
    )
