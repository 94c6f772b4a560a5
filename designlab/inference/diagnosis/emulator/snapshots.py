"""Snapshots are rendered pictures of a model with their derivatives by poses and effects of light.

Every picture is rendered once, for the stated presses and the model as given. What a fit needs in between is
combined from these: a quadratic through three pictures for each pose coordinate and each effect parameter.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from designlab.core.types import Array, Single
from designlab.measurement.shots import Shot
from designlab.sensor.camera import View
from designlab.simulation.effects import SensorModel
from designlab.simulation.effects.base import Values

POSE_STEP = (0.05, 0.05, 0.06, 1.0)  # x, y, depth (mm) and yaw (deg): steps of the differences
SIZE_STEP = 0.02  # likewise of the probe, relative
SHARPER = 2  # times as many pixels along each side of pictures that are moved where a camera looks elsewhere


@dataclass(frozen=True, eq=False)
class LightDerivative:
    """Change of light with one coordinate t: t * first + t^2 * second, going on straight beyond `reach`.

    Both have shape (groups, rows, columns), or (rows, columns) where the light of `group` alone changes.
    Where `product`, t is the coordinate of a shape, and the change is per coordinate of what it shapes.
    """

    first: Single
    second: Single
    group: int | None = None
    reach: float = 1.0
    product: bool = False

    def added(self, light: Single, t: float, times: float = 1.0) -> None:
        """Add the change at t, so many times, to light (groups, rows, columns)."""
        target = light if self.group is None else light[self.group]
        target += np.float32(times * t) * self.first
        end = min(abs(t), self.reach)
        target += np.float32(times * end * (2 * abs(t) - end)) * self.second

    def slope(self, shape: tuple[int, ...], t: float) -> Single:
        """Derivative at t, (groups, rows, columns)."""
        found = np.zeros(shape, dtype=np.float32)
        target = found if self.group is None else found[self.group]
        target += self.first + np.float32(2 * np.clip(t, -self.reach, self.reach)) * self.second
        return found


@dataclass(frozen=True, eq=False)
class LocalCorrection:
    """What is added where a press seems to stand, so that light is exact there.

    Along the way from the stated pose it grows with the third power, as the error of a quadratic does.

    Attributes
    ----------
    pose : array, shape (4,)
        Where, in steps `POSE_STEP`.
    error : array, shape (groups, rows, columns)
        What pictures about the stated pose lack there.
    """

    pose: Array
    error: Single

    def share(self, pose: Array) -> float:
        """How much of the error is added at a pose, in steps."""
        return self._way(pose) ** 3

    def slope(self, pose: Array, axis: int) -> Single:
        """Derivative of the light by a step along an axis."""
        way = self._way(pose)
        rise = 3.0 * way**2 * float(self.pose[axis] / (self.pose @ self.pose)) if way < 1.0 else 0.0
        return np.asarray(np.float32(rise) * self.error, dtype=np.float32)

    def _way(self, pose: Array) -> float:
        """How far along the way to the stand a pose lies, 0 to 1."""
        return float(np.clip(pose @ self.pose / (self.pose @ self.pose), 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Snapshot:
    """Light of one stated press, and its changes.

    Attributes
    ----------
    light : array, shape (groups, rows, columns)
        Radiance of every LED group at unit flux; of repeats their mean, denoised.
    view : View
        What is rendered: more than the shots show, since a camera that stands or looks otherwise sees beyond.
    place : tuple of slice
        Rows and columns where the view of the shots lies in it.
    seen_mm : tuple of arrays, shape (rows, columns)
        Membrane point every pixel sees.
    numerical : array, shape (groups, rows, columns)
        What a finer membrane mesh changes.
    pitch_mm : tuple of float
        Size of a pixel on the plane z = 0.
    pose : tuple of LightDerivative
        By steps `POSE_STEP` of x, y, depth and yaw; empty without a press.
    size : LightDerivative or None
        By steps `SIZE_STEP` of the probe; None without a press.
    changes : mapping of (effect, parameter) to LightDerivative
        By coordinates from where the bank stands.
    spread : array, shape (repeats, groups, rows, columns), or None
        Deviations of the repeats from their mean, without what is known to be noise; None where a picture's
        random error is below what every simulation is granted.
    denoising : array, shape (groups, rows, columns), or None
        Factor that removes Monte Carlo noise from pictures of this press, where there are repeats.
    stand : LocalCorrection or None
        Where light was rendered besides, if the press seems to stand far from where it was stated.
    sharp : array, shape (groups, SHARPER * rows, SHARPER * columns), or None
        Light of the stated press in finer pixels, of which edges move as they should; None where noise in it
        is more than that is worth.
    sharp_at : array, shape (4,), or None
        Pose, in steps, of the press in `sharp`, if that is not the stated one.
    exact_at : array, shape (4,), or None
        Pose, in steps, at which `light` and changes together are exact, if that is not the stated one.
    """

    light: Single
    view: View
    place: tuple[slice, slice]
    seen_mm: tuple[Array, Array]
    numerical: Single
    pitch_mm: tuple[float, float]
    pose: tuple[LightDerivative, ...] = ()
    size: LightDerivative | None = None
    changes: Mapping[tuple[str, str], LightDerivative] = field(default_factory=dict)
    spread: Single | None = None
    denoising: Single | None = None
    stand: LocalCorrection | None = None
    sharp: Single | None = None
    sharp_at: Array | None = None
    exact_at: Array | None = None

    @cached_property
    def blunt(self) -> Single | None:
        """`sharp` in pixels as wide as those of `light`."""
        return None if self.sharp is None else binned(self.sharp)


@dataclass(frozen=True, eq=False)
class Bank:
    """All pictures that a diagnosis combines.

    Attributes
    ----------
    model : SensorModel
        The model as given.
    shots : tuple of Shot
        What was measured.
    pictures : tuple of Snapshot
        One for each press, shared by its shots.
    place : tuple of int
        Number of the picture of each shot.
    origin : mapping of effect to values
        Where rendered effects stand in the pictures; those not named are at their null.
    stands : mapping of effect to values
        Where light is exact instead, if it has been rendered there.
    """

    model: SensorModel
    shots: tuple[Shot, ...]
    pictures: tuple[Snapshot, ...]
    place: tuple[int, ...]
    origin: Mapping[str, Values] = field(default_factory=dict)
    stands: Mapping[str, Values] = field(default_factory=dict)

    def of(self, number: int) -> Snapshot:
        """Picture of a shot."""
        return self.pictures[self.place[number]]

    def with_own(self, pictures: Sequence[Snapshot]) -> "Bank":
        """Bank in which every shot has a picture of its own."""
        return replace(self, pictures=tuple(pictures), place=tuple(range(len(pictures))))

    def with_changes(self, other: "Bank") -> "Bank":
        """Bank that knows changes by effects as another one of the same shots does, where that knows them."""
        shown = [other.of(self.place.index(number)) for number in range(len(self.pictures))]
        return replace(
            self,
            pictures=tuple(
                replace(own, changes={**own.changes, **better.changes})
                for own, better in zip(self.pictures, shown, strict=True)
            ),
        )


def binned(sharp: Single) -> Single:
    """Mean of `SHARPER` by `SHARPER` pixels."""
    # A sum over strided views is ten times faster than a mean over two axes of a reshaped array.
    within = np.ndindex(SHARPER, SHARPER)
    found = sum(sharp[:, row::SHARPER, column::SHARPER] for row, column in within)
    return np.asarray(found / np.float32(SHARPER**2), dtype=np.float32)
