"""What light meets besides the membrane: LED boards, gelcore, gel, and the housing's inside."""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from designlab.core.types import Array
from designlab.sensor.design import Design
from designlab.sensor.led_mounting import front_corners, seated
from designlab.sensor.optical_constants import AIR
from designlab.sensor.seating import inside
from designlab.simulation.scene.materials import Dielectric, Diffuse, Medium, Shape
from designlab.simulation.scene.meshes import band_faces, oriented, sheet
from geometries import elastomer, gelcore, step_part
from geometries.outline import reach_mm

CLEARANCE_MM = 1e-3  # between parts that would otherwise touch and fight for a ray
GAP_MM = 0.02  # of air where gel and core have come apart: thick for light, thin for everything else
SIDE_RINGS = 25  # of the mesh of a curved side, from gel side to window
CAVITY_RINGS = 60  # of a hollow's mesh, from its bottom to its rim
FACING_DEG = 20.0  # a side face that points at an LED row within this angle lets its light in


def board_name(body: int) -> str:
    """Name of the shape of an LED package, given by its number."""
    return f"board-{body}"


def boards(design: Design) -> Iterator[Shape]:
    """Front faces of the LED packages; packages cast into the core are closed boxes."""
    reflectance = Diffuse(design.per_group("board_reflectance"))
    for number, body in enumerate(seated(design)[0]):
        vertices, faces = front_corners(body), np.array([[0, 1, 2], [0, 2, 3]])
        if design.leds.coupling == "embedded":
            back = vertices - 2 * body.half_mm[2] * np.asarray(body.normal)
            vertices = np.concatenate([vertices, back])
            faces = np.concatenate([faces, [[4, 5, 6], [4, 6, 7]], band_faces(4, 0, 4)])
        outward = vertices[faces].mean(axis=1) - np.asarray(body.centre_mm)
        yield Shape(board_name(number), vertices, oriented(vertices, faces, outward), reflectance)


def core_and_gel(design: Design) -> Iterator[Shape]:
    """Boundaries of gelcore and elastomer as light sees them: sides, window, interface.

    Paint wets the face it is on: seen from inside the core it reflects diffusely, without an air gap.
    """
    core, gel = design.gelcore, design.elastomer
    groups = len(design.leds.groups)
    inner, _, air = _media(design)
    paint, black = Diffuse((core.paint_reflectance,) * groups), Diffuse((0.0,) * groups)
    outline = gelcore.polygon(core, segments=72)
    top = gelcore.polygon_at(core, core.height_mm, segments=72)
    window_z = gel.thickness_mm + core.height_mm + core.window_slope * top[:, 1]
    low, high = np.column_stack([outline, _interface_z(design, outline)]), np.column_stack([top, window_z])
    curve = None if not core.side_bulge_mm else _Curve.of(design, outline, low, high)
    for number, lit in enumerate(_sides_with_light(design, outline)):
        ends = [number, (number + 1) % len(outline)]
        if curve is None:
            side, corners = np.concatenate([low[ends], high[ends[::-1]]]), np.array([[0, 1, 2], [0, 2, 3]])
        else:
            side, corners = curve.strip(ends)
        finish = (core.led_side_finish or "polished") if lit else core.side_finish
        painted = finish == "painted"
        outward = side.mean(axis=0) * (1.0, 1.0, 0.0) * (-1.0 if painted else 1.0)
        faces = oriented(side, corners, outward)
        rough = core.ground_roughness if finish == "ground" else 0.0
        # A round core is turned, not cut into flats: light is bent by its curve.
        normals = side * (1.0, 1.0, 0.0) / np.hypot(*side.T[:2])[:, None] if core.shape == "dome" else None
        if curve is not None:
            normals = curve.normals(ends, normals)
        matter = paint if painted else Dielectric(inner, air, rough)
        yield Shape(f"core-side-{number}", side, faces, matter, None if painted else normals)
    yield from _window(design, top, Dielectric(inner, air))
    # The gel's rim is cut soft silicone against the housing, taken as black.
    rim = elastomer.polygon(gel, segments=72) * 0.999999
    lower = np.column_stack([rim, elastomer.base_mm(gel, rim[:, 0], rim[:, 1])])
    yield _tube("gel-rim", lower, np.column_stack([rim, _interface_z(design, rim)]), black)
    yield from _interface(design, outline)


