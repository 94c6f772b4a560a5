"""Pressure and force on an elastic layer from the shape of its surface, nowhere negative."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from scipy import fft
from scipy.ndimage import binary_dilation, label, maximum

from designlab.core.types import Array, Mask
from designlab.mechanics.contact import NotConverged, OutOfReach, press
from designlab.mechanics.grid_response import symbol
from designlab.mechanics.layer import ElasticLayer

ITERATIONS = 300
SETTLED = 1e-4  # change of the pressure, relative, at which it stays
SUPPORT = 0.1  # of the depth: where the surface is lower than this, nothing touches it
MARGIN_MM = 0.3  # around that
PRESSED_IN = 0.3  # of the depth: a contact goes deeper somewhere
TOUCHED = 0.03  # of the highest pressure from which a point counts as touched
USUAL_SHARE = 0.3  # pressure over modulus of a usual press: how large pressures may be against noise
ABOVE_NOISE = 3.0  # standard deviations of the heights from which the surface counts as pressed in
POINTS = 16  # across a contact, for how much stiffer it is where it sticks
MODEL_SD = 0.05  # of the force, relative, by finite elements (docs/validation.md)
HEIGHT_SDS = 1.0  # relative error of the force for one of the depth by noise, most of which averages out
NORMAL_95 = 1.96  # standard deviations to either side that hold 95 %


class ForceRange(NamedTuple):
    """A force (N) and the ends of its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class SurfacePressure:
    """Pressure that gives a surface its shape.

    Attributes
    ----------
    pressure : array, shape (rows, columns)
        Pressure over Young's modulus.
    offset_mm : float
        What the surface is too high by everywhere.
    rest_mm : float
        Root mean square of what the pressure does not explain.
    pitch_mm : float
        Distance of the points.
    height_mm : array, shape (rows, columns)
        The surface, without its offset.
    layer : ElasticLayer
        The layer, of modulus 1.
    noise_mm : float
        Standard deviation of the heights.
    """

    pressure: Array
    offset_mm: float
    rest_mm: float
    pitch_mm: float
    height_mm: Array
    layer: ElasticLayer
    noise_mm: float

    @property
    def contact(self) -> Mask:
        """Where the surface is touched."""
        return np.asarray(self.pressure > TOUCHED * self.pressure.max())

    @property
    def contact_area_mm2(self) -> float:
        """Area of the contact."""
        return float(self.contact.sum() * self.pitch_mm**2)

    @property
    def surface_mm(self) -> Array:
        """The surface as the layer answers the pressure (mm), with its far slopes and bulge."""
        return self._under(self.pressure)

    def lift_mm(self, part: Mask) -> float:
        """How far the pressure of a part of the points presses the surface in where it does most (mm)."""
        return float(self._under(np.where(part, self.pressure, 0)).max())

    def _under(self, pressure: Array) -> Array:
        rows, columns = pressure.shape
        shape = _padded(rows, columns)
        response = _response(self.layer, self.pitch_mm, *shape).astype(pressure.dtype)
        spectrum = fft.rfft2(pressure, s=shape) * response
        return np.asarray(fft.irfft2(spectrum, s=shape)[:rows, :columns])

    @cached_property
    def sticking(self) -> float:
        """Force of a probe that carries the skin along, over that of one which slides.

        Both are those of a rigid body of the contact's shape, on few points: the ratio hardly needs more.
        """
        contact = self.contact
        rows, columns = (np.flatnonzero(contact.any(axis=axis)) for axis in (1, 0))
        box = np.s_[max(rows[0] - 1, 0) : rows[-1] + 2, max(columns[0] - 1, 0) : columns[-1] + 2]
        depth = float(self.height_mm[contact].max())
        gap = np.where(contact, depth - self.height_mm, np.inf)[box].astype(float)
        every = math.ceil(max(gap.shape) / POINTS)
        try:
            sliding, sticking = (
                press(
                    gap[::every, ::every],
                    self.layer,
                    pitch_mm=every * self.pitch_mm,
                    depth_mm=depth,
                    friction=friction,
                ).force_n
                for friction in (0.0, math.inf)
            )
        except (NotConverged, OutOfReach):
            return 1.0
        return sticking / sliding

    def force_n(self, modulus_mpa: float) -> float:
        """Force (N) on a layer of a modulus in MPa, by a probe that carries the skin along."""
        return self.sticking * self.sliding_force_n(modulus_mpa)

    def sliding_force_n(self, modulus_mpa: float) -> float:
        """Force (N) on a layer of a modulus in MPa, by a probe on which the skin slides freely."""
        return float(self.pressure.sum() * self.pitch_mm**2 * modulus_mpa)

    def force_range(self, modulus_mpa: float, modulus_sd_mpa: float = 0.0) -> ForceRange:
        """Force with its 95 % interval, from a probe that slides freely to one that carries the skin along.

        Parameters
        ----------
        modulus_mpa, modulus_sd_mpa : float
            Modulus of the layer (MPa) and its standard deviation.
        """
        depth_error = self.noise_mm / max(float(self.height_mm.max()), self.noise_mm)
        sds = (MODEL_SD, HEIGHT_SDS * depth_error, modulus_sd_mpa / modulus_mpa)
        wide = math.exp(NORMAL_95 * math.hypot(*sds))
        force, sliding = self.force_n(modulus_mpa), self.sliding_force_n(modulus_mpa)
        return ForceRange(force, min(force, sliding) / wide, force * wide)


