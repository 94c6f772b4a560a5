"""Standard objects that are pressed into the gel, and any mesh a user gives.

Every probe stands on a shank or plate of its own outline, so that it can be printed and clamped; only its
upper surface, `profile_mm`, presses.
"""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from geometries import mesh_files
from geometries.mesh import from_solid
from geometries.mesh_files import FORMATS, SIDES, UNITS_MM, Side, Understood, Unit
from geometries.outline import (
    beyond_inset_star_mm,
    inside_star,
    largest_inset_mm,
    regular_polygon,
    star_polygon,
)
from geometries.raster import height_map
from geometries.spec import Spec, quantity

if TYPE_CHECKING:
    import cadquery
    import trimesh

ProbeKind = Literal["sphere", "triangle", "star", "cylinder", "cone", "prism", "dots", "wave", "bars", "mesh"]

SIZES: dict[ProbeKind, str] = {
    "sphere": "diameter of the ball",
    "triangle": "side of the flat equilateral face, a corner at +y",
    "star": "diameter of the circle through the tips of the flat five-pointed face, a tip at +y",
    "cylinder": "diameter of the lying cylinder, whose axis is x; it is twice as long",
    "cone": "diameter of the base; the apex angle is 90 deg, so it is half as high",
    "prism": "width along y of the base of the lying ridge, whose 90 deg edge is x; it is twice as long",
    "dots": "distance between neighbouring hemispheres, 3 x 3 on a square plate, each 0.6 of it in diameter",
    "wave": "wavelength of the sinusoidal ridges along y, a quarter of it high, on 3 x 3 wavelengths",
    "bars": "distance between the axes of two flat bars along y, each half of it wide, 2.5 times as long and "
    "4 times as high, on a plate",
    "mesh": "larger extent of the mesh across the direction in which it is pressed",
}
"""What `size_mm` measures, by kind of probe."""

DEFAULT_SIZE_MM = 4.0
"""Size of a library probe whose text gives none."""

STAR_INNER = 0.45
"""Radius of the star's notches as a share of the radius of its tips."""
STAR_TIPS = 5
DOT_SHARE = 0.6
"""Diameter of a dot as a share of the distance between dots."""
BAR_WIDTH, BAR_LENGTH, BAR_HEIGHT = 1 / 2, 5 / 2, 4.0
"""Sides of a bar as shares of the distance between the axes of two."""
WAVE_AMPLITUDE = 1 / 8
"""Amplitude (half the height from trough to crest) of the wave as a share of its wavelength."""

MESH_TEXT = re.compile(rf"(.+(?:{'|'.join(map(re.escape, FORMATS))}))(?::(.*))?", re.IGNORECASE)
"""Form of a probe given as a mesh: its file and, after colons, its size or its unit, and its side."""

LARGEST_MM, LARGEST_MESH_MM = 100.0, 1000.0
"""Largest size of a library probe, and of a mesh, of which only a part may touch."""

LARGEST_EDGE: dict[ProbeKind, float] = {
    "triangle": largest_inset_mm(tips=3, outer_mm=3**-0.5, inner_mm=3**-0.5 / 2),
    "star": largest_inset_mm(tips=STAR_TIPS, outer_mm=1 / 2, inner_mm=STAR_INNER / 2),
    "cone": 2**-0.5,
    "prism": 2**-0.5,
}
"""Edge radius as a share of the size at which nothing straight is left beside the edge, by kind of probe."""

REACH: dict[ProbeKind, float] = {
    "sphere": 1 / 2,
    "triangle": 3**-0.5,
    "star": 1 / 2,
    "cylinder": 5**0.5 / 2,
    "cone": 1 / 2,
    "prism": 5**0.5 / 2,
    "dots": 3 * 2**-0.5,
    "wave": 3 * 2**-0.5,
    "bars": (0.75**2 + 1.25**2) ** 0.5,
    "mesh": 2**-0.5,
}
"""Largest distance from the axis to the outline as a share of the size, by kind of probe."""

