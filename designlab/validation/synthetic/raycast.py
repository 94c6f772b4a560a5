"""Pictures of a membrane by casting every pixel's own rays onto the height field."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.sensor.camera import Camera, View
from designlab.validation.synthetic import lens
from designlab.validation.synthetic.elastic_surface import pressed
from designlab.validation.synthetic.generator_sensor import Rig, TrueLens
from designlab.validation.synthetic.glass import CameraRays, look
from designlab.validation.synthetic.indenter import Indenter
from designlab.validation.synthetic.light import Lighting, Pressed, reflectances
from designlab.validation.synthetic.surface import HeightField, base_z, indented
from geometries import elastomer, probes

if TYPE_CHECKING:
    from designlab.validation.synthetic.immersed import ImmersedLighting, ImmersedMembraneLight

SUPERSAMPLES = 2  # rays along each side of an output pixel
GRAIN_REFLECTANCE = 0.3  # of a grain on the gel, over the membrane's


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
        self._wide, self._place = view.grown(lens.margin(rig.camera, rig.lens, view), rig.camera)
        self._lighting: Lighting | ImmersedLighting
        self._rays = pixel_rays(rig.camera, self._wide, bent=rig.lens, turn=rig.turn)
        self._passed: Array | float = 1.0
        self._veil: Array | float = 0.0
        if rig.glass is None:
            self._lighting = Lighting(rig)
        else:
            # The rendering engine is loaded for light behind glass alone.
            from designlab.validation.synthetic import immersed, veil

            self._lighting = immersed.ImmersedLighting(rig)
            self._veil = veil.veil(rig, self._lighting.field, self._rays.tan_x, self._rays.tan_y)
            self._rays, self._passed = look(rig.glass, self._rays)
        self._t = meet(self._rays, HeightField(rig.elastomer.radius_mm))
        x, y, _ = self._rays.at(self._t)
        self._untouched = self._lighting.untouched.irradiance(x, y, eye=self._eye)
        self._falloff = rig.camera.vignette(view) * lens.falloff(rig.camera, rig.lens, view)
        self._grain = self._with_grain()

    @property
    def _eye(self) -> Array | None:
        if not self._rig.coat.specular:
            return None
        return np.stack(np.broadcast_arrays(*self._rays.origin_mm, self._rays.tan_x)[:3], axis=-1)

    def radiance(self, indenter: Indenter | None) -> Array:
        """Radiance of every LED group at unit flux, shape (groups, rows, columns), in mW/mm2/sr per mW.

        As it arrives behind the lens: blurred, vignetted, with ghosts, without glare.
        """
        if indenter is None:
            return self._image(self._leaving(self._t, self._untouched, self._lighting.untouched.surface))
        surface = self._membrane(indenter)
        return self._image(self._leaving(*self._lit(surface), surface))

    def _membrane(self, indenter: Indenter) -> HeightField:
        """Membrane under a press, by the kernel, the elastic layer, or between the two."""
        rig, gel = self._rig, self._rig.gel
        if gel.share == 1:
            return pressed(rig.elastomer, gel, indenter, waves=rig.waves)
        smoothed = indented(
            rig.elastomer,
            indenter,
            kernel_length_mm=rig.kernel_length_mm,
            kernel_m=rig.kernel_m,
            tail_share=rig.contact.tail_share,
            tail_mm=rig.contact.tail_mm,
            waves=rig.waves,
        )
        if gel.share == 0:
            return smoothed
        return pressed(rig.elastomer, gel, indenter, waves=rig.waves).mixed(smoothed, 1 - gel.share)

    def _lit(self, surface: HeightField) -> tuple[Array, Array]:
        """Where every ray meets an indented membrane, and the irradiance there."""
        pressed = self._lighting.pressed(surface)
        t, irradiance = self._t.copy(), self._untouched.copy()
        x, y, _ = self._rays.at(t)
        near = self._near(pressed, x, y)
        close = self._rays.only(near)
        t[near] = meet(close, surface)
        x[near], y[near], _ = close.at(t[near])
        eye = self._eye
        irradiance[:, near] = pressed.irradiance(x[near], y[near], eye=None if eye is None else eye[near])
        far = ~near
        irradiance[:, far] += pressed.from_membrane(x[far], y[far])
        irradiance[:, far] -= self._lighting.untouched.from_membrane(x[far], y[far])
        return t, irradiance

    def _with_grain(self) -> Array | float:
        """What a grain on the gel and its shadow leave of the light of every ray."""
        if self._rig.grain is None:
            return 1.0
        x, y, radius, height = self._rig.grain
        ball = Indenter(probes.sphere(diameter_mm=2 * radius), height, (x, y))
        surface = indented(
            self._rig.elastomer,
            ball,
            kernel_length_mm=0.0,
            kernel_m=self._rig.kernel_m,
            waves=self._rig.waves,
        )
        t, irradiance = self._lit(surface)
        place = self._rays.at(t)
        covered = surface.touched(place[0], place[1])
        share = irradiance / np.maximum(self._untouched, 1e-30)
        return np.asarray(share * (1 - (1 - GRAIN_REFLECTANCE) * covered))

    def _leaving(self, t: Array, irradiance: Array, surface: HeightField) -> Array:
        """Radiance towards the camera of the point that every ray meets, (groups, rays)."""
        x, y, _ = self._rays.at(t)
        membrane = elastomer.inside(self._rig.elastomer, x, y)
        passed = self._passed
        if self._rig.glass is not None:
            way_mm = t * np.sqrt(1 + self._rays.tan_x**2 + self._rays.tan_y**2)
            passed = passed * np.exp(-self._rig.glass.gel_absorption_per_mm[:, None] * way_mm)
        irradiance = np.where(membrane, irradiance * self._rig.light_share(x, y), 0.0)
        radiance = reflectances(self._rig, surface, x, y) / np.pi * irradiance
        return radiance * self._grain * passed + self._veil

    def _near(self, pressed: "Pressed | ImmersedMembraneLight", x: Array, y: Array) -> NDArray[np.bool_]:
        """Rays whose own point, or the light on it, an indentation changes."""
        if pressed.window is None:
            return np.zeros(len(x), dtype=bool)
        steepest = float(max(np.abs(self._rays.tan_x).max(), np.abs(self._rays.tan_y).max()))
        return pressed.window.grown(pressed.surface.peak_mm * steepest).contains(x, y)

    def _image(self, radiance: Array) -> Array:
        split, wide, bent = SUPERSAMPLES, self._wide, self._rig.lens
        picture = radiance.reshape(len(radiance), wide.rows * split, wide.columns * split)
        if bent.blur_um:
            per_px = wide.columns * split / wide.width_px
            radius = lens.disc_px(self._rig.camera, bent) * per_px
            picture = lens.blurred(picture, radius=radius, aspect=self._rig.camera.pixel_aspect)
        picture = picture.reshape(len(picture), wide.rows, split, wide.columns, split).mean(axis=(2, 4))
        picture = picture[:, self._place[0], self._place[1]] * self._falloff
        if bent.drop is not None:
            picture = lens.behind_drop(picture, bent.drop)
        if bent.ghost:
            mean = self._untouched.mean(axis=1) * self._rig.albedo / np.pi
            picture = picture + bent.ghost * mean[:, None, None] * lens.ghosts(self._rig, self._view)
        return np.asarray(picture)


def pixel_rays(
    camera: Camera,
    view: View,
    *,
    split: int = SUPERSAMPLES,
    bent: TrueLens | None = None,
    turn: Array | None = None,
) -> CameraRays:
    """Rays through `split` x `split` evenly spaced points of every output pixel, rows first, flattened.

    Parameters
    ----------
    camera : Camera
        The camera as designed; at its true place.
    view : View
        Output pixels.
    split : int
        Rays along each side of a pixel.
    bent : TrueLens, optional
        What the lens distorts beyond the camera's own distortion.
    turn : array, shape (3, 3), optional
        Rotation of the camera about its centre of projection.

    Raises
    ------
    ValueError
        If a pixel looks 90 deg or more away from the axis, where no ray meets the membrane.
    """
    u = view.x_px + (np.arange(view.columns * split) + 0.5) * view.width_px / (view.columns * split)
    v = view.y_px + (np.arange(view.rows * split) + 0.5) * view.height_px / (view.rows * split)
    column, row = lens.seen(camera, bent or TrueLens(), *np.meshgrid(u, v))
    if camera.is_plain:
        x_c, y_c = camera.centre_px
        right, up = (column - x_c) / camera.focal_px, (y_c - row) / camera.focal_px
        forward = np.ones_like(right)
    else:
        right, up, forward = camera.unproject(column, row)
    if turn is not None:
        right, up, back = np.tensordot(turn, np.stack([right, up, -forward]), axes=1)
        forward = -back
    if forward.min() <= 0:
        raise ValueError("camera.lens: the picture must stay within 90 deg of the axis")
    return CameraRays(camera.position_mm, (right / forward).ravel(), (up / forward).ravel())


def meet(rays: CameraRays, surface: HeightField, *, steps: int = 16) -> Array:
    """Ray parameter t (mm below the camera) of the first point where each ray meets a membrane.

    The base is met by Newton's method. Where there is an indentation, the piece of the ray between its peak
    and the base, or its deepest bulge, is searched in equal steps for the first crossing, which bisection
    then narrows down.
    """
    t = np.broadcast_to(rays.origin_mm[2], rays.tan_x.shape).astype(float)
    if surface.radius_mm is not None:
        for _ in range(6):
            x, y, z = rays.at(t)
            rise = np.sqrt(np.maximum(surface.radius_mm**2 - x**2 - y**2, 1e-6))
            fall = 1 + (x * rays.tan_x + y * rays.tan_y) / rise
            t = t + (z - base_z(surface.radius_mm, x, y)) / fall
    if surface.height_mm is None:
        return t
    # The base under the ray rises by less than the ray falls, so twice the peak is above the indentation.
    high, low = t - 2 * surface.peak_mm - 1e-3, t + 2 * surface.bulge_mm + 1e-6
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
