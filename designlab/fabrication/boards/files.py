"""Files to order the boards of a design: for each its Gerber ZIP, tables, specification and picture."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from designlab.fabrication.boards import orders, verify
from designlab.fabrication.boards.circuit import Channel
from designlab.fabrication.boards.drawn import Board
from designlab.fabrication.boards.gerber import outline_read, write_gerbers
from designlab.fabrication.boards.picture import Colour, write_picture
from designlab.fabrication.checks import FileCheck

FOLDER = "boards"
READ_MM = 1e-3
"""Largest difference of an outline as read again."""


def write_board(
    board: Board, folder: Path, *, channels: Sequence[Channel], colours: Sequence[Colour], project: str
) -> tuple[dict[str, Any], list[FileCheck]]:
    """Write the files of one board into the export's folder ``boards``.

    Parameters
    ----------
    board : Board
        The board.
    folder : Path
        Folder of the export.
    channels : sequence of Channel
        Drive of each LED group.
    colours : sequence of (float, float, float)
        Display colour of each group (sRGB, 0..1).
    project : str
        Name of the design.

    Returns
    -------
    described : dict
        Figures for the manifest.
    checks : list of FileCheck
        Nets, clearances and the outline as read again.
    """
    out = folder / FOLDER
    out.mkdir(exist_ok=True)
    package = out / f"{board.name}-gerbers.zip"
    write_gerbers(board, package, project=project)
    _table(orders.bill_rows(board), out / f"{board.name}-bom.csv")
    _table(orders.placement_rows(board), out / f"{board.name}-cpl.csv")
    _table(orders.net_rows(board), out / f"{board.name}-nets.csv")
    text = orders.specification(board, channels)
    (out / f"{board.name}-specification.txt").write_text(text, encoding="utf-8")
    title = f"{project}: {board.name}"
    write_picture(board, out / f"{board.name}.png", colours=colours, title=title)
    off = max(
        abs(read - drawn) for read, drawn in zip(outline_read(package), board.outline.bounds, strict=True)
    )
    checks = [FileCheck(board.name, package.name, "outline", off, READ_MM, "mm", off <= READ_MM)]
    checks += [
        FileCheck(board.name, package.name, name, value, bound, unit, passed)
        for name, value, bound, unit, passed in verify.figures(board)
    ]
    return describe(board, channels), checks


def describe(board: Board, channels: Sequence[Channel]) -> dict[str, Any]:
    """Figures of a board for the manifest; its frame places it in the sensor."""
    groups = sorted({group for place in board.blank.places for group in place.groups})
    frame = board.blank.frames[0]
    axes = {"origin_mm": frame.origin, "x": frame.x, "y": frame.y, "normal": frame.normal}
    return {
        "name": board.name,
        "kind": board.blank.kind,
        "size_mm": [round(side, 4) for side in board.size_mm],
        "thickness_mm": board.thickness_mm,
        "led_height_mm": board.blank.led_mm,
        "leds": len(board.blank.places),
        "groups": [channels[group].group.name for group in groups],
        "connector": list(board.pins),
        "mounting_holes": len(board.holes),
        "frame": {name: [round(float(c), 6) + 0.0 for c in axis] for name, axis in axes.items()},
    }


def bill_row(board: Board) -> dict[str, Any]:
    """Row of the sensor's bill of materials for a board."""
    width, height = board.size_mm
    return {
        "item": board.name,
        "count": 1,
        "material": f"circuit board, {width:.4g} x {height:.4g} x {board.thickness_mm:g} mm",
        "volume_ml": None,
        "mass_g": None,
        "note": f"{FOLDER}/{board.name}-gerbers.zip; parts on it in {FOLDER}/{board.name}-bom.csv",
    }


def _table(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
