"""Optical constants of the transparent materials these sensors are made of.

Indices are for 589 nm unless the source says otherwise; dispersion over the visible range (about 0.01 to
0.02) is not modelled.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Material:
    """A clear material: refractive index (pure number) and where the figure comes from."""

    name: str
    index: float
    source: str


# GGX alpha of a ground face: what the 2020 prototype's public scene gives its core (arXiv 2012.13184).
GROUND_ROUGHNESS = 0.3

AIR = Material("air", 1.0, "definition; air at 20 C is 1.00027")

MATERIALS: dict[str, Material] = {
    material.name: material
    for material in (
        AIR,
        Material("acrylic", 1.49, "PMMA at 589 nm, rounded; published values lie between 1.489 and 1.492"),
        Material("silicone", 1.41, "clear PDMS gels, 1.40 to 1.43 by makers' data sheets; rounded"),
        Material("resin-2020", 1.5403, "gelcore of the 2020 prototype, arXiv 2012.13184, public scene files"),
        Material("glass", 1.5168, "SCHOTT N-BK7 data sheet, n_d"),
    )
}


def material(name: str) -> Material:
    """Look up a material by name.

    Raises
    ------
    ValueError
        If the name is unknown; the message lists the known ones.
    """
    try:
        return MATERIALS[name]
    except KeyError:
        raise ValueError(f"material: unknown {name!r}; known are {', '.join(MATERIALS)}") from None
