"""Measured light probes: the ball of a frame, and the light that arrives at it."""

from typing import Any

import numpy as np
from pydantic import ValidationError

from designlab.measurement.frames import MeasuredFrame, Measurement, MeasurementError
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.light_probe.outline import Outline, locate
from designlab.measurement.light_probe.unwrap import Unwrapped, unwrap
from designlab.sensor.design import CHANNELS, Design
from designlab.sensor.field_errors import explain


def ball_of(measurement: Measurement, frame: MeasuredFrame) -> LightProbe:
    """Ball that a light probe frame shows.

    Its place is `centre_mm`, or follows from the outline in the image where `centre_px` and
    `contact_radius_px` give one. A `lowest_mm` that is absent is found from the outline as well; with
    `centre_mm` alone the ball stands on the plane z = 0, the assumption of `LightProbe`.

    Raises
    ------
    MeasurementError
        If the frame is no light probe, or size or place of the ball are unknown or do not fit.
    """
    if frame.kind != "light_probe":
        raise measurement.error(frame, "kind: must be light_probe", frame.kind)
    size = (frame.probe or "").strip().partition(":")[2]
    if not size:
        raise measurement.error(frame, "probe: its size is unknown, write sphere:diameter_mm", frame.probe)
    content: dict[str, Any] = {"diameter_mm": float(size), "immersed": bool(frame.immersed)}
    if frame.lowest_mm is not None:
        content["lowest_mm"] = frame.lowest_mm
    try:
        if frame.centre_mm is not None:
            return LightProbe.model_validate({**content, "centre_mm": frame.centre_mm})
        probe = LightProbe.model_validate(content)
    except ValidationError as error:
        raise measurement.error(frame, f"probe: {explain(error)}", frame.probe) from None
    if frame.centre_px is None or frame.contact_radius_px is None:
        rule = "centre_mm: unknown; give it, or the ball's outline as centre_px and contact_radius_px"
        raise measurement.error(frame, rule, None)
    design = _design(measurement, frame)
    column, row = frame.centre_px
    # Places in a frame count from the edge of the image, those of an outline from its first pixel's middle.
    outline = Outline(column - 0.5, row - 0.5, frame.contact_radius_px, 1.0)
    try:
        return locate(
            outline,
            design=design,
            view=measurement.view(frame, design),
            diameter_mm=probe.diameter_mm,
            lowest_mm=frame.lowest_mm,
            immersed=probe.immersed,
        )
    except ValueError as error:
        raise measurement.error(frame, f"contact_radius_px: {error}", frame.contact_radius_px) from None


def light_of(measurement: Measurement, frame: MeasuredFrame) -> Unwrapped:
    """Light that arrives at the ball of a measured light probe, in the unit of the frame.

    The response is undone, and the mean of the dark frames of the same crop subtracted where there are any.

    Raises
    ------
    MeasurementError
        If sensor, response, ball or its place are unknown, or do not fit each other.
    """
    design, probe = _design(measurement, frame), ball_of(measurement, frame)
    image = np.asarray(measurement.linear(frame), dtype=float)
    darks = [f for f in measurement.frames if f.kind == "dark" and f.crop_px == frame.crop_px]
    if darks:
        image = image - np.mean([measurement.linear(dark) for dark in darks], axis=0)
    names: tuple[str, ...] = CHANNELS
    groups: list[int] | None = None
    if image.shape[-1] == 1 and frame.leds is not None and len(frame.leds) == 1:
        names, groups = frame.leds, [design.group_names.index(frame.leds[0])]
    view = measurement.view(frame, design)
    try:
        return unwrap(image, design=design, probe=probe, view=view, names=names, groups=groups)
    except ValueError as error:
        raise measurement.error(frame, f"probe: {error}", frame.probe) from None


def _design(measurement: Measurement, frame: MeasuredFrame) -> Design:
    design = measurement.design()
    if design is None:
        raise MeasurementError(
            f"{measurement.folder}: field sensor: must be known to unwrap {frame.file}, got 'unknown'"
        )
    return design
