"""Ways from colour change and position to slope, fitted to pixels of known slope.

Each method maps a change of colour (N, channels), in units of its spread over the contacts, and a position
(N, 2), in -1..1, to a slope vector (N, 2): -n_x and -n_y of the unit normal, in which Lambert's law is
linear. No change of colour means no slope.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve

from designlab.core.types import Array

Predictor = Callable[[Array, Array], Array]

_LEAST_ERROR = (
    0.02  # of a slope: below a degree a pixel counts in full, and the weights stay within two decades
)
_FLAT_SLOPE = 0.01
_STEEPEST = 0.97  # sine of the steepest slope that is believed
_CHUNK = 4096  # pixels at a time, so that their terms stay in the processor's cache


class Samples(NamedTuple):
    """Pixels of one press: colour change, position, slope vector, and weight of each pixel."""

    signal: Array
    position: Array
    slope: Array
    weight: Array


def slope_gradients(slope: Array) -> Array:
    """Gradients (N, 2) of slope vectors -n_x, -n_y (N, 2); steeper ones than 76 deg are cut."""
    size = np.linalg.norm(slope, axis=1)
    slope = slope * np.minimum(1.0, _STEEPEST / np.maximum(size, 1e-12))[:, None]
    return np.asarray(slope / np.sqrt(1 - (slope**2).sum(axis=1))[:, None])


@dataclass(frozen=True, eq=False)
class LinearMap:
    """A fitted map of a linear method: its terms times their weights, shape (terms, outputs)."""

    method: "LinearMethod"
    weights: Array

    def __call__(self, signal: Array, position: Array) -> Array:
        """Outputs of each pixel, (N, outputs), from its colour change and place."""
        parts = []
        for first in range(0, len(signal), _CHUNK):
            terms = self.method.terms(signal[first : first + _CHUNK], position[first : first + _CHUNK])
            parts.append(terms @ self.weights.astype(terms.dtype))
        return np.concatenate(parts).astype(float)


@dataclass(frozen=True, eq=False)
class ErrorMap:
    """Expected squared error of slopes, (N,): the exponential of a fitted map above a level."""

    course: LinearMap
    level: float

    def __call__(self, signal: Array, position: Array) -> Array:
        """Squared error of each pixel, (N,), from its colour change and place."""
        return np.asarray(np.exp(self.course(signal, position)[:, 0] + self.level))


class JointMap:
    """Fitted maps of equal methods, read together for pictures whose pixels have the same places.

    What a method says of the untouched gel is found once for each place.

    Parameters
    ----------
    maps : sequence of LinearMap
        The maps.
    position : array, shape (N, 2)
        Places of the pixels.
    channels : int
        Of the pictures.
    """

    def __init__(self, maps: Sequence[LinearMap], position: Array, channels: int) -> None:
        self._method, self._position = maps[0].method, position
        self._weights = np.concatenate([each.weights for each in maps], axis=1).astype(np.float32)
        self._ends = np.cumsum([each.weights.shape[1] for each in maps])[:-1]
        self._at_rest = self._sums(np.zeros((len(position), channels)))

    def __call__(self, signal: Array) -> list[Array]:
        """Outputs of each map, (N, outputs), from the changes of colour."""
        return np.split((self._sums(signal) - self._at_rest).astype(float), self._ends, axis=1)

    def _sums(self, signal: Array) -> NDArray[np.float32]:
        parts = [
            self._method.waves(signal[first : first + _CHUNK], self._position[first : first + _CHUNK])
            @ self._weights
            for first in range(0, len(signal), _CHUNK)
        ]
        return np.concatenate(parts)


def outputs_at(maps: Sequence[LinearMap], signal: Array, place: Array) -> NDArray[np.float32]:
    """Outputs of maps of equal methods side by side, (N, outputs), for changes of colour at one place."""
    method, weights = maps[0].method, np.concatenate([each.weights for each in maps], axis=1)
    single = weights.astype(np.float32)
    at_rest = method.waves(np.zeros((1, signal.shape[1])), place[None]) @ single
    parts = []
    for first in range(0, len(signal), _CHUNK):
        some = signal[first : first + _CHUNK]
        waves = method.waves(some, np.broadcast_to(place, (len(some), 2)))
        parts.append(waves.astype(np.float32) @ single - at_rest)
    return np.concatenate(parts)


class Method(Protocol):
    """A way to learn slopes from samples."""

    @property
    def name(self) -> str:
        """Name with the settings that matter."""

    def fit(self, presses: Sequence[Samples]) -> Predictor:
        """Fit to all presses."""

    def fit_without_each(self, presses: Sequence[Samples]) -> Sequence[Predictor]:
        """Fits that each know nothing of one press, in the order of the presses."""


@dataclass(frozen=True)
class LinearMethod(ABC):
    """Methods linear in their terms: ridge regression, with normal equations kept apart by press."""

    ridge: float = 1e-3

    @abstractmethod
    def terms(self, signal: Array, position: Array) -> NDArray[np.floating]:
        """Terms of each pixel, shape (N, terms)."""

    def waves(self, signal: Array, position: Array) -> NDArray[np.floating]:
        """Terms up to those of no change of colour, shape (N, terms)."""
        return self.terms(signal, position)

    def fit(self, presses: Sequence[Samples]) -> LinearMap:
        """Fit to all presses."""
        return LinearMap(self, self.weights(presses))

    def weights(self, presses: Sequence[Samples]) -> Array:
        """Weights of the terms fitted to all presses."""
        matrix, right = (np.sum(part, axis=0) for part in zip(*map(self.normal, presses), strict=True))
        return self._solve(matrix, right)

    def fit_without_each(self, presses: Sequence[Samples]) -> list[LinearMap]:
        """Fits that each know nothing of one press."""
        return self.solve_without_each([self.normal(press) for press in presses])

    def solve_without_each(self, normals: Sequence[tuple[Array, Array]]) -> list[LinearMap]:
        """Fits that each know nothing of one press, from the `normal` equations of all."""
        matrix, right = (np.sum(part, axis=0) for part in zip(*normals, strict=True))
        return [LinearMap(self, self._solve(matrix - m, right - r)) for m, r in normals]

    def normal(self, press: Samples) -> tuple[Array, Array]:
        """Matrix and right-hand side of a press's normal equations, which do not depend on the ridge."""
        terms = np.asarray(self.terms(press.signal, press.position), dtype=float)
        weighted = terms * press.weight[:, None]
        return weighted.T @ terms, weighted.T @ press.slope

    def _solve(self, matrix: Array, right: Array) -> Array:
        power = np.diag(matrix)
        # scaled to unit diagonal, so that the ridge acts on every term alike
        scale = 1 / np.sqrt(np.where(power > 1e-12 * power.max(), power, np.inf))
        scaled = matrix * scale[:, None] * scale + self.ridge * np.eye(len(scale))
        return np.asarray(solve(scaled, right * scale[:, None], assume_a="pos") * scale[:, None])


