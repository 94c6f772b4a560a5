"""Controls of a design, made from the metadata of its own fields: unit, bounds, choices, meaning."""

import math
import types
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from designlab.core.fields import field_at, unit_of
from designlab.sensor.contact import CONTACT_MODELS, CUSTOM, KernelContact, LayerContact
from designlab.sensor.design import Design
from designlab.sensor.gel_materials import MATERIALS as GELS
from designlab.sensor.led_catalogue import PARTS
from designlab.sensor.optical_constants import MATERIALS
from designlab.sensor.parts_file import OwnParts
from designlab.sensor.spectra import EMISSION, FILTERS, SENSITIVITIES, Sensitivity
from geometries.spectrum import Filter, Spectrum

MODELS: dict[str, type[KernelContact | LayerContact]] = {"kernel": KernelContact, "layer": LayerContact}
Kind = Literal["number", "choice", "switch", "text", "numbers"]

TITLES = {
    "gelcore": "Gelcore",
    "elastomer": "Gel",
    "leds": "LEDs",
    "housing": "Housing",
    "optics": "Materials and light path",
    "contact": "Contact",
    "camera": "Camera",
    "design": "Sensing area and mixing",
}
LOOSE = "design"  # part of the fields that belong to no other
NAMED = (Spectrum, Filter, Sensitivity)  # specifications that a name of the catalogue stands for
UNTOLD = ("name", "description", "parent", "parts")
OPEN = "open"  # shown for a field that holds a table of one's own
WHOLE_RANGE = 2.0  # bounds this near to each other are the range of a slider
PER_MM = "_per_mm"
ENDINGS = (PER_MM, "_mm", "_deg", "_nm", "_px", "_mw", "_mpa", "_ms", "_db", "_e")
"""Units at the end of a name, which the label has beside it."""
LEAST_REACH = {"mm": 2.0, "deg": 10.0, "nm": 50.0}
FILES = (
    "file",
    "ies",
    "ldt",
    "pixels",
    "content",
)  # texts that name or hold files: not for an address to state


@dataclass(frozen=True)
class Control:
    """One field as a person may change it.

    Attributes
    ----------
    path : str
        Dotted path of the field.
    label, unit, meaning : str
        Name without its unit, the unit (empty for a pure number) and what it means.
    kind : str
        number, choice, switch, text, or numbers (a list of them, with its brackets left out).
    value : Any
        What stands there now; None where the field is off.
    low, high : float
        Bounds of a number; infinite where there is none.
    whole : bool
        Whether the number is whole.
    choices : tuple of str
        Of a choice.
    optional : bool
        Whether the field may be off.
    """

    path: str
    label: str
    unit: str
    meaning: str
    kind: Kind
    value: Any
    low: float = -math.inf
    high: float = math.inf
    whole: bool = False
    choices: tuple[str, ...] = ()
    optional: bool = False

    def edit(self, value: Any) -> tuple[str, Any]:
        """Path and value of `Design.replace` that set the field."""
        if self.path == "contact.model":
            return "contact", MODELS[value]().model_dump()  # whole, so that its other fields can be set too
        return self.path, value


@dataclass(frozen=True)
class Part:
    """Controls that belong together."""

    key: str
    title: str
    controls: tuple[Control, ...] = field(default=())


def parts(design: Design) -> tuple[Part, ...]:
    """All controls of a design by part; each LED group is a part of its own."""
    return tuple(Part(key, title, tuple(controls)) for key, title, controls in _parts(design))


def control_at(design: Design, path: str) -> Control | None:
    """The control of one field, one of `parts`, which takes longer to make; None where there is none."""
    found: Iterable[Control] = ()
    for key, _, controls in _parts(design):
        if path.startswith(f"{key}.") or (key == LOOSE and not found):
            found = controls  # an LED group comes behind the part of all LEDs
    return next((control for control in found if control.path == path), None)


def slider_range(control: Control, around: float | None) -> tuple[float, float, float] | None:
    """Low end, high end and step of a slider about a value; None where there is none to turn about.

    Angles and shares have their bounds; lengths and others reach as far again as the value, within bounds.
    """
    if control.kind != "number" or around is None:
        return None
    low, high = control.low, control.high
    near = control.unit == "deg" or high - low <= WHOLE_RANGE
    if not (near and math.isfinite(low) and math.isfinite(high)):
        reach = max(abs(around), LEAST_REACH.get(control.unit, 0.0), 1.0 if control.whole else 0.0)
        if reach > 0:
            low, high = max(low, around - reach), min(high, around + reach)
    if not (math.isfinite(low) and math.isfinite(high)):
        return None
    step = 1.0 if control.whole else 10.0 ** math.floor(math.log10(max(high - low, 1e-9) / 100))
    # Bounds that do not belong to the range lie a hair within it; a step further in is rounder.
    low, high = math.ceil(low / step - 1e-3) * step, math.floor(high / step + 1e-3) * step
    low, high = low + step * (low < control.low), high - step * (high > control.high)
    return (low, high, step) if high > low else None


def read_numbers(text: str) -> Any:
    """Numbers of a text as lists: ``0, 120``, or rows in brackets, ``(0, 0), (1, 2)``.

    Raises
    ------
    ValueError
        If the text holds anything else.
    """
    import ast

    told = text.strip().rstrip(",")
    if not told:
        return None
    try:
        found = ast.literal_eval(f"[{told}]")
    except (ValueError, SyntaxError, MemoryError, RecursionError):
        raise ValueError(f"must be numbers with commas between them, got {text[:40]!r}") from None
    if not _only_numbers(found):
        raise ValueError(f"must be numbers with commas between them, got {text[:40]!r}")
    return found


