"""A suspicion names a usual fault of pictures that a model explains clearly better once it is undone.

Light powers are free in all comparisons, and so are the factors of channels: they say nothing about a fault.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from designlab.core.types import Array, Mask
from designlab.measurement.quality.additivity import Curve, nonlinear, other_curves
from designlab.measurement.quality.suspicion import Suspicion
from designlab.measurement.quality.turns import TURNS, UPRIGHT
from designlab.measurement.shots import Shot, binned
from designlab.measurement.transfer import (
    MODEL_ERROR,
    normal_equations,
    predicted,
    solved,
    transfer_and_floor,
)
from designlab.sensor.design import CHANNELS

COLUMNS = 48  # faults are as large as the picture
# Misfits are root mean squares in units of the noise and 1 % of the mean signal together.
LEAST_MISFIT = 3.0  # below, there is nothing to explain
MOST_MISFIT = 15.0  # that a fault, once undone, may leave: as much as a model before its calibration
MOST_MISFIT_ALONE = 5.0  # the same of one picture, beside others that the model has to explain as well
BETTER = 2.0  # factor by which it must be better; models 20 % off in scale stayed below 1.2
ALIKE = 1.5  # factor within which the explanation with fewer faults is taken
FAR, NEAR = 0.7, 0.55  # distances of directions in colour space: of other colours, and of the same colour
DIM = 0.5  # of the brightest channel: crosstalk of usual filters reaches that far
FAINT = 0.1  # of the brightest: groups below say nothing about colour

ORDER = (0, 1, 2)


class Fault(NamedTuple):
    """What may have been done to all pictures of a set, and how it is undone."""

    turn: str = ""
    curve: Curve | None = None
    order: tuple[int, ...] = ORDER

    @property
    def parts(self) -> int:
        """Number of faults in one."""
        return (self.turn != "") + (self.curve is not None) + (self.order != ORDER)


@dataclass(frozen=True, eq=False)
class CoarseShot:
    """One shot, averaged to few columns, with the unit-power pictures of the model."""

    files: tuple[str, ...]
    basis: Array
    lit: Array
    signal: Array
    variance: Array
    valid: Mask

    def without(self, fault: Fault, black: Array) -> "CoarseShot":
        """Undo a fault."""
        order, undone = list(fault.order), TURNS[fault.turn].undone
        signal, variance, valid = (
            undone(values)[..., order] for values in (self.signal, self.variance, self.valid)
        )
        if fault.curve is not None:
            level = black[order]
            step = 1e-4
            slope = (fault.curve(signal + level + step) - fault.curve(signal + level)) / step
            signal = fault.curve(signal + level) - fault.curve(level)
            variance = variance * slope**2
        return replace(self, signal=signal, variance=variance, valid=valid)

    @property
    def equations(self) -> tuple[Array, Array]:
        """Normal equations of the light."""
        return normal_equations(self.basis, self.lit, self.signal, self.sigma, self.valid)

    @property
    def sigma(self) -> Array:
        """Noise, and what the simulation is not trusted with."""
        level = np.abs(self.signal.mean(axis=(0, 1)))
        return np.asarray(np.sqrt(self.variance + (MODEL_ERROR * level) ** 2) + 1e-12)


class FittedLight(NamedTuple):
    """Light fitted to pictures: `transfer` (3, groups), `floor` (3,), and what they miss it by."""

    misfit: float
    transfer: Array
    floor: Array


def faults(
    pictures: Sequence[CoarseShot], black: Array, transfer: Array, response: str
) -> tuple[Suspicion, ...]:
    """Name the faults of all pictures, else those of single ones."""
    pictures = [picture for picture in pictures if picture.valid.any()]
    if not pictures:
        return ()
    return _of_all(pictures, black, transfer, response) or _of_single(pictures, black, response)


def _of_all(
    pictures: Sequence[CoarseShot], black: Array, transfer: Array, response: str
) -> tuple[Suspicion, ...]:
    """Faults that all pictures share."""
    tried = {fault: fitted_light(pictures, fault, black) for fault in _shared(pictures, response)}
    declared = tried[Fault()]
    best = min(fit.misfit for fit in tried.values())
    chosen = min(
        (fault for fault, fit in tried.items() if fit.misfit <= ALIKE * best),
        key=lambda fault: (fault.parts, tried[fault].misfit),
    )
    if not _explains(tried[chosen].misfit, declared.misfit):
        chosen = Fault()
    order: tuple[int, ...] = ORDER
    mirror = None
    if tried[chosen].misfit <= MOST_MISFIT:
        order = _order(tried[chosen].transfer, transfer)
    if order != ORDER:
        # Where the lamps stand symmetrically, a mirrored picture looks like one with swapped channels.
        mirrors = [
            fault
            for fault, fit in tried.items()
            if fault.turn not in ("", chosen.turn)
            and fault.curve == chosen.curve
            and fit.misfit <= ALIKE * tried[chosen].misfit
            and _distance(fit.transfer, transfer) < NEAR
        ]
        mirror = min(mirrors, key=lambda fault: tried[fault].misfit, default=None)
        if mirror is not None and BETTER * tried[mirror].misfit < tried[chosen].misfit:
            chosen = mirror
        else:
            chosen = chosen._replace(order=order)
    return _named(chosen, pictures, declared.misfit, tried, response, mirror)


def _of_single(pictures: Sequence[CoarseShot], black: Array, response: str) -> tuple[Suspicion, ...]:
    """Faults of single pictures, with the light that the others tell."""
    found: list[Suspicion] = []
    for picture, light in zip(pictures, lights_of_others(pictures), strict=True):
        if light is None or light.misfit > MOST_MISFIT_ALONE:
            continue
        declared = misfit(picture, light)
        candidates = [*_shared([picture], response), *_orders(picture)]
        tried = {
            fault: misfit(picture.without(fault, black), light) for fault in candidates if fault.parts == 1
        }
        fault = min(tried, key=lambda each: tried[each])
        if _explains(tried[fault], declared) and tried[fault] < MOST_MISFIT_ALONE:
            fits = {fault: FittedLight(tried[fault], light.transfer, light.floor)}
            found += _named(fault, [picture], declared, fits, response, None)
    return tuple(found)


def _explains(misfit: float, declared: float) -> bool:
    return declared > LEAST_MISFIT and misfit < MOST_MISFIT and BETTER * misfit < declared


def _shared(pictures: Sequence[CoarseShot], response: str) -> Iterator[Fault]:
    """Faults to try: what turns and curves there are; the order of channels follows from the fit."""
    square = all(picture.signal.shape[0] == picture.signal.shape[1] for picture in pictures)
    for turn, curve in itertools.product(TURNS if square else UPRIGHT, (None, *other_curves(response))):
        yield Fault(turn, curve)


def _orders(picture: CoarseShot) -> Iterator[Fault]:
    """Orders of channels that one picture tells: dim channels hold what a model leaves out of bright ones."""
    level = picture.signal.mean(axis=(0, 1))
    for order in itertools.permutations(ORDER):
        moved = [channel for channel in ORDER if order[channel] != channel]
        if moved and level[moved].max() > DIM * level.max():
            yield Fault(order=order)


def fitted_light(pictures: Sequence[CoarseShot], fault: Fault, black: Array) -> FittedLight:
    """Fit the light to pictures with a fault undone."""
    undone = [picture.without(fault, black) for picture in pictures]
    fit = FittedLight(0.0, *transfer_and_floor(p.equations for p in undone))
    return fit._replace(misfit=_of_several(undone, fit))


def _of_several(pictures: Sequence[CoarseShot], light: FittedLight) -> float:
    """Root mean square of what light leaves of several pictures, over their standard deviations."""
    squares = [misfit(p, light) ** 2 * p.valid.sum() for p in pictures if p.valid.any()]
    return float(np.sqrt(np.sum(squares) / sum(p.valid.sum() for p in pictures)))


def lights_of_others(pictures: Sequence[CoarseShot]) -> list[FittedLight | None]:
    """For every picture the light that all others tell; None where they do not show one of its groups."""
    if not pictures:
        return []
    equations = [p.equations for p in pictures]
    matrix, right = (np.sum(parts, axis=0) for parts in zip(*equations, strict=True))
    shown = np.sum([p.lit > 0 for p in pictures], axis=0)
    found: list[FittedLight | None] = []
    for number, picture in enumerate(pictures):
        if len(pictures) < 2 or (shown[picture.lit > 0] < 2).any():
            found.append(None)
            continue
        light = FittedLight(0.0, *solved(matrix - equations[number][0], right - equations[number][1]))
        others = [p for place, p in enumerate(pictures) if place != number]
        found.append(light._replace(misfit=_of_several(others, light)))
    return found


def misfit(picture: CoarseShot, light: FittedLight) -> float:
    """Root mean square of what the model leaves of a picture, over its standard deviation."""
    left = picture.signal - predicted(light.transfer, light.floor, picture.lit, picture.basis)
    return float(np.sqrt(np.mean((left / picture.sigma)[picture.valid] ** 2)))


def _order(found: Array, expected: Array) -> tuple[int, ...]:
    """Order of the channels that brings the fitted transfer to the model's, where it is clearly another."""
    distance = {order: _distance(found[list(order)], expected) for order in itertools.permutations(ORDER)}
    best = min(distance, key=lambda order: distance[order])
    if distance[ORDER] > FAR and distance[best] < NEAR and BETTER * distance[best] < distance[ORDER]:
        return best
    return ORDER


