"""Fields of a design as people read them: path, unit, range, default and meaning of each."""

import difflib
import json
import re
import types
from collections.abc import Iterator
from typing import Any, NamedTuple, Union, get_args, get_origin

import annotated_types
from pydantic import BaseModel
from pydantic.fields import FieldInfo

NEAR = 0.55  # similarity of texts from which one may be meant by the other
_BOUNDS: dict[type, str] = {
    annotated_types.Gt: "above ",
    annotated_types.Ge: "",
    annotated_types.Lt: "below ",
    annotated_types.Le: "",
}
_TABLE = re.compile(r"\[+(?P<path>[^\]]+)\]+")
_STRING = re.compile(r'"(?:\\.|[^"\\])*"')
_ENTRY = re.compile(r"(?P<name>[A-Za-z_][\w-]*) = ")


class FieldLine(NamedTuple):
    """One field: dotted path (entries of lists without their number), unit, range, default and meaning."""

    path: str
    unit: str
    values: str
    default: str
    meaning: str

    @property
    def text(self) -> str:
        """The field in one line, without its path."""
        unit = "" if self.unit in ("", "1") else self.unit
        absent = f"default {self.default}" if self.default else ""
        about = ", ".join(part for part in (unit, self.values, absent) if part)
        return f"{self.meaning} [{about}]" if about else self.meaning


def fields(model: type[BaseModel], prefix: str = "") -> Iterator[FieldLine]:
    """Fields of a specification and of all that it holds, in order."""
    for name, field in model.model_fields.items():
        path = f"{prefix}{name}"
        inner = list(_models(field.annotation))
        if not inner:
            yield _line(path, field)
        for each in inner:
            yield from fields(each, f"{path}.")


def described(model: type[BaseModel]) -> str:
    """All fields, one a line, for the help of a specification."""
    seen: dict[str, str] = {}
    for line in fields(model):
        seen.setdefault(line.path, line.text)
    return "\n".join(f"    {path}\n        {text}" for path, text in seen.items())


def nearest(model: type[BaseModel], path: str) -> str:
    """The field that a path, which is none, comes nearest to; empty if none is near."""
    bare = re.sub(r"\.\d+(?=\.|$)", "", path)
    known = list(dict.fromkeys(line.path for line in fields(model)))
    last = bare.rpartition(".")[2]
    ends = {each.rpartition(".")[2]: each for each in reversed(known)}
    if last in ends:
        return ends[last]
    found = difflib.get_close_matches(bare, known, n=1, cutoff=NEAR)
    found = found or [ends[end] for end in difflib.get_close_matches(last, list(ends), n=1, cutoff=NEAR)]
    return found[0] if found else ""


def commented(toml: str, model: type[BaseModel]) -> str:
    """TOML text of a specification with the meaning of each field beside it."""
    known: dict[str, FieldLine] = {}
    for line in fields(model):
        known.setdefault(line.path, line)
    table, lines, depth = "", [], 0
    for text in toml.splitlines():
        entry = _ENTRY.match(text) if depth == 0 else None
        heading = _TABLE.fullmatch(text) if depth == 0 else None
        bare = _STRING.sub("", text)  # brackets within texts close nothing
        depth += bare.count("[") - bare.count("]") if heading is None else 0
        if heading is not None:
            table = f"{heading['path']}."
        elif entry is not None and (found := known.get(table + entry["name"])) is not None:
            lines.append(f"# {found.text}")
        lines.append(text)
    return "\n".join(lines) + "\n"


def _line(path: str, field: FieldInfo) -> FieldLine:
    extra = field.json_schema_extra
    unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
    bounds = {}
    for rule in field.metadata:
        for kind, word in _BOUNDS.items():
            if isinstance(rule, kind):
                bounds[kind.__name__[0]] = f"{word}{getattr(rule, kind.__name__.lower()):g}"
    choices = [text for text in get_args(field.annotation) if isinstance(text, str)]
    values = " | ".join(choices) or " to ".join(bounds[key] for key in "GL" if key in bounds)
    absent = None if field.is_required() or field.default_factory else field.default
    default = "" if absent in ("", (), None) else json.dumps(absent, default=str)
    return FieldLine(path, unit, values, default, " ".join((field.description or "").split()))


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Specifications that a field may hold, in lists too."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) in (Union, types.UnionType, tuple, list) or hasattr(
        annotation, "__metadata__"
    ):
        for part in get_args(annotation):
            yield from _models(part)