WAVE_POINTS = 48
"""Points per wavelength of the cubic spline that stands for the sine in CAD."""
MIN_SHANK_MM = 5.0
"""Least length of the shank behind the pressing surface; larger probes have one as long as their size."""


def _is_zero(value: float) -> bool:
    return value == 0


def _is_upper(side: str) -> bool:
    return side == "+z"


class Probe(Spec):
    """A probe is the rigid body that is pressed into the gel.

    In its own frame its foremost point touches z = 0 and it extends towards -z; it moves along +z into the
    gel.

    Parameters
    ----------
    kind : str
        Shape of the probe, one of `SIZES`.
    size_mm : float
        Characteristic size in mm, see `SIZES`.
    file : str, optional
        Mesh file of a probe of kind ``mesh``, see `geometries.mesh_files.FORMATS`.
    edge_radius_mm : float
        Radius in mm to which the edge that presses is rounded: the border of a triangle's or star's flat
        face, the point of a cone, the edge of a prism. 0 is sharp. The probe is what a ball of this radius
        can fill of the sharp shape, so the corners of an outline are rounded in plan as well, as the round
        bead of a printer leaves them; `size_mm` still measures the sharp shape.
    side : str
        Side of a mesh that presses, by the axes of its file.

    Raises
    ------
    pydantic.ValidationError
        If the kind is unknown, the size is out of its bounds, the file is missing or superfluous, or the
        edge radius is too large or stated of a kind without such an edge.
    """

    kind: ProbeKind = Field(description="Shape of the probe.")
    size_mm: float = quantity(
        unit="mm", gt=0.05, le=LARGEST_MESH_MM, description="Characteristic size, see `SIZES`."
    )
    file: str | None = Field(None, description="Mesh file of a probe of kind mesh.")
    # Left out where it is zero: what was kept and named before probes had it keeps its digest.
    edge_radius_mm: float = quantity(
        0.0, unit="mm", description="Radius of the edge that presses; 0 is sharp.", ge=0, exclude_if=_is_zero
    )
    side: Side = Field(
        "+z", description="Side of a mesh that presses, by the axes of its file.", exclude_if=_is_upper
    )

    @field_validator("size_mm")
    @classmethod
    def _library_probes_are_small(cls, size_mm: float, info: ValidationInfo) -> float:
        if info.data.get("kind") != "mesh" and size_mm > LARGEST_MM:
            raise ValueError(f"Input should be less than or equal to {LARGEST_MM:g}")
        return size_mm

    @model_validator(mode="after")
    def _mesh_has_file(self) -> Self:
        if self.kind == "mesh" and self.file is None:
            raise ValueError("file: a probe of kind mesh needs its mesh file")
        if self.kind != "mesh" and self.file is not None:
            raise ValueError(f"file: only a probe of kind mesh has a file, kind is {self.kind!r}")
        if self.kind != "mesh" and self.side != "+z":
            raise ValueError(f"side: only of a probe of kind mesh it can be chosen, kind is {self.kind!r}")
        return self

    @model_validator(mode="after")
    def _edge_fits(self) -> Self:
        if self.edge_radius_mm == 0:
            return self
        if self.kind not in LARGEST_EDGE:
            raise ValueError(
                f"edge_radius_mm: only {', '.join(LARGEST_EDGE)} have a sharp edge that presses, "
                f"kind is {self.kind!r}, leave it out"
            )
        if self.edge_radius_mm >= (largest := LARGEST_EDGE[self.kind] * self.size_mm):
            raise ValueError(
                f"edge_radius_mm: must be below {largest:.4g} mm on a {self.kind} of {self.size_mm:g} mm, "
                f"is {self.edge_radius_mm:g} mm"
            )
        return self

    @property
    def text(self) -> str:
        """The probe in the form that `parse` reads, for example ``sphere:4`` or ``triangle:5:r0.2``."""
        edge = f":r{self.edge_radius_mm:.12g}" if self.edge_radius_mm else ""
        side = "" if self.side == "+z" else f":{self.side}"
        return f"{self.file or self.kind}:{self.size_mm:.12g}{edge}{side}"

    @property
    def is_round(self) -> bool:
        """Whether the probe is the same however it is turned about its axis."""
        return self.kind in ("sphere", "cone")

    def scaled(self, factor: float) -> Self:
        """Return the probe with all its lengths multiplied by `factor`; bounds are not checked."""
        lengths = {"size_mm": self.size_mm * factor, "edge_radius_mm": self.edge_radius_mm * factor}
        return self.model_copy(update=lengths)


