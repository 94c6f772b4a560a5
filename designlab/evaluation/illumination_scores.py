"""Illumination scores are those of the untouched gel; each has its standard error."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter, uniform_filter

from designlab.core.metrics import uniformity_cv, uniformity_u0
from designlab.core.types import Array, Mask
from designlab.evaluation import illumination
from designlab.evaluation.illumination import Evenness, evenness, saturated
from designlab.evaluation.noise_limit import noise_limit_deg, pressed_limit_deg
from designlab.evaluation.protocol import SMOOTHING_PX, EvaluationProtocol, each_of, sub_seed
from designlab.evaluation.response_maps import (
    Responses,
    counted_at,
    drawn,
    membrane_light,
    seen,
    sensing_area,
    step_of,
    thinned,
)
from designlab.evaluation.weakest_point import GelMaps
from designlab.sensor.design import Design
from designlab.simulation.imaging import Capture, expected, noise_sigma
from designlab.simulation.simulator import GRAIN_PX, Frame, automatic_exposure, metered

UNIFORMITY_DRAWS, DETAIL_DRAWS = 30, 10
SCORES = {
    "uniformity_u0": "1",
    "uniformity_cv": "1",
    "normal_error_median_deg": "deg",
    "normal_error_mean_deg": "deg",
    "height_mae_um": "um",
    "height_rmse_um": "um",
    "height_mae_moved_um": "um",
    "information_deg": "deg",
    "information_flat_deg": "deg",
    "slant_deg": "deg",
    "shadow_share_30deg": "1",
    "uniformity_min_max": "1",
    "uniformity_nine_point": "1",
    "uniformity_gradient": "1",
    "combined_u0": "1",
    "combined_cv": "1",
    "combined_min_max": "1",
    "combined_nine_point": "1",
    "combined_gradient": "1",
    "colour_balance": "1",
    "dynamic_range_use": "1",
    "coverage": "1",
    "saturation_share": "1",
    "stray_share": "1",
    "normals_within_5deg": "1",
    "rgb2normal": "1",
    "press_saturation_share": "1",
    "press_depth_mm": "mm",
    "force_at_depth_n": "N",
    "depth_at_force_mm": "mm",
    "force_resolution_mn": "mN",
    "saturation_depth_mm": "mm",
    "lateral_resolution_mm": "mm",
}
"""Every score of an evaluation, and its unit."""

COARSER = 2  # most figures are those of pixels of so many `thinned` ones along each side
NOISE_REACH_SHARE = 0.04  # of a picture's width, over which the power of noise is alike
GRADIENT_MM = 0.5  # over which gradients are smoothed: render noise is steep
SLOPE_DEG = 30.0  # at which attached shadows are counted
LIMIT_STEP = 4  # between the `thinned` pixels at which the pressed membrane's limit is looked at


@dataclass(frozen=True)
class Estimate:
    """A score with its standard error, both in `unit`.

    `bias_bound` is how much of the standard error is systematic; None where no bias is known.
    """

    value: float
    se: float
    unit: str
    bias_bound: float | None = None

    def __str__(self) -> str:
        """Value, standard error and unit for people."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.value:.4g} ± {self.se:.2g}{unit}"


Scores = dict[str, Estimate]


class TransportError(NamedTuple):
    """How far the light of a picture may be off, relative to its mean; of the worst LED group.

    Parameters
    ----------
    noise : float
        Standard error of blocks of 1 mm x 1 mm of the untouched gel.
    bias_mean, bias_block : float
        Systematic error of the mean and of small blocks, the largest seen, see `render.estimators.Bias`.
    """

    noise: float
    bias_mean: float
    bias_block: float

    def __str__(self) -> str:
        """Sentence for people."""
        noise = f"light on the untouched gel: random error {self.noise:.1%} of each mm2"
        if not self.bias_block:
            return f"{noise}, no bias"
        return (
            f"{noise}; bias, the largest of random designs: {self.bias_mean:.1%} of the mean, "
            f"{self.bias_block:.0%} of 8 x 8 of 160 columns"
        )


def transport_error(design: Design, a: Frame, b: Frame) -> TransportError:
    """Noise of the mean of two independent renders of the untouched gel, and the bound of their bias."""
    mask = sensing_area(design, a)
    size = max(1, round(1.0 / float(a.rays.pitch_mm[0])))
    noise = []
    for one, other in zip(a.basis, b.basis, strict=True):
        blocks = uniform_filter((one - other) / 2, size, mode="nearest")
        noise.append(float(np.sqrt(np.mean(blocks[mask] ** 2)) / (one + other)[mask].mean() * 2))
    return TransportError(max(noise), *a.bias)


def uniformity(design: Design, a: Frame, b: Frame, seed: int) -> Scores:
    """U0 and coefficient of variation of the worst LED group."""
    mask, pair, step = _coarse(design, a, b, coarser=1)  # the darkest hundredth needs many pixels
    sigma_px = SMOOTHING_PX / step
    found = _over_draws(lambda basis: worst_evenness(basis, mask, sigma_px), pair, seed, UNIFORMITY_DRAWS)
    return _estimates(("uniformity_u0", "uniformity_cv"), *found)


