"""Where the LEDs of a design appear in the ball, in closed form: each point is mirrored at its own place.

It knows neither renderer nor unwrapping. Light must run straight, so this is for designs without a core in
the path of light.
"""

import json
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.light_probe.polar import angles_deg
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.sensor.led_mounting import front_corners, seated
from geometries.leds import Emitter

PARTS = 32  # of an emitting face along each side
SETTLED = 1e-9  # change of the normal in the last step below which it counts as found


@dataclass(frozen=True)
class Panel:
    """One emitting face as the ball shows it.

    Attributes
    ----------
    group : str
        Its LED group.
    number : int
        Its place among all emitting faces of the design.
    polar_deg, azimuth_deg : float
        Middle of the directions of what is visible: angle from +z, and counter-clockwise from +x.
    direction : tuple of float
        The same as a unit vector from the ball.
    solid_angle_sr : float
        Of these directions, each from its own point of the ball.
    seen_sr : float
        Solid angle subtended by what is visible, each part of it as seen from where it is mirrored.
    origin_mm : tuple of float
        Where the middle of the face is mirrored.
    visible : float
        Share of the face's solid angle that the picture shows.
    hidden_by : tuple of str
        What hides the rest: "ball", "board", "picture", or "back" where the face shows its back.
    """

    group: str
    number: int
    polar_deg: float
    azimuth_deg: float
    direction: tuple[float, float, float]
    solid_angle_sr: float
    seen_sr: float
    origin_mm: tuple[float, float, float]
    visible: float
    hidden_by: tuple[str, ...]


@dataclass(frozen=True)
class Panels:
    """Every emitting face of a design as the ball shows it."""

    panels: tuple[Panel, ...]

    def to_json(self) -> str:
        """Content as JSON."""
        return json.dumps(asdict(self))


def panels(design: Design, probe: LightProbe, view: View) -> Panels:
    """Mirror every emitting face in the ball.

    Raises
    ------
    ValueError
        If light refracts in a gelcore.
    """
    if design.optics.light_path != "air":
        raise ValueError(
            f"optics.light_path: must be 'air' for LEDs to be seen straight, is {design.optics.light_path!r}"
        )
    boxes, faces = seated(design)
    boards = np.stack([front_corners(box) for box in boxes])
    names = design.group_names
    return Panels(
        tuple(_panel(design, probe, view, face, n, names[face.group], boards) for n, face in enumerate(faces))
    )


def _panel(
    design: Design, probe: LightProbe, view: View, face: Emitter, number: int, group: str, boards: Array
) -> Panel:
    eye = np.array(design.camera.eye_mm)
    corners = _points(face, np.linspace(-1, 1, PARTS + 1))
    middles = _points(face, (np.arange(PARTS) + 0.5) * 2 / PARTS - 1)
    at, mirrored = mirror_points(middles, eye, probe)
    at_corner, corner_mirrored = mirror_points(corners, eye, probe)
    towards = middles - at
    distance = np.linalg.norm(towards, axis=-1)
    towards = towards / distance[..., None]
    to_corner = corners - at_corner
    to_corner = to_corner / np.linalg.norm(to_corner, axis=-1, keepdims=True)
    a, b, c, d = _around_cells(to_corner)
    whole = np.all(_around_cells(corner_mirrored), axis=0)
    cells = np.where(whole, _triangle_sr(a, b, c) + _triangle_sr(a, c, d), 0.0)
    facing = -(towards @ np.array(face.normal))
    seen = np.maximum(facing, 0.0) * face.area_mm2 / PARTS**2 / distance**2
    hidden = {
        "ball": ~(mirrored & whole),
        "back": facing <= 0,
        "board": blocked(at, middles, boards) | blocked(at, np.broadcast_to(eye, at.shape), boards),
        "picture": ~_in_picture(at, design, view),
    }
    shown = ~np.any(list(hidden.values()), axis=0)
    middle = (cells * shown)[..., None] * towards
    direction = middle.sum(axis=(0, 1))
    if not shown.any():
        direction = np.nanmean(towards, axis=(0, 1))
    direction = direction / np.linalg.norm(direction)
    polar, azimuth = angles_deg(direction)
    origin = mirror_points(np.array(face.centre_mm), eye, probe)[0]
    return Panel(
        group=group,
        number=number,
        polar_deg=polar,
        azimuth_deg=azimuth,
        direction=(float(direction[0]), float(direction[1]), float(direction[2])),
        solid_angle_sr=float(cells[shown].sum()),
        seen_sr=float(seen[shown].sum()),
        origin_mm=(float(origin[0]), float(origin[1]), float(origin[2])),
        visible=float(shown.mean()),
        hidden_by=tuple(reason for reason, where in hidden.items() if where.any()),
    )


