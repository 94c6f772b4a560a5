"""The geometric rules of a design, as signed distances in mm: positive means violated."""

import math
from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from designlab.core.types import Array
from designlab.sensor.camera import Camera
from designlab.sensor.led_mounting import face_corners, sides
from designlab.sensor.parts import Parts
from designlab.sensor.refraction import apparent_distance_mm, apparent_tangent
from designlab.sensor.seating import camera_board, inside
from geometries import elastomer, gelcore, step_part
from geometries.elastomer import Elastomer
from geometries.gelcore import Gelcore
from geometries.leds import Body, bodies, emitters
from geometries.outline import reach_mm
from geometries.seats import LEAST_WALL_MM, WIDEST_OPEN_DEG, rings, widest_gap_deg

MINIMUM_WALL_MM = LEAST_WALL_MM
MINIMUM_GEL_MM = 0.5  # thinner gels tear when they are taken out of the mould
LEAST_TOP_MM = 1.0  # width of a drafted core at the window, of a hollow one: its sides must not meet
SIDE_PIECES = 12  # convex ones, one over the other, that stand for a core with curved sides
LEAST_SIDE_MM = 0.1  # height of a dome core's side, which light enters through: a printer's layer
FORGIVEN_MM = 0.01  # of two spheres: what a mould reproduces; more means a gel of uneven thickness
FORGIVEN_MM3 = 0.3  # that a core cuts into its gel; an export checks for less than 1 mm3
LEAST_RIM_MM = 0.4  # of a core's rim on its stop
LEAST_HEAD_MM = 5.0  # a threaded insert of 4 mm, and a closed floor under it
LIT_MM = 0.3  # kept free beside LEDs

RULES: dict[str, str] = {
    "leds_inside_housing": "every LED body lies inside the housing's inner radius, and outside the walls of "
    "a housing.step",
    "leds_below_plate": "every LED body lies below the camera plate",
    "leds_above_membrane": "every LED body lies above the membrane plane",
    "leds_clear_of_core": "no LED body reaches into gelcore or elastomer; the emitting face of a bonded one "
    "lies on a side of the gelcore within leds.glue_mm; embedded ones lie wholly inside the gelcore",
    "leds_clear_of_each_other": "LED bodies do not overlap; LEDs of different groups share one where place "
    "and tilt are the same",
    "leds_outside_view": "no LED body stands between the camera and the sensing area",
    "core_inside_housing": "gelcore and elastomer fit into the housing",
    "core_below_plate": "the gelcore ends below the camera plate",
    "elastomer_on_core": "the elastomer does not reach beyond the gelcore",
    "core_sides": f"a gelcore whose sides are drafted or hollow is at least {LEAST_TOP_MM:g} mm wide",
    "core_radius": "gelcore.radius_mm of a dome is at least half of gelcore.width_mm",
    "core_height": "gelcore.height_mm of a dome exceeds the height of its spherical cap by "
    f"{LEAST_SIDE_MM} mm or more",
    "cavity_in_core": f"around a hollow the gelcore is at least {MINIMUM_WALL_MM} mm thick",
    "dome_radius": "elastomer.radius_mm of a dome is at least half of elastomer.width_mm",
    "dome_core": "gelcore and elastomer of a dome are concentric spheres",
    "sensing_area_on_membrane": "the sensing area lies on the membrane, where that is at most "
    f"{elastomer.STEEPEST_DEG:g} deg steep",
    "camera_sees_membrane": "the sensing area lies inside the camera's field of view",
    "camera_above_core": "the camera stands above the gelcore",
    "camera_clears_plate": "the lens fits through the hole of the camera plate",
    "view_through_window": "the camera sees the sensing area through the gelcore's clear window and between "
    "its sides",
    "view_through_plate": "the camera sees the sensing area through the hole of the camera plate, and past a "
    "housing.step",
    "mirror_fills_view": "all of the sensing area is seen in the camera's mirror",
    "mirror_above_core": "camera and mirror stand above the gelcore",
    "seats_hold_core": f"housing.seats: collar, or ledges of the tabs, meet {LEAST_RIM_MM} mm or more of the "
    "gelcore's rim",
    "seats_centre_core": "housing.seats: tabs between the rows of LEDs, or a ring of "
    f"{MINIMUM_WALL_MM} mm under a level board, hold the gelcore from all sides",
    "seats_outside_view": "housing.seats: collar and tabs stand outside the view of the sensing area",
    "seats_clear_of_leds": f"housing.seats: the collar stands {LIT_MM} mm or more from LEDs beside it",
    "camera_board_fits": "housing.seats.camera: its lens is no wider than camera.body_radius_mm says",
    "camera_board_above_plate": f"housing.seats.camera: it lies {LEAST_HEAD_MM:g} mm or more above the "
    "camera plate's underside, so that its screws hold and end short of the light",
    "camera_board_above_core": f"housing.seats.camera: its lens ends {LIT_MM} mm or more above the gelcore",
    "minimum_wall": f"housing walls are at least {MINIMUM_WALL_MM} mm thick",
    "minimum_gel": f"the gel is at least {MINIMUM_GEL_MM} mm thick",
}

