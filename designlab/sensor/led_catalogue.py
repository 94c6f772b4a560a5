"""LEDs that can be bought: what their data sheets say, and how it fills the fields of a design.

Only figures that were read in the named source stand here; None means that it was not found there. What LED
boards need and no source at hand states is assumed, and named in `assumed`. Emitting sizes were found for
none: the whole front of a package is taken to emit (assumption).
"""

from collections.abc import Collection, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from designlab.sensor.data import table
from designlab.sensor.spectra import luminous_efficacy_lm_w
from geometries.emission import AngularProfile
from geometries.spec import Spec, quantity

Size = Annotated[float, Field(gt=0, le=200)]  # mm


class Chip(Spec):
    """One colour of a part: wavelength, spectral width, radiant flux."""

    wavelength_nm: float | None = quantity(None, unit="nm", ge=350, le=1100)
    """Wavelength; the middle where a range is sold."""
    kind: Literal["peak", "dominant", "nominal"] = "peak"
    """Which wavelength the sheet gives."""
    width_nm: float | None = quantity(None, unit="nm", gt=0.1, le=300)
    """Full width of the spectrum at half maximum."""
    spectrum: str | None = Field(None, min_length=1, max_length=80)
    """Name of the spectrum of a chip behind phosphor, instead of a width."""
    flux_mw: float | None = quantity(None, unit="mW", gt=0, le=1e6)
    """Radiant flux at the current that the source names."""
    intensity_mcd: float | None = quantity(None, unit="mcd", gt=0, le=1e9)
    """Typical luminous intensity on the axis, which sheets often give instead of a flux."""
    forward_v: float | None = quantity(None, unit="V", gt=0, le=100)
    """Typical forward voltage at `current_ma`."""
    current_ma: float | None = quantity(None, unit="mA", gt=0, le=1e5)
    """Forward current at which flux, intensity and forward voltage are given."""
    current_max_ma: float | None = quantity(None, unit="mA", gt=0, le=1e5)
    """Highest continuous forward current."""
    anode: str | None = Field(None, min_length=1, max_length=8)
    """Pad of the land pattern that the chip's anode is soldered to."""
    cathode: str | None = Field(None, min_length=1, max_length=8)
    """Pad of its cathode."""


class LedPart(Spec):
    """An LED: its package and its colours."""

    maker: str = ""
    """Who makes it."""
    number: str = ""
    """The maker's part number."""
    chips: dict[str, Chip] = Field(min_length=1)
    """Colours by name."""
    source: str = ""
    """Where the figures were read."""
    size_mm: tuple[Size, Size, Size | None] | None = None
    """Front (width, height) and thickness of the package (mm). The first runs along the row, the second
    towards the membrane: for a right-angle part its height above the circuit board."""
    viewing_deg: float | None = quantity(None, unit="deg", ge=1, lt=180)
    """Full viewing angle at half intensity."""
    land: str | None = Field(None, min_length=1, max_length=80)
    """Land pattern of the package on a circuit board, by its name in the library of land patterns."""
    assumed: tuple[str, ...] = ()
    """Fields of this part that are assumed: no source at hand states them."""

    @field_validator("size_mm", mode="before")
    @classmethod
    def _flat(cls, size: Any) -> Any:
        """Take two figures for a front whose thickness is unknown."""
        return (*size, None) if isinstance(size, list | tuple) and len(size) == 2 else size


def _parts() -> dict[str, LedPart]:
    return {name: LedPart.model_validate(content) for name, content in table("led_catalogue").items()}


PARTS = _parts()
"""The catalogue, read from `data/led_catalogue.toml`."""
FILLED_ARRAY = (
    "body_width_mm",
    "body_height_mm",
    "body_thickness_mm",
    "emitting_width_mm",
    "emitting_spans_mm",
    "profile",
)
FILLED_GROUP = ("wavelength_nm", "width_nm", "spectrum", "flux_mw", "profile")
NO_PARTS: Mapping[str, LedPart] = {}


def part(name: str, own: Mapping[str, LedPart] = NO_PARTS) -> LedPart:
    """Look up a part by name, in the catalogue and among parts of one's `own`.

    Raises
    ------
    ValueError
        If the name is unknown; the message lists the known ones.
    """
    known = {**own, **PARTS}
    try:
        return known[name]
    except KeyError:
        raise ValueError(f"unknown part {name!r}; known are {', '.join(known)}") from None


def flux_mw(chosen: LedPart, chip: Chip) -> float | None:
    """Radiant flux of one chip (mW): the data sheet's, or estimated from its luminous intensity.

    The intensity spreads as cos(angle)^m, m from the viewing angle, over 2 pi / (m + 1) sr; the spectrum
    turns lumen into watt. Against a sheet that states its lumen per watt (Broadcom ASMT-QTB4) a Gaussian
    spectrum makes the estimate 8 % (red) and 14 % (green) too high; 56 % for blue, whose real spectrum has
    a tail towards green that the eye sees far better than the peak.
    """
    known = chosen.viewing_deg is not None and chip.intensity_mcd is not None
    if chip.flux_mw is not None or not known or chip.wavelength_nm is None:
        return chip.flux_mw
    spread_sr = AngularProfile(beam_deg=chosen.viewing_deg).flux
    efficacy = luminous_efficacy_lm_w(chip.wavelength_nm, chip.width_nm)
    return float(f"{(chip.intensity_mcd or 0.0) * spread_sr / efficacy:.3g}")


