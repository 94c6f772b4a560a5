"""Shots of one sensor, a state of everything unknown about it, and what is simulated from that."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from designlab.calibrate.fields import SharedField
from designlab.calibrate.linear import predicted, transfer_and_floor
from designlab.design import Design
from designlab.measurement.shots import Shot
from designlab.press import Press
from designlab.simulate import Simulator

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

MODEL_ERROR = 0.01  # of a channel's mean signal in a shot: what the simulation is not trusted with
LEAST_DEPTH_MM = 0.01


@dataclass(frozen=True, eq=False)
class State:
    """Shared fields, departures of poses (x, y, depth in mm, yaw in deg), transfer and floor."""

    shared: Array
    poses: Mapping[int, Array]
    transfer: Array
    floor: Array

    def pose(self, number: int) -> Array:
        """Departure of a shot's pose from the stated one."""
        return self.poses.get(number, np.zeros(4))


class Problem:
    """Shots, the standard deviation of each of their values, and the simulator."""

    def __init__(
        self,
        design: Design,
        shots: tuple[Shot, ...],
        fields: tuple[SharedField, ...],
        *,
        samples: int,
        seed: int,
        progress: Progress | None = None,
    ) -> None:
        self.design, self.shots, self.fields = design, shots, fields
        self.samples, self.seed, self.progress = samples, seed, progress
        self.stage, self.done, self.expected = "", 0, 1
        self.sigmas = [
            np.sqrt(shot.variance + (MODEL_ERROR * np.abs(shot.signal.mean(axis=(0, 1)))) ** 2)
            for shot in shots
        ]

    def begin(self, stage: str, expected: int) -> None:
        """Name what is done now and how many pictures it takes, as far as is known."""
        self.stage, self.done, self.expected = stage, 0, expected

    def start(self) -> State:
        """State that the design and the measurement state, without light yet."""
        groups = len(self.design.group_names)
        return State(np.array([f.value for f in self.fields]), {}, np.zeros((3, groups)), np.zeros(3))

    def design_at(self, shared: Array) -> Design:
        """Design with other values of the shared fields."""
        return self.design.replace(
            {f.path: float(value) for f, value in zip(self.fields, shared, strict=True)}
        )

    def press(self, state: State, number: int) -> Press | None:
        """Indentation of a shot at the state's pose."""
        press = self.shots[number].press
        if press is None:
            return None
        x, y, depth, yaw = state.pose(number)
        return Press(
            probe=press.probe,
            depth_mm=max(float(press.depth_mm + depth), LEAST_DEPTH_MM),
            centre_mm=(float(press.centre_mm[0] + x), float(press.centre_mm[1] + y)),
            yaw_deg=float(press.yaw_deg + yaw),
        )

    def basis(self, state: State, number: int, *, other_seed: bool = False) -> Array:
        """Unit-power pictures of a shot; the same random numbers each time, unless others are asked for."""
        simulator = Simulator(
            self.design_at(state.shared),
            view=self.shots[number].view,
            samples=self.samples,
            seed=self.seed + other_seed,
        )
        found = simulator.frame(self.press(state, number)).basis.astype(float)
        self.done += 1
        self.expected = max(self.expected, self.done)
        if self.progress is not None:
            self.progress(self.stage, self.done, self.expected)
        return found

    def untouched(self) -> Array:
        """Unit-power pictures of the untouched gel over the whole sensing area, of the design as given."""
        simulator = Simulator(self.design, samples=self.samples, seed=self.seed)
        return simulator.frame(None).basis.astype(float)

    def bases(self, state: State, numbers: Sequence[int]) -> dict[int, Array]:
        """Unit-power pictures of several shots."""
        return {number: self.basis(state, number) for number in numbers}

    def predict(self, state: State, number: int, basis: Array) -> Array:
        """Signal of a shot, (rows, columns, 3)."""
        return predicted(state.transfer, state.floor, self.shots[number].lit, basis)

    def lit_best(self, state: State, bases: Mapping[int, Array]) -> State:
        """State with the transfer and floor that fit the shots best."""
        shots = [self.shots[number] for number in bases]
        transfer, floor = transfer_and_floor(
            list(bases.values()),
            [shot.lit for shot in shots],
            [shot.signal for shot in shots],
            [self.sigmas[number] for number in bases],
            [shot.valid for shot in shots],
        )
        return replace(state, transfer=transfer, floor=floor)

    def residual(self, state: State, number: int, basis: Array) -> Array:
        """Measured minus predicted valid values over their standard deviation, (values,)."""
        shot = self.shots[number]
        left = (shot.signal - self.predict(state, number, basis)) / self.sigmas[number]
        return np.asarray(left[shot.valid])

    def objective(self, state: State, bases: Mapping[int, Array]) -> float:
        """Sum of squared residuals, plus the priors of the poses."""
        total = 0.0
        for number, basis in bases.items():
            sigma = self.shots[number].pose_sigma
            total += float((self.residual(state, number, basis) ** 2).sum())
            total += float(((state.pose(number)[sigma > 0] / sigma[sigma > 0]) ** 2).sum())
        return total
