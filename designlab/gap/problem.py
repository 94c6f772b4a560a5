"""What is compared: a state of the model (effects, gains, poses) against the shots, in units of the noise."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from designlab.effects.model import AppliedEffect, SensorModel
from designlab.gap.basis import Renders, Variant
from designlab.measurement.shots import POSE, Shot
from designlab.press import Press

Array = NDArray[np.float64]

DEPTH_STEP_MM = 0.03
LEAST_DEPTH_MM = 0.01
BLOCK_PX = 8


@dataclass(frozen=True, eq=False)
class State:
    """A model with the nuisances of one measurement: gains of LED groups, pose errors of shots."""

    model: SensorModel
    gains: Array
    poses: Mapping[int, Array]

    def pose(self, number: int) -> Array:
        """Departure of a shot's pose from the nominal one: x, y, depth (mm), yaw (deg)."""
        return self.poses.get(number, np.zeros(len(POSE)))

    def with_values(self, values: Mapping[str, Mapping[str, float]]) -> "State":
        """Give effects other values; effects that the model lacks join it."""
        model = self.model
        for name, parameters in values.items():
            model = model.with_effect(AppliedEffect(name=name, values=dict(parameters)))
        return replace(self, model=model)


@dataclass(frozen=True, eq=False)
class Problem:
    """Shots, the standard deviation expected of each value, and the renderer.

    `spread` is the difference of two basis pictures of each shot with different random numbers, `budget` the
    systematic error granted to the simulation, both part of `sigma`.
    """

    renders: Renders
    shots: tuple[Shot, ...]
    sigma: tuple[Array, ...]
    spread: tuple[Array, ...]
    budget: tuple[Array, ...]
    _pose_columns: dict[int, Array] = field(default_factory=dict)

    def press(self, state: State, number: int) -> Press | None:
        """Indentation of a shot at the state's pose."""
        return moved(self.shots[number].press, state.pose(number))

    def basis(self, state: State, number: int, *, variant: Variant = "value") -> Array:
        """Radiance of every LED group for a shot, (groups, rows, columns)."""
        shot = self.shots[number]
        press = self.press(state, number)
        stream = 0 if press is None else number + 1
        found = self.renders.basis(state.model, press, shot.view, stream=stream, variant=variant)
        return found.astype(float)

    def predict(self, state: State, number: int, *, variant: Variant = "value") -> Array:
        """Signal of a shot, (rows, columns, 3)."""
        shot = self.shots[number]
        return clipped(
            mixed(weights(state, shot), self.basis(state, number, variant=variant)), shot.clip_sigma
        )

    def residual(self, state: State, number: int, *, variant: Variant = "value") -> Array:
        """Measured minus predicted signal over the standard deviation; zero where a value is not valid."""
        shot = self.shots[number]
        difference = (shot.signal - self.predict(state, number, variant=variant)) / self.sigma[number]
        return np.where(shot.valid, difference, 0.0)

    def pose_columns(self, state: State, number: int) -> Array:
        """Derivative of the signal by x, y, depth (per mm) and yaw (per deg), (rows, columns, 3, 4).

        A small shift or turn of the probe moves the difference to the untouched gel; depth is a finite
        difference of two renders with common random numbers. What was found at the first state serves every
        later one: fits correct their derivatives as they go.
        """
        if number not in self._pose_columns:
            self._pose_columns[number] = self._found_pose_columns(state, number)
        return self._pose_columns[number]

    def _found_pose_columns(self, state: State, number: int) -> Array:
        shot = self.shots[number]
        here = self.press(state, number)
        if here is None:
            raise ValueError("an untouched gel has no pose")
        mixing = weights(state, shot)
        touched = mixed(mixing, self.basis(state, number))
        untouched = self.renders.basis(state.model, None, shot.view, stream=0).astype(float)
        change = touched - mixed(mixing, untouched)
        change = np.where(np.abs(gaussian_filter(change, (1, 1, 0))) > self.sigma[number], change, 0.0)
        rays = self.renders.simulator(state.model, shot.view).rays
        by_row, by_column = (gaussian_filter(change, (0.5, 0.5, 0), order=o) for o in ((1, 0, 0), (0, 1, 0)))
        by_x = by_column / np.gradient(rays.x_mm, axis=1)[..., None]
        by_y = by_row / np.gradient(rays.y_mm, axis=0)[..., None]
        off_x, off_y = rays.x_mm - here.centre_mm[0], rays.y_mm - here.centre_mm[1]
        by_yaw = np.radians(1.0) * (by_x * -off_y[..., None] + by_y * off_x[..., None])
        deeper = moved(here, np.array([0.0, 0.0, DEPTH_STEP_MM, 0.0]))
        basis = self.renders.basis(state.model, deeper, shot.view, stream=number + 1).astype(float)
        by_depth = (mixed(mixing, basis) - touched) / DEPTH_STEP_MM
        return np.stack([-by_x, -by_y, by_depth, -by_yaw], axis=-1)


def moved(press: Press | None, pose: Array) -> Press | None:
    """Shift, deepen and turn a press by x, y, depth (mm) and yaw (deg)."""
    if press is None or not pose.any():
        return press
    # Rounded far below what can be seen, so that equal poses have equal digests.
    x, y, depth, yaw = (float(v) for v in np.round(pose, 6))
    return Press(
        probe=press.probe,
        depth_mm=max(press.depth_mm + depth, LEAST_DEPTH_MM),
        centre_mm=(press.centre_mm[0] + x, press.centre_mm[1] + y),
        yaw_deg=press.yaw_deg + yaw,
    )


def weights(state: State, shot: Shot) -> Array:
    """Signal of each channel per unit of each group's radiance at unit flux, (3, groups)."""
    design = state.model.effective_design()
    flux = np.array([group.flux_mw for group in design.leds.groups])
    return np.asarray(design.mixing_matrix * flux * state.gains * shot.lit)


def mixed(mixing: Array, basis: Array) -> Array:
    """Combine group radiances into channels, (rows, columns, 3)."""
    return np.moveaxis(np.tensordot(mixing, basis, axes=1), 0, -1)


def clipped(signal: Array, sigma: Array) -> Array:
    """Mean of counts about a signal when those below zero are cut to zero; channels of zero `sigma` stay.

    For Gaussian counts it is s Phi(s / sigma) + sigma phi(s / sigma), which tends to s well above the noise.
    """
    from scipy.stats import norm

    found = signal.copy()
    for channel in np.flatnonzero(sigma):
        ratio = signal[..., channel] / sigma[channel]
        found[..., channel] = sigma[channel] * (ratio * norm.cdf(ratio) + norm.pdf(ratio))
    return found


def blocks(shape: tuple[int, ...]) -> NDArray[np.int64]:
    """Number of the block of `BLOCK_PX` x `BLOCK_PX` pixels that each pixel lies in, (rows, columns)."""
    row, column = np.indices(shape[:2]) // BLOCK_PX
    return np.asarray(row * (shape[1] // BLOCK_PX + 1) + column)


def halves(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Every other block, as on a chess board: True where poses are registered, False where judged."""
    row, column = np.indices(shape[:2]) // BLOCK_PX
    return np.asarray((row + column) % 2 == 0)
