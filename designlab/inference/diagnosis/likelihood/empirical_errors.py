"""Empirical errors, learnt from generated sets with known answers, say how far to trust values and names.

A fit knows noise and the errors that are granted to the simulation. What no catalogue lists pulls values too,
in the same way in all frames, and by how much only sets with known answers tell.
"""

import json
import math
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.special import chdtri

from designlab.core.types import Array

BY_CHANCE = 0.0027  # of three standard deviations
FILE = "empirical_errors.json"
"""Of ``designlab gap benchmark --pool calibration``; ``benchmarks/confidence.py`` adds opened pools,
``benchmarks/dirt_sizes.py`` what dirt looks like."""


def unlisted_sd(effect: str, parameter: str, *, shape: bool, dirty: bool = False) -> float:
    """Standard deviation of what the unlisted does to a fitted value, in prior standard deviations.

    Parameters
    ----------
    effect, parameter : str
        Names; an effect that was never seen has the median of all.
    shape : bool
        Whether the parameter only says how another acts: such have values of their own, all others of an
        effect share one.
    dirty : bool
        Whether the sensor has a lab's dirt.
    """
    spreads: dict[str, float] = known()["unlisted_sd"]
    shared = spreads.get(effect, sorted(spreads.values())[len(spreads) // 2])
    if shape:
        return spreads.get(f"{effect}.{parameter}", shared)
    return math.hypot(shared, dirt_sd(effect)) if dirty else shared


def dirt_sd(effect: str) -> float:
    """Value that a lab's dirt gives to an effect that is not there, in prior standard deviations.

    0 of effects of which it is not known.
    """
    return float(known()["dirt_sd"].get(effect, 0.0))


def dirt_looks_like(effect: str) -> bool:
    """Whether a lab's dirt ever made an effect promising that was not there."""
    return effect in known()["like_dirt"]


def surely_beyond_dirt(effect: str, parameters: int) -> float:
    """Distance from null from which an effect is surely larger than what dirt makes of it.

    Prior standard deviations, three standard deviations of chance, a fit without errors; 0 of effects that
    dirt does not look like.

    Parameters
    ----------
    effect : str
        Its name.
    parameters : int
        How many it has that do not only shape it.
    """
    return dirt_looks_like(effect) * dirt_sd(effect) * math.sqrt(chdtri(parameters, BY_CHANCE))


def over_dirt(away: Array, information: Array, size: float) -> float:
    """How far fitted values are from null, over what chance and dirt may do; surely beyond above 1 (Wald).

    Parameters
    ----------
    away : array, shape (n,)
        Values less their nulls, in prior standard deviations.
    information : array, shape (n, n)
        What the shots tell of them.
    size : float
        What dirt makes of them, see `dirt_sd`.
    """
    eye = np.eye(len(away))
    covariance = np.linalg.inv(information + eye) + size**2 * eye
    return float(away @ np.linalg.solve(covariance, away) / chdtri(len(away), BY_CHANCE))


def shares_right() -> tuple[dict[str, float], list[float], list[float]]:
    """Weights of the signs of a name, and along their weighted sum the share of names that were right."""
    found = known()["confidence"]
    return found["weights"], found["scores"], found["right"]


@cache
def known() -> Mapping[str, Any]:
    """All of it, by the names of what is learnt."""
    content: Mapping[str, Any] = json.loads(
        files("designlab.inference.diagnosis.likelihood").joinpath(FILE).read_text(encoding="utf-8")
    )
    return content
