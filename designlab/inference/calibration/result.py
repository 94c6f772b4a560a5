"""A calibration result holds the calibrated model, fitted parameters with errors, and its frames."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from designlab.core.plain import plain
from designlab.core.types import Array
from designlab.simulation.directional_light import DirectionalLight
from designlab.simulation.effects.model import SensorModel

FRAME_KEYS = ("file", "use", "held_out", "pose", "before", "after")  # of a frame, in plain data


@dataclass(frozen=True)
class FittedParameter:
    """One fitted number; its standard error is None where the value stands at zero or nothing shows it.

    The value give or take 1.96 standard errors is an interval of 95 %.
    """

    name: str
    unit: str
    value: float
    se: float | None


@dataclass(frozen=True, eq=False)
class FrameResult:
    """One shot: what it was used for, how alike model and picture are before and after, and where it was.

    Attributes
    ----------
    file : str
        The frame; of repeats, which are averaged, the first.
    use : str
        "background", "light_probe" and "train" were fitted; of "select" and "final" the pose alone.
    before, after : dict
        Figures of `metrics.compare` with the model as given at the stated pose, and calibrated.
    pose : dict or None
        x_mm, y_mm, depth_mm and yaw_deg after the fit; None for the untouched gel.
    measured, given, simulated : array, shape (rows, columns, 3)
        Signals as shares of full scale: measured, of the model as given, and calibrated.
    """

    file: str
    use: str
    before: Mapping[str, Any]
    after: Mapping[str, Any]
    pose: Mapping[str, float] | None
    measured: Array = field(repr=False)
    given: Array = field(repr=False)
    simulated: Array = field(repr=False)

    @property
    def held_out(self) -> bool:
        """Whether nothing but the pose was fitted to it."""
        return self.use in ("select", "final")


@dataclass(frozen=True, eq=False)
class Calibration:
    """A sensor as its pictures show it.

    Attributes
    ----------
    model : SensorModel or DirectionalLight
        The calibrated model. Of a design: flux, mixing, exposure and the shared fields, and the floor as the
        effect ``black_level``.
    parameters : tuple of FittedParameter
        Everything fitted: shared fields, poses of the fitted presses, transfer, floor.
    correlation : array, shape (parameters, parameters)
        Of their errors; NaN where there is no standard error.
    frames : tuple of FrameResult
        Every shot.
    products : tuple of FittedParameter
        Transfer times reflectance of the membrane for each channel and LED group, which pictures of the gel
        tell whether or not they tell the two apart.
    transfer, floor : array, shapes (3, groups) and (3,)
        Signal of a channel per unit-power radiance of a group (mm2 sr), and that without light from LEDs. Of
        directional light: its factors, shape (3, components).
    notes : tuple of str
        What was left out, assumed, or cannot be told apart.
    stuck : bool
        Whether the search ended early, though its derivatives promised a better fit.
    """

    model: SensorModel | DirectionalLight
    parameters: tuple[FittedParameter, ...]
    correlation: Array
    products: tuple[FittedParameter, ...]
    frames: tuple[FrameResult, ...]
    transfer: Array
    floor: Array
    notes: tuple[str, ...]
    provenance: Mapping[str, Any]
    stuck: bool = False

    def to_json(self) -> dict[str, Any]:
        """Return plain data; numbers without a finite value are None."""
        content = {
            "parameters": [vars(parameter) for parameter in self.parameters],
            "correlation": self.correlation.tolist(),
            "products": [vars(parameter) for parameter in self.products],
            "transfer": self.transfer.tolist(),
            "floor": self.floor.tolist(),
            "frames": [{name: getattr(frame, name) for name in FRAME_KEYS} for frame in self.frames],
            "notes": list(self.notes),
            "model_digest": self.model.digest,
            "provenance": dict(self.provenance),
        }
        found: dict[str, Any] = plain(content)
        return found
