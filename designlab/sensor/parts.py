"""The parts of a sensor as its geometric rules see them; `Design` has them, and more."""

from typing import Protocol

from designlab.core.types import Array
from designlab.sensor.camera import Camera
from designlab.sensor.optical_properties import Optics
from designlab.sensor.sensing_area import SensingArea
from geometries.elastomer import Elastomer
from geometries.gelcore import Gelcore
from geometries.housing import Housing
from geometries.leds import LedArray


class Parts(Protocol):
    """What rules and seats of LEDs depend on."""

    @property
    def gelcore(self) -> Gelcore:
        """The clear block between camera and gel."""
        ...

    @property
    def elastomer(self) -> Elastomer:
        """The gel."""
        ...

    @property
    def leds(self) -> LedArray:
        """The LEDs and how they are mounted."""
        ...

    @property
    def housing(self) -> Housing:
        """The housing around all."""
        ...

    @property
    def optics(self) -> Optics:
        """Materials and the path of light."""
        ...

    @property
    def camera(self) -> Camera:
        """The camera and its lens."""
        ...

    @property
    def sensing_area(self) -> SensingArea:
        """The area that counts."""
        ...

    def tangents_to(self, points: Array, *, camera_mm: float | None = None) -> Array:
        """Directions in which the camera sees membrane points."""
        ...

    def layers_to_camera(self, z: float, *, camera_mm: float | None = None) -> list[tuple[float, float]]:
        """Thickness and index of each layer from a membrane point to the camera."""
        ...
