"""A board as its maker reads it: Gerber X2 layers and Excellon drills in one ZIP, written by gerbonara."""

import math
import zipfile
from collections.abc import Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

from shapely.geometry import Point

from designlab.core.backend import installed_version
from designlab.fabrication.boards.drawn import MARK_MM, Board, Line, Pad
from designlab.fabrication.boards.layout import SUPPLY_NET
from designlab.fabrication.boards.stock import EDGE_MM, TRACK_MM, VIA_DRILL_MM, VIA_MM

MASK_MM = 0.05
"""By which the mask's opening is larger than its pad, on each side."""
LINE_MM = 0.1
"""Width of the outline's and the legend's lines."""
PLUS_MM = 0.6
"""Size of the mark beside the supply's pad."""
LAYERS = {
    "F_Cu.gtl": ("Copper,L1,Top", "Positive"),
    "B_Cu.gbl": ("Copper,L2,Bot", "Positive"),
    "F_Mask.gts": ("Soldermask,Top", "Negative"),
    "B_Mask.gbs": ("Soldermask,Bot", "Negative"),
    "F_Paste.gtp": ("Paste,Top", "Positive"),
    "B_Paste.gbp": ("Paste,Bot", "Positive"),
    "F_Silkscreen.gto": ("Legend,Top", "Positive"),
    "B_Silkscreen.gbo": ("Legend,Bot", "Positive"),
    "Edge_Cuts.gm1": ("Profile,NP", "Positive"),
}
"""Layers by the end of their file's name, with file function and polarity (Gerber X2)."""
DRILLS = {"PTH.drl": True, "NPTH.drl": False}
"""Drill files by the end of their name: whether their holes are plated."""


def plus_mark(board: Board) -> tuple[Line, Line] | None:
    """Two crossed lines on the back beside the supply's pad; None where nothing is free there."""
    pads = [pad for pad in board.pads if 1 in pad.layers]
    supply = [p for c in board.components if c.kind in ("connector", "wire") for p in c.pads]
    supply = [pad for pad in supply if pad.net == SUPPLY_NET and pad in pads]
    covered = [pad.shape for pad in pads] + [via.shape for via in board.vias]
    covered += [Point(x, y).buffer(d / 2) for x, y, d in board.holes]
    inner = board.outline.buffer(-EDGE_MM)
    for pad in supply:
        for distance in (1.0, 1.2, 1.5):
            for step in range(16):
                angle = math.radians(pad.turn_deg) + math.tau * step / 16
                x, y = pad.x + distance * math.cos(angle), pad.y + distance * math.sin(angle)
                spot = Point(x, y).buffer(PLUS_MM / 2 + MARK_MM)
                if inner.contains(spot) and not any(spot.intersects(shape) for shape in covered):
                    half = PLUS_MM / 2
                    return ((x - half, y), (x + half, y)), ((x, y - half), (x, y + half))
    return None


