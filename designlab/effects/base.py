"""What every effect is: a stage, bounded parameters, and what it changes there."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from designlab.design import Design
from designlab.scene import Scene

Stage = Literal["geometry", "emission", "transport", "material", "contact", "camera"]
Values = Mapping[str, float]
Signal = NDArray[np.floating]
"""Linear picture of three channels, (rows, columns, 3), as a share of full scale."""


@dataclass(frozen=True)
class Parameter:
    """One number of an effect.

    Attributes
    ----------
    name, unit : str
        Name with its unit, and the unit alone.
    null : float
        Value at which the effect does nothing.
    sd : float
        Prior standard deviation: how large the effect usually is in built sensors.
    low, high : float
        Hard physical bounds.
    description : str
        Meaning and source of the prior.
    """

    name: str
    unit: str
    null: float
    sd: float
    low: float
    high: float
    description: str


class Effect:
    """A named physical effect.

    Subclasses override the hook of the stage they act on; the others change nothing.
    """

    name: ClassVar[str]
    stage: ClassVar[Stage]
    summary: ClassVar[str]
    transferable: ClassVar[bool]
    """Whether it holds for new designs too (True), or belongs to one built unit (False)."""
    nuisance: ClassVar[bool] = False
    """Whether calibration settles it, so that a diagnosis does not look for it."""

    def parameters(self, design: Design) -> tuple[Parameter, ...]:
        """Return the parameters for a design (some effects have one for each LED group)."""
        raise NotImplementedError  # abstract: every effect defines its own

    def on_design(self, design: Design, values: Values) -> Design:
        """Change the design before anything is simulated."""
        return design

    def on_scene(self, scene: Scene, values: Values) -> Scene:
        """Change the scene before light is traced."""
        return scene

    def on_signal(self, signal: Signal, values: Values) -> Signal:
        """Change the signal of the camera, before its noise."""
        return signal

    def null(self, design: Design) -> dict[str, float]:
        """Values at which the effect is the identity."""
        return {parameter.name: parameter.null for parameter in self.parameters(design)}