def parse(text: str, *, unit: Unit | None = None, side: Side | None = None) -> Probe:
    """Read a probe from its short form.

    Parameters
    ----------
    text : str
        ``kind[:size_mm[:rEDGE]]`` such as ``sphere:4.0``, ``triangle`` (4 mm then) or ``triangle:5:r0.2``
        (edge radius 0.2 mm), or a mesh file ``path.stl[:size_mm][:unit][:side]`` such as ``knob.stl``,
        ``knob.stl:12`` (scaled to 12 mm), ``knob.stl:m`` (its numbers are metres) or ``knob.stl:m:-z``.
    unit : str, optional
        Unit of a mesh file whose text states none.
    side : str, optional
        Side of a mesh that presses where its text states none; +z when absent.

    Raises
    ------
    ValueError
        If the kind is unknown, a length is no number or out of bounds, or the mesh file is not usable.
    """
    if is_mesh(text):
        stated = mesh_text(text, unit=unit, side=side)
        return from_file(stated.file, size_mm=stated.size_mm, unit=stated.unit, side=stated.side or "+z")
    if unit is not None or side is not None:
        what = "side" if unit is None else "unit"
        raise ValueError(f"probe: --probe-{what} is for mesh files, {text!r} is none; leave it out")
    name, colon, lengths = text.strip().partition(":")
    library = {kind: kind for kind in SIZES if kind != "mesh"}
    if name not in library:
        raise ValueError(
            f"probe: unknown {name!r} in {text!r}; known are {', '.join(library)}, or a mesh file "
            f"({' '.join(FORMATS)})"
        )
    size_mm, edge_mm = _lengths_mm(lengths, text) if colon else (DEFAULT_SIZE_MM, 0.0)
    try:
        return Probe(kind=library[name], size_mm=size_mm, edge_radius_mm=edge_mm)
    except ValidationError as error:
        broken = error.errors()[0]
        if not broken["loc"]:  # a rule of several fields, which names them
            raise ValueError(f"probe: {text!r}: {broken['msg'].removeprefix('Value error, ')}") from None
        said = broken["msg"].removeprefix("Value error, ")
        raise ValueError(f"probe: {broken['loc'][0]} in {text!r}: {said} (mm)") from None


class MeshText(NamedTuple):
    """What the text of a mesh probe states: file, size (mm), unit and side."""

    file: str
    size_mm: float | None
    unit: Unit | None
    side: Side | None

    @property
    def text(self) -> str:
        """The text that `mesh_text` reads."""
        size = None if self.size_mm is None else f"{self.size_mm:.12g}"
        return ":".join(part for part in (self.file, size, self.unit, self.side) if part is not None)


def is_mesh(text: str) -> bool:
    """Whether a probe's text names a mesh file."""
    return MESH_TEXT.fullmatch(text.strip()) is not None


