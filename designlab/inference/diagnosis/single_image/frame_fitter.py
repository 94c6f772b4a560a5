"""A fit to one picture, whose blocks share their pose and whose scale is not known."""

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.difference_stencil import NEAR_SD
from designlab.inference.diagnosis.emulator.rendering import fill, moved
from designlab.inference.diagnosis.emulator.snapshots import POSE_STEP, Bank, Snapshot
from designlab.inference.diagnosis.emulator.state import State, Unknown, Values
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.normal_equations import ALIKE
from designlab.measurement.blocks import TRAIN
from designlab.measurement.residuals import spread_of
from designlab.measurement.shots import POSE, Shot
from designlab.simulation.effects import CATALOGUE, SensorModel, effect
from designlab.simulation.render_cache import Renders

SCALE, MAGNIFICATION = next((e.name, e.scales) for e in CATALOGUE if e.scales)
SCALE_SD = 0.15  # of a picture's scale, which nothing in a single one tells


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
        self.smooth_alike = math.inf
        self.forward.parameters[SCALE] = tuple(
            replace(p, sd=SCALE_SD) if p.name == MAGNIFICATION else p for p in self.forward.parameters[SCALE]
        )

    @property
    def fits_smooth(self) -> bool:
        """One picture does not tell the smooth error of light from the shape of a press."""
        return False

    def unknowns(
        self, state: State, names: Collection[str], shots: Sequence[int], *, gains: bool = True
    ) -> list[Unknown]:
        """Unknowns as usual, but for radial distortion, of which a crop about the axis shows little."""
        found = super().unknowns(state, names, shots, gains=gains)
        return [u for u in found if u.effect != SCALE or u.name == MAGNIFICATION]

    def weighed(self, state: State) -> "FrameFitter":
        """Return the same, in which values count as what a state leaves of them shows: neighbours err alike.

        A model that explains the picture badly would otherwise be trusted more than what is known of pose,
        scale and effects, and a fit would end where only a wrong pose helps it.
        """
        shot, noise = self.bank.shots[TRAIN], self.noises[TRAIN]
        left = np.where(shot.valid, (shot.signal - self.forward.predict(state, TRAIN)) / noise.sigma, 0.0)
        found = self.about(self.bank, self.away)
        found.alike = max(float(spread_of(left, shot.valid)[0].mean()), ALIKE)
        return found

    def about(self, bank: Bank, away: Array) -> "FrameFitter":
        """Fitter of other pictures that counts values as this one does."""
        other = FrameFitter(bank, away)
        other.noises, other.alike = self.noises, self.alike
        return other

    def knowing(self, nearby: Snapshot) -> "FrameFitter":
        """Return the same with further changes of its picture, rendered nearby."""
        (picture,) = self.bank.pictures
        changes = {**nearby.changes, **picture.changes}
        known = replace(picture, numerical=nearby.numerical, changes=changes)
        return self.about(replace(self.bank, pictures=(known,)), self.away)

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
) -> Bank:
    """Pictures rendered at a pose and at values of effects.

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
    return fill(source, model, there, list(names), origin=origin, finer=finer)
