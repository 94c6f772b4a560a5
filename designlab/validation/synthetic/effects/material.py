"""Effects of reflecting surfaces: the boards, and the membrane's coat."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from designlab.validation.synthetic.effects.base import Planted, PlantedParameter
from designlab.validation.synthetic.generator_sensor import Rig

FIELD = ("x", "y", "xx", "xy", "yy")
OPEN_AIR = 0.536  # sent back where a silicone skin of index 1.41 ends at air: 1 - (1 - 0.0784) / 1.41^2


def _interreflection_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    return {
        "boards": PlantedParameter(0.0, 0.15, -1.0, 1.0),
        "albedo_ratio": PlantedParameter(1.0, 0.15, 0.3, 2.5),
    }


def _interreflection(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Change what comes back from boards and membrane; the LEDs make up for the membrane's brightness."""
    ratio = values["albedo_ratio"]
    return replace(
        rig,
        board_reflectance=np.clip(rig.board_reflectance + values["boards"], 0.0, 1.0),
        albedo=np.minimum(rig.albedo * ratio, 1.0),
        flux_mw=rig.flux_mw / ratio,
    )


def _field(rig: Rig, values: Mapping[str, float]) -> Rig:
    x, y, xx, xy, yy = (values[name] for name in FIELD)
    return replace(rig, coat=replace(rig.coat, field=(x, y, xx, xy, yy)))


def _specular_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    return {
        "share": PlantedParameter(rig.coat.specular, 0.075, min(0.0, rig.coat.specular), 0.6),
        "roughness": PlantedParameter(rig.coat.roughness, 0.1, 0.1, 0.8, shape=True),
    }


def _specular(rig: Rig, values: Mapping[str, float]) -> Rig:
    return replace(rig, coat=replace(rig.coat, specular=values["share"], roughness=values["roughness"]))


def _translucency_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    return {
        "transmittance": PlantedParameter(rig.coat.transmittance, 0.1, 0.0, 0.4),
        "object": PlantedParameter(rig.coat.behind, 0.25, 0.0, 1.0, shape=True),
    }


def _translucency(rig: Rig, values: Mapping[str, float]) -> Rig:
    return replace(
        rig, coat=replace(rig.coat, transmittance=values["transmittance"], behind=values["object"])
    )


def _wetting(rig: Rig, values: Mapping[str, float]) -> Rig:
    if not values["transmittance"]:
        return rig
    coat = replace(rig.coat, transmittance=values["transmittance"], behind=0.0, open_air=OPEN_AIR)
    return replace(rig, coat=coat)


MATERIAL = {
    "interreflection": Planted(_interreflection_parameters, _interreflection),
    "albedo_field": Planted(
        lambda _: {name: PlantedParameter(0.0, 0.05, -0.5, 0.5) for name in FIELD}, _field
    ),
    "specular_coat": Planted(_specular_parameters, _specular),
    "translucency": Planted(_translucency_parameters, _translucency),
    "wetting": Planted(
        lambda rig: {"transmittance": PlantedParameter(rig.coat.transmittance, 0.2, 0.0, 0.4)}, _wetting
    ),
}