def mesh_text(text: str, *, unit: Unit | None = None, side: Side | None = None) -> MeshText:
    """Read the text of a mesh probe; its file is not opened.

    Parameters
    ----------
    text : str
        ``path.stl[:size_mm][:unit][:side]``.
    unit, side : str, optional
        What is stated beside the text.

    Raises
    ------
    ValueError
        If a part is none of these, stated twice, or size and unit are both stated.
    """
    match = MESH_TEXT.fullmatch(text.strip())
    if match is None:
        raise ValueError(f"probe: {text!r} names no mesh file ({' '.join(FORMATS)})")
    given = {"unit": unit, "side": side}
    found: dict[str, Any] = {}
    for part in () if match[2] is None else match[2].split(":"):
        if part in UNITS_MM:
            what, value = "unit", cast("float | str", part)
        elif part in SIDES:
            what, value = "side", part
        elif re.match(r"r[\d.]", part):
            raise ValueError(f"probe: a mesh has the edges of its file, leave out the radius in {text!r}")
        else:
            what, value = "size_mm", _mesh_size(part, text)
        if what in found:
            raise ValueError(f"probe: {text!r} states its {what} twice")
        found[what] = value
    for what, beside in given.items():
        if beside is not None and found.setdefault(what, beside) != beside:
            raise ValueError(f"probe: {text!r} states the {what} {found[what]}, --probe-{what} says {beside}")
    if "size_mm" in found and "unit" in found:
        raise ValueError(f"probe: {text!r} states a size in mm and a unit of the file, leave out one of them")
    return MeshText(match[1], found.get("size_mm"), found.get("unit"), found.get("side"))


def _mesh_size(part: str, text: str) -> float:
    try:
        return _number(part, "size", text)
    except ValueError as error:
        raise ValueError(
            f"{error}; nor is it a unit ({' '.join(UNITS_MM)}) or a side ({' '.join(SIDES)})"
        ) from None


def _lengths_mm(lengths: str, text: str) -> tuple[float, float]:
    """Size and edge radius of what follows a probe's name, ``size`` or ``size:rEDGE``."""
    size, colon, edge = lengths.partition(":")
    if colon and not edge.startswith("r"):
        raise ValueError(
            f"probe: after the size comes the edge radius in mm, such as r0.2, is {edge!r} in {text!r}"
        )
    size_mm = _number(size, "size", text)
    return size_mm, _number(edge[1:], "edge radius", text) if colon else 0.0


def _number(value: str, what: str, text: str) -> float:
    try:
        return float(value)
    except ValueError:
        raise ValueError(f"probe: the {what} must be a number in mm, is {value!r} in {text!r}") from None


def sphere(diameter_mm: float) -> Probe:
    """Make a ball, on a round shank of its diameter.

    Parameters
    ----------
    diameter_mm : float
        Diameter of the ball in mm, above 0.05, at most 100.

    Returns
    -------
    Probe

    Raises
    ------
    pydantic.ValidationError
        If the size is out of its bounds.
    """
    return Probe(kind="sphere", size_mm=diameter_mm)


def triangle(side_mm: float, *, edge_radius_mm: float = 0.0) -> Probe:
    """Make a flat equilateral triangle with a corner at +y.

    Parameters
    ----------
    side_mm : float
        Side of the triangle in mm, above 0.05, at most 100.
    edge_radius_mm : float
        Radius of the edge of the face in mm, see `Probe`.

    Returns
    -------
    Probe

    Raises
    ------
    pydantic.ValidationError
        If a length is out of its bounds.
    """
    return Probe(kind="triangle", size_mm=side_mm, edge_radius_mm=edge_radius_mm)


def star(diameter_mm: float, *, edge_radius_mm: float = 0.0) -> Probe:
    """Make a flat five-pointed star with a tip at +y.

    Parameters
    ----------
    diameter_mm : float
        Diameter of the circle through the tips in mm, above 0.05, at most 100.
    edge_radius_mm : float
        Radius of the edge of the face in mm, see `Probe`.

    Returns
    -------
    Probe

    Raises
    ------
    pydantic.ValidationError
        If a length is out of its bounds.
    """
    return Probe(kind="star", size_mm=diameter_mm, edge_radius_mm=edge_radius_mm)


def cylinder(diameter_mm: float) -> Probe:
    """Make a cylinder that lies along x, twice as long as its diameter.

    Parameters
    ----------
    diameter_mm : float
        Diameter in mm, above 0.05, at most 100.

    Returns
    -------
    Probe

    Raises
    ------
    pydantic.ValidationError
        If a length is out of its bounds.
    """
    return Probe(kind="cylinder", size_mm=diameter_mm)