SEEN = ("camera_sees_membrane",)
"""Rules about what the camera sees, not about what can be made.

A sensor that was built a little off its drawing may break them and works all the same: its coverage says how
much of the sensing area it has lost.
"""

SHAPED = ("core_sides", "core_radius", "core_height", "dome_radius")
"""Rules without which a part has no shape: such a design can be neither laid out, drawn nor made."""


def margins(design: Parts) -> dict[str, float]:
    """Signed distance to every rule in `RULES` that applies to the design, in mm; positive means violated."""
    values: dict[str, float] = {}
    for part in (_seat_margins, _led_margins, _body_margins, _camera_margins):
        values |= part(design)
    for rule, margin in _step_margins(design).items():
        values[rule] = max(values[rule], margin)
    # A rule that does not apply has the margin -inf; one that cannot be told is not met.
    told = {rule: math.inf if math.isnan(values[rule]) else float(values[rule]) for rule in RULES}
    return {rule: margin for rule, margin in told.items() if margin > -math.inf}


def shape_margins(core: Gelcore, gel: Elastomer) -> dict[str, float]:
    """Margins of `SHAPED`; -inf where a rule does not apply."""
    found = dict.fromkeys(SHAPED, -math.inf)
    if gel.radius_mm is not None:
        found["dome_radius"] = gel.width_mm / 2 - gel.radius_mm
    if core.radius_mm is None:
        across = core.width_mm if core.shape != "slab" else min(core.width_mm, core.length_mm)
        top_mm = across - 2 * core.height_mm * math.tan(math.radians(core.draft_deg))
        return found | {"core_sides": LEAST_TOP_MM - top_mm + 2 * _waist_mm(core)}
    rim = min(core.width_mm / 2, core.radius_mm)
    cap_mm = core.radius_mm - math.sqrt(core.radius_mm**2 - rim**2)
    if _waist_mm(core):
        found["core_sides"] = LEAST_TOP_MM - core.width_mm + 2 * _waist_mm(core)
    return found | {
        "core_radius": core.width_mm / 2 - core.radius_mm,
        "core_height": cap_mm + LEAST_SIDE_MM - core.height_mm,
    }


def _waist_mm(core: Gelcore) -> float:
    """How far hollow sides of a core recede midway."""
    return max(-(core.side_bulge_mm or 0.0), 0.0)


