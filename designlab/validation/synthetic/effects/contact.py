"""Effects of the contact between object and gel."""

from collections.abc import Mapping
from dataclasses import replace

from designlab.validation.synthetic.effects.base import Planted, PlantedParameter, of_fields
from designlab.validation.synthetic.generator_sensor import Rig


def _kernel(rig: Rig, values: Mapping[str, float]) -> Rig:
    return replace(rig, kernel_length_mm=rig.kernel_length_mm * values["length_ratio"])


CONTACT = {
    "contact_kernel": Planted(lambda _: {"length_ratio": PlantedParameter(1.0, 0.4, 0.1, 4.0)}, _kernel),
    "contact_profile": of_fields(
        "contact",
        tail_share=("tail_share", PlantedParameter(0.0, 0.2, 0.0, 0.8)),
        tail_mm=("tail_mm", PlantedParameter(0.7, 0.15, 0.1, 3.0, "mm", shape=True)),
    ),
    "depth_offset": of_fields(
        "contact", offset_mm=("deeper_mm", PlantedParameter(0.0, 0.05, -0.5, 0.5, "mm"))
    ),
}
