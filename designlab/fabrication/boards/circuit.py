"""What drives the LEDs: part of each group, current from its flux, and the series resistor of each chip.

The flux of a chip is taken as proportional to its current, as it is near the current of the data sheet.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from designlab.fabrication.boards.stock import LAND_PATTERNS, STOCK, LandPattern
from designlab.sensor.design import Design
from designlab.sensor.led_catalogue import PARTS, Chip, LedPart, flux_mw
from geometries.leds import LedArray, LedGroup

SUPPLY_V = 5.0
"""Supply of the boards when none is given."""
HEADROOM_V = 0.3
"""Left for the resistor and the switch of a group, so that the current does not hang on the LED's voltage."""
BALLAST = 0.3
"""Least voltage across the resistor of a string of LEDs over that of its LEDs: with less, the current would
follow the LEDs' own voltage, which differs from one to the next."""
LOADED = 0.8
"""Share of its rating that a resistor carries at most."""
NEAR_NM = 25.0
"""A chip stands in for a group whose peak lies this near."""
E24 = (10, 11, 12, 13, 15, 16, 18, 20, 22, 24, 27, 30, 33, 36, 39, 43, 47, 51, 56, 62, 68, 75, 82, 91)


class BoardError(ValueError):
    """A board that cannot be made; the text names part, value and rule."""


class NoPartError(BoardError):
    """No part is named and none of the catalogue stands in."""


class Resistor(NamedTuple):
    """A series resistor: value, size, and the load it carries."""

    ohm: float
    size: str
    load_mw: float
    rating_mw: float

    @property
    def land(self) -> LandPattern:
        """Its land pattern."""
        return LAND_PATTERNS[STOCK["resistor"]["sizes"][self.size]["land"]]

    @property
    def value(self) -> str:
        """Value as schematics print it, such as 150R or 1K5."""
        for factor, letter in ((1e6, "M"), (1e3, "K"), (1.0, "R")):
            if self.ohm >= factor or factor == 1.0:
                whole, _, rest = f"{self.ohm / factor:g}".partition(".")
                return f"{whole}{letter}{rest}"
        raise AssertionError

    @property
    def number(self) -> str:
        """The maker's part number."""
        return str(STOCK["resistor"]["number"]).format(size=self.size, code=self.value)


class Channel(NamedTuple):
    """How the LEDs of one group are driven: `in_series` chips in a row share a resistor.

    `current_ma` is what the resistor lets through; `flux_mw` the chip's flux then, and `wanted_mw` that of
    the design. `from_flux` says whether the current follows from the design's flux; if not, it
    is the part's own.
    """

    group: LedGroup
    name: str
    part: LedPart
    colour: str
    chip: Chip
    supply_v: float
    current_ma: float
    resistor: Resistor
    flux_mw: float | None
    wanted_mw: float | None
    from_flux: bool
    note: str
    in_series: int = 1

    @property
    def number(self) -> str:
        """Maker's part number; a part whose colours are sold apart lists one a chip."""
        numbers = self.part.number.split(", ")
        each = numbers[list(self.part.chips).index(self.colour)] if len(numbers) > 1 else self.part.number
        return each or self.name

    @property
    def anode(self) -> str:
        """Pad of the anode."""
        return str(self.chip.anode)

    @property
    def cathode(self) -> str:
        """Pad of the cathode."""
        return str(self.chip.cathode)

    def told(self) -> dict[str, Any]:
        """Figures for the manifest."""
        return {
            "group": self.group.name,
            "part": self.name,
            "number": self.number,
            "forward_v": self.chip.forward_v,
            "supply_v": self.supply_v,
            "in_series": self.in_series,
            "current_ma": round(self.current_ma, 4),
            "current_max_ma": self.chip.current_max_ma,
            "resistor_ohm": self.resistor.ohm,
            "resistor": self.resistor.number,
            "resistor_mw": round(self.resistor.load_mw, 3),
            "resistor_rating_mw": self.resistor.rating_mw,
            "drive": 1.0 if self.group.drive is None else self.group.drive,
            "current_from": "flux" if self.from_flux else "part",
            "design_flux_mw": self.wanted_mw,
            "board_flux_mw": None if self.flux_mw is None else round(self.flux_mw, 5),
            "note": self.note,
        }