def pressure_under(
    height_mm: Array,
    *,
    poisson: float,
    thickness_mm: float,
    pitch_mm: float,
    noise_mm: float = 0.005,
    iterations: int = ITERATIONS,
) -> SurfacePressure:
    """Find the pressure under which a bonded layer takes a measured shape.

    The total force is the response at wave number 0, which vanishes for a gel that keeps its volume: plain
    inversion turns an offset of 5 um into newtons. So pressure is only where the surface is pressed in, is
    nowhere negative, and the height's offset is unknown. What pressure alone explains is the contact of a
    probe that slides. One that carries the skin along needs more force for the same shape, by up to a half:
    both contacts are solved for the shape found, and their ratio is kept.

    Parameters
    ----------
    height_mm : array, shape (rows, columns)
        How far the surface is pressed in (mm); negative where it bulges. Single precision is kept.
    poisson, thickness_mm : float
        Of the layer.
    pitch_mm : float
        Distance of the points.
    noise_mm : float
        Standard deviation of the heights.
    iterations : int
        Most of them; after some 30 the force is known to a percent.

    Raises
    ------
    ValueError
        If nothing is pressed in.

    Notes
    -----
    Least squares with a small ridge, by projected gradients with momentum: Beck and Teboulle (2009), SIAM J.
    Imaging Sci. 2, 183.
    """
    depth = float(height_mm.max())
    if not depth > 0:
        raise ValueError("height_mm: nothing is pressed in")
    margin = max(1, round(MARGIN_MM / pitch_mm))
    layer = ElasticLayer(1.0, poisson, thickness_mm)
    solver = _Solver(height_mm, layer, pitch_mm, noise_mm, iterations)
    least = max(SUPPORT * depth, ABOVE_NOISE * noise_mm + min(float(np.median(height_mm)), 0.5 * depth))
    support = binary_dilation(height_mm > min(least, PRESSED_IN * depth), iterations=margin)
    found = solver.solve(support)
    # What the layer does not explain of a surface would press at the support's edge.
    parts, count = label(found.contact)
    peaks = maximum(height_mm, parts, range(1, count + 1))
    kept = np.isin(parts, 1 + np.flatnonzero(np.asarray(peaks) > PRESSED_IN * depth))
    if kept.any() and (kept != found.contact).any():
        found = solver.solve(support & binary_dilation(kept, iterations=margin))
    return found


def _padded(rows: int, columns: int) -> tuple[int, int]:
    """Points of a transform in which a surface does not meet itself at the border."""
    return fft.next_fast_len(2 * rows, real=True), fft.next_fast_len(2 * columns, real=True)


@lru_cache(maxsize=4)
def _response(layer: ElasticLayer, pitch_mm: float, rows: int, columns: int) -> Array:
    """Response of a layer, which the frames of a video share."""
    return symbol(layer, pitch_mm, rows, columns, "zz")


class _Solver:
    """Pressures within a support that give one surface its shape."""

    def __init__(
        self, height_mm: Array, layer: ElasticLayer, pitch_mm: float, noise_mm: float, iterations: int
    ) -> None:
        self.height, self.layer, self.pitch, self.noise = height_mm, layer, pitch_mm, noise_mm
        self.iterations = iterations
        self.shape = _padded(*height_mm.shape)
        self.response = _response(layer, pitch_mm, *self.shape).astype(height_mm.dtype)
        self.ridge = (noise_mm / USUAL_SHARE) ** 2
        self.step = 1.0 / (float(np.abs(self.response).max()) ** 2 + self.ridge)

    def surface(self, pressure: Array) -> Array:
        """Surface under a pressure (mm)."""
        rows, columns = self.height.shape
        spectrum = fft.rfft2(pressure, s=self.shape)
        return np.asarray(fft.irfft2(spectrum * self.response, s=self.shape)[:rows, :columns])

    def solve(self, support: Mask) -> SurfacePressure:
        """Pressure that is 0 outside a support."""
        pressure = np.zeros_like(self.height)
        ahead, momentum = pressure, 1.0
        for _ in range(self.iterations):
            rest = self.surface(ahead) - self.height
            rest -= rest.mean()  # the offset that fits best
            slope = self.surface(rest) + self.ridge * ahead
            found = np.where(support, np.maximum(ahead - self.step * slope, 0), 0)
            faster = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
            change = found - pressure
            ahead = found + (momentum - 1) / faster * change
            pressure, momentum = found, faster
            if np.linalg.norm(change) < SETTLED * np.linalg.norm(found):
                break
        rest = self.height - self.surface(pressure)
        offset = float(rest.mean())
        spread = float((rest - offset).std())
        return SurfacePressure(
            pressure, offset, spread, self.pitch, self.height - offset, self.layer, self.noise
        )