def cone(base_mm: float, *, edge_radius_mm: float = 0.0) -> Probe:
    """Make a cone of 90 deg apex angle, its point sharp or rounded.

    Parameters
    ----------
    base_mm : float
        Diameter of its base in mm, above 0.05, at most 100.
    edge_radius_mm : float
        Radius of the edge in mm, see `Probe`.

    Returns
    -------
    Probe

    Raises
    ------
    pydantic.ValidationError
        If a length is out of its bounds.
    """
    return Probe(kind="cone", size_mm=base_mm, edge_radius_mm=edge_radius_mm)


def prism(width_mm: float, *, edge_radius_mm: float = 0.0) -> Probe:
    """Make a lying ridge with an edge of 90 deg along x, twice as long as wide.

    Parameters
    ----------
    width_mm : float
        Width of its base along y in mm, above 0.05, at most 100.
    edge_radius_mm : float
        Radius of the edge in mm, see `Probe`.

    Returns
    -------
    Probe

    Raises
    ------
    pydantic.ValidationError
        If a length is out of its bounds.
    """
    return Probe(kind="prism", size_mm=width_mm, edge_radius_mm=edge_radius_mm)


def dots(pitch_mm: float) -> Probe:
    """Make nine hemispheres, 3 x 3, on a square plate.

    Parameters
    ----------
    pitch_mm : float
        Distance between neighbours in mm, above 0.05, at most 100.

    Returns
    -------
    Probe

    Raises
    ------
    pydantic.ValidationError
        If a length is out of its bounds.
    """
    return Probe(kind="dots", size_mm=pitch_mm)


def bars(distance_mm: float) -> Probe:
    """Make two flat bars along y, as far apart as wide.

    Parameters
    ----------
    distance_mm : float
        Distance between their axes in mm, above 0.05, at most 100.

    Returns
    -------
    Probe

    Raises
    ------
    pydantic.ValidationError
        If a length is out of its bounds.
    """
    return Probe(kind="bars", size_mm=distance_mm)


def wave(wavelength_mm: float) -> Probe:
    """Make sinusoidal ridges along y, 3 x 3 wavelengths, a crest at x = 0.

    Parameters
    ----------
    wavelength_mm : float
        Wavelength in mm, above 0.05, at most 100.

    Returns
    -------
    Probe

    Raises
    ------
    pydantic.ValidationError
        If a length is out of its bounds.
    """
    return Probe(kind="wave", size_mm=wavelength_mm)


def from_file(
    path: str | Path, *, size_mm: float | None = None, unit: Unit | None = None, side: Side = "+z"
) -> Probe:
    """Make a probe of a mesh file.

    Parameters
    ----------
    path : str or Path
        STL, OBJ, PLY, OFF, GLB, glTF, 3MF or STEP file. Only its surface seen from the side that presses
        counts, so it need not close.
    size_mm : float, optional
        Larger extent across the pressing direction in mm, to which it is scaled; its own when absent.
    unit : str, optional
        Unit of the file, ``"um"``, ``"mm"``, ``"cm"``, ``"m"`` or ``"inch"``, where no size is given. When
        absent that of the file or its format, else mm if that is plausible.
    side : str
        Side that presses, ``"+z"``, ``"-z"``, ``"+x"``, ``"-x"``, ``"+y"`` or ``"-y"`` of the file.

    Returns
    -------
    Probe

    Warns
    -----
    geometries.mesh_files.MeshNote
        About what was left out of the file or taken for something else.

    Raises
    ------
    ValueError
        If the file holds nothing that can press, see `geometries.mesh_files.load`, or its unit must be
        stated.
    """
    own_mm = mesh_files.own_size_mm(path, unit=unit, side=side) if size_mm is None else size_mm
    try:
        probe = Probe(kind="mesh", size_mm=own_mm, file=str(path), side=side)
    except ValidationError as error:
        broken = error.errors()[0]
        raise ValueError(f"{path}: size {own_mm:g} mm: {broken['msg']}") from None
    mesh(probe)
    return probe


