"""Effects of the camera's lens."""

from functools import lru_cache
from typing import ClassVar, Literal

import numpy as np
from scipy.ndimage import convolve1d, gaussian_filter1d
from scipy.special import ive

from designlab.core.types import Array
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.sensor.lens import Fisheye
from designlab.simulation.effects.base import Effect, EffectParameter, Light, Part, Sight, Stage, Values

GLARE_WIDTH = 0.3  # standard deviation of the veil over the picture's width


class LensDistortion(Effect):
    """The lens images otherwise than assumed: scale and radial distortion."""

    name: ClassVar[str] = "lens_distortion"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "the picture is scaled or distorted"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # the lens's kind
    warps: ClassVar[bool] = True
    scales: ClassVar[str] = "magnification"
    confounded_with: ClassVar[tuple[str, ...]] = ("probe_size",)  # by its magnification

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """What is left after undistortion: 2 % of the distance from the axis at the corner (estimate).

        Displaced inwards by 4/27 or more, a lens images nothing at the corner.
        """
        return (
            EffectParameter(
                "radial", "1", 0.0, 0.02, -0.1, 0.2, "relative displacement at the full picture's corner"
            ),
            EffectParameter("magnification", "1", 0.0, 0.02, -0.4, 0.6, "relative enlargement"),
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Image a point at distance d at d (1 + magnification + radial r^2), r = d over half the diagonal."""
        radial, larger = values["radial"], 1.0 + values["magnification"]
        if not radial and larger == 1.0:
            return design
        camera = design.camera
        half_width, focal = camera.width_px / 2, camera.focal_px * larger
        k1 = radial / larger * (camera.focal_px / camera.half_diagonal_px) ** 2
        distortion = camera.distortion.model_copy(update={"k1": camera.distortion.k1 + float(k1)})
        if camera.lens == "pinhole":
            half = np.arctan(half_width / focal)
        else:
            # A fisheye's field of view is stated with its distortion in it.
            right, _, forward = Fisheye(distortion).direction(np.array(half_width / focal), np.zeros(()))
            half = np.arctan2(right, forward)
        return design.replace(
            {"camera.horizontal_fov_deg": float(2 * np.degrees(half)), "camera.distortion.k1": distortion.k1}
        )


class PointSpread(Effect):
    """The picture is blurred: defocus, diffraction, a smear on the lens."""

    name: ClassVar[str] = "point_spread"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "the picture is blurred"
    changes: ClassVar[tuple[Part, ...]] = ("light",)
    transferable: ClassVar[bool] = True  # the lens's kind

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Width on the membrane; 1.5 mm of lens, 40 mm away and 4 mm out of focus, blurs by 40 um."""
        return (
            EffectParameter(
                "sigma_um", "um", 0.0, 75.0, 0.0, 300.0, "standard deviation along each axis", squared=True
            ),
        )

    def on_light(self, light: Light, values: Values, sight: Sight) -> Light:
        """Smooth by a Gaussian; beyond its edges the picture is taken to go on in proportion."""
        if not values["sigma_um"]:
            return light
        kernels = [discrete_gaussian(1e-3 * values["sigma_um"] / pitch_mm) for pitch_mm in sight.pitch_mm]
        across, down = (
            min(len(kernel) // 2, size - 1) for kernel, size in zip(kernels, light.shape[:-3:-1], strict=True)
        )
        still = [(0, 0)] * (light.ndim - 2)
        wide = np.pad(light, [*still, (down, down), (across, across)], "reflect", reflect_type="odd")
        for axis, kernel in zip((-1, -2), kernels, strict=True):
            wide = convolve1d(wide, kernel, axis=axis, mode="nearest")
        rows, columns = light.shape[-2:]
        return np.asarray(wide[..., down : down + rows, across : across + columns])


def discrete_gaussian(sigma_px: float) -> Array:
    """Weights of a Gaussian on a grid: exp(-t) I_n(t), whose variance is t = sigma^2 for every t.

    Lindeberg, IEEE TPAMI 12, 1990, 234. Samples of a Gaussian narrower than a pixel would do nothing.
    """
    reach = int(np.ceil(5 * sigma_px)) + 2
    weights = ive(np.abs(np.arange(-reach, reach + 1)), sigma_px**2)
    return np.asarray(weights / weights.sum())


class VignettingEffect(Effect):
    """The picture is darker towards its corners than assumed."""

    name: ClassVar[str] = "vignetting"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "the picture falls off towards its corners"
    changes: ClassVar[tuple[Part, ...]] = ("light",)
    transferable: ClassVar[bool] = True  # the lens's kind

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Small lenses lose 20 to 55 % at the corner (libcamera's ov5647 table)."""
        return (
            EffectParameter(
                "corner_loss", "1", 0.0, 0.25, 0.0, 0.98, "share lost at the full picture's corner"
            ),
        )

    def finer_parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Lenses of several elements fall off more steeply than by the square, misplaced stops less."""
        return (
            EffectParameter(
                "power", "1", 2.0, 0.7, 1.0, 6.0, "power of r that the loss rises with (estimate)", shape=True
            ),
        )

    def on_light(self, light: Light, values: Values, sight: Sight) -> Light:
        """Multiply by 1 - loss r^power."""
        power = values.get("power", 2.0)
        factor = 1.0 - values["corner_loss"] * _radius(sight.design, sight.view) ** power
        return np.asarray(light * factor, dtype=light.dtype)


def _radius(design: Design, view: View) -> Array:
    """Distance of every pixel from the axis of the lens over half the diagonal of the full sensor."""
    camera = design.camera
    return np.asarray(camera.radius_px(*view.centres()) / camera.half_diagonal_px)


class VeilingGlare(Effect):
    """Light strays in the lens and lies over the picture as a veil."""

    name: ClassVar[str] = "veiling_glare"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "a veil of stray light lies over the picture"
    changes: ClassVar[tuple[Part, ...]] = ("light",)
    transferable: ClassVar[bool] = True  # the lens's kind
    told_by: ClassVar[Literal["dark"]] = "dark"

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Up to 3 % for a clean small lens, more for a dirty one (estimate)."""
        return (EffectParameter("share", "1", 0.0, 0.015, 0.0, 0.2, "share of the light that strays"),)

    def on_light(self, light: Light, values: Values, sight: Sight) -> Light:
        """Spread a share of the light widely; beyond its edges the picture is taken to go on mirrored."""
        share = values["share"]
        if not share:
            return light
        rows, columns = light.shape[-2:]
        width = GLARE_WIDTH * columns
        veil = _spreading(rows, width) @ np.asarray(light, dtype=float) @ _spreading(columns, width).T
        return np.asarray((1 - share) * light + share * veil, dtype=light.dtype)


@lru_cache(maxsize=8)
def _spreading(size: int, width_px: float) -> Array:
    """Matrix that smooths lines of a picture by a Gaussian, mirrored at the ends.

    A veil is about as wide as the picture: the product with a matrix takes less time than a convolution.
    """
    return np.asarray(gaussian_filter1d(np.eye(size), width_px, axis=0, mode="reflect", truncate=3.0))


EFFECTS: tuple[Effect, ...] = (LensDistortion(), PointSpread(), VignettingEffect(), VeilingGlare())
"""In the order in which they act."""
