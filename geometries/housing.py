"""The opaque tube that holds gelcore, LEDs and camera."""

from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from geometries import step_part
from geometries.spec import Spec, quantity
from geometries.step_part import StepPart

if TYPE_CHECKING:
    import cadquery


CLEARANCE_MM = {"fdm": 0.2, "sla": 0.1}
"""Gap on each side between a seat and its part, by how the housing is printed."""


class Seats(Spec):
    """Seats that hold gelcore, LED boards and camera in the housing, and a lid over the camera."""

    fit: Literal["fdm", "sla"] = "fdm"
    """How body and lid are printed: fdm, melted filament, gaps of 0.2 mm; sla, cured resin, 0.1 mm."""
    clearance_mm: float | None = quantity(None, unit="mm", ge=0.02, le=1)
    """Gap on each side between a seat and its part; that of the fit when absent."""
    outline: Literal["round", "rectangle"] = "round"
    """Outside of the body: a tube, or a square block around it. The inside is round."""
    stop: Literal["collar", "tabs"] = "collar"
    """What the gelcore's window rests on: collar, a black tunnel from the camera plate down to it; tabs,
    ledges at the wall, where a collar would stand in the light of the LEDs."""
    collar_wall_mm: float = quantity(1.2, unit="mm", ge=0.8, le=10)
    """Thickness of the collar's wall, around the clear window."""
    camera: str = Field("raspberry-pi-camera-2", min_length=1, max_length=80)
    """Camera board that is seated, by its name in the table of modules."""
    fastening: Literal["insert", "self_tapping"] = "insert"
    """What the screws M2 of the lid go into: brass inserts melted into the body, or holes in the print."""

    @property
    def gap_mm(self) -> float:
        """Gap on each side between a seat and its part (mm)."""
        return CLEARANCE_MM[self.fit] if self.clearance_mm is None else self.clearance_mm


class Housing(Spec):
    """Round tube from the membrane's edge up to the camera plate, or a part of one's own. Sensor frame."""

    inner_radius_mm: float = quantity(17.0, unit="mm", gt=1, le=200)
    """Inner radius of the tube."""
    wall_mm: float = quantity(2.0, unit="mm", gt=0, le=50)
    """Thickness of the tube's wall."""
    bottom_mm: float = quantity(1.0, unit="mm", ge=-50, le=100)
    """Height of the lower rim above the membrane plane; the gel stands proud of it."""
    top_mm: float = quantity(30.0, unit="mm", gt=0, le=300)
    """Height of the camera plate's underside."""
    plate_mm: float = quantity(2.0, unit="mm", gt=0, le=50)
    """Thickness of the camera plate."""
    camera_hole_mm: float = quantity(8.0, unit="mm", gt=0, le=100)
    """Diameter of the hole in the camera plate."""
    seats: Seats | None = None
    """Seats for gelcore, LED boards and camera, and a lid; `seats = true` takes their defaults. A plain tube
    when absent."""

    step: StepPart | None = None
    """A housing of one's own instead of the tube, from a closed STEP file; inner_radius_mm, bottom_mm, top_mm
    and camera_hole_mm say what room it leaves, for the rules."""

    @field_validator("seats", mode="before")
    @classmethod
    def _seats_as_a_switch(cls, seats: Any) -> Any:
        """Take true for seats as they are by default, and false for none."""
        return ({} if seats else None) if isinstance(seats, bool) else seats

    @model_validator(mode="after")
    def _tube_has_length_and_plate(self) -> Self:
        if self.top_mm <= self.bottom_mm:
            raise ValueError(
                f"top_mm: must be above bottom_mm ({self.bottom_mm:g} mm), is {self.top_mm:g} mm"
            )
        if self.camera_hole_mm >= 2 * self.inner_radius_mm:
            raise ValueError(
                f"camera_hole_mm: must be below the inner diameter ({2 * self.inner_radius_mm:g} mm), "
                f"is {self.camera_hole_mm:g} mm"
            )
        if self.step is not None and self.seats is not None:
            raise ValueError(
                "step: a housing of one's own has the seats that it is drawn with; leave out seats"
            )
        return self


def solid(spec: Housing) -> "cadquery.Workplane":
    """Build tube and camera plate as one closed solid in the sensor frame (mm), or take one's own."""
    import cadquery

    if spec.step is not None:
        return step_part.solid(spec.step)

    inner, outer, top = spec.inner_radius_mm, spec.inner_radius_mm + spec.wall_mm, spec.top_mm
    corners = [(inner, spec.bottom_mm), (outer, spec.bottom_mm), (outer, top + spec.plate_mm)]
    corners += [(spec.camera_hole_mm / 2, top + spec.plate_mm), (spec.camera_hole_mm / 2, top), (inner, top)]
    return cadquery.Workplane("XZ").polyline(corners).close().revolve(360, (0, 0, 0), (0, 1, 0))
