"""Which boards carry the LEDs of an array: flat rings, a strip for each side, or one flexible board around.

A board's frame: x and y in its front plane, z along the LEDs' light; the front is the side with the LEDs.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from designlab.core.types import Array
from designlab.fabrication.boards.circuit import BoardError, Channel, front_limit_mm
from designlab.sensor.design import Design
from geometries.leds import Body, LedArray, bodies

LEVEL = 1e-6  # parts of unit vectors and mm: LEDs that differ by less lie in one plane
WIDEST_FOLD_DEG = 60.0
BETWEEN_MM = 0.9
"""Between LEDs that a panel's strips are filled with: room for tracks."""


class Frame(NamedTuple):
    """Where a board's front stands: a point and three unit vectors in the sensor frame (mm)."""

    origin: Array
    x: Array
    y: Array
    normal: Array

    def point(self, x: float, y: float, z: float = 0.0) -> Array:
        """A point of the board in the sensor frame (mm)."""
        return np.asarray(self.origin + x * self.x + y * self.y + z * self.normal)


class Place(NamedTuple):
    """An LED on its board: middle (mm), turn (deg, counter-clockwise from the front), its groups.

    `body` is the number of the design's package that it stands for or is part of.
    """

    x: float
    y: float
    turn_deg: float
    groups: tuple[int, ...]
    body: int


class Blank(NamedTuple):
    """A board before it is drawn.

    A flexible board has a frame for each facet, `facets` with their range of x; a flat board has one.
    """

    name: str
    kind: Literal["ring", "strip", "flex"]
    places: tuple[Place, ...]
    frames: tuple[Frame, ...]
    facets: tuple[tuple[float, float], ...]
    led_mm: float

    def frame_at(self, x: float) -> tuple[Frame, float]:
        """Frame of the facet on which x lies, and x in it."""
        if self.kind != "flex":
            return self.frames[0], x
        index = next((k for k, (_, high) in enumerate(self.facets) if x <= high), len(self.facets) - 1)
        low, high = self.facets[index]
        return self.frames[index], x - (low + high) / 2


def per_package(array: LedArray, land_width_mm: float = 0.0) -> tuple[tuple[float, float], ...]:
    """Places of the LEDs on one package of the design, (along the row, towards the membrane), mm.

    A panel's strips are filled with as many LEDs of a width as fit, evenly; else the package is the LED.
    """
    if array.package != "panel":
        return ((0.0, 0.0),)
    count = max(1, int(front_limit_mm(array)[0] / (land_width_mm + BETWEEN_MM) + 1e-9))
    step = array.emitting_width_mm / count
    return tuple(
        ((place - (count - 1) / 2) * step, (low + high) / 2)
        for low, high in array.emitting_spans_mm
        for place in range(count)
    )


def blanks(
    design: Design,
    chosen: Sequence[Channel],
    spots: Sequence[tuple[float, float]],
    *,
    turn_deg: float = 0.0,
) -> list[Blank]:
    """Boards of a design, each with its LEDs in place.

    Parameters
    ----------
    design : Design
        The sensor.
    chosen : sequence of Channel
        Drive of each group.
    spots : sequence of (float, float)
        LEDs on each package, see `per_package`.
    turn_deg : float
        By which every LED is turned on its place.

    Raises
    ------
    BoardError
        If no flat or singly bent board holds the LEDs as the design turns them; names field, value and rule.
    """
    array = design.leds
    found = bodies(array)
    heights = [_height_mm(design, chosen, body) for body in found]
    down = [body.normal[2] for body in found]
    if array.layout == "ring" and all(abs(z) < LEVEL for z in down):
        return [_turned(_flex(array, found, heights), turn_deg)]
    own_plane = array.layout == "ring" and any(group.count > 1 for group in array.groups)
    if own_plane and any(LEVEL < abs(z) < 1 - LEVEL for z in down):
        tilts = sorted({array.placement_of(k).tilt_deg for k in range(len(array.groups))})
        raise BoardError(
            f"leds.tilt_deg: {', '.join(f'{t:g}' for t in tilts)} deg on a ring turns each LED of a row into "
            "a plane of its own, which no flat or singly bent board holds; give 0 (flexible board), 90 (flat "
            'ring) or leds.layout = "edge" (a strip a side)'
        )
    planes: dict[tuple[int, ...], list[int]] = {}
    for number, (body, height) in enumerate(zip(found, heights, strict=True)):
        normal = np.asarray(body.normal)
        offset = float(normal @ _seat(body, height))
        key = tuple(round(c / LEVEL / 10) for c in (*body.normal, offset))
        planes.setdefault(key, []).append(number)
    names: dict[str, int] = {}
    made = []
    for members in planes.values():
        chosen_bodies = [found[n] for n in members]
        level = abs(chosen_bodies[0].normal[2]) > 1 - LEVEL
        held = dict.fromkeys(array.groups[g].name for body in chosen_bodies for g in body.groups)
        name = "board_ring" if level else "_".join(["board", *held])
        names[name] = names.get(name, 0) + 1
        name = name if names[name] == 1 else f"{name}_{names[name]}"
        blank = _flat(name, members, chosen_bodies, heights[members[0]], spots, level=level)
        made.append(_turned(blank, turn_deg))
    return made


