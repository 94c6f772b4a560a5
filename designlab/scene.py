"""A design and a membrane as plain data: meshes, materials, lights and camera. Knows no rendering engine."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from designlab.camera import View
from designlab.design import Design
from designlab.materials import AIR, GROUND_ROUGHNESS, material
from designlab.press import Surface
from geometries import elastomer, gelcore
from geometries.leds import Body, bodies, emitters

FloatArray = NDArray[np.float64]
LED_FACE_GAP_MM = 1e-3  # strips shine just above their board, so that the two never fight for a ray
FLAT_MM = 1e-6  # lower indentations are rounding of the smoothing, not gel
FACING_DEG = 20.0  # a side face that points at an LED row within this angle lets its light in


@dataclass(frozen=True)
class Medium:
    """What fills a volume: refractive index, and per mm the absorption for each LED group and the haze.

    `anisotropy` is the mean cosine g of the scattering angle (Henyey and Greenstein 1941).
    """

    index: float
    absorption_per_mm: tuple[float, ...]
    scattering_per_mm: float = 0.0
    anisotropy: float = 0.0

    @property
    def clear(self) -> bool:
        """Whether light passes undimmed."""
        return not any(self.absorption_per_mm) and self.scattering_per_mm == 0


@dataclass(frozen=True)
class Diffuse:
    """Opaque Lambertian surface; `reflectance` for the light of each LED group, zero is black."""

    reflectance: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Texture:
    """Factor on a reflectance by place (x, y), over a rectangle centred on the sensor's axis.

    `values` has shape (layers, rows, columns), row 0 at +y: one layer for all LED groups, or one for each.
    Between the centres of its cells it is interpolated linearly; beyond the rectangle its edge goes on.
    """

    values: NDArray[np.float32]
    width_mm: float
    height_mm: float

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the content."""
        return hashlib.sha256(self.values.tobytes() + repr(self.values.shape).encode()).hexdigest()

    def layer(self, group: int) -> NDArray[np.float32]:
        """Factor for the light of one LED group, shape (rows, columns)."""
        return np.asarray(self.values[group if len(self.values) > 1 else 0])

    def __repr__(self) -> str:
        return f"Texture({self.digest}, {self.width_mm!r}, {self.height_mm!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Texture) and repr(self) == repr(other)

    def __hash__(self) -> int:
        return hash(repr(self))


@dataclass(frozen=True)
class Coating:
    """The membrane's inner side: Lambertian, with a share `specular` of the reflected light in a GGX lobe.

    `reflectance` is for each LED group, `roughness` is alpha of the lobe. `texture` is a factor on the
    reflectance by place; their product stays within 1.
    """

    reflectance: tuple[float, ...]
    specular: float = 0.0
    roughness: float = 0.3
    texture: Texture | None = None
    transmittance: float = 0.0


@dataclass(frozen=True)
class Dielectric:
    """Clear boundary; normals point from the medium `inside` into the medium `outside`.

    `roughness` is alpha of the GGX distribution of facets, zero where it is smooth.
    """

    inside: Medium
    outside: Medium
    roughness: float = 0.0


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangle mesh with a material: vertices (n, 3) mm, faces (m, 3), optional vertex normals (n, 3)."""

    name: str
    vertices: FloatArray
    faces: NDArray[np.uint32]
    material: Diffuse | Coating | Dielectric
    normals: FloatArray | None = None


@dataclass(frozen=True)
class Light:
    """Lambertian rectangle of one LED group; `radiance` in mW/mm2/sr when the whole group emits 1 mW."""

    group: int
    centre_mm: tuple[float, float, float]
    normal: tuple[float, float, float]
    across: tuple[float, float, float]
    down: tuple[float, float, float]
    half_width_mm: float
    half_height_mm: float
    radiance: float


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything a renderer needs, in mm, in the sensor frame."""

    shapes: tuple[Shape, ...]
    lights: tuple[Light, ...]
    groups: int
    camera_mm: tuple[float, float, float]
    focal_px: float
    sensor_px: tuple[int, int]
    view: View
    path_length: int

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
        camera = self.camera_mm, self.focal_px, self.sensor_px, self.view
        return hashlib.sha256(repr((self.light_digest, camera)).encode()).hexdigest()

    @property
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
        state.update(repr((self.lights, self.groups, self.path_length)).encode())
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
    shapes = [_membrane(design, surface), *_boards(design)]
    if design.optics.light_path == "core":
        shapes += _core_and_gel(design)
    camera = design.camera
    return Scene(
        shapes=tuple(shapes),
        lights=tuple(_lights(design)),
        groups=len(design.leds.groups),
        camera_mm=camera.position_mm,
        focal_px=camera.focal_px,
        sensor_px=(camera.width_px, camera.height_px),
        view=view,
        path_length=design.optics.path_length,
    )


