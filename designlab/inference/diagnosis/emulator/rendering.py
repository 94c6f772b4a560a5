"""Rendering of all that a diagnosis combines its pictures from: presses, poses and effects about a model."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from designlab.core.memory import remembered
from designlab.core.store import digest
from designlab.core.types import Array, Single
from designlab.inference.diagnosis.emulator.difference_stencil import StencilStep, steps
from designlab.inference.diagnosis.emulator.snapshots import (
    POSE_STEP,
    SHARPER,
    SIZE_STEP,
    Bank,
    LightDerivative,
    Snapshot,
)
from designlab.measurement.shots import POSE, Shot
from designlab.sensor.camera import View
from designlab.simulation.contact.press import Press
from designlab.simulation.effects import AppliedEffect, SensorModel, effect
from designlab.simulation.effects.base import Values
from designlab.simulation.render.denoising import Denoiser, denoised_change, fit_denoiser, share_of
from designlab.simulation.render_cache import DRAFT, FINE, USUAL, Quality, Renders

MARGIN_PX = 4  # rendered around what shots show
REPEATS = 8  # further pictures of the given model where light comes through a core, each with its own noise
FILLED_KEPT = 2
DRAFTED = ("emission", "transport", "material")  # stages of effects that change light but not the gel


def fill(
    renders: Renders,
    model: SensorModel,
    shots: tuple[Shot, ...],
    effects: Sequence[str],
    *,
    origin: Mapping[str, Values] | None = None,
    finer: bool = True,
    both: bool = True,
) -> Bank:
    """Render everything that a diagnosis with some effects needs.

    Parameters
    ----------
    renders : Renders
        Where pictures come from; those already there cost nothing.
    effects : sequence of str
        Effects that may be fitted.
    origin : mapping of effect to values, optional
        Values of rendered effects about which the pictures are taken; their null when absent.
    finer : bool
        Whether to render what a finer mesh changes; nothing is taken for it otherwise.
    both : bool
        Whether to render either side of where effects stand; straight lines through one are taken otherwise.
    """
    origin = {} if origin is None else origin
    keys = [(shot.press, shot.view) for shot in shots]
    presses = list(dict.fromkeys(keys))
    settings = list(effects), origin, str(renders.folder), renders.samples, renders.seed, finer, both
    key = digest(model.digest, presses, *settings)
    # Measurements of one sensor by one plan share their pictures.
    pictures = remembered(
        _filled, key, lambda: _fill(renders, model, presses, effects, origin, finer, both), most=FILLED_KEPT
    )
    return Bank(model, shots, pictures, tuple(presses.index(k) for k in keys), origin)


_filled: dict[str, tuple["Snapshot", ...]] = {}


def cost_to_fill(given: SensorModel, shots: Sequence[Shot], effects: Sequence[str]) -> float:
    """About what it costs to `fill` a bank on one side of null, in usual pictures."""
    shown = dict.fromkeys((shot.press, shot.view) for shot in shots)
    pressed = [press for press, _ in shown if press is not None]
    ends = [_quality(given, step.effect).cost for step in _stencil(given, pressed, effects, {})]
    each = 2 + _repeats(given) + FINE.cost + sum(ends)
    return len(shown) * each + len(pressed) * 2 * (len(POSE) + 1)


def rendered_at(
    renders: Renders,
    bank: Bank,
    values: Mapping[str, Values],
    poses: Mapping[int, Array],
    sizes: Mapping[str, float],
    *,
    times: int = 1,
) -> Iterator[tuple[int, Single]]:
    """Light of shots of a bank, rendered with values of effects: their numbers, (groups, rows, columns).

    Parameters
    ----------
    values : mapping of effect to values
        Of effects that are rendered; the others leave no trace in it.
    poses : mapping of int to array
        Shots to render, by number, and the departure of their poses: x, y, depth (mm), yaw (deg).
    sizes : mapping of str to float
        By how much probes are larger than stated, relative.
    times : int
        As many pixels along each side.
    """
    model = _with(bank.model, values)
    calm = _with(bank.model, {name: own for name, own in values.items() if not _traced_anew(name)})
    lamp = _Lamp(renders, bank.model)
    for number, pose in poses.items():
        shot = bank.shots[number]
        press = shot.press
        if press is not None:
            press = resized(press, sizes.get(press.probe.text, 0.0))
            press = moved(press, pose) if pose.any() else press
        picture = bank.of(number)
        light = lamp.light(model, press, picture.view.finer(times))
        if picture.denoising is None:
            yield number, light
        elif model == calm:
            yield number, light * picture.denoising
        else:
            # Photons that go other ways bring noise of their own, which the picture's denoising leaves.
            drawn = lamp.light(calm, press, picture.view)
            quiet, repeated = drawn * picture.denoising, lamp.repeated(shot.press, picture.view)
            assert repeated is not None  # where there is a denoising there are repeats
            spread = repeated - repeated.mean(axis=0)
            yield number, quiet + denoised_change(light - drawn, drawn, quiet, spread)


def _fill(
    renders: Renders,
    given: SensorModel,
    shown: Sequence[tuple[Press | None, View]],
    effects: Sequence[str],
    origin: Mapping[str, Values],
    finer: bool,
    both: bool,
) -> tuple["Snapshot", ...]:
    pressed = [press for press, _ in shown if press is not None]
    chosen = _stencil(given, pressed, effects, origin)
    model = _with(given, origin)
    camera = given.effective_design().camera
    wider = [view.grown(MARGIN_PX, camera) for _, view in shown]
    presses = [(press, view) for (press, _), (view, _) in zip(shown, wider, strict=True)]
    repeats = _repeats(given)
    # One model after the other: what its light is shaded from is large and not kept for long.
    lamp = _Lamp(renders, given)
    for press, view in presses:
        lamp.light(model, press, view)
        if not repeats:
            lamp.light(model, press, view.finer(SHARPER))
        if press is not None:
            for _, there in around(press):
                lamp.light(model, there, view)
    for press, view in presses if finer else ():
        lamp.light(model, press, view, quality=FINE)
    for repeat in range(1, 1 + repeats):
        for press, view in presses:
            renders.basis(given, press, view, repeat=repeat)
    if any(_quality(given, step.effect) == DRAFT for step in chosen):
        for press, view in presses:
            lamp.light(model, press, view, quality=DRAFT)
    for step in chosen:
        for end in step.taken(both=both):
            varied = _with(model, {step.effect: step.ends[end]})
            for press, view in presses:
                if press is not None or not effect(step.effect).needs_touch:
                    lamp.light(varied, press, view, quality=_quality(given, step.effect))
    return tuple(
        _picture(lamp, model, press, *view, chosen, finer, both)
        for (press, _), view in zip(presses, wider, strict=True)
    )


def _stencil(
    given: SensorModel, pressed: Sequence[Press], effects: Sequence[str], origin: Mapping[str, Values]
) -> list[StencilStep]:
    return [
        step
        for e in map(effect, effects)
        for step in steps(e, e.parameters_under(given.design, pressed), origin.get(e.name))
    ]


@dataclass(frozen=True, eq=False)
class _Lamp:
    """Pictures of models that are lit by the flux of the model as given."""

    renders: Renders
    given: SensorModel
    _denoisers: dict[View, Denoiser] = field(default_factory=dict)

    def light(
        self, model: SensorModel, press: Press | None, view: View, *, quality: Quality = USUAL
    ) -> Single:
        """Light per unit flux of the model as given, (groups, rows, columns)."""
        like = self.given if _repeats(self.given) or quality == DRAFT else None
        found = self.renders.basis(model, press, view, quality=quality, like=like)
        ours, theirs = (m.effective_design().flux_mw for m in (model, self.given))
        return np.asarray(found * (ours / theirs).astype(np.float32)[:, None, None])

    def repeated(self, press: Press | None, view: View) -> Single | None:
        """Pictures of the given model with other random numbers, (repeats, groups, rows, columns)."""
        numbers = range(1, 1 + _repeats(self.given))
        if not numbers:
            return None
        return np.stack([self.renders.basis(self.given, press, view, repeat=k) for k in numbers])

    def denoiser(self, view: View) -> Denoiser:
        """Denoiser from repeated pictures of the untouched gel of the given model."""
        if view not in self._denoisers:
            untouched = self.repeated(None, view)
            assert untouched is not None
            self._denoisers[view] = fit_denoiser(untouched)
        return self._denoisers[view]


def _quality(given: SensorModel, name: str) -> Quality:
    """Quality of pictures that tell how light changes with an effect.

    Where light comes through a core, noise of the photons is taken off by pictures of the usual quality.
    """
    return DRAFT if effect(name).stage in DRAFTED and not _repeats(given) else USUAL


def _with(model: SensorModel, effects: Mapping[str, Values]) -> SensorModel:
    for name, values in effects.items():
        model = model.with_effect(AppliedEffect(name=name, values=dict(values)))
    return model


def _picture(
    lamp: _Lamp,
    model: SensorModel,
    press: Press | None,
    view: View,
    place: tuple[slice, slice],
    chosen: Sequence[StencilStep],
    finer: bool,
    both: bool,
) -> Snapshot:
    here = lamp.light(model, press, view)
    simulator = lamp.renders.simulator(model, view)
    seen = simulator.rays.hit(simulator.surface(press))
    numerical = lamp.light(model, press, view, quality=FINE) - here if finer else np.zeros_like(here)
    changes: dict[tuple[str, str], LightDerivative] = {}
    for step in chosen:
        sees = press is not None or not effect(step.effect).needs_touch

        def lit(values: Values, step: StencilStep = step) -> Single:
            varied = _with(model, {step.effect: values})
            return lamp.light(varied, press, view, quality=_quality(lamp.given, step.effect))

        near = lamp.light(model, press, view, quality=_quality(lamp.given, step.effect)) if sees else here
        taken = {end: lit(step.ends[end]) if sees else here for end in step.taken(both=both)}
        for number, p in enumerate(step.parameters):
            group = model.design.group_names.index(p.group) if p.group else None
            ends = [(light, step.reached[end][number]) for end, light in taken.items()]
            if step.product:
                usual = lit(step.usual) if sees else here
                changes[step.effect, p.name] = replace(_quadratic(usual, ends, group), product=True)
            else:
                changes[step.effect, p.name] = _quadratic(near, ends, group)
    pose: tuple[LightDerivative, ...] = ()
    size = None
    if press is not None:
        beside = [(lamp.light(model, there, view), s) for s, there in around(press)]
        *of_pose, size = (_quadratic(here, beside[k : k + 2], None) for k in range(0, len(beside), 2))
        pose = tuple(of_pose)
    found = Snapshot(
        light=here,
        view=view,
        place=place,
        seen_mm=seen,
        numerical=numerical,
        pitch_mm=simulator.rays.pitch_mm,
        pose=pose,
        size=size,
        changes=changes,
    )
    repeated = lamp.repeated(press, view)
    if repeated is None:
        return replace(found, sharp=lamp.light(model, press, view.finer(SHARPER)))
    mean = repeated.mean(axis=0)
    spread = repeated - mean
    denoiser = lamp.denoiser(view)
    drawn, quiet = lamp.light(lamp.given, press, view), denoiser.factor * mean
    own = (1.0 + share_of(quiet - drawn, drawn)).astype(np.float32)
    return replace(
        found,
        light=own * here,
        numerical=own * numerical,
        pose=tuple(_times(change, own) for change in pose),
        size=None if size is None else _times(size, own),
        changes={
            key: _denoised(change, drawn, quiet, spread) if _traced_anew(key[0]) else _times(change, own)
            for key, change in changes.items()
        },
        spread=spread - mean * denoiser.removed,
        denoising=own,
    )


def _repeats(given: SensorModel) -> int:
    """How often the pictures of the given model are rendered with other random numbers."""
    return REPEATS if given.effective_design().optics.light_path == "core" else 0


def _traced_anew(name: str) -> bool:
    """Whether an effect sends photons elsewhere, so that noise does not cancel in its changes."""
    return effect(name).stage in ("emission", "transport")


def _times(change: LightDerivative, factor: Single) -> LightDerivative:
    own = factor if change.group is None else factor[change.group]
    return replace(change, first=change.first * own, second=change.second * own)


def _denoised(change: LightDerivative, drawn: Single, quiet: Single, spread: Single) -> LightDerivative:
    groups = slice(None) if change.group is None else [change.group]

    def clean(image: Single) -> Single:
        stack = image.reshape(-1, *quiet.shape[1:])
        return denoised_change(stack, drawn[groups], quiet[groups], spread[:, groups]).reshape(image.shape)

    return replace(change, first=clean(change.first), second=clean(change.second))


def _quadratic(here: Single, sides: Sequence[tuple[Single, float]], group: int | None) -> LightDerivative:
    """Quadratic through the light here and at two other places, or a straight line to a single one."""
    chosen = slice(None) if group is None else group
    (a, s), *other = ((light[chosen] - here[chosen], at) for light, at in sides)
    if not other:
        return LightDerivative(np.ascontiguousarray(a / np.float32(s)), np.zeros_like(a), group, abs(s))
    ((b, t),) = other
    second = (b / np.float32(t) - a / np.float32(s)) / np.float32(t - s)
    first = a / np.float32(s) - np.float32(s) * second
    reach = max(abs(s), abs(t))
    return LightDerivative(np.ascontiguousarray(first), np.ascontiguousarray(second), group, reach)


def around(press: Press) -> Iterator[tuple[float, Press]]:
    """Presses one step to either side along each pose coordinate, and with a smaller and a larger probe."""
    for axis, name in enumerate(POSE):
        alike = name == "yaw_deg" and press.probe.is_round and not press.moves_sideways
        for sign in (-1.0, 1.0):
            step = sign * np.eye(len(POSE))[axis] * POSE_STEP
            yield sign, press if alike else moved(press, step)
    for sign in (-1.0, 1.0):
        yield sign, resized(press, sign * SIZE_STEP)


def resized(press: Press, larger: float) -> Press:
    """Scale the probe of a press by one and this."""
    return press.model_copy(update={"probe": press.probe.scaled(1.0 + float(np.round(larger, 6)))})


def moved(press: Press, pose: Array) -> Press:
    """Shift, deepen and turn a press by x, y, depth (mm) and yaw (deg)."""
    return press.moved(*(float(v) for v in np.round(pose, 6)))
