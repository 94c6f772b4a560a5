"""Effects of a clear core and its gel: how they refract, swallow and scatter light, and whether they adhere.

They have no parameters, and do nothing, where light passes no core.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from designlab.validation.synthetic.effects.base import Planted, PlantedParameter
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.glass import Disc


def _index_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    if rig.glass is None:
        return {}
    return {part: PlantedParameter(0.0, 0.02, -0.3, 0.3) for part in ("gelcore", "elastomer")}


def _indices(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Add to the refractive indices, which stay those of matter."""
    if rig.glass is None:
        return rig
    core = max(rig.glass.core_index + values["gelcore"], 1.0)
    gel = max(rig.glass.gel_index + values["elastomer"], 1.0)
    return replace(rig, glass=replace(rig.glass, core_index=core, gel_index=gel))


def _gap_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    if rig.glass is None:
        return {}
    return {
        "x_mm": PlantedParameter(0.0, 4.0, -20.0, 20.0, "mm", shape=True),
        "y_mm": PlantedParameter(0.0, 4.0, -20.0, 20.0, "mm", shape=True),
        "radius_mm": PlantedParameter(0.0, 1.5, 0.0, 8.0, "mm"),
    }


def _gap(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Put a disc of air between core and gel."""
    if rig.glass is None or not values["radius_mm"]:
        return rig
    disc = Disc(values["x_mm"], values["y_mm"], values["radius_mm"])
    return replace(rig, glass=replace(rig.glass, gap=disc))


def _absorption_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    if rig.glass is None:
        return {}
    return {f"{name}_per_mm": PlantedParameter(0.0, 0.005, 0.0, 0.2, "1/mm") for name in rig.group_names}


def _absorption(rig: Rig, values: Mapping[str, float]) -> Rig:
    if rig.glass is None:
        return rig
    more = np.array([values[f"{name}_per_mm"] for name in rig.group_names])
    glass = replace(rig.glass, core_absorption_per_mm=rig.glass.core_absorption_per_mm + more)
    return replace(rig, glass=glass)


def _scatter_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    if rig.glass is None:
        return {}
    return {"per_mm": PlantedParameter(0.0, 0.01, 0.0, 0.5, "1/mm")}


def _scatter(rig: Rig, values: Mapping[str, float]) -> Rig:
    if rig.glass is None:
        return rig
    more = rig.glass.scattering_per_mm + values["per_mm"]
    return replace(rig, glass=replace(rig.glass, scattering_per_mm=more))


TRANSPORT = {
    "gelcore_index": Planted(_index_parameters, _indices),
    "delamination": Planted(_gap_parameters, _gap),
    "absorption": Planted(_absorption_parameters, _absorption),
    "core_scatter": Planted(_scatter_parameters, _scatter),
}