class _Curve(NamedTuple):
    """Rings of a core with curved sides, from gel side to window.

    Attributes
    ----------
    rings : array, shape (rings, corners, 3)
        Points of the sides (mm).
    slope : array, shape (rings,)
        How fast the sides lean outwards with height, mm a mm.
    """

    rings: Array
    slope: Array

    @classmethod
    def of(cls, design: Design, outline: Array, low: Array, high: Array) -> "_Curve":
        """Lay rings between the lower and the upper edge of the sides."""
        core, share = design.gelcore, np.linspace(0.0, 1.0, SIDE_RINGS)
        rings = []
        for part, out in zip(share, gelcore.bulge_mm(core, share), strict=True):
            z = low[:, 2] + part * (high[:, 2] - low[:, 2])
            rings.append(np.column_stack([gelcore.outset(outline, float(out)), z]))
        return cls(np.array(rings), gelcore.bulge_slope(core, share))

    def strip(self, ends: list[int]) -> tuple[Array, Array]:
        """Vertices and faces of the side between two corners."""
        first = 2 * np.arange(len(self.rings) - 1)[:, None]
        faces = np.concatenate([first + np.array([0, 1, 3]), first + np.array([0, 3, 2])])
        return self.rings[:, ends].reshape(-1, 3), faces

    def normals(self, ends: list[int], level: Array | None) -> Array:
        """Outward normals at the vertices of a side, whose level ones are given where the core is round."""
        if level is None:
            edge = self.rings[0, ends[1]] - self.rings[0, ends[0]]
            level = np.tile([edge[1], -edge[0], 0.0], (2 * len(self.rings), 1))
            level = level / np.linalg.norm(level, axis=1)[:, None]
        leaning = level - np.repeat(self.slope, 2)[:, None] * (0.0, 0.0, 1.0)
        return np.asarray(leaning / np.linalg.norm(leaning, axis=1)[:, None])


def _window(design: Design, top: Array, matter: Dielectric) -> Iterator[Shape]:
    """Camera side of the core: a plane, or a hollow with a plane rim around it."""
    core, window_mm = design.gelcore, design.elastomer.thickness_mm + design.gelcore.height_mm
    if core.cavity is None:
        level = np.full(len(top), window_mm)
        yield sheet("window", [top * 0.0, top], [level, level + core.window_slope * top[:, 1]], matter)
        return
    radius, depth = core.cavity
    # As round as a circle is, whatever the outline; its corners are kept.
    corners = np.arctan2(top[:, 1], top[:, 0])
    angles = np.unique(np.round(np.concatenate([corners, np.linspace(-np.pi, np.pi, 96, endpoint=False)]), 9))
    round_ = np.column_stack([np.cos(angles), np.sin(angles)])
    level, edge = np.full(len(angles), window_mm), radius * round_
    yield sheet("window-rim", [edge, round_ * reach_mm(top, round_)[:, None]], [level, level], matter)
    turns = np.radians(np.linspace(0.0, 90.0, CAVITY_RINGS))
    rings = [edge * np.sin(t) for t in turns]
    hollow = sheet("window", rings, [level - depth * np.cos(t) for t in turns], matter)
    inward = hollow.vertices - (0.0, 0.0, level[0])
    normals = -inward / np.array([radius, radius, depth]) ** 2
    yield replace(hollow, normals=normals / np.linalg.norm(normals, axis=1)[:, None])


def _interface(design: Design, outline: Array) -> Iterator[Shape]:
    """Boundary of gel and core; where they have come apart, that of each with the air between them."""
    radius_mm = design.elastomer.radius_mm
    for shape in _interface_faces(design, outline):
        if radius_mm is None:
            yield shape
            continue
        normals = (0.0, 0.0, radius_mm) - shape.vertices
        yield replace(shape, normals=normals / np.linalg.norm(normals, axis=1)[:, None])


