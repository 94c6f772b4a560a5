"""Photometric stereo calibrated on presses whose slopes are known at every pixel."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from designlab.metrics import normal_error_deg
from designlab.reconstruct.height import normals

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Signal = Literal["difference", "ratio"]

# Terms tried by default, simple to rich: degree in position of the factors of 1, 2 and 3 colours.
POSITION_DEGREES: tuple[tuple[int, ...], ...] = ((2,), (2, 1), (2, 1, 1))
RIDGES: tuple[float, ...] = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
# A ratio to a background darker than this share of its mean would be noise.
_DARKEST = 0.1
# More pixels of one press repeat each other; without a limit the flat ones would outvote the contact.
_SLOPING_PIXELS, _FLAT_PIXELS = 4000, 1000
# Below this share of a press's steepest slope a pixel counts as flat.
_FLAT = 0.01


class Terms(NamedTuple):
    """The polynomial of a calibration.

    Attributes
    ----------
    signal : str
        ``difference``: (I - I0) / mean(I0) per channel; ``ratio``: (I - I0) / I0; I0 is the untouched gel.
    position_degrees : tuple of int
        Entry d is the degree in position of the factor of each product of d + 1 colours.
    """

    signal: Signal
    position_degrees: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Calibration:
    """A fitted map from an image and the position in it to the gradients of the indentation.

    Attributes
    ----------
    background : array, shape (rows, columns, channels)
        Untouched gel.
    x, y : array, shape (rows, columns)
        Positions, brought to -1..1.
    terms : Terms
        Polynomial chosen.
    ridge : float
        Regularisation chosen: share of each term's power added to the diagonal of the normal equations.
    coefficients : array, shape (terms, 2)
        Weights of the terms in p and q.
    error_deg : float
        Mean angle between estimated and true normals on presses that were left out of the fit in turn.
    """

    background: Array
    x: Array
    y: Array
    terms: Terms
    ridge: float
    coefficients: Array
    error_deg: float

    def gradients(self, image: ArrayLike) -> tuple[Array, Array]:
        """Gradients of the indentation: p = dz/dx, q = dz/dy, each of shape (rows, columns).

        Parameters
        ----------
        image : array, shape (rows, columns, channels)
            A press, seen as the background was.

        Raises
        ------
        ValueError
            If the image has another shape than the background.
        """
        image = checked_image(image, self.background.shape, "image")
        signal = colour_change(image, self.background, self.terms.signal)
        p, q = np.zeros_like(self.x), np.zeros_like(self.x)
        position = _position_terms(self.x, self.y, max(self.terms.position_degrees))
        first = 0
        for colour, degree in _colour_terms(signal, self.terms.position_degrees):
            count = _position_count(degree)
            weights = position[..., :count] @ self.coefficients[first : first + count]
            p += colour * weights[..., 0]
            q += colour * weights[..., 1]
            first += count
        return p, q


def fit_calibration(
    images: Sequence[ArrayLike],
    background: ArrayLike,
    gradients_p: Sequence[ArrayLike],
    gradients_q: Sequence[ArrayLike],
    masks: Sequence[Mask],
    x_mm: ArrayLike,
    y_mm: ArrayLike,
    *,
    signals: Sequence[Signal] = ("difference", "ratio"),
    position_degrees: Sequence[tuple[int, ...]] = POSITION_DEGREES,
    ridges: Sequence[float] = RIDGES,
    like: "Calibration | None" = None,
) -> Calibration:
    """Calibrate photometric stereo on presses of known shape.

    Gradients are a polynomial in the change of colour from the untouched gel, with coefficients that are
    polynomials in position; there is no constant term, so an untouched gel is flat. The terms and the ridge
    are those with the least angular error when each press in turn is left out of the fit.

    Parameters
    ----------
    images : sequence of arrays, shape (rows, columns, channels)
        Presses; linear or not, but all alike.
    background : array, same shape
        The untouched gel.
    gradients_p, gradients_q : sequences of arrays, shape (rows, columns)
        True gradients dz/dx and dz/dy of the indentation above the undeformed membrane.
    masks : sequence of bool arrays, shape (rows, columns)
        Where the truth is known; membrane known to be flat belongs to it too.
    x_mm, y_mm : array, shape (rows, columns)
        Membrane point that each pixel sees (mm).
    signals, position_degrees, ridges : sequences
        Candidates, see `Terms` and `Calibration`.
    like : Calibration, optional
        Take its terms and ridge instead of choosing.

    Raises
    ------
    ValueError
        If there are fewer than two presses, shapes differ, a value is not finite, or nothing slopes.
    """
    if like is not None:
        signals, position_degrees, ridges = (
            (like.terms.signal,),
            (like.terms.position_degrees,),
            (like.ridge,),
        )
    background = np.asarray(background, dtype=float)
    background = checked_image(background, background.shape, "background")
    if (background.mean(axis=(0, 1)) <= 0).any():
        raise ValueError("background: each channel must have light, one has none")
    if not 2 <= len(images) == len(gradients_p) == len(gradients_q) == len(masks):
        raise ValueError(
            "images, gradients_p, gradients_q, masks: must be at least 2 presses and equally many, got "
            f"{len(images)}, {len(gradients_p)}, {len(gradients_q)}, {len(masks)}"
        )
    x, y = centred(x_mm, "x_mm", background.shape), centred(y_mm, "y_mm", background.shape)
    truths = [_truth(*press, background.shape) for press in zip(gradients_p, gradients_q, masks, strict=True)]
    presses = [
        checked_image(image, background.shape, f"images[{index}]") for index, image in enumerate(images)
    ]
    best: Calibration | None = None
    for signal in signals:
        changes = [colour_change(image, background, signal) for image in presses]
        for degrees in position_degrees:
            samples = [
                _sample(change, truth, x, y, degrees) for change, truth in zip(changes, truths, strict=True)
            ]
            total = _Normal(*(sum(part) for part in zip(*(s.normal for s in samples), strict=True)))
            for ridge in ridges:
                error_deg = _left_out_error_deg(samples, total, ridge)
                if best is None or error_deg < best.error_deg:
                    weights = _solve(total, ridge)
                    best = Calibration(background, x, y, Terms(signal, degrees), ridge, weights, error_deg)
    if best is None:
        raise ValueError("signals, position_degrees, ridges: must each hold a candidate")
    return best


class _Normal(NamedTuple):
    """Normal equations of least squares."""

    matrix: Array
    right: Array


class _Truth(NamedTuple):
    """Chosen pixels of a press with their true gradients; the first `sloping` ones are not flat."""

    pixels: NDArray[np.intp]
    gradients: Array
    sloping: int


class _Sample(NamedTuple):
    """One press as the fit sees it; `terms` and `gradients` hold the sloping pixels."""

    normal: _Normal
    terms: Array
    gradients: Array


def colour_change(image: Array, background: Array, signal: Signal) -> Array:
    """Change of colour from the untouched gel, see `Terms`."""
    mean = background.mean(axis=(0, 1))
    if signal == "difference":
        return np.asarray((image - background) / mean)
    if signal == "ratio":
        return np.asarray((image - background) / np.maximum(background, _DARKEST * mean))
    raise ValueError(f"signal: must be difference or ratio, got {signal!r}")


def _colour_terms(signal: Array, position_degrees: Sequence[int]) -> Iterable[tuple[Array, int]]:
    """Each product of colours, with the degree in position of its factor."""
    channels = range(signal.shape[-1])
    for extra, degree in enumerate(position_degrees):
        for chosen in combinations_with_replacement(channels, extra + 1):
            yield np.prod(signal[..., chosen], axis=-1), degree


def _position_terms(x: Array, y: Array, degree: int) -> Array:
    """1, x, y, x^2, xy, y^2, ... by rising degree, along a new last axis."""
    return np.stack([x ** (d - j) * y**j for d in range(degree + 1) for j in range(d + 1)], axis=-1)


def _position_count(degree: int) -> int:
    return (degree + 1) * (degree + 2) // 2


def _truth(p: ArrayLike, q: ArrayLike, mask: Mask, shape: tuple[int, ...]) -> _Truth:
    gradients = np.stack([np.asarray(p, dtype=float), np.asarray(q, dtype=float)], axis=-1)
    if gradients.shape[:2] != shape[:2] or mask.shape != shape[:2] or mask.dtype != bool:
        raise ValueError(
            f"gradients_p, gradients_q, masks: must be {shape[0]} x {shape[1]} and masks bool, got "
            f"{gradients.shape[:2]} and {mask.dtype} {mask.shape}"
        )
    known, gradients = np.flatnonzero(mask), gradients.reshape(-1, 2)
    steepness = np.linalg.norm(gradients[known], axis=1)
    if not np.isfinite(steepness).all():
        raise ValueError("gradients_p, gradients_q: must be finite within the mask")
    if not steepness.any():
        raise ValueError("gradients_p, gradients_q: each press must slope somewhere within its mask")
    flat = steepness <= _FLAT * steepness.max()
    sloping = thinned(known[~flat], _SLOPING_PIXELS)
    pixels = np.concatenate([sloping, thinned(known[flat], _FLAT_PIXELS)])
    return _Truth(pixels, gradients[pixels], sloping.size)


def thinned(pixels: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """At most `count` of the pixels, evenly spread over the list."""
    if pixels.size <= count:
        return pixels
    return pixels[np.linspace(0, pixels.size - 1, count).round().astype(np.intp)]


def _sample(change: Array, truth: _Truth, x: Array, y: Array, degrees: tuple[int, ...]) -> _Sample:
    signal = change.reshape(-1, change.shape[-1])[truth.pixels]
    position = _position_terms(x.ravel()[truth.pixels], y.ravel()[truth.pixels], max(degrees))
    terms = np.concatenate(
        [
            colour[:, None] * position[:, : _position_count(degree)]
            for colour, degree in _colour_terms(signal, degrees)
        ],
        axis=1,
    )
    normal = _Normal(terms.T @ terms, terms.T @ truth.gradients)
    return _Sample(normal, terms[: truth.sloping], truth.gradients[: truth.sloping])


def _solve(normal: _Normal, ridge: float) -> Array:
    power = np.diag(normal.matrix)
    # scaled to unit diagonal, so that the ridge acts on every term alike
    scale = 1 / np.sqrt(np.where(power > 0, power, 1.0))
    matrix = normal.matrix * scale[:, None] * scale + ridge * np.eye(len(scale))
    return np.asarray(np.linalg.solve(matrix, normal.right * scale[:, None]) * scale[:, None])


def _left_out_error_deg(samples: Sequence[_Sample], total: _Normal, ridge: float) -> float:
    errors = []
    for sample in samples:
        others = _Normal(total.matrix - sample.normal.matrix, total.right - sample.normal.right)
        estimated = sample.terms @ _solve(others, ridge)
        truth = normals(*sample.gradients.T)
        errors.append(normal_error_deg(normals(*estimated.T), truth).mean())
    return float(np.mean(errors))


def checked_image(image: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """Finite image of a given shape; the error names it."""
    image = np.asarray(image, dtype=float)
    if image.ndim != 3 or image.shape != shape:
        raise ValueError(f"{name}: must have shape (rows, columns, channels) {shape}, got {image.shape}")
    if not np.isfinite(image).all():
        raise ValueError(f"{name}: values must be finite, {int((~np.isfinite(image)).sum())} are not")
    return image


def centred(position_mm: ArrayLike, name: str, shape: tuple[int, ...]) -> Array:
    """Positions brought to -1..1."""
    position_mm = np.asarray(position_mm, dtype=float)
    if position_mm.shape != shape[:2] or not np.isfinite(position_mm).all():
        raise ValueError(f"{name}: must be finite of shape {shape[:2]}, got shape {position_mm.shape}")
    low, high = position_mm.min(), position_mm.max()
    if low == high:
        raise ValueError(f"{name}: must vary over the image, it is {low:g} mm everywhere")
    return np.asarray((2 * position_mm - low - high) / (high - low))
