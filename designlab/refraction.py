"""Snell's law at plane layers between the membrane and the camera."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Layers = Sequence[tuple[float, float]]
"""Thickness (mm) and refractive index of each layer, the camera's last."""


def crossing_mm(
    tangent: NDArray[np.float64], layers: Layers
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Follow rays that leave the camera at an angle to the layers' normal back through all of them.

    Parameters
    ----------
    tangent : array
        Tangent of the angle in the last layer.
    layers : sequence of (thickness in mm, index)
        Plane layers, the camera's last.

    Returns
    -------
    lateral_mm, slope : array
        Sideways distance travelled and tangent of the angle in the first layer, both over `tangent`: these
        ratios have a limit on the axis, where distance and tangent vanish.
    """
    cosine = 1.0 / np.sqrt(1.0 + tangent**2)
    # n sin(theta) is the same in every layer, so n cos(theta) = sqrt(n^2 - invariant^2).
    invariant = layers[-1][1] * tangent * cosine
    ratios = [layers[-1][1] * cosine / np.sqrt(index**2 - invariant**2) for _, index in layers]
    lateral = sum(
        (thickness * ratio for (thickness, _), ratio in zip(layers, ratios, strict=True)), np.zeros(())
    )
    return np.asarray(lateral), np.asarray(ratios[0])


def apparent_tangent(distance_mm: float, layers: Layers) -> float:
    """Tangent, in the last layer, of the ray that crosses the layers over a sideways distance."""
    from scipy.optimize import brentq

    if distance_mm == 0:
        return 0.0

    def lateral_mm(invariant: float) -> float:
        return sum(thickness * invariant / math.sqrt(index**2 - invariant**2) for thickness, index in layers)

    steepest = min(index for _, index in layers) * (1 - 1e-12)
    invariant = brentq(lambda s: lateral_mm(s) - distance_mm, 0.0, steepest, xtol=1e-14)
    return float(invariant / math.sqrt(layers[-1][1] ** 2 - invariant**2))


def apparent_distance_mm(layers: Layers) -> float:
    """Distance at which something behind the layers seems to lie, seen along their normal."""
    return sum(thickness / index for thickness, index in layers) * layers[-1][1]
