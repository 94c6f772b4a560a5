"""The membrane as a height field, untouched or pressed; smoothed by its transfer function."""

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0

from designlab.core.types import Array
from designlab.validation.synthetic import kernels
from designlab.validation.synthetic.indenter import Indenter
from designlab.validation.synthetic.tail import LEAST_MM, outside_mm, reach_mm
from geometries.elastomer import Elastomer
from geometries.probes import Probe, profile_mm

PITCH_MM = 0.02
LEAST_CHANGE_MM = 1e-4
REACH = 6.0  # the kernel ends at this many of its lengths


class Box(NamedTuple):
    """Axis-parallel rectangle of the membrane plane (mm)."""

    left: float
    right: float
    bottom: float
    top: float

    @property
    def centre(self) -> complex:
        """Its middle, x + i y (mm)."""
        return complex(self.left + self.right, self.bottom + self.top) / 2

    def grown(self, margin_mm: float) -> "Box":
        """Move every side outwards."""
        left, right, bottom, top = self
        return Box(left - margin_mm, right + margin_mm, bottom - margin_mm, top + margin_mm)

    def joined(self, other: "Box") -> "Box":
        """Smallest box around two."""
        low = min(self.left, other.left), min(self.bottom, other.bottom)
        high = max(self.right, other.right), max(self.top, other.top)
        return Box(low[0], high[0], low[1], high[1])

    def contains(self, x: Array, y: Array) -> NDArray[np.bool_]:
        """Which points lie within the box."""
        return (x >= self.left) & (x <= self.right) & (y >= self.bottom) & (y <= self.top)


@dataclass(frozen=True, eq=False)
class HeightField:
    """Base (plane or sphere) plus an indentation on a square grid; rows ascend with y, columns with x.

    Beyond the grid the indentation is zero; it is negative where gel bulges out. `contact` is the share of
    each cell that an object touches; `waves` are ripples of the base, of which only slopes count: rows of
    wave number (x, y), amplitude, phase.
    """

    radius_mm: float | None
    x0_mm: float = 0.0
    y0_mm: float = 0.0
    pitch_mm: float = PITCH_MM
    height_mm: Array | None = None
    contact: Array | None = None
    waves: Array = field(default_factory=lambda: np.zeros((0, 4)))

    @cached_property
    def slopes(self) -> tuple[Array | None, Array | None]:
        """Slopes of the indentation along x and y by central differences, on the grid."""
        if self.height_mm is None:
            return None, None
        along_x, along_y = (np.gradient(self.height_mm, self.pitch_mm, axis=axis) for axis in (1, 0))
        return along_x, along_y

    @property
    def peak_mm(self) -> float:
        """Largest indentation."""
        return 0.0 if self.height_mm is None else max(float(self.height_mm.max()), 0.0)

    @property
    def bulge_mm(self) -> float:
        """How far the membrane bulges out at most, below its undeformed shape."""
        return 0.0 if self.height_mm is None else max(-float(self.height_mm.min()), 0.0)

    @property
    def bump(self) -> Box:
        """Bounding box of the indentation."""
        return self.above(LEAST_CHANGE_MM)

    def above(self, height_mm: float) -> Box:
        """Bounding box of what is indented more than this."""
        return self._about(self._pressed > min(height_mm, 0.5 * self.peak_mm))

    @property
    def changed(self) -> Box:
        """Bounding box of what is indented or bulges out."""
        return self._about(np.abs(self._pressed) > min(LEAST_CHANGE_MM, 0.5 * self.peak_mm))

    @property
    def _pressed(self) -> Array:
        if self.height_mm is None:
            raise ValueError("an untouched membrane has no bump")
        return self.height_mm

    def _about(self, some: NDArray[np.bool_]) -> Box:
        rows, columns = np.nonzero(some)
        return Box(
            self.x0_mm + columns.min() * self.pitch_mm,
            self.x0_mm + columns.max() * self.pitch_mm,
            self.y0_mm + rows.min() * self.pitch_mm,
            self.y0_mm + rows.max() * self.pitch_mm,
        )

    def z(self, x: Array, y: Array) -> Array:
        """Height of the membrane in the sensor frame (mm)."""
        return base_z(self.radius_mm, x, y) + self._look_up(self.height_mm, x, y)

    def normals(self, x: Array, y: Array) -> Array:
        """Unit normals towards the camera, shape (..., 3)."""
        if self.radius_mm is None:
            p, q = np.zeros_like(x), np.zeros_like(y)
        else:
            rise = np.sqrt(np.maximum(self.radius_mm**2 - x**2 - y**2, 1e-12))
            p, q = x / rise, y / rise
        along_x, along_y = self.slopes
        p, q = p + self._look_up(along_x, x, y), q + self._look_up(along_y, x, y)
        for wave_x, wave_y, amplitude_mm, phase in self.waves:
            steep = amplitude_mm * np.cos(wave_x * x + wave_y * y + phase)
            p, q = p + wave_x * steep, q + wave_y * steep
        return np.stack([-p, -q, np.ones_like(p)], axis=-1) / np.sqrt(1 + p**2 + q**2)[..., None]

    def mixed(self, other: "HeightField", share: float) -> "HeightField":
        """Go from this membrane towards another, on this one's grid, by a share."""
        rows, columns = self._pressed.shape
        x, y = np.meshgrid(
            self.x0_mm + self.pitch_mm * np.arange(columns), self.y0_mm + self.pitch_mm * np.arange(rows)
        )
        height, contact = other._look_up(other.height_mm, x, y), other.touched(x, y)
        return replace(
            self,
            height_mm=(1 - share) * self._pressed + share * height,
            contact=self.contact if share < 0.5 else contact,
        )

    def touched(self, x: Array, y: Array) -> Array:
        """Share of points that an object touches."""
        return self._look_up(self.contact, x, y)

    def _look_up(self, grid: Array | None, x: Array, y: Array) -> Array:
        if grid is None:
            return np.zeros_like(x)
        row, column = (y - self.y0_mm) / self.pitch_mm, (x - self.x0_mm) / self.pitch_mm
        return kernels.bilinear(grid, np.ravel(row), np.ravel(column), False).reshape(np.shape(row))


