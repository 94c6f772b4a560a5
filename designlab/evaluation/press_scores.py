"""Press scores say how well the shape of test presses is reconstructed; each has its standard error."""

from collections.abc import Sequence

import numpy as np

from designlab.core.metrics import rgb_to_normal
from designlab.core.types import Array
from designlab.evaluation.illumination import saturated
from designlab.evaluation.illumination_scores import SCORES, Estimate, Scores
from designlab.evaluation.press_plan import TEST_PROBES
from designlab.evaluation.protocol import EvaluationProtocol, Reconstruction
from designlab.evaluation.response_maps import signal_of, thinned
from designlab.mechanics.contact import FORCE_TOLERANCE
from designlab.reconstruction import normals
from designlab.simulation.simulator import Frame
from geometries.elastomer import base_gradient

WITHIN_DEG = 5.0
PRESS_FIGURES = (
    "normal_error_median_deg",
    "normal_error_mean_deg",
    "height_mae_um",
    "height_mse_um2",
    "normals_within_5deg",
    "press_saturation_share",
    "rgb2normal",
)
"""Of each test press, on the contact and around it: what the scores are pooled from."""
TYPICAL = np.array(
    [  # median, mean, MAE, MSE, beyond 5 deg, saturated, RGB2Normal short of 1
        (0.90, 0.80, 0.72, 0.40, 0.43, 1.0, 0.30),  # sphere
        (1.24, 1.25, 1.47, 1.68, 1.15, 1.0, 0.64),  # triangle
        (1.36, 1.53, 1.75, 2.51, 2.45, 1.0, 0.68),  # star
        (1.05, 0.92, 1.09, 0.97, 0.72, 1.0, 0.40),  # cylinder
        (0.54, 0.58, 0.32, 0.09, 0.33, 1.0, 0.83),  # cone
        (0.91, 0.92, 0.65, 0.35, 0.92, 1.0, 3.16),  # dots
    ]
)
"""How hard each of the six test probes is, relative to their mean: geometric means over random designs, see
``benchmarks/information_ranking.py``. How many pixels saturate depends on the design alone."""

NOISE_LEFT = 0.5
"""Share of what render noise adds that may be left of it, or taken off too much, see
``benchmarks/render_noise.py``."""


def reconstruction_scores(
    protocol: EvaluationProtocol,
    untouched: Frame,
    background: Array,
    results: Sequence[Reconstruction],
    noisier: Sequence[Sequence[Reconstruction]],
) -> tuple[Scores, dict[str, list[float]]]:
    """Errors of the test presses, pooled, and `PRESS_FIGURES` of each.

    Parameters
    ----------
    protocol : EvaluationProtocol
        The protocol that reconstructed them.
    untouched : Frame
        The untouched gel.
    background : array, shape (rows, columns, channels)
        Its picture, as the calibration has it.
    results : sequence of Reconstruction
        The presses.
    noisier : sequence of sequence of Reconstruction
        `noisier_presses` of them with twice the variance of render noise, one or several times. What is added
        to a score then, render noise has added as well: it is taken off.
    """
    base = normals(*base_gradient(protocol.design.elastomer, *untouched.seen_mm))
    each = _errors(protocol, results, background, base)
    value, once = pooled(each), pooled(each[noisier_presses(len(each))])
    again = [pooled(_errors(protocol, half, background, base)) for half in noisier]
    chances = press_chances(each)
    estimates = {}
    for name in value:
        if not np.isfinite(value[name]):
            continue
        unit = SCORES[name]
        choice = float(np.linalg.norm(chances[name]))
        added = float(np.mean([half[name] for half in again])) - once[name]
        added = added if np.isfinite(added) else 0.0
        freed = float(np.clip(value[name] - added, 0.0, 1.0 if unit == "1" else np.inf))
        left = NOISE_LEFT * abs(added)
        estimates[name] = Estimate(freed, float(np.hypot(choice, left)), unit, left)
    if any(result.frame.surface.bulges for result in results):
        estimates["height_mae_moved_um"] = _moved_error(results)
    return estimates, dict(zip(PRESS_FIGURES, each.T.tolist(), strict=True))


