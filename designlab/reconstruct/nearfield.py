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
does not end at once where the slope turns away, and neither cast shadows nor light between walls are in it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import map_coordinates

from designlab.reconstruct.kernel import Estimate
from designlab.reconstruct.polynomial import checked_image

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

STEEPEST = float(np.tan(np.radians(76.0)))  # slope that is never exceeded, as of the calibrated methods
# Slopes of which the best is a second start: attached shadow leaves more than one minimum.
_RING_DEG, _AZIMUTHS = (15.0, 35.0, 55.0), 12
_ROUNDS = 40
_DAMPING, _MOST_DAMPING = 1e-3, 1e9
_CONVERGED = 1e-9  # slope
_LEAST_ERROR = float(np.tan(np.radians(0.5)))  # smaller ones would make the integration stiff
_MOST_SHIFT_MM = 2.0  # of grazing light, which a small height would otherwise take from beyond the gel


class _Pixels(NamedTuple):
    """What is known of some pixels; the first axis is that of pixels."""

    facing: Array  # (pixels, groups, 3): product of V with the normal is its first entry plus (p, q) . rest
    base: Array  # (pixels, 2)
    target: Array  # (pixels, channels): signal less the offset
    certainty: Array  # (pixels, channels): 1 / sigma, zero where a channel tells nothing

    def of(self, chosen: NDArray[np.generic]) -> "_Pixels":
        """Some of them."""
        return _Pixels(*(values[chosen] for values in self))


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
    """

    light: Array
    response: Array
    mix: Array
    offset: Array
    base: Array
    noise_sigma: Callable[[Array], Array]
    full_scale: float
    model_error: float

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
        if not full_scale > 0:
            raise ValueError(f"full_scale: must be positive, got {full_scale:g}")
        return cls(
            light=np.moveaxis(light, 0, -1),
            response=np.moveaxis(response, 0, -2),
            mix=mix,
            offset=offset,
            base=slopes,
            noise_sigma=noise_sigma,
            full_scale=full_scale,
            model_error=model_error,
        )

    @property
    def background(self) -> Array:
        """Signal of the untouched membrane, shape (rows, columns, channels)."""
        return np.asarray(self.light @ self.mix.T + self.offset)

    @property
    def _facing(self) -> Array:
        """What `_Pixels.facing` is, shape (rows, columns, groups, 3)."""
        length = np.sqrt(1 + (self.base**2).sum(axis=-1))[..., None]
        by_slope = (
            length[..., None] * self.response
            + (self.light / length)[..., None] * self.base[..., None, :]
        )
        return np.concatenate([(length * self.light)[..., None], by_slope], axis=-1)

    def estimate(self, image: ArrayLike, *, mask: Mask | None = None) -> Estimate:
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
        if mask is not None and (mask.shape != (rows, columns) or mask.dtype != bool or not mask.any()):
            raise ValueError(f"mask: must be bool of shape {(rows, columns)} with a pixel to use")
        sigma = np.hypot(self.noise_sigma(image), self.model_error * (self.background - self.offset))
        certainty = np.where((image < self.full_scale) & (sigma > 0), 1 / np.maximum(sigma, 1e-300), 0.0)
        pixels = _Pixels(
            self._facing.reshape(-1, self.light.shape[-1], 3),
            self.base.reshape(-1, 2),
            (image - self.offset).reshape(-1, channels),
            certainty.reshape(-1, channels),
        )
        slope, cost = _solved(pixels, self.mix)
        weights = _weights(pixels, self.mix, slope, cost)
        weights = weights.reshape(rows, columns) / max(float(weights.max()), 1e-300)
        p, q = slope.T.reshape(2, rows, columns)
        return Estimate(p, q, weights if mask is None else weights * mask)

    def lifted(
        self, height_mm: ArrayLike, *, pitch_mm: tuple[float, float], view: tuple[ArrayLike, ArrayLike]
    ) -> Self:
        """The same light at the points of a lifted membrane.

        A pixel sees a lifted point beside the one it saw before, and light reaches that point on the way to
        yet another place: its mean direction tells where the same light fell on the undeformed membrane.

        Parameters
        ----------
        height_mm : array, shape (rows, columns)
            Height of the indentation, of a first pass.
        pitch_mm : pair of float
            Distances of pixels along x and y.
        view : pair of arrays, shape (rows, columns)
            By how much the viewing ray of each pixel moves along x and y per mm of height.
        """
        height = np.asarray(height_mm, dtype=float)
        view_x, view_y = (np.asarray(slope, dtype=float) for slope in view)
        a, b = np.moveaxis(self.base, -1, 0)
        lift = height / np.maximum(1 - a * view_x - b * view_y, 0.1)
        seen = lift * view_x, lift * view_y
        at = np.indices(height.shape, dtype=float)

        def moved(values: Array, shift_x: Array, shift_y: Array) -> Array:
            places = [at[0] - shift_y / pitch_mm[1], at[1] + shift_x / pitch_mm[0]]
            return np.asarray(map_coordinates(values, places, order=1, mode="nearest"))

        base = np.stack([moved(slope, *seen) for slope in (a, b)], axis=-1)
        length = np.sqrt(1 + (base**2).sum(axis=-1))
        light, response = np.empty_like(self.light), np.empty_like(self.response)
        for group in range(self.light.shape[-1]):
            towards, *by_slope = np.moveaxis(self._facing[:, :, group], -1, 0)
            vector = [-by_slope[0], -by_slope[1], towards - a * by_slope[0] - b * by_slope[1]]
            # height over the product of the light's vector with the normal: how far back along the light
            back = height / np.maximum(towards, 1e-9 * max(float(towards.max()), 1e-300))
            away = [-back * v for v in vector[:2]]
            far = np.minimum(1.0, _MOST_SHIFT_MM / np.maximum(np.hypot(*away), 1e-12))
            shift = [s + far * w for s, w in zip(seen, away, strict=True)]
            x, y, z = (moved(v, *shift) for v in vector)
            facing = z - base[..., 0] * x - base[..., 1] * y
            light[..., group] = np.maximum(facing, 0.0) / length
            for axis, v in enumerate((x, y)):
                response[..., group, axis] = (
                    -v / length - light[..., group] * base[..., axis] / length**2
                )
        return replace(self, light=light, response=response, base=base)


def near_field(
    image: ArrayLike,
    light: ArrayLike,
    response: ArrayLike,
    mix: ArrayLike,
    *,
    noise_sigma: Callable[[Array], Array],
    offset: ArrayLike = 0.0,
    base: tuple[ArrayLike, ArrayLike] = (0.0, 0.0),
) -> Estimate:
    """Slopes of a press from its picture and the known light; see `NearField.of` for the parameters."""
    known = NearField.of(light, response, mix, noise_sigma=noise_sigma, offset=offset, base=base)
    return known.estimate(image)


def _predicted(pixels: _Pixels, mix: Array, slope: Array) -> Array:
    """Signals less the offset, (pixels, channels)."""
    total = pixels.base + slope
    length = np.sqrt(1 + (total**2).sum(axis=-1))
    facing = pixels.facing[..., 0] + (pixels.facing[..., 1:] @ slope[..., None])[..., 0]
    return np.asarray((np.maximum(facing, 0.0) / length[:, None]) @ mix.T)


def _jacobian(pixels: _Pixels, mix: Array, slope: Array) -> Array:
    """Derivatives of `_predicted` by the slopes, (pixels, channels, 2)."""
    total = pixels.base + slope
    length = np.sqrt(1 + (total**2).sum(axis=-1))[:, None]
    facing = pixels.facing[..., 0] + (pixels.facing[..., 1:] @ slope[..., None])[..., 0]
    lit = facing > 0
    shaded = np.where(lit, facing, 0.0) / length**3
    parts = [
        np.where(lit, pixels.facing[..., 1 + axis], 0.0) / length - shaded * total[:, axis, None]
        for axis in (0, 1)
    ]
    return np.stack([part @ mix.T for part in parts], axis=-1)


def _cost(pixels: _Pixels, mix: Array, slope: Array) -> Array:
    """Sum of squared residuals in units of their standard deviations, (pixels,)."""
    residual = (pixels.target - _predicted(pixels, mix, slope)) * pixels.certainty
    return np.asarray((residual**2).sum(axis=-1))


def _solved(pixels: _Pixels, mix: Array) -> tuple[Array, Array]:
    """Slopes of least cost, (pixels, 2), and that cost, from a flat start and the best of rings of slopes."""
    slope, cost = _descended(pixels, mix, np.zeros_like(pixels.base))
    channels = (pixels.certainty > 0).sum(axis=-1)
    # A fit as good as noise allows with all groups lit is the only one.
    facing = pixels.facing[..., 0] + (pixels.facing[..., 1:] @ slope[..., None])[..., 0]
    doubtful = np.flatnonzero(
        (channels >= 2) & ((facing <= 0).any(axis=-1) | (channels < mix.shape[0]) | (cost > 4 * channels))
    )
    some = pixels.of(doubtful)
    best, least = np.zeros((doubtful.size, 2)), np.full(doubtful.size, np.inf)
    for tangent in np.tan(np.radians(_RING_DEG)):
        for azimuth in np.arange(_AZIMUTHS) * 2 * np.pi / _AZIMUTHS:
            trial = np.broadcast_to(tangent * np.array([np.cos(azimuth), np.sin(azimuth)]), best.shape)
            found = _cost(some, mix, trial)
            better = found < least
            best[better], least[better] = trial[better], found[better]
    other, lower = _descended(some, mix, best)
    better = lower < cost[doubtful]
    slope[doubtful[better]], cost[doubtful[better]] = other[better], lower[better]
    return slope, cost


def _descended(pixels: _Pixels, mix: Array, start: Array) -> tuple[Array, Array]:
    """Slopes after steps of Levenberg and Marquardt, each pixel with its own damping, and their cost."""
    slope, cost = start.copy(), _cost(pixels, mix, start)
    damping = np.full(len(slope), _DAMPING)
    going = np.flatnonzero((pixels.certainty > 0).any(axis=-1))
    for _ in range(_ROUNDS):
        if not going.size:
            break
        some, at = pixels.of(going), slope[going]
        jacobian = _jacobian(some, mix, at) * some.certainty[..., None]
        residual = (some.target - _predicted(some, mix, at)) * some.certainty
        downhill = (jacobian * residual[..., None]).sum(axis=1)
        xx, xy, yy = _information(jacobian)
        # Marquardt's scale, with a share of the other slope's so that a direction without response stands still
        held = damping[going] * (xx + yy) + 1e-300
        xx, yy = xx + held, yy + held
        determinant = xx * yy - xy**2
        step = np.stack(
            [
                yy * downhill[:, 0] - xy * downhill[:, 1],
                xx * downhill[:, 1] - xy * downhill[:, 0],
            ],
            axis=-1,
        ) / np.maximum(determinant, 1e-300)[:, None]
        trial = at + step
        trial *= np.minimum(1.0, STEEPEST / np.maximum(np.hypot(*trial.T), 1e-12))[:, None]
        found = _cost(some, mix, trial)
        better = found <= cost[going]
        slope[going[better]], cost[going[better]] = trial[better], found[better]
        damping[going] *= np.where(better, 0.1, 10.0)
        moved = np.hypot(*(trial - at).T)
        going = going[(moved > _CONVERGED) & (damping[going] < _MOST_DAMPING)]
    return slope, cost


def _information(jacobian: Array) -> tuple[Array, Array, Array]:
    """Fisher's information of the two slopes: entries xx, xy and yy, each (pixels,)."""
    x, y = jacobian[..., 0], jacobian[..., 1]
    return (x * x).sum(axis=-1), (x * y).sum(axis=-1), (y * y).sum(axis=-1)


def _weights(pixels: _Pixels, mix: Array, slope: Array, cost: Array) -> Array:
    """Inverse of the expected variance of the slopes, (pixels,)."""
    xx, xy, yy = _information(_jacobian(pixels, mix, slope) * pixels.certainty[..., None])
    determinant = xx * yy - xy**2
    free = np.maximum((pixels.certainty > 0).sum(axis=-1) - 2, 1)
    known = determinant > 1e-12 * (xx + yy) ** 2
    variance = (xx + yy) / np.where(known, determinant, 1.0) * np.maximum(cost / free, 1.0)
    return np.where(known, 1 / (variance + _LEAST_ERROR**2), 0.0)


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