def _led_margins(design: Parts) -> dict[str, float]:
    boxes = [_Convex.box(body) for body in bodies(design.leds)]
    corners = np.concatenate([box.corners for box in boxes])
    radius = np.hypot(corners[:, 0], corners[:, 1])
    return {
        "leds_inside_housing": radius.max() - design.housing.inner_radius_mm,
        "leds_below_plate": corners[:, 2].max() - design.housing.top_mm,
        "leds_above_membrane": -corners[:, 2].min(),
        "leds_clear_of_core": _off_their_seat(design, boxes),
        "leds_clear_of_each_other": max(
            (_overlap(a, b) for a, b in combinations(boxes, 2)), default=-math.inf
        ),
        "leds_outside_view": intrusion_into_view_mm(design, [box.corners for box in boxes]),
    }


class _Convex(NamedTuple):
    """Convex body: corners (n, dimensions), unit face normals and unit edge directions."""

    corners: Array
    normals: Array
    edges: Array

    @classmethod
    def box(cls, body: Body) -> "_Convex":
        """Box of an LED."""
        axes = np.array([body.across, body.down, body.normal])
        signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
        corners = np.asarray(body.centre_mm) + signs @ (axes * np.array(body.half_mm)[:, None])
        return cls(corners, axes, axes)

    @classmethod
    def prism(cls, polygon: Array, height_mm: float, slope: float = 0.0) -> "_Convex":
        """Upright prism over a convex polygon, from z = 0; its upper face may rise along y, mm a mm."""
        outward, along = _sides(polygon)
        high_mm = height_mm + slope * polygon[:, 1]
        low, high = (np.column_stack([polygon, z]) for z in (np.zeros(len(polygon)), high_mm))
        up = np.array([[0.0, 0.0, 1.0]])
        level = [np.column_stack([vectors, np.zeros(len(vectors))]) for vectors in (outward, along)]
        normals, edges = [level[0], up], [level[1], up]
        if slope:
            leaning = np.roll(high, -1, axis=0) - high
            normals.append(np.array([[0.0, -slope, 1.0]]) / np.hypot(1.0, slope))
            edges.append(leaning / np.linalg.norm(leaning, axis=1, keepdims=True))
        return cls(np.concatenate([low, high]), np.concatenate(normals), np.concatenate(edges))

    @classmethod
    def frustum(cls, low: Array, high: Array, bottom_mm: float, top_mm: float) -> "_Convex":
        """Body between two convex polygons with parallel sides, one over the other."""
        outward, along = _sides(low)
        lean = ((high - low) * outward).sum(axis=1) / (top_mm - bottom_mm)
        normals = np.column_stack([outward, -lean]) / np.hypot(1.0, lean)[:, None]
        below = np.column_stack([low, np.full(len(low), bottom_mm)])
        above = np.column_stack([high, np.full(len(high), top_mm)])
        slant = (above - below) / np.linalg.norm(above - below, axis=1)[:, None]
        level = np.column_stack([along, np.zeros(len(along))])
        faces = np.concatenate([normals, [[0.0, 0.0, 1.0]]])
        return cls(np.concatenate([below, above]), faces, np.concatenate([level, slant]))


def _sides(polygon: Array) -> tuple[Array, Array]:
    """Unit outward normals and unit directions of the sides of a counter-clockwise polygon."""
    edge = np.roll(polygon, -1, axis=0) - polygon
    along = edge / np.linalg.norm(edge, axis=1, keepdims=True)
    return np.column_stack([along[:, 1], -along[:, 0]]), along


def _overlap(a: _Convex, b: _Convex) -> float:
    """How far two convex bodies must move apart to be free; where they are, minus the gap (at least).

    The separating axis theorem: of two convex bodies apart, one face normal of either or one cross product of
    their edges separates them.
    """
    across = np.cross(a.edges[:, None], b.edges[None]).reshape(-1, 3)
    length = np.linalg.norm(across, axis=1)
    axes = np.concatenate([a.normals, b.normals, across[length > 1e-9] / length[length > 1e-9, None]])
    return _least_overlap(a.corners @ axes.T, b.corners @ axes.T)


