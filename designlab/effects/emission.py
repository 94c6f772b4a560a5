"""Effects of the light sources."""

from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from designlab.design import Design
from designlab.effects.base import Effect, Parameter, Stage, Values
from designlab.scene import Light, Scene, Shape

FloatArray = NDArray[np.float64]


class LedPosition(Effect):
    """Every row of LEDs sits off its nominal place by the same radial, axial and tangential distance."""

    name: ClassVar[str] = "led_position"
    stage: ClassVar[Stage] = "emission"
    summary: ClassVar[str] = "LED rows stand off their nominal place"
    transferable: ClassVar[bool] = False

    def parameters(self, design: Design) -> tuple[Parameter, ...]:
        """Three distances; 0.3 mm is a circuit board's tolerance, 1 mm a hand assembly's.

        LEDs bonded to the core have no radial play that light could tell: glue of the core's index fills it.
        """
        return tuple(
            Parameter(f"{direction}_mm", "mm", 0.0, 0.5, -3.0, 3.0, meaning)
            for direction, meaning in (
                ("radial", "away from the axis"),
                ("height", "towards the camera"),
                ("tangential", "counter-clockwise around the axis"),
            )
            if direction != "radial" or design.leds.coupling != "bonded"
        )

    def on_scene(self, scene: Scene, values: Values) -> Scene:
        """Move emitters and their boards."""
        if not any(values.values()):
            return scene
        lights = tuple(self._moved_light(light, values) for light in scene.lights)
        shapes = tuple(
            self._moved_board(s, values) if s.name.startswith("board") else s for s in scene.shapes
        )
        return replace(scene, lights=lights, shapes=shapes)

    def _moved_light(self, light: Light, values: Values) -> Light:
        x, y, z = np.asarray(light.centre_mm) + _shift(np.asarray(light.normal), values)
        return replace(light, centre_mm=(float(x), float(y), float(z)))

    def _moved_board(self, board: Shape, values: Values) -> Shape:
        a, b, c = board.vertices[board.faces[0]]
        return replace(board, vertices=board.vertices + _shift(np.cross(b - a, c - a), values))


def _shift(facing: FloatArray, values: Values) -> FloatArray:
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
