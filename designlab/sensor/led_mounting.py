"""Where LEDs sit on or in the gelcore: its side planes, and the way of a bonded LED onto its side."""

from typing import NamedTuple, TypeVar

import numpy as np

from designlab.core.types import Array
from designlab.sensor.parts import Parts
from geometries import elastomer, gelcore
from geometries.leds import Body, Emitter, bodies, emitters

Part = TypeVar("Part", Body, Emitter)
JOINED_MM = (
    2e-3  # a bonded board is put this far inside the core's side, so that the two never fight for a ray
)
FACING = 0.7  # cosine: sides turned to an LED by less than 45 deg may carry it


class Sides(NamedTuple):
    """Side planes of a gelcore: a point on the lower edge (mm) and the unit outward normal of each."""

    points: Array
    normals: Array

    def distance_mm(self, at: Array) -> Array:
        """Largest signed distance of points (n, 3) to the planes; positive outside."""
        return np.asarray(self._distances(at).max(axis=1))

    def _distances(self, at: Array) -> Array:
        return np.asarray(((at[:, None] - self.points[None]) * self.normals[None]).sum(axis=-1))

    def onto_mm(self, body: Body) -> float:
        """How far a body must move along its normal until its whole front lies just inside the core."""
        along = -(self.normals @ np.asarray(body.normal))
        facing = along > FACING
        if not facing.any():
            return 0.0
        lacking = self._distances(front_corners(body)).max(axis=0)[facing] + JOINED_MM
        return max(0.0, float((lacking / along[facing]).max()))


def front_corners(body: Body) -> Array:
    """Corners of the face that carries the emitting strips, shape (4, 3), mm."""
    middle = np.asarray(body.centre_mm) + body.half_mm[2] * np.asarray(body.normal)
    return _corners(
        middle, body.half_mm[0] * np.asarray(body.across), body.half_mm[1] * np.asarray(body.down)
    )


def face_corners(strip: Emitter) -> Array:
    """Corners of an emitting strip, shape (4, 3), mm."""
    across, down = (
        half * np.asarray(axis)
        for half, axis in ((strip.half_width_mm, strip.across), (strip.half_height_mm, strip.down))
    )
    return _corners(np.asarray(strip.centre_mm), across, down)


def _corners(middle: Array, across: Array, down: Array) -> Array:
    return np.array([middle + i * across + j * down for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))])


def sides(design: Parts) -> Sides:
    """Side planes of the gelcore; a drafted one leans to the axis towards the camera."""
    core = design.gelcore
    outline = gelcore.polygon(core, segments=72)
    edge = np.roll(outline, -1, axis=0) - outline
    level = np.column_stack([edge[:, 1], -edge[:, 0]]) / np.linalg.norm(edge, axis=1, keepdims=True)
    draft = np.radians(0.0 if core.shape == "dome" else core.draft_deg)
    normals = np.column_stack([np.cos(draft) * level, np.full(len(level), np.sin(draft))])
    return Sides(
        np.column_stack([outline, elastomer.interface_mm(design.elastomer, outline[:, 0], outline[:, 1])]),
        normals,
    )


def seated(design: Parts) -> tuple[list[Body], list[Emitter]]:
    """Bodies and emitters of the LEDs where light finds them: bonded ones moved onto the core's side.

    Glue of the core's index carries light as the core does: a bonded face shines from just inside the side.
    """
    boxes, strips = list(bodies(design.leds)), list(emitters(design.leds))
    if design.leds.coupling != "bonded":
        return boxes, strips
    planes = sides(design)
    ways = [planes.onto_mm(box) for box in boxes]
    return (
        [_moved(box, way) for box, way in zip(boxes, ways, strict=True)],
        [_moved(strip, ways[strip.body]) for strip in strips],
    )


def _moved(part: Part, way_mm: float) -> Part:
    x, y, z = (float(c + way_mm * n) for c, n in zip(part.centre_mm, part.normal, strict=True))
    return part._replace(centre_mm=(x, y, z))
