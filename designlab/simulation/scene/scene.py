"""A design and a membrane as plain data: meshes, materials, lights and camera. Knows no rendering engine."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from designlab.sensor.camera import Camera, View
from designlab.sensor.design import Design
from designlab.sensor.led_mounting import seated
from designlab.simulation.contact.surface import Surface
from designlab.simulation.scene.materials import (
    Ball,
    Coating,
    Dielectric,
    Diffuse,
    Medium,
    Metal,
    Shape,
    Texture,
)
from designlab.simulation.scene.membrane import membrane
from designlab.simulation.scene.static_parts import board_name, boards, core_and_gel, housing_inside, seats
from geometries.emission import AngularProfile

__all__ = [
    "Ball", "Coating", "Dielectric", "Diffuse", "Light", "Medium", "Metal", "Scene", "Shape", "Texture",
    "build", "without_gel",
]  # fmt: skip

LED_FACE_GAP_MM = 1e-3  # strips shine just above their board, so that the two never fight for a ray


@dataclass(frozen=True)
class Light:
    """Emitting rectangle of one LED group.

    `radiance` (mW/mm2/sr), when the whole group emits 1 mW, is that of a Lambertian face of the same flux;
    `profile` says how the flux spreads over directions, around `normal` and from `across` towards `down`.
    `inside` is true where it shines from within the core. `board` is the name of the shape that carries it,
    which follows from the place, so that digests leave it out.
    """

    group: int
    centre_mm: tuple[float, float, float]
    normal: tuple[float, float, float]
    across: tuple[float, float, float]
    down: tuple[float, float, float]
    half_width_mm: float
    half_height_mm: float
    radiance: float
    profile: AngularProfile = field(default_factory=AngularProfile)
    inside: bool = False
    board: str = field(default="", repr=False)

    @property
    def flux_mw(self) -> float:
        """What the face emits when its whole group nominally emits 1 mW."""
        return float(4 * np.pi * self.radiance * self.half_width_mm * self.half_height_mm)


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything a renderer needs, in mm, in the sensor frame."""

    shapes: tuple[Shape, ...]
    lights: tuple[Light, ...]
    groups: int
    camera: Camera
    view: View
    path_length: int
    balls: tuple[Ball, ...] = ()

    @property
    def membrane(self) -> Shape:
        """The reflective membrane."""
        return next(shape for shape in self.shapes if shape.name == "membrane")

    @property
    def refracts(self) -> bool:
        """Whether light crosses a dielectric boundary on its way."""
        return any(isinstance(shape.material, Dielectric) for shape in self.shapes)

    @property
    def digest(self) -> str:
        """SHA-256 of the content, arrays by their bytes."""
        return hashlib.sha256(repr((self.light_digest, self.camera, self.view)).encode()).hexdigest()

    @cached_property
    def light_digest(self) -> str:
        """SHA-256 of all but the camera: what light on the membrane depends on."""
        state = hashlib.sha256()
        for shape in self.shapes:
            state.update(repr((shape.name, shape.material)).encode())
            for array in (shape.vertices, shape.faces, shape.normals):
                if array is not None:
                    state.update(
                        repr((array.shape, str(array.dtype))).encode() + np.ascontiguousarray(array).tobytes()
                    )
        state.update(repr((self.lights, self.groups, self.path_length, *self.balls)).encode())
        return state.hexdigest()


def build(design: Design, surface: Surface, view: View) -> Scene:
    """Lay out a design around a (deformed) membrane.

    Parameters
    ----------
    design : Design
        The sensor.
    surface : Surface
        The membrane over the area of interest; beyond it the membrane is undeformed.
    view : View
        The part of the camera's sensor that is rendered.
    """
    shapes = [membrane(design, surface), *boards(design), *housing_inside(design), *seats(design)]
    if design.optics.light_path == "core":
        shapes += core_and_gel(design)
    return _laid_out(design, shapes, view)


def without_gel(design: Design, ball: Ball, view: View) -> Scene:
    """Lay out a design with a ball in place of its membrane; the gel's cut rim is gone as well.

    Parameters
    ----------
    design : Design
        The sensor; its gel's index and absorption are those of what surrounds the ball.
    ball : Ball
        What the camera looks at.
    view : View
        The part of the camera's sensor that is rendered.
    """
    shapes = [*boards(design), *housing_inside(design), *seats(design)]
    if design.optics.light_path == "core":
        shapes += [shape for shape in core_and_gel(design) if shape.name != "gel-rim"]
    return replace(_laid_out(design, shapes, view), balls=(ball,))


def _laid_out(design: Design, shapes: Sequence[Shape], view: View) -> Scene:
    return Scene(
        shapes=tuple(shapes),
        lights=tuple(_lights(design)),
        groups=len(design.leds.groups),
        camera=design.camera,
        view=view,
        path_length=design.optics.path_length,
    )


def _lights(design: Design) -> Iterator[Light]:
    _, rectangles = seated(design)
    area = [0.0] * len(design.leds.groups)
    for rectangle in rectangles:
        area[rectangle.group] += rectangle.area_mm2
    inside = design.leds.coupling != "air_gap"
    for r in rectangles:
        x, y, z = (float(c) for c in np.asarray(r.centre_mm) + LED_FACE_GAP_MM * np.asarray(r.normal))
        size = r.half_width_mm, r.half_height_mm
        radiance, profile = 1.0 / (np.pi * area[r.group]), design.leds.profile_of(r.group)
        axes, board = (r.normal, r.across, r.down), board_name(r.body)
        yield Light(r.group, (x, y, z), *axes, *size, radiance, profile, inside, board)
