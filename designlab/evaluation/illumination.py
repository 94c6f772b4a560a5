"""Illumination figures say how a sensor lights its untouched gel and how its picture responds to slope.

The *slant* of a group's light is that of the distant light with the same effect. A Lambertian membrane of
unit normal n under light of vector irradiance E sends I = E . n: untouched I = E_z, and to first order in the
slopes p = dz/dx and q = dz/dy it changes by -(E_x p + E_y q). So tan(slant) = |dI/d(p, q)| / I. It is what
photometric stereo lives on: for k even lights of known albedo the noise of a slope is that of the picture
over sin(slant). LEDs on opposite sides cancel in it, though each of them may graze the gel.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from designlab.core.metrics import (
    gradient_nonuniformity,
    uniformity_cv,
    uniformity_min_max,
    uniformity_nine_point,
    uniformity_u0,
)
from designlab.core.types import Array, Mask

RANGE_PERCENTILE = 99.0


class Evenness(NamedTuple):
    """How even a picture of the untouched gel is, see the functions of these names in `metrics`."""

    u0: float
    cv: float
    min_max: float
    nine_point: float
    gradient: float


def evenness(image: ArrayLike, mask: Mask | None = None, *, smooth: ArrayLike | None = None) -> Evenness:
    """Figures of evenness of one picture.

    Parameters
    ----------
    image : array, shape (rows, columns)
        One colour of the untouched gel, linear.
    mask : bool array, same shape, optional
        Where it counts; everywhere when absent.
    smooth : array, same shape, optional
        The same without noise, which is steep, for the gradient.
    """
    return Evenness(
        uniformity_u0(image, mask),
        uniformity_cv(image, mask),
        uniformity_min_max(image, mask),
        uniformity_nine_point(image, mask),
        gradient_nonuniformity(image if smooth is None else smooth, mask),
    )


def colour_balance(signal: ArrayLike, mask: Mask | None = None) -> float:
    """Mean of the brightest over that of the dimmest channel of a picture, shape (rows, columns, channels).

    Raises
    ------
    ValueError
        If a channel is dark.
    """
    means = _values(signal, mask).mean(axis=0)
    if means.min() <= 0:
        raise ValueError(f"signal: every channel must have light, one has a mean of {means.min():.3g}")
    return float(means.max() / means.min())


def saturated(signal: ArrayLike) -> Mask:
    """Pixels of which a channel reaches full scale, shape (rows, columns).

    Parameters
    ----------
    signal : array, shape (rows, columns, channels)
        Linear signal as a share of full scale, black level included.
    """
    return np.asarray((np.asarray(signal) >= 1.0).any(axis=-1))


def dynamic_range_use(signal: ArrayLike, mask: Mask | None = None) -> float:
    """99th percentile of the least exposed channel, as a share of full scale; parameters as `saturated`."""
    clipped = np.minimum(_values(signal, mask), 1.0)
    return float(np.percentile(clipped, RANGE_PERCENTILE, axis=0).min())


def coverage(x_mm: Array, y_mm: Array, seen: Mask, area: Mask) -> float:
    """Share of an area of the membrane that is seen.

    Parameters
    ----------
    x_mm, y_mm : array, shape (rows, columns)
        Membrane point of each pixel of a view that holds the whole area, whether the camera has it or not.
    seen : bool array, same shape
        Pixels that the camera has and that show the membrane.
    area : bool array, same shape
        Pixels whose membrane point lies in the area.
    """
    footprint = np.abs(
        np.gradient(x_mm, axis=1) * np.gradient(y_mm, axis=0)
        - np.gradient(x_mm, axis=0) * np.gradient(y_mm, axis=1)
    )
    inside = footprint * area
    return float(inside[seen].sum() / inside.sum())


def within(x_mm: Array, y_mm: Array, area_mm: tuple[float, float]) -> Mask:
    """Pixels whose membrane point lies in an area of this width and height around the origin."""
    width, height = area_mm
    return np.asarray((np.abs(x_mm) <= width / 2) & (np.abs(y_mm) <= height / 2))


def slant_deg(response: Array, signal: ArrayLike) -> Array:
    """Slant of the distant light with the same effect on a flat membrane: 0 from above, 90 grazing.

    Parameters
    ----------
    response : array, shape (..., 2)
        Change of signal per unit of slope along x and y, see `noise_limit.responses`.
    signal : array, shape (...)
        Signal of the untouched membrane.
    """
    return np.asarray(np.degrees(np.arctan2(np.linalg.norm(response, axis=-1), signal)))


def shadow_share(slant_deg: ArrayLike, *, slope_deg: float) -> Array:
    """Share of the directions into which a slope may face that leave it in attached shadow.

    A distant light at the slant s goes out for the slope a where cos(a) cos(s) + sin(a) sin(s) cos(azimuth)
    is negative: nowhere if a + s < 90 deg, else over acos(1 / (tan(a) tan(s))) / 180 deg of the azimuths.

    Parameters
    ----------
    slant_deg : array
        Slant of the light.
    slope_deg : float
        Steepness of the membrane, above 0 and below 90.
    """
    if not 0 < slope_deg < 90:
        raise ValueError(f"slope_deg: must be between 0 and 90 deg, got {slope_deg:g}")
    with np.errstate(divide="ignore"):
        limit = 1 / (np.tan(np.radians(slope_deg)) * np.tan(np.radians(np.asarray(slant_deg, dtype=float))))
    return np.asarray(np.arccos(np.clip(limit, -1.0, 1.0)) / np.pi)


def stray_share(stray: ArrayLike, image: ArrayLike, mask: Mask | None = None) -> float:
    """Share of a picture's light, shape (rows, columns), that does not come straight from the membrane."""
    return float(_values(stray, mask).sum() / _values(image, mask).sum())


def _values(image: ArrayLike, mask: Mask | None) -> Array:
    """Pixels of a mask, channels kept apart."""
    values = np.asarray(image, dtype=float)
    return values.reshape(-1, *values.shape[2:]) if mask is None else values[mask]