def _least_overlap(a: Array, b: Array) -> float:
    """Least overlap of two point sets projected on some axes, shapes (points, axes)."""
    return float(np.minimum(a.max(axis=0) - b.min(axis=0), b.max(axis=0) - a.min(axis=0)).min())


def _off_their_seat(design: Parts, boxes: Sequence[_Convex]) -> float:
    """How far LEDs are from where their coupling wants them (light in air: no core, no rule)."""
    if design.optics.light_path == "air":
        return -math.inf
    if design.leds.coupling == "air_gap":
        # A drafted side recedes towards the camera; its lower edge, which is nearest, stands for all of it.
        outline = gelcore.polygon(design.gelcore, segments=72)
        if design.gelcore.side_bulge_mm:
            pieces = _curved_core(design, outline)
        else:
            pieces = [_Convex.prism(outline, _window_mm(design), design.gelcore.window_slope)]
        return max(_overlap(box, piece) for box in boxes for piece in pieces)
    walls = sides(design)

    def outside(points: Array) -> Array:
        """How far points lie above the window or below the gelcore's gel side."""
        below = elastomer.interface_mm(design.elastomer, points[:, 0], points[:, 1]) - points[:, 2]
        window = _window_mm(design) + design.gelcore.window_slope * points[:, 1]
        return np.maximum(points[:, 2] - window, below)

    if design.leds.coupling == "embedded":
        corners = np.concatenate([box.corners for box in boxes])
        return float(np.maximum(walls.distance_mm(corners), outside(corners)).max())
    faces = np.concatenate([face_corners(strip) for strip in emitters(design.leds)])
    apart = np.maximum(walls.distance_mm(faces) - design.leds.glue_mm, outside(faces))
    # 1 um is forgiven: a bonded body touches the side.
    soft, core = design.elastomer, _core_body(design)
    gel = _Convex.prism(elastomer.polygon(soft, segments=72), soft.thickness_mm)
    overlap = max(max(_overlap(box, core), _overlap(box, gel)) for box in boxes) - 1e-3
    return max(float(apart.max()), overlap)


def _curved_core(design: Parts, outline: Array) -> list[_Convex]:
    """Gel and a core with curved sides, in convex pieces one over the other.

    Pieces of an outward bulge lie inside it by up to 1 / `SIDE_PIECES`^2 of it.
    """
    core, top_mm = design.gelcore, _window_mm(design)
    rim_mm = top_mm - gelcore.side_height_mm(core)
    share = np.linspace(0.0, 1.0, SIDE_PIECES + 1)
    rings = [gelcore.outset(outline, float(out)) for out in gelcore.bulge_mm(core, share)]
    heights = rim_mm + share * (top_mm - rim_mm)
    pieces = [_Convex.prism(outline, rim_mm)]
    for (low, high), (bottom, top) in zip(pairwise(rings), pairwise(heights), strict=True):
        pieces.append(_Convex.frustum(low, high, float(bottom), float(top)))
    return pieces


def _core_body(design: Parts) -> _Convex:
    """Gelcore as a convex body, its drafted sides included."""
    core = design.gelcore
    low = gelcore.polygon(core, segments=72)
    if core.wedge_deg is not None:
        wedge, lift = _Convex.prism(low, core.height_mm, core.window_slope), np.zeros(3)
        lift[2] = design.elastomer.thickness_mm
        return wedge._replace(corners=wedge.corners + lift)
    walls = sides(design)
    # A side with normal (cos d, sin d) recedes by tan d times the height; corners follow both their sides.
    level = walls.normals[:, :2] / np.linalg.norm(walls.normals[:, :2], axis=1, keepdims=True)
    lean_mm = core.height_mm * walls.normals[0, 2] / float(np.linalg.norm(walls.normals[0, :2]))
    before = np.roll(level, 1, axis=0)
    both = (level + before) / (1 + (level * before).sum(axis=1, keepdims=True))
    corners = [
        np.column_stack([polygon, np.full(len(low), z)])
        for polygon, z in ((low, design.elastomer.thickness_mm), (low - lean_mm * both, _window_mm(design)))
    ]
    edge, slant = np.roll(corners[0], -1, axis=0) - corners[0], corners[1] - corners[0]
    edges = np.concatenate([edge, slant])
    normals = np.concatenate([walls.normals, [[0.0, 0.0, 1.0]]])
    return _Convex(np.concatenate(corners), normals, edges / np.linalg.norm(edges, axis=1, keepdims=True))