def channels(
    design: Design,
    *,
    supply_v: float = SUPPLY_V,
    per_package: int = 1,
    stand_in: str | None = None,
    in_series: Sequence[int] = (),
) -> list[Channel]:
    """Drive of every LED group, in their order.

    Parameters
    ----------
    design : Design
        The sensor.
    supply_v : float
        Supply of the boards (V).
    per_package : int
        LEDs on each package of the design; a panel carries several.
    stand_in : str, optional
        Part of groups for which the design names none; the first of `stand_ins` when absent.
    in_series : sequence of int
        Chips that share a resistor, for each group; one when absent.

    Raises
    ------
    BoardError
        If the supply does not suffice, a part lacks what a board needs, or a current or load is too high;
        names part, value and rule.
    """
    if not (math.isfinite(supply_v) and 0 < supply_v <= 60):
        raise BoardError(f"supply_v: lies above 0 V and up to 60 V, got {supply_v:g} V")
    groups = range(len(design.leds.groups))
    rows = in_series or [1] * len(groups)
    return [_channel(design, index, supply_v, per_package, stand_in, rows[index]) for index in groups]


def longest_string(channel: Channel) -> int:
    """How many chips of a group the supply drives in series, `BALLAST` left to their resistor."""
    return max(1, int(channel.supply_v / (float(channel.chip.forward_v or 0.0) * (1 + BALLAST)) + 1e-9))


def front_limit_mm(array: LedArray) -> tuple[float, float]:
    """Largest front (width, height) that an LED of the array may have; of a panel, its strips' (mm)."""
    if array.package != "panel":
        return array.body_width_mm, array.body_height_mm
    return array.emitting_width_mm, min(high - low for low, high in array.emitting_spans_mm)


def _channel(
    design: Design, index: int, supply_v: float, per_package: int, stand_in: str | None, in_series: int
) -> Channel:
    array, group = design.leds, design.leds.groups[index]
    named = group.part or array.part
    name = named or stand_in or stand_ins(array)[0]
    part = design.led_part(name)
    where = f"part {name!r} of LED group {group.name!r}"
    if part.land is None:
        raise BoardError(
            f"{where}: has no land pattern, so no board holds it; give the part's field land, one of "
            f"{', '.join(n for n in LAND_PATTERNS if n.startswith('LED'))}"
        )
    if part.land not in LAND_PATTERNS:
        raise BoardError(
            f"{where}: land pattern {part.land!r} is unknown; known are {', '.join(LAND_PATTERNS)}"
        )
    colour = _colour(part, group, where)
    chip = part.chips[colour]
    for field in ("forward_v", "current_ma", "current_max_ma", "anode", "cathode"):
        if getattr(chip, field) is None:
            raise BoardError(f"{where}: chips.{colour}.{field} is not given; a board needs it")
    for pad in (str(chip.anode), str(chip.cathode)):
        if pad not in LAND_PATTERNS[part.land].pads:
            raise BoardError(f"{where}: chips.{colour} names pad {pad!r}, {part.land} has no such pad")
    each = group.flux_mw / (group.count * len(group.azimuth_deg) * per_package)
    at_sheet = flux_mw(part, chip)
    from_flux, note = False, ""
    if named is None:
        note = f"the design names no LED part: made for {name} at the current of its data sheet"
        note += ", whatever its flux" if not array.relative_flux else "; its fluxes are relative"
    elif array.relative_flux:
        note = f"fluxes are relative, so no current follows from them: that of the sheet of {name} is used"
    elif at_sheet is None:
        note = f"no flux of {name} is known, so no current follows: that of its data sheet is used"
    else:
        from_flux = True
    current = float(chip.current_ma or 0.0) * (each / at_sheet if from_flux and at_sheet else 1.0)
    found, drawn = _resistor(where, chip, supply_v, current, in_series)
    built = None if at_sheet is None else at_sheet * drawn / float(chip.current_ma or 1.0)
    return Channel(
        group,
        name,
        part,
        colour,
        chip,
        supply_v,
        drawn,
        found,
        built if from_flux else None,
        each if from_flux else None,
        from_flux,
        note,
        in_series,
    )