def filled(leds: Mapping[str, Any], own: Mapping[str, LedPart] = NO_PARTS) -> dict[str, Any]:
    """Fill the fields of an LED array that its parts know and that are not given.

    Parameters
    ----------
    leds : mapping
        Content of the table ``leds`` of a design. `part` of the array fills package size and angular profile,
        and for each group, by its name (``red``), the chip's figures; `part` of a group fills the latter and
        the group's own profile.
    own : mapping of str to LedPart
        Parts of one's own beside the catalogue.

    Raises
    ------
    ValueError
        If a part is unknown, or does not know the wavelength of a group that gives none.
    """
    content = dict(leds)
    whole = _named(content, "leds.part", own)
    if whole is not None:
        _fill(content, _array_fields(whole))
    groups = content.get("groups")
    if isinstance(groups, list | tuple):
        content["groups"] = [
            _group(group, whole, f"leds.groups.{index}", own) if isinstance(group, Mapping) else group
            for index, group in enumerate(groups)
        ]
    return content


def forget(leds: dict[str, Any], path: str, *, given: Collection[str]) -> None:
    """Drop the fields that a newly named part fills.

    Parameters
    ----------
    leds : dict
        Complete content of the table ``leds``; changed.
    path : str
        Dotted path of the changed `part`, ``leds.part`` or ``leds.groups.N.part``.
    given : collection of str
        Paths that are set together with it, and stay.
    """
    groups = list(leds["groups"])
    if path == "leds.part":
        chosen: list[tuple[dict[str, Any], str, tuple[str, ...]]] = [(leds, "leds", FILLED_ARRAY)]
        chosen += [(g, f"leds.groups.{k}", FILLED_GROUP) for k, g in enumerate(groups) if not g.get("part")]
    else:
        place = path.removesuffix(".part")
        chosen = [(groups[int(place.rsplit(".", 1)[1])], place, FILLED_GROUP)]
    for node, place, names in chosen:
        for name in names:
            own = f"{place}.{name}"
            if not any(change == own or change.startswith(own + ".") for change in given):
                node.pop(name, None)


def _named(content: Mapping[str, Any], where: str, own: Mapping[str, LedPart]) -> LedPart | None:
    name = content.get("part")
    if not isinstance(name, str):
        return None
    try:
        return part(name, own)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _group(
    group: Mapping[str, Any], whole: LedPart | None, where: str, known_parts: Mapping[str, LedPart]
) -> dict[str, Any]:
    content = dict(group)
    own = _named(content, f"{where}.part", known_parts)
    chosen = whole if own is None else own
    if chosen is None:
        return content
    chips = chosen.chips
    chip = chips.get(str(content.get("name")), next(iter(chips.values())) if len(chips) == 1 else None)
    known = chip is not None and (chip.wavelength_nm is not None or chip.spectrum is not None)
    if not known and content.get("wavelength_nm") is None:
        reason = (
            f"part {chosen.number} has {', '.join(chips)}; name the group so"
            if chip is None
            else f"the library has no wavelength of {chosen.number}"
        )
        raise ValueError(f"{where}.wavelength_nm: {reason}, or give it")
    values: dict[str, Any] = {}
    if chip is not None:
        values = {"wavelength_nm": chip.wavelength_nm, "width_nm": chip.width_nm}
        values["spectrum"] = chip.spectrum
        flux = flux_mw(chosen, chip)
        rows, count = content.get("azimuth_deg"), content.get("count", 1)
        if flux is not None and isinstance(rows, list | tuple) and isinstance(count, int):
            values["flux_mw"] = flux * count * len(rows)
    if own is not None and own.viewing_deg is not None:
        values["profile"] = {"beam_deg": own.viewing_deg}
    _fill(content, values)
    return content


def _array_fields(chosen: LedPart) -> dict[str, Any]:
    values: dict[str, Any] = {}
    if chosen.viewing_deg is not None:
        values["profile"] = {"beam_deg": chosen.viewing_deg}
    if chosen.size_mm is not None:
        width, height, thickness = chosen.size_mm
        values |= {
            "body_width_mm": width,
            "body_height_mm": height,
            "body_thickness_mm": thickness,
            "emitting_width_mm": width,
            "emitting_spans_mm": ((-height / 2, height / 2),),
        }
    return values


def _fill(content: dict[str, Any], values: Mapping[str, Any]) -> None:
    for name, value in values.items():
        if value is not None and content.get(name) is None:
            content[name] = value
