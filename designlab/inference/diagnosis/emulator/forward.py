"""What a state of the model predicts for a shot, and by how much each unknown changes it."""

from collections.abc import Mapping, Sequence

import numpy as np

from designlab.core.memory import remembered
from designlab.core.types import Array, Single
from designlab.inference.diagnosis.emulator.camera_response import Answers
from designlab.inference.diagnosis.emulator.snapshots import (
    POSE_STEP,
    SHARPER,
    SIZE_STEP,
    Bank,
    Snapshot,
    binned,
)
from designlab.inference.diagnosis.emulator.state import FRINGES, SIZE, Key, State, Unknown
from designlab.inference.diagnosis.emulator.warps import Warps, turning
from designlab.measurement.shots import POSE
from designlab.sensor.design import DesignError
from designlab.simulation.effects import CATALOGUE, Effect, EffectParameter, Sight, effect
from designlab.simulation.effects.base import Light
from designlab.simulation.imaging import Capture, clipped, expected, mixed, uncut

HALF_STEP = 0.25  # of a prior standard deviation: differences of effects that are not rendered
EDGES_KEPT = 64  # a fit asks for those of all its shots twice, at every step


class Forward:
    """Predicts shots from a bank of pictures.

    Parameters
    ----------
    bank : Bank
        The pictures.
    """

    def __init__(self, bank: Bank) -> None:
        self.bank = bank
        self.design = bank.model.effective_design()
        self._warps = Warps(self.design)
        self.answers = Answers(bank.model, self.design)
        self._edged: dict[tuple[int, Key], tuple[Light, Light] | None] = {}
        self.flux = self.design.flux_mw
        presses = [shot.press for shot in bank.shots if shot.press is not None]
        given = bank.model.design
        self.parameters: dict[str, tuple[EffectParameter, ...]] = {
            e.name: (*e.parameters_under(given, presses), *e.finer_parameters(given)) for e in CATALOGUE
        }

    @property
    def black(self) -> Array:
        """Signal of the three channels without light, by the model as given."""
        return expected(np.zeros(3), Capture(self.design.camera, self.bank.model))

    def predict(self, state: State, number: int) -> Array:
        """Signal of a shot, (rows, columns, 3)."""
        seen, _ = self._seen(state, number, self.light(state, number))
        return self._of_optics(state, number, self._after_warp(state, number, seen))

    def untouched(self, state: State, number: int) -> Array:
        """Signal that a shot would have without a press, effects on light transport left aside."""
        view = self.bank.shots[number].view
        bare = (n for n, shot in enumerate(self.bank.shots) if shot.press is None and shot.view == view)
        warped = self._warped(state, number, self.bank.of(next(bare, number)).light)
        return self._of_optics(state, number, self._after_warp(state, number, warped))

    def of_groups(self, state: State, number: int) -> Array:
        """Signal that each LED group adds to a shot, (groups, rows, columns, 3)."""
        gains = [Unknown("gain", name, 1.0) for name in self.design.group_names]
        slopes = self.linear(state, number, gains)[1]
        return np.asarray(slopes * state.gains[:, None, None, None])

    def light(self, state: State, number: int) -> Single:
        """Light of every group in front of the camera, before what the camera's optics do.

        Like all light before these, it is of the wider view of a picture.
        """
        picture = self.bank.of(number)
        light = picture.light + np.float32(state.numerical) * picture.numerical
        for name, values in state.values.items():
            at = self.coordinates(name, values)
            main = next((at[p.name] for p in self.parameters[name] if not p.shape), 0.0)
            for p in self.parameters[name]:
                change = picture.changes.get((name, p.name))
                if change is not None and at[p.name]:
                    change.added(light, at[p.name], main if change.product else 1.0)
        pose = self.pose(state, number) / POSE_STEP
        for change, t in zip(picture.pose, pose, strict=False):
            if t:
                change.added(light, t)
        if picture.size is not None and (larger := state.sizes.get(self._probe(number), 0.0)):
            picture.size.added(light, larger / SIZE_STEP)
        if picture.stand is not None:
            light += np.float32(picture.stand.share(pose)) * picture.stand.error
        return light

    def coordinates(self, name: str, values: Mapping[str, float]) -> dict[str, float]:
        """Coordinates of values from where the bank stands."""
        origin = self.bank.origin.get(name, {})
        return {
            p.name: p.coordinate(values[p.name]) - p.coordinate(origin.get(p.name, p.null))
            for p in self.parameters[name]
            if p.name in values
        }

    def values(self, state: State, name: str) -> Mapping[str, float]:
        """Values of an effect in a state: its null where the state has none."""
        return state.values.get(name) or effect(name).null(self.bank.model.design)

    def parameter(self, unknown: Unknown) -> EffectParameter:
        """Parameter of an effect that an unknown is."""
        return next(p for p in self.parameters[unknown.effect] if p.name == unknown.name)

    def pose(self, state: State, number: int) -> Array:
        """Departure of a shot's pose; what effects add to all poses is part of it."""
        pose = state.pose(number).copy()
        for name, values in state.values.items():
            for parameter, axis in effect(name).reposes.items():
                pose[POSE.index(axis)] += values[parameter]
        return pose

    def _probe(self, number: int) -> str:
        """Text of the probe of a shot; empty without a press."""
        press = self.bank.shots[number].press
        return "" if press is None else press.probe.text

    def sight(self, state: State, number: int, *, wide: bool = False) -> Sight:
        """What effects on the light of a shot, or of its picture's wider view, need to know."""
        shot, picture = self.bank.shots[number], self.bank.of(number)
        view, (x, y) = shot.view, picture.seen_mm
        if wide:
            view = picture.view
        else:
            x, y = x[picture.place], y[picture.place]
        return Sight(self.design, view, (x, y), picture.pitch_mm, shot.gel_rotation_deg)

    def _warped(self, state: State, number: int, light: Light, *, straight: bool = False) -> Light:
        """Light as the camera of a state sees it, before what its optics and sensor do; of the wider view.

        Many pictures at once are resampled by straight lines between pixels, which is faster.
        """
        sight = self.sight(state, number, wide=True)
        for e in CATALOGUE:
            if e.stage != "camera" and e.name in state.values:
                light = e.on_light(light, state.values[e.name], sight)
        warp = self._warps.between((), turning(state.values), sight.view)
        if warp is None:
            return light
        return warp.straight(light) if straight else warp(light)

    def _seen(self, state: State, number: int, light: Single) -> tuple[Light, Light | None]:
        """Light of one picture as the camera of a state sees it, of the wider view; what sharp pictures give.

        Edges are resampled less well than smooth light: what a sharper picture shows of them is put right.
        """
        warped, edges = self._warped(state, number, light), self._edges(state, number)
        if edges is None:
            return warped, None
        sharp, blunt = edges
        return np.asarray(warped + sharp - blunt, dtype=np.float32), sharp

    def _edges(self, state: State, number: int) -> tuple[Light, Light] | None:
        """Nominal light as the camera of a state sees it, by a sharper and by a usual picture.

        The light of a fit changes at every step, edges where its camera does alone.
        """
        picture, looks = self.bank.of(number), turning(state.values)

        def edged() -> tuple[Light, Light] | None:
            blunt, sharp = picture.blunt, self._sharp(state, number)
            warp = self._warps.between((), looks, picture.view)
            return None if warp is None or sharp is None or blunt is None else (sharp, warp(blunt))

        return remembered(self._edged, (self.bank.place[number], looks), edged, most=EDGES_KEPT)

    def _sharp(self, state: State, number: int, *, straight: bool = False) -> Light | None:
        """Nominal light as the camera of a state sees it, by a sharper picture; None where none is needed."""
        picture, looks = self.bank.of(number), turning(state.values)
        if picture.sharp is None:
            return None
        warp = self._warps.between((), looks, picture.view.finer(SHARPER))
        if warp is None:
            return None
        return binned(warp.straight(picture.sharp) if straight else warp(picture.sharp))

    def _after_warp(self, state: State, number: int, light: Light) -> Light:
        """Light of the shot's own view after what the camera's optics and sensor do."""
        sight = self.sight(state, number)
        light = light[:, *self.bank.of(number).place]
        for e in CATALOGUE:
            if e.stage == "camera" and e.name in state.values:
                light = e.on_light(light, state.values[e.name], sight)
        return np.asarray(light * self._of_one_shot(state, number))

    def _of_one_shot(self, state: State, number: int) -> Array | float:
        """Factor on the light of a shot by what it has alone."""
        factor: Array | float = 1.0
        for name, values in state.values.items():
            own = state.drawn.get(name, {}).get(number)
            if own is not None:
                waves = effect(name).waves(self.bank.shots[number].view, values)
                change = np.tensordot(own, waves, axes=1)
                # A plain number leaves light in single precision.
                factor = factor * (1.0 + (change.item() if change.size == 1 else change))
        return factor

    def weights(self, state: State, number: int) -> Array:
        """Signal of each channel per unit of each group's radiance at unit flux, (3, groups)."""
        mixing = self.design.mixing_matrix
        for name, values in state.values.items():
            mixing = effect(name).on_mixing(mixing, self.design, values)
        return np.asarray(mixing * self.flux * state.gains * self.bank.shots[number].lit)

    def _of_optics(self, state: State, number: int, optics: Light) -> Array:
        channels = mixed(optics, self.weights(state, number))
        if state.fringes:
            channels = channels + state.fringes * self._fringes(number, channels)
        reported = self.answers.reported(state.values, channels * _pattern(state))
        return clipped(reported, self.bank.shots[number].clip_sigma)

    def _fringes(self, number: int, channels: Light) -> Array:
        """Change of a picture, (rows, columns, 3), per share by which red is magnified more and blue less.

        Lateral colour moves light by less than a pixel, so that the picture's slope tells it.
        """
        view = self.bank.shots[number].view
        column, row = view.centres()
        x_c, y_c = self.design.camera.centre_px
        across = (column - x_c) * view.columns / view.width_px
        down = (row - y_c) * view.rows / view.height_px
        slope_down, slope_across = np.gradient(channels, axis=(0, 1))
        outwards = across[..., None] * slope_across + down[..., None] * slope_down
        return np.asarray(outwards * np.array([-1.0, 0.0, 1.0]))

    def linear(self, state: State, number: int, unknowns: Sequence[Unknown]) -> tuple[Array, Single]:
        """Signal of a shot, and its derivatives per prior standard deviation, (n, rows, columns, 3)."""
        picture, shot = self.bank.of(number), self.bank.shots[number]
        rows, width = shot.view.rows, shot.view.columns
        found = np.zeros((len(unknowns), rows, width, 3), dtype=np.float32)
        light = self.light(state, number)
        warped, sharp = self._seen(state, number, light)
        optics = self._after_warp(state, number, warped)
        here = self._of_optics(state, number, optics)
        if not unknowns or not (shot.lit.any() or any(u.effect in self.answers.effects for u in unknowns)):
            return here, found
        slopes: dict[int, Single] = {}  # of the light, by the place of the unknown
        looks: dict[int, Single] = {}
        mixing = self.weights(state, number)
        gain = self._slope(state, mixing, optics, shot.clip_sigma)
        for place, unknown in enumerate(unknowns):
            if unknown.shot not in (-1, number):
                continue
            if unknown.effect == SIZE and unknown.name != self._probe(number):
                continue
            slope = self._light_slope(state, number, unknown, picture)
            if slope is not None:
                slopes[place] = slope * np.float32(unknown.sd)
            elif unknown.effect == "gain":
                group = self.design.group_names.index(unknown.name)
                part = mixing[:, group, None, None] * optics[group] / state.gains[group]
                found[place] = unknown.sd * np.moveaxis(part, 0, -1) * gain
            elif unknown.effect == FRINGES:
                channels = mixed(optics, mixing)
                found[place] = unknown.sd * self._fringes(number, channels) * gain
            elif unknown.shot == number:  # poses, which shots have alone too, are slopes of the light
                waves = effect(unknown.effect).waves(shot.view, self.values(state, unknown.effect))
                part = np.tensordot(mixing, optics * waves[int(unknown.name)], axes=1)
                found[place] = unknown.sd * np.moveaxis(part, 0, -1) * gain
            elif effect(unknown.effect).warps:
                looks[place] = self._look_slope(state, number, unknown, warped, sharp)
            else:
                found[place] = self._difference(state, number, unknown, (light, warped, optics))
        changes: list[Light] = [*looks.values()]
        if slopes:
            changes.append(self._warped(state, number, np.concatenate([*slopes.values()]), straight=True))
        if changes:
            pushed = self._after_warp(state, number, np.concatenate(changes))
            pushed = pushed.reshape(-1, len(mixing[0]), rows, width)
            channels = np.tensordot(mixing, pushed, axes=([1], [1]))  # (3, n, rows, columns)
            found[[*looks, *slopes]] = channels.transpose(1, 2, 3, 0) * gain
        return here, found

    def _look_slope(
        self, state: State, number: int, unknown: Unknown, warped: Light, sharp: Light | None
    ) -> Single:
        """Change of the light by a parameter that turns where pixels look, of the wider view.

        Every pixel takes the light a little beside its own. The steps are as wide as the errors that are
        looked for: a tangent would lose an edge that is pixels away. `sharp` is the part of the light that
        sharper pictures show, where they show another than the nominal one.
        """
        view, here = self.bank.of(number).view, turning(state.values)
        if sharp is None:
            sharp = self.bank.of(number).blunt
        rest = warped if sharp is None else warped - sharp
        p = self.parameter(unknown)
        values = self.values(state, unknown.effect)
        ends = []
        for step in (-HALF_STEP, HALF_STEP):
            there: Mapping[str, float] = {**values, p.name: p.value_at(p.coordinate(values[p.name]) + step)}
            try:
                warp = self._warps.between(here, turning({**state.values, unknown.effect: there}), view)
            except DesignError:  # no lens turns back within the picture
                there, warp = values, None
            # Errors of straight lines between pixels cancel in a difference.
            shown = rest if warp is None else warp.straight(rest)
            if sharp is not None:
                other = self._sharp(state.with_values(unknown.effect, there), number, straight=True)
                shown = shown + (sharp if other is None else other)
            ends.append((shown, p.coordinate(there[p.name])))
        (low, start), (high, end) = ends
        return np.asarray((high - low) / np.float32(end - start), dtype=np.float32)

    def _slope(self, state: State, mixing: Array, optics: Light, sigma: Array) -> Array:
        """Derivative of the reported signal by the mixed light, (rows, columns, 3)."""
        channels = mixed(optics, mixing) * _pattern(state)
        slope = uncut(self.answers.reported(state.values, channels), sigma)
        if self.answers.curved(state.values):
            step = 1e-3 * max(float(channels.max()), 1e-3)
            ends = (
                self.answers.reported(state.values, channels - step),
                self.answers.reported(state.values, channels + step),
            )
            slope = slope * (ends[1] - ends[0]) / (2 * step)
        return slope * _pattern(state) * (channels > 0.0)

    def _light_slope(self, state: State, number: int, unknown: Unknown, picture: Snapshot) -> Single | None:
        """Derivative of the light by a pose or a rendered parameter; None for all others."""
        shape = picture.light.shape
        if unknown.effect == "numerical":
            return picture.numerical
        if unknown.effect == SIZE and picture.size is not None:
            larger = state.sizes.get(unknown.name, 0.0) / SIZE_STEP
            return picture.size.slope(shape, larger) / np.float32(SIZE_STEP)
        reposes = effect(unknown.effect).reposes if unknown.effect in self.parameters else {}
        moved = unknown.name if unknown.effect == "pose" else reposes.get(unknown.name)
        if moved is not None:
            if not picture.pose:
                return np.zeros(shape, dtype=np.float32)
            axis = POSE.index(moved)
            pose = self.pose(state, number) / POSE_STEP
            slope = picture.pose[axis].slope(shape, float(pose[axis]))
            if picture.stand is not None:
                slope += picture.stand.slope(pose, axis)
            return slope / np.float32(POSE_STEP[axis])
        change = picture.changes.get((unknown.effect, unknown.name))
        if change is None:
            return None
        p = self.parameter(unknown)
        values = self.values(state, unknown.effect)
        at = self.coordinates(unknown.effect, values)
        main = next(at[q.name] for q in self.parameters[unknown.effect] if not q.shape)
        if change.product:
            return np.float32(main) * change.slope(shape, at[p.name]) / np.float32(p.sd)
        slope = change.slope(shape, at[p.name])
        for q in self.parameters[unknown.effect]:
            cross = picture.changes.get((unknown.effect, q.name))
            if cross is not None and cross.product and not p.shape:
                cross.added(slope, at[q.name])
        return slope / np.float32(p.sd)

    def _difference(
        self, state: State, number: int, unknown: Unknown, stages: tuple[Single, Light, Light]
    ) -> Array:
        """Change of the signal per standard deviation of a parameter that is not rendered.

        `stages` is the light in front of the camera, as the camera sees it, and behind its optics.
        """
        changing = effect(unknown.effect)
        p = self.parameter(unknown)
        values = dict(self.values(state, unknown.effect))
        now = p.coordinate(values[p.name])
        far = 1.0 if p.squared and now == 0 else HALF_STEP
        start, end = (0.0, far) if p.one_sided and now < far else (-far, far)
        low, high = (
            self._again(
                state.with_values(unknown.effect, values | {p.name: p.value_at(now + step)}),
                number,
                changing,
                stages,
            )
            for step in (start, end)
        )
        return (high - low) / (end - start)

    def _again(
        self, state: State, number: int, changing: Effect, stages: tuple[Single, Light, Light]
    ) -> Array:
        """Signal of a state that differs in one effect from one whose light is known at every stage."""
        light, warped, optics = stages
        if "light" in changing.changes:
            if changing.stage != "camera":
                # Errors of straight lines between pixels cancel in a difference.
                warped = self._warped(state, number, light, straight=True)
            optics = self._after_warp(state, number, warped)
        return self._of_optics(state, number, optics)


def _pattern(state: State) -> Array | float:
    """Factor of the patterns that all shots carry."""
    factor: Array | float = 1.0
    for name, pattern in state.patterns.items():
        if name in state.values:
            factor = factor * (1.0 + state.values[name][effect(name).per_pixel] * pattern)
    return factor
