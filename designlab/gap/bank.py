"""Pictures of a model, and how they change with poses and with effects that need light traced anew.

Every picture is rendered once, for the stated presses and the model as given. What a fit needs in between is
combined from these: a quadratic through three pictures for each pose coordinate and each effect parameter.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from designlab.camera import View
from designlab.effects import AppliedEffect, Effect, Parameter, SensorModel, effect
from designlab.gap.basis import Renders
from designlab.measurement.shots import POSE, Shot
from designlab.press import Press
from designlab.store import digest

Array = NDArray[np.float64]
Single = NDArray[np.float32]

POSE_STEP = (0.05, 0.05, 0.03, 1.0)  # x, y, depth (mm) and yaw (deg): steps of the differences
LEAST_DEPTH_MM = 0.01


@dataclass(frozen=True, eq=False)
class Change:
    """Change of light with one coordinate t: t * first + t^2 * second, going on straight beyond `reach`.

    Both have shape (groups, rows, columns), or (rows, columns) where the light of `group` alone changes.
    """

    first: Single
    second: Single
    group: int | None = None
    reach: float = 1.0

    def added(self, light: Single, t: float) -> None:
        """Add the change at t to light (groups, rows, columns)."""
        target = light if self.group is None else light[self.group]
        target += np.float32(t) * self.first
        end = min(abs(t), self.reach)
        target += np.float32(end * (2 * abs(t) - end)) * self.second

    def slope(self, shape: tuple[int, ...], t: float) -> Single:
        """Derivative at t, (groups, rows, columns)."""
        found = np.zeros(shape, dtype=np.float32)
        target = found if self.group is None else found[self.group]
        target += self.first + np.float32(2 * np.clip(t, -self.reach, self.reach)) * self.second
        return found


@dataclass(frozen=True, eq=False)
class Picture:
    """Light of one stated press, and its changes.

    Attributes
    ----------
    light : array, shape (groups, rows, columns)
        Radiance of every LED group at unit flux.
    seen_mm : tuple of arrays, shape (rows, columns)
        Membrane point every pixel sees.
    numerical : array, shape (groups, rows, columns)
        What a finer membrane mesh changes.
    pitch_mm : tuple of float
        Size of a pixel on the plane z = 0.
    pose : tuple of Change
        By steps `POSE_STEP` of x, y, depth and yaw; empty without a press.
    changes : mapping of (effect, parameter) to Change
        By prior standard deviations. A shape's coordinate multiplies that of its effect's first parameter.
    """

    light: Single
    seen_mm: tuple[Array, Array]
    numerical: Single
    pitch_mm: tuple[float, float]
    pose: tuple[Change, ...] = ()
    changes: Mapping[tuple[str, str], Change] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Bank:
    """All pictures that a diagnosis combines.

    Attributes
    ----------
    model : SensorModel
        The model as given.
    shots : tuple of Shot
        What was measured.
    pictures : tuple of Picture
        One for each press, shared by its shots.
    place : tuple of int
        Number of the picture of each shot.
    """

    model: SensorModel
    shots: tuple[Shot, ...]
    pictures: tuple[Picture, ...]
    place: tuple[int, ...]

    def of(self, number: int) -> Picture:
        """Picture of a shot."""
        return self.pictures[self.place[number]]


def fill(renders: Renders, model: SensorModel, shots: tuple[Shot, ...], effects: Sequence[str]) -> Bank:
    """Render everything that a diagnosis with some effects needs.

    Parameters
    ----------
    renders : Renders
        Where pictures come from; those already there cost nothing.
    effects : sequence of str
        Effects that may be fitted.
    """
    keys = [(shot.press, shot.view) for shot in shots]
    presses = list(dict.fromkeys(keys))
    key = digest(model.digest, presses, list(effects), str(renders.folder), renders.samples, renders.seed)
    if key not in _filled:
        # Measurements of one sensor by one plan share their pictures.
        _filled.clear()
        _filled[key] = _fill(renders, model, presses, effects)
    pictures = _filled[key]
    return Bank(model, shots, pictures, tuple(presses.index(key) for key in keys))


_filled: dict[str, tuple["Picture", ...]] = {}


def _fill(
    renders: Renders,
    model: SensorModel,
    presses: Sequence[tuple[Press | None, View]],
    effects: Sequence[str],
) -> tuple["Picture", ...]:
    steps = [step for name in effects for step in _steps(model, effect(name))]
    touched = sum(press is not None for press, _ in presses)
    sides = 2 * len(steps)
    renders.begin("pictures", len(presses) * (2 + sides) + touched * 2 * len(POSE))
    # One model after the other: what its light is shaded from is large and not kept for long.
    for variant in ("value", "fine"):
        for press, view in presses:
            renders.basis(model, press, view, variant=variant)
            if press is not None and variant == "value":
                for _, there in _around(press):
                    renders.basis(model, there, view)
    for step in steps:
        for varied, _ in _sides(model, step):
            for press, view in presses:
                if press is not None or _acts_untouched(step.effect):
                    renders.basis(varied, press, view)
    return tuple(_picture(renders, model, press, view, steps) for press, view in presses)


@dataclass(frozen=True)
class _Step:
    """Two other values of some parameters of an effect, each of which changes the light of other groups.

    `at` holds, for each of the two, the values of the effect and how far they are in standard deviations.
    """

    effect: str
    parameters: tuple[Parameter, ...]
    at: tuple[tuple[tuple[tuple[str, float], ...], float], ...]
    shape: bool = False


def _steps(model: SensorModel, chosen: Effect) -> Iterator[_Step]:
    if not chosen.rendered:
        return
    parameters, null = chosen.parameters(model.design), chosen.null(model.design)
    mains = [p for p in parameters if not p.shape]
    for together in _together(mains):
        sides = []
        for t in (1.0, 2.0) if together[0].one_sided else (-1.0, 1.0):
            values = null | {p.name: float(np.clip(p.null + t * p.sd, p.low, p.high)) for p in together}
            reached = (values[together[0].name] - together[0].null) / together[0].sd
            sides.append((tuple(values.items()), reached))
        yield _Step(chosen.name, tuple(together), tuple(sides))
    for p in parameters:
        if p.shape:
            main = mains[0]
            sides = []
            for t in (-1.0, 1.0):
                values = null | {
                    main.name: main.null + main.sd,
                    p.name: float(np.clip(p.null + t * p.sd, p.low, p.high)),
                }
                sides.append((tuple(values.items()), (values[p.name] - p.null) / p.sd))
            yield _Step(chosen.name, (p,), tuple(sides), shape=True)


def _together(parameters: Sequence[Parameter]) -> list[list[Parameter]]:
    """Sort parameters so that those of different LED groups are moved at once."""
    lots: list[list[Parameter]] = []
    for p in parameters:
        for lot in lots:
            if p.group and all(other.group and other.group != p.group for other in lot):
                lot.append(p)
                break
        else:
            lots.append([p])
    return lots


def _picture(
    renders: Renders, model: SensorModel, press: Press | None, view: View, steps: Sequence[_Step]
) -> Picture:
    here = renders.basis(model, press, view)
    simulator = renders.simulator(model, view)
    seen = simulator.rays.hit(simulator.surface(press))
    numerical = renders.basis(model, press, view, variant="fine") - here
    changes: dict[tuple[str, str], Change] = {}
    for step in steps:
        sees = press is not None or _acts_untouched(step.effect)
        sides = [
            (_relative(renders.basis(varied, press, view), varied, model) if sees else here, t)
            for varied, t in _sides(model, step)
        ]
        for p in step.parameters:
            group = model.design.group_names.index(p.group) if p.group else None
            if step.shape:
                (low, t_low), (high, t_high) = sides
                first = (high - low) / np.float32(t_high - t_low)
                changes[step.effect, p.name] = Change(first, np.zeros_like(first))
            else:
                changes[step.effect, p.name] = _quadratic(here, sides, group)
    pose: tuple[Change, ...] = ()
    if press is not None:
        ends = [(renders.basis(model, there, view), s) for s, there in _around(press)]
        pose = tuple(_quadratic(here, ends[2 * axis : 2 * axis + 2], None) for axis in range(len(POSE)))
    return Picture(here, seen, numerical, simulator.rays.pitch_mm, pose, changes)


def _relative(light: Single, varied: SensorModel, model: SensorModel) -> Single:
    """Light at unit flux of one model as that at unit flux of another, which is lit by another flux."""
    ratio = [
        ours.flux_mw / theirs.flux_mw
        for ours, theirs in zip(
            varied.effective_design().leds.groups, model.effective_design().leds.groups, strict=True
        )
    ]
    return light * np.array(ratio, dtype=np.float32)[:, None, None]


def _acts_untouched(name: str) -> bool:
    """Whether an effect can change the picture of the untouched gel."""
    return effect(name).stage != "contact" and name != "translucency"


def _quadratic(here: Single, sides: Sequence[tuple[Single, float]], group: int | None) -> Change:
    """Quadratic through the light here and at two other places."""
    chosen = slice(None) if group is None else group
    (a, s), (b, t) = ((light[chosen] - here[chosen], at) for light, at in sides)
    second = (b / np.float32(t) - a / np.float32(s)) / np.float32(t - s)
    first = a / np.float32(s) - np.float32(s) * second
    reach = max(abs(s), abs(t))
    return Change(np.ascontiguousarray(first), np.ascontiguousarray(second), group, reach)


def _sides(model: SensorModel, step: _Step) -> Iterator[tuple[SensorModel, float]]:
    """The two other models of a step, and how far they are in standard deviations."""
    for values, t in step.at:
        yield model.with_effect(AppliedEffect(name=step.effect, values=dict(values))), t


def _around(press: Press) -> Iterator[tuple[float, Press]]:
    """Presses one step to either side along each pose coordinate."""
    for axis in range(len(POSE)):
        for sign in (-1.0, 1.0):
            yield sign, moved(press, sign * np.eye(len(POSE))[axis] * POSE_STEP)


def moved(press: Press, pose: Array) -> Press:
    """Shift, deepen and turn a press by x, y, depth (mm) and yaw (deg)."""
    x, y, depth, yaw = (float(v) for v in np.round(pose, 6))
    return Press(
        probe=press.probe,
        depth_mm=max(press.depth_mm + depth, LEAST_DEPTH_MM),
        centre_mm=(press.centre_mm[0] + x, press.centre_mm[1] + y),
        yaw_deg=press.yaw_deg + yaw,
    )
