"""Photometric stereo by kernel regression that also says how far it may be trusted at each pixel."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from designlab.core.metrics import normal_error_deg
from designlab.core.types import Array, Mask
from designlab.reconstruction.height import integrate, normals
from designlab.reconstruction.markers import FILLED
from designlab.reconstruction.methods import Kernel, Samples, log_errors, slope_gradients
from designlab.reconstruction.pictures import (
    centred,
    check_filled,
    check_mask,
    checked_image,
    colour_change,
    smoothed,
    thinned,
)

_RIDGES = (3e-3, 1e-3, 3e-4)
# Test presses are steeper than balls. A narrower kernel errs less on balls left out, and more on presses.
_COLOUR_SCALE = 2.0
_FEATURES_PER_PRESS, _MOST_FEATURES = 34, 500  # more presses show more detail
_CHUNK = 4096  # pixels at a time, so that their waves stay in the processor's cache
_SLOPING_PIXELS, _FLAT_PIXELS = 1000, 200
_FLAT = 0.01  # share of a press's steepest slope below which a pixel counts as flat
_TOLERANCE = 1e-3  # of the integration: half a micrometre at most


class GradientEstimate(NamedTuple):
    """Gradients p = dz/dx, q = dz/dy of an indentation, and their weights in the integration."""

    p: Array
    q: Array
    weights: Array

    def height_mm(self, *, pitch_mm: float | tuple[float, float]) -> Array:
        """Height above the border of the picture, all of which is held at 0; see `integrate`."""
        return integrate(
            self.p,
            self.q,
            pitch_mm=pitch_mm,
            boundary="dirichlet",
            weights=self.weights,
            tolerance=_TOLERANCE,
        )


@dataclass(frozen=True, eq=False)
class KernelCalibration:
    """A fitted map from a picture and the position in it to gradients and their expected error.

    Attributes
    ----------
    background : array, shape (rows, columns, channels)
        Untouched gel.
    position : array, shape (pixels, 2)
        Positions, brought to -1..1.
    spread : array, shape (channels,)
        Root mean square colour change where the presses slope: the unit of colour.
    kernel : Kernel
        The regression chosen.
    error_deg : float
        Mean angle between estimated and true normals on presses that were left out of the fit in turn.
    smoothing_px : float
        Standard deviation of the Gaussian that pictures are smoothed with.
    """

    background: Array
    position: Array
    spread: Array
    kernel: Kernel
    error_deg: float
    smoothing_px: float
    _weights: Array
    _at_rest: Array

    def on(self, background: ArrayLike) -> "KernelCalibration":
        """Return the same map for another sensor of the kind, of which only the untouched gel was seen.

        Raises
        ------
        ValueError
            If its picture has another shape.
        """
        return replace(self, background=checked_image(background, self.background.shape, "background"))

    def estimate(
        self, image: ArrayLike, *, mask: Mask | None = None, filled: Mask | None = None
    ) -> GradientEstimate:
        """Gradients of the indentation and their weights, each of shape (rows, columns).

        The weight of a pixel is the inverse of the error that presses left out of the calibration had at
        its colour and place: shadows and clipped channels count little in the height.

        Parameters
        ----------
        image : array, shape (rows, columns, channels)
            A press, seen as the background was.
        mask : bool array, shape (rows, columns), optional
            Pixels to use; others get no weight.
        filled : bool array, shape (rows, columns), optional
            Pixels whose marker was filled in from around, see `markers.without`. They get little weight.

        Raises
        ------
        ValueError
            If the image or the mask has another shape than the background.
        """
        image = checked_image(image, self.background.shape, "image")
        rows, columns, channels = self.background.shape
        check_mask(mask, (rows, columns))
        check_filled(filled, (rows, columns))
        change = smoothed(colour_change(image, self.background), self.smoothing_px)
        signal = change.reshape(-1, channels) / self.spread
        found = _sums(self.kernel, self._weights, signal, self.position) - self._at_rest
        p, q = slope_gradients(found[:, :2]).T.reshape(2, rows, columns)
        weights = np.exp(-found[:, 2]).reshape(rows, columns)
        weights /= weights.max()
        if filled is not None:
            weights[filled] *= FILLED
        return GradientEstimate(p, q, weights if mask is None else weights * mask)


def fit_kernel(
    images: Sequence[ArrayLike],
    background: ArrayLike,
    gradients_p: Sequence[ArrayLike],
    gradients_q: Sequence[ArrayLike],
    x_mm: ArrayLike,
    y_mm: ArrayLike,
    *,
    smoothing_px: float = 0.0,
    covered: Sequence[Mask | None] | None = None,
) -> KernelCalibration:
    """Calibrate on presses of known shape.

    The kernel is the one with the least angular error when each press in turn is left out of the fit. What
    error is left then, as a function of colour and place, is fitted as well.

    Parameters
    ----------
    images : sequence of arrays, shape (rows, columns, channels)
        Presses; linear or not, but all alike.
    background : array, same shape
        The untouched gel.
    gradients_p, gradients_q : sequences of arrays, shape (rows, columns)
        True gradients dz/dx and dz/dy of the indentation above the undeformed membrane.
    x_mm, y_mm : array, shape (rows, columns)
        Membrane point that each pixel sees (mm).
    smoothing_px : float
        Standard deviation of the Gaussian that pictures are smoothed with, against noise. True slopes are
        smoothed alike, since colours follow slopes.
    covered : sequence of bool arrays, shape (rows, columns), or None, optional
        Pixels of each press whose marker was filled in from around; they teach nothing.

    Raises
    ------
    ValueError
        If there are fewer than two presses, shapes differ, a value is not finite, or nothing slopes.
    """
    if not 2 <= len(images) == len(gradients_p) == len(gradients_q):
        raise ValueError(
            "images, gradients_p, gradients_q: must be at least 2 presses and equally many, got "
            f"{len(images)}, {len(gradients_p)}, {len(gradients_q)}"
        )
    background = np.asarray(background, dtype=float)
    background = checked_image(background, background.shape, "background")
    if (background.mean(axis=(0, 1)) <= 0).any():
        raise ValueError("background: each channel must have light, one has none")
    x, y = centred(x_mm, "x_mm", background.shape), centred(y_mm, "y_mm", background.shape)
    position = np.stack([x.ravel(), y.ravel()], axis=1)
    presses, sloping = [], []
    for number, (image, p, q) in enumerate(zip(images, gradients_p, gradients_q, strict=True)):
        change = colour_change(checked_image(image, background.shape, f"images[{number}]"), background)
        change = smoothed(change, smoothing_px)
        slope = _slope_vectors(p, q, background.shape, smoothing_px)
        steepness = np.hypot(*slope.T)
        flat = steepness <= _FLAT * steepness.max()
        hidden = None if covered is None else covered[number]
        bare = np.ones(flat.size, dtype=bool) if hidden is None else ~hidden.ravel()
        steep = thinned(np.flatnonzero(~flat & bare), _SLOPING_PIXELS)
        pixels = np.concatenate([steep, thinned(np.flatnonzero(flat & bare), _FLAT_PIXELS)])
        sloping.append(steep.size)
        presses.append(
            Samples(
                change.reshape(-1, change.shape[-1])[pixels],
                position[pixels],
                slope[pixels],
                np.ones(pixels.size),
            )
        )
    contacts = [press.signal[:count] for press, count in zip(presses, sloping, strict=True)]
    spread = np.sqrt((np.concatenate(contacts) ** 2).mean(axis=0))
    if not (spread > 0).all():
        raise ValueError("images: each channel must change colour where the presses slope")
    presses = [press._replace(signal=press.signal / spread) for press in presses]
    error_deg, kernel, left_out = _chosen(presses, sloping)
    errors, _ = log_errors(presses, left_out)
    weights = kernel.weights(
        [p._replace(slope=np.concatenate([p.slope, e], axis=1)) for p, e in zip(presses, errors, strict=True)]
    )
    at_rest = _sums(kernel, weights, np.zeros((len(position), background.shape[-1])), position)
    return KernelCalibration(background, position, spread, kernel, error_deg, smoothing_px, weights, at_rest)


def _sums(kernel: Kernel, weights: Array, signal: Array, position: Array) -> Array:
    """Weighted sums of the kernel's waves, some pixels at a time."""
    chunks = [slice(first, first + _CHUNK) for first in range(0, len(signal), _CHUNK)]
    single = weights.astype(np.float32)
    return np.concatenate([kernel.waves(signal[c], position[c]) @ single for c in chunks]).astype(float)