def intrusion_into_view_mm(design: Parts, bodies: Sequence[Array]) -> float:
    """How far bodies reach into the sensing area as the camera sees both; mm at the membrane.

    Parameters
    ----------
    design : Parts
        The sensor.
    bodies : sequence of array, shape (corners, 3)
        Corners of convex bodies in the sensor frame (mm).
    """
    area, distance_mm = _sensing_area_seen(design)
    position = np.asarray(design.camera.eye_mm)
    worst = -math.inf
    for corners in bodies:
        below = corners[corners[:, 2] < position[2] - 1e-6]
        if len(below):
            seen = tangents(design, below) * distance_mm
            between = (seen[:, None] - seen[None]).reshape(-1, 2)
            length = np.linalg.norm(between, axis=1)
            # Normals of all lines between corners; those of the outline, which decide, are among them.
            normals = between[length > 1e-9][:, ::-1] * (1.0, -1.0) / length[length > 1e-9, None]
            axes = np.concatenate([normals, _sides(area)[0]])
            worst = max(worst, _least_overlap(seen @ axes.T, area @ axes.T))
    return worst


def tangents(design: Parts, points: Array) -> Array:
    """Tangents of the directions in which the camera sees points below it, shape (n, 2).

    Points beside the core are seen straight, those of embedded LEDs through the window.
    """
    x_c, y_c, z_c = design.camera.eye_mm
    away = points[:, :2] - (x_c, y_c)
    straight = away / (z_c - points[:, 2:])
    window = _window_mm(design)
    if design.leds.coupling != "embedded" or design.optics.light_path == "air" or z_c <= window:
        return np.asarray(straight)
    index = design.optics.core_index
    for number, point in enumerate(points):
        distance = float(np.hypot(*away[number]))
        if point[2] < window and distance > 0:
            tangent = apparent_tangent(distance, [(window - point[2], index), (z_c - window, 1.0)])
            straight[number] = away[number] / distance * tangent
    return np.asarray(straight)


def _sensing_area_seen(design: Parts) -> tuple[Array, float]:
    """Outline of the sensing area as the camera sees it, counter-clockwise, in mm at its apparent distance.

    A camera below the window is lifted just above it here; it breaks `camera_above_core` anyway.
    """
    _, y_c, z_c = design.camera.eye_mm
    outline = design.sensing_area.outline_mm()
    base = np.nan_to_num(elastomer.base_mm(design.elastomer, outline[:, 0], outline[:, 1]))
    window_mm = _window_mm(design) + max(design.gelcore.window_slope * y_c, 0.0)
    lifted_mm = max(z_c, window_mm + 0.01, float(base.max()) + 0.01)
    distance_mm = apparent_distance_mm(design.layers_to_camera(0.0, camera_mm=lifted_mm))
    tangents = design.tangents_to(np.column_stack([outline, base]), camera_mm=lifted_mm)
    return tangents * distance_mm, distance_mm


def _window_mm(design: Parts) -> float:
    """Height of the gelcore's camera side."""
    return design.elastomer.thickness_mm + design.gelcore.height_mm


def _highest_mm(design: Parts) -> float:
    """Height of the gelcore's highest place, at the thick end of a wedge."""
    return _window_mm(design) + abs(design.gelcore.window_slope) * design.gelcore.length_mm / 2


