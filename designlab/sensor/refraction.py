"""Snell's law between the membrane and the camera: at plane layers, and at curved ones."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.sensor.optical_properties import Optics
from geometries.elastomer import Elastomer
from geometries.gelcore import Gelcore

NEWTON_STEPS, NEWTON_STEP = 12, 1e-6
Layers = Sequence[tuple[float, float]]
"""Thickness (mm) and refractive index of each layer, the camera's last."""


def crossing_mm(tangent: Array, layers: Layers) -> tuple[Array, Array]:
    """Follow rays that leave the camera at an angle to the layers' normal back through all of them.

    Parameters
    ----------
    tangent : array
        Tangent of the angle in the last layer.
    layers : sequence of (thickness in mm, index)
        Plane layers, the camera's last.

    Returns
    -------
    lateral_mm, slope : array
        Sideways distance travelled and tangent of the angle in the first layer, both over `tangent`: these
        ratios have a limit on the axis, where distance and tangent vanish.
    """
    cosine = 1.0 / np.sqrt(1.0 + tangent**2)
    # n sin(theta) is the same in every layer, so n cos(theta) = sqrt(n^2 - invariant^2).
    invariant = layers[-1][1] * tangent * cosine
    ratios = [layers[-1][1] * cosine / np.sqrt(index**2 - invariant**2) for _, index in layers]
    lateral = sum(
        (thickness * ratio for (thickness, _), ratio in zip(layers, ratios, strict=True)), np.zeros(())
    )
    return np.asarray(lateral), np.asarray(ratios[0])


def apparent_tangent(distance_mm: float, layers: Layers) -> float:
    """Tangent, in the last layer, of the ray that crosses the layers over a sideways distance."""
    from scipy.optimize import brentq

    if distance_mm == 0:
        return 0.0

    def lateral_mm(invariant: float) -> float:
        return sum(thickness * invariant / math.sqrt(index**2 - invariant**2) for thickness, index in layers)

    steepest = min(index for _, index in layers) * (1 - 1e-12)
    invariant = brentq(lambda s: lateral_mm(s) - distance_mm, 0.0, steepest, xtol=1e-14)
    return float(invariant / math.sqrt(layers[-1][1] ** 2 - invariant**2))


def tangents_through(layers: Sequence[Layers], away_mm: Array) -> Array:
    """Tangents of the angles to the axis at which the camera sees points through plane layers.

    Parameters
    ----------
    layers : sequence of Layers
        The layers between the camera and each point.
    away_mm : array, shape (n, 2)
        Ways from the camera to the points along x and y.

    Returns
    -------
    array, shape (n, 2)
        Tangents along x and y, in the camera's layer.
    """
    distances = np.hypot(*away_mm.T)
    tangents = [apparent_tangent(float(d), each) for d, each in zip(distances, layers, strict=True)]
    return np.asarray(away_mm * (tangents / np.maximum(distances, 1e-300))[:, None])


def apparent_distance_mm(layers: Layers) -> float:
    """Distance at which something behind the layers seems to lie, seen along their normal."""
    return sum(thickness / index for thickness, index in layers) * layers[-1][1]


