"""What is wrong with a field, in one line: its name as in the file, the rule, the value."""

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from designlab.sensor.contact import CONTACT_MODELS


def explain(error: ValidationError) -> str:
    """Put the first problem of a pydantic error into one line: field, rule, value, how many others."""
    problems = [problem for problem in error.errors() if not _follows_from_another(problem, error)]
    first = problems[0]
    # A rule about the whole names its fields itself.
    own = first["type"] == "value_error" and not first["loc"]
    field = "" if own else f"{'.'.join(entries(first['loc'])) or '(whole)'}: "
    rule = first["msg"].removeprefix("Value error, ")
    if first["type"] == "extra_forbidden":
        rule = "unknown field"
    whole = isinstance(first["input"], Mapping)  # a rule about several fields names them itself
    value = (
        "" if whole or first["type"] in ("missing", "extra_forbidden") else f", got {shorten(first['input'])}"
    )
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    # Our own rules may state the value themselves; pydantic's "got a number with ..." does not.
    stated = first["type"] == "value_error" and "got" in rule
    return f"field {field}{rule}{'' if stated else value}{more}"


def entries(location: Sequence[str | int]) -> list[str]:
    """Names of a field and what holds it, as they stand in a file: without the model that was chosen."""
    entries = [str(part) for part in location]
    if "contact" in entries[:-1] and entries[entries.index("contact") + 1] in CONTACT_MODELS:
        del entries[entries.index("contact") + 1]
    return entries


def _follows_from_another(problem: Any, error: ValidationError) -> bool:
    """Whether it is said only because another field was refused: of a list without items, of a default."""
    if problem["type"] == "default_factory_not_called":
        return True
    depth = len(problem["loc"])
    return problem["type"] == "too_short" and any(
        len(other["loc"]) > depth and other["loc"][:depth] == problem["loc"] for other in error.errors()
    )


def shown(value: Any) -> str:
    """A value of a field for people."""
    return f"{value:g}" if isinstance(value, float) else "none" if value is None else shorten(value)


def shorten(value: Any) -> str:
    """Python's own text of a value, cut to 60 characters."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
