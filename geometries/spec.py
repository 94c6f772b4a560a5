"""The base of every specification: a frozen, validated value object whose fields carry their own unit."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

FOLDER = "folder"
"""Key of the validation context under which the folder stands that files named in a specification lie in."""


class Spec(BaseModel):
    """A frozen value object: equal by content, hashable, refusing unknown fields and non-finite numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def quantity(
    default: Any = ...,
    *,
    unit: str,
    description: str,
    ge: float | None = None,
    gt: float | None = None,
    le: float | None = None,
    lt: float | None = None,
) -> Any:
    """Declare a field with its unit, its bounds and its meaning, once.

    Parameters
    ----------
    default : Any
        Value used when the field is absent; required when omitted.
    unit : str
        Unit of the field (``"mm"``, ``"deg"``, ``"nm"``, ``"1"`` for a pure number).
    description : str
        What the field means, in one sentence.
    ge, gt, le, lt : float, optional
        Bounds in the unit of the field.
    """
    return Field(
        default,
        description=description,
        ge=ge,
        gt=gt,
        le=le,
        lt=lt,
        json_schema_extra={"unit": unit},
    )
