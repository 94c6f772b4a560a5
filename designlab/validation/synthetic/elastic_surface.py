"""The membrane of an elastic gel under a press: balls by the exact contact, others by boundary elements."""

from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple, Protocol

import numpy as np
from scipy.interpolate import CubicSpline, RectBivariateSpline
from scipy.ndimage import distance_transform_edt, gaussian_filter

from designlab.core.types import Array
from designlab.validation.synthetic.boundary_elements import ElementContact, Wanted, press_any
from designlab.validation.synthetic.elastic_contact import ElasticBase, RoundContact, press_ball
from designlab.validation.synthetic.indenter import Indenter
from designlab.validation.synthetic.surface import PITCH_MM, Box, HeightField, above_base, base_z
from geometries import elastomer as gel_shape
from geometries.elastomer import Elastomer
from geometries.probes import REACH

FELT = 8.0  # thicknesses; further from a contact the membrane has moved by less than 0.1 um
FAR_PITCH_MM, NEAR_MM = 0.2, 1.0  # between points at which a bulge is worked out, so far from a contact
RADII = 400  # at which a round surface is worked out outside its contact
MODULUS_MPA = 1.0  # scales forces alone


@dataclass(frozen=True)
class TrueGel:
    """How elastic the gel is.

    Attributes
    ----------
    share : float
        Share of the layer in the shape of a pressed membrane; what is left is the smoothing kernel's.
    thickness_mm, poisson : float
        Thickness (mm) and Poisson's ratio of the layer.
    skin_mm : float
        Standard deviation of the smoothing by its skin (mm).
    """

    share: float
    thickness_mm: float
    poisson: float
    skin_mm: float