def _slope_vectors(p: ArrayLike, q: ArrayLike, shape: tuple[int, ...], smoothing_px: float) -> Array:
    p, q = np.asarray(p, dtype=float), np.asarray(q, dtype=float)
    if p.shape != shape[:2] or q.shape != shape[:2] or not (np.isfinite(p) & np.isfinite(q)).all():
        raise ValueError(f"gradients_p, gradients_q: must be finite of shape {shape[:2]}, got {p.shape}")
    if not (p.any() or q.any()):
        raise ValueError("gradients_p, gradients_q: each press must slope somewhere")
    p, q = np.moveaxis(smoothed(np.stack([p, q], axis=-1), smoothing_px), -1, 0)
    return np.asarray(-normals(p, q)[..., :2].reshape(-1, 2))


def _chosen(presses: Sequence[Samples], sloping: Sequence[int]) -> tuple[float, Kernel, list[Array]]:
    """The kernel, of three from stiff to supple, with the least error on presses left out in turn.

    The error is the mean angle on their slopes; all their slopes, predicted so, are returned with it.
    """
    features = min(_FEATURES_PER_PRESS * len(presses), _MOST_FEATURES)
    kernels = [Kernel(ridge=ridge, colour_scale=_COLOUR_SCALE, features=features) for ridge in _RIDGES]
    parts = [kernels[0].normal(press) for press in presses]
    tried = []
    for kernel in kernels:
        found, errors = [], []
        for press, count, predictor in zip(presses, sloping, kernel.solve_without_each(parts), strict=True):
            found.append(predictor(press.signal, press.position))
            estimated, truth = (normals(*slope_gradients(s[:count]).T) for s in (found[-1], press.slope))
            errors.append(normal_error_deg(estimated, truth).mean())
        tried.append((float(np.mean(errors)), kernel, found))
    return min(tried, key=lambda row: row[0])
