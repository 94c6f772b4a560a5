"""The opaque tube that holds gelcore, LEDs and camera."""

from typing import TYPE_CHECKING

from geometries.spec import Spec, quantity

if TYPE_CHECKING:
    import cadquery


class Housing(Spec):
    """Round tube from the membrane's edge up to the camera plate. Sensor frame."""

    inner_radius_mm: float = quantity(17.0, unit="mm", gt=1, le=200, description="Inner radius of the tube.")
    wall_mm: float = quantity(2.0, unit="mm", gt=0, le=50, description="Thickness of the tube's wall.")
    bottom_mm: float = quantity(
        1.0,
        unit="mm",
        ge=-50,
        le=100,
        description="Height of the lower rim above the membrane plane; the gel stands proud of it.",
    )
    top_mm: float = quantity(
        30.0, unit="mm", gt=0, le=300, description="Height of the camera plate's underside."
    )
    plate_mm: float = quantity(2.0, unit="mm", gt=0, le=50, description="Thickness of the camera plate.")
    camera_hole_mm: float = quantity(
        8.0, unit="mm", gt=0, le=100, description="Diameter of the hole in the camera plate."
    )