class _Frame(NamedTuple):
    """Plane that touches the undeformed membrane where the probe does: a point, and unit vectors."""

    origin: Array
    across: Array
    along: Array
    normal: Array

    def place(self, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
        """Coordinates on the plane of what lies above or below it."""
        away = np.stack([x, y, z], axis=-1) - self.origin
        return away @ self.across, away @ self.along


class _Contact(Protocol):
    """A solved contact on its plane; its heights are along the normal, of a tilted plane after some turns."""

    turns: int

    def surface_mm(self, x_mm: Array, y_mm: Array) -> Array: ...

    def touched(self, x_mm: Array, y_mm: Array) -> Array: ...


def pressed(
    elastomer: Elastomer,
    gel: TrueGel,
    indenter: Indenter,
    *,
    waves: Array | None = None,
    pitch_mm: float = PITCH_MM,
) -> HeightField:
    """Membrane of an elastic gel with a probe pressed into it.

    It moves along its normal as a flat layer would on the plane that touches it where the probe does. A
    contact whose radius is a on a dome of radius R is off by terms of the order of (a / R)^2. What touches
    besides is added as if neither felt the other, and of a wrong object's shape its share is taken.

    Raises
    ------
    ValueError
        If the probe misses the membrane, or is pressed deeper than the gel is thick.
    """
    share = indenter.wrong if indenter.other is not None else 0.0
    presses = [(1.0 - share, indenter)] if share < 1 else []
    if indenter.other is not None and share:
        presses.append((share, indenter._replace(probe=indenter.other)))
    if indenter.beside is not None:
        presses.append((1.0, indenter.beside))
    reach = [(one.centre_mm, REACH[one.probe.kind] * one.probe.size_mm) for _, one in presses]
    boxes = [Box(x - far, x + far, y - far, y + far) for (x, y), far in reach]
    box = reduce(Box.joined, boxes)
    outline = gel_shape.polygon(elastomer)
    (left, bottom), (right, top) = outline.min(axis=0), outline.max(axis=0)
    box = box.grown(FELT * gel.thickness_mm)
    box = Box(max(box.left, left), min(box.right, right), max(box.bottom, bottom), min(box.top, top))
    box = box.grown(2 * pitch_mm)
    x = np.arange(box.left, box.right + pitch_mm, pitch_mm)
    y = np.arange(box.bottom, box.top + pitch_mm, pitch_mm)
    height, contact = np.zeros((len(y), len(x))), np.zeros((len(y), len(x)))
    for share, one in presses:
        moved, touched = _spread(elastomer, *_solve(elastomer, gel, one), x, y)
        height, contact = height + share * moved, np.maximum(contact, share * touched)
    if gel.skin_mm:
        height = gaussian_filter(height, gel.skin_mm / pitch_mm, mode="nearest")
    return HeightField(
        elastomer.radius_mm,
        x0_mm=float(x[0]),
        y0_mm=float(y[0]),
        pitch_mm=pitch_mm,
        height_mm=height,
        contact=contact,
        waves=np.zeros((0, 4)) if waves is None else waves,
    )


def _solve(elastomer: Elastomer, gel: TrueGel, indenter: Indenter) -> tuple[_Frame, _Contact]:
    """Plane of a contact, and the contact on it."""
    base = ElasticBase(MODULUS_MPA, gel.poisson, gel.thickness_mm)
    if indenter.depth_mm >= gel.thickness_mm:
        raise ValueError(
            f"presses: depth_mm: must be less than the gel is thick, {gel.thickness_mm:g} mm, "
            f"got {indenter.depth_mm:g} mm"
        )
    if indenter.probe.kind == "sphere":
        frame, depth = _ball_frame(elastomer, indenter)
        ball, dome = indenter.probe.size_mm / 2, elastomer.radius_mm or np.inf
        return frame, _Round(
            press_ball(base, ball_radius_mm=ball, depth_mm=depth, dome_radius_mm=dome), ball, dome
        )
    frame = _frame(elastomer, indenter)
    rise, x, y = float(frame.normal[2]), *(np.array(centre) for centre in indenter.centre_mm)
    across, along = frame.place(x, y, base_z(elastomer.radius_mm, x, y))
    top = float(above_base(elastomer, indenter, *frame.origin[:2, None])[0])

    def wanted(across: Array, along: Array) -> Array:
        point = frame.origin + across[..., None] * frame.across + along[..., None] * frame.along
        over = above_base(elastomer, indenter, point[..., 0], point[..., 1]) - top
        return np.asarray(rise * (indenter.depth_mm + over))

    half = 1.02 * REACH[indenter.probe.kind] * indenter.probe.size_mm / rise
    middle = float(across), float(along)
    solved = press_any(base, wanted, middle_mm=middle, half_mm=half, depth_mm=rise * indenter.depth_mm)
    return frame, _Any(solved, wanted)


def _frame(elastomer: Elastomer, indenter: Indenter) -> _Frame:
    """Plane that touches the membrane where the probe touches first."""
    axis = REACH[indenter.probe.kind] * indenter.probe.size_mm * np.linspace(-1, 1, 201)
    x, y = np.meshgrid(*(centre + axis for centre in indenter.centre_mm))
    first = int(above_base(elastomer, indenter, x, y).argmax())
    return _tangent(elastomer, float(x.flat[first]), float(y.flat[first]))


def _tangent(elastomer: Elastomer, x: float, y: float) -> _Frame:
    """Plane that touches the membrane at a point."""
    dome = elastomer.radius_mm
    if dome is None:
        return _Frame(np.array([x, y, 0.0]), *np.eye(3))
    z = float(base_z(dome, np.array(x), np.array(y)))
    normal = np.array([-x, -y, dome - z]) / dome
    across = np.array([normal[2], 0.0, -normal[0]]) / np.hypot(normal[0], normal[2])
    return _Frame(np.array([x, y, z]), across, np.cross(normal, across), normal)


def _ball_frame(elastomer: Elastomer, indenter: Indenter) -> tuple[_Frame, float]:
    """Plane at the axis of a ball that is pressed along z, and how deep it stands along that axis (mm).

    Ball and dome are round about the line between their middles, wherever the ball has come to.
    """
    x, y = indenter.centre_mm
    dome = elastomer.radius_mm
    if dome is None:
        return _tangent(elastomer, x, y), indenter.depth_mm
    touching = dome + indenter.probe.size_mm / 2
    below = np.sqrt(touching**2 - x**2 - y**2) - indenter.depth_mm  # of the ball's middle, from the dome's
    apart = float(np.sqrt(x**2 + y**2 + below**2))
    return _tangent(elastomer, x * dome / apart, y * dome / apart), touching - apart


def _spread(
    elastomer: Elastomer, frame: _Frame, contact: _Contact, x: Array, y: Array
) -> tuple[Array, Array]:
    """Height along z, and whether the probe touches, on a grid with axes x and y."""
    rise = float(frame.normal[2])

    def at(px: Array, py: Array) -> tuple[Array, Array]:
        base = base_z(elastomer.radius_mm, px, py)
        height = contact.surface_mm(*frame.place(px, py, base)) / rise
        # On a slope what has moved along the normal stands over another place.
        for _ in range(contact.turns if rise < 1 else 0):
            height = contact.surface_mm(*frame.place(px, py, base + height)) / rise
        return height, contact.touched(*frame.place(px, py, base + (height if contact.turns else 0.0)))

    grid_x, grid_y = np.meshgrid(x, y)
    if contact.turns:
        return at(grid_x, grid_y)
    coarse = [np.arange(axis[0], axis[-1] + FAR_PITCH_MM, FAR_PITCH_MM) for axis in (x, y)]
    far, _ = at(*np.meshgrid(*coarse))
    height = RectBivariateSpline(*coarse, far.T)(x, y).T
    touched = contact.touched(*frame.place(grid_x, grid_y, base_z(elastomer.radius_mm, grid_x, grid_y)))
    near = distance_transform_edt(touched == 0, sampling=float(x[1] - x[0])) < NEAR_MM
    height[near], _ = at(grid_x[near], grid_y[near])
    return height, touched


class _Round:
    """Contact of a ball: its own shape where it touches, elsewhere that of the loaded layer."""

    turns = 8

    def __init__(self, contact: RoundContact, ball_mm: float, dome_mm: float) -> None:
        self._contact, self._ball, self._dome = contact, ball_mm, dome_mm
        radius, far = contact.contact_radius_mm, 2 * FELT * contact.base.thickness_mm
        # Close together at the contact's edge, where the surface turns.
        r = radius + far * np.linspace(0.0, 1.0, RADII) ** 2
        self._outside = CubicSpline(r, contact.surface_mm(r))

    def surface_mm(self, x_mm: Array, y_mm: Array) -> Array:
        r = np.hypot(x_mm, y_mm)
        within = np.minimum(r, self._contact.contact_radius_mm)
        profile = self._ball - np.sqrt(self._ball**2 - within**2)
        if np.isfinite(self._dome):
            profile = profile + self._dome - np.sqrt(self._dome**2 - within**2)
        outside = self._outside(np.clip(r, self._outside.x[0], self._outside.x[-1]))
        return np.where(r < self._contact.contact_radius_mm, self._contact.depth_mm - profile, outside)

    def touched(self, x_mm: Array, y_mm: Array) -> Array:
        return np.where(np.hypot(x_mm, y_mm) < self._contact.contact_radius_mm, 1.0, 0.0)


class _Any:
    """Contact of any probe: its own shape where it touches, and never the other side of it."""

    turns = 0  # heights along z were asked for

    def __init__(self, contact: ElementContact, wanted: Wanted) -> None:
        self._contact, self._wanted = contact, wanted

    def surface_mm(self, x_mm: Array, y_mm: Array) -> Array:
        probe = self._wanted(x_mm, y_mm)
        beside = ~(self._contact.touched(x_mm, y_mm) & np.isfinite(probe))
        height = probe.copy()
        height[beside] = np.maximum(self._contact.surface_mm(x_mm[beside], y_mm[beside]), probe[beside])
        return height

    def touched(self, x_mm: Array, y_mm: Array) -> Array:
        return self._contact.touched(x_mm, y_mm).astype(float)
