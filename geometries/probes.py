"""Standard objects that are pressed into the gel, and any mesh a user gives."""

from typing import TYPE_CHECKING, Literal, Self

from pydantic import Field, model_validator

from geometries.spec import Spec, quantity

if TYPE_CHECKING:
    import cadquery
    import numpy as np
    from numpy.typing import NDArray

ProbeKind = Literal["sphere", "triangle", "star", "cylinder", "cone", "prism", "dots", "wave", "mesh"]


class Probe(Spec):
    """An indenter. Local frame: its foremost point touches z = 0 and it extends towards -z; it moves along +z."""

    kind: ProbeKind = Field(description="Shape of the probe.")
    size_mm: float = quantity(unit="mm", gt=0.05, le=100, description="Characteristic size, see `SIZES`.")
    file: str | None = Field(None, description="Mesh file (STL or OBJ) of a probe of kind mesh.")