def _points(face: Emitter, steps: Array) -> Array:
    across, down = (
        half * steps[:, None] * np.asarray(axis)
        for half, axis in ((face.half_width_mm, face.across), (face.half_height_mm, face.down))
    )
    return np.asarray(np.asarray(face.centre_mm) + across[:, None] + down[None])


def _around_cells(corners: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Values at the four corners of every cell of a grid, in order around the cell."""
    return corners[:-1, :-1], corners[1:, :-1], corners[1:, 1:], corners[:-1, 1:]


def mirror_points(points: Array, eye: Array, probe: LightProbe) -> tuple[Array, NDArray[np.bool_]]:
    """Points of the ball that mirror light from points (..., 3) into the eye, and where there is one.

    The normal halves the angle between the ways to light and eye; near a small ball both hardly change with
    it, so that the fixed point contracts.
    """
    middle = np.array(probe.middle_mm)
    normal = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    for _ in range(60):
        before = normal
        at = middle + probe.radius_mm * normal
        ways = [to - at for to in (points, np.broadcast_to(eye, points.shape))]
        units = [way / np.linalg.norm(way, axis=-1, keepdims=True) for way in ways]
        normal = units[0] + units[1]
        normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    # Behind the ball there is no such point, and the normal does not come to rest.
    settled = np.linalg.norm(normal - before, axis=-1) < SETTLED
    outside = np.linalg.norm(points - middle, axis=-1) > probe.radius_mm
    return middle + probe.radius_mm * normal, np.asarray(settled & outside)


def _triangle_sr(a: Array, b: Array, c: Array) -> Array:
    """Solid angle of triangles of unit vectors (van Oosterom and Strackee, IEEE Trans. BME 30, 1983)."""
    volume = np.abs((a * np.cross(b, c)).sum(axis=-1))
    rest = 1 + (a * b).sum(axis=-1) + (b * c).sum(axis=-1) + (c * a).sum(axis=-1)
    return np.asarray(2 * np.arctan2(volume, rest))


def blocked(start: Array, end: Array, boards: Array) -> NDArray[np.bool_]:
    """Whether a board stands between two points; one that carries the end does not."""
    found = np.zeros(start.shape[:-1], dtype=bool)
    way = end - start
    for corners in boards:
        across, down = corners[1] - corners[0], corners[3] - corners[0]
        normal = np.cross(across, down)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = ((corners[0] - start) @ normal) / (way @ normal)
            place = start + share[..., None] * way - corners[0]
            u, v = place @ across / (across @ across), place @ down / (down @ down)
            between = (share > 1e-6) & (share < 1 - 1e-4) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
        found |= between
    return found


def _in_picture(at: Array, design: Design, view: View) -> NDArray[np.bool_]:
    way = at - np.array(design.camera.eye_mm)
    column, row = design.camera.project(way[..., 0], way[..., 1], -way[..., 2])
    return np.asarray(
        (column >= view.x_px)
        & (column <= view.x_px + view.width_px)
        & (row >= view.y_px)
        & (row <= view.y_px + view.height_px)
    )