def _turned(blank: Blank, turn_deg: float) -> Blank:
    places = tuple(place._replace(turn_deg=place.turn_deg + turn_deg) for place in blank.places)
    return blank._replace(places=places)


def _height_mm(design: Design, chosen: Sequence[Channel], body: Body) -> float:
    """Height of the LED over its board (mm): the part's, else the design's."""
    parts = {chosen[group].name for group in body.groups}
    if len(parts) > 1:
        raise BoardError(f"leds.groups: one package holds parts {', '.join(sorted(parts))}; give it one part")
    size = chosen[body.groups[0]].part.size_mm
    thickness = None if size is None else size[2]
    return design.leds.body_thickness_mm if thickness is None else thickness


def _seat(body: Body, height_mm: float) -> Array:
    """Middle of an LED's underside (mm)."""
    return np.asarray(body.centre_mm) + (body.half_mm[2] - height_mm) * np.asarray(body.normal)


def _flat(
    name: str,
    numbers: Sequence[int],
    members: Sequence[Body],
    height: float,
    spots: Sequence[tuple[float, float]],
    *,
    level: bool,
) -> Blank:
    seats = np.array([_seat(body, height) for body in members])
    normal = np.asarray(members[0].normal)
    if level:
        x = np.array([1.0, 0.0, 0.0])
        frame = Frame(np.array([0.0, 0.0, seats[0][2]]), x, np.cross(normal, x), normal)
    else:
        first = members[0]
        frame = Frame(seats.mean(axis=0), -np.asarray(first.across), -np.asarray(first.down), normal)
    places = []
    for number, body, seat in zip(numbers, members, seats, strict=True):
        across, below = np.asarray(body.across), np.asarray(body.down)
        turn = math.degrees(math.atan2(-across @ frame.y, -across @ frame.x))
        for along, down in spots:
            at = seat + along * across + down * below - frame.origin
            places.append(Place(float(at @ frame.x), float(at @ frame.y), turn, body.groups, number))
    return Blank(name, "ring" if level else "strip", tuple(places), (frame,), (), height)


def _flex(array: LedArray, members: Sequence[Body], heights: Sequence[float]) -> Blank:
    """One flexible board around the axis: a flat facet for each LED, bent between them."""
    seats = [_seat(body, height) for body, height in zip(members, heights, strict=True)]
    radii = [math.hypot(seat[0], seat[1]) for seat in seats]
    if max(radii) - min(radii) > 1e-6:
        raise BoardError(
            f"leds.groups: a flexible board needs one radius, it would lie at {min(radii):g} to "
            f"{max(radii):g} mm; give all groups one radius_mm and one part height"
        )
    radius, level = radii[0], float(np.mean([seat[2] for seat in seats]))
    order = sorted(range(len(members)), key=lambda n: math.atan2(seats[n][1], seats[n][0]))
    angles = [math.atan2(seats[n][1], seats[n][0]) for n in order]
    gaps = [
        (after - before) % math.tau for before, after in zip(angles, [*angles[1:], angles[0]], strict=True)
    ]
    start = (int(np.argmax(gaps)) + 1) % len(order)  # the board opens where the widest gap is
    order = order[start:] + order[:start]
    angles = [math.atan2(seats[n][1], seats[n][0]) for n in order]
    for k, (before, after) in enumerate(pairwise(angles)):
        angles[k + 1] = before + (after - before) % math.tau
    # Facets without LEDs keep each bend below the widest fold.
    stops: list[tuple[float, int | None]] = [(angles[0], order[0])]
    for (before, after), number in zip(pairwise(angles), order[1:], strict=True):
        parts = max(1, math.ceil((after - before) / math.radians(WIDEST_FOLD_DEG) - 1e-9))
        stops += [(before + (after - before) * k / parts, None) for k in range(1, parts)]
        stops.append((after, number))
    halves = [radius * math.tan((b - a) / 2) for (a, _), (b, _) in pairwise(stops)]
    end = min(max(halves, default=radius * math.tan(math.radians(15.0))), radius)
    halves = [end, *reversed(halves), end]
    frames, facets, places = [], [], []
    low = 0.0
    # x runs clockwise around the axis, seen from the camera, so that y points to the camera.
    for (angle, on_it), before, after in zip(reversed(stops), halves, halves[1:], strict=False):
        out = np.array([math.cos(angle), math.sin(angle), 0.0])
        x, y = np.array([math.sin(angle), -math.cos(angle), 0.0]), np.array([0.0, 0.0, 1.0])
        frames.append(Frame(radius * out + (after - before) / 2 * x + level * y, x, y, -out))
        if on_it is not None:
            at = low + before, float(seats[on_it][2] - level)
            places.append(Place(*at, 0.0, members[on_it].groups, on_it))
        facets.append((low, low + before + after))
        low += before + after
    return Blank("board_flex", "flex", tuple(places), tuple(frames), tuple(facets), heights[0])
