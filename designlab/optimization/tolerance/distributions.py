"""Spreads say which fields and effects differ between built copies of a design, and by how much."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from designlab.core.fields import field_at
from designlab.core.store import digest
from designlab.core.types import Array
from designlab.sensor.design import Design, DesignError
from designlab.sensor.field_errors import explain
from designlab.sensor.seating import camera_board
from designlab.simulation.effects import AppliedEffect, SensorModel, effect
from geometries.housing import Seats
from geometries.spec import Spec

PLACED_MM = 0.1  # to which packages are placed on their board
CUT_SD = 3.0  # copies further off are sorted out before they are used
EFFECTS = "effects"
ANY = "*"


class Spread(Spec):
    """How one dimension, material figure or part of a built sensor departs from its drawing."""

    field: str = Field(
        description="Field of the design by dotted path, or effects.NAME.PARAMETER of the catalogue; "
        "* stands for every LED group, or every parameter of an effect, each with a draw of its own."
    )
    sd: float = Field(
        gt=0, description="Standard deviation, in the unit of the field; draws end at three of it."
    )
    relative: bool = Field(False, description="Whether the deviation is a share of the value.")
    also: tuple[str, ...] = Field((), description="Fields that move by the same distance.")
    source: str = Field("", description="Where the figure comes from.")


@dataclass(frozen=True)
class Input:
    """One number that is drawn for every copy.

    Attributes
    ----------
    name : str
        Field or effect and parameter.
    spread : Spread
        What it is drawn from.
    """

    name: str
    spread: Spread

    @property
    def is_effect(self) -> bool:
        """Whether it is a parameter of an effect."""
        return self.name.startswith(f"{EFFECTS}.")


def default_spreads(design: Design) -> tuple[Spread, ...]:
    """Spreads of a sensor that a laboratory makes itself: printed housing, cast gel, LEDs of one reel."""
    found: list[Spread] = []

    def add(
        field: str, sd: float, source: str, *, relative: bool = False, also: tuple[str, ...] = ()
    ) -> None:
        found.append(Spread(field=field, sd=sd, relative=relative, also=also, source=source))

    bins = "an intensity bin is 10 to 15 % wide (data sheet OSXX0402C1C), even over it"
    add("leds.groups.*.flux_mw", 0.035, bins, relative=True)
    add("effects.led_spread.*", 0.035, "as the flux of groups: LEDs side by side are of one bin")
    wavelength = "5 nm to either side of the typical wavelength (data sheet LLH-RGBW-5050), even over it"
    add("leds.groups.*.wavelength_nm", 2.9, wavelength)
    if design.housing.seats is None:
        place = "package and board 0.1 mm (data sheet LLH-RGBW-5050), printed slot (estimate)"
        add("effects.led_position.*", 0.1, place)
        add("effects.led_tilt.*", 1.0, "board in a printed slot (estimate)")
        add("effects.camera_pose.*", 0.1, "module in a printed seat, mm and deg (estimate)")
    else:
        for field, sd, source in _plays(design, design.housing.seats):
            add(field, sd, source)
    add("optics.membrane_albedo", 0.05, "sprayed coating (estimate)", relative=True)
    dome = design.elastomer.shape == "dome"
    # The membrane is the origin: a thicker gel moves all above it away.
    heights = ("leds.height_mm", *(f"leds.groups.{k}.height_mm" for k in design.leds.own("height_mm")))
    above = (*heights, "camera.position_mm.2", *(("elastomer.radius_mm",) if dome else ()))
    add("elastomer.thickness_mm", 0.1, "gel cast in a printed mould (estimate)", also=above)
    if dome:
        mould = "printed or turned mould, 0.5 % of the radius (estimate)"
        # A core that is nearly a hemisphere has no room for a smaller sphere within its width.
        core = design.gelcore
        room_mm = math.inf if core.radius_mm is None else core.radius_mm - core.width_mm / 2
        if room_mm > 0:
            also = ("gelcore.radius_mm",)
            add("elastomer.radius_mm", min(0.2, room_mm / (CUT_SD + 1)), mould, also=also)
    if design.optics.light_path == "core":
        add("optics.elastomer_index", 0.003, "silicones of one kind (estimate)")
        add("optics.gelcore_index", 0.002, "acrylic of several makers (estimate)")
        if "ground" in (design.gelcore.side_finish, design.gelcore.led_side_finish):
            add("gelcore.ground_roughness", 0.2, "sanded by hand (estimate)", relative=True)
    return tuple(spread for spread in found if _has(design, spread))


def _plays(design: Design, seats: Seats) -> Iterator[tuple[str, float, str]]:
    """Field, sd and source of how far parts move and turn in their seats: evenly over the gap of the fit."""
    play_mm, leds, across = seats.gap_mm / math.sqrt(3.0), design.leds, camera_board(seats.camera).board_mm
    fit = f"housing.seats: even over its gap of {seats.gap_mm:g} mm on each side"
    on_board = f"package on its board 0.1 mm (data sheet LLH-RGBW-5050); {fit}"
    yield "effects.led_position.*", math.hypot(PLACED_MM / math.sqrt(3.0), play_mm), on_board
    row_mm = leds.body_width_mm + leds.pitch_mm * (min(group.count for group in leds.groups) - 1)
    yield "effects.led_tilt.*", math.degrees(math.atan2(play_mm, row_mm)), f"{fit}, over the row of LEDs"
    for axis in "xyz":
        yield f"effects.camera_pose.{axis}_mm", play_mm, fit
    lean_deg = math.degrees(math.atan2(play_mm, min(across[1] - across[0], across[3] - across[2])))
    for axis in "xy":
        yield f"effects.camera_pose.tilt_{axis}_deg", lean_deg, f"{fit}, over the camera board"


def _has(design: Design, spread: Spread) -> bool:
    """Whether a design has what a default spread is about."""
    if not spread.field.startswith(f"{EFFECTS}."):
        return True
    return bool(effect(spread.field.split(".")[1]).parameters(design))


def inputs(design: Design, spreads: Sequence[Spread]) -> tuple[Input, ...]:
    """Everything that is drawn for a copy of a design.

    Raises
    ------
    ValueError
        If a spread names no field or effect of the design, or one is named twice.
    """
    found = [Input(name, spread) for spread in spreads for name in _names(design, spread)]
    names = [each.name for each in found]
    if doubled := {name for name in names if names.count(name) > 1}:
        raise ValueError(f"spreads: {', '.join(sorted(doubled))} is given twice")
    for each in found:
        if not each.is_effect:
            for path in (each.name, *each.spread.also):
                _number(design, path)
    return tuple(found)


def applicable(design: Design, spreads: Sequence[Spread]) -> tuple[Spread, ...]:
    """Those spreads that a design has: a radius is for a dome, not for a flat gel."""
    return tuple(spread for spread in spreads if _misfit(design, spread) is None)


def require_applicable(designs: Sequence[Design], spreads: Sequence[Spread]) -> None:
    """Refuse a spread that none of some designs has, and two that move the same thing.

    Raises
    ------
    ValueError
        That names the spread by its place.
    """
    for number, spread in enumerate(spreads):
        misfits = [_misfit(design, spread) for design in designs]
        if all(misfits):
            raise ValueError(f"spread.{number}: {misfits[0]}")
    for design in designs:
        inputs(design, applicable(design, spreads))


def _misfit(design: Design, spread: Spread) -> str | None:
    """Why a design does not have a spread, if so."""
    try:
        inputs(design, (spread,))
    except ValueError as error:
        return str(error).removeprefix("spreads: ")
    return None


def _names(design: Design, spread: Spread) -> Iterator[str]:
    first, *rest = spread.field.split(".")
    if first == EFFECTS:
        if len(rest) != 2:
            raise ValueError(f"spreads: {spread.field!r} is not effects.NAME.PARAMETER")
        name, wanted = rest
        known = [p.name for p in effect(name).parameters(design) if not p.shape]
        chosen = known if wanted == ANY else [p for p in known if p == wanted]
        if not chosen:
            raise ValueError(
                f"spreads: {spread.field!r}: {name} has no parameter {wanted!r} on this design, "
                f"only {', '.join(known) or 'none'}"
            )
        yield from (f"{EFFECTS}.{name}.{p}" for p in chosen)
    elif ANY in rest:
        for k in range(len(design.leds.groups)):
            yield spread.field.replace(ANY, str(k), 1)
    else:
        yield spread.field


def _number(design: Design, path: str) -> float | tuple[float, ...]:
    """Value of a field that can be moved: a number, or one for each LED group."""
    if path in ("optics.gelcore_index", "optics.elastomer_index"):  # by default their material's
        return design.optics.core_index if "gelcore" in path else design.optics.gel_index
    try:
        node = field_at(design, path).value
    except LookupError as error:
        raise ValueError(f"spreads: {error} in a design") from None
    numbers = node if isinstance(node, tuple) else (node,)
    if not numbers or any(isinstance(v, bool) or not isinstance(v, int | float) for v in numbers):
        raise ValueError(f"spreads: {path} is no number in this design, it is {node!r}")
    return node if isinstance(node, tuple) else float(node)


def deviates(count: int, names: Sequence[str], seed: int) -> Array:
    """Standard normal draws, cut at `CUT_SD`, for things by name: (count, names).

    What is drawn for a name depends on it, the number and the seed alone: sensors that differ in other things
    have the same luck in this one, and the first draws stay the same when more are asked for.
    """
    from scipy.stats import truncnorm  # with much else, which takes a second

    seeds = ([seed, int(digest(name)[:16], 16)] for name in names)
    even = [_stratified(count, np.random.default_rng(own)) for own in seeds]
    return np.asarray(truncnorm.ppf(np.reshape(even, (len(names), count)).T, -CUT_SD, CUT_SD))


def _stratified(count: int, random: np.random.Generator) -> Array:
    """Numbers that fill 0 to 1 evenly: of the first 2^k, one lies in each of 2^k equal intervals.

    Their order within each doubling is random, so that columns of a table are independent: it is a Latin
    hypercube (McKay, Beckman and Conover 1979) that can be extended.
    """
    points = random.random(1)
    while len(points) < count:
        intervals = 2 * len(points)
        empty = np.setdiff1d(np.arange(intervals), (points * intervals).astype(int))
        points = np.append(points, (random.permutation(empty) + random.random(len(empty))) / intervals)
    return points[:count]


def copy(nominal: SensorModel, drawn: Sequence[Input], values: Array) -> SensorModel:
    """Built copy of a model.

    Parameters
    ----------
    nominal : SensorModel
        The drawing.
    drawn : sequence of Input
        What departs from it.
    values : array, shape (inputs,)
        By how many standard deviations each.

    Raises
    ------
    DesignError
        If such a copy cannot be: a value breaks a rule of its field.
    """
    design = nominal.design
    changes: dict[str, Any] = {}
    built: dict[str, dict[str, float]] = {}
    for each, by in zip(drawn, values, strict=True):
        away = float(by) * each.spread.sd
        if each.is_effect:
            _, name, parameter = each.name.split(".")
            own = built.setdefault(name, dict(_stated(nominal, name)))
            own[parameter] += away * (own[parameter] if each.spread.relative else 1.0)
            continue
        value = _number(design, each.name)
        shares = np.atleast_1d(value)
        moved = shares * (1 + away) if each.spread.relative else shares + away
        _put(changes, design, each.name, moved - shares)
        for path in each.spread.also:
            _put(changes, design, path, np.full(1, float(moved[0] - shares[0])))
    try:
        model = nominal.replace(changes) if changes else nominal
        for name, own in built.items():
            model = model.with_effect(AppliedEffect(name=name, values=own))
    except ValidationError as error:  # a value beyond the bounds of an effect
        raise DesignError(explain(error)) from None
    return model


def _stated(model: SensorModel, name: str) -> dict[str, float]:
    """Values of an effect that a model has, or at which it does nothing."""
    present = {applied.name: applied.values for applied in model.effects}
    return present.get(name) or effect(name).null(model.design)


def _put(changes: dict[str, Any], design: Design, path: str, away: Array) -> None:
    """Add a deviation to a field, which another input may have moved already."""
    before = changes.get(path, _number(design, path))
    after = np.atleast_1d(before) + away
    changes[path] = tuple(float(v) for v in after) if isinstance(before, tuple) else float(after[0])
