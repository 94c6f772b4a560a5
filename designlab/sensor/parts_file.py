"""A user's own parts: LEDs, white spectra, filters and gels from a TOML file, as in the catalogue."""

import tomllib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from designlab.sensor import gel_materials, spectra
from designlab.sensor.gel_materials import GelMaterial
from designlab.sensor.led_catalogue import PARTS, LedPart
from geometries.spec import FOLDER, Spec
from geometries.spectrum import Filter, Spectrum

LARGEST_BYTES = 1_000_000


class OwnParts(Spec):
    """Content of a parts file: parts by kind and name."""

    leds: dict[str, LedPart] = Field({}, description="LEDs, with the fields of the catalogue.")
    spectra: dict[str, Spectrum] = Field({}, description="Spectra of white LEDs: wavelength_nm, power.")
    filters: dict[str, Filter] = Field({}, description="Colour filters: wavelength_nm, transmittance.")
    gels: dict[str, GelMaterial] = Field({}, description="Gels, with the fields of the catalogue.")

    @model_validator(mode="before")
    @classmethod
    def _named(cls, content: Any) -> Any:
        """Give each curve and gel the name that it stands under."""
        if not isinstance(content, Mapping):
            return content
        found = dict(content)
        for kind in ("spectra", "filters", "gels"):
            if isinstance(table := found.get(kind), Mapping):
                found[kind] = {
                    name: {**entry, "name": name} if isinstance(entry, Mapping) else entry
                    for name, entry in table.items()
                }
        return found

    @field_validator("leds", "spectra", "filters", "gels")
    @classmethod
    def _of_their_own(cls, parts: dict[str, Any], info: ValidationInfo) -> dict[str, Any]:
        catalogue: dict[str, Mapping[str, Any]] = {
            "leds": PARTS,
            "spectra": spectra.EMISSION,
            "filters": spectra.FILTERS,
            "gels": gel_materials.MATERIALS,
        }
        known = catalogue[str(info.field_name)]
        for name, part in parts.items():
            if name in known:
                raise ValueError(f"{name}: is a name of the catalogue; choose another one")
            if isinstance(part, Spectrum | Filter) and not part.wavelength_nm:
                raise ValueError(f"{name}: needs a table, wavelength_nm and its values")
        return parts


class PartsFile(Spec):
    """Parts of one's own, from a TOML file that is read once and then kept in the design."""

    file: str = Field(min_length=1, max_length=400)
    """TOML file with tables leds, spectra, filters and gels, relative to the design's own file."""
    content: str = Field("", repr=False)
    """Text of the file, kept in the design; written by the program."""

    @model_validator(mode="before")
    @classmethod
    def _read(cls, given: Any, info: ValidationInfo) -> Any:
        given = {"file": given} if isinstance(given, str) else given
        if not isinstance(given, dict) or given.get("content") or not isinstance(given.get("file"), str):
            return given
        return given | {"content": _text(Path((info.context or {}).get(FOLDER, ".")) / given["file"])}

    @model_validator(mode="after")
    def _sound(self) -> Self:
        _ = self.parts
        return self

    @property
    def parts(self) -> OwnParts:
        """The parts that it holds.

        Raises
        ------
        ValueError
            If the text is not TOML, or a part breaks a rule; names file, field, value and rule.
        """
        return _parsed(self.content, self.file)


def load_parts(path: str | Path) -> OwnParts:
    """Read a parts file.

    Raises
    ------
    ValueError
        If it cannot be used; names file, field, value and rule.
    """
    return _parsed(_text(Path(path)), str(path))


def resolved(content: Mapping[str, Any], own: OwnParts) -> dict[str, Any]:
    """Put one's own spectra, filters and gels into the content of a design that names them.

    Tables and moduli stay in the design; LEDs are filled in by `led_catalogue.filled`.
    """
    found = dict(content)
    if isinstance(camera := found.get("camera"), Mapping):
        found["camera"] = _with_table(camera, "filter", own.filters)
    if isinstance(leds := found.get("leds"), Mapping) and isinstance(leds.get("groups"), list | tuple):
        groups = [
            _with_table(_with_table(group, "filter", own.filters), "spectrum", own.spectra)
            if isinstance(group, Mapping)
            else group
            for group in leds["groups"]
        ]
        found["leds"] = {**leds, "groups": groups}
    contact = found.get("contact")
    if isinstance(contact, Mapping) and (gel := own.gels.get(str(contact.get("gel")))) is not None:
        figures = {"modulus_mpa": gel.modulus_mpa, "poisson": gel.poisson}
        stated = {name: value for name, value in contact.items() if value is not None}
        found["contact"] = figures | stated | {"gel": "custom"}
    return found


def _with_table(
    content: Mapping[str, Any], field: str, known: Mapping[str, Spectrum] | Mapping[str, Filter]
) -> dict[str, Any]:
    """Content whose field, where it names one's own curve without its table, holds the table."""
    value = content.get(field)
    name = value if isinstance(value, str) else value.get("name") if isinstance(value, Mapping) else None
    if name in known and not (isinstance(value, Mapping) and value.get("wavelength_nm")):
        return {**content, field: known[str(name)].model_dump()}
    return dict(content)


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise ValueError(f"{path}: must be at most {LARGEST_BYTES} bytes long; is it a parts file?")
        return path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ValueError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read as text: {error}") from None


@lru_cache(maxsize=16)
def _parsed(text: str, source: str) -> OwnParts:
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{source}: not valid TOML: {error}") from None
    if not content:
        raise ValueError(f"{source}: holds no parts; it has tables such as [leds.NAME] or [filters.NAME]")
    try:
        return OwnParts.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"])
        rule = first["msg"].removeprefix("Value error, ")
        if first["type"] == "extra_forbidden":
            rule = "unknown field"
        shown = isinstance(first["input"], str | int | float) and "got" not in rule
        value = f", got {first['input']!r}" if shown and first["type"] != "extra_forbidden" else ""
        more = len(error.errors()) - 1
        others = f" (and {more} more)" if more else ""
        raise ValueError(f"{source}: field {field}: {rule}{value}{others}") from None
