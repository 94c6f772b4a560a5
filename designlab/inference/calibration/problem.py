"""Shots of one sensor, a state of everything unknown about it, and what is simulated from that."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from designlab.core.types import Array
from designlab.inference.calibration.directional import Directional
from designlab.inference.calibration.fields import PROBE, SharedField
from designlab.inference.calibration.imaging import How, Rendered, Touched
from designlab.measurement.residuals import spread_of
from designlab.measurement.shots import Shot
from designlab.measurement.transfer import MODEL_ERROR, normal_equations, predicted, transfer_and_floor
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Mechanics
from designlab.simulation.simulator import Simulator

BRIGHT = 99.0  # percentile
LEAST_BLOCK_PX = 8  # of standard errors
DRAWS = 4  # of unbiased light, whose noise they tell
OF_MESH = 4 / 3  # error of a mesh over what half its pitch changes, where it goes with the pitch squared

Imaging = Rendered | Directional
"""A model of pictures that can be calibrated."""


@dataclass(frozen=True, eq=False)
class CalibrationState:
    """Shared fields, departures of poses (x, y, depth in mm, yaw in deg), factors of components and floor.

    `stuck` says that the search for it ended early: derivatives promised much, and no step held it.
    """

    shared: Array
    poses: Mapping[int, Array]
    transfer: Array
    floor: Array
    stuck: bool = False

    def pose(self, number: int) -> Array:
        """Departure of a shot's pose from the stated one."""
        return self.poses.get(number, np.zeros(4))


