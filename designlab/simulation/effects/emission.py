"""Effects of the light sources."""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import groupby, islice
from typing import ClassVar

import numpy as np

from designlab.core.types import Array
from designlab.sensor.design import Design, DesignError
from designlab.sensor.led_mounting import FACING
from designlab.simulation.effects.base import Effect, EffectParameter, Part, Stage, Values
from designlab.simulation.scene.scene import Light, Scene, Shape
from geometries.leds import bodies, emitters, joined_groups

Way = Callable[[Light], Light]
FACES_OF_A_FRONT = 2  # triangles of a board; a package cast into the core is a closed box


class LedSpread(Effect):
    """The LEDs of a group differ in brightness."""

    name: ClassVar[str] = "led_spread"
    stage: ClassVar[Stage] = "emission"
    summary: ClassVar[str] = "LEDs of one group differ in brightness"
    changes: ClassVar[tuple[Part, ...]] = ("scene",)
    transferable: ClassVar[bool] = False  # other LEDs from the bin

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """One for each face of a group but its last; a bin is 10 to 15 % wide (data sheet OSXX0402C1C)."""
        return tuple(
            EffectParameter(
                f"{group}_{number}",
                "1",
                0.0,
                0.12,
                -1.0,
                1.0,
                "excess of the flux of a face over the mean of its group; -1 is dead",
                group=group,
            )
            for group, count in _faces(design).items()
            for number in range(1, count)
        )

    def on_scene(self, scene: Scene, values: Values) -> Scene:
        """Scale the radiance of every face; a group's last face has what the others leave of its flux.

        What all faces of a group have in common is its gain, which nothing tells from reflectance.

        Raises
        ------
        DesignError
            If nothing is left for the last face of a group.
        """
        factors = [1.0 + excess for group in _excesses(scene, values) for excess in group]
        lights = tuple(
            replace(light, radiance=light.radiance * factor)
            for light, factor in zip(scene.lights, factors, strict=True)
        )
        return replace(scene, lights=lights)


class LedProfile(Effect):
    """The LEDs' light spreads over other angles than assumed."""

    name: ClassVar[str] = "led_profile"
    stage: ClassVar[Stage] = "emission"
    summary: ClassVar[str] = "the beam of the LEDs is wider or narrower"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # optics of the kind of LED

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Exponent of the cosine for each group without a table; 120 to 150 deg beams have 1 to 0.5."""
        powers = {g.name: design.leds.profile_of(k).power for k, g in enumerate(design.leds.groups)}
        return tuple(
            EffectParameter(
                f"{name}_exponent",
                "1",
                power,
                0.3,
                min(0.3, power),
                max(20.0, 2 * power),
                "cos^m of the beam",
                group=name,
            )
            for name, power in powers.items()
            if power is not None
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Give groups their exponent."""
        changes = {
            f"leds.groups.{k}.profile": {"exponent": values[f"{group.name}_exponent"]}
            for k, group in enumerate(design.leds.groups)
            if values.get(f"{group.name}_exponent", design.leds.profile_of(k).power)
            != design.leds.profile_of(k).power
        }
        return design.replace(changes) if changes else design


