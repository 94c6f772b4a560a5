"""LEDs that can be bought: what their data sheets say, and how it fills the fields of a design.

Only figures that were read in the named source stand here; None means that it was not found there. Emitting
sizes were found for none: the whole front of a package is taken to emit (assumption).
"""

from collections.abc import Collection, Mapping
from typing import Any, Literal, NamedTuple

from designlab.sensor.spectra import luminous_efficacy_lm_w
from geometries.emission import AngularProfile


class Chip(NamedTuple):
    """One colour of a part: wavelength, spectral width (full, at half maximum; nm), radiant flux (mW).

    `intensity_mcd` is the typical luminous intensity on the axis, which sheets often give instead of a flux.
    """

    wavelength_nm: float | None
    kind: Literal["peak", "dominant", "nominal"] = "peak"
    width_nm: float | None = None
    flux_mw: float | None = None
    intensity_mcd: float | None = None


class LedPart(NamedTuple):
    """An LED: front (width, height) and thickness of its package in mm, full viewing angle at half intensity.

    The first size runs along the row, the second towards the membrane: for a right-angle part its height
    above the circuit board. Flux and intensity of a chip are for the current named in the source.
    """

    maker: str
    number: str
    chips: Mapping[str, Chip]
    size_mm: tuple[float, float, float | None] | None
    viewing_deg: float | None
    source: str


PARTS: dict[str, LedPart] = {
    "broadcom-asmt-qtb4": LedPart(
        "Broadcom",
        "ASMT-QTB4-0AA02",
        {"red": Chip(629.0), "green": Chip(521.0), "blue": Chip(464.0)},
        None,
        120.0,
        "data sheet ASMT-QTB4-0AA02, table 3 (PLCC-4, three colours, black front)",
    ),
    "kingbright-apfa3010": LedPart(
        "Kingbright",
        "APFA3010LSEKJ3ZGKQBC",
        {
            "red": Chip(None, intensity_mcd=40.0),
            "green": Chip(None, intensity_mcd=60.0),
            "blue": Chip(None, intensity_mcd=10.0),
        },
        (3.0, 1.0, 1.5),
        150.0,
        "data sheet DSAO4458 V.3B, page 1, at 2 mA (right-angle, three colours)",
    ),
    "kingbright-apgf0606": LedPart(
        "Kingbright",
        "APGF0606VGTPBTSEETC",
        {
            "red": Chip(None, intensity_mcd=25.0),
            "green": Chip(None, intensity_mcd=90.0),
            "blue": Chip(None, intensity_mcd=20.0),
        },
        (0.65, 0.65, 0.2),
        140.0,
        "data sheet DSAP1402 V.3B, page 1, at 5 mA (three colours)",
    ),
    "kingbright-aphb1608": LedPart(
        "Kingbright",
        "APHB1608ZGKSURKC",
        {"red": Chip(None, intensity_mcd=250.0), "green": Chip(None, intensity_mcd=350.0)},
        (1.6, 0.8, 0.5),
        130.0,
        "data sheet DSAM9277 V.4A, page 1, at 20 mA (0603, two colours)",
    ),
    "kingbright-apt1608ec": LedPart(
        "Kingbright",
        "APT1608EC",
        {"red": Chip(627.0, width_nm=45.0, intensity_mcd=15.0)},
        (1.6, 0.8, 0.75),
        150.0,
        "data sheet DSAD0924 V.17A, at 20 mA (0603)",
    ),
    "kingbright-aptf1616": LedPart(
        "Kingbright",
        "APTF1616LSEKJ3ZGKQBC",
        {
            "red": Chip(640.0, width_nm=20.0),
            "green": Chip(515.0, width_nm=35.0),
            "blue": Chip(460.0, width_nm=25.0),
        },
        (1.6, 1.6, 0.7),
        None,
        "data sheet DSAO4460 V.4B, at 2 mA (0606, three colours)",
    ),
    "osram-gf-cs8pm1": LedPart(
        "OSRAM",
        "GF CS8PM1.24",
        {"infrared": Chip(730.0, "nominal", flux_mw=231.0)},
        None,
        80.0,
        "data sheet OSLON SSL 80, version 1.1 (2015-12-21), typical flux at 350 mA (lens, far red)",
    ),
    "osram-lrtb-g6tg": LedPart(
        "OSRAM",
        "LRTB G6TG",
        {"red": Chip(625.0, "nominal"), "green": Chip(528.0, "nominal"), "blue": Chip(470.0, "nominal")},
        None,
        120.0,
        "data sheet MULTILED LRTB G6TG, features (PLCC-6, three colours)",
    ),
    "vishay-vlm1300": LedPart(
        "Vishay",
        "VLMS1300, VLMTG1300, VLMB1300",
        {
            "red": Chip(631.0, "nominal", intensity_mcd=54.0),
            "green": Chip(525.0, "nominal"),
            "blue": Chip(470.0, "nominal"),
        },
        (1.6, 0.8, 0.8),
        130.0,
        "data sheet 82437 rev. 1.4, page 1, at 20 mA (0603, one colour each; blue: middle of 465 to 475 nm)",
    ),
    "vishay-vlmrgb6112": LedPart(
        "Vishay",
        "VLMRGB6112",
        {"red": Chip(None, intensity_mcd=730.0), "green": Chip(None), "blue": Chip(None)},
        (3.5, 2.8, 1.45),
        120.0,
        "data sheet VLMRGB6112, page 1, at 20 mA (PLCC-6, 3528, three colours)",
    ),
    "worldsemi-ws2812b": LedPart(
        "Worldsemi",
        "WS2812B",
        {
            "red": Chip(622.5, "nominal", intensity_mcd=405.0),
            "green": Chip(523.5, "nominal", intensity_mcd=690.0),
            "blue": Chip(466.0, "nominal", intensity_mcd=190.0),
        },
        (5.0, 5.0, None),
        120.0,
        "data sheet figures as sellers print them, at full brightness; middles of 620 to 625, 522 to 525 and "
        "465 to 467 nm, of 390 to 420, 660 to 720 and 180 to 200 mcd (5050, driver inside, three colours)",
    ),
}
FILLED_ARRAY = (
    "body_width_mm",
    "body_height_mm",
    "body_thickness_mm",
    "emitting_width_mm",
    "emitting_spans_mm",
    "profile",
)
FILLED_GROUP = ("wavelength_nm", "width_nm", "flux_mw", "profile")


