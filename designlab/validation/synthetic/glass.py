"""Immersed parts are clear core and gel; the camera looks through them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.sensor.design import Design
from designlab.simulation.scene.materials import Shape
from designlab.simulation.scene.static_parts import core_and_gel, housing_inside
from designlab.validation.synthetic.boundaries import gap_transmission, reflectance, refracted
from geometries import gelcore

Place = float | Array
INTERFACE = ("interface", "gap-gel", "gap-core")  # laid out anew


class Disc(NamedTuple):
    """Round patch where the gel has come off the core: a thin gap of air between the two."""

    x_mm: float
    y_mm: float
    radius_mm: float

    def contains(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Which points lie under the gap."""
        return np.hypot(x - self.x_mm, y - self.y_mm) < self.radius_mm


@dataclass(frozen=True, eq=False)
class ImmersedParts:
    """Core, gel and what stands around them; absorption has shape (groups,).

    `walls` are the core's sides and window, the gel's rim and the housing; boundary between core and gel,
    membrane and LEDs are laid out anew. `package_mm` is the depth of LED packages cast into the core, else 0.
    """

    core_index: float
    gel_index: float
    core_absorption_per_mm: Array
    gel_absorption_per_mm: Array
    scattering_per_mm: float
    anisotropy: float
    thickness_mm: float
    window_mm: float
    interface_radius_mm: float | None
    outline: Array
    walls: tuple[Shape, ...]
    bonded: bool
    package_mm: float
    gap: Disc | None = None

    @classmethod
    def of(cls, design: Design) -> "ImmersedParts":
        """Take the clear parts of a design."""
        if design.gelcore.cavity is not None:
            raise ValueError("gelcore.cavity_radius_mm: measurements are generated of solid cores only")
        if design.gelcore.wedge_deg is not None:
            raise ValueError("gelcore.wedge_deg: measurements are generated of level windows only")
        if design.gelcore.side_bulge_mm:
            raise ValueError("gelcore.side_bulge_mm: measurements are generated of straight sides only")
        optics, gel = design.optics, design.elastomer
        shapes = [shape for shape in core_and_gel(design) if shape.name not in INTERFACE]
        return cls(
            core_index=optics.core_index,
            gel_index=optics.gel_index,
            core_absorption_per_mm=np.array(design.absorption_per_mm("gelcore")),
            gel_absorption_per_mm=np.array(design.absorption_per_mm("elastomer")),
            scattering_per_mm=optics.gelcore_scattering_per_mm,
            anisotropy=optics.gelcore_anisotropy,
            thickness_mm=gel.thickness_mm,
            window_mm=gel.thickness_mm + design.gelcore.height_mm,
            interface_radius_mm=None if gel.radius_mm is None else gel.radius_mm - gel.thickness_mm,
            outline=gelcore.polygon(design.gelcore, segments=288),
            walls=(*shapes, *housing_inside(design)),
            bonded=design.leds.coupling == "bonded",
            package_mm=design.leds.body_thickness_mm if design.leds.coupling == "embedded" else 0.0,
            gap=Disc(*optics.gap_centre_mm, optics.gap_radius_mm) if optics.gap_radius_mm else None,
        )

    @property
    def clear(self) -> bool:
        """Whether light passes undimmed."""
        losses = *self.core_absorption_per_mm, *self.gel_absorption_per_mm, self.scattering_per_mm
        return not any(losses)


