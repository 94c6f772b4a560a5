"""What things are made of and how they are bounded, as plain data that knows no rendering engine."""

import hashlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array


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


@dataclass(frozen=True)
class Metal:
    """Conductor that reflects as a mirror, or in a GGX lobe of alpha `roughness`.

    `reflectance` is a factor for each LED group; with `index`, the complex refractive index n + ik for each
    group, Fresnel's reflectance comes on top.
    """

    reflectance: tuple[float, ...]
    index: tuple[complex, ...] | None = None
    roughness: float = 0.0


@dataclass(frozen=True)
class Ball:
    """Exact sphere: centre and radius in mm."""

    name: str
    centre_mm: tuple[float, float, float]
    radius_mm: float
    material: Metal


@dataclass(frozen=True, eq=False)
class Shape:
    """Triangle mesh with a material: vertices (n, 3) mm, faces (m, 3), optional vertex normals (n, 3)."""

    name: str
    vertices: Array
    faces: NDArray[np.uint32]
    material: Diffuse | Coating | Dielectric
    normals: Array | None = None
