"""The parts of a sensor as its geometric rules see them; `Design` has them, and more."""

from typing import Protocol

from designlab.core.types import Array
from designlab.sensor.camera import Camera
from designlab.sensor.optical_properties import Optics
from geometries.elastomer import Elastomer
from geometries.gelcore import Gelcore
from geometries.housing import Housing
from geometries.leds import LedArray


class Parts(Protocol):
    """What rules and seats of LEDs depend on."""

    @property
    def gelcore(self) -> Gelcore: ...  # noqa: D102  fields of `Design`
    @property
    def elastomer(self) -> Elastomer: ...  # noqa: D102
    @property
    def leds(self) -> LedArray: ...  # noqa: D102
    @property
    def housing(self) -> Housing: ...  # noqa: D102
    @property
    def optics(self) -> Optics: ...  # noqa: D102
    @property
    def camera(self) -> Camera: ...  # noqa: D102
    @property
    def sensing_area_mm(self) -> tuple[float, float]: ...  # noqa: D102

    def tangents_to(self, points: Array, *, camera_mm: float | None = None) -> Array:
        """Directions in which the camera sees membrane points."""
        ...

    def layers_to_camera(self, z: float, *, camera_mm: float | None = None) -> list[tuple[float, float]]:
        """Thickness and index of each layer from a membrane point to the camera."""
        ...
