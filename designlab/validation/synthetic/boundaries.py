"""Clear boundaries follow Fresnel's and Snell's laws, for arrays of NumPy and of the rendering engine."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

MOST = 0.999999  # share of light that a gap of air sends to and fro


class Functions(NamedTuple):
    """Functions that differ between libraries of arrays: choice by a mask, and a root that is 0 below 0."""

    where: Callable[..., Any]
    root: Callable[[Any], Any]


NUMPY = Functions(np.where, lambda values: np.sqrt(np.maximum(values, 0.0)))


def reflectance(cosine: Any, index: Any, other: Any, functions: Functions = NUMPY) -> Any:
    """Fresnel's reflectance for unpolarised light that meets a medium `other` at a cosine; 1 if total."""
    where, root = functions
    sine2 = (index / other) * (index / other) * (1.0 - cosine * cosine)
    onward = root(1.0 - sine2)
    with np.errstate(invalid="ignore", divide="ignore"):
        across = (index * cosine - other * onward) / (index * cosine + other * onward)
        along = (other * cosine - index * onward) / (other * cosine + index * onward)
    return where(sine2 >= 1.0, 1.0, 0.5 * (across * across + along * along))


def gap_transmission(
    cosine: Any, index: Any, sides: tuple[float, float], functions: Functions = NUMPY
) -> Any:
    """Share of power through a plane gap of air, thick against the wave: all reflections in it, no phases.

    Parameters
    ----------
    cosine, index : array or float
        Cosine at which light meets the gap, and index of the medium that it comes from.
    sides : tuple of float
        Indices of the media on both sides.
    """
    where, root = functions
    inner = root(1.0 - index * index * (1.0 - cosine * cosine))
    first, second = (reflectance(inner, 1.0, side, functions) for side in sides)
    returned = first * second
    passed = (1.0 - first) * (1.0 - second) / (1.0 - where(returned < MOST, returned, MOST))
    return where(inner > 0, passed, 0.0)


def refracted(direction: Any, normal: Any, cosine: Any, ratio: Any, functions: Functions = NUMPY) -> Any:
    """Directions beyond a boundary, Snell's law in Heckbert's form.

    Parameters
    ----------
    direction, normal : array of vectors
        Unit vectors; normals point against the directions.
    cosine, ratio : array or float
        Cosine between the two, and index over index beyond.
    """
    onward = functions.root(1.0 - ratio * ratio * (1.0 - cosine * cosine))
    return ratio * direction + (ratio * cosine - onward) * normal