def _body_margins(design: Parts) -> dict[str, float]:
    core, gel, housing = design.gelcore, design.elastomer, design.housing
    core_polygon = gelcore.polygon(core)
    gel_polygon = elastomer.polygon(gel)
    dome_core = -math.inf
    if gel.radius_mm is not None:
        if core.radius_mm is not None:
            dome_core = _off_concentric(core, core.radius_mm, gel.radius_mm - gel.thickness_mm)
        else:
            dome_core = gel.radius_mm  # a flat core under a dome gel: not concentric at all
    widest = gelcore.outset(core_polygon, max(core.side_bulge_mm or 0.0, 0.0))
    reach = max(np.hypot(*widest.T).max(), np.hypot(*gel_polygon.T).max())
    return {
        "core_inside_housing": float(reach) - housing.inner_radius_mm,
        "core_below_plate": _highest_mm(design) - housing.top_mm,
        "elastomer_on_core": _beyond(gel_polygon, core_polygon),
        **shape_margins(core, gel),
        "cavity_in_core": _thinnest_beside_cavity(design),
        "dome_core": dome_core,
        "minimum_wall": MINIMUM_WALL_MM - min(housing.wall_mm, housing.plate_mm),
        "minimum_gel": MINIMUM_GEL_MM - elastomer.thinnest_mm(gel),
    }


def _off_concentric(core: Gelcore, radius_mm: float, inner_mm: float) -> float:
    """How far the radius of a dome core is from that of the gel's inner sphere, beyond what is forgiven."""
    larger_mm = radius_mm - inner_mm
    rim = min(core.width_mm / 2, inner_mm)
    # The core's sphere touches the gel's on the axis. Where it is larger it cuts into the gel, for each mm of
    # radius by this volume: the integral of R / sqrt(R^2 - r^2) - 1 over the disc of the rim.
    each_mm2 = math.pi * (inner_mm * (inner_mm - math.sqrt(inner_mm**2 - rim**2)) - rim**2 / 2)
    cutting = larger_mm - FORGIVEN_MM3 / max(each_mm2, 1e-9)
    return max(abs(larger_mm) - FORGIVEN_MM, cutting)


def _thinnest_beside_cavity(design: Parts) -> float:
    """How far the core around its hollow is short of the least wall; -inf of a solid one."""
    core, cavity = design.gelcore, design.gelcore.cavity
    if cavity is None:
        return -math.inf
    turn = np.radians(np.linspace(0.0, 90.0, 91))
    radius, height = cavity[0] * np.cos(turn), core.height_mm - cavity[1] * np.sin(turn)
    below = height
    if core.radius_mm is not None:  # above the centre of its sphere a dome is a cylinder
        below = core.radius_mm - np.hypot(radius, np.minimum(height - core.radius_mm, 0.0))
    outline = gelcore.polygon(core)
    outward, _ = _sides(outline)
    sides = float((outline * outward).sum(-1).min())  # nearest side, from the axis
    lean = math.tan(math.radians(core.draft_deg)) * height
    share = 1.0 - (core.height_mm - height) / gelcore.side_height_mm(core)
    beside = sides + gelcore.bulge_mm(core, np.clip(share, 0.0, 1.0)) - lean - radius
    return MINIMUM_WALL_MM - float(min(below.min(), beside.min()))


def _beyond(points: Array, polygon: Array) -> float:
    """Largest signed distance of points to a convex counter-clockwise polygon, positive outside.

    1 um is forgiven.
    """
    outward, _ = _sides(polygon)
    return float(((points[:, None] - polygon[None]) * outward[None]).sum(-1).max()) - 1e-3


