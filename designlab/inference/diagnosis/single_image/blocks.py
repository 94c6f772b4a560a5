"""One picture as three: alternate blocks of it are fitted to, judge, and give the last numbers."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.difference_stencil import NEAR_SD
from designlab.inference.diagnosis.emulator.render_cache import Renders
from designlab.inference.diagnosis.emulator.snapshots import POSE_STEP, Bank, Snapshot, fill, moved
from designlab.inference.diagnosis.emulator.state import State, Unknown, Values
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.normal_equations import ALIKE
from designlab.measurement.shots import POSE, Observations, Shot, Use
from designlab.simulation.effects import CATALOGUE, SensorModel, effect

Uses = NDArray[np.intp]

TRAIN, SELECT, FINAL = 0, 1, 2
USES: tuple[Use, Use, Use] = ("train", "select", "final")
BLOCKS = 15  # across a picture: some 10 pixels each, several times as far as neighbouring values are alike
SCALE, MAGNIFICATION = next((e.name, e.scales) for e in CATALOGUE if e.scales)
SCALE_SD = 0.15  # of a picture's scale, which nothing in a single one tells
NORMAL_MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation


def block_numbers(rows: int, columns: int) -> tuple[Uses, Uses]:
    """Row and column of the block that every pixel belongs to, (rows, 1) and (1, columns)."""
    down = max(round(rows / columns * BLOCKS), 1)
    row, column = np.arange(rows) * down // rows, np.arange(columns) * BLOCKS // columns
    return row[:, None], column[None, :]


def block_uses(rows: int, columns: int, *, parity: int = 0) -> Uses:
    """What every pixel serves: fields of one colour of a chessboard fit, the others judge and end in turn.

    Parameters
    ----------
    parity : int
        0 or 1: which colour is fitted to.
    """
    row, column = block_numbers(rows, columns)
    other = (row + column + parity) % 2
    return np.asarray(np.where(other == 0, TRAIN, np.where((row + column // 2) % 2, FINAL, SELECT)))


def in_blocks(seen: Observations, *, parity: int = 0) -> Observations:
    """Replace the only press by one shot for each use of its blocks.

    Without repeats noise is not known. What neighbouring values differ by, noise and grain of the coating
    together, stands for it.
    """
    (shot,) = (s for s in seen.shots if s.lit.any() and s.ball is None)
    uses = block_uses(*shot.signal.shape[:2], parity=parity)
    variance = shot.variance + (grain(shot.signal) * shot.signal) ** 2
    shots = tuple(
        replace(
            shot,
            use=use,
            variance=variance,
            valid=shot.valid & (uses == number)[..., None],
            pose_sigma=shot.pose_sigma if number == TRAIN else np.zeros(len(POSE)),
        )
        for number, use in enumerate(USES)
    )
    return replace(seen, shots=shots, noise_source="camera description and grain of the picture")


def grain(signal: Array) -> Array:
    """Relative fluctuation of neighbouring values of each channel, (3,); slopes and edges do not count."""
    bends = signal[:, 2:] - 2 * signal[:, 1:-1] + signal[:, :-2]
    relative = np.abs(bends) / np.maximum(signal[:, 1:-1], np.finfo(float).tiny)
    return np.asarray(NORMAL_MAD * np.median(relative, axis=(0, 1)) / np.sqrt(6))


class FrameFitter(Fitter):
    """Fits to one picture, whose blocks share their pose, and whose scale is not known.

    Parameters
    ----------
    bank : Bank
        Pictures and the shots of the blocks.
    away : array, shape (4,)
        Departure of the press of the bank from the stated one.
    """

    def __init__(self, bank: Bank, away: Array) -> None:
        super().__init__(bank)
        self.away = away
        # The light of one real picture is off by much more than what simulations are granted; where it is
        # smooth, a wrong scale would make up for it.
        self.smooth_alike = ALIKE
        self.forward.parameters[SCALE] = tuple(
            replace(p, sd=SCALE_SD) if p.name == MAGNIFICATION else p for p in self.forward.parameters[SCALE]
        )

    def unknowns(
        self, state: State, names: Collection[str], shots: Sequence[int], *, gains: bool = True
    ) -> list[Unknown]:
        """Unknowns as usual, but for radial distortion, of which a crop about the axis shows little."""
        found = super().unknowns(state, names, shots, gains=gains)
        return [u for u in found if u.effect != SCALE or u.name == MAGNIFICATION]

    def knowing(self, nearby: Snapshot) -> "FrameFitter":
        """Return the same with further changes of its picture, rendered nearby."""
        (picture,) = self.bank.pictures
        changes = {**nearby.changes, **picture.changes}
        known = replace(picture, numerical=nearby.numerical, changes=changes)
        fitter = FrameFitter(replace(self.bank, pictures=(known,)), self.away)
        fitter.noises = self.noises
        return fitter

    def reaches(self, state: State) -> bool:
        """Whether a state lies so near to what was rendered that pictures in between can be combined."""
        near = bool((np.abs(state.pose(TRAIN)) <= np.array(POSE_STEP)).all())
        return near and all(
            abs(t) <= NEAR_SD
            for name, values in state.values.items()
            if effect(name).rendered
            for t in self.forward.coordinates(name, values).values()
        )

    def stated(self, state: State) -> Array:
        """Departure of the press from the stated one."""
        return self.away + state.pose(TRAIN)

    def bounds(self, unknowns: Sequence[Unknown]) -> tuple[Array, Array]:
        """Bounds as usual; more than the error of the mesh is no error of the mesh."""
        low, high = super().bounds(unknowns)
        for k, u in enumerate(unknowns):
            if u.effect == "numerical":
                low[k], high[k] = -1.0, 1.0
        return low, high

    def moved(self, state: State, unknowns: Sequence[Unknown], step: Array) -> State:
        """Take a step; all blocks take the pose of those that are fitted to."""
        there = super().moved(state, unknowns, step)
        return replace(there, poses=dict.fromkeys(range(len(self.bank.shots)), there.pose(TRAIN)))

    def _now(self, state: State, u: Unknown) -> float:
        away = self.away[POSE.index(u.name)] / u.sd if u.effect == "pose" else 0.0
        return super()._now(state, u) + float(away)


def centred(
    source: Renders,
    model: SensorModel,
    shots: Sequence[Shot],
    names: Sequence[str],
    away: Array,
    values: Values,
    *,
    finer: bool = False,
) -> FrameFitter:
    """Fitter about pictures rendered at a pose and at values of effects.

    Parameters
    ----------
    shots : sequence of Shot
        The blocks, with the stated press.
    names : sequence of str
        Effects whose pictures are wanted.
    away : array, shape (4,)
        Departure from the stated press.
    values : mapping of effect to values
        Effects of the model so far.
    finer : bool
        Whether to render what a finer mesh changes.
    """
    there = tuple(
        shot if shot.press is None else replace(shot, press=moved(shot.press, away)) for shot in shots
    )
    origin = {name: v for name, v in values.items() if effect(name).rendered}
    return FrameFitter(fill(source, model, there, list(names), origin=origin, finer=finer), away)
