"""The object that the generator presses into its gel."""

from typing import NamedTuple

from geometries.probes import Probe


class Indenter(NamedTuple):
    """What is pressed, how deep and where; yaw counter-clockwise.

    `other` is a probe that the indentation is like to the share `wrong`; `beside` is pressed together.
    """

    probe: Probe
    depth_mm: float
    centre_mm: tuple[float, float]
    yaw_deg: float = 0.0
    other: Probe | None = None
    wrong: float = 0.0
    beside: "Indenter | None" = None
