"""Localisation shares the excess between model and measurement among regions known from geometry."""

from collections.abc import Sequence

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.rendering import moved
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.result import Where
from designlab.measurement.regions import regions
from designlab.sensor.design import CHANNELS
from designlab.simulation.contact.press import Press
from designlab.simulation.render_cache import Renders
from designlab.simulation.simulator import Frame

LEAST_SHARE = 0.005


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


def geometry(fitter: Fitter, renders: Renders, state: State, number: int) -> Frame:
    """What every pixel of a shot sees; its picture is not rendered."""
    shot = fitter.bank.shots[number]
    simulator = renders.simulator(fitter.bank.model, shot.view)
    press: Press | None = None if shot.press is None else moved(shot.press, state.pose(number))
    design = simulator.design
    empty = np.zeros((len(design.leds.groups), shot.view.rows, shot.view.columns), dtype=np.float32)
    return Frame(press, simulator.surface(press), simulator.rays, empty, design.transfer_mw)