def part(name: str) -> LedPart:
    """Look up a part by name.

    Raises
    ------
    ValueError
        If the name is unknown; the message lists the known ones.
    """
    try:
        return PARTS[name]
    except KeyError:
        raise ValueError(f"unknown part {name!r}; known are {', '.join(PARTS)}") from None


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


def filled(leds: Mapping[str, Any]) -> dict[str, Any]:
    """Fill the fields of an LED array that its parts know and that are not given.

    Parameters
    ----------
    leds : mapping
        Content of the table ``leds`` of a design. `part` of the array fills package size and angular profile,
        and for each group, by its name (``red``), the chip's figures; `part` of a group fills the latter and
        the group's own profile.

    Raises
    ------
    ValueError
        If a part is unknown, or does not know the wavelength of a group that gives none.
    """
    content = dict(leds)
    whole = _named(content, "leds.part")
    if whole is not None:
        _fill(content, _array_fields(whole))
    groups = content.get("groups")
    if isinstance(groups, list | tuple):
        content["groups"] = [
            _group(group, whole, f"leds.groups.{index}") if isinstance(group, Mapping) else group
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


def _named(content: Mapping[str, Any], where: str) -> LedPart | None:
    name = content.get("part")
    if not isinstance(name, str):
        return None
    try:
        return part(name)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _group(group: Mapping[str, Any], whole: LedPart | None, where: str) -> dict[str, Any]:
    content = dict(group)
    own = _named(content, f"{where}.part")
    chosen = whole if own is None else own
    if chosen is None:
        return content
    chips = chosen.chips
    chip = chips.get(str(content.get("name")), next(iter(chips.values())) if len(chips) == 1 else None)
    known = chip is not None and chip.wavelength_nm is not None
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