def write_gerbers(board: Board, path: Path, *, project: str) -> None:
    """Write all layers and drills of a board into one ZIP; all share one origin and are in mm."""
    files = {f"{board.name}-{end}": _layer(board, end, project) for end in LAYERS}
    files |= {f"{board.name}-{end}": _drills(board, plated=plated) for end, plated in DRILLS.items()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as package:
        for name, content in files.items():
            # A fixed date keeps equal boards equal, byte for byte.
            package.writestr(zipfile.ZipInfo(name), content, compress_type=zipfile.ZIP_DEFLATED)


def outline_read(path: Path) -> tuple[float, float, float, float]:
    """Read a ZIP's outline again: its bounds (mm), at the middle of its lines."""
    from gerbonara.rs274x import GerberFile
    from gerbonara.utils import MM

    with zipfile.ZipFile(path) as package:
        name = next(n for n in package.namelist() if n.endswith("Edge_Cuts.gm1"))
        layer = GerberFile.from_string(package.read(name).decode())
    (low_x, low_y), (high_x, high_y) = layer.bounding_box(unit=MM)
    half = LINE_MM / 2
    return low_x + half, low_y + half, high_x - half, high_y - half


def _layer(board: Board, end: str, project: str) -> bytes:
    from gerbonara.cam import FileSettings
    from gerbonara.rs274x import GerberFile

    function, polarity = LAYERS[end]
    side = 0 if end.startswith("F_") else 1
    if "_Cu." in end:
        objects = _copper(board, side)
    elif "_Mask" in end:
        objects = [_flash(pad, MASK_MM) for pad in board.pads if side in pad.layers]
    elif "_Paste" in end:
        objects = [
            _flash(pad, 0.0)
            for component in board.components
            if component.kind in ("led", "resistor")
            for pad in component.pads
            if side in pad.layers
        ]
    elif "_Silk" in end:
        cathodes = [c.mark for c in board.components if c.kind == "led"]
        objects = _lines(cathodes if side == 0 else plus_mark(board) or (), MARK_MM)
    else:
        rings = [board.outline.exterior, *board.outline.interiors]
        edges = [list(ring.coords) for ring in rings]
        objects = [line for edge in edges for line in _lines(pairwise(edge), LINE_MM)]
    layer = GerberFile(objects=objects)
    layer.file_attrs = {
        ".GenerationSoftware": ("designlab", "designlab", installed_version("designlab")),
        ".ProjectId": (_plain(project), "0", "1"),
        ".SameCoordinates": (_plain(board.name),),
        ".FileFunction": tuple(function.split(",")),
        ".FilePolarity": (polarity,),
    }
    content = layer.write_to_bytes(FileSettings(unit=_mm(), number_format=(4, 6), zeros=None))
    # gerbonara 1.5 leaves out the end of this one command, and strict readers stop there.
    return bytes(content).replace(b"\nG75\n", b"\nG75*\n") + b"\n"


def _copper(board: Board, layer: int) -> list[Any]:
    from gerbonara.apertures import CircleAperture
    from gerbonara.graphic_objects import Flash

    objects = [_flash(pad, 0.0) for pad in board.pads if layer in pad.layers]
    ring = CircleAperture(VIA_MM, unit=_mm())
    objects += [Flash(via.x, via.y, aperture=ring, unit=_mm()) for via in board.vias]
    for track in board.tracks:
        if track.layer == layer:
            objects += _lines(pairwise(track.points), TRACK_MM)
    return objects


def _flash(pad: Pad, wider_mm: float) -> Any:
    from gerbonara.apertures import RectangleAperture
    from gerbonara.graphic_objects import Flash

    flat = RectangleAperture(pad.width + 2 * wider_mm, pad.height + 2 * wider_mm, unit=_mm())
    turned = flat.rotated(-math.radians(round(pad.turn_deg, 6)))  # gerbonara turns clockwise
    return Flash(pad.x, pad.y, aperture=turned, unit=_mm())


def _lines(pairs: Iterable[Any], width_mm: float) -> list[Any]:
    from gerbonara.apertures import CircleAperture
    from gerbonara.graphic_objects import Line as Stroke

    pen = CircleAperture(width_mm, unit=_mm())
    return [Stroke(*start, *end, aperture=pen, unit=_mm()) for start, end in pairs]


def _drills(board: Board, *, plated: bool) -> bytes:
    from gerbonara.apertures import ExcellonTool
    from gerbonara.excellon import ExcellonFile
    from gerbonara.graphic_objects import Flash

    if plated:
        holes = [(via.x, via.y, VIA_DRILL_MM) for via in board.vias]
        holes += [(pad.x, pad.y, pad.drill_mm) for pad in board.pads if pad.drill_mm]
    else:
        holes = list(board.holes)
    tools = {d: ExcellonTool(d, plated=plated, unit=_mm()) for d in sorted({d for _, _, d in holes})}
    objects = [Flash(x, y, aperture=tools[d], unit=_mm()) for x, y, d in holes]
    return bytes(ExcellonFile(objects=objects).write_to_bytes()) + b"\n"


def _mm() -> Any:
    from gerbonara.utils import MM

    return MM


def _plain(text: str) -> str:
    """Text without the signs that end a Gerber attribute."""
    return "".join("_" if sign in "*%,\\" or not sign.isprintable() else sign for sign in text)