class Problem:
    """Shots, the standard deviation of each of their values, and the model of pictures.

    Parameters
    ----------
    imaging : Imaging
        What simulates pictures.
    shots : tuple of Shot
        What was photographed.
    fields : tuple of SharedField
        Numbers of the imaging's model that are free.
    seed : int
        Seed of the simulation.
    """

    def __init__(
        self, imaging: Imaging, shots: tuple[Shot, ...], fields: tuple[SharedField, ...], *, seed: int
    ) -> None:
        self.imaging, self.shots, self.fields, self.seed = imaging, shots, fields, seed
        self.weighed = False
        self.lits = [imaging.lit(shot) for shot in shots]
        self.stated = [_stated(shot, shot.signal) for shot in shots]
        self.sigmas = list(self.stated)
        self.blocks_px = [LEAST_BLOCK_PX] * len(shots)
        self.corrections: dict[int, Array] = {}
        self.doubts: dict[int, Array] = {}

    def hold(self, numbers: Sequence[int]) -> None:
        """Keep the poses of some shots where a state has them."""
        self.shots = tuple(
            replace(shot, pose_sigma=np.zeros(4)) if number in numbers else shot
            for number, shot in enumerate(self.shots)
        )

    def weigh(self, state: CalibrationState, bases: Mapping[int, Array]) -> float:
        """Let values count as what is left of them shows: errors of neighbours go together.

        Sums of residuals over blocks then have the variance that they would have if values erred
        independently by their standard deviation, for the blocks where these vary most: how far errors
        reach is not known. Smooth errors of a simulated gel so count for little beside the sharp image of a
        light probe, and what is known of a pose beside a picture that the model explains badly.

        Returns
        -------
        float
            Largest change of a standard deviation, as a share of it.
        """
        change = 0.0
        for number, basis in bases.items():
            shot, expected = self.shots[number], self.predict(state, number, basis)
            stated = self.stated[number] = _stated(shot, expected)
            left = np.where(shot.valid, (shot.signal - expected) / stated, 0.0)
            spread, needed = spread_of(left, shot.valid)
            self.blocks_px[number] = max(needed, LEAST_BLOCK_PX)
            weighed = np.maximum(stated * np.sqrt(spread), np.sqrt(shot.variance_at(expected)))
            change = max(change, float(np.abs(weighed / self.sigmas[number] - 1.0).max()))
            self.sigmas[number] = weighed
        self.weighed = True
        return change

    def start(self) -> CalibrationState:
        """State that the model and the measurement state, without light yet."""
        components = len(self.imaging.names)
        return CalibrationState(
            np.array([f.value for f in self.fields]), {}, np.zeros((3, components)), np.zeros(3)
        )

    def changes(self, shared: Array) -> dict[str, float]:
        """Values of the shared fields of the model by their paths."""
        return {path: value for path, value in self._values(shared).items() if not path.startswith(PROBE)}

    def _values(self, shared: Array) -> dict[str, float]:
        return {f.path: float(value) for f, value in zip(self.fields, shared, strict=True)}

    def _press(self, shot: Shot, shared: Array) -> Press | None:
        """Press of a shot, of a probe with values of the shared fields."""
        if shot.press is None:
            return None
        values = self._values(shared).items()
        own = {path.removeprefix(PROBE): value for path, value in values if path.startswith(PROBE)}
        return shot.press.model_copy(update={"probe": shot.press.probe.model_copy(update=own)})

    def settled(self, shared: Array) -> "Problem":
        """Return the problem of the poses alone, with the shared fields at values."""
        shots = tuple(replace(shot, press=self._press(shot, shared)) for shot in self.shots)
        imaging = self.imaging.at(self.changes(shared))
        return Problem(imaging, shots, (), seed=self.seed)

    def sees(self, field: SharedField, shot: Shot) -> bool:
        """Whether a shot can depend on a shared field."""
        if field.path.startswith(PROBE):
            return shot.press is not None
        return self.imaging.sees(field.path, shot)

    def touched(self, state: CalibrationState, number: int) -> Touched:
        """Return what a shot shows, at the state's pose."""
        shot = self.shots[number]
        x, y, depth, yaw = (float(v) for v in state.pose(number))
        if shot.ball is not None:
            at = (shot.ball.centre_mm[0] + x, shot.ball.centre_mm[1] + y)
            return shot.ball.model_copy(update={"centre_mm": at, "lowest_mm": shot.ball.lowest_mm + depth})
        press = self._press(shot, state.shared)
        return None if press is None else press.moved(x, y, depth, yaw)

    def force_n(self, state: CalibrationState, number: int) -> float:
        """Force of a press of an elastic gel (N)."""
        return self._mechanics(state, number).force_n

    def depth_mm(self, state: CalibrationState, number: int) -> float:
        """Depth of a press (mm), stated or found for its force."""
        press = self.touched(state, number)
        assert isinstance(press, Press)
        return press.depth_mm or self._mechanics(state, number).depth_mm

    def _mechanics(self, state: CalibrationState, number: int) -> Mechanics:
        press = self.touched(state, number)
        assert isinstance(press, Press)
        design = self.imaging.at(self.changes(state.shared)).design
        simulator = Simulator(design, view=self.shots[number].view, samples=1, seed=self.seed)
        mechanics = simulator.surface(press).mechanics
        assert mechanics is not None  # no shot of contact by the smoothing kernel has a force
        return mechanics

    def force_residual(self, state: CalibrationState, number: int) -> float:
        """Measured minus simulated force of a press over its standard deviation; 0 where it is unknown."""
        shot = self.shots[number]
        if math.isinf(shot.force_sigma_n):
            return 0.0
        return (shot.force_n - self.force_n(state, number)) / shot.force_sigma_n

    def correct(self, state: CalibrationState, numbers: Sequence[int]) -> None:
        """Correct the pictures of some shots, from now on, by what exact ones have beyond them at a state.

        Exact are unbiased light and a mesh without pitch, whose error follows from half the pitch (Richardson
        extrapolation). A fit so needs few exact pictures: defect correction (Stetter 1978,
        doi:10.1007/BF01432879). Kept in `doubts` are errors that stay, each of one standard deviation: the
        noise of unbiased light, whose mean is taken, and the step from half the pitch to none.
        """
        for number in numbers:
            usual = self.pictures(state, number)
            drawn = np.array([self.pictures(state, number, seed=k, how="unbiased") for k in range(DRAWS)])
            mean, mesh = drawn.mean(axis=0), np.zeros_like(usual)
            if self.shots[number].press is not None:
                mesh = self.pictures(state, number, how="fine") - usual
            noise = (drawn - mean) / math.sqrt(DRAWS * (DRAWS - 1))
            self.doubts[number] = np.stack([*noise, (OF_MESH - 1.0) * mesh])
            self.corrections[number] = mean - usual + OF_MESH * mesh

    def pictures(self, state: CalibrationState, number: int, *, seed: int = 0, how: How = "usual") -> Array:
        """Pictures of the components; the same random numbers each time, unless others are asked for."""
        shot, touched = self.shots[number], self.touched(state, number)
        changes = {p: v for p, v in self.changes(state.shared).items() if self.imaging.sees(p, shot)}
        return self.imaging.basis(changes, touched, shot.view, seed=self.seed + seed, how=how)

    def basis(self, state: CalibrationState, number: int, *, how: How = "usual") -> Array:
        """Pictures of the components, corrected where `correct` was asked to."""
        return self.pictures(state, number, how=how) + self.corrections.get(number, 0.0)

    def bases(self, state: CalibrationState, numbers: Sequence[int]) -> dict[int, Array]:
        """Unit-power pictures of several shots."""
        return {number: self.basis(state, number) for number in numbers}

    def predict(self, state: CalibrationState, number: int, basis: Array) -> Array:
        """Signal of a shot, (rows, columns, 3)."""
        return predicted(state.transfer, state.floor, self.lits[number], basis)

    def lit_best(self, state: CalibrationState, bases: Mapping[int, Array]) -> CalibrationState:
        """State with the transfer and floor that fit the shots best."""
        transfer, floor = transfer_and_floor(
            normal_equations(basis, self.lits[n], self.shots[n].signal, self.sigmas[n], self.shots[n].valid)
            for n, basis in bases.items()
        )
        return replace(state, transfer=transfer, floor=floor)

    def residual(self, state: CalibrationState, number: int, basis: Array, *, weighed: bool = True) -> Array:
        """Measured minus predicted valid values over their standard deviation, (values,).

        The standard deviation is that of noise and model error alone where `weighed` is False.
        """
        shot = self.shots[number]
        sigma = (self.sigmas if weighed else self.stated)[number]
        left = (shot.signal - self.predict(state, number, basis)) / sigma
        return np.asarray(left[shot.valid])

    def objective(self, state: CalibrationState, bases: Mapping[int, Array]) -> float:
        """Sum of squared residuals of pictures and forces, plus the priors of shared fields and poses."""
        total = sum(
            ((value - f.expected) / f.sigma) ** 2 for f, value in zip(self.fields, state.shared, strict=True)
        )
        for number, basis in bases.items():
            sigma = self.shots[number].pose_sigma
            total += float((self.residual(state, number, basis) ** 2).sum())
            total += float(((state.pose(number)[sigma > 0] / sigma[sigma > 0]) ** 2).sum())
            total += self.force_residual(state, number) ** 2
        return float(total)


def _stated(shot: Shot, signal: Array) -> Array:
    """Standard deviation of noise and model error, where the signal is what a model says."""
    return np.asarray(np.sqrt(shot.variance_at(signal) + (MODEL_ERROR * _level(shot)) ** 2))


def _level(shot: Shot) -> Array:
    """What the model error is a share of: the mean of a smooth picture, the bright end of a mirror's."""
    if shot.ball is None:
        return np.asarray(np.abs(shot.signal.mean(axis=(0, 1))))
    return np.asarray(np.abs(np.percentile(shot.signal, BRIGHT, axis=(0, 1))))