def stand_ins(array: LedArray) -> list[str]:
    """Parts of the catalogue that may stand in where a design names none, the largest front first.

    Each fits into the design's own front, knows every size and has a chip for each group.

    Raises
    ------
    NoPartError
        If there is none.
    """
    width, height = front_limit_mm(array)
    fitting = {
        name: part.size_mm[0] * part.size_mm[1]
        for name, part in PARTS.items()
        if part.size_mm is not None
        and part.size_mm[2] is not None
        and part.size_mm[0] <= width + 1e-9
        and part.size_mm[1] <= height + 1e-9
        and part.land in LAND_PATTERNS
        and all(_match(part, group) is not None for group in array.groups)
    }
    if not fitting:
        raise NoPartError(
            f"leds.part: none is named, and no part of the catalogue has a land pattern, a front within "
            f"{width:g} x {height:g} mm and the colours of the groups; name one"
        )
    return sorted(fitting, key=lambda name: -fitting[name])


def _match(part: LedPart, group: LedGroup) -> str | None:
    """Colour of a part that serves a group: the one of its name, the only one, else the nearest peak."""
    if group.name in part.chips:
        return group.name
    peaks = {c: chip.wavelength_nm for c, chip in part.chips.items() if chip.wavelength_nm is not None}
    if not peaks:
        return None
    nearest = min(peaks, key=lambda colour: abs(peaks[colour] - group.wavelength_nm))
    return nearest if abs(peaks[nearest] - group.wavelength_nm) <= NEAR_NM else None


def _colour(part: LedPart, group: LedGroup, where: str) -> str:
    if len(part.chips) == 1:
        return next(iter(part.chips))
    colour = _match(part, group)
    if colour is None:
        raise BoardError(
            f"{where}: has {', '.join(part.chips)}, none within {NEAR_NM:g} nm of "
            f"{group.wavelength_nm:g} nm; name the group after one"
        )
    return colour


def _resistor(
    where: str, chip: Chip, supply_v: float, wanted_ma: float, in_series: int
) -> tuple[Resistor, float]:
    """Nearest value of E24 that keeps the part's limit, in the smallest size that bears it; the current."""
    forward_v, limit_ma = float(chip.forward_v or 0.0), float(chip.current_max_ma or 0.0)
    across_v = supply_v - in_series * forward_v
    if across_v < HEADROOM_V:
        raise BoardError(
            f"{where}: forward voltage {forward_v:g} V needs a supply of {forward_v + HEADROOM_V:g} V or "
            f"more ({HEADROOM_V:g} V for resistor and switch), supply_v is {supply_v:g} V"
        )
    if wanted_ma > limit_ma:
        raise BoardError(
            f"{where}: the design's flux needs {wanted_ma:.4g} mA, the part bears {limit_ma:g} mA; lower "
            "flux_mw, add LEDs or name a stronger part"
        )
    exact = across_v / wanted_ma * 1e3
    ohms = [step * 10.0**power for power in range(-2, 8) for step in E24]
    allowed = [ohm for ohm in ohms if across_v / ohm * 1e3 <= limit_ma]
    ohm = min(allowed, key=lambda value: abs(math.log(value / exact)))
    drawn = across_v / ohm * 1e3
    load = drawn * across_v
    sizes: Mapping[str, Mapping[str, Any]] = STOCK["resistor"]["sizes"]
    for size, figures in sizes.items():
        if load <= LOADED * figures["rating_mw"]:
            return Resistor(ohm, size, load, figures["rating_mw"]), drawn
    strongest = max(figures["rating_mw"] for figures in sizes.values())
    raise BoardError(
        f"{where}: its series resistor would bear {load:.4g} mW, at most {LOADED * strongest:g} mW may be; "
        f"lower supply_v ({supply_v:g} V) or the flux"
    )


def assumed(chosen: Sequence[Channel]) -> list[str]:
    """Figures of the boards' parts that no source at hand states, as dotted names."""
    listed = [f"{channel.name}.{field}" for channel in chosen for field in channel.part.assumed]
    listed += [f"boards.{kind}" for kind in ("resistor", "hole", "board") if STOCK[kind]["assumed"]]
    return list(dict.fromkeys(listed))
