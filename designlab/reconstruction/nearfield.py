"""Photometric stereo from the known light of a design, without calibration presses.

Let V be the vector irradiance of an LED group at a membrane point, the base slopes (a, b) there, and (p, q)
the slopes of the indentation, which add to those of the base. A Lambertian membrane shows

    I(p, q) = max(0, V . (-a - p, -b - q, 1)) / sqrt(1 + (a + p)^2 + (b + q)^2).

With L = I(0, 0) and its derivative r by (p, q), and N = sqrt(1 + a^2 + b^2), the product with V is

    N L + p (N r_p + L a / N) + q (N r_q + L b / N),

so that the untouched light and its response to slope are all there is to know. On a flat base this is
I = max(0, L + r . (p, q)) / sqrt(1 + p^2 + q^2). A channel sees sum_g mix[c, g] I_g and an offset that no
press changes. The slopes of each pixel are those that explain its channels best, by Levenberg and Marquardt.

The formula takes all light of a group as coming from one direction at each place: light from many directions
does not end at once where the slope turns away, and cast shadows are not in it.

A slope sees the gel around it, of which a plane would fill (1 - cos t) / 2 of its sky, t the angle by which
the indentation turned the normal. So R L (1 - cos t) / 2 is added, R being the membrane's reflectance.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import map_coordinates

from designlab.core.types import Array, Mask
from designlab.reconstruction.kernel import GradientEstimate
from designlab.reconstruction.pictures import check_mask, checked_image
from designlab.reconstruction.pixelwise import Pixels, solved, weights_of

# Elevations over which a group's light is spread, see docs/decisions.md.
PENUMBRA_DEG = 20.0
_STEPS, _REACH = 20, 5.0  # of the search for the horizon, as multiples of the height
_SHADOW_ERROR = 0.25  # of a shadow, as a share of the light it takes


@dataclass(frozen=True, eq=False)
class NearField:
    """Light of each LED group on the untouched membrane, and how a camera sees it.

    Make one with `NearField.of`.

    Attributes
    ----------
    light : array, shape (rows, columns, groups)
        From the untouched membrane.
    response : array, shape (rows, columns, groups, 2)
        Its change per unit of the slopes p and q of the indentation.
    mix : array, shape (channels, groups)
        Signal of each channel per unit of light.
    offset : array, shape (rows, columns, channels)
        Signal that does not come from the membrane: stray light, black level.
    base : array, shape (rows, columns, 2)
        Slopes of the undeformed membrane.
    noise_sigma : callable
        Standard deviation of the camera's noise for a signal (rows, columns, channels).
    full_scale : float
        Signal from which a channel is clipped.
    model_error : float
        Standard deviation of what the model leaves out, as a share of each channel's untouched signal.
    reflectance : array, shape (groups,)
        Of the membrane, for the light that the gel around throws on slopes.
    expected_slope : float
        Standard deviation of slopes along x and y before the picture is seen.
    visible : array, shape (rows, columns, groups)
        Share of the light that no indentation keeps away, see `shadowed`.
    """

    light: Array
    response: Array
    mix: Array
    offset: Array
    base: Array
    noise_sigma: Callable[[Array], Array]
    full_scale: float
    model_error: float
    reflectance: Array
    expected_slope: float
    visible: Array

    @classmethod
    def of(
        cls,
        light: ArrayLike,
        response: ArrayLike,
        mix: ArrayLike,
        *,
        noise_sigma: Callable[[Array], Array],
        offset: ArrayLike = 0.0,
        base: tuple[ArrayLike, ArrayLike] = (0.0, 0.0),
        full_scale: float = 1.0,
        model_error: float = 0.0,
        reflectance: ArrayLike = 0.0,
        expected_slope: float = np.inf,
    ) -> Self:
        """Check what is known, and bring it into order.

        Parameters
        ----------
        light : array, shape (groups, rows, columns)
            Light of the untouched membrane by LED group, stray light not included.
        response : array, shape (groups, rows, columns, 2)
            Change of that light per unit of slope along x and y.
        mix : array, shape (channels, groups)
            Signal of each channel per unit of light; flux and exposure included.
        noise_sigma : callable
            Standard deviation of the camera's noise for a signal (rows, columns, channels).
        offset : array, shape (rows, columns, channels) or what broadcasts to it
            Signal that does not come from the membrane: stray light, black level.
        base : pair of arrays, shape (rows, columns)
            Slopes dz/dx and dz/dy of the undeformed membrane; zero for a flat one.
        full_scale : float
            Signal from which a channel is clipped and tells nothing.
        model_error : float
            Standard deviation of what the model leaves out (light between walls, cast shadows), as a share of
            each channel's untouched signal. It weighs dark channels against bright ones.
        reflectance : array, shape (groups,), or float
            Of the membrane: slopes see the gel around, which is lit as they were. Zero leaves that out.
        expected_slope : float
            Standard deviation of slopes along x and y before the picture is seen; it decides where two
            slopes explain a picture equally well, as where a shadow leaves two channels.

        Raises
        ------
        ValueError
            If shapes differ, a value is not finite or negative where it may not be, or there are fewer than
            two channels.
        """
        light, response, mix = (np.asarray(values, dtype=float) for values in (light, response, mix))
        if light.ndim != 3:
            raise ValueError(f"light: must have shape (groups, rows, columns), got {light.shape}")
        groups, *shape = light.shape
        if response.shape != (*light.shape, 2):
            raise ValueError(f"response: must have shape {(*light.shape, 2)}, got {response.shape}")
        if mix.ndim != 2 or mix.shape[1] != groups or len(mix) < 2:
            raise ValueError(
                f"mix: must have shape (channels, groups) of at least 2 channels and {groups} groups, "
                f"got {mix.shape}"
            )
        offset = _spread("offset", offset, (*shape, len(mix)))
        slopes = np.stack([_spread("base", slope, tuple(shape)) for slope in base], axis=-1)
        for name, values in (("light", light), ("response", response), ("mix", mix)):
            _require_finite(name, values)
        for name, values in (("light", light), ("mix", mix), ("model_error", np.asarray(model_error))):
            if not (values >= 0).all():
                raise ValueError(f"{name}: must not be negative, the least is {values.min():g}")
        reflectance = _spread("reflectance", reflectance, (groups,))
        if not ((reflectance >= 0) & (reflectance <= 1)).all():
            raise ValueError(f"reflectance: must lie between 0 and 1, got {reflectance}")
        for name, value in (("full_scale", full_scale), ("expected_slope", expected_slope)):
            if not value > 0:
                raise ValueError(f"{name}: must be positive, got {value:g}")
        return cls(
            light=np.moveaxis(light, 0, -1),
            response=np.moveaxis(response, 0, -2),
            mix=mix,
            offset=offset,
            base=slopes,
            noise_sigma=noise_sigma,
            full_scale=full_scale,
            model_error=model_error,
            reflectance=reflectance,
            expected_slope=expected_slope,
            visible=np.ones((*shape, groups)),
        )

    @property
    def background(self) -> Array:
        """Signal of the untouched membrane, shape (rows, columns, channels)."""
        return np.asarray(self.light @ self.mix.T + self.offset)

    @property
    def _facing(self) -> Array:
        """What `Pixels.facing` is, shape (rows, columns, groups, 3)."""
        length = np.sqrt(1 + (self.base**2).sum(axis=-1))[..., None]
        by_slope = (
            length[..., None] * self.response + (self.light / length)[..., None] * self.base[..., None, :]
        )
        return np.concatenate([(length * self.light)[..., None], by_slope], axis=-1)

    def estimate(self, image: ArrayLike, *, mask: Mask | None = None) -> GradientEstimate:
        """Slopes of the indentation and their weights, each of shape (rows, columns).

        The weight of a pixel is the inverse of the variance that camera noise and model error leave in its
        slopes (Cramer and Rao), raised by what its channels contradict each other; a pixel with less than two
        channels that tell anything has none.

        Parameters
        ----------
        image : array, shape (rows, columns, channels)
            A press, linear, black level included.
        mask : bool array, shape (rows, columns), optional
            Pixels that show the bare membrane; printed markers left out, which get no weight.

        Raises
        ------
        ValueError
            If the image or the mask has another shape than the light, or the image is not finite.
        """
        image = checked_image(image, self.offset.shape, "image")
        rows, columns, channels = image.shape
        check_mask(mask, (rows, columns))
        uncertain = np.hypot(self.model_error, _SHADOW_ERROR * (1 - self.visible)) * self.light
        sigma = np.hypot(self.noise_sigma(image), uncertain @ self.mix.T)
        certainty = np.where((image < self.full_scale) & (sigma > 0), 1 / np.maximum(sigma, 1e-300), 0.0)
        pixels = Pixels(
            (self._facing * self.visible[..., None]).reshape(-1, self.light.shape[-1], 3),
            self.base.reshape(-1, 2),
            (self.reflectance * self.light).reshape(-1, self.light.shape[-1]),
            (image - self.offset).reshape(-1, channels),
            certainty.reshape(-1, channels),
            np.full(rows * columns, 1 / self.expected_slope),
        )
        slope, cost = solved(pixels, self.mix)
        weights = weights_of(pixels, self.mix, slope, cost)
        weights = weights.reshape(rows, columns) / max(float(weights.max()), 1e-300)
        p, q = slope.T.reshape(2, rows, columns)
        return GradientEstimate(p, q, weights if mask is None else weights * mask)

    def shadowed(self, height_mm: ArrayLike, *, pitch_mm: tuple[float, float]) -> Self:
        """The same light with the shadows that an indentation casts on the gel around it.

        Each group's mean direction is held against the horizon of the indentation. The shadow is soft, since
        a group's light comes from `PENUMBRA_DEG` of elevations; what a slope's own tilt takes from it is not
        counted twice.

        Parameters
        ----------
        height_mm : array, shape (rows, columns)
            Height of the indentation, of a first pass.
        pitch_mm : pair of float
            Distances of pixels along x and y.

        Raises
        ------
        ValueError
            If the height has another shape than the light.
        """
        height = np.asarray(height_mm, dtype=float)
        if height.shape != self.light.shape[:2]:
            raise ValueError(f"height_mm: must have shape {self.light.shape[:2]}, got {height.shape}")
        down, right = np.gradient(height, pitch_mm[1], pitch_mm[0])
        facing = self._facing
        at = np.indices(height.shape, dtype=float)
        distances = np.geomspace(min(pitch_mm), max(_REACH * height.max(), 2 * min(pitch_mm)), _STEPS)
        visible = np.empty_like(self.light)
        for group in range(self.light.shape[-1]):
            towards, *by_slope = np.moveaxis(facing[:, :, group], -1, 0)
            level = np.maximum(np.hypot(*by_slope), 1e-12 * max(float(towards.max()), 1e-300))
            x, y = (-v / level for v in by_slope)
            own = np.arctan(x * right - y * down)
            horizon = own.copy()
            for distance in distances:
                places = [at[0] - distance * y / pitch_mm[1], at[1] + distance * x / pitch_mm[0]]
                there = map_coordinates(height, places, order=1, mode="nearest")
                np.maximum(horizon, np.arctan((there - height) / distance), out=horizon)
            elevation = np.arctan2(towards, level)
            past, above = (
                np.clip(0.5 + (elevation - h) / np.radians(PENUMBRA_DEG), 1e-6, 1.0) for h in (horizon, own)
            )
            visible[..., group] = past / above
        return replace(self, visible=visible)


def near_field(
    image: ArrayLike,
    light: ArrayLike,
    response: ArrayLike,
    mix: ArrayLike,
    *,
    noise_sigma: Callable[[Array], Array],
    offset: ArrayLike = 0.0,
    base: tuple[ArrayLike, ArrayLike] = (0.0, 0.0),
) -> GradientEstimate:
    """Slopes of a press from its picture and the known light; see `NearField.of` for the parameters."""
    known = NearField.of(light, response, mix, noise_sigma=noise_sigma, offset=offset, base=base)
    return known.estimate(image)


def _spread(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    try:
        spread = np.broadcast_to(np.asarray(values, dtype=float), shape)
    except ValueError:
        raise ValueError(f"{name}: must broadcast to shape {shape}, got {np.shape(values)}") from None
    _require_finite(name, spread)
    return spread


def _require_finite(name: str, values: Array) -> None:
    bad = int((~np.isfinite(values)).sum())
    if bad:
        raise ValueError(f"{name}: must be finite, {bad} of {values.size} values are not")
