"""Shared fields are numbers of a design that a calibration fits, with bounds and difference steps."""

import math
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import annotated_types
from pydantic import BaseModel

from designlab.sensor.design import Design

# What light transport does not see, or sees as a factor only, is part of the transfer.
WITHIN = "design."  # prefix of the design's fields in a model that holds one
IN_TRANSFER = r"mixing(\..*)?|leds\.groups\.\d+\.flux_mw|camera\.exposure|(factors|floor)(\..*)?"
UNSEEN = r"camera\.(full_well_e|read_noise_e|black_level)"
SHARE = r"optics\.\w+(albedo|reflectance)\.\d+"  # of several values, whose bounds pydantic does not hold
STEP = 0.05  # of the value, for finite differences
CAMERA_STEP = 0.01  # edges move by pixels where the camera does
DIRECTION, DIRECTION_STEP_DEG = r"lights\.\d+\.\w+_deg", 1.0
INSIDE = 1e-6  # of the value: how far within a bound that does not belong to the range


class SharedField(NamedTuple):
    """A number of the design that all frames share, with its bounds and the step of finite differences."""

    path: str
    unit: str
    value: float
    low: float
    high: float
    step: float


def shared_fields(model: BaseModel, free: Sequence[str]) -> tuple[SharedField, ...]:
    """Look up the fields to be fitted.

    Raises
    ------
    ValueError
        If a path names no number of the design, is named twice, or cannot be calibrated; says which and why.
    """
    repeated = sorted({path for path in free if list(free).count(path) > 1})
    if repeated:
        raise ValueError(f"free: each field once, got {', '.join(repeated)} twice")
    return tuple(_field(model, path) for path in free)


def _field(model: BaseModel, path: str) -> SharedField:
    inner = path.removeprefix(WITHIN)
    if re.fullmatch(IN_TRANSFER, inner):
        raise ValueError(
            f"free: {path} cannot be told from other factors of the light and is fitted with them as transfer"
        )
    if re.fullmatch(UNSEEN, inner):
        raise ValueError(f"free: {path} must be a field that pictures without noise depend on")
    node: Any = model
    low, high, unit = -math.inf, math.inf, "1"
    for part in path.split("."):
        if isinstance(node, BaseModel) and part in type(node).model_fields:
            info = type(node).model_fields[part]
            low, high = _bounds(info.metadata)
            extra = info.json_schema_extra
            unit = str(extra.get("unit", "1")) if isinstance(extra, dict) else "1"
            node = getattr(node, part)
        elif isinstance(node, tuple) and part.isdecimal() and int(part) < len(node):
            node = node[int(part)]
        else:
            raise ValueError(f"free: no field {path!r} in the model")
    if isinstance(node, bool) or not isinstance(node, float):
        raise ValueError(f"free: {path} must be a number that can vary, got {node!r}")
    if re.fullmatch(SHARE, inner):
        low, high = INSIDE, 1.0 - (model.optics.coating_transmittance if isinstance(model, Design) else 0.0)
    share = CAMERA_STEP if inner.startswith("camera.") else STEP
    step = share * abs(node) or 0.01 * (min(high, 1.0) - max(low, -1.0))
    if re.fullmatch(DIRECTION, path):
        step = DIRECTION_STEP_DEG
    return SharedField(path, unit, node, low, high, step)


def _bounds(metadata: Sequence[Any]) -> tuple[float, float]:
    low, high = -math.inf, math.inf
    for rule in metadata:
        if isinstance(rule, annotated_types.Ge):
            low = float(rule.ge)  # type: ignore[arg-type]
        elif isinstance(rule, annotated_types.Gt):
            low = float(rule.gt) + INSIDE * max(abs(float(rule.gt)), 1.0)  # type: ignore[arg-type]
        elif isinstance(rule, annotated_types.Le):
            high = float(rule.le)  # type: ignore[arg-type]
        elif isinstance(rule, annotated_types.Lt):
            high = float(rule.lt) - INSIDE * max(abs(float(rule.lt)), 1.0)  # type: ignore[arg-type]
    return low, high
