"""What an effect is to the generator."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from designlab.validation.synthetic.generator_sensor import Rig


class PlantedParameter(NamedTuple):
    """Null value, usual spread about it, bounds and unit; `shape` if it does nothing by itself."""

    null: float
    spread: float
    low: float
    high: float
    unit: str = ""
    shape: bool = False

    @property
    def one_sided(self) -> bool:
        """Whether only values above null are possible."""
        return self.low == self.null


class Planted(NamedTuple):
    """Parameters of an effect on a sensor, and the change of the sensor that their values make."""

    known: Callable[[Rig], dict[str, PlantedParameter]]
    change: Callable[[Rig, Mapping[str, float]], Rig]