def _interface_faces(design: Design, outline: Array) -> Iterator[Shape]:
    """Their faces, flat ones."""
    inner, soft, air = _media(design)
    centre, radius = np.asarray(design.optics.gap_centre_mm), design.optics.gap_radius_mm
    if not radius:
        rings = [outline * share for share in np.linspace(0.0, 1.0, 49)]
        yield sheet(
            "interface", rings, [_interface_z(design, ring) for ring in rings], Dielectric(soft, inner)
        )
        return
    corners = np.arctan2(*(outline - centre).T[::-1])
    angles = np.unique(np.round(np.concatenate([corners, np.linspace(-np.pi, np.pi, 96, endpoint=False)]), 9))
    round_ = np.column_stack([np.cos(angles), np.sin(angles)])
    edge = centre + reach_mm(outline - centre, round_)[:, None] * round_
    rim = centre + radius * round_
    rings = [rim + share * (edge - rim) for share in np.linspace(0.0, 1.0, 49)]
    yield sheet("interface", rings, [_interface_z(design, ring) for ring in rings], Dielectric(soft, inner))
    rings = [centre + share * radius * round_ for share in np.linspace(0.0, 1.0, 25)]
    heights = [_interface_z(design, ring) for ring in rings]
    yield sheet("gap-gel", rings, heights, Dielectric(soft, air))
    yield sheet("gap-core", rings, [z + GAP_MM for z in heights], Dielectric(air, inner))


def degelled(design: Design) -> Design:
    """Return the design with air where its gel is."""
    return design.replace({"optics.elastomer_index": AIR.index, "optics.elastomer_absorption_per_mm": (0.0,)})


def _interface_z(design: Design, xy: Array) -> Array:
    """Height of the boundary between elastomer and gelcore at points (n, 2)."""
    return elastomer.interface_mm(design.elastomer, xy[:, 0], xy[:, 1])


def _sides_with_light(design: Design, outline: Array) -> list[bool]:
    """Which side faces look at a row of LEDs; none where the LEDs are inside."""
    if design.leds.coupling == "embedded":
        return [False] * len(outline)
    edge = np.roll(outline, -1, axis=0) - outline
    facing_deg = np.degrees(np.arctan2(-edge[:, 0], edge[:, 1]))
    rows_deg = np.array([azimuth for group in design.leds.groups for azimuth in group.azimuth_deg])
    apart_deg = np.abs((facing_deg[:, None] - rows_deg[None] + 180.0) % 360.0 - 180.0)
    return [bool(near) for near in (apart_deg < FACING_DEG).any(axis=1)]


def _media(design: Design) -> tuple[Medium, Medium, Medium]:
    """Gelcore, gel and air."""
    optics = design.optics
    return (
        Medium(
            optics.core_index,
            design.absorption_per_mm("gelcore"),
            optics.gelcore_scattering_per_mm,
            optics.gelcore_anisotropy if optics.gelcore_scattering_per_mm else 0.0,
        ),
        Medium(optics.gel_index, design.absorption_per_mm("elastomer")),
        Medium(AIR.index, (0.0,) * len(design.leds.groups)),
    )


