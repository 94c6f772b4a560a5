"""A planted effect has parameters on a sensor and a change of the sensor that their values make."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

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


def of_fields(part: str, **parameters: tuple[str, PlantedParameter]) -> Planted:
    """Make an effect whose parameters are fields of a part of the rig: name to field and parameter."""

    def known(rig: Rig) -> dict[str, PlantedParameter]:
        return {name: parameter for name, (_, parameter) in parameters.items()}

    def change(rig: Rig, values: Mapping[str, float]) -> Rig:
        fields: dict[str, Any] = {field: values[name] for name, (field, _) in parameters.items()}
        changed: dict[str, Any] = {part: replace(getattr(rig, part), **fields)}
        return replace(rig, **changed)

    return Planted(known, change)
