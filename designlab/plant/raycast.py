"""Pictures of a membrane by casting every pixel's own rays onto the height field."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.camera import Camera, View
from designlab.plant.light import Lighting, Pressed
from designlab.plant.rig import Rig
from designlab.plant.surface import HeightField, Indenter, base_z, indented
from geometries import elastomer

Array = NDArray[np.float64]

SUPERSAMPLES = 2  # rays along each side of an output pixel


class Rays(NamedTuple):
    """Rays x = x_c + t tan_x, y = y_c + t tan_y, z = z_c - t from a centre of projection (x_c, y_c, z_c)."""

    origin_mm: tuple[float, float, float]
    tan_x: Array
    tan_y: Array

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Points of the rays."""
        x, y, z = self.origin_mm
        return x + t * self.tan_x, y + t * self.tan_y, z - t


class Caster:
    """Renders presses of one rig in one view; what the untouched membrane shows is computed once.

    Parameters
    ----------
    rig : Rig
        The sensor.
    view : View
        Rectangle of the camera's sensor and the output pixels it is binned to.
    """

    def __init__(self, rig: Rig, view: View) -> None:
        self._rig, self._view = rig, view
        self._lighting = Lighting(rig)
        self._rays = pixel_rays(rig.camera, view)
        self._t = meet(self._rays, HeightField(rig.elastomer.radius_mm))
        x, y, _ = self._rays.at(self._t)
        self._untouched = self._lighting.untouched.irradiance(x, y)

    def radiance(self, indenter: Indenter | None) -> Array:
        """Radiance of every LED group at unit flux, shape (groups, rows, columns), in mW/mm2/sr per mW."""
        if indenter is None:
            return self._image(self._t, self._untouched)
        rig = self._rig
        surface = indented(
            rig.elastomer, indenter, kernel_length_mm=rig.kernel_length_mm, kernel_m=rig.kernel_m
        )
        pressed = self._lighting.pressed(surface)
        t, irradiance = self._t.copy(), self._untouched.copy()
        x, y, _ = self._rays.at(t)
        near = self._near(pressed, x, y)
        close = Rays(self._rays.origin_mm, self._rays.tan_x[near], self._rays.tan_y[near])
        t[near] = meet(close, surface)
        x[near], y[near], _ = close.at(t[near])
        irradiance[:, near] = pressed.irradiance(x[near], y[near])
        far = ~near
        irradiance[:, far] += pressed.from_membrane(x[far], y[far])
        irradiance[:, far] -= self._lighting.untouched.from_membrane(x[far], y[far])
        return self._image(t, irradiance)

    def _near(self, pressed: Pressed, x: Array, y: Array) -> NDArray[np.bool_]:
        """Rays whose own point, or the light on it, an indentation changes."""
        if pressed.window is None:
            return np.zeros(len(x), dtype=bool)
        steepest = float(max(np.abs(self._rays.tan_x).max(), np.abs(self._rays.tan_y).max()))
        return pressed.window.grown(pressed.surface.peak_mm * steepest).contains(x, y)

    def _image(self, t: Array, irradiance: Array) -> Array:
        x, y, _ = self._rays.at(t)
        membrane = elastomer.inside(self._rig.elastomer, x, y)
        radiance = self._rig.albedo[:, None] / np.pi * np.where(membrane, irradiance, 0.0)
        split = SUPERSAMPLES
        shape = len(radiance), self._view.rows, split, self._view.columns, split
        return np.asarray(radiance.reshape(shape).mean(axis=(2, 4))) * self._rig.camera.vignette(self._view)


def pixel_rays(camera: Camera, view: View, *, split: int = SUPERSAMPLES) -> Rays:
    """Rays through `split` x `split` evenly spaced points of every output pixel, rows first, flattened.

    Raises
    ------
    ValueError
        If a pixel looks 90 deg or more away from the axis, where no ray meets the membrane.
    """
    u = view.x_px + (np.arange(view.columns * split) + 0.5) * view.width_px / (view.columns * split)
    v = view.y_px + (np.arange(view.rows * split) + 0.5) * view.height_px / (view.rows * split)
    if not camera.is_plain:
        right, up, forward = camera.unproject(*np.meshgrid(u, v))
        if forward.min() <= 0:
            raise ValueError("camera.lens: the picture must stay within 90 deg of the axis")
        return Rays(camera.position_mm, (right / forward).ravel(), (up / forward).ravel())
    per_px = 2 * np.tan(np.radians(camera.horizontal_fov_deg / 2)) / camera.width_px
    x_c, y_c = camera.centre_px
    tan_x, tan_y = np.meshgrid(per_px * (u - x_c), per_px * (y_c - v))
    return Rays(camera.position_mm, tan_x.ravel(), tan_y.ravel())


def meet(rays: Rays, surface: HeightField, *, steps: int = 16) -> Array:
    """Ray parameter t (mm below the camera) of the first point where each ray meets a membrane.

    The base is met by Newton's method. Where there is an indentation, the piece of the ray between its peak
    and the base is searched in equal steps for the first crossing, which bisection then narrows down.
    """
    t = np.full(rays.tan_x.shape, rays.origin_mm[2])
    if surface.radius_mm is not None:
        for _ in range(6):
            x, y, z = rays.at(t)
            rise = np.sqrt(np.maximum(surface.radius_mm**2 - x**2 - y**2, 1e-6))
            fall = 1 + (x * rays.tan_x + y * rays.tan_y) / rise
            t = t + (z - base_z(surface.radius_mm, x, y)) / fall
    if surface.height_mm is None:
        return t
    # The base under the ray rises by less than the ray falls, so twice the peak is above the indentation.
    high, low = t - 2 * surface.peak_mm - 1e-3, t + 1e-6
    found = np.zeros(t.shape, dtype=bool)
    step = (low - high) / steps
    upper, lower = high.copy(), low.copy()
    for number in range(1, steps + 1):
        x, y, z = rays.at(high + number * step)
        crossed = ~found & (z <= surface.z(x, y))
        upper[crossed] = (high + (number - 1) * step)[crossed]
        lower[crossed] = (high + number * step)[crossed]
        found |= crossed
    for _ in range(18):
        middle = (upper + lower) / 2
        x, y, z = rays.at(middle)
        below = z <= surface.z(x, y)
        lower, upper = np.where(below, middle, lower), np.where(below, upper, middle)
    return np.asarray((upper + lower) / 2)


def render(rig: Rig, view: View, indenters: list[Indenter | None]) -> list[Array]:
    """Radiance of every LED group at unit flux for a list of presses; equal presses are computed once."""
    caster = Caster(rig, view)
    done: dict[Indenter | None, Array] = {}
    for indenter in indenters:
        if indenter not in done:
            done[indenter] = caster.radiance(indenter)
    return [done[indenter] for indenter in indenters]