class CameraRays(NamedTuple):
    """Rays x = x_c + t tan_x, y = y_c + t tan_y, z = z_c - t from a centre of projection (x_c, y_c, z_c)."""

    origin_mm: tuple[Place, Place, Place]
    tan_x: Array
    tan_y: Array

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Points of the rays."""
        x, y, z = self.origin_mm
        return x + t * self.tan_x, y + t * self.tan_y, z - t

    def only(self, chosen: NDArray[np.bool_]) -> "CameraRays":
        """Some of the rays."""
        x, y, z = (np.broadcast_to(place, chosen.shape)[chosen] for place in self.origin_mm)
        return CameraRays((x, y, z), self.tan_x[chosen], self.tan_y[chosen])


def look(glass: ImmersedParts, rays: CameraRays) -> tuple[CameraRays, Array]:
    """Follow the camera's rays through window and core into the gel.

    Snell's law in Heckbert's vector form at a plane window and at the plane or sphere under it; Fresnel's
    losses for unpolarised light. Rays that miss a sphere go on from its equator, where no membrane is.

    Parameters
    ----------
    rays : CameraRays
        Rays in air, from the centre of projection.

    Returns
    -------
    onward : CameraRays
        Rays within the gel, each from its own place.
    passed : array (groups, n)
        Share of the membrane's radiance that comes from the interface to the camera, the widening of the
        beam (1 / index of the gel squared) included.
    """
    (x, y, z), tan_x, tan_y = rays
    steep = 1.0 / np.sqrt(1.0 + tan_x**2 + tan_y**2)
    direction = np.stack([tan_x * steep, tan_y * steep, -steep])
    fall = z - glass.window_mm
    point = np.stack([x + fall * tan_x, y + fall * tan_y, np.full(len(tan_x), glass.window_mm)])
    up = np.broadcast_to(np.array([[0.0], [0.0], [1.0]]), direction.shape)
    direction, passed = _entering(direction, up, 1.0, glass.core_index)
    if glass.interface_radius_mm is None:
        way = (point[2] - glass.thickness_mm) / -direction[2]
        below = point + way * direction
        normal = up
    else:
        radius = glass.interface_radius_mm
        centre = np.array([[0.0], [0.0], [radius + glass.thickness_mm]])
        half = ((point - centre) * direction).sum(axis=0)
        root = np.maximum(half**2 - ((point - centre) ** 2).sum(axis=0) + radius**2, 0.0)
        way = -half + np.sqrt(root)
        below = point + way * direction
        normal = (centre - below) / np.linalg.norm(centre - below, axis=0)
    onward, share = _entering(direction, normal, glass.core_index, glass.gel_index)
    if glass.gap is not None:
        behind = glass.gap.contains(below[0], below[1])
        cosine, sides = -(direction * normal).sum(axis=0), (glass.gel_index, glass.core_index)
        through = gap_transmission(cosine, glass.core_index, sides)
        share = np.where(behind, through, share)
    lost = glass.core_absorption_per_mm + glass.scattering_per_mm
    kept = np.exp(-lost[:, None] * way) * passed * share / glass.gel_index**2
    x, y, z = below
    return CameraRays((x, y, z), onward[0] / -onward[2], onward[1] / -onward[2]), kept


def _entering(direction: Array, normal: Array, index: float, other: float) -> tuple[Array, Array]:
    """Directions (3, n) beyond a boundary and the share of power that passes; normals point against them."""
    cosine = -(direction * normal).sum(axis=0)
    return refracted(direction, normal, cosine, index / other), 1.0 - reflectance(cosine, index, other)


def interface_z(glass: ImmersedParts, x: Array, y: Array) -> Array:
    """Height of the boundary between core and gel (mm)."""
    if glass.interface_radius_mm is None:
        return np.full(np.shape(x), glass.thickness_mm)
    radius = glass.interface_radius_mm
    return np.asarray(radius + glass.thickness_mm - np.sqrt(np.maximum(radius**2 - x**2 - y**2, 0.0)))


def onto_interface(glass: ImmersedParts, point: Array, towards: Array) -> tuple[Array, Array]:
    """Where rays from a point in the gel (3,) along unit vectors (n, 3) meet the core, and their cosines."""
    if glass.interface_radius_mm is None:
        way = (glass.thickness_mm - point[2]) / towards[:, 2]
        return point + way[:, None] * towards, towards[:, 2]
    radius = glass.interface_radius_mm
    centre = np.array([0.0, 0.0, radius + glass.thickness_mm])
    half = (point - centre) @ towards.T
    root = half**2 - float(((point - centre) ** 2).sum()) + radius**2
    met = point + (-half - np.sqrt(np.maximum(root, 0.0)))[:, None] * towards
    cosine = np.abs(((met - centre) * towards).sum(axis=1)) / radius
    # Rays that pass below the sphere's rim meet no core.
    return np.where((root > 0)[:, None], met, 1e9), np.clip(cosine, 1e-3, 1.0)