class LedTilt(Effect):
    """The LEDs of a group shine in another direction: each is turned about the middle of its front.

    Groups that share packages turn together.
    """

    name: ClassVar[str] = "led_tilt"
    stage: ClassVar[Stage] = "emission"
    summary: ClassVar[str] = "LEDs shine in another direction"
    changes: ClassVar[tuple[Part, ...]] = ("scene",)
    transferable: ClassVar[bool] = False  # how boards were set
    # Light bends with these angles, at 9 deg by an eighth: pictures at 3 deg are combined badly there.
    step_sd: ClassVar[float] = 2.0

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Two angles for each group; boards set by hand stand to some 3 deg (estimate).

        LEDs bonded to the core have no such play.
        """
        if design.leds.coupling == "bonded":
            return ()
        names = design.group_names
        together = [[names[g] for g in held] for held in joined_groups(b.groups for b in bodies(design.leds))]
        return tuple(
            EffectParameter(
                f"{'_'.join(own)}_{way}_deg",
                "deg",
                0.0,
                3.0,
                -20.0,
                20.0,
                meaning,
                group=own[0] if len(own) == 1 else "",
            )
            for own in together
            for way, meaning in (
                ("tilt", "beam turned towards the membrane"),
                ("turn", "beam turned about the face's height, counter-clockwise from above"),
            )
        )

    def on_scene(self, scene: Scene, values: Values) -> Scene:
        """Turn every LED with its board."""
        if not any(values.values()):
            return scene
        joined = joined_groups(_held(scene).values())
        each = np.radians(list(values.values())).reshape(-1, 2)
        angles = {group: pair for held, pair in zip(joined, each, strict=True) for group in held}

        def turned(board: Shape, light: Light) -> tuple[Shape, Way]:
            if not angles[light.group].any():
                return board, lambda light: light
            turn, middle = _turn(light, *angles[light.group]), board.vertices[:4].mean(axis=0)
            vertices = middle + (board.vertices - middle) @ turn.T
            return replace(board, vertices=vertices), lambda light: _turned(light, turn, middle)

        return _with_boards(scene, turned)


def _with_boards(scene: Scene, mounted: Callable[[Shape, Light], tuple[Shape, Way]]) -> Scene:
    """Mount every board otherwise, its LEDs with it; asked with the board and the first of its LEDs."""
    boards = {shape.name: shape for shape in scene.shapes}
    ways: dict[str, Way] = {}
    moved: dict[str, Shape] = {}
    for light in scene.lights:
        if light.board not in ways:
            moved[light.board], ways[light.board] = mounted(boards[light.board], light)
    lights = tuple(ways[light.board](light) for light in scene.lights)
    shapes = tuple(moved.get(shape.name, shape) for shape in scene.shapes)
    return replace(scene, lights=lights, shapes=shapes)


def _held(scene: Scene) -> dict[str, set[int]]:
    """Groups whose LEDs each board carries."""
    held: dict[str, set[int]] = {}
    for light in scene.lights:
        held.setdefault(light.board, set()).add(light.group)
    return held


def _turn(light: Light, tilt: float, turn: float) -> Array:
    """Rotation by tilt, from the normal to `down`, then by turn, from `across` to the normal (radians)."""
    axes = np.array([light.across, light.down, light.normal])
    sin, cos = np.sin(tilt), np.cos(tilt)
    tilted = np.array([[1.0, 0.0, 0.0], [0.0, cos, sin], [0.0, -sin, cos]])
    sin, cos = np.sin(turn), np.cos(turn)
    turned = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
    return np.asarray(axes.T @ turned @ tilted @ axes)


def _turned(light: Light, turn: Array, middle: Array) -> Light:
    return replace(
        light,
        centre_mm=_vector(middle + turn @ (np.asarray(light.centre_mm) - middle)),
        normal=_vector(turn @ light.normal),
        across=_vector(turn @ light.across),
        down=_vector(turn @ light.down),
    )


def _vector(axis: Array) -> tuple[float, float, float]:
    x, y, z = (float(c) for c in axis)
    return x, y, z


class LedPosition(Effect):
    """Every row of LEDs sits off its nominal place by the same radial, axial and tangential distance."""

    name: ClassVar[str] = "led_position"
    stage: ClassVar[Stage] = "emission"
    summary: ClassVar[str] = "LED rows stand off their nominal place"
    changes: ClassVar[tuple[Part, ...]] = ("scene",)
    transferable: ClassVar[bool] = False  # how boards were set

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Three distances; 0.3 mm is a circuit board's tolerance, 1 mm a hand assembly's.

        LEDs bonded to the core have no radial play that light could tell: glue of the core's index fills it.
        """
        return tuple(
            EffectParameter(f"{direction}_mm", "mm", 0.0, 0.5, -3.0, 3.0, meaning)
            for direction, meaning in (
                ("radial", "away from the axis"),
                ("height", "towards the camera"),
                ("tangential", "counter-clockwise around the axis"),
            )
            if direction != "radial" or design.leds.coupling != "bonded"
        )

    def on_scene(self, scene: Scene, values: Values) -> Scene:
        """Move every board with its emitters; one that is bonded stays joined to the core's side."""
        if not any(values.values()):
            return scene
        front = next(shape for shape in scene.shapes if shape.name.startswith("board"))
        bonded = scene.lights[0].inside and len(front.faces) == FACES_OF_A_FRONT

        def shifted(board: Shape, light: Light) -> tuple[Shape, Way]:
            facing = np.asarray(light.normal)
            shift = _shift(facing, values)
            if bonded:
                shift = shift + _way_back_mm(scene, board.vertices, shift, facing) * facing
            moved = replace(board, vertices=board.vertices + shift)
            return moved, lambda light: replace(light, centre_mm=_vector(light.centre_mm + shift))

        return _with_boards(scene, shifted)


def _way_back_mm(scene: Scene, corners: Array, shift: Array, facing: Array) -> float:
    """Way along its normal that puts a shifted board as deep into the core's side as it was."""
    ways: list[tuple[float, float]] = []
    for side in (shape for shape in scene.shapes if shape.name.startswith("core-side")):
        a, b, c = side.vertices[side.faces[0]]
        outward = np.cross(b - a, c - a)
        outward *= np.sign(outward[:2] @ a[:2]) / np.linalg.norm(outward)
        along = -float(outward @ facing)
        if along > FACING:
            before, after = (float(((at - a) @ outward).max()) for at in (corners, corners + shift))
            ways.append((before / along, after / along))
    return max(after for _, after in ways) - max(before for before, _ in ways) if ways else 0.0


def _shift(facing: Array, values: Values) -> Array:
    """Displacement of a row whose emitting side faces `facing`, the axis; outwards is its reverse."""
    outward = -facing[:2] / np.hypot(*facing[:2])
    radial, tangential = values.get("radial_mm", 0.0), values["tangential_mm"]
    return np.array(
        [
            radial * outward[0] - tangential * outward[1],
            radial * outward[1] + tangential * outward[0],
            values["height_mm"],
        ]
    )


def _faces(design: Design) -> dict[str, int]:
    """Number of emitting faces of each group."""
    count = Counter(face.group for face in emitters(design.leds))
    return {name: count[number] for number, name in enumerate(design.group_names)}


def _excesses(scene: Scene, values: Values) -> Iterator[list[float]]:
    """Relative excess of every face of each group, in the order of the lights."""
    own = iter(values.items())
    for _, lights in groupby(scene.lights, key=lambda light: light.group):
        *others, final = [light.flux_mw for light in lights]
        named = dict(islice(own, len(others)))
        last = -sum(v * flux for v, flux in zip(named.values(), others, strict=True)) / final
        if last < -1.0:
            stated = ", ".join(f"{name} {value:g}" for name, value in named.items())
            raise DesignError(f"led_spread: {stated}: nothing of the flux is left for the group's last face")
        yield [*named.values(), last]


EFFECTS: tuple[Effect, ...] = (LedSpread(), LedProfile(), LedTilt(), LedPosition())
"""In the order in which they act."""