def worst_evenness(
    basis: NDArray[np.floating], mask: Mask, sigma_px: float = SMOOTHING_PX
) -> tuple[float, float]:
    """U0 and coefficient of variation of the worst group."""
    smooth = _smoothed(basis, sigma_px)
    return min(uniformity_u0(i, mask) for i in smooth), max(uniformity_cv(i, mask) for i in smooth)


def evenness_scores(
    design: Design, a: Frame, b: Frame, seed: int
) -> tuple[Scores, dict[str, dict[str, Estimate]]]:
    """Evenness of the worst LED group and of the sum of the camera's channels; and that of each group."""
    names = [*design.group_names, "combined"]
    total = a.weights.sum(axis=0)
    mask, pair, step = _coarse(design, a, b)
    pitch_mm = step * a.rays.pitch_mm[0]

    def figures(basis: NDArray[np.floating]) -> Array:
        smooth = _smoothed(basis, SMOOTHING_PX / step)
        images = [*smooth, np.einsum("g,grk->rk", total, smooth)]
        blurred = _smoothed(np.array(images), GRADIENT_MM / pitch_mm)
        pairs = zip(images, blurred, strict=True)
        return np.array([evenness(image, mask, smooth=blur) for image, blur in pairs])

    values, errors = _over_draws(figures, pair, seed, DETAIL_DRAWS)
    each = {
        name: _estimates(Evenness._fields, value, error)
        for name, value, error in zip(names, values, errors, strict=True)
    }
    combined = each.pop("combined")
    groups = list(each.values())
    scores = {
        "uniformity_min_max": min((g["min_max"] for g in groups), key=lambda e: e.value),
        "uniformity_nine_point": min((g["nine_point"] for g in groups), key=lambda e: e.value),
        "uniformity_gradient": max((g["gradient"] for g in groups), key=lambda e: e.value),
    } | {f"combined_{figure}": estimate for figure, estimate in combined.items()}
    return scores, each


def _estimates(names: Sequence[str], values: ArrayLike, errors: ArrayLike) -> Scores:
    """Scores in their units; figures that are no scores have none."""
    found = zip(names, np.asarray(values), np.asarray(errors), strict=True)
    return {name: Estimate(float(value), float(error), SCORES.get(name, "1")) for name, value, error in found}


class _Pair(NamedTuple):
    """Two independent renders."""

    one: NDArray[np.float32]
    other: NDArray[np.float32]


def _coarse(
    design: Design, a: Frame, b: Frame, *, coarser: int = COARSER, stray: bool = False
) -> tuple[Mask, _Pair, int]:
    """Where scores count, two frames in pixels as coarse as their noise is, and how many pixels make one.

    If asked for, their stray light follows behind the groups, where they know it.
    """
    step = coarser * step_of(a)
    images = (
        np.concatenate([f.basis, f.stray]) if stray and f.stray is not None else f.basis for f in (a, b)
    )
    return sensing_area(design, a)[::step, ::step], _Pair(*(_binned(i, step) for i in images)), step


def _over_draws(
    figures: Callable[[NDArray[np.floating]], ArrayLike], pair: _Pair, seed: int, count: int
) -> tuple[Array, Array]:
    """Figures of the mean of two independent renders, and their errors from the difference of the two.

    Noise passes for unevenness in proportion to its variance, of which each render has twice that of their
    mean; the difference of the two is taken off.
    """

    def freed(mean: NDArray[np.floating], noise: NDArray[np.floating]) -> Array:
        single = np.mean(np.array([figures(mean + noise), figures(mean - noise)]), axis=0)
        return np.asarray(2 * np.array(figures(mean)) - single)

    # Mean and half difference carry the same noise, each with a draw of its own.
    mean, noise = (pair.one + pair.other) / 2, (pair.one - pair.other) / 2
    power = _smoothed(noise**2, NOISE_REACH_SHARE * noise.shape[2])
    random = np.random.default_rng(sub_seed(seed, 7, 0))
    others = [[drawn(noise, power, random, images=(0,)) for _ in "ab"] for _ in range(count)]
    draws = each_of(lambda k: freed(mean + others[k][0], others[k][1]), count)
    return freed(mean, noise), np.std(draws, axis=0, ddof=1)


def _smoothed(basis: NDArray[np.floating], sigma_px: float) -> NDArray[np.floating]:
    return np.asarray(gaussian_filter(basis, (0, sigma_px, sigma_px), mode="nearest"))


