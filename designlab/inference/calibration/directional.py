"""Directional light predicts pictures without light transport; it is fitted in the same way."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from pydantic import BaseModel

from designlab.core.progress import Work
from designlab.core.types import Array
from designlab.inference.calibration.fields import WITHIN
from designlab.inference.calibration.imaging import How, Touched
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.shots import Shot
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.simulation.directional_light import DirectionalLight

ANGLES = ("azimuth_deg", "elevation_deg")


@dataclass(frozen=True)
class Directional:
    """One component for the diffuse reflection of each light, for Phong one more for each lobe."""

    light: DirectionalLight
    work: Work = field(default_factory=Work, repr=False, compare=False)

    unit = "1"  # shares of full scale
    step_share = 0.2  # small: nothing is drawn, and directions, depth and view nearly make up for each other

    @property
    def design(self) -> Design:
        """The sensor."""
        return self.light.design

    @property
    def model(self) -> BaseModel:
        """The model of directional light, with its design."""
        return self.light

    @property
    def kind(self) -> str:
        """Reflection under directional light."""
        return f"directional light, {self.light.reflection}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of LED groups, and of their lobes."""
        return self.light.names

    def lit(self, shot: Shot) -> Array:
        """Exposure of the groups that are on, for each of their components."""
        return self.light.each(shot.lit)

    def usual(self, shots: Sequence[Shot]) -> tuple[str, ...]:
        """Directions and exponent, of which flat gel without a press tells nothing.

        Not kernel and field of view: a press as large as the picture would stand for light that falls off.
        """
        if self.design.elastomer.shape == "flat" and not any(shot.press is not None for shot in shots):
            return ()
        directions = [f"lights.{g}.{angle}" for g in range(len(self.light.lights)) for angle in ANGLES]
        return (*directions, *(("exponent",) if self.light.exponent is not None else ()))

    def sees(self, path: str, shot: Shot) -> bool:
        """Whether it matters: an untouched gel does not know how it smooths an indentation."""
        return shot.press is not None or not path.startswith(f"{WITHIN}contact.")

    def alone(self, path: str) -> int | None:
        """Group of a direction; a direction of Phong moves two components."""
        first, _, rest = path.partition(".")
        return int(rest.partition(".")[0]) if first == "lights" and self.light.exponent is None else None

    def basis(
        self, changes: Mapping[str, float], touched: Touched, view: View, *, seed: int, how: How = "usual"
    ) -> Array:
        """Shade; nothing is drawn."""
        assert not isinstance(touched, LightProbe)  # left out where shots are gathered
        found = self.light.replace(changes).components(touched, view, fine=how == "fine")
        self.work.step()
        return found

    def at(self, changes: Mapping[str, float]) -> "Directional":
        """Return light of other directions."""
        return replace(self, light=self.light.replace(changes))

    def factors(self) -> Array:
        """Return the model's own."""
        return np.array(self.light.factors)

    def level(self) -> Array:
        """Return black level of the camera and floor."""
        return np.array(self.light.floor) + self.light.design.camera.black_level

    def finished(
        self, changes: Mapping[str, float], factors: Array, level: Array, source: str
    ) -> DirectionalLight:
        """Put values found into their fields."""
        return self.light.replace(
            {
                **changes,
                "factors": [[float(value) for value in row] for row in factors],
                "floor": [float(value) for value in level - self.light.design.camera.black_level],
                "found_in": source,
            }
        )
