"""Effects of a clear core and its gel: how they refract, swallow and scatter light, and whether they adhere.

They have no parameters, and do nothing, where light passes no core.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from designlab.validation.synthetic.effects.base import Planted, PlantedParameter
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.glass import Disc, ImmersedParts

Values = Mapping[str, float]


def _of_glass(
    known: Callable[[Rig], dict[str, PlantedParameter]],
    change: Callable[[Rig, ImmersedParts, Values], ImmersedParts],
) -> Planted:
    """Make an effect of the clear parts of a rig, where it has some."""

    def changed(rig: Rig, values: Values) -> Rig:
        return rig if rig.glass is None else replace(rig, glass=change(rig, rig.glass, values))

    return Planted(lambda rig: {} if rig.glass is None else known(rig), changed)


def _indices(rig: Rig, glass: ImmersedParts, values: Values) -> ImmersedParts:
    """Add to the refractive indices, which stay those of matter."""
    core = max(glass.core_index + values["gelcore"], 1.0)
    return replace(glass, core_index=core, gel_index=max(glass.gel_index + values["elastomer"], 1.0))


def _gap_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    return {
        "x_mm": PlantedParameter(0.0, 4.0, -20.0, 20.0, "mm", shape=True),
        "y_mm": PlantedParameter(0.0, 4.0, -20.0, 20.0, "mm", shape=True),
        "radius_mm": PlantedParameter(0.0, 1.5, 0.0, 8.0, "mm"),
    }


def _gap(rig: Rig, glass: ImmersedParts, values: Values) -> ImmersedParts:
    """Put a disc of air between core and gel."""
    disc = Disc(values["x_mm"], values["y_mm"], values["radius_mm"])
    return replace(glass, gap=disc) if disc.radius_mm else glass


def _absorption_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    return {f"{name}_per_mm": PlantedParameter(0.0, 0.005, 0.0, 0.2, "1/mm") for name in rig.group_names}


def _absorption(rig: Rig, glass: ImmersedParts, values: Values) -> ImmersedParts:
    more = np.array([values[f"{name}_per_mm"] for name in rig.group_names])
    return replace(glass, core_absorption_per_mm=glass.core_absorption_per_mm + more)


def _scatter(rig: Rig, glass: ImmersedParts, values: Values) -> ImmersedParts:
    return replace(glass, scattering_per_mm=glass.scattering_per_mm + values["per_mm"])


TRANSPORT = {
    "gelcore_index": _of_glass(
        lambda _: {part: PlantedParameter(0.0, 0.02, -0.3, 0.3) for part in ("gelcore", "elastomer")},
        _indices,
    ),
    "delamination": _of_glass(_gap_parameters, _gap),
    "absorption": _of_glass(_absorption_parameters, _absorption),
    "core_scatter": _of_glass(lambda _: {"per_mm": PlantedParameter(0.0, 0.01, 0.0, 0.5, "1/mm")}, _scatter),
}