def understood(probe: Probe) -> Understood | None:
    """Say what the mesh file of a probe is taken for; None of a library probe."""
    if probe.file is None:
        return None
    return mesh_files.understood(probe.file, size_mm=probe.size_mm, side=probe.side)


def thickness_mm(probe: Probe) -> float:
    """Height of a mesh along the direction in which it is pressed (mm); library probes have no end."""
    return float(mesh(probe).extents[2]) if probe.kind == "mesh" else np.inf


def profile_mm(probe: Probe, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
    """Height of the probe's upper surface.

    Parameters
    ----------
    probe : Probe
        The probe.
    x, y : array_like
        Points in the probe's own frame (mm), broadcast against each other.

    Returns
    -------
    ndarray
        Height in mm, zero at the foremost point and negative elsewhere; -inf outside the probe's outline.
        Closed forms, except for a mesh, whose triangles are cast.
    """
    x, y = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
    if probe.kind == "mesh":
        return height_map(mesh(probe), x, y)
    size, edge = probe.size_mm, probe.edge_radius_mm
    ax, ay, r = np.abs(x), np.abs(y), np.hypot(x, y)
    if probe.kind == "sphere":
        return _within(r <= size / 2, _ball_mm(r, size / 2))
    if probe.kind == "triangle":
        outer = size / np.sqrt(3)
        return _flat_face_mm(x, y, edge, tips=3, outer_mm=outer, inner_mm=outer / 2)
    if probe.kind == "star":
        return _flat_face_mm(x, y, edge, tips=STAR_TIPS, outer_mm=size / 2, inner_mm=STAR_INNER * size / 2)
    if probe.kind == "cylinder":
        return _within((ax <= size) & (ay <= size / 2), _ball_mm(ay, size / 2))
    if probe.kind == "cone":
        return _within(r <= size / 2, _flank_mm(r, edge))
    if probe.kind == "prism":
        return _within((ax <= size) & (ay <= size / 2), _flank_mm(ay, edge))
    if probe.kind == "bars":
        on_bar = np.abs(ax - size / 2) <= BAR_WIDTH * size / 2
        in_plate = (ax <= (1 + BAR_WIDTH) * size / 2) & (ay <= BAR_LENGTH * size / 2)
        return _within(in_plate, np.where(on_bar, 0.0, -BAR_HEIGHT * size))
    in_plate = (ax <= 1.5 * size) & (ay <= 1.5 * size)
    if probe.kind == "dots":
        column, row = np.clip(np.round(x / size), -1, 1), np.clip(np.round(y / size), -1, 1)
        to_dot = np.hypot(x - size * column, y - size * row)
        return _within(in_plate, _ball_mm(to_dot, DOT_SHARE * size / 2))
    return _within(in_plate, WAVE_AMPLITUDE * size * (np.cos(2 * np.pi * x / size) - 1))


def _within(inside: NDArray[np.bool_], height_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(inside, height_mm, -np.inf)


def _ball_mm(distance_mm: NDArray[np.float64], radius_mm: float) -> NDArray[np.float64]:
    """Height of a ball touching z = 0 at a distance from its axis; beyond it, the height of its centre."""
    distance_mm = np.minimum(distance_mm, radius_mm)
    root = np.sqrt(np.maximum(radius_mm**2 - distance_mm**2, 0.0))
    # R - sqrt(R^2 - r^2) rewritten without the difference, which would cancel near the apex.
    return np.asarray(-(distance_mm**2) / (radius_mm + root))


def _flat_face_mm(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    edge_mm: float,
    *,
    tips: int,
    outer_mm: float,
    inner_mm: float,
) -> NDArray[np.float64]:
    """Height of a star's flat face, which falls as a quarter circle within `edge_mm` of its outline."""
    if edge_mm == 0:
        return _within(inside_star(x, y, tips=tips, outer_mm=outer_mm, inner_mm=inner_mm), np.zeros(x.shape))
    beyond = beyond_inset_star_mm(x, y, tips=tips, outer_mm=outer_mm, inner_mm=inner_mm, inset_mm=edge_mm)
    return _within(beyond <= edge_mm * (1 + 1e-12), _ball_mm(beyond, edge_mm))


def _flank_mm(distance_mm: NDArray[np.float64], edge_mm: float) -> NDArray[np.float64]:
    """Height of a flank of 45 deg at a distance from its edge, which is rounded up to where it is tangent."""
    if edge_mm == 0:
        return -distance_mm
    lost = edge_mm * (np.sqrt(2) - 1)  # of the height of the sharp shape
    return np.where(distance_mm < edge_mm / np.sqrt(2), _ball_mm(distance_mm, edge_mm), lost - distance_mm)


def mesh(probe: Probe, *, tolerance_mm: float = 0.005) -> "trimesh.Trimesh":
    """Watertight mesh of probe and shank in the probe's own frame (mm); of a user's file its triangles."""
    if probe.file is not None:
        return mesh_files.load(probe.file, size_mm=probe.size_mm, side=probe.side)
    return from_solid(solid(probe), tolerance_mm=tolerance_mm)


def solid(probe: Probe) -> "cadquery.Workplane":
    """Build the probe with its shank as one closed CadQuery solid in its own frame (mm).

    Raises
    ------
    ValueError
        For a probe of kind mesh, which has no CAD solid; `mesh` gives its triangles.
    """
    if probe.kind == "mesh":
        raise ValueError(f"kind: a mesh probe ({probe.file}) has no CAD solid, use its mesh")
    size, edge, back = probe.size_mm, probe.edge_radius_mm, -max(MIN_SHANK_MM, probe.size_mm)
    if probe.kind in ("sphere", "cone"):
        return _turned(size / 2, back - size / 2, edge, round_tip=probe.kind == "sphere")
    if probe.kind == "triangle":
        corners = regular_polygon(corners=3, radius_mm=size / np.sqrt(3), azimuth_deg=90.0)
        return _prismatic(corners, back, edge)
    if probe.kind == "star":
        corners = star_polygon(tips=STAR_TIPS, outer_mm=size / 2, inner_mm=STAR_INNER * size / 2)
        return _prismatic(corners, back, edge)
    if probe.kind == "dots":
        return _dots(size, back - DOT_SHARE * size / 2)
    if probe.kind == "bars":
        return _bars(size, back - BAR_HEIGHT * size)
    return _ridged(probe.kind, size, back - size / 2, edge)


def _turned(radius_mm: float, bottom_mm: float, edge_mm: float, *, round_tip: bool) -> "cadquery.Workplane":
    """Hemisphere or cone of 90 deg, as high as its radius, on a round shank down to `bottom_mm`."""
    import cadquery

    sketch = cadquery.Workplane("XZ")
    if round_tip:
        middle = radius_mm * np.sqrt(0.5)
        sketch = sketch.threePointArc((middle, middle - radius_mm), (radius_mm, -radius_mm))
    else:
        if edge_mm > 0:
            sketch = sketch.threePointArc(_on_arc_mm(edge_mm, np.pi / 8), _on_arc_mm(edge_mm, np.pi / 4))
        sketch = sketch.lineTo(radius_mm, _rim_mm(radius_mm, edge_mm))
    sketch = sketch.lineTo(radius_mm, bottom_mm).lineTo(0, bottom_mm).close()
    return sketch.revolve(360, (0, 0, 0), (0, 1, 0))


def _on_arc_mm(radius_mm: float, angle: float) -> tuple[float, float]:
    """Point (distance from the axis, height) of a circle that touches z = 0, at an angle from its top."""
    return radius_mm * np.sin(angle), radius_mm * (np.cos(angle) - 1)


def _rim_mm(half_mm: float, edge_mm: float) -> float:
    """Height of the rim of a cone or prism."""
    return float(_flank_mm(np.asarray(half_mm), edge_mm))


def _prismatic(corners: NDArray[np.float64], bottom_mm: float, edge_mm: float) -> "cadquery.Workplane":
    """Prism with a flat face at z = 0, down to `bottom_mm`; its edges but those in notches are rounded."""
    import cadquery

    body = cadquery.Workplane("XY").polyline(corners.tolist()).close().extrude(bottom_mm)
    if edge_mm == 0:
        return body
    tip_mm = np.hypot(*corners.T).max()
    upright = cast("list[cadquery.Edge]", body.edges("|Z").vals())
    at_tips = [edge for edge in upright if np.hypot(edge.Center().x, edge.Center().y) > 0.99 * tip_mm]
    return body.newObject([*body.faces(">Z").edges().vals(), *at_tips]).fillet(edge_mm)


def _dots(pitch_mm: float, bottom_mm: float) -> "cadquery.Workplane":
    """3 x 3 balls sunk to their equators into a square plate."""
    import cadquery

    radius, width = DOT_SHARE * pitch_mm / 2, 3 * pitch_mm
    plate = cadquery.Workplane("XY").workplane(offset=-radius).rect(width, width).extrude(bottom_mm + radius)
    balls = cadquery.Workplane("XY").rarray(pitch_mm, pitch_mm, 3, 3).sphere(radius, combine=False)
    return plate.union(balls.translate((0, 0, -radius))).solids()


def _bars(distance_mm: float, bottom_mm: float) -> "cadquery.Workplane":
    """Two bars on a plate of their outline."""
    import cadquery

    foot, length = -BAR_HEIGHT * distance_mm, BAR_LENGTH * distance_mm
    outline = (1 + BAR_WIDTH) * distance_mm, length
    plate = cadquery.Workplane("XY").workplane(offset=foot).rect(*outline).extrude(bottom_mm - foot)
    bars = cadquery.Workplane("XY").rarray(distance_mm, 1, 2, 1).rect(BAR_WIDTH * distance_mm, length)
    return plate.union(bars.extrude(foot)).solids()


def _ridged(kind: ProbeKind, size_mm: float, bottom_mm: float, edge_mm: float) -> "cadquery.Workplane":
    """Lying cylinder, prism or wave: a profile across the ridges, drawn out along them."""
    import cadquery

    half = size_mm / 2
    if kind == "wave":
        x = np.linspace(-1.5, 1.5, 3 * WAVE_POINTS + 1) * size_mm
        crest = np.column_stack([x, WAVE_AMPLITUDE * size_mm * (np.cos(2 * np.pi * x / size_mm) - 1)])
        # With x as the parameter the slopes given at the ends are true derivatives.
        sketch = cadquery.Workplane("XZ", origin=(0, 1.5 * size_mm, 0)).spline(
            crest.tolist(), tangents=[(1, 0), (1, 0)], parameters=x.tolist(), scale=False
        )
        return sketch.lineTo(x[-1], bottom_mm).lineTo(x[0], bottom_mm).close().extrude(3 * size_mm)
    rim = _rim_mm(half, edge_mm) if kind == "prism" else -half
    sketch = cadquery.Workplane("YZ", origin=(-size_mm, 0, 0)).moveTo(-half, rim)
    if kind == "cylinder":
        sketch = sketch.threePointArc((0, 0), (half, rim))
    elif edge_mm > 0:
        end, height = _on_arc_mm(edge_mm, np.pi / 4)
        sketch = sketch.lineTo(-end, height).threePointArc((0, 0), (end, height)).lineTo(half, rim)
    else:
        sketch = sketch.lineTo(0, 0).lineTo(half, rim)
    return sketch.lineTo(half, bottom_mm).lineTo(-half, bottom_mm).close().extrude(2 * size_mm)
