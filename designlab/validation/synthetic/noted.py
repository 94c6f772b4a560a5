"""What a lab notes of a press: its depth, the force, the contact circle of a ball, or nothing."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np

from designlab.sensor.contact import LayerContact
from designlab.sensor.design import Design
from designlab.validation.synthetic.elastic_contact import ElasticBase, RoundContact, press_ball
from designlab.validation.synthetic.indenter import Indenter

Noted = Literal["depth", "force", "circle", "nothing"]
FORCE_SHARE, CIRCLE_SHARE = 0.05, 0.05  # standard deviations of a scale, and of a circle by eye


def noted_as(
    metadata: Mapping[str, Any],
    true: Indenter,
    design: Design,
    noted: Noted,
    *,
    placed: bool,
    random: np.random.Generator,
) -> dict[str, Any]:
    """Fields of a press as a lab notes them, in place of a stated pose.

    Parameters
    ----------
    metadata : mapping
        Fields of the press with its pose and ``sigma``.
    true : Indenter
        What was really pressed.
    design : Design
        The sensor, for its gel.
    noted : str
        What tells the depth.
    placed : bool
        Whether place and yaw are noted.
    random : Generator
        Source of the errors of force and circle.

    Raises
    ------
    ValueError
        If force or circle are asked for of a gel or a probe that has none by a closed form.
    """
    unknown = set() if placed else {"centre_mm", "yaw_deg"}
    unknown |= set() if noted == "depth" else {"depth_mm"}
    fields = {name: value for name, value in metadata.items() if name not in unknown}
    fields["sigma"] = {name: value for name, value in metadata["sigma"].items() if name not in unknown}
    if noted in ("depth", "nothing"):
        return fields
    contact = _ball(true, design, noted)
    if noted == "force":
        force = contact.force_n * (1 + FORCE_SHARE * random.standard_normal())
        fields["sigma"] = {**fields["sigma"], "force_n": round(FORCE_SHARE * abs(force), 4)}
        return fields | {"force_n": round(abs(force), 4)}
    across = 2 * contact.contact_radius_mm * (1 + CIRCLE_SHARE * random.standard_normal())
    return fields | {"contact_diameter_mm": round(across, 3)}


def _ball(true: Indenter, design: Design, noted: Noted) -> RoundContact:
    """Exact contact of a ball with an elastic gel."""
    if true.probe.kind != "sphere":
        raise ValueError(f"noted: {noted} is generated for balls, got {true.probe.kind}")
    if not isinstance(design.contact, LayerContact):
        raise ValueError(
            f"noted: {noted} is generated for elastic gels, contact.model is {design.contact.model!r}"
        )
    layer = design.contact.layer(thickness_mm=design.elastomer.thickness_mm)
    base = ElasticBase(layer.modulus_mpa, layer.poisson, layer.thickness_mm)
    return press_ball(base, ball_radius_mm=true.probe.size_mm / 2, depth_mm=true.depth_mm)