def _distance(found: Array, expected: Array) -> float:
    """Root mean square distance of the groups' colours, each of unit length (2 ** 0.5: at right angles)."""
    norms = np.linalg.norm(found, axis=0), np.linalg.norm(expected, axis=0)
    seen = (norms[0] > 0) & (norms[1] > FAINT * norms[1].max())
    if not seen.any():
        return 0.0
    apart = found[:, seen] / norms[0][seen] - expected[:, seen] / norms[1][seen]
    return float(np.sqrt((apart**2).sum(axis=0).mean()))


def _named(
    fault: Fault,
    pictures: Sequence[CoarseShot],
    declared: float,
    tried: Mapping[Fault, FittedLight],
    response: str,
    mirror: Fault | None,
) -> tuple[Suspicion, ...]:
    """Say each part of a fault by name."""
    files = tuple(file for picture in pictures for file in picture.files)
    plain = fault if fault in tried else fault._replace(order=ORDER)
    evidence = (
        f"the model misses them by {declared:.3g} times noise and {MODEL_ERROR:.0%} of the mean as declared, "
        f"by {tried[plain].misfit:.2g} once that is undone"
    )
    found = []
    if fault.curve is not None:
        found.append(nonlinear(files, fault.curve, response, evidence))
    if fault.turn:
        found.append(
            Suspicion(
                "mirrored",
                files,
                evidence,
                f"the pictures are {TURNS[fault.turn].text} against the sensor frame (x right, y up) "
                "by a setting of camera or program, or the sensor's top was taken for its bottom",
                "undo it in the files, or turn the stated poses and the design's LED azimuths the same way",
            )
        )
    if fault.order != ORDER:
        held = "".join(CHANNELS[fault.order.index(channel)] for channel in ORDER)
        also = ""
        if mirror is not None:
            also = f"; or they are {TURNS[mirror.turn].text}, which off-centre presses would tell"
        if len(pictures) > 1:
            evidence = (
                "the fitted light of the LED groups has the model's colours once the channels are reordered, "
                "as declared it has not"
            )
        found.append(
            Suspicion(
                "channels",
                files,
                evidence,
                f"the files' channels hold {held} instead of RGB (OpenCV reads and writes BGR), or LED "
                f"groups stand in each other's place{also}",
                "write the files in the order red, green, blue, or exchange the groups' azimuths in the "
                "design",
            )
        )
    return tuple(found)


def coarse(shot: Shot, basis: Array) -> CoarseShot:
    """Average a shot, without the black level, and its unit-power pictures to few columns."""
    factor = max(1, -(-shot.signal.shape[1] // COLUMNS))
    signal, variance = binned(shot.signal, factor), binned(shot.variance, factor) / factor**2
    valid = binned(shot.valid.astype(float), factor) == 1.0
    unit = np.moveaxis(binned(np.moveaxis(basis, 0, -1), factor), -1, 0)
    return CoarseShot(shot.files, unit, shot.lit, signal, variance, valid)
