"""Calibration as a lab does it: ball presses in, a map from pictures to height and normals out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from designlab.core.types import Array, Mask
from designlab.reconstruction.ball_samples import (
    ball_samples,
    known_gel,
    positions,
    relative_change,
    shape_samples,
)
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.gel_fit import GelFit
from designlab.reconstruction.height import blended, integrate, normals
from designlab.reconstruction.markers import FILLED
from designlab.reconstruction.membrane import Membrane
from designlab.reconstruction.methods import (
    ErrorMap,
    JointMap,
    Kernel,
    LinearMap,
    Method,
    Predictor,
    Samples,
    expected_error,
    expected_error_without_each,
    slope_gradients,
)
from designlab.reconstruction.pictures import check_filled, check_mask
from designlab.reconstruction.setup import Setup

_UNSEEN = 1e-2  # weight of gel beyond the camera's sight
_TOLERANCE = 1e-4  # of a weighted integration: far below a micrometre


@dataclass(frozen=True, eq=False)
class ReconstructedShape:
    """Reconstructed indentation.

    Attributes
    ----------
    height_mm : array, shape (rows, columns)
        Height above the undeformed membrane.
    read : pair of array, shape (rows, columns)
        Slopes dz/dx and dz/dy that the finest map reads off the colours.
    pitch_mm : float
        Distance of pixels.
    mask : bool array, shape (rows, columns), optional
        Pixels whose colours tell slopes; all when absent.
    """

    height_mm: Array
    read: tuple[Array, Array]
    pitch_mm: float
    mask: Mask | None = None

    @cached_property
    def slopes(self) -> tuple[Array, Array]:
        """Slopes between those read and those of the height, see `blended`."""
        return blended(*self.read, self.height_mm, pitch_mm=self.pitch_mm, mask=self.mask)

    def normals(self) -> Array:
        """Unit normals of the slopes, shape (rows, columns, 3)."""
        return normals(*self.slopes)

    def raised(self, by_mm: Array) -> "ReconstructedShape":
        """The same shape with a height added that no colour tells, as that of its border is."""
        return replace(self, height_mm=self.height_mm + by_mm)


class FittedMap(NamedTuple):
    """A fitted map.

    Attributes
    ----------
    predictor : callable
        From colour and place to slope vectors, see `methods`.
    expected_error : callable, optional
        Expected squared error of the slopes, see `methods.expected_error`.
    """

    predictor: Predictor
    expected_error: Predictor | None = None


@dataclass(frozen=True, eq=False)
class LabCalibration:
    """A calibration made from ball presses.

    Within the circle that one sees the gel has left the ball, as an elastic layer does. A map taught the
    ball's slopes up to the circle knows the object, and makes contacts too high; one taught the layer's
    surface, inside and around the contact, gets heights right and rounds the rim. So the first gives the fine
    detail of the height, the second all that is wider.

    Attributes
    ----------
    background : array, shape (rows, columns, channels)
        The untouched gel.
    setup : Setup
        Scale, ball, smoothing.
    spread : array, shape (channels,)
        Root mean square colour change over the contacts: the unit of colour.
    inner : FittedMap
        Map taught the surface of the gel.
    rim : FittedMap, optional
        Map taught the ball to almost all of the circles.
    detail_px : float
        Standard deviation of the Gaussian that parts fine from wide.
    gel : GelFit, optional
        Fit of thickness and bias of the circles; None where both were stated.
    """

    background: Array
    setup: Setup
    spread: Array
    inner: FittedMap
    rim: FittedMap | None = None
    detail_px: float = 0.0
    gel: GelFit | None = None

    def gradients(self, image: ArrayLike, *, mask: Mask | None = None) -> tuple[Array, Array]:
        """Slopes p = dz/dx, q = dz/dy of the indentation by the inner map, pixel by pixel.

        Parameters
        ----------
        image : array, shape (rows, columns, channels)
            A press.
        mask : bool array, shape (rows, columns), optional
            Pixels that show the bare membrane; printed markers left out. They are filled from around.
        """
        return self._gradients(self.inner, self._signal(image, mask))

    def _gradients(self, fit: FittedMap, signal: Array) -> tuple[Array, Array]:
        return self._sloped(fit.predictor(signal, positions(self.background.shape)))

    def _sloped(self, slope: Array) -> tuple[Array, Array]:
        p, q = slope_gradients(slope).T.reshape(2, *self.background.shape[:2])
        return p, q

    @cached_property
    def alike(self) -> tuple[list[LinearMap], list[LinearMap]] | None:
        """All maps of slopes, and all of expected errors, where those are of one method each; else None."""
        fits = [fit for fit in (self.inner, self.rim) if fit is not None]
        slopes = [fit.predictor for fit in fits if isinstance(fit.predictor, LinearMap)]
        errors = [fit.expected_error.course for fit in fits if isinstance(fit.expected_error, ErrorMap)]
        kinds = {each.method for each in slopes}, {each.method for each in errors}
        if len(slopes) < len(fits) or len(errors) not in (0, len(fits)) or max(map(len, kinds)) > 1:
            return None
        if not errors and any(fit.expected_error is not None for fit in fits):
            return None
        return slopes, errors

    @cached_property
    def _joint(self) -> tuple[JointMap, JointMap | None] | None:
        if self.alike is None:
            return None
        place, channels = positions(self.background.shape), self.background.shape[-1]
        slopes, errors = self.alike
        return JointMap(slopes, place, channels), JointMap(errors, place, channels) if errors else None

    def _read(self, signal: Array) -> list[tuple[Array, Array, Array | None]]:
        """Slopes p and q, and weights in the integration, by the inner map and by that of the rim."""
        if self._joint is None:
            fits = [fit for fit in (self.inner, self.rim) if fit is not None]
            return [(*self._gradients(fit, signal), self._weights(fit, signal)) for fit in fits]
        slopes, errors = self._joint
        found = [self._sloped(slope) for slope in slopes(signal)]
        if errors is None:
            return [(*each, None) for each in found]
        # the level of an error has no part in weights
        shape = self.background.shape[:2]
        courses = [course[:, 0].reshape(shape) for course in errors(signal)]
        return [(*each, np.exp(course.min() - course)) for each, course in zip(found, courses, strict=True)]

    def _weights(self, fit: FittedMap, signal: Array) -> Array | None:
        """Weights of the pixels in the integration; None where all are alike."""
        if fit.expected_error is None:
            return None
        error = fit.expected_error(signal, positions(self.background.shape))
        weights: Array = error.min() / error.reshape(self.background.shape[:2])
        return weights

    def reconstruct(
        self,
        image: ArrayLike,
        *,
        mask: Mask | None = None,
        unseen: Mask | None = None,
        filled: Mask | None = None,
        robust: bool = False,
    ) -> ReconstructedShape:
        """Height and slopes of a press.

        Parameters
        ----------
        image, mask
            See `gradients`; masked pixels have no weight in the integration.
        unseen : bool array, shape (rows, columns), optional
            Masked pixels beyond what the camera sees. They are taken to be flat, with little weight: without
            any nothing would hold the height to the border.
        filled : bool array, shape (rows, columns), optional
            Pixels whose marker was filled in from around, see `markers.without`. Their slopes count little.
        robust : bool
            See `integrate`.
        """
        signal = self._signal(image, mask)
        check_filled(filled, self.background.shape[:2])
        pitch_mm = self.setup.mm_per_px
        counted = None
        if mask is not None or filled is not None:
            counted = np.ones(self.background.shape[:2]) if mask is None else mask.astype(float)
            if filled is not None:
                counted[filled] *= FILLED
            if unseen is not None:
                counted[unseen] = _UNSEEN

        def height(p: Array, q: Array, weights: Array | None) -> Array:
            if counted is not None:
                weights = counted if weights is None else weights * counted
            return integrate(
                p,
                q,
                pitch_mm=pitch_mm,
                boundary=self.setup.boundary,
                weights=weights,
                robust=robust,
                tolerance=_TOLERANCE,
            )

        inner, *rim = self._read(signal)
        height_mm = height(*inner)
        if rim:
            more = height(*rim[0]) - height_mm
            height_mm += more - gaussian_filter(more, self.detail_px, mode="nearest")
        p, q, _ = rim[0] if rim else inner
        return ReconstructedShape(height_mm, (p, q), pitch_mm, mask)

    def change(self, image: ArrayLike, mask: Mask | None = None) -> Array:
        """Change of colour from the untouched gel, in spreads, (rows, columns, channels)."""
        return self._signal(image, mask).reshape(self.background.shape)

    def _signal(self, image: ArrayLike, mask: Mask | None) -> Array:
        image = np.asarray(image, dtype=float)
        if image.shape != self.background.shape:
            raise ValueError(
                f"image: must have the shape of the background {self.background.shape}, got {image.shape}"
            )
        check_mask(mask, image.shape[:2])
        change = relative_change(image, self.background, self.setup, mask) / self.spread
        return change.reshape(-1, self.background.shape[-1])


def calibrate(
    balls: Sequence[BallPress],
    background: ArrayLike,
    setup: Setup,
    *,
    method: Method | None = None,
    membrane: Membrane | None = None,
) -> LabCalibration:
    """Calibrate on ball presses.

    Parameters
    ----------
    balls : sequence of BallPress
        At least two, at different places.
    background : array, shape (rows, columns, channels)
        The untouched gel.
    setup : Setup
        Scale, ball and what is known of the gel; the rest is fitted, see `ball_samples.known_gel`.
    method : Method, optional
        See `methods`; `Kernel()` when absent.
    membrane : Membrane, optional
        The undeformed membrane on whose grid the pictures are laid out, for a dome; a plane when absent.

    Raises
    ------
    ValueError
        If there are fewer than two balls, or shapes differ.
    """
    balls, setup, gel = known_gel(balls, background, setup, membrane)
    background, spread, parts = ball_samples(balls, background, setup, membrane)
    method = method or Kernel()
    fits = []
    for presses in parts:
        error = None
        if setup.weighted:
            error = expected_error(presses, _predicted(method.fit_without_each(presses), presses))
        fits.append(FittedMap(method.fit(presses), error))
    return _assembled(balls, background, setup, spread, fits, gel)


def calibrate_on_shapes(
    images: Sequence[Array],
    background: Array,
    slopes: Sequence[tuple[Array, Array]],
    regions: Sequence[Mask],
    setup: Setup,
    *,
    method: Method | None = None,
) -> LabCalibration:
    """Calibrate on presses whose slopes are known at every pixel, as those of simulated ones are.

    Slopes on and around the contact are known alike, so one map takes them all.

    Parameters
    ----------
    images : sequence of array, shape (rows, columns, channels)
        At least two presses.
    background : array, shape (rows, columns, channels)
        The untouched gel.
    slopes : sequence of pair of arrays, shape (rows, columns)
        Slopes dz/dx and dz/dy of each indentation.
    regions : sequence of bool array, shape (rows, columns)
        On and around each contact.
    setup : Setup
        Scale, gel and smoothing; `detail` must be 0.
    method : Method, optional
        See `methods`; `Kernel()` when absent.

    Raises
    ------
    ValueError
        If a channel does not change colour.
    """
    method = method or Kernel()
    spread, presses = shape_samples(images, background, slopes, regions, setup)
    error = None
    if setup.weighted:
        error = expected_error(presses, _predicted(method.fit_without_each(presses), presses))
    return LabCalibration(background, setup, spread, FittedMap(method.fit(presses), error))


def _assembled(
    balls: Sequence[BallPress],
    background: Array,
    setup: Setup,
    spread: Array,
    fits: Sequence[FittedMap],
    gel: GelFit | None = None,
) -> LabCalibration:
    detail_px = setup.detail * float(np.mean([ball.contact_radius_px for ball in balls]))
    return LabCalibration(
        background, setup, spread, fits[0], fits[1] if len(fits) > 1 else None, detail_px, gel
    )


def _predicted(fits: Sequence[Predictor], presses: Sequence[Samples]) -> list[Array]:
    """Slopes of each press by its own fit."""
    return [fit(press.signal, press.position) for fit, press in zip(fits, presses, strict=True)]


def calibrations_without_each(
    balls: Sequence[BallPress],
    background: ArrayLike,
    setup: Setup,
    *,
    method: Method | None = None,
    membrane: Membrane | None = None,
) -> list[LabCalibration]:
    """Calibrations that each know nothing of one ball, on a gel that is known. Parameters as `calibrate`."""
    method = method or Kernel()
    background, spread, parts = ball_samples(balls, background, setup, membrane)
    fits = []
    for presses in parts:
        predictors = method.fit_without_each(presses)
        errors: Sequence[Predictor | None] = [None] * len(balls)
        if setup.weighted:
            errors = expected_error_without_each(presses, _predicted(predictors, presses))
        fits.append([FittedMap(*pair) for pair in zip(predictors, errors, strict=True)])
    return [_assembled(balls, background, setup, spread, own) for own in zip(*fits, strict=True)]
