"""Picture of a board: both sides with copper, parts, polarity marks and designators."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shapely import affinity
from shapely.geometry import LineString, Point, Polygon, box
from shapely.ops import nearest_points

from designlab.fabrication.boards.drawn import MARK_MM, Board, Component
from designlab.fabrication.boards.gerber import plus_mark
from designlab.fabrication.boards.stock import VIA_DRILL_MM

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BOARD, TRACKS, PADS, BODY, INK = "#1d1f22", "#4a5058", "#d9b45b", "#8d949c", "#20242a"
LETTER_MM = 0.5
"""Height of designators, on the board's scale."""
Colour = tuple[float, float, float]


def write_picture(board: Board, path: Path, *, colours: Sequence[Colour], title: str) -> None:
    """Write both sides of a board as a PNG; the back is seen from behind.

    Parameters
    ----------
    board : Board
        The board.
    path : Path
        File to write.
    colours : sequence of (float, float, float)
        Colour of each group (sRGB, 0..1).
    title : str
        Text above.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    width, height = board.size_mm
    beside = width <= 1.6 * height
    scale = min(0.42, 7.0 / max(width, height))  # inches a millimetre
    room = 1.4  # mm around the board, for designators
    each = ((width + 2 * room) * scale, (height + 2 * room) * scale)
    size = (2 * each[0], each[1] + 1.1) if beside else (each[0], 2 * each[1] + 1.4)
    size = (max(size[0], 6.5), size[1])
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2) if beside else figure.subplots(2, 1)
    for layer, axis in enumerate(axes):
        _side(axis, board, layer, colours, room, points=72.0 * scale * LETTER_MM)
    figure.suptitle(title, fontsize=9, color=INK)
    note = "white bar: cathode; plus: supply; all in mm"
    figure.supxlabel(note, fontsize=7, color=INK)
    figure.savefig(path, dpi=200, metadata={"Software": None})


def _side(
    axis: "Axes", board: Board, layer: int, colours: Sequence[Colour], room: float, *, points: float
) -> None:
    side = ("top", "bottom")[layer]
    mirror = layer == 1

    def seen(shape: Any) -> Any:
        return affinity.scale(shape, -1.0, 1.0, origin=(0, 0)) if mirror else shape

    _fill(axis, seen(board.outline), BOARD, 0)
    for track in board.tracks:
        if track.layer == layer:
            _fill(axis, seen(track.shape), TRACKS, 1)
    pads = [seen(pad.shape) for pad in board.pads if layer in pad.layers]
    for pad in pads:
        _fill(axis, pad, PADS, 2)
    for via in board.vias:
        _fill(axis, seen(via.shape), TRACKS, 2)
        x = -via.x if mirror else via.x
        axis.add_patch(_disc(x, via.y, VIA_DRILL_MM / 2, "#0c0d0e", 3))
    drilled = [(pad.x, pad.y, pad.drill_mm) for pad in board.pads if pad.drill_mm]
    for x, y, diameter in [*board.holes, *drilled]:
        axis.add_patch(_disc(-x if mirror else x, y, diameter / 2, "white", 4))
    parts = [component for component in board.components if component.side == side]
    for component in parts:
        if component.kind == "led":
            _led(axis, component, colours)
        elif component.kind == "resistor":
            _fill(axis, seen(component.body), BODY, 4, alpha=0.75)
    for part in board.components:
        if part.kind == "connector":
            x, y = seen(part.body).exterior.xy
            axis.plot(x, y, color=TRACKS, linewidth=0.8, zorder=5)
    covered = [*pads, seen(board.outline.boundary)]
    covered += [seen(via.shape) for via in board.vias]
    covered += [seen(Point(x, y).buffer(diameter / 2)) for x, y, diameter in board.holes]
    if layer == 0:
        covered += [LineString(led.mark).buffer(MARK_MM) for led in parts if led.kind == "led"]
    elif (plus := plus_mark(board)) is not None:
        for line in plus:
            x, y = seen(LineString(line)).xy
            axis.plot(x, y, color="white", linewidth=1.2, zorder=6)
            covered.append(seen(LineString(line)).buffer(MARK_MM))
    wanted = [(c.designator, seen(c.body)) for c in parts if c.kind in ("led", "resistor")]
    for part in board.components:
        if part.kind == "connector" and part.side == side:
            wanted.append((part.designator, seen(part.body).boundary))
        if part.kind in ("connector", "wire") and (part.side == side or part.kind == "connector"):
            wanted += [(pad.net, seen(pad.shape)) for pad in part.pads]
    _labels(axis, wanted, covered, seen(board.outline), points)
    low_x, low_y, high_x, high_y = seen(board.outline).bounds
    axis.set_xlim(low_x - room, high_x + room)
    axis.set_ylim(low_y - room, high_y + room)
    axis.set_aspect("equal")
    axis.tick_params(labelsize=6, colors=INK, length=2)
    if mirror:  # x stays that of the files
        axis.xaxis.set_major_formatter(lambda x, _: f"{-x + 0.0:g}")
    for spine in axis.spines.values():
        spine.set_visible(False)
    axis.set_title("front, LED side" if layer == 0 else "back, seen from behind", fontsize=8, color=INK)


def _led(axis: "Axes", led: Component, colours: Sequence[Colour]) -> None:
    held = [colours[group] for group in led.groups]
    mean = tuple(sum(colour[k] for colour in held) / len(held) for k in range(3))
    _fill(axis, led.body, mean, 5, alpha=0.8)
    (x0, y0), (x1, y1) = led.mark
    axis.plot([x0, x1], [y0, y1], color="white", linewidth=1.6, solid_capstyle="butt", zorder=6)


def _labels(
    axis: "Axes", wanted: Sequence[tuple[str, Polygon]], covered: Sequence[Any], outline: Any, points: float
) -> None:
    """Write texts beside their shapes where they cover nothing, with a line between."""
    taken = [*covered, *(shape for _, shape in wanted)]
    for text, shape in wanted:
        half = 0.36 * LETTER_MM * len(text) + 0.1, 0.6 * LETTER_MM
        x, y = _free_spot(shape.centroid.x, shape.centroid.y, half, taken)
        place = box(x - half[0], y - half[1], x + half[0], y + half[1])
        taken.append(place)
        inside = outline.contains(place)
        start, end = nearest_points(shape, place)
        axis.plot([start.x, end.x], [start.y, end.y], color="#9aa3ad", linewidth=0.5, zorder=7)
        axis.text(
            x, y, text, fontsize=points, color="white" if inside else INK, ha="center", va="center", zorder=9
        )


def _free_spot(x: float, y: float, half: tuple[float, float], taken: Sequence[Any]) -> tuple[float, float]:
    """Nearest place for a text that covers nothing, out to where there is nothing."""
    for ring in range(2, 120):
        radius = 0.2 * ring
        for step in range(24):
            angle = math.tau * step / 24 + math.pi / 2
            at = x + radius * math.cos(angle), y + radius * math.sin(angle)
            text = box(at[0] - half[0], at[1] - half[1], at[0] + half[0], at[1] + half[1])
            if not any(text.intersects(shape) for shape in taken):
                return at
    return x, y


def _fill(axis: "Axes", shape: Any, colour: Any, order: int, *, alpha: float = 1.0) -> None:
    """Fill a polygon, its holes left open."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    for polygon in getattr(shape, "geoms", [shape]):
        rings = [polygon.exterior, *polygon.interiors]
        path = Outline.make_compound_path(*(Outline(list(ring.coords), closed=True) for ring in rings))
        axis.add_patch(PathPatch(path, facecolor=colour, edgecolor="none", alpha=alpha, zorder=order))


def _disc(x: float, y: float, radius: float, colour: str, order: int) -> Any:
    from matplotlib.patches import Circle

    return Circle((x, y), radius, facecolor=colour, edgecolor="none", zorder=order)
