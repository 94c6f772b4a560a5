"""The opaque tube that holds gelcore, LEDs and camera."""

from typing import TYPE_CHECKING, Self

from pydantic import model_validator

from geometries.spec import Spec, quantity

if TYPE_CHECKING:
    import cadquery


class Housing(Spec):
    """Round tube from the membrane's edge up to the camera plate. Sensor frame."""

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
        return self


def solid(spec: Housing) -> "cadquery.Workplane":
    """Build tube and camera plate as one closed CadQuery solid in the sensor frame (mm)."""
    import cadquery

    inner, outer, top = spec.inner_radius_mm, spec.inner_radius_mm + spec.wall_mm, spec.top_mm
    corners = [(inner, spec.bottom_mm), (outer, spec.bottom_mm), (outer, top + spec.plate_mm)]
    corners += [(spec.camera_hole_mm / 2, top + spec.plate_mm), (spec.camera_hole_mm / 2, top), (inner, top)]
    return cadquery.Workplane("XZ").polyline(corners).close().revolve(360, (0, 0, 0), (0, 1, 0))
