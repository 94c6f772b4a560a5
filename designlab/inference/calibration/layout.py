"""Where the LED groups of a sensor shine from, by its pictures: places are tried, the best is refined."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from designlab.core.fields import field_at
from designlab.core.progress import Work, silent
from designlab.core.types import Array, Progress
from designlab.inference.calibration.fields import LED_PLACE, LED_STEPS
from designlab.inference.calibration.imaging import Rendered
from designlab.inference.calibration.poses import posed
from designlab.inference.calibration.result import Calibration, FittedParameter
from designlab.inference.calibration.verdict import FitWord
from designlab.measurement import Measurement, MeasurementError
from designlab.measurement.shots import Shot, observe
from designlab.sensor.design import CHANNELS, Design

STEP_DEG = 15.0  # between azimuths that are tried
RISES_MM = (-3.0, 3.0)  # from the height drawn, tried where no azimuth fits at that height
FITS = 0.1  # rest of the pictures, as a share of their mean, up to which azimuths alone fit
# To either side of the best place, then of the best of those. A search by derivatives that begins a
# millimetre off can end there: an LED that rises past the edge of a core changes a picture by leaps.
FINE_DEG_MM = ((5.0, 1.5), (2.5, 0.75))
MOST_PLACES = 500_000  # of all groups together, which are compared at once
COLUMNS, SAMPLES = 48, 24
MOST_PRESSES = 3
FEWEST_BUILDABLE = 6  # azimuths; where fewer can be built, all are tried
MOST_GROUPS = 4  # whose azimuths are tried together
STRANGE = 4.0  # by which a misfit counts for more with each group that is not the strongest of its channel
CLEAR = 2.0  # light of a group over that of any other in a channel by the design, from which it is its own
TWO_SIDED = 1.96  # standard errors to the end of a 95 % interval
TELLING_DEG = 5.0  # standard error of an azimuth beyond which it is not told
# Interval to either side beyond which a value is not told.
TOLD = {("height_mm", "height", "mm"): 1.0, ("tilt_deg", "tilt", "deg"): 5.0}
MOVED_DEG = 10.0  # from which a group stands elsewhere than drawn
# Half an interval, at least, of what a fit left where it began: half a step of search or derivatives.
LEFT = {
    "azimuth_deg": FINE_DEG_MM[-1][0] / 2,
    "height_mm": FINE_DEG_MM[-1][1] / 2,
    "tilt_deg": LED_STEPS["tilt_deg"] / 2,
}


Move = tuple[float, float]
"""Angle by which a group is turned, deg, and height by which it is raised, mm."""


class GroupPlace(NamedTuple):
    """Where the light of a group comes from.

    Attributes
    ----------
    name : str
        The group.
    drawn_deg, found_deg : float
        Azimuth of its first row by the design and by the pictures, counter-clockwise from +x.
    worse : float
        Misfit of the best other azimuth over that of the best; little above 1 says that it is not told.
    """

    name: str
    drawn_deg: float
    found_deg: float
    worse: float

    @property
    def moved_deg(self) -> float:
        """How far it is from where it is drawn, -180 to 180."""
        return (self.found_deg - self.drawn_deg + 180.0) % 360.0 - 180.0


class LayoutFound(NamedTuple):
    """Where the groups shine from by their pictures.

    Attributes
    ----------
    design : Design
        With the groups there.
    places : tuple of GroupPlace
        Of each group.
    drawn : float
        Misfit of the groups where they are drawn over that of the best places.
    left : float
        What the best leave of the pictures, root mean square, as a share of each channel's mean.
    """

    design: Design
    places: tuple[GroupPlace, ...]
    drawn: float
    left: float


def search_layout(
    measurement: Measurement,
    design: Design,
    *,
    seed: int = 0,
    closely: bool = True,
    progress: Progress = silent,
) -> LayoutFound:
    """Try azimuths of all LED groups on a background and up to three presses, and heights where these fail.

    Every group is turned about the axis with all of its rows. Channels are sums of the light of all groups
    with factors that are nowhere negative, and a floor; for each combination of places these follow by
    least squares. Where no azimuths fit at the heights drawn, both are tried together: near the wall of a
    core, light from another height looks more like that from another side.

    Parameters
    ----------
    measurement : Measurement
        A background, a press or both.
    design : Design
        The sensor as drawn.
    seed : int
        Seed of the light transport.
    closely : bool
        Whether heights and places near the best azimuths are tried as well, as a fit needs for a start.
    progress : callable, optional
        Called with what is being done, and how much of everything is done in thousandths.

    Raises
    ------
    MeasurementError
        If no frame can be used, or the design has too many groups to try.
    """
    groups = len(design.leds.groups)
    if groups > MOST_GROUPS:
        raise MeasurementError(
            f"--layout: tries the azimuths of {MOST_GROUPS} LED groups at most, got {groups}"
        )
    seen = observe(posed(measurement, design, seed=seed).measurement, design, columns=COLUMNS)
    shots = [seen.shots[n] for n in seen.of("background")]
    shots += [seen.shots[n] for n in seen.of("train", "select", "final")][:MOST_PRESSES]
    turns = [(turn, 0.0) for turn in _turns(design)]
    raised = _raised(design, turns) if closely else []
    steps = {"trying azimuths": turns, "trying heights": raised}
    if closely:
        steps["trying places near the best"] = [move for fine in FINE_DEG_MM for move in _near(fine)]
    work = Work(progress, {name: float(len(moves) * len(shots)) for name, moves in steps.items()})
    tried = _Tried(design, shots, seed, work)
    work.begin("trying azimuths")
    moves, columns = turns, tried.columns([turns] * groups)
    misfit = tried.misfits(columns)
    if raised and tried.rest(misfit.min()) > FITS:
        work.begin("trying heights")
        columns = np.concatenate([columns, tried.columns([raised] * groups)], axis=1)
        moves, misfit = [*turns, *raised], tried.misfits(columns)
    best = np.unravel_index(int(misfit.argmin()), misfit.shape)
    drawn = float(misfit[(0,) * groups])
    apart = np.array([move[0] for move in moves])
    worse = []
    for group in range(groups):
        others = np.moveaxis(misfit, group, 0)[apart != apart[best[group]]]
        worse.append(float(others.min() / misfit[best]) if len(others) else np.inf)
    there, left = [moves[place] for place in best], float(misfit[best])
    if closely:
        work.begin("trying places near the best")
        for fine in FINE_DEG_MM:
            near = [_near(fine, move) for move in there]
            misfit = tried.misfits(tried.columns(near))
            least = np.unravel_index(int(misfit.argmin()), misfit.shape)
            there = [moves[place] for moves, place in zip(near, least, strict=True)]
            left = float(misfit[least])
    work.end()
    found = _moved(design, there)
    places = tuple(
        GroupPlace(spec.name, float(spec.azimuth_deg[0]), group.azimuth_deg[0], ratio)
        for spec, group, ratio in zip(design.leds.groups, found.leds.groups, worse, strict=True)
    )
    return LayoutFound(found, places, drawn / left, tried.rest(left))


def layout_fields(design: Design) -> tuple[Design, tuple[str, ...]]:
    """A design whose groups have heights and tilts of their own, and the paths that a fit frees.

    Groups of several rows keep the angles between them: only groups of a single row have a free azimuth.
    """
    changes: dict[str, float] = {}
    paths = []
    for number, group in enumerate(design.leds.groups):
        own = f"leds.groups.{number}"
        for name in ("height_mm", "tilt_deg"):
            value = getattr(group, name)
            changes[f"{own}.{name}"] = float(getattr(design.leds, name) if value is None else value)
            paths.append(f"{own}.{name}")
        if len(group.azimuth_deg) == 1:
            paths.append(f"{own}.azimuth_deg.0")
    return design.replace(changes), tuple(paths)


def as_searched(found: Calibration, start: Design) -> Calibration:
    """Widen intervals of places that a fit left where the search had put them.

    Such a value is told by the search alone: derivatives through noisy light did not move it, and what they
    say of its error is worth little.

    Parameters
    ----------
    found : Calibration
        A calibration whose `layout_fields` were free.
    start : Design
        Where it began.
    """
    parameters = []
    for parameter in found.parameters:
        place = re.fullmatch(LED_PLACE, parameter.name)
        if place and parameter.se is not None and parameter.value == field_at(start, parameter.name).value:
            parameter = replace(parameter, se=max(parameter.se, LEFT[place["name"]] / TWO_SIDED))
        parameters.append(parameter)
    return replace(found, parameters=tuple(parameters))


def layout_words(found: Calibration, drawn: Design, verdict: FitWord = "good") -> list[str]:
    """Sentences about where the groups stand, by a calibration whose `layout_fields` were free.

    Intervals are those of the model that was fitted: a doubtful fit tells places without them, a failed one
    tells nothing.
    """
    if verdict == "failed":
        return [
            f"LED group {group.name}: not told where it shines from, since the fit failed"
            for group in drawn.leds.groups
        ]
    parameters = {parameter.name: parameter for parameter in found.parameters}
    told = []
    for number, group in enumerate(drawn.leds.groups):
        azimuth = parameters.get(f"leds.groups.{number}.azimuth_deg.0")
        if azimuth is None:
            continue
        value = azimuth.value % 360.0
        if verdict == "doubtful":
            told.append(
                f"LED group {group.name} may shine from about {value:.0f} deg, drawn at "
                f"{group.azimuth_deg[0]:g} deg; how sure is not told, since the fit is doubtful"
            )
            continue
        if azimuth.se is None or azimuth.se > TELLING_DEG:
            told.append(f"LED group {group.name}: these pictures do not tell its azimuth")
            continue
        away = (value - group.azimuth_deg[0] + 180.0) % 360.0 - 180.0
        place = f"LED group {group.name} shines from {value:.0f} ± {TWO_SIDED * azimuth.se:.1f} deg"
        drawn_at = f"drawn at {group.azimuth_deg[0]:g} deg"
        told.append(f"{place}, {drawn_at}" if abs(away) > MOVED_DEG else f"{place}, as drawn")
        told += _others(parameters, number, group.name)
    return told


def _others(parameters: dict[str, FittedParameter], number: int, name: str) -> list[str]:
    """Height and tilt with their intervals, or that pictures do not tell them."""
    found = []
    for (field, what, unit), told in TOLD.items():
        parameter = parameters.get(f"leds.groups.{number}.{field}")
        if parameter is None:
            continue
        if parameter.se is None:
            found.append(f"LED group {name}: these pictures do not tell its {what}")
            continue
        spread = TWO_SIDED * parameter.se
        untold = f": these pictures do not tell it to {told:g} {unit}" if spread > told else ""
        found.append(f"LED group {name}: {what} {parameter.value:.2f} ± {spread:.2f} {unit}{untold}")
    return found


def _turns(design: Design) -> list[float]:
    """Angles by which groups are turned: those that can be built, or all where few can."""
    groups = len(design.leds.groups)
    turns = [float(turn) for turn in np.arange(0.0, 360.0, STEP_DEG)]
    buildable = [
        turn
        for turn in turns
        if turn == 0.0 or not _moved(design, [(turn, 0.0)] * groups).broken(as_built=True)
    ]
    return buildable if len(buildable) >= FEWEST_BUILDABLE else turns


def _raised(design: Design, turns: Sequence[Move]) -> list[Move]:
    """The same angles at other heights over the membrane, unless there are too many to compare."""
    lowest = min(_height_mm(design, group) for group in range(len(design.leds.groups)))
    found = [(turn, rise) for rise in RISES_MM if lowest + rise > 0 for turn, _ in turns]
    return found if (len(turns) + len(found)) ** len(design.leds.groups) <= MOST_PLACES else []


def _near(fine: Move, move: Move = (0.0, 0.0)) -> list[Move]:
    """A place and those so far to either side of it."""
    ways = product((0, -1, 1), repeat=2)
    return [(move[0] + turn * fine[0], move[1] + rise * fine[1]) for turn, rise in ways]


def _height_mm(design: Design, group: int) -> float:
    own = design.leds.groups[group].height_mm
    return float(design.leds.height_mm if own is None else own)


def _moved(design: Design, moves: Sequence[Move]) -> Design:
    """The design with each group turned about the axis and raised."""
    changes: dict[str, float | list[float]] = {}
    for number, (group, (turn, rise)) in enumerate(zip(design.leds.groups, moves, strict=True)):
        changes[f"leds.groups.{number}.azimuth_deg"] = [(a + turn) % 360.0 for a in group.azimuth_deg]
        if rise:
            changes[f"leds.groups.{number}.height_mm"] = _height_mm(design, number) + rise
    return design.replace(changes)


class _Tried:
    """Light of the groups of a design at places that are tried, beside the pictures it is to explain."""

    def __init__(self, design: Design, shots: Sequence[Shot], seed: int, work: Work) -> None:
        self._design, self._shots, self._seed, self._work = design, shots, seed, work
        channels = len(CHANNELS)
        self._valid = np.concatenate([shot.valid.reshape(-1, channels).all(axis=-1) for shot in shots])
        self._measured = np.concatenate([shot.signal.reshape(-1, channels) for shot in shots])[self._valid]
        self._own = _own_channels(design)

    def columns(self, moves: Sequence[Sequence[Move]]) -> Array:
        """Light of each group at each of its moves in all shots, (groups, moves, valid values)."""
        found = []
        for each in zip(*moves, strict=True):
            imaging = Rendered(_moved(self._design, each), SAMPLES, work=self._work)
            parts = []
            for shot in self._shots:
                basis = imaging.basis({}, shot.press, shot.view, seed=self._seed)
                parts.append((basis * shot.lit[:, None, None]).reshape(len(basis), -1))
            found.append(np.concatenate(parts, axis=1)[:, self._valid])
        return np.asarray(np.stack(found, axis=1), dtype=float)

    def misfits(self, columns: Array) -> Array:
        """Squared rest of each combination of places, an axis for each group."""
        return _misfits(columns, self._measured, self._own)

    def rest(self, misfit: float) -> float:
        """Root mean square of a rest, as a share of each channel's mean."""
        return float(np.sqrt(misfit / max(self._measured.size, 1)))


