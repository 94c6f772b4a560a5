"""Gels that sensors are cast of, and how stiff they are.

Only moduli with a source stand in the table, and each says how it was found: moduli of one product differ
between methods, batches and cures by 30 % and more.
"""

from typing import Literal

from designlab.sensor.data import table
from geometries.spec import Spec, quantity

GelMethod = Literal["tensile", "compression", "indentation", "hardness", "stated"]


class GelMaterial(Spec):
    """A gel material is a castable gel, its elastic constants, and where they were read."""

    name: str
    """Name in designs."""
    modulus_mpa: float = quantity(unit="MPa", gt=0)
    """Young's modulus at small strain."""
    range_mpa: tuple[float, float] | None = None
    """Lowest and highest modulus by the sources (MPa); unknown when absent."""
    poisson: float = quantity(0.499, unit="1", gt=0, le=0.5)
    """Poisson's ratio; that usual of silicones when absent (assumption)."""
    shore: str = ""
    """Shore hardness with its scale, such as ``OO 30`` or ``A 10``; unknown when empty."""
    mixing_ratio: str = ""
    """Ratio in which the parts are mixed; unknown when empty."""
    in_sensors: bool = False
    """Whether its source is a camera-based tactile sensor, whose camera looks through it."""
    method: GelMethod
    """How the modulus was found: by a tensile or compression test, a fit to forces of a ball on a layer, a
    chart of hardness; or only stated by users."""
    source: str
    """Where the figures were read."""


MATERIALS = {name: GelMaterial(name=name, **content) for name, content in table("gels").items()}
"""The gels, read from `data/gels.toml`."""


def gel_material(name: str) -> GelMaterial:
    """Look up a gel by name.

    Raises
    ------
    ValueError
        If the name is unknown; the message lists the known ones.
    """
    try:
        return MATERIALS[name]
    except KeyError:
        raise ValueError(f"gel: unknown {name!r}; known are {', '.join(MATERIALS)}") from None
