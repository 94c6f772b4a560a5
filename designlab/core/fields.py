"""A field of a specification is named by its dotted path and looked up with its value, unit and bounds."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import annotated_types
from pydantic import BaseModel

OPEN_END = 1e-6  # of the value: how far within a bound that does not belong to the range


_UNITS = {"mm": "mm", "deg": "deg", "nm": "nm", "mw": "mW", "px": "px", "mpa": "MPa", "um": "µm", "ms": "ms"}


class FieldAt(NamedTuple):
    """What stands at a path: the value, the unit ("1" of a pure number), and the bounds of the field."""

    value: Any
    unit: str
    low: float
    high: float


def field_at(spec: BaseModel, path: str) -> FieldAt:
    """Look up a field of a specification by dotted path; positions are numbers (``leds.groups.0.flux_mw``).

    Unit and bounds of a value among several are those of the field that holds them all.

    Raises
    ------
    LookupError
        If the specification has no such field.
    """
    node: Any = spec
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
            raise LookupError(f"no field {path!r}")
    return FieldAt(node, unit, low, high)


def unit_of(path: str) -> str:
    """Unit of a field, read off the end of its name; empty for a pure number.

    Examples
    --------
    >>> unit_of("leds.height_mm"), unit_of("effects.led_tilt.red_tilt_deg.0"), unit_of("leds.count")
    ('mm', 'deg', '')
    """
    names = [part for part in path.split(".") if not part.isdigit()]
    return _UNITS.get(names[-1].rpartition("_")[2], "")


def _bounds(metadata: Sequence[Any]) -> tuple[float, float]:
    low, high = -math.inf, math.inf
    for rule in metadata:
        if isinstance(rule, annotated_types.Ge):
            low = _number(rule.ge)
        elif isinstance(rule, annotated_types.Gt):
            low = _number(rule.gt) + OPEN_END * max(abs(_number(rule.gt)), 1.0)
        elif isinstance(rule, annotated_types.Le):
            high = _number(rule.le)
        elif isinstance(rule, annotated_types.Lt):
            high = _number(rule.lt) - OPEN_END * max(abs(_number(rule.lt)), 1.0)
    return low, high


def _number(bound: Any) -> float:
    """Bound of a field that holds numbers: the rule knows of it only that values compare with it."""
    return float(bound)