def base_z(radius_mm: float | None, x: Array, y: Array) -> Array:
    """Height of the undeformed membrane; clamped at the equator of a dome's sphere."""
    if radius_mm is None:
        return np.zeros(np.broadcast(x, y).shape)
    return np.asarray(radius_mm - np.sqrt(np.maximum(radius_mm**2 - x**2 - y**2, 0.0)))


def indented(
    elastomer: Elastomer,
    indenter: Indenter,
    *,
    kernel_length_mm: float,
    kernel_m: float,
    pitch_mm: float = PITCH_MM,
    tail_share: float = 0.0,
    tail_mm: float = 0.7,
    waves: Array | None = None,
) -> HeightField:
    """Membrane with a probe pressed into it.

    Where `tail_share` is not zero, the gel is lifted around the contact too, to that share of the depth at
    the contact's outline, decaying over `tail_mm`. Penetration and tail are multiplied by the transfer
    function of the kernel in the frequency domain.

    Raises
    ------
    ValueError
        If the probe does not touch the membrane.
    """
    reach = reach_mm(tail_share, tail_mm, indenter.depth_mm)
    x, y, (x0, y0) = _grid(elastomer, indenter, kernel_length_mm, pitch_mm, reach)
    height, contact = penetration(elastomer, indenter, x, y, pitch_mm)
    if tail_share:
        away = outside_mm(elastomer, indenter, contact, x, y)
        # Without its last half micrometre the tail ends smoothly.
        height = np.maximum(height, tail_share * indenter.depth_mm * np.exp(-away / tail_mm) - LEAST_MM)
    if indenter.beside is not None:
        other, touched = penetration(elastomer, indenter.beside, x, y, pitch_mm)
        height, contact = np.maximum(height, other), np.maximum(contact, touched)
    if kernel_length_mm > 0:
        height = _smoothed(height, pitch_mm, kernel_length_mm, kernel_m)
    return HeightField(
        elastomer.radius_mm,
        x0_mm=x0,
        y0_mm=y0,
        pitch_mm=pitch_mm,
        height_mm=height,
        contact=contact,
        waves=np.zeros((0, 4)) if waves is None else waves,
    )


def _grid(
    elastomer: Elastomer, indenter: Indenter, kernel_length_mm: float, pitch_mm: float, tail_mm: float
) -> tuple[Array, Array, tuple[float, float]]:
    """Points (x, y) around all that is touched, and the first of them."""
    margin = REACH * kernel_length_mm + 6 * pitch_mm
    box = _touched(elastomer, indenter)
    if indenter.other is not None:
        box = box.joined(_touched(elastomer, indenter._replace(probe=indenter.other)))
    box = box.grown(tail_mm)
    if indenter.beside is not None:
        box = box.joined(_touched(elastomer, indenter.beside))
    box = box.grown(margin)
    columns = int(np.ceil((box.right - box.left) / pitch_mm)) + 1
    rows = int(np.ceil((box.top - box.bottom) / pitch_mm)) + 1
    x, y = np.meshgrid(box.left + np.arange(columns) * pitch_mm, box.bottom + np.arange(rows) * pitch_mm)
    return x, y, (box.left, box.bottom)