def housing_inside(design: Design) -> Iterator[Shape]:
    """Inside of the housing: tube, camera plate with its hole, and floor around the gel; or one's own part.

    Black walls need no shape: light that meets nothing is lost as well. The floor stands at the tube's lower
    rim, or just below the LEDs where those reach lower.
    """
    reflectance = design.per_group("housing_reflectance")
    if design.housing.step is not None:  # even a black one may stand in the light
        own = step_part.mesh(design.housing.step)
        name = "housing-step" if any(reflectance) else "part-step"
        yield Shape(
            name, np.asarray(own.vertices), np.asarray(own.faces, dtype=np.uint32), Diffuse(reflectance)
        )
        return
    if not any(reflectance):
        return
    housing, walls = design.housing, Diffuse(reflectance)
    lowest_mm = min(float(front_corners(body)[:, 2].min()) for body in seated(design)[0])
    floor_mm = min(housing.bottom_mm, lowest_mm - CLEARANCE_MM)
    part = gelcore.polygon(design.gelcore) if design.optics.light_path == "core" else None
    inner = elastomer.polygon(design.elastomer) if part is None else part
    corners = np.arctan2(inner[:, 1], inner[:, 0])
    turns = np.concatenate([corners / (2 * np.pi), np.arange(144) / 144]) % 1.0
    angles = np.unique(np.round(turns, 9) % 1.0) * 2 * np.pi
    round_ = np.column_stack([np.cos(angles), np.sin(angles)])
    count = len(angles)
    tube, hole = housing.inner_radius_mm * round_, housing.camera_hole_mm / 2 * round_
    edge = round_ * reach_mm(inner, round_)[:, None] + CLEARANCE_MM * round_
    low, high = (np.column_stack([tube, np.full(count, z)]) for z in (floor_mm, housing.top_mm))
    yield _tube("housing-tube", low, high, walls)
    top = np.full(count, housing.top_mm)
    yield sheet("housing-plate", [hole, tube], [top, top], walls, up=-1.0)
    bottom = np.full(count, floor_mm)
    yield sheet("housing-floor", [edge, tube], [bottom, bottom], walls)


def seats(design: Design) -> Iterator[Shape]:
    """What seats put between LEDs, core and camera: the collar with its feet, and the tabs.

    They are there even when they are black, since they may stand in the light. The pockets of LED boards and
    the holes for their wires lie behind the LEDs' fronts, where light of these never arrives. A ring around
    the gel is left out: traced with it, the mean light of no group changes by more than 1e-4, and the darkest
    border by less than 1 % (presets default and gelsight-mini-like).
    """
    within = inside(design)
    if within is None:
        return
    reflectance = design.per_group("housing_reflectance")
    # Shapes named after the housing are those that a bright one is mirrored by.
    name, walls = "housing" if any(reflectance) else "seat", Diffuse(reflectance)
    if (collar := within.collar) is not None:
        turns = np.arange(144) / 144 * 2 * np.pi
        round_ = np.column_stack([np.cos(turns), np.sin(turns)])
        rings = []
        for radius in (collar.inner_mm, collar.outer_mm):
            edge = radius * round_
            lower = collar.low_mm + collar.slope * edge[:, 1] + CLEARANCE_MM
            rings.append(
                (np.column_stack([edge, lower]), np.column_stack([edge, np.full(144, collar.high_mm)]))
            )
        (near_low, near_high), (far_low, far_high) = rings
        yield _tube(f"{name}-collar-inside", near_low, near_high, walls)
        yield _tube(f"{name}-collar-outside", far_low, far_high, walls, outside=True)
        band, faces = np.concatenate([near_low, far_low]), band_faces(144, 0, 144)
        down = np.tile([0.0, 0.0, -1.0], (len(faces), 1))
        yield Shape(f"{name}-collar-end", band, oriented(band, faces, down), walls)
    for number, tab in enumerate((*within.tabs, *within.feet)):
        count = len(tab.outline)
        low, high = (np.column_stack([tab.outline, np.full(count, z)]) for z in (tab.low_mm, tab.high_mm))
        around = np.concatenate([low, high])
        faces = band_faces(count, 0, count)
        out = around[faces].mean(axis=1) - around.mean(axis=0)
        middle = np.concatenate([low, low.mean(axis=0, keepdims=True)])
        ends = np.arange(count)
        fan = np.column_stack([ends, np.roll(ends, -1), np.full(count, count)])
        yield Shape(f"{name}-tab-{number}", around, oriented(around, faces, out * (1.0, 1.0, 0.0)), walls)
        down = np.tile([0.0, 0.0, -1.0], (count, 1))
        yield Shape(f"{name}-tab-{number}-end", middle, oriented(middle, fan, down), walls)


def _tube(name: str, low: Array, high: Array, surface: Diffuse, *, outside: bool = False) -> Shape:
    """Wall between two rings about the axis that shows its inside, or its outside."""
    wall, ring = np.concatenate([low, high]), band_faces(len(low), 0, len(low))
    outward = wall[ring].mean(axis=1) * (1.0, 1.0, 0.0)
    return Shape(name, wall, oriented(wall, ring, outward if outside else -outward), surface)
