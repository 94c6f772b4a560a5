"""A press: which probe, how deep or with which force, and where."""

import math
from typing import Any, Literal, Self

from pydantic import field_validator, model_validator

from geometries.probes import Probe, parse
from geometries.spec import Spec, quantity

Direction = Literal["axis", "normal"]
LEAST_DEPTH_MM = 0.01  # of a press that errors of depth would lift off the gel


class Press(Spec):
    """A press is one indentation: which probe, how deep or with which force, where, and how it is turned.

    Parameters
    ----------
    probe : Probe or str
        The indenter, or its text, such as ``"sphere:4"``.
    depth_mm : float, optional
        Largest penetration below the undeformed membrane, along the press, in mm; at most 20.
    force_n : float, optional
        Force along the press in N instead of a depth, for gels that are elastic layers.
    centre_mm : tuple of two float
        Where the probe's axis meets the membrane, (x, y) in mm.
    direction : {"axis", "normal"}
        Along which the probe is pressed: the sensor's axis z, or the normal of the membrane at its centre.
        There a dome is turned by the shortest way until its apex is at the centre; yaw and shear are about
        and along the axes that turned with it.
    yaw_deg : float
        Rotation about the press in degrees, counter-clockwise in the image.
    shear_mm : tuple of two float
        How far the probe is then moved sideways, (x, y) in mm.
    twist_deg : float
        How far it is then turned about its axis, in degrees, counter-clockwise in the image.

    Raises
    ------
    pydantic.ValidationError
        If a value is out of its bounds, or neither or both of depth and force are stated.
    """

    probe: Probe
    """The indenter."""
    depth_mm: float | None = quantity(None, unit="mm", gt=0, le=20)
    """Largest penetration below the undeformed membrane, along the press."""
    force_n: float | None = quantity(None, unit="N", gt=0, le=1000)
    """Force along the press instead of a depth, for gels that are elastic layers."""
    centre_mm: tuple[float, float] = (0.0, 0.0)
    """Where the probe's axis meets the membrane (x, y) (mm)."""
    direction: Direction = "axis"
    """Along which the probe is pressed: the sensor's axis, or the normal of the membrane at the centre."""
    yaw_deg: float = quantity(0.0, unit="deg", ge=-360, le=360)
    """Rotation about the press, counter-clockwise in the image."""
    shear_mm: tuple[float, float] = (0.0, 0.0)
    """How far the probe is then moved sideways (x, y) (mm)."""
    twist_deg: float = quantity(0.0, unit="deg", ge=-90, le=90)
    """How far it is then turned about its axis, counter-clockwise in the image."""

    @field_validator("probe", mode="before")
    @classmethod
    def _from_text(cls, probe: Any) -> Any:
        return parse(probe) if isinstance(probe, str) else probe

    @model_validator(mode="after")
    def _depth_or_force(self) -> Self:
        if (self.depth_mm is None) == (self.force_n is None):
            raise ValueError("depth_mm, force_n: state one of them, how deep or with which force")
        return self

    @property
    def stated_depth_mm(self) -> float:
        """Depth (mm) of a press that states it.

        Raises
        ------
        ValueError
            If the press states a force.
        """
        if self.depth_mm is None:
            raise ValueError("press.depth_mm: needed here, the press states its force alone")
        return self.depth_mm

    def moved(self, x_mm: float, y_mm: float, depth_mm: float, yaw_deg: float) -> Self:
        """Return the press elsewhere, deeper and turned, but no less deep than `LEAST_DEPTH_MM`."""
        yaw_deg += self.yaw_deg
        changes: dict[str, object] = {
            "centre_mm": (self.centre_mm[0] + x_mm, self.centre_mm[1] + y_mm),
            "yaw_deg": yaw_deg if abs(yaw_deg) <= 360.0 else math.remainder(yaw_deg, 360.0),
        }
        if self.depth_mm is not None:
            changes["depth_mm"] = max(self.depth_mm + depth_mm, LEAST_DEPTH_MM)
        return self.model_copy(update=changes)

    @property
    def moves_sideways(self) -> bool:
        """Whether the probe is moved or turned once it touches."""
        return self.shear_mm != (0.0, 0.0) or self.twist_deg != 0.0
