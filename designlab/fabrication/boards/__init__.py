"""LED boards of a design: which it needs, what drives their LEDs, and the files to order them."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from designlab.fabrication.boards import circuit, layout, planes
from designlab.fabrication.boards.circuit import SUPPLY_V, BoardError, Channel, NoPartError
from designlab.fabrication.boards.drawn import Board, bodies, extent
from designlab.fabrication.boards.layout import SEAT_MM, Room
from designlab.fabrication.boards.stock import LAND_PATTERNS
from designlab.sensor.design import Design
from designlab.sensor.feasibility import intrusion_into_view_mm
from designlab.sensor.seating import inside

__all__ = ["SUPPLY_V", "Board", "BoardError", "Boards", "NoPartError", "boards"]


class Boards(NamedTuple):
    """All LED boards of a design, and how its groups are driven."""

    channels: tuple[Channel, ...]
    boards: tuple[Board, ...]
    notes: tuple[str, ...]
    assumed: tuple[str, ...]


def boards(design: Design, *, supply_v: float = SUPPLY_V) -> Boards:
    """Draw the LED boards of a design.

    A design that names no LED part gets the largest of the catalogue that fits its packages and whose boards
    can be made.

    Parameters
    ----------
    design : Design
        The sensor.
    supply_v : float
        Supply of the boards (V).

    Raises
    ------
    BoardError
        If a board cannot be made; names part, value and rule.
    """
    first: BoardError | None = None
    for name, turn_deg in _candidates(design):
        try:
            return _drawn(design, supply_v, name, turn_deg)
        except BoardError as error:
            first = error if first is None else first
    assert first is not None
    raise first


def _candidates(design: Design) -> list[tuple[str | None, float]]:
    """Parts to try where none is named, each as it lies and turned by a quarter where its front then fits."""
    if design.leds.part is not None or all(group.part is not None for group in design.leds.groups):
        return [(None, 0.0)]
    width, height = circuit.front_limit_mm(design.leds)
    found: list[tuple[str | None, float]] = []
    for name in circuit.stand_ins(design.leds):
        size = design.led_part(name).size_mm
        assert size is not None
        found.append((name, 0.0))
        if size[1] <= width + 1e-9 and size[0] <= height + 1e-9:
            found.append((name, 90.0))
    return found


def _drawn(design: Design, supply_v: float, stand_in: str | None, turn_deg: float) -> Boards:
    chosen = circuit.channels(design, supply_v=supply_v, stand_in=stand_in)
    width = max(_width_mm(channel, turn_deg) for channel in chosen)
    spots = planes.per_package(design.leds, width)
    if len(spots) > 1:
        chosen = circuit.channels(design, supply_v=supply_v, stand_in=stand_in, per_package=len(spots))
    housing = design.housing
    room = Room(
        housing.inner_radius_mm - SEAT_MM,
        housing.bottom_mm,
        housing.top_mm,
        _bore_mm(design),
    )
    blanks = planes.blanks(design, chosen, spots, turn_deg=turn_deg)
    rows = _in_series(blanks, chosen)
    if max(rows) > 1:
        chosen = circuit.channels(
            design, supply_v=supply_v, stand_in=stand_in, per_package=len(spots), in_series=rows
        )
    found = [layout.draw(blank, chosen, room) for blank in blanks]
    for board in found:
        _require_out_of_view(design, board)
    notes = list(dict.fromkeys(channel.note for channel in chosen if channel.note))
    notes += [f"{board.name}: {note}" for board in found for note in board.notes]
    notes += _unlike(design, chosen)
    return Boards(tuple(chosen), tuple(found), tuple(notes), tuple(circuit.assumed(chosen)))


def _in_series(blanks: Sequence[planes.Blank], chosen: Sequence[Channel]) -> list[int]:
    """How many chips of each group share a resistor: as many as the supply drives, in strings alike.

    Chips of a package that holds several have one each, since such packages may join their anodes.
    """
    found = []
    for index, channel in enumerate(chosen):
        places = [[place for place in blank.places if index in place.groups] for blank in blanks]
        alone = all(place.groups == (index,) for held in places for place in held)
        even = math.gcd(*(len(held) for held in places))
        longest = circuit.longest_string(channel) if alone else 1
        found.append(max(n for n in range(1, even + 1) if even % n == 0 and n <= longest))
    return found


def _require_out_of_view(design: Design, board: Board) -> None:
    """Refuse a board whose tail or parts stand between camera and sensing area."""
    reach = intrusion_into_view_mm(design, bodies(board))
    if reach > 0:
        raise BoardError(
            f"{board.name}: reaches {reach:.3g} mm into the camera's view of the sensing area, 0 mm may be; "
            "raise leds.radius_mm, or lower sensing_area_mm"
        )


def _bore_mm(design: Design) -> float:
    """Radius that a level board leaves free: of the clear window, or of the collar that stands around it."""
    within, seats = inside(design), design.housing.seats
    if within is None or seats is None or within.collar is None:
        return design.gelcore.window_diameter_mm / 2
    return within.collar.outer_mm + seats.gap_mm


def _width_mm(channel: Channel, turn_deg: float) -> float:
    """Width of a part with its pads along the row (mm)."""
    bounds = extent(LAND_PATTERNS[str(channel.part.land)], 0.0, 0.0, turn_deg).bounds
    return float(bounds[2] - bounds[0])


def _unlike(design: Design, chosen: Sequence[Channel]) -> list[str]:
    """Say where a part's own package differs from the one that light is simulated with."""
    array = design.leds
    if array.package == "panel":
        return ["leds.package: light is simulated with even strips, the boards carry single LEDs in them"]
    drawn = (array.body_width_mm, array.body_height_mm, array.body_thickness_mm)
    found = []
    for name, size in {channel.name: channel.part.size_mm for channel in chosen}.items():
        if size is None:
            continue
        pairs: list[tuple[Any, float]] = list(zip(size, drawn, strict=True))
        if any(own is not None and abs(own - as_drawn) > 0.05 for own, as_drawn in pairs):
            own = " x ".join("?" if value is None else f"{value:g}" for value in size)
            light = " x ".join(f"{value:g}" for value in drawn)
            found.append(
                f"{name} is {own} mm, light is simulated with LEDs of {light} mm; the boards put its front "
                "where the design's is"
            )
    return found