@dataclass(frozen=True)
class Polynomial(LinearMethod):
    """Photometric stereo with position terms: products of colours times polynomials in position.

    Attributes
    ----------
    position_degrees : tuple of int
        Entry d is the degree in position of the factor of each product of d + 1 colours.
    """

    position_degrees: tuple[int, ...] = (2, 1, 1)

    @property
    def name(self) -> str:
        """Name with the degrees."""
        return f"polynomial {self.position_degrees}"

    def terms(self, signal: Array, position: Array) -> Array:
        """Terms of each pixel."""
        x, y = position.T
        factors = np.stack(
            [x ** (d - j) * y**j for d in range(max(self.position_degrees) + 1) for j in range(d + 1)], axis=1
        )
        return np.concatenate(
            [
                np.prod(signal[:, chosen], axis=1)[:, None] * factors[:, : (degree + 1) * (degree + 2) // 2]
                for extra, degree in enumerate(self.position_degrees)
                for chosen in combinations_with_replacement(range(signal.shape[1]), extra + 1)
            ],
            axis=1,
        )


@dataclass(frozen=True)
class Kernel(LinearMethod):
    """Gaussian kernel regression on colour and position by random Fourier features.

    Follows the colours wherever the balls show them, shadows and clipped channels included, and returns to
    flat where they show none. Features: Rahimi and Recht, NIPS 2007.

    Attributes
    ----------
    colour_scale, position_scale : float
        Length of the kernel in spreads of the colour change, and in half images.
    features : int
        Number of random features; more are slower and closer to the kernel itself.
    seed : int
        Of the features.
    """

    ridge: float = 3e-3
    colour_scale: float = 1.5
    position_scale: float = 2.0
    features: int = 600
    seed: int = 0

    @property
    def name(self) -> str:
        """Name with the scales."""
        scales = f"{self.colour_scale:g}, {self.position_scale:g}"
        return f"kernel {scales}, ridge {self.ridge:g}, {self.features} features"

    def terms(self, signal: Array, position: Array) -> NDArray[np.float32]:
        """Terms of each pixel; zero where the colour is that of the untouched gel."""
        return self.waves(signal, position) - self.waves(np.zeros_like(signal), position)

    def waves(self, signal: Array, position: Array) -> NDArray[np.float32]:
        """Terms before those of no change of colour are taken off."""
        draw = np.random.default_rng(self.seed)
        along_colour = draw.standard_normal((signal.shape[1], self.features)) / self.colour_scale
        along_position = draw.standard_normal((2, self.features)) / self.position_scale
        turn = draw.uniform(0, 2 * np.pi, self.features).astype(np.float32)
        # single precision is far finer than any camera, and faster
        at = np.concatenate([signal, position], axis=1).astype(np.float32)
        along = np.concatenate([along_colour, along_position]).astype(np.float32)
        return np.asarray(np.cos(at @ along + turn))


def expected_error(presses: Sequence[Samples], predicted: Sequence[Array]) -> ErrorMap:
    """Expected squared error of slopes as a function of colour and place, shape (N,).

    Kernel regression on the logarithm of the squared errors that presses had when left out of the fit. Only
    its course matters, not its level: its inverse weighs pixels in the integration.

    Parameters
    ----------
    presses : sequence of Samples
        Presses.
    predicted : sequence of arrays, shape (N, 2)
        Slopes of each press, predicted by a fit without it.
    """
    kernel, samples, level = _course(presses, predicted)
    return ErrorMap(kernel.fit(samples), level)


def expected_error_without_each(presses: Sequence[Samples], predicted: Sequence[Array]) -> list[ErrorMap]:
    """`expected_error` from all but one press, for each press."""
    kernel, samples, level = _course(presses, predicted)
    return [ErrorMap(course, level) for course in kernel.fit_without_each(samples)]


def log_errors(presses: Sequence[Samples], predicted: Sequence[Array]) -> tuple[list[Array], float]:
    """Logarithm of each pixel's squared error above that of flat pixels, (N, 1) a press, and the latter."""
    errors = [
        np.log(((p - press.slope) ** 2).sum(axis=1) + _LEAST_ERROR**2)[:, None]
        for p, press in zip(predicted, presses, strict=True)
    ]
    flat = np.concatenate([np.hypot(*press.slope.T) < _FLAT_SLOPE for press in presses])
    together = np.concatenate(errors)
    level = float(together[flat].mean() if flat.any() else together.min())
    return [error - level for error in errors], level


def _course(presses: Sequence[Samples], predicted: Sequence[Array]) -> tuple[Kernel, list[Samples], float]:
    errors, level = log_errors(presses, predicted)
    kernel = Kernel(ridge=1e-3, colour_scale=1.0, features=100)
    return kernel, [press._replace(slope=e) for press, e in zip(presses, errors, strict=True)], level
