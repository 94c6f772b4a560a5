"""The base of every specification: a frozen, validated value object whose fields carry their own unit."""

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

FOLDER = "folder"
"""Key of the validation context under which the folder stands that files named in a specification lie in."""


class Spec(BaseModel):
    """A frozen value object: equal by content, hashable, refusing unknown fields and non-finite numbers.

    The text below a field, or the `description` given to it, says what it means.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)


def quantity(default: Any = ..., *, unit: str, description: str | None = None, **bounds: Any) -> Any:
    """Declare a field with its unit and its bounds, once.

    Parameters
    ----------
    default : Any
        Value used when the field is absent; required when omitted.
    unit : str
        Unit of the field (``"mm"``, ``"deg"``, ``"nm"``, ``"1"`` for a pure number).
    description : str, optional
        What the field means, in one sentence; the text below the field when absent.
    **bounds : float
        Bounds ``ge``, ``gt``, ``le`` and ``lt`` in the unit of the field.
    """
    return Field(default, description=description, json_schema_extra={"unit": unit}, **bounds)