def _lights(design: Design) -> Iterator[Light]:
    rectangles = emitters(design.leds)
    area = [0.0] * len(design.leds.groups)
    for rectangle in rectangles:
        area[rectangle.group] += rectangle.area_mm2
    for r in rectangles:
        centre = np.asarray(r.centre_mm) + LED_FACE_GAP_MM * np.asarray(r.normal)
        radiance = 1.0 / (np.pi * area[r.group])
        x, y, z = (float(c) for c in centre)
        yield Light(
            r.group, (x, y, z), r.normal, r.across, r.down, r.half_width_mm, r.half_height_mm, radiance
        )


def _membrane(design: Design, surface: Surface) -> Shape:
    """Grid, fine where the gel is pressed, coarse elsewhere, without seams, cut off at the gel's outline."""
    gel = design.elastomer
    outline = elastomer.polygon(gel)
    x = _extended(surface.x_mm, float(outline[:, 0].min()), float(outline[:, 0].max()))
    y = _extended(surface.y_mm[::-1], float(outline[:, 1].min()), float(outline[:, 1].max()))[::-1]
    grid_x, grid_y = np.meshgrid(x, y)
    z = elastomer.base_mm(gel, grid_x, grid_y)
    p, q = elastomer.base_gradient(gel, grid_x, grid_y)
    column, row = int(np.searchsorted(x, surface.x_mm[0])), int(np.searchsorted(-y, -surface.y_mm[0]))
    fine = np.s_[row : row + len(surface.y_mm), column : column + len(surface.x_mm)]
    z[fine] += surface.height_mm
    dp, dq = surface.indentation_gradient
    p[fine] += dp
    q[fine] += dq
    pressed = np.zeros(z.shape, dtype=bool)
    pressed[fine] = surface.height_mm > FLAT_MM
    rows = _worth_keeping(np.asarray(pressed.any(axis=1)), row, len(surface.y_mm))
    columns = _worth_keeping(np.asarray(pressed.any(axis=0)), column, len(surface.x_mm))
    x, y, kept_nodes = x[columns], y[rows], np.ix_(rows, columns)
    grid_x, grid_y, z, p, q = (field[kept_nodes] for field in (grid_x, grid_y, z, p, q))
    middle_x, middle_y = np.meshgrid((x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2)
    corners = np.isfinite(z)
    whole = corners[1:, 1:] & corners[1:, :-1] & corners[:-1, 1:] & corners[:-1, :-1]
    kept = elastomer.inside(gel, middle_x, middle_y) & whole
    index = np.arange(grid_x.size, dtype=np.uint32).reshape(grid_x.shape)
    a, b, c, d = index[:-1, :-1][kept], index[:-1, 1:][kept], index[1:, 1:][kept], index[1:, :-1][kept]
    faces = np.concatenate([np.stack([a, d, c], axis=1), np.stack([a, c, b], axis=1)])
    normals = np.stack([-p, -q, np.ones_like(p)], axis=-1).reshape(-1, 3)
    normals = np.nan_to_num(normals / np.linalg.norm(normals, axis=-1, keepdims=True), nan=0.0)
    vertices = np.nan_to_num(np.stack([grid_x, grid_y, z], axis=-1).reshape(-1, 3))
    return Shape("membrane", vertices, faces, Coating(design.per_group("membrane_albedo")), normals)


def _worth_keeping(pressed: NDArray[np.bool_], first: int, count: int) -> NDArray[np.bool_]:
    """Grid lines through pressed gel with their neighbours, every eighth other fine one, all coarse ones.

    The `count` fine lines start at `first`; the coarse ones reach to the outline, which they must follow.
    """
    kept = pressed.copy()
    kept[1:] |= pressed[:-1]
    kept[:-1] |= pressed[1:]
    kept[first : first + count : 8] = True
    kept[:first] = True
    kept[first + count - 1 :] = True
    return kept


def _extended(axis: FloatArray, low: float, high: float) -> FloatArray:
    """Continue an ascending axis to [low, high] in at most 24 even steps a side, no finer than its own."""

    def beyond(edge: float, end: float) -> FloatArray:
        pitch = float(axis[1] - axis[0])
        steps = int(np.clip(np.ceil(abs(end - edge) / pitch), 1, 24))
        return np.linspace(edge, end, steps + 1)[1:]

    left = beyond(float(axis[0]), low)[::-1] if low < axis[0] - 1e-9 else np.empty(0)
    right = beyond(float(axis[-1]), high) if high > axis[-1] + 1e-9 else np.empty(0)
    return np.concatenate([left, axis, right])


def _boards(design: Design) -> Iterator[Shape]:
    """Front faces of the LED packages."""
    reflectance = Diffuse(design.per_group("board_reflectance"))
    for number, body in enumerate(bodies(design.leds)):
        yield _rectangle(f"board-{number}", body, reflectance)


def _rectangle(name: str, body: Body, surface: Diffuse) -> Shape:
    front = np.asarray(body.centre_mm) + body.half_mm[2] * np.asarray(body.normal)
    across, down = body.half_mm[0] * np.asarray(body.across), body.half_mm[1] * np.asarray(body.down)
    vertices = np.array(
        [front - across - down, front + across - down, front + across + down, front - across + down]
    )
    return Shape(
        name,
        vertices,
        _oriented(vertices, np.array([[0, 1, 2], [0, 2, 3]]), np.asarray(body.normal)),
        surface,
    )


def _oriented(vertices: FloatArray, faces: NDArray[np.int64], outward: FloatArray) -> NDArray[np.uint32]:
    """Faces wound so that their normals point along `outward` (one direction, or one for each face)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    flipped = (np.cross(b - a, c - a) * outward).sum(-1) < 0
    return np.where(flipped[:, None], faces[:, ::-1], faces).astype(np.uint32)


def _core_and_gel(design: Design) -> Iterator[Shape]:
    """Boundaries of gelcore and elastomer as light sees them: sides, window, interface; black where painted.

    The housing needs no shape: light that leaves the core and meets nothing is lost, as on black walls.
    """
    core, gel = design.gelcore, design.elastomer
    groups = len(design.leds.groups)
    inner, soft, air = (
        Medium(material(name).index, (0.0,) * groups)
        for name in (design.optics.gelcore_material, design.optics.elastomer_material, AIR.name)
    )
    black = Diffuse((0.0,) * groups)
    outline = gelcore.polygon(core, segments=72)
    lean_mm = np.tan(np.radians(core.draft_deg)) * core.height_mm
    top = (
        outline * (1 - lean_mm / (core.width_mm / 2))
        if core.shape == "hexagonal"
        else outline - lean_mm * np.sign(outline)
    )
    window_z = np.full(len(top), gel.thickness_mm + core.height_mm)
    low, high = np.column_stack([outline, _interface_z(design, outline)]), np.column_stack([top, window_z])
    for number, lit in enumerate(_sides_with_light(design, outline)):
        ends = [number, (number + 1) % len(outline)]
        side = np.concatenate([low[ends], high[ends[::-1]]])
        painted = core.side_finish == "painted" and not lit
        outward = side.mean(axis=0) * (1.0, 1.0, 0.0) * (-1.0 if painted else 1.0)
        faces = _oriented(side, np.array([[0, 1, 2], [0, 2, 3]]), outward)
        rough = GROUND_ROUGHNESS if core.side_finish == "ground" and not lit else 0.0
        yield Shape(f"core-side-{number}", side, faces, black if painted else Dielectric(inner, air, rough))
    yield _sheet("window", [top * 0.0, top], [window_z, window_z], Dielectric(inner, air))
    # The gel's rim is cut soft silicone against the housing, taken as black.
    rim = elastomer.polygon(gel, segments=72) * 0.999999
    lower = np.column_stack([rim, elastomer.base_mm(gel, rim[:, 0], rim[:, 1])])
    band = np.concatenate([lower, np.column_stack([rim, _interface_z(design, rim)])])
    ring = _band_faces(len(rim), 0, len(rim))
    inward = -band[ring].mean(axis=1) * (1.0, 1.0, 0.0)
    yield Shape("gel-rim", band, _oriented(band, ring, inward), black)
    rings = [outline * share for share in np.linspace(0.0, 1.0, 49)]
    yield _sheet("interface", rings, [_interface_z(design, ring) for ring in rings], Dielectric(soft, inner))


def _interface_z(design: Design, xy: FloatArray) -> FloatArray:
    """Height of the boundary between elastomer and gelcore at points (n, 2)."""
    gel = design.elastomer
    if gel.radius_mm is None:
        return np.full(len(xy), gel.thickness_mm)
    inner_mm = gel.radius_mm - gel.thickness_mm
    return np.asarray(gel.radius_mm - np.sqrt(np.maximum(inner_mm**2 - (xy**2).sum(axis=1), 0.0)))


def _sides_with_light(design: Design, outline: FloatArray) -> list[bool]:
    """Which side faces look at a row of LEDs."""
    edge = np.roll(outline, -1, axis=0) - outline
    facing_deg = np.degrees(np.arctan2(-edge[:, 0], edge[:, 1]))
    rows_deg = np.array([azimuth for group in design.leds.groups for azimuth in group.azimuth_deg])
    apart_deg = np.abs((facing_deg[:, None] - rows_deg[None] + 180.0) % 360.0 - 180.0)
    return [bool(near) for near in (apart_deg < FACING_DEG).any(axis=1)]


def _sheet(name: str, rings: list[FloatArray], heights: list[FloatArray], boundary: Dielectric) -> Shape:
    """Sheet facing the camera, through nested rings of equal point count; the first ring may be a point."""
    count = len(rings[0])
    vertices = np.concatenate([np.column_stack([xy, z]) for xy, z in zip(rings, heights, strict=True)])
    faces = np.concatenate(
        [_band_faces(count, ring * count, (ring + 1) * count) for ring in range(len(rings) - 1)]
    )
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-12]
    return Shape(name, vertices, _oriented(vertices, faces, np.array([0.0, 0.0, 1.0])), boundary)


def _band_faces(count: int, first: int, second: int) -> NDArray[np.int64]:
    """Triangles between two closed rings of `count` vertices that start at the given indices."""
    k = np.arange(count)
    following = (k + 1) % count
    a, b, c, d = first + k, first + following, second + following, second + k
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
