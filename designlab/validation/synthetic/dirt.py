"""Dirt is what every sensor in a lab has and no drawing shows: small departures everywhere, all at once.

Sets without it differ from their model by one effect and one or two small departures alone; no real sensor is
so clean. None of this is written a second time anywhere else: the catalogue has no form of it.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.validation.synthetic.generator_sensor import Rectangles, Rig

Values = dict[str, Any]
Range = tuple[float, float]

LIGHT_RMS: Range = (0.01, 0.05)  # smooth departure of each group's light over the gel, relative
LIGHT_WAVES = 6  # that such a departure is made of
LIGHT_WAVELENGTH: Range = (0.7, 2.5)  # of these, over the width of the sensing area
GRAIN_RMS: Range = (0.003, 0.02)  # of single frames, relative
GRAIN_PX: Range = (0.0, 1.5)  # standard deviation of the blur that grain went through
SAMPLING_RMS: Range = (0.002, 0.006)  # noise of a second renderer at the mean light, relative
BOARD_SIZE, BOARD_REFLECTANCE = 0.25, 0.3  # largest relative departures of each board and each colour
WALL_MM: Range = (1.0, 4.0)  # height of the wall of the housing above each board
PACKAGE_MM = 1.5  # pitch of the LEDs of a strip
LIT: Range = (0.4, 0.8)  # share of a strip that shines
EDGE_MM: Range = (0.01, 0.04)  # rounding of printed edges
READ_OFF = {"depth_mm": 0.04, "centre_mm": 0.1, "yaw_deg": 1.5}
"""Standard deviations of poses that are read off the picture."""


def add_dirt(rig: Rig, *, random: np.random.Generator) -> tuple[Rig, Values]:
    """Put a lab's dirt into a sensor in air: all kinds of it, in sizes drawn between the least and the most.

    Parameters
    ----------
    rig : Rig
        The sensor, effects and other departures in it.
    random : Generator
        Source of sizes and shapes.

    Returns
    -------
    Rig, dict
        The changed sensor, and what each kind was drawn to be.

    Raises
    ------
    ValueError
        If light reaches the gel through a core.
    """
    if rig.glass is not None:
        raise ValueError("dirt: optics.light_path must be 'air', is 'core'")
    rms = _drawn(LIGHT_RMS, random)
    lit = _drawn(LIT, random)
    edge_mm = _drawn(EDGE_MM, random)
    sizes = 1 + random.uniform(-BOARD_SIZE, BOARD_SIZE, (len(rig.boards.half), 2))
    reflects = 1 + random.uniform(-BOARD_REFLECTANCE, BOARD_REFLECTANCE, len(rig.board_reflectance))
    wall_mm = _drawn(WALL_MM, random)
    grain: Values = {
        "grain_rms": _drawn(GRAIN_RMS, random),
        "grain_px": float(random.uniform(*GRAIN_PX)),
        "sampling_rms": _drawn(SAMPLING_RMS, random),
    }
    strips, pieces = _with_gaps(rig.emitters, lit)
    changed = replace(
        rig,
        light_waves=_light_waves(rig, rms, random),
        emitters=strips,
        face_flux=np.repeat(rig.face_flux, pieces),
        carrier=np.repeat(rig.carrier, pieces),
        boards=_with_walls(rig.boards._replace(half=rig.boards.half * sizes), wall_mm),
        board_reflectance=np.clip(rig.board_reflectance * reflects, 0.0, 1.0),
        contact=replace(rig.contact, edge_mm=rig.contact.edge_mm + edge_mm),
        sensor=replace(rig.sensor, **grain),
    )
    return changed, {
        "light_rms": rms,
        "lit_share": lit,
        "edge_mm": edge_mm,
        "board_sizes": sizes.tolist(),
        "board_reflectance": reflects.tolist(),
        "wall_mm": wall_mm,
        **grain,
    }


def _drawn(range_: Range, random: np.random.Generator) -> float:
    """Size between the least and the most, evenly in its logarithm."""
    return float(np.exp(random.uniform(*np.log(range_))))


def _light_waves(rig: Rig, rms: float, random: np.random.Generator) -> Array:
    """Waves of each group's light: rows of wave numbers (x, y; 1/mm), amplitude and phase."""
    shape = len(rig.flux_mw), LIGHT_WAVES
    length_mm = rig.sensing_area_mm[0] * random.uniform(*LIGHT_WAVELENGTH, shape)
    number = 2 * np.pi / length_mm * np.exp(1j * random.uniform(0, 2 * np.pi, shape))
    amplitude = np.full(shape, rms / np.sqrt(LIGHT_WAVES / 2))
    return np.stack([number.real, number.imag, amplitude, random.uniform(0, 2 * np.pi, shape)], axis=-1)


def _with_gaps(strips: Rectangles, lit: float) -> tuple[Rectangles, NDArray[np.int64]]:
    """Cut strips into LEDs with gaps between, and how many of each: they send the light of the whole."""
    counts = np.maximum(np.round(2 * strips.half[:, 0] / PACKAGE_MM).astype(int), 1)
    centre, half = [], []
    for middle, across, (width, height), count in zip(
        strips.centre, strips.across, strips.half, counts, strict=True
    ):
        place = (2 * np.arange(count) + 1 - count) / count * width
        centre.append(middle + place[:, None] * across)
        half.append(np.broadcast_to([lit * width / count, height], (count, 2)))
    cut = Rectangles(
        group=np.repeat(strips.group, counts),
        centre=np.concatenate(centre),
        normal=np.repeat(strips.normal, counts, axis=0),
        across=np.repeat(strips.across, counts, axis=0),
        down=np.repeat(strips.down, counts, axis=0),
        half=np.concatenate(half),
    )
    return cut, counts


def _with_walls(boards: Rectangles, wall_mm: float) -> Rectangles:
    """Boards, and above each as much of the housing's wall, of the same colour."""
    above = boards.half[:, 1:] + wall_mm / 2
    half = np.column_stack([boards.half[:, 0], np.full(len(boards.half), wall_mm / 2)])
    walls = boards._replace(centre=boards.centre - above * boards.down, half=half)
    return Rectangles(*(np.concatenate(parts) for parts in zip(boards, walls, strict=True)))