def _seat_margins(design: Parts) -> dict[str, float]:
    """Margins of a housing with seats; -inf of one without."""
    rules = (
        "seats_hold_core",
        "seats_centre_core",
        "seats_outside_view",
        "seats_clear_of_leds",
        "camera_board_fits",
        "camera_board_above_plate",
        "camera_board_above_core",
    )
    found = dict.fromkeys(rules, -math.inf)
    within, housing, core, camera = inside(design), design.housing, design.gelcore, design.camera
    if within is None or housing.seats is None:
        return found
    window_mm, collar = _window_mm(design), within.collar
    stops = [tab.outline for tab in within.tabs if tab.low_mm >= window_mm - 1e-9]
    turns = np.linspace(-math.pi, math.pi, 720, endpoint=False)
    way = np.column_stack([np.cos(turns), np.sin(turns)])
    rim = reach_mm(gelcore.polygon_at(core, core.height_mm), way)
    if collar is not None:
        found["seats_hold_core"] = LEAST_RIM_MM - (float(rim.max()) - collar.inner_mm)
        nearest = collar.inner_mm
    else:
        nearest = min((float(np.hypot(*outline.T).min()) for outline in stops), default=float(rim.max()))
        found["seats_hold_core"] = LEAST_RIM_MM - (float(rim.max()) - nearest)
    if not rings(design.leds):
        open_deg = widest_gap_deg(within.tabs_deg) - WIDEST_OPEN_DEG
        found["seats_centre_core"] = math.radians(open_deg) * housing.inner_radius_mm
    else:  # a ring around the core, between it and the tube
        found["seats_centre_core"] = (
            float(rim.max()) + 2 * housing.seats.gap_mm + MINIMUM_WALL_MM - housing.inner_radius_mm
        )
    seen, distance_mm = _sensing_area_seen(design)
    x_c, y_c, z_c = camera.eye_mm
    at_window = np.array([x_c, y_c]) + seen / distance_mm * max(z_c - window_mm, 0.0)
    found["seats_outside_view"] = float(np.linalg.norm(at_window, axis=1).max()) - nearest
    corners = np.concatenate([_Convex.box(body).corners for body in bodies(design.leds)])
    above = corners[corners[:, 2] > window_mm]
    if collar is not None and len(above):
        found["seats_clear_of_leds"] = collar.outer_mm + LIT_MM - float(np.hypot(*above[:, :2].T).min())
    board = camera_board(housing.seats.camera)
    found["camera_board_fits"] = board.barrel_mm - 2 * camera.body_radius_mm
    seat_mm = camera.position_mm[2] + board.pupil_mm
    found["camera_board_above_plate"] = LEAST_HEAD_MM + housing.top_mm - seat_mm
    found["camera_board_above_core"] = LIT_MM + _highest_mm(design) - (seat_mm - board.lens_height_mm)
    return found


def _step_margins(design: Parts) -> dict[str, float]:
    """What a housing of one's own adds to the margins of rules."""
    if design.housing.step is None:
        return {}
    own = step_part.mesh(design.housing.step)
    corners = np.asarray(own.triangles)
    area, distance_mm = _sensing_area_seen(design)
    below = corners[(corners[:, :, 2] < design.camera.eye_mm[2] - 1e-6).all(axis=1)]
    seen = tangents(design, below.reshape(-1, 3)).reshape(-1, 3, 2) * distance_mm
    outward, _ = _sides(area)
    # Triangles beyond one side of the sensing area are clear of it.
    beyond = (seen @ outward.T).min(axis=1) - (area @ outward.T).max(axis=0)
    clear = float(beyond.max(axis=1).min()) if len(below) else math.inf
    near = below[beyond.max(axis=1) <= 0] if len(below) else below
    into = intrusion_into_view_mm(design, list(near)) if len(near) else -clear
    share = np.linspace(-1.0, 1.0, 3)
    grid = np.stack(np.meshgrid(share, share, share), axis=-1).reshape(-1, 3)
    points = np.concatenate(
        [
            np.asarray(body.centre_mm)
            + (grid * body.half_mm) @ np.array([body.across, body.down, body.normal])
            for body in bodies(design.leds)
        ]
    )
    return {"view_through_plate": into, "leds_inside_housing": step_part.depth_mm(own, points)}


