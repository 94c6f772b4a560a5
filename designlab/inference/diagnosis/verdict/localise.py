"""Localisation shares the excess between model and measurement among regions known from geometry.

Regions are named as someone at the bench would: by the imprint, by the LEDs that a camera channel answers to,
and by the edge of the picture.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.render_cache import Renders
from designlab.inference.diagnosis.emulator.snapshots import moved
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.result import Where
from designlab.sensor.design import CHANNELS, Design
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Frame

WALL_SLOPE = 0.15
RIM_MM = 0.5
AROUND_MM = 2.0
LEAST_SHARE = 0.005
FACING = 0.5  # cosine between a wall's downhill direction and the way to the LEDs
CORNER = 0.8  # of the way from the middle of the picture to its corner


def localise(fitter: Fitter, renders: Renders, state: State, shots: Sequence[int]) -> tuple[Where, ...]:
    """Share of the excess over noise and granted errors in each region and channel, largest first.

    Parameters
    ----------
    state : State
        With registered poses.
    shots : sequence of int
        Shots to look at.
    """
    # Of each region, channel and kind of frame: excess, sum of residuals, number of values.
    sums: dict[tuple[str, str, str], Array] = {}
    for number in shots:
        shot, noise = fitter.bank.shots[number], fitter.noises[number]
        predicted = fitter.forward.predict(state, number)
        residual = np.where(shot.valid, (shot.signal - predicted) / noise.sigma, 0.0)
        touched = "background" if shot.press is None else "press"
        frames = touched if shot.lit.any() else "dark"
        frame = geometry(fitter, renders, state, number)
        for channel, name in enumerate(CHANNELS):
            used = shot.valid[..., channel]
            for region, place in regions(frame, fitter.forward.design, channel).items():
                z = residual[..., channel][place & used]
                granted = (noise.granted / noise.sigma)[..., channel][place & used]
                key = (region, name, frames)
                here = np.array([(z**2 - granted**2).sum(), z.sum(), z.size])
                sums[key] = sums.get(key, 0.0) + here
    totals: dict[tuple[str, str, str], list[float]] = {key: own.tolist() for key, own in sums.items()}
    total = sum(max(excess, 0.0) for excess, _, _ in totals.values())
    compared = sum(size for _, _, size in totals.values())
    if total <= 0:
        return ()
    found = []
    for key, (excess, signed, size) in totals.items():
        if excess / total < LEAST_SHARE:
            continue
        alike = [own for other, own in totals.items() if other[1:] == key[1:]]
        mean = sum(max(own[0], 0.0) for own in alike) / sum(own[2] for own in alike)
        found.append(Where(*key, excess / total, size / compared, excess / size / mean, signed / size))
    return tuple(sorted(found, key=lambda place: -place.share))


def regions(frame: Frame, design: Design, channel: int) -> dict[str, NDArray[np.bool_]]:
    """Regions of a picture as one channel sees it; every pixel lies in exactly one.

    Walls of an imprint are lit or unlit by the LED group that the channel answers to most.
    """
    own = design.leds.groups[int(np.abs(design.mixing_matrix[channel]).argmax())]
    azimuth = np.radians(own.azimuth_deg)
    towards = np.stack([np.cos(azimuth), np.sin(azimuth)])
    x, y = frame.seen_mm
    near = np.max(x[..., None] * towards[0] + y[..., None] * towards[1], axis=-1)
    low, high = np.quantile(near, (0.2, 0.8))
    p, q = frame.gradient
    slope = np.hypot(p, q)
    facing = np.max(-(p[..., None] * towards[0] + q[..., None] * towards[1]), axis=-1) / np.maximum(
        slope, 1e-9
    )
    wall = slope > WALL_SLOPE
    away_mm = _distance_mm(frame)
    far = np.hypot(x - x.mean(), y - y.mean())
    candidates = {
        f"slope of the imprint that faces the {own.name} LEDs": wall & (facing > FACING),
        f"slope of the imprint that faces away from the {own.name} LEDs": wall & (facing < -FACING),
        f"slope of the imprint sideways to the {own.name} LEDs": wall,
        "flat part of the imprint": frame.contact,
        "rim of the imprint, up to 0.5 mm outside": away_mm <= RIM_MM,
        "around the imprint, 0.5 to 2 mm outside": away_mm <= AROUND_MM,
        "corners of the picture": far > CORNER * far.max(),
        f"gel next to the {own.name} LEDs": near >= high,
        f"gel far from the {own.name} LEDs": near <= low,
        "rest of the gel": np.ones(near.shape, dtype=bool),
    }
    taken = np.zeros(near.shape, dtype=bool)
    atlas = {}
    for name, place in candidates.items():
        atlas[name] = place & ~taken
        taken |= place
    return atlas


def geometry(fitter: Fitter, renders: Renders, state: State, number: int) -> Frame:
    """What every pixel of a shot sees; its picture is not rendered."""
    shot = fitter.bank.shots[number]
    simulator = renders.simulator(fitter.bank.model, shot.view)
    press: Press | None = None if shot.press is None else moved(shot.press, state.pose(number))
    design = simulator.design
    flux = np.array([group.flux_mw for group in design.leds.groups])
    empty = np.zeros((len(flux), shot.view.rows, shot.view.columns), dtype=np.float32)
    return Frame(press, simulator.surface(press), simulator.rays, empty, design.mixing_matrix * flux)


def _distance_mm(frame: Frame) -> Array:
    """Distance of every pixel from the contact; infinite without one."""
    from scipy.ndimage import distance_transform_edt

    if not frame.contact.any():
        return np.full(frame.contact.shape, np.inf)
    pitch = np.abs(np.diff(frame.rays.y_mm, axis=0)).mean(), np.abs(np.diff(frame.rays.x_mm, axis=1)).mean()
    return np.asarray(distance_transform_edt(~frame.contact, sampling=pitch))
