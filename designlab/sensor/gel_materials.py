"""Gels and how stiff they are."""

from geometries.spec import Spec, quantity


class GelMaterial(Spec):
    """A gel material and its elastic constants."""

    name: str
    """Name of the material."""
    modulus_mpa: float = quantity(unit="MPa", gt=0)
    """Young's modulus."""
    poisson: float = quantity(unit="1", gt=0, le=0.5)
    """Poisson's ratio."""


def gel_material(name: str) -> GelMaterial:
    """Return a gel of the table."""
    if name != "gelsight-mini":
        raise ValueError(f"gel: unknown {name!r}; known are gelsight-mini")
    return GelMaterial(name=name, modulus_mpa=0.43, poisson=0.49)
