"""Seats of a design: what stands inside its housing, where its camera board lies, and the tables of both."""

from functools import cache
from typing import Any

from designlab.sensor.data import table
from designlab.sensor.parts import Parts
from geometries.camera_head import CameraBoard, Fastener, Mount
from geometries.seats import Inside
from geometries.seats import inside as _inside

SCREW = "M2"


def _entries(name: str) -> dict[str, Any]:
    """Entries of a table by name, lists as tuples."""
    return {
        key: {field: _frozen(value) for field, value in entry.items()} for key, entry in table(name).items()
    }


def _frozen(value: object) -> object:
    return tuple(map(_frozen, value)) if isinstance(value, list) else value


@cache
def camera_modules() -> dict[str, CameraBoard]:
    """Camera boards by name."""
    return {name: CameraBoard(name, **entry) for name, entry in _entries("camera_modules").items()}


@cache
def fastener() -> Fastener:
    """Screw and insert that hold lid and camera."""
    return Fastener(**_entries("fasteners")[SCREW])


def camera_board(name: str) -> CameraBoard:
    """Camera board by name.

    Raises
    ------
    ValueError
        If the table has none of that name; lists those it has.
    """
    if name not in camera_modules():
        raise ValueError(
            f"no camera board of that name, got {name!r}; known are {', '.join(camera_modules())}"
        )
    return camera_modules()[name]


def inside(design: Parts) -> Inside | None:
    """What stands inside the housing, LED boards' seats apart; None where it has no seats."""
    if design.housing.seats is None:
        return None
    window_mm = design.elastomer.thickness_mm + design.gelcore.height_mm
    return _inside(design.housing, design.gelcore, design.leds, window_mm=window_mm)


def mount(design: Parts) -> Mount:
    """Camera board at the place where its entrance pupil is the design's camera."""
    seats = design.housing.seats
    assert seats is not None
    board = camera_board(seats.camera)
    x, y, z = design.camera.position_mm
    return Mount(x, y, z + board.pupil_mm, board, fastener())


def assumed_figures(design: Parts) -> list[str]:
    """Figures of the tables that a housing with seats is fitted to and no source states."""
    if design.housing.seats is None:
        return []
    board, screw = camera_board(design.housing.seats.camera), fastener()
    found = [f"camera {board.name}: {figure}" for figure in board.assumed]
    return [*found, *(f"{screw.title}: {figure}" for figure in screw.assumed)]