def _binned(basis: NDArray[np.float32], step: int) -> NDArray[np.float32]:
    """Means over blocks of pixels that start where `thinned` pixels lie."""
    groups, rows, columns = basis.shape
    short = (-rows) % step, (-columns) % step
    whole = np.pad(basis, ((0, 0), (0, short[0]), (0, short[1])), mode="edge")
    blocks = whole.reshape(groups, whole.shape[1] // step, step, whole.shape[2] // step, step)
    return np.asarray(blocks.mean(axis=(2, 4)), dtype=np.float32)


def exposure_scores(protocol: EvaluationProtocol, a: Frame, b: Frame) -> tuple[Scores, float]:
    """How the untouched gel fills the camera's range, colours balance, light is stray, the area is seen.

    With it the relative error that render noise puts into the automatic exposure.
    """
    design, groups = protocol.design, len(a.basis)
    mask, pair, step = _coarse(design, a, b, stray=True)
    names = ["colour_balance", "dynamic_range_use", "saturation_share", "stray_share"]
    automatic = design.fixed_exposure is None
    meter = metered(design, a)
    meter = None if meter is None else meter[::step, ::step]

    def figures(images: NDArray[np.floating]) -> list[float]:
        basis, stray = images[:groups], images[groups:]
        mixed = np.einsum("cg,grk->rkc", a.weights, basis)
        scale = (
            automatic_exposure(mixed, grain_px=GRAIN_PX / step, within=meter)
            if automatic
            else protocol.exposure
        )
        signal = expected(mixed, replace(protocol.capture(), exposure=scale))
        found = [
            scale,
            illumination.colour_balance(mixed, mask),
            illumination.dynamic_range_use(signal, mask),
            float(saturated(signal)[mask].mean()),
        ]
        shares = [illumination.stray_share(s, i, mask) for s, i in zip(stray, basis, strict=False)]
        return [*found, max(shares)] if shares else found

    (scale, *values), (scale_error, *errors) = _over_draws(figures, pair, protocol.seed, DETAIL_DRAWS)
    both = _estimates(names[: len(values)], np.maximum(values, 0.0), errors)
    covered = illumination.coverage(*counted_at(design, a), seen(design, a), sensing_area(design, a))
    return both | {"coverage": Estimate(covered, 0.0, "1")}, float(scale_error / scale)


def slant_scores(
    design: Design, untouched: Frame, responses: Responses
) -> tuple[Scores, dict[str, dict[str, Estimate]]]:
    """Slant and attached shadows of the worst LED group, and of each.

    Parameters
    ----------
    design : Design
        The sensor.
    untouched : Frame
        The untouched gel.
    responses : Responses
        What `slope_responses` gave.
    """
    thin = thinned(untouched)
    mask = sensing_area(design, untouched)[thin]
    membrane = membrane_light(untouched)[thin][mask]

    def of(response: Array) -> list[Array]:
        slant = illumination.slant_deg(response[mask], membrane)
        return [np.median(slant, axis=0), illumination.shadow_share(slant, slope_deg=SLOPE_DEG).mean(axis=0)]

    values, errors = responses.figures(of)
    each = {
        name: _estimates(("slant_deg", "shadow_share_30deg"), values[:, g], errors[:, g])
        for g, name in enumerate(design.group_names)
    }
    scores = {
        "slant_deg": min((g["slant_deg"] for g in each.values()), key=lambda e: e.value),
        "shadow_share_30deg": max((g["shadow_share_30deg"] for g in each.values()), key=lambda e: e.value),
    }
    return scores, each


def information_score(
    protocol: EvaluationProtocol, untouched: Frame, gel: GelMaps, responses: Responses, exposure_error: float
) -> Scores:
    """Noise limits of the flat and of the pressed membrane, median over the sensing area.

    Parameters
    ----------
    protocol, untouched, gel, responses
        Camera, untouched gel, its maps, and its responses to slope.
    exposure_error : float
        Relative error of the exposure, which the signals share.
    """
    camera = protocol.design.camera
    binned = max(untouched.rays.binned, 1.0)
    some = np.zeros_like(gel.area)
    some[::LIMIT_STEP, ::LIMIT_STEP] = True
    some &= gel.area
    light = membrane_light(untouched)[thinned(untouched)]

    def sigma(signal: Array) -> Array:
        collected = np.minimum(signal, 1.0 - camera.black_level)
        noise = noise_sigma(collected, Capture(camera, binned=binned))
        return np.where(signal + camera.black_level < 1.0, noise, np.inf)

    def of(response: Array, brighter: float = 1.0) -> Array:
        mix = brighter * protocol.exposure * untouched.weights
        seen = sigma(light[gel.area] @ mix.T)
        flat = noise_limit_deg(np.tensordot(response[gel.area], mix, axes=(1, 1)).swapaxes(1, 2), seen)
        pressed = pressed_limit_deg(light[some], response[some], mix, sigma, steepest_deg=SLOPE_DEG)
        return np.array([np.median(flat), np.median(pressed)])

    values, errors = responses.figures(of)
    errors = np.hypot(errors, of(responses.best, 1 + exposure_error) - values)
    return _estimates(("information_flat_deg", "information_deg"), values, errors)


def merged(*parts: Mapping[str, Mapping[str, Estimate]]) -> dict[str, dict[str, Estimate]]:
    """Figures of each LED group, from several tables of them."""
    return {name: {k: v for part in parts for k, v in part[name].items()} for name in parts[0]}
