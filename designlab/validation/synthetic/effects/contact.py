"""Effects of the contact between object and gel."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from designlab.validation.synthetic.effects.base import Planted, PlantedParameter, of_fields
from designlab.validation.synthetic.generator_sensor import Rig

Known = dict[str, PlantedParameter]
Values = Mapping[str, float]


def _of_kernels(planted: Planted) -> Planted:
    """Limit an effect to gels that smooth by a kernel."""

    def change(rig: Rig, values: Values) -> Rig:
        return planted.change(rig, values) if rig.gel.share < 1 else rig

    return Planted(lambda rig: planted.known(rig) if rig.gel.share < 1 else {}, change)


def _kernel(rig: Rig, values: Values) -> Rig:
    return replace(rig, kernel_length_mm=rig.kernel_length_mm * values["length_ratio"])


def _layer(rig: Rig) -> Known:
    gel_mm = rig.gel.thickness_mm
    thickness = PlantedParameter(gel_mm, gel_mm / 4, gel_mm / 2, 3 * gel_mm, "mm", shape=True)
    skin = PlantedParameter(rig.gel.skin_mm, 0.05, 0.0, 0.5, "mm", shape=True)
    return {"share": PlantedParameter(0.0, 0.5, 0.0, 1.0), "thickness_mm": thickness, "skin_length_mm": skin}


def _with_layer(rig: Rig, values: Values) -> Rig:
    places = {"share": "share", "thickness_mm": "thickness_mm", "skin_length_mm": "skin_mm"}
    fields: dict[str, Any] = {places[name]: value for name, value in values.items()}
    return replace(rig, gel=replace(rig.gel, **fields))


def _of_gel(parameter: str, known: PlantedParameter, changed: str, *, ratio: bool) -> Planted:
    """Make an effect that scales a figure of an elastic gel, or adds to it."""

    def change(rig: Rig, values: Values) -> Rig:
        if parameter not in values:
            return rig
        figure = getattr(rig.gel, changed)
        figure = figure * values[parameter] if ratio else max(figure + values[parameter], 0.0)
        fields: dict[str, Any] = {changed: figure}
        return replace(rig, gel=replace(rig.gel, **fields))

    return Planted(lambda rig: {parameter: known} if rig.gel.share == 1 else {}, change)


CONTACT = {
    "contact_kernel": _of_kernels(
        Planted(lambda _: {"length_ratio": PlantedParameter(1.0, 0.4, 0.1, 4.0)}, _kernel)
    ),
    "contact_profile": _of_kernels(
        of_fields(
            "contact",
            tail_share=("tail_share", PlantedParameter(0.0, 0.2, 0.0, 0.8)),
            tail_mm=("tail_mm", PlantedParameter(0.7, 0.15, 0.1, 3.0, "mm", shape=True)),
        )
    ),
    "contact_layer": _of_kernels(Planted(_layer, _with_layer)),
    "gel_thickness": _of_gel(
        "thickness_ratio", PlantedParameter(1.0, 0.15, 0.5, 2.0), "thickness_mm", ratio=True
    ),
    "skin_length": _of_gel("added_mm", PlantedParameter(0.0, 0.03, -0.05, 0.5, "mm"), "skin_mm", ratio=False),
    "probe_edge": of_fields("contact", radius_mm=("edge_mm", PlantedParameter(0.0, 0.15, 0.0, 1.0, "mm"))),
    "probe_size": of_fields("contact", size_ratio=("probe_scale", PlantedParameter(1.0, 0.03, 0.7, 1.4))),
    "depth_offset": of_fields(
        "contact", offset_mm=("deeper_mm", PlantedParameter(0.0, 0.05, -0.5, 0.5, "mm"))
    ),
}
