"""The ball of a light probe: where it lies, how it reflects, and whether it fits into a sensor."""

import numpy as np

from designlab.core.types import Array
from designlab.sensor.design import Design
from designlab.sensor.led_mounting import front_corners, seated
from designlab.sensor.optical_constants import fresnel_reflectance
from designlab.sensor.spectra import CHROMIUM
from designlab.simulation.scene.materials import Ball, Metal
from designlab.simulation.scene.static_parts import degelled
from geometries import elastomer
from geometries.spec import Spec, quantity

RINGS = 60  # of the ball's upper half that are held against the core


def chromium(wavelength_nm: float) -> complex:
    """Complex refractive index n + ik of chromium, linear between the tabulated wavelengths."""
    wavelength, n, k = CHROMIUM.T
    return complex(np.interp(wavelength_nm, wavelength, n), np.interp(wavelength_nm, wavelength, k))


class LightProbe(Spec):
    """A light probe is a chrome ball in a sensor without its gel, seen by the sensor's own camera.

    The ball stands on the plane z = 0, where the apex of the membrane was, on the camera's side: this is an
    assumption, which `lowest_mm` changes. A sensor with a gelcore in the path of light has no room there for
    more than the gel's thickness; a larger ball hangs lower.

    Parameters
    ----------
    diameter_mm : float
        Diameter of the ball in mm.
    centre_mm : tuple of two float
        Place of the ball's centre, (x, y) in mm.
    lowest_mm : float
        Height of the ball's lowest point above the plane z = 0, in mm.
    roughness : float
        GGX alpha of the ball's surface, from 0, a mirror, to 1.
    reflectance : float, optional
        Reflectance at all angles, at most 1; chromium's when absent.
    immersed : bool
        Whether a clear liquid of the gel's index joins ball and gelcore.

    Raises
    ------
    pydantic.ValidationError
        If a value is out of its bounds.
    """

    diameter_mm: float = quantity(4.0, unit="mm", gt=0, le=50)
    """Diameter of the ball."""
    centre_mm: tuple[float, float] = (0.0, 0.0)
    """Place of the ball's centre (x, y) (mm)."""
    lowest_mm: float = quantity(0.0, unit="mm", ge=-100, le=200)
    """Height of the ball's lowest point above the plane z = 0: 0 stands on the plane (assumption), minus the
    diameter touches it from below."""
    roughness: float = quantity(0.0, unit="1", ge=0, le=1)
    """GGX alpha of the ball's surface; 0 is a mirror."""
    reflectance: float | None = quantity(None, unit="1", gt=0, le=1)
    """Reflectance at all angles; chromium's when absent."""
    immersed: bool = False
    """Whether a clear liquid of the gel's index joins ball and gelcore: without it a plane core keeps light
    that entered by its sides."""

    @property
    def radius_mm(self) -> float:
        """Radius of the ball."""
        return self.diameter_mm / 2

    @property
    def middle_mm(self) -> tuple[float, float, float]:
        """Centre of the ball in the sensor frame."""
        return (*self.centre_mm, self.lowest_mm + self.radius_mm)

    def around(self, design: Design) -> Design:
        """Return the sensor as the ball meets it: air, or the liquid, where the gel was."""
        return design if self.immersed else degelled(design)

    def reflected(self, cosine: Array, design: Design, group: int) -> Array:
        """Share of an LED group's light that the ball reflects, by the cosine of the angle of incidence.

        A rough ball is taken as its mirror: what its facets lose to each other is left out.
        """
        if self.reflectance is not None:
            return np.full_like(cosine, self.reflectance)
        return fresnel_reflectance(cosine, self._indices(design)[group])

    def ball(self, design: Design) -> Ball:
        """Return the ball as plain data for a scene."""
        groups = len(design.leds.groups)
        if self.reflectance is None:
            material = Metal((1.0,) * groups, self._indices(design), self.roughness)
        else:
            material = Metal((self.reflectance,) * groups, None, self.roughness)
        return Ball("light-probe", self.middle_mm, self.radius_mm, material)

    def _indices(self, design: Design) -> tuple[complex, ...]:
        """Index of chromium for each LED group, relative to what surrounds the ball."""
        refracts = design.optics.light_path == "core"
        around = self.around(design).optics.gel_index if refracts else 1.0
        return tuple(chromium(group.wavelength_nm) / around for group in design.leds.groups)

    def require_room(self, design: Design) -> None:
        """Check that the ball touches neither gelcore, LEDs nor camera.

        Raises
        ------
        ValueError
            Naming field, value and rule.
        """
        x, y, z = self.middle_mm
        top_mm, camera_mm = z + self.radius_mm, design.camera.eye_mm[2]
        if top_mm >= camera_mm:
            raise ValueError(
                f"light_probe.lowest_mm: the top of the ball must lie below the camera at {camera_mm:g} mm, "
                f"is at {top_mm:g} mm (diameter_mm is {self.diameter_mm:g} mm)"
            )
        if design.optics.light_path == "core" and (excess_mm := self._into_core_mm(design)) > 1e-9:
            raise ValueError(
                f"light_probe.lowest_mm: must be at most {self.lowest_mm - excess_mm:.4g} mm, so that the "
                f"ball of diameter_mm = {self.diameter_mm:g} mm stays below the gelcore, "
                f"got {self.lowest_mm:g} mm"
            )
        for body in seated(design)[0]:
            near_mm = _distance_mm(np.array([x, y, z]), front_corners(body))
            if near_mm < self.radius_mm:
                raise ValueError(
                    f"light_probe.diameter_mm: must be below {2 * near_mm:.4g} mm, so that the ball at "
                    f"({x:g}, {y:g}) mm does not touch an LED, got {self.diameter_mm:g} mm"
                )

    def _into_core_mm(self, design: Design) -> float:
        """Greatest height of the ball above the gel side of the core; negative where it is clear of it."""
        share = np.sin(np.linspace(0.0, np.pi / 2, RINGS))[:, None]
        turn = np.linspace(0.0, 2 * np.pi, 72)[None]
        x = self.middle_mm[0] + self.radius_mm * share * np.cos(turn)
        y = self.middle_mm[1] + self.radius_mm * share * np.sin(turn)
        upper = self.middle_mm[2] + self.radius_mm * np.sqrt(np.maximum(1 - share**2, 0.0)) + 0 * turn
        return float(np.nanmax(upper - elastomer.interface_mm(design.elastomer, x, y)))


def _distance_mm(point: Array, corners: Array) -> float:
    """Distance of a point to a rectangle, given by its corners in order."""
    across, down = corners[1] - corners[0], corners[3] - corners[0]
    along = [np.clip((point - corners[0]) @ side / (side @ side), 0.0, 1.0) * side for side in (across, down)]
    return float(np.linalg.norm(point - corners[0] - along[0] - along[1]))