def _own_channels(design: Design) -> dict[int, int]:
    """Group and the channel in which it is by far the strongest, for all that have one."""
    own = {}
    for channel, light in enumerate(design.transfer_mw):
        group = int(light.argmax())
        if light[group] > CLEAR * np.delete(light, group).max(initial=0.0):
            own[group] = channel
    return own


def _misfits(columns: Array, measured: Array, own: Mapping[int, int]) -> Array:
    """Squared rest of each combination of places, an axis for each group, in units of each channel's mean.

    Which group a channel sees the light of is not told by where it comes from: every group that is to be the
    strongest of a channel is asked to be, and what breaks that counts as worse by far. Two groups at each
    other's place would else pass for the right ones wherever their places lie on the grid.
    """
    groups, turns, values = columns.shape
    scale = columns.mean(axis=-1, keepdims=True)
    columns = columns / np.where(scale > 0, scale, 1.0)
    level = measured.mean(axis=0)
    target = measured / np.where(level > 0, level, 1.0)
    terms = np.concatenate([columns.reshape(groups * turns, values), np.ones((1, values))])
    gram, right = terms @ terms.T, terms @ target  # (n, n), (n, channels)
    power = (target**2).sum(axis=0)
    choices = np.array(list(product(range(turns), repeat=groups)))
    places = choices + turns * np.arange(groups)
    chosen = np.concatenate([places, np.full((len(places), 1), groups * turns)], axis=1)
    best = np.full((len(chosen), target.shape[1]), np.inf)
    light = np.zeros((len(chosen), groups, target.shape[1]))
    for used in product((False, True), repeat=groups + 1):
        # Of factors that are nowhere negative, each is zero or free: all ways are tried.
        some = chosen[:, np.flatnonzero(used)]
        if not some.shape[1]:
            continue
        inner = gram[some[:, :, None], some[:, None, :]] + 1e-9 * values * np.eye(some.shape[1])
        sides = right[some]
        factors = np.linalg.solve(inner, sides)
        rest = power - np.einsum("nkc,nkc->nc", factors, sides)
        better = (factors >= 0).all(axis=1) & (rest < best)
        best = np.where(better, rest, best)
        lit = np.zeros_like(light)
        free = [place for place in np.flatnonzero(used) if place < groups]
        lit[:, free] = factors[:, : len(free)]
        light = np.where(better[:, None], lit, light)
    strange = sum(light[:, :, channel].argmax(axis=1) != group for group, channel in own.items())
    found = best.sum(axis=1) * (1.0 + STRANGE * np.asarray(strange))
    return np.asarray(found.reshape((turns,) * groups))
