"""The coat of the membrane reflects light: diffusely, in a lobe, in a pattern, from what touches it."""

from dataclasses import dataclass

import numpy as np

from designlab.core.types import Array

MARKER_SOFT_MM = 0.04  # over which the border of a printed dot fades


@dataclass(frozen=True)
class Coat:
    """Reflection of the membrane.

    Attributes
    ----------
    half_mm : tuple of float
        Half width and half height of the sensing area, the unit of `field`.
    field : tuple of float
        Coefficients of u, v, u^2 - 1/3, u v, v^2 - 1/3 in the reflectance over its nominal value.
    specular, roughness : float
        Share of the reflected light in a lobe of microfacets (GGX), and their roughness alpha.
    transmittance, behind, open_air : float
        Diffuse transmittance of the coat, reflectance of an object that touches it, and what is sent back
        from behind the coat where nothing does, which is part of its nominal reflectance.
    markers : tuple of float, optional
        Pitch and diameter (mm) of printed dots on a square grid, and the share of light they swallow.
    turn_deg : float
        Rotation of the gel about the z axis.
    """

    half_mm: tuple[float, float]
    field: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    specular: float = 0.0
    roughness: float = 0.35
    transmittance: float = 0.0
    behind: float = 0.5
    open_air: float = 0.0
    markers: tuple[float, float, float] | None = None
    turn_deg: float = 0.0

    @property
    def is_patterned(self) -> bool:
        """Whether the reflectance changes from place to place."""
        return any(self.field) or self.markers is not None

    def reflectance(self, albedo: Array, x: Array, y: Array, *, touched: Array | None = None) -> Array:
        """Reflectance at points of the membrane, shape (groups, points).

        Parameters
        ----------
        albedo : array, shape (groups,)
            Nominal reflectance of the coat.
        x, y : array, shape (points,)
            Points (mm), the gel as it is turned.
        touched : array, shape (points,), optional
            Share of each point that an object touches.
        """
        local = np.repeat(albedo[:, None], len(x), axis=1)
        back = np.exp(-1j * np.radians(self.turn_deg)) * (x + 1j * y)
        if any(self.field):
            u, v = back.real / self.half_mm[0], back.imag / self.half_mm[1]
            basis = np.stack([u, v, u * u - 1 / 3, u * v, v * v - 1 / 3])
            local *= np.maximum(1 + np.array(self.field) @ basis, 0.0)
        if self.markers is not None:
            pitch, diameter, loss = self.markers
            off = back / pitch
            off -= np.round(off.real) + 1j * np.round(off.imag)
            inside = (diameter / 2 - pitch * np.abs(off)) / MARKER_SOFT_MM + 0.5
            local *= 1 - loss * np.clip(inside, 0.0, 1.0)
        if touched is not None and self.transmittance:
            alone = local
            for _ in range(200 if self.open_air else 0):
                alone = local - self._returned(alone, self.open_air)
            local = local + touched * (alone + self._returned(alone, self.behind) - local)
        return np.minimum(local, 1.0)

    def _returned(self, alone: Array, behind: float) -> Array:
        """Light that passed the coat and goes to and fro behind it: the sum of what comes back each time."""
        returned = np.zeros_like(alone)
        passed = self.transmittance * behind * np.ones_like(alone)
        for _ in range(60):
            returned += self.transmittance * passed
            passed = passed * (alone * behind)
        return returned

    def lobe(self, points: Array, normals: Array, lights: Array, eye: Array) -> Array:
        """Brightness of the lobe over that of a diffuse coat of equal reflectance, shape (points, lights).

        pi D G / (4 cos_in cos_out) with the distribution D of GGX in the facets' angle, and the
        masking G of Smith for each direction.

        Parameters
        ----------
        points, normals : array, shape (points, 3)
            Points of the membrane (mm) and their unit normals.
        lights : array, shape (lights, 3)
            Where light comes from (mm).
        eye : array, shape (3,)
            Where it is seen from (mm).
        """
        to_eye = eye - points
        to_eye /= np.linalg.norm(to_eye, axis=1, keepdims=True)
        cos_out = np.maximum((normals * to_eye).sum(axis=1), 1e-3)[:, None]
        square = (points**2).sum(axis=1)[:, None] + (lights**2).sum(axis=1) - 2 * points @ lights.T
        distance = np.sqrt(np.maximum(square, 1e-12))
        cos_in = (normals @ lights.T - (normals * points).sum(axis=1)[:, None]) / distance
        cos_in = np.clip(cos_in, 1e-3, 1.0)
        between = (to_eye @ lights.T - (to_eye * points).sum(axis=1)[:, None]) / distance
        cos_half_2 = np.clip((cos_in + cos_out) ** 2 / (2 + 2 * between + 1e-12), 1e-6, 1.0)
        alpha_2 = self.roughness**2
        facets = 1 / (alpha_2 * (cos_half_2 + (1 - cos_half_2) / alpha_2) ** 2)
        return np.asarray(facets * self.seen(cos_in) * self.seen(cos_out) / (4 * cos_in * cos_out))

    def seen(self, cosine: Array) -> Array:
        """Share of the facets that is not hidden by others in a direction."""
        tangent_2 = 1 / cosine**2 - 1
        return np.asarray(2 / (1 + np.sqrt(1 + self.roughness**2 * tangent_2)))
