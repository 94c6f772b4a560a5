"""The weakest point is the worst place of a sensor; stated rules tell from maps why it is bad.

On the untouched gel the worst place is, in this order,

1. the middle of what the camera does not see, if that is more than 1 % of the sensing area: *out of view*;
2. the middle of what reaches full scale, if that is more than 0.1 % of it: *saturated*;
3. where the information limit, averaged over half a millimetre, is greatest.

In the last case the limit is the product of three factors: how uncertain the slopes would be if every
channel's noise were as large as its signal from the membrane (*flat response*), how much stray light lies
over that signal (*stray light*), and how noisy the signal is (*dark*). The one that stands out most from its
median over the sensing area is the reason; but where one LED group gives less than 15 % of its own mean, and
less than 40 % of what the next dimmest gives of its, it is *shadowed*. Below 1.25 times the median no place
stands out: *even*.

Of the test presses it is where the normal error, averaged over half a millimetre, is greatest. There the
reason is the first of these that holds: *saturated*, more than a tenth of the pixels; *out of view*, a wall
that turns away from the camera; *shadowed*, a group gives less than a fifth of what it gives the untouched
gel; *steep*, more than a third of the pixels steeper than 99 % of the flanks of the calibration balls; the
reason of the untouched gel, if the limit is above 1.5 times its median; *calibration*, none of these.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from designlab.core.types import Array, Mask
from designlab.evaluation.noise_limit import noise_limit_deg

LEAST_UNSEEN, LEAST_SATURATED = 0.01, 0.001  # shares of the sensing area
PLACE_MM = 0.5  # over which a place is averaged
STANDS_OUT = 1.25  # times the median
GROUP_MISSING, GROUP_BEHIND = 0.15, 0.4
PRESS_SATURATED, PRESS_SHADOWED, PRESS_STEEP, PRESS_LIMIT = 0.1, 0.2, 1 / 3, 1.5
GRAZING = 0.1  # cosine between a wall and the way to the camera below which it hides


class Place(NamedTuple):
    """A place on the membrane, the reason why it is the worst, and how bad it is.

    Parameters
    ----------
    x_mm, y_mm : float
        Where.
    reason : str
        See the module.
    value_deg : float
        Information limit or normal error there.
    times : float
        The same over its median; over the contacts, for presses.
    detail : str
        The LED group, or the probe.
    press : int, optional
        Number of the test press.
    """

    x_mm: float
    y_mm: float
    reason: str
    value_deg: float
    times: float
    detail: str = ""
    press: int | None = None


@dataclass(frozen=True, eq=False)
class GelMaps:
    """What the untouched gel looks like, pixel by pixel; arrays of shape (rows, columns, ...).

    Attributes
    ----------
    x_mm, y_mm : array
        Membrane points.
    area, seen, saturated : bool array
        The sensing area; what the camera sees; where its picture reaches full scale.
    light : array, shape (rows, columns, groups)
        Light of each LED group over its mean.
    signal : array, shape (rows, columns, channels)
        Share of full scale above the black level.
    stray : array, shape (rows, columns, channels)
        Part of it that does not come straight from the membrane.
    sigma : array, shape (rows, columns, channels)
        Standard deviation of the camera's noise.
    response : array, shape (rows, columns, channels, 2)
        Change of signal per unit of slope.
    """

    x_mm: Array
    y_mm: Array
    area: Mask
    seen: Mask
    saturated: Mask
    light: Array
    signal: Array
    stray: Array
    sigma: Array
    response: Array

    @property
    def limit_deg(self) -> Array:
        """Information limit, 90 deg where there is no picture to tell a slope from."""
        limit = noise_limit_deg(self.response, self.sigma)
        return np.asarray(np.where(self.seen & ~self.saturated, limit, 90.0))

    @property
    def pitch_mm(self) -> float:
        """Distance of neighbouring pixels."""
        return float(np.median(np.diff(self.x_mm, axis=1)))

    def factors(self) -> dict[str, Array]:
        """What the limit is the product of, each over its median in the sensing area."""
        membrane = np.maximum(self.signal - self.stray, 1e-12)
        geometry = noise_limit_deg(self.response, membrane)
        veiled = noise_limit_deg(self.response, np.maximum(self.signal, 1e-12))
        limit = noise_limit_deg(self.response, self.sigma)
        parts = {"flat response": geometry, "stray light": veiled / geometry, "dark": limit / veiled}
        inside = self.area & self.seen
        return {name: part / np.median(part[inside]) for name, part in parts.items()}


class PressMaps(NamedTuple):
    """One test press, pixel by pixel; arrays of shape (rows, columns, ...).

    Parameters
    ----------
    error_deg : array
        Normal error.
    region : bool array
        Where it counts.
    saturated : bool array
        Pixels at full scale.
    light : array, shape (rows, columns, groups)
        Light of each group over that on the untouched gel.
    slope : array
        True steepness of the indentation.
    facing : array
        Cosine between the true normal and the way to the camera.
    name : str
        The probe.
    """

    error_deg: Array
    region: Mask
    saturated: Mask
    light: Array
    slope: Array
    facing: Array
    name: str


def worst_of_gel(maps: GelMaps, group_names: Sequence[str]) -> Place:
    """Worst place of the untouched gel, see the module."""
    limit, inside = maps.limit_deg, maps.area & maps.seen
    if not inside.any():
        raise ValueError("seen: the camera must see some of the sensing area")
    median = float(np.median(limit[inside]))

    def place(at: tuple[int, int], reason: str, value: float, detail: str = "") -> Place:
        return Place(
            float(maps.x_mm[at]), float(maps.y_mm[at]), reason, value, value / median, detail
        )  # fmt: skip

    for bad, least, reason in (
        (maps.area & ~maps.seen, LEAST_UNSEEN, "out of view"),
        (maps.area & maps.saturated, LEAST_SATURATED, "saturated"),
    ):
        if bad.sum() > least * maps.area.sum():
            return place(_middle(bad), reason, 90.0)
    smooth = averaged(limit, inside, PLACE_MM / maps.pitch_mm)
    at = _greatest(smooth, inside)
    value = float(smooth[at])
    if value < STANDS_OUT * median:
        return place(at, "even", value)
    reason, detail = _reason(maps, at, group_names)
    return place(at, reason, value, detail)


def worst_of_presses(
    presses: Sequence[PressMaps], maps: GelMaps, group_names: Sequence[str], *, steepest: float
) -> Place:
    """Worst place of the test presses, see the module.

    Parameters
    ----------
    presses : sequence of PressMaps
        On the pixels of `maps`.
    maps : GelMaps
        The untouched gel.
    group_names : sequence of str
        Names of the LED groups.
    steepest : float
        Slope that 99 % of the flanks of the calibration balls do not exceed.
    """
    sigma = PLACE_MM / maps.pitch_mm
    found = []
    for number, press in enumerate(presses):
        smooth = averaged(press.error_deg, press.region, sigma)
        at = _greatest(smooth, press.region)
        found.append((float(smooth[at]), number, at))
    value, number, at = max(found)
    press = presses[number]
    rows, columns = np.indices(press.region.shape)
    near = press.region & (np.hypot(rows - at[0], columns - at[1]) <= max(sigma, 1.0))
    reason, detail = _press_reason(press, near, maps, at, group_names, steepest)
    typical = float(np.median(np.concatenate([p.error_deg[p.region] for p in presses])))
    return Place(
        float(maps.x_mm[at]), float(maps.y_mm[at]), reason, value, value / typical,
        ", ".join(part for part in (press.name, detail) if part), number,
    )  # fmt: skip


def averaged(values: Array, inside: Mask, sigma_px: float) -> Array:
    """Mean of the values inside a mask, weighted by a Gaussian; 0 outside."""
    weight = gaussian_filter(inside.astype(float), sigma_px, mode="constant")
    total = gaussian_filter(np.where(inside, values, 0.0), sigma_px, mode="constant")
    return np.asarray(np.where(inside, total / np.maximum(weight, 1e-12), 0.0))


def _press_reason(
    press: PressMaps, near: Mask, maps: GelMaps, at: tuple[int, int], names: Sequence[str], steepest: float
) -> tuple[str, str]:
    light = press.light[near].mean(axis=0)
    if press.saturated[near].mean() > PRESS_SATURATED:
        return "saturated", ""
    if press.facing[near].min() < GRAZING:
        return "out of view", ""
    if light.min() < PRESS_SHADOWED:
        return "shadowed", names[int(light.argmin())]
    if (press.slope[near] > steepest).mean() > PRESS_STEEP:
        return "steep", ""
    limit = maps.limit_deg
    if limit[near].mean() > PRESS_LIMIT * np.median(limit[maps.area & maps.seen]):
        return _reason(maps, at, names)
    return "calibration", ""


def _reason(maps: GelMaps, at: tuple[int, int], names: Sequence[str]) -> tuple[str, str]:
    """The factor that stands out most at a pixel, and the LED group that is missing, if one is."""
    factors = {name: float(part[at]) for name, part in maps.factors().items()}
    reason = max(factors, key=lambda name: factors[name])
    light = maps.light[at]
    if len(light) > 1:
        missing = int(light.argmin())
        others = np.delete(light, missing)
        if light[missing] < GROUP_MISSING and light[missing] < GROUP_BEHIND * others.min():
            return "shadowed", names[missing]
    return reason, ""


def _middle(bad: Mask) -> tuple[int, int]:
    """Pixel of a mask that is furthest from its edge."""
    inner = distance_transform_edt(np.pad(bad, 1))[1:-1, 1:-1]
    return _greatest(np.asarray(inner), bad)


def _greatest(values: Array, inside: Mask) -> tuple[int, int]:
    found: Any = np.unravel_index(np.argmax(np.where(inside, values, -np.inf)), values.shape)
    return int(found[0]), int(found[1])