def mean_depth(depths_mm: Sequence[float]) -> Estimate:
    """How deep presses of equal force went in the mean (mm), beside which their heights are to be read."""
    mean = float(np.mean(depths_mm))
    return Estimate(mean, FORCE_TOLERANCE * mean, SCORES["press_depth_mm"])


def _moved_error(results: Sequence[Reconstruction]) -> Estimate:
    """Error of height over all gel that is raised or lowered; kinds of probes count as chance."""
    each = [
        float(1000 * np.abs(one.height_mm - one.frame.height_mm)[one.moved].mean())
        for one in results
        if one.moved.any()
    ]
    return Estimate(float(np.mean(each)), float(np.std(each, ddof=1) / np.sqrt(len(each))), "um")


def noisier_presses(count: int) -> list[int]:
    """Which test presses are seen with more render noise too: every other, of two rounds each probe once."""
    return [k for k in range(count) if (k + k // len(TEST_PROBES)) % 2 == 0]


def _errors(
    protocol: EvaluationProtocol, results: Sequence[Reconstruction], background: Array, base: Array
) -> Array:
    """`PRESS_FIGURES` of each press, shape (presses, figures)."""
    rows = []
    for result in results:
        thin = thinned(result.frame)
        angle, height = result.error_deg[result.region], result.height_error_um
        rows.append(
            (
                np.median(angle),
                angle.mean(),
                np.abs(height).mean(),
                np.mean(height**2),
                (angle < WITHIN_DEG).mean(),
                saturated(signal_of(protocol, result.frame, thin))[result.region[thin]].mean(),
                rgb_to_normal(result.image[thin], background[thin], result.true_normals[thin], base[thin]),
            )
        )
    return np.array(rows)


def pooled(errors: Array) -> dict[str, float]:
    """Scores from `PRESS_FIGURES` of presses, shape (presses, figures): each press counts the same."""
    median, mean, absolute, square, close, full = (float(value) for value in errors[:, :-1].mean(axis=0))
    follows = errors[:, -1][np.isfinite(errors[:, -1])]
    return {
        "normal_error_median_deg": median,
        "normal_error_mean_deg": mean,
        "height_mae_um": absolute,
        "height_rmse_um": float(np.sqrt(square)),
        "normals_within_5deg": close,
        "rgb2normal": float(follows.mean()) if len(follows) else float("nan"),
        "press_saturation_share": full,
    }


def press_chances(errors: Array) -> dict[str, Array]:
    """What chance put into each score, press by press; the norm is the score's standard error.

    Chance is the place, the angle and the noise of a press. That a star is harder than a ball is none: the
    six probes are the same for every design and seed. With several rounds of them it shows as the scatter of
    each probe about its mean. With one round it is told from the misfit to `TYPICAL`, up to a common factor.

    Parameters
    ----------
    errors : array, shape (presses, figures)
        `PRESS_FIGURES` of whole rounds of the six test probes.
    """
    rounds, rest = divmod(len(errors), len(TEST_PROBES))
    if rest or not rounds:
        raise ValueError(f"errors: must hold whole rounds of {len(TEST_PROBES)} presses, got {len(errors)}")
    falling = [PRESS_FIGURES.index(name) for name in ("normals_within_5deg", "rgb2normal")]
    amiss = errors.copy()
    amiss[:, falling] = 1 - amiss[:, falling]
    if rounds > 1:
        kinds = amiss.reshape(rounds, *TYPICAL.shape)
        left = (kinds - np.nanmean(kinds, axis=0)).reshape(amiss.shape) * np.sqrt(rounds / (rounds - 1))
    else:
        left = amiss - np.nanmean(amiss / TYPICAL, axis=0) * TYPICAL
        left *= np.sqrt(len(left) / (len(left) - 1))
    left = np.where(np.isfinite(left), left, 0.0) / np.maximum(np.isfinite(errors).sum(axis=0), 1)
    found = dict(zip(PRESS_FIGURES, left.T, strict=True))
    found["height_rmse_um"] = found.pop("height_mse_um2") / (2 * max(pooled(errors)["height_rmse_um"], 1e-9))
    return found
