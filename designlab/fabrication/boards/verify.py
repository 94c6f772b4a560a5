"""Checks of a drawn board: every net in one piece, nets apart, copper off the edge, parts of one net list."""

from typing import Any

import shapely
from shapely.geometry import Point

from designlab.fabrication.boards.drawn import Board
from designlab.fabrication.boards.stock import CLEARANCE_MM, EDGE_MM

NEAR_MM = 1e-4
"""What rounding in files takes."""


def least_clearance_mm(board: Board) -> float:
    """Least distance of copper of two nets, on either layer (mm)."""
    least = float("inf")
    for layer in (0, 1):
        shapes = list(board.copper(layer).values())
        tree = shapely.STRtree(shapes)
        for index, shape in enumerate(shapes):
            near = [n for n in tree.query(shape.buffer(1.0)) if n > index]
            least = min([least, *(float(shape.distance(shapes[n])) for n in near)])
    return least


def pieces(board: Board) -> dict[str, int]:
    """In how many pieces each net's copper lies; vias and drilled pads join the layers."""
    found = {}
    layers = [board.copper(layer) for layer in (0, 1)]
    for net in {*layers[0], *layers[1]}:
        parts: list[Any] = []
        for layer in layers:
            if net in layer:
                parts.append(list(getattr(layer[net], "geoms", [layer[net]])))
        groups = [[(k, n)] for k, each in enumerate(parts) for n in range(len(each))]
        joints = [Point(via.x, via.y) for via in board.vias if via.net == net]
        joints += [Point(pad.x, pad.y) for pad in board.pads if pad.net == net and pad.drill_mm]
        for joint in joints:
            touched = [g for g in groups if any(parts[k][n].intersects(joint) for k, n in g)]
            joined = [each for group in touched for each in group]
            groups = [g for g in groups if g not in touched] + [joined]
        found[net] = len(groups)
    return found


def least_edge_mm(board: Board) -> float:
    """Least distance of copper to the outline and to holes without copper (mm)."""
    edge = board.outline.boundary
    holes = [Point(x, y).buffer(d / 2) for x, y, d in board.holes]
    copper = [shape for layer in (0, 1) for shape in board.copper(layer).values()]
    return min(float(shape.distance(other)) for shape in copper for other in [edge, *holes])


def figures(board: Board) -> list[tuple[str, float, float, str, bool]]:
    """Checks as (name, value, bound, unit, passed)."""
    clearance, edge = least_clearance_mm(board), least_edge_mm(board)
    broken = sum(1 for count in pieces(board).values() if count != 1)
    return [
        ("nets in pieces", broken, 0, "1", broken == 0),
        ("clearance", clearance, CLEARANCE_MM, "mm", clearance >= CLEARANCE_MM - NEAR_MM),
        ("copper to edge", edge, EDGE_MM, "mm", edge >= EDGE_MM - NEAR_MM),
    ]