class Glass(NamedTuple):
    """Core and gel as the camera looks through them.

    Attributes
    ----------
    window_mm, interface_mm : float
        Heights of the window and, on the axis, of the boundary of gel and core above the membrane's apex.
    core_index, gel_index : float
        Refractive indices.
    dome_mm : float or None
        Radius of the boundary of gel and core where that is a sphere, which bulges towards the membrane.
    reach_mm : float
        How far from the axis a sphere goes.
    cavity : (float, float) or None
        Radius and depth of a hollow behind the window, half a spheroid.
    window_slope : float
        Rise of the window along y of a wedge, mm a mm.
    """

    window_mm: float
    interface_mm: float
    core_index: float
    gel_index: float
    dome_mm: float | None = None
    reach_mm: float = math.inf
    cavity: tuple[float, float] | None = None
    window_slope: float = 0.0

    @property
    def bends(self) -> bool:
        """Whether light passes other than plane layers that are level."""
        return self.dome_mm is not None or self.cavity is not None or self.window_slope != 0.0

    @classmethod
    def of(cls, core: Gelcore, gel: Elastomer, optics: Optics) -> "Glass | None":
        """Core and gel of a design; None where light does not see them."""
        if optics.light_path == "air":
            return None
        dome_mm = None if gel.radius_mm is None else gel.radius_mm - gel.thickness_mm
        return cls(
            window_mm=gel.thickness_mm + core.height_mm,
            interface_mm=gel.thickness_mm,
            core_index=optics.core_index,
            gel_index=optics.gel_index,
            dome_mm=dome_mm,
            reach_mm=math.inf if dome_mm is None else min(core.width_mm / 2, dome_mm),
            cavity=core.cavity,
            window_slope=core.window_slope,
        )

    def layers(self, z_mm: float, camera_mm: float) -> list[tuple[float, float]]:
        """Plane layers that stand for core and gel over a point of the membrane at a height.

        On a dome the gel keeps its thickness and the core gets thinner towards the edge; behind a freeform
        membrane the core is flat and the gel gets thinner.

        Returns
        -------
        list of (thickness in mm, index)
            From the membrane to the camera.
        """
        gel_mm, core_mm = self.interface_mm, self.window_mm - self.interface_mm
        if self.dome_mm is None:
            gel_mm -= z_mm
        else:
            core_mm -= z_mm
        return [(gel_mm, self.gel_index), (core_mm, self.core_index), (camera_mm - self.window_mm, 1.0)]

    def follow(self, start: Array, direction: Array) -> tuple[Array, Array, Array]:
        """Follow rays from the camera into the gel.

        Parameters
        ----------
        start : array, shape (3, ...)
            Points above the window.
        direction : array, shape (3, ...)
            Unit vectors, downwards.

        Returns
        -------
        point, direction : array, shape (3, ...)
            Where they enter the gel and how they go on there.
        met : bool array
            Whether they meet the boundary of gel and core from above, on its sphere if it is one.
        """
        point, normal = self._at_window(start, direction)
        direction = refracted(direction, normal, 1.0 / self.core_index)
        if self.dome_mm is None:
            point = point + (self.interface_mm - point[2]) / direction[2] * direction
            normal, met = _down(point), np.ones(point.shape[1:], dtype=bool)
        else:
            centre = np.zeros_like(point)
            centre[2] = self.interface_mm + self.dome_mm
            point, inside = _leaving(point, direction, centre, np.full(3, self.dome_mm))
            normal = (point - centre) / self.dome_mm
            met = inside & (point[2] < centre[2]) & (np.hypot(point[0], point[1]) < self.reach_mm)
        direction = refracted(direction, normal, self.core_index / self.gel_index)
        return point, direction, met & (direction[2] < 0)

    def toward(self, camera: Array, points: Array) -> Array:
        """Directions in which the camera sees points in the gel, by Newton's method.

        Parameters
        ----------
        camera : array, shape (3,)
            Above the window.
        points : array, shape (n, 3)
            In the gel.

        Returns
        -------
        array, shape (n, 2)
            Tangents of the angles to the axis, along x and y; not numbers where none is found.
        """
        tangents = (points[:, :2] - camera[:2]) / (camera[2] - points[:, 2:])
        for _ in range(NEWTON_STEPS):
            missed = self._passes(camera, tangents, points[:, 2]) - points[:, :2]
            slopes = [
                (self._passes(camera, tangents + step, points[:, 2]) - missed - points[:, :2]) / NEWTON_STEP
                for step in NEWTON_STEP * np.eye(2)
            ]
            try:
                steps = np.linalg.solve(np.stack(slopes, axis=-1), missed[..., None])
            except np.linalg.LinAlgError:  # seen along the window, as where the camera stands below it
                return np.full_like(tangents, np.nan)
            tangents = tangents - steps[..., 0]
        return np.asarray(tangents)

    def _passes(self, camera: Array, tangents: Array, height_mm: Array) -> Array:
        """Where rays from the camera pass heights in the gel, (n, 2)."""
        direction = np.stack([*tangents.T, -np.ones(len(tangents))])
        direction = direction / np.linalg.norm(direction, axis=0)
        start = np.repeat(camera[:, None], len(tangents), axis=1)
        point, bent, _ = self.follow(start, direction)
        return np.asarray((point[:2] + (height_mm - point[2]) / bent[2] * bent[:2]).T)

    def _at_window(self, start: Array, direction: Array) -> tuple[Array, Array]:
        """Where rays meet the window, and its normal there, into the core."""
        if self.window_slope:
            above = start[2] - self.window_mm - self.window_slope * start[1]
            point = start + above / (self.window_slope * direction[1] - direction[2]) * direction
            normal = _down(point)
            normal[1] = self.window_slope
            return point, normal / np.hypot(1.0, self.window_slope)
        plane = start + (self.window_mm - start[2]) / direction[2] * direction
        if self.cavity is None:
            return plane, _down(plane)
        radius, depth = self.cavity
        axes = np.array([radius, radius, depth])
        centre = np.zeros_like(start)
        centre[2] = self.window_mm
        hollow, _ = _leaving(start, direction, centre, axes)
        normal = (hollow - centre) / (axes**2).reshape(3, *[1] * (start.ndim - 1))
        normal = normal / np.linalg.norm(normal, axis=0)
        opening = np.hypot(plane[0], plane[1]) < radius
        return np.where(opening, hollow, plane), np.where(opening, normal, _down(plane))


def _down(like: Array) -> Array:
    """Unit vectors towards the membrane."""
    found = np.zeros_like(like)
    found[2] = -1.0
    return found


def _leaving(start: Array, direction: Array, centre: Array, axes: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Where rays leave an ellipsoid, and whether they meet it at all; the nearest point else."""
    scale = axes.reshape(3, *[1] * (start.ndim - 1))
    at, way = (start - centre) / scale, direction / scale
    a, b, c = (way * way).sum(axis=0), (at * way).sum(axis=0), (at * at).sum(axis=0) - 1.0
    root = b * b - a * c
    return start + (np.sqrt(np.maximum(root, 0.0)) - b) / a * direction, root > 0


def refracted(direction: Array, normal: Array, ratio: float) -> Array:
    """Snell's law in vectors: unit direction behind a boundary, along it where light is reflected totally.

    Parameters
    ----------
    direction, normal : array, shape (3, ...)
        Unit vectors; the normal points to where the light goes.
    ratio : float
        Index before over index behind.
    """
    cosine = (normal * direction).sum(axis=0)
    onward = np.sqrt(np.maximum(1 - ratio**2 * (1 - cosine**2), 0.0))
    return np.asarray(ratio * direction + (onward - ratio * cosine) * normal)
