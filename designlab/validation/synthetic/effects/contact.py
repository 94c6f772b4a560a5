"""Effects of the contact between object and gel."""

from collections.abc import Mapping
from dataclasses import replace

from designlab.validation.synthetic.effects.base import Planted, PlantedParameter
from designlab.validation.synthetic.generator_sensor import Rig


def _kernel_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    return {"length_ratio": PlantedParameter(1.0, 0.4, 0.1, 4.0)}


def _kernel(rig: Rig, values: Mapping[str, float]) -> Rig:
    return replace(rig, kernel_length_mm=rig.kernel_length_mm * values["length_ratio"])


def _profile_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    return {
        "tail_share": PlantedParameter(0.0, 0.2, 0.0, 0.8),
        "tail_mm": PlantedParameter(0.7, 0.15, 0.1, 3.0, "mm", shape=True),
    }


def _profile(rig: Rig, values: Mapping[str, float]) -> Rig:
    contact = replace(rig.contact, tail_share=values["tail_share"], tail_mm=values["tail_mm"])
    return replace(rig, contact=contact)


def _offset_parameters(rig: Rig) -> dict[str, PlantedParameter]:
    return {"offset_mm": PlantedParameter(0.0, 0.05, -0.5, 0.5, "mm")}


def _offset(rig: Rig, values: Mapping[str, float]) -> Rig:
    return replace(rig, contact=replace(rig.contact, deeper_mm=values["offset_mm"]))


CONTACT = {
    "contact_kernel": Planted(_kernel_parameters, _kernel),
    "contact_profile": Planted(_profile_parameters, _profile),
    "depth_offset": Planted(_offset_parameters, _offset),
}