def penetration(
    elastomer: Elastomer, indenter: Indenter, x: Array, y: Array, pitch_mm: float
) -> tuple[Array, Array]:
    """Depth to which a probe stands in the undeformed gel, and share of each cell that it touches."""
    # Four points a cell place straight edges to a quarter of the pitch.
    shifts = [(dx * pitch_mm, dy * pitch_mm) for dx in (-0.25, 0.25) for dy in (-0.25, 0.25)]

    def cut(probe: Probe) -> Array:
        one = indenter._replace(probe=probe)
        above = np.stack([above_base(elastomer, one, x + dx, y + dy) for dx, dy in shifts])
        return np.asarray(np.maximum(above - above.max() + indenter.depth_mm, 0.0))

    depth = cut(indenter.probe)
    if indenter.other is not None:
        depth = (1 - indenter.wrong) * depth + indenter.wrong * cut(indenter.other)
    return depth.mean(axis=0), (depth > 0).mean(axis=0)


def transfer(wavenumber: Array, *, kernel_length_mm: float, kernel_m: float) -> Array:
    """Fourier transform of the kernel (m + 1) / (m + exp(r / length)), cut at 6 lengths, one at zero.

    Parameters
    ----------
    wavenumber : array
        Angular wave number (1/mm).
    """
    nodes, weights = np.polynomial.legendre.leggauss(96)
    r = (nodes + 1) / 2 * REACH
    ring = weights * r * (kernel_m + 1) / (kernel_m + np.exp(r))
    hankel = j0(np.multiply.outer(np.asarray(wavenumber) * kernel_length_mm, r)) @ ring
    return np.asarray(hankel / ring.sum())


def _smoothed(height: Array, pitch_mm: float, length_mm: float, m: float) -> Array:
    rows, columns = height.shape
    k_y = 2 * np.pi * np.fft.fftfreq(rows, pitch_mm)
    k_x = 2 * np.pi * np.fft.rfftfreq(columns, pitch_mm)
    k = np.hypot(k_y[:, None], k_x[None, :])
    table_k, table = _transfer_table(pitch_mm, length_mm, m)
    spectrum = np.fft.rfft2(height) * np.interp(k, table_k, table)
    return np.maximum(np.fft.irfft2(spectrum, s=height.shape), 0.0)


@lru_cache(maxsize=16)
def _transfer_table(pitch_mm: float, length_mm: float, m: float) -> tuple[Array, Array]:
    k = np.linspace(0.0, 1.01 * np.sqrt(2) * np.pi / pitch_mm, 8192)
    return k, transfer(k, kernel_length_mm=length_mm, kernel_m=m)


def above_base(elastomer: Elastomer, indenter: Indenter, x: Array, y: Array) -> Array:
    """Height of the probe, its foremost point at z = 0, above the undeformed membrane."""
    turn = np.exp(-1j * np.radians(indenter.yaw_deg))
    local = turn * ((x - indenter.centre_mm[0]) + 1j * (y - indenter.centre_mm[1]))
    return np.asarray(profile_mm(indenter.probe, local.real, local.imag) - base_z(elastomer.radius_mm, x, y))


def _touched(elastomer: Elastomer, indenter: Indenter) -> Box:
    """Bounding box of the contact, found on a coarse grid and grown by one of its steps."""
    reach = (
        2.2 * indenter.probe.size_mm
    )  # the plate of a wave probe is the widest: 1.5 sizes, over the corner 2.12
    if elastomer.shape == "dome":
        reach = min(reach, elastomer.width_mm)
    axis = np.linspace(-reach, reach, 241)
    x, y = np.meshgrid(indenter.centre_mm[0] + axis, indenter.centre_mm[1] + axis)
    above = above_base(elastomer, indenter, x, y)
    touching = above > above.max() - indenter.depth_mm
    if not np.isfinite(above.max()):
        raise ValueError(f"press: probe {indenter.probe.text} misses the membrane")
    step = float(axis[1] - axis[0])
    return Box(x[touching].min(), x[touching].max(), y[touching].min(), y[touching].max()).grown(step)