def _too_far_down(gel: Elastomer, outline: Array) -> float:
    """How far an outline reaches down the flank of a dome to where heights over (x, y) tell no shape.

    1 um is forgiven.
    """
    if gel.radius_mm is None:
        return -math.inf
    steepest_mm = gel.radius_mm * math.sin(math.radians(elastomer.STEEPEST_DEG))
    return float(np.linalg.norm(outline, axis=1).max()) - steepest_mm - 1e-3


def _beyond_picture(camera: Camera, tangents: Array) -> float:
    """How far a polygon of directions (n, 2) reaches out of the picture, in focal lengths.

    Points between the corners count too: a distorted edge may bulge.
    """
    share = np.linspace(0.0, 1.0, 16, endpoint=False)[:, None, None]
    edge = (tangents + share * (np.roll(tangents, -1, axis=0) - tangents)).reshape(-1, 2)
    column, row = camera.project(edge[:, 0], edge[:, 1])
    half_w, half_h = camera.width_px / 2, camera.height_px / 2
    across, down = np.abs(column - half_w) - half_w, np.abs(row - half_h) - half_h
    return float(np.maximum(across / camera.focal_px, down / camera.focal_rows_px).max())


def _camera_margins(design: Parts) -> dict[str, float]:
    camera, housing, core = design.camera, design.housing, design.gelcore
    x_c, y_c, z_c = camera.eye_mm
    outline = design.sensing_area.outline_mm()
    seen, distance_mm = _sensing_area_seen(design)
    through = -math.inf
    if design.optics.light_path == "core":
        # Rays run straight from the camera to the window.
        slope, towards = core.window_slope, seen / distance_mm
        drop_mm = max(z_c - _window_mm(design) - slope * y_c, 0.0) / (1 + slope * towards[:, 1:])
        at_window = np.array([x_c, y_c]) + towards * drop_mm
        through = float(np.linalg.norm(at_window, axis=1).max()) - core.window_diameter_mm / 2
        if _waist_mm(core):  # rays pass it midway between window and membrane
            waist = gelcore.outset(gelcore.polygon(core), -_waist_mm(core))
            through = max(through, _beyond((at_window + outline) / 2, waist))
    mirror, beside, lowest = camera.mirror, -math.inf, math.inf
    if mirror is not None:
        across, along, _ = mirror.axes
        half = np.array([(i * mirror.width_mm, j * mirror.height_mm) for i in (-1, 1) for j in (-1, 1)]) / 2
        ends = np.asarray(mirror.centre_mm) + half @ np.stack([across, along])
        lowest = min(float(ends[:, 2].min()), camera.position_mm[2])
        eye = np.array(camera.eye_mm)
        towards = eye + np.column_stack([seen / distance_mm, -np.ones(len(seen))])
        beside = float(mirror.reach_mm(eye, towards).max())
    hole = -math.inf
    # Where the mirror hangs inside the housing, light does not pass the plate.
    if z_c > housing.top_mm and lowest >= housing.top_mm:
        at_plate = np.array([x_c, y_c]) + seen * (z_c - housing.top_mm) / distance_mm
        hole = float(np.linalg.norm(at_plate, axis=1).max()) - housing.camera_hole_mm / 2
    return {
        "sensing_area_on_membrane": max(
            _beyond(outline, elastomer.polygon(design.elastomer)), _too_far_down(design.elastomer, outline)
        ),
        "camera_sees_membrane": _beyond_picture(camera, seen / distance_mm) * distance_mm,
        "camera_above_core": _window_mm(design) + max(core.window_slope * y_c, 0.0) - z_c,
        "camera_clears_plate": -math.inf
        if mirror is not None
        else 2 * camera.body_radius_mm - housing.camera_hole_mm,
        "mirror_fills_view": beside,
        "mirror_above_core": _window_mm(design) - lowest,
        "view_through_window": through,
        "view_through_plate": hole,
    }
