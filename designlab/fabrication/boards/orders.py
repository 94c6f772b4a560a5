"""What goes with a board's Gerber files: bill of materials, placement, nets, specification, and its solid."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from designlab.fabrication.boards.circuit import Channel
from designlab.fabrication.boards.drawn import Board, Component
from designlab.fabrication.boards.stock import (
    CLEARANCE_MM,
    EDGE_MM,
    HOLE_MM,
    STOCK,
    TRACK_MM,
    VIA_DRILL_MM,
    VIA_MM,
)

if TYPE_CHECKING:
    import cadquery

SAME_MM = 1e-6
HOLES_FOR = {
    "ring": "for pegs of a housing with seats, or screws M1.6",
    "strip": "for screws M1.6; a housing with seats leaves them empty, glue holds the board",
}
PLACED = ("led", "resistor", "connector")
"""Kinds of components that are bought and placed; wire pads are copper only."""


def placed(board: Board) -> list[Component]:
    """Components that are bought and placed."""
    return [component for component in board.components if component.kind in PLACED]


def fitted(board: Board) -> list[Component]:
    """Components that the maker of the board places: all but the connector, whose holes stay open."""
    return [component for component in placed(board) if component.kind != "connector"]


def bill_rows(board: Board) -> list[dict[str, Any]]:
    """Bill of materials of one board: one row a part, with its designators; DNP is what stays off."""
    rows: dict[tuple[str, ...], list[str]] = {}
    for component in placed(board):
        key = (component.kind, component.value, component.maker, component.number, component.land.name)
        rows.setdefault(key, []).append(component.designator)
    return [
        {
            "Designator": ",".join(designators),
            "Quantity": len(designators),
            "Value": value,
            "Footprint": land,
            "Manufacturer": maker,
            "Part number": number,
            "DNP": "do not populate: wires are soldered here" if kind == "connector" else "",
        }
        for (kind, value, maker, number, land), designators in rows.items()
    ]


def placement_rows(board: Board) -> list[dict[str, Any]]:
    """Pick and place: middle and turn of every fitted part, counter-clockwise, seen from the front."""
    return [
        {
            "Designator": component.designator,
            "Mid X": round(component.x, 4) + 0.0,
            "Mid Y": round(component.y, 4) + 0.0,
            "Layer": component.side,
            "Rotation": round(component.turn_deg % 360.0, 3) % 360.0,
        }
        for component in fitted(board)
    ]


def net_rows(board: Board) -> list[dict[str, Any]]:
    """Net list: every pad with its net; a pad that is alone on its net is not connected."""
    return [
        {
            "Designator": component.designator,
            "Pad": pad.name,
            "Net": pad.net,
            "X": round(pad.x, 4) + 0.0,
            "Y": round(pad.y, 4) + 0.0,
            "Layer": "both" if pad.drill_mm else pad.side,
        }
        for component in board.components
        for pad in component.pads
    ]


def specification(board: Board, channels: Sequence[Channel]) -> str:
    """Text for the order: what the maker of the board needs to know, and how it is wired."""
    flexible = board.blank.kind == "flex"
    stock = STOCK["flex" if flexible else "board"]
    groups = sorted({group for place in board.blank.places for group in place.groups})
    width, height = board.size_mm
    lines = [
        board.name,
        f"size           {width:.2f} x {height:.2f} mm, outline in Edge_Cuts.gm1",
        f"layers         2, {stock['material']}",
        f"thickness      {board.thickness_mm:g} mm; the LEDs' place follows from the front's, not from it",
        f"mask           {stock['mask']}; no legend but the polarity marks, white paint would shine",
        f"finish         {stock['finish']}",
        f"least track    {TRACK_MM:g} mm, least clearance {CLEARANCE_MM:g} mm, copper to edge {EDGE_MM:g} mm",
        f"holes          vias {VIA_DRILL_MM:g} mm in {VIA_MM:g} mm of copper, tented; "
        + (
            f"{len(board.holes)} of {HOLE_MM:g} mm without copper, {HOLES_FOR[board.blank.kind]}"
            if board.holes
            else "no others"
        ),
        "origin         one for Gerber, drill and placement files: "
        + {
            "ring": "the sensor's axis",
            "strip": "the middle of the LEDs",
            "flex": "the left end of the line of LEDs",
        }[board.blank.kind],
        f"parts          {len(fitted(board))}, the connector left out; placement is seen from the front, "
        "turns are counter-clockwise",
        f"connector      pads in order: {', '.join(board.pins)}; {channels[0].supply_v:g} V at V+, switch "
        "the others to ground",
        "",
    ]
    for group in groups:
        channel = channels[group]
        drive = 1.0 if channel.group.drive is None else channel.group.drive
        count = sum(group in place.groups for place in board.blank.places)
        chip = channel.chip
        lines.append(
            f"{channel.group.name}: {count} x {channel.number}, {chip.forward_v:g} V at "
            f"{chip.current_ma:g} mA; {_strings(channel.in_series)} {channel.current_ma:.4g} mA through "
            f"{channel.resistor.value} "
            f"({channel.resistor.number}, "
            f"{channel.resistor.load_mw:.3g} of {channel.resistor.rating_mw:g} mW); the group "
            f"{count // channel.in_series * channel.current_ma:.4g} mA, on for {100 * drive:g} % of the time"
        )
        if channel.from_flux and channel.flux_mw is not None and channel.wanted_mw is not None:
            lines.append(
                f"  flux of each chip {channel.flux_mw:.4g} mW, the design has {channel.wanted_mw:.4g} mW "
                f"({100 * (channel.flux_mw / channel.wanted_mw - 1):+.1f} %: next value of E24)"
            )
        if channel.note:
            lines.append(f"  brightness unknown: {channel.note}")
    for name in dict.fromkeys(channels[group].name for group in groups):
        part = next(channel.part for channel in channels if channel.name == name)
        if told := [field for field in part.assumed if field in ("land", "anode", "cathode")]:
            lines.append(
                f"{part.number}: {', '.join(told)} assumed; compare pads and pins with its data sheet before "
                "ordering. The white bar stands at the cathode; pad 1 is in the nets file"
            )
    if flexible:
        folds = ", ".join(f"{high:.2f}" for _, high in board.blank.facets[:-1])
        lines += ["", f"bend at x = {folds} mm, around the gelcore, the LEDs inside"]
    return "\n".join([*lines, *board.notes]) + "\n"


def _strings(in_series: int) -> str:
    return "each" if in_series == 1 else f"each string of {in_series} in series"


def solid(board: Board) -> "cadquery.Shape":
    """Board as a solid in the sensor frame (mm), with its mounting holes; a flexible one is bent."""
    import cadquery

    low_x, low_y, high_x, high_y = board.outline.bounds
    if board.blank.kind == "flex":
        return _bent(board)
    frame = board.blank.frames[0]
    plane = cadquery.Plane(
        origin=tuple(frame.origin.tolist()), xDir=tuple(frame.x.tolist()), normal=tuple(frame.normal.tolist())
    )
    work = cadquery.Workplane(plane)
    if board.blank.kind == "ring":
        bore = max((ring.bounds[2] for ring in board.outline.interiors), default=0.0)
        body = work.circle(high_x)
        body = body.circle(bore) if bore else body
        body = body.extrude(-board.thickness_mm)
    else:
        body = work.center((low_x + high_x) / 2, (low_y + high_y) / 2)
        body = body.rect(high_x - low_x, high_y - low_y).extrude(-board.thickness_mm)
    for x, y, diameter in board.holes:
        body = body.cut(
            cadquery.Workplane(plane).center(x, y).circle(diameter / 2).extrude(-board.thickness_mm)
        )
    return _shape(body)


def led_solids(board: Board) -> "list[cadquery.Shape]":
    """LEDs of a board in the order of its places, as boxes in the sensor frame (mm)."""
    import cadquery

    found = []
    for led in (component for component in board.components if component.kind == "led"):
        frame, along = board.blank.frame_at(led.x)
        turn = math.radians(led.turn_deg)
        across = math.cos(turn) * frame.x + math.sin(turn) * frame.y
        plane = cadquery.Plane(
            origin=tuple(frame.point(along, led.y).tolist()),
            xDir=tuple(across.tolist()),
            normal=tuple(frame.normal.tolist()),
        )
        work = cadquery.Workplane(plane).rect(*led.land.body_mm).extrude(board.blank.led_mm)
        found.append(_shape(work))
    return found


def _shape(work: "cadquery.Workplane") -> "cadquery.Shape":
    import cadquery

    shape = work.val()
    assert isinstance(shape, cadquery.Shape)
    return shape


def _bent(board: Board) -> "cadquery.Shape":
    """Flexible board around the axis: flat facets that meet in folds."""
    import cadquery

    blank, thickness = board.blank, board.thickness_mm
    _, low_y, _, high_y = board.outline.bounds
    inside, outside = [], []
    for frame, (low, high) in zip(blank.frames, blank.facets, strict=True):
        half = (high - low) / 2
        inside += [frame.point(-half, 0.0), frame.point(half, 0.0)]
        # Facets are tangents of one circle, so their backs meet on the rays through the folds.
        radius = float(frame.origin @ -frame.normal)
        grown = (radius + thickness) / radius
        outside += [
            frame.point(-half, 0.0) * (grown, grown, 1.0),
            frame.point(half, 0.0) * (grown, grown, 1.0),
        ]
    corners: list[tuple[float, float]] = []
    for point in (*inside, *reversed(outside)):  # neighbours share the corners of their fold
        corner = float(point[0]), float(point[1])
        if not corners or math.dist(corner, corners[-1]) > SAME_MM:
            corners.append(corner)
    level = float(blank.frames[0].origin[2])
    section = cadquery.Workplane("XY", origin=(0, 0, level + low_y)).polyline(corners).close()
    return _shape(section.extrude(high_y - low_y))