def numbers_text(value: Any) -> str:
    """What `read_numbers` reads."""
    if value is None:
        return ""
    return ", ".join(
        f"({numbers_text(item)})" if isinstance(item, Sequence) else f"{item:.12g}" for item in value
    )


def _only_numbers(value: Any) -> bool:
    if isinstance(value, list | tuple):
        return all(_only_numbers(item) for item in value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def _parts(design: Design) -> Iterator[tuple[str, str, Iterable[Control]]]:
    """Key, title and controls of each part; controls are made as they are asked for."""
    own = OwnParts() if design.parts is None else design.parts.parts
    loose: list[Iterable[Control]] = []
    for name, info in type(design).model_fields.items():
        if name in UNTOLD:
            continue
        value = getattr(design, name)
        if isinstance(value, BaseModel):
            yield name, TITLES[name], _controls(value, f"{name}.", design, own)
        else:
            loose.append(_control(design, name, info, name, design, own))
        if name == "leds":
            for index, group in enumerate(design.leds.groups):
                key = f"leds.groups.{index}"
                yield key, f"LED group {group.name}", _controls(group, f"{key}.", design, own)
    yield LOOSE, TITLES[LOOSE], chain.from_iterable(loose)


def _controls(spec: BaseModel, prefix: str, design: Design, own: OwnParts) -> Iterator[Control]:
    """Controls of a part: its own fields first, then those of what it holds, such as a profile."""
    found: list[list[Control]] = [[], []]
    for name, info in type(spec).model_fields.items():
        path = f"{prefix}{name}"
        made = list(_control(spec, name, info, path, design, own))
        found[any(control.path != path for control in made)] += made
    for controls in found:
        yield from controls


def _control(
    spec: BaseModel, name: str, info: FieldInfo, path: str, design: Design, own: OwnParts
) -> Iterator[Control]:
    """The control of one field, or those of what it holds."""
    value = getattr(spec, name)
    annotation, optional = _without_none(info.annotation)
    named = next((kind for kind in NAMED if annotation is kind or isinstance(value, kind)), None)
    if isinstance(value, BaseModel) and named is None:
        yield from _controls(value, f"{path}.", design, own)
        return
    if named is None and _holds_specs(annotation):
        return  # LED groups are parts of their own; what is off, such as a mirror, begins in the file
    extra = info.json_schema_extra
    unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
    if not unit:
        unit = "1/mm" if name.endswith(PER_MM) else unit_of(path)
    told: dict[str, Any] = {
        "path": path,
        "label": _label(path),
        "unit": "" if unit == "1" else unit,
        "meaning": " ".join((info.description or "").split()),
        "optional": optional,
    }
    choices = _choices(path, annotation, own)
    if choices:
        shown = value
        if isinstance(value, BaseModel):
            shown = getattr(value, "name", "") or OPEN
        yield Control(**told, kind="choice", value=shown, choices=choices)
    elif annotation is bool:
        yield Control(**told, kind="switch", value=value)
    elif annotation in (int, float):
        at = field_at(design, path)
        yield Control(**told, kind="number", value=value, low=at.low, high=at.high, whole=annotation is int)
    elif annotation is str and name not in FILES:
        yield Control(**told, kind="text", value=value)
    elif get_origin(annotation) is tuple:
        yield Control(**told, kind="numbers", value=value)


def _choices(path: str, annotation: Any, own: OwnParts) -> tuple[str, ...]:
    """What may be picked: the words of a literal, or the names of the catalogue and of one's own parts."""
    last = path.rpartition(".")[2]
    catalogue: Mapping[str, tuple[str, ...]] = {
        "gelcore_material": tuple(MATERIALS),
        "elastomer_material": tuple(MATERIALS),
        "gel": (*GELS, *own.gels, CUSTOM),
        "part": (*PARTS, *own.leds),
        "spectrum": (*EMISSION, *own.spectra),
        "filter": (*FILTERS, *own.filters),
        "sensitivity": tuple(SENSITIVITIES),
    }
    if path == "contact.model":
        return CONTACT_MODELS
    if last in catalogue:
        return catalogue[last]
    return tuple(word for word in get_args(annotation) if isinstance(word, str))


def _without_none(annotation: Any) -> tuple[Any, bool]:
    """The annotation without the None that it may be, and whether it may."""
    if get_origin(annotation) in (Union, types.UnionType):
        rest = [part for part in get_args(annotation) if part is not type(None)]
        if len(rest) < len(get_args(annotation)):
            return (rest[0] if len(rest) == 1 else Union[tuple(rest)]), True  # noqa: UP007  made here
    return annotation, False


def _holds_specs(annotation: Any) -> bool:
    if isinstance(annotation, type):
        return issubclass(annotation, BaseModel)
    return any(_holds_specs(part) for part in get_args(annotation))


def _label(path: str) -> str:
    """Name of a field for people: what holds it within its part, without the unit."""
    parts = [part for part in path.split(".") if not part.isdigit()]
    shown = parts[2:] if parts[:2] == ["leds", "groups"] else parts[1:] or parts
    last = shown[-1]
    for end in ENDINGS:
        if last.endswith(end):
            last = last.removesuffix(end)
            break
    return " ".join([*shown[:-1], last]).replace("_", " ")
