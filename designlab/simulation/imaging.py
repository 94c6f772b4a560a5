"""The imaging chain: from light in front of the camera to what the camera reports, step by step.

`CHAIN` is the one ordered list of steps. Those before `Mixing` act on the light of every LED group, an array
of shape (groups, rows, columns). `Mixing` turns it into the channels of the camera, (rows, columns, 3), on
which the others act. A simulated frame is light behind the optics. Evaluation runs the rest, with noise.
Comparison and diagnosis ask for the signal that is expected without noise; calibration mixes frames by a
transfer and a floor that it fits. So a step on light that is added here is seen by all, one on the signal by
all but calibration. Pictures that are kept on disk hold the steps on light: a change of these needs a higher
`render_cache.PICTURES_VERSION`.

Effects on the signal belong to the electronics. They act on what a pixel has collected, its noise included,
and before the converter cuts and rounds it, as in the linear camera model of the standard EMVA 1288: so a
pedestal keeps the noise of a dark pixel from being cut at zero.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from designlab.core.types import Array
from designlab.sensor.camera import Camera, View, Vignetting
from designlab.simulation.effects.base import Light, Sight, Signal
from designlab.simulation.optics.defocus import blur

Image = NDArray[np.floating[Any]]
"""Light of every LED group before `Mixing`, the channels of the camera after it."""

CHANNELS = 3
WHOLE = (slice(None), slice(None))  # rows and columns of a picture
DEVIATES = np.linspace(-5.0, 5.0, 101)  # of the noise of one pixel
LEVELS = 400  # of a sampled curve
FEW_ELECTRONS = (
    1000.0  # below which photon noise is drawn from Poisson's distribution; above, a Gaussian agrees
)


class CameraEffects(Protocol):
    """Effects of a sensor model on light and signal."""

    @property
    def curved(self) -> bool:
        """Whether the signal changes otherwise than in proportion, so that noise changes its mean."""
        ...

    def on_light(self, light: Light, sight: Sight) -> Light:
        """Return the light after the effects on it."""
        ...

    def on_signal(self, signal: Signal) -> Signal:
        """Return the signal after the effects on it."""
        ...


@dataclass(frozen=True, eq=False)
class Capture:
    """How one picture is taken.

    Attributes
    ----------
    camera : Camera
        The camera.
    effects : CameraEffects, optional
        Effects of the sensor model; none when absent.
    view : View, optional
        Part of the camera's sensor; the steps on light need it.
    sight : Sight, optional
        What the picture shows, for effects on its light; they are left out when it is absent.
    defocus_px : array, optional
        Radius of the blur disc of every pixel; absent where the light has passed the lens already.
    place : tuple of slice
        Rows and columns of the view within the light, which is wider where it is blurred.
    weights : array, shape (3, groups)
        Mixing matrix times flux; a camera that sees each of three groups in a channel of its own when absent.
    exposure : float
        Signal as a share of full scale per unit of mixed radiance.
    seed : int, optional
        Seed of the noise; without it nothing is drawn or rounded.
    binned : float
        Sensor pixels averaged into one pixel of the picture, at least 1.
    """

    camera: Camera
    effects: CameraEffects | None = None
    view: View | None = None
    sight: Sight | None = None
    defocus_px: Array | None = None
    place: tuple[slice, slice] = WHOLE
    weights: Array = field(default_factory=lambda: np.eye(CHANNELS))
    exposure: float = 1.0
    seed: int | None = None
    binned: float = 1.0

    @property
    def averages_behind_curve(self) -> bool:
        """Whether pixels of the picture are means of sensor pixels that each answer by a curve."""
        curved = not self.camera.response.is_linear or (self.effects is not None and self.effects.curved)
        return self.seed is not None and self.binned > 1 and curved

    @property
    def steps(self) -> float:
        """Steps of the converter over its range, those that averaging refines included."""
        return self.binned * float(2**self.camera.bit_depth - 1)


class ImagingStep(ABC):
    """One step of the imaging chain."""

    name: ClassVar[str]
    linear: ClassVar[bool] = True
    """Whether the mean of the picture passes in proportion, an added constant apart."""
    converts: ClassVar[bool] = False
    """Whether it belongs to the converter, whose curve is undone in what is measured."""

    @abstractmethod
    def apply(self, image: Image, capture: Capture) -> Image:
        """Return the picture after the step, with its random draws where the capture has a seed."""

    def moments(self, mean: Image, variance: Image, capture: Capture) -> tuple[Image, Image]:
        """Return mean and variance of every pixel after the step.

        A step that multiplies pixels, as this assumes, multiplies the variance twice. Of one that also
        spreads light over pixels this is an upper bound.
        """
        return self.apply(mean, capture), self.apply(self.apply(variance, capture), capture)


class Lens(ImagingStep):
    """The lens blurs what is out of focus: the variance of pixels falls, and neighbours err alike."""

    name: ClassVar[str] = "lens"

    def apply(self, image: Image, capture: Capture) -> Image:
        """Blur and cut to the view."""
        if capture.defocus_px is not None:
            image = blur(np.asarray(image, dtype=np.float32), capture.defocus_px)
        return np.asarray(image[..., *capture.place])

    def moments(self, mean: Image, variance: Image, capture: Capture) -> tuple[Image, Image]:
        """Sum the variances by the squares of the weights of the disc."""
        if capture.defocus_px is not None:
            variance = blur(np.asarray(variance, dtype=np.float32), capture.defocus_px, squared=True)
        return self.apply(mean, capture), np.asarray(variance[..., *capture.place])


class FallOff(ImagingStep):
    """The lens is darker towards the corners (vignetting)."""

    name: ClassVar[str] = "vignetting"

    def apply(self, image: Image, capture: Capture) -> Image:
        """Multiply by the fall-off."""
        if capture.view is None or capture.camera.vignetting == Vignetting():
            return image
        return np.asarray(image * capture.camera.vignette(capture.view), dtype=image.dtype)


class EffectsOnLight(ImagingStep):
    """Effects of the sensor model on light; each is linear in it."""

    name: ClassVar[str] = "effects on light"

    def apply(self, image: Image, capture: Capture) -> Image:
        """Let the effects act in the order of the catalogue."""
        if capture.effects is None or capture.sight is None:
            return image
        return np.asarray(capture.effects.on_light(image, capture.sight), dtype=image.dtype)


class Mixing(ImagingStep):
    """Channels of the camera see the light of the LED groups by the mixing matrix."""

    name: ClassVar[str] = "mixing"

    def apply(self, image: Image, capture: Capture) -> Image:
        """Sum over the groups."""
        return mixed(image, capture.weights)

    def moments(self, mean: Image, variance: Image, capture: Capture) -> tuple[Image, Image]:
        """Sum the variances by the squares of the weights: groups err independently."""
        return mixed(mean, capture.weights), mixed(variance, capture.weights**2)


class Exposing(ImagingStep):
    """Pixels collect light over the exposure; none collects less than nothing, whatever mixing takes."""

    name: ClassVar[str] = "exposure"

    def apply(self, image: Image, capture: Capture) -> Image:
        """Scale to shares of full scale."""
        return np.clip(np.asarray(image, dtype=float) * capture.exposure, 0.0, None)


class PixelNoise(ImagingStep):
    """Photon noise (Poisson) and read noise (Gaussian) of the sensor's pixels; the mean stays."""

    name: ClassVar[str] = "noise"

    def apply(self, image: Image, capture: Capture) -> Image:
        """Draw the noise; that of pixels which are averaged behind a curve is drawn there, see `Response`."""
        if capture.seed is None or capture.averages_behind_curve:
            return image
        camera, binned = capture.camera, capture.binned
        random, deviates = _deviates(capture.seed, image.shape)
        electrons = image * camera.full_scale_e * binned
        # Averaging pixels refines the converter's steps, but each pixel has brought its own rounding error.
        rounding_e = camera.full_scale_e * np.sqrt((binned - 1) / 12) / (2**camera.bit_depth - 1)
        read_e = np.hypot(camera.read_noise_e * np.sqrt(binned), rounding_e)
        found = electrons + np.sqrt(electrons + read_e**2) * deviates
        few = electrons < FEW_ELECTRONS
        found[few] = random.poisson(electrons[few]) + read_e * deviates[few]
        return np.asarray(found / (camera.full_scale_e * binned))

    def moments(self, mean: Image, variance: Image, capture: Capture) -> tuple[Image, Image]:
        """Add the variance of photons and read-out."""
        sigma = capture.camera.pixel_noise(
            np.asarray(mean + capture.camera.black_level, dtype=float), capture.binned
        )
        return mean, variance + sigma**2


class BlackLevel(ImagingStep):
    """The camera adds its black level; the variance stays."""

    name: ClassVar[str] = "black level"

    def apply(self, image: Image, capture: Capture) -> Image:
        """Add the level."""
        return image + capture.camera.black_level

    def moments(self, mean: Image, variance: Image, capture: Capture) -> tuple[Image, Image]:
        """Move the mean."""
        return self.apply(mean, capture), variance


class EffectsOnSignal(ImagingStep):
    """Effects of the sensor model on the signal: pedestals and curves of the electronics."""

    name: ClassVar[str] = "effects on the signal"
    linear: ClassVar[bool] = False

    def apply(self, image: Image, capture: Capture) -> Image:
        """Let the effects act, unless on single sensor pixels, see `Response`."""
        if capture.effects is None or capture.averages_behind_curve:
            return image
        return np.asarray(capture.effects.on_signal(image), dtype=float)

    def moments(self, mean: Image, variance: Image, capture: Capture) -> tuple[Image, Image]:
        """Linearise about the mean over one standard deviation to either side."""
        sigma = np.maximum(np.sqrt(variance), 1e-6)
        high, low = (self.apply(mean + sign * sigma, capture) for sign in (1, -1))
        return self.apply(mean, capture), variance * ((high - low) / (2 * sigma)) ** 2


class Response(ImagingStep):
    """The camera answers by its response curve.

    Where a pixel of the picture averages sensor pixels, each has its noise before the curve. The noise of the
    mean is then drawn here, as a Gaussian with the moments of one pixel behind the curve.
    """

    name: ClassVar[str] = "response"
    linear: ClassVar[bool] = False
    converts: ClassVar[bool] = True

    def apply(self, image: Image, capture: Capture) -> Image:
        """Encode by the curve."""
        if not capture.averages_behind_curve:
            return capture.camera.response.encode(image)
        mean, sigma = _behind_curve(image, capture)
        # Rounding to the refined steps, which follows, brings the rest of the pixels' rounding errors.
        rounding = np.sqrt((1 - 1 / capture.binned) / 12) / (2**capture.camera.bit_depth - 1)
        noise_of_mean = np.hypot(sigma, rounding) / np.sqrt(capture.binned)
        return np.asarray(
            mean + noise_of_mean * np.random.default_rng(capture.seed).standard_normal(image.shape)
        )

    def moments(self, mean: Image, variance: Image, capture: Capture) -> tuple[Image, Image]:
        """Multiply the variance by what the curve makes of that of one pixel's noise, clipping included."""
        camera = capture.camera
        if camera.response.is_linear:
            return mean, variance
        single = np.asarray(mean, dtype=float)
        before, behind = camera.pixel_noise(single, 1.0), camera.behind_curve(single)[1]
        # A pixel without noise has none behind the curve but what the table of the curve leaves.
        share = np.divide(behind, before, out=np.zeros_like(single), where=before > 0)
        return camera.response.encode(mean), variance * share**2


class Quantisation(ImagingStep):
    """The converter rounds to its steps and cuts to its range."""

    name: ClassVar[str] = "quantisation"
    linear: ClassVar[bool] = False
    converts: ClassVar[bool] = True

    def apply(self, image: Image, capture: Capture) -> Image:
        """Round and cut."""
        if capture.seed is not None:
            image = np.round(image * capture.steps) / capture.steps
        return np.asarray(np.clip(image, 0.0, 1.0), dtype=np.float32)

    def moments(self, mean: Image, variance: Image, capture: Capture) -> tuple[Image, Image]:
        """Add the variance of rounding errors, those of averaged pixels included."""
        steps = 2**capture.camera.bit_depth - 1
        return np.clip(mean, 0.0, 1.0), variance + 1 / (12 * capture.binned * steps**2)


class Linearisation(ImagingStep):
    """Whoever reads the picture undoes the response curve that the camera is known to have."""

    name: ClassVar[str] = "linearisation"
    linear: ClassVar[bool] = False
    converts: ClassVar[bool] = True

    def apply(self, image: Image, capture: Capture) -> Image:
        """Decode by the curve."""
        return np.asarray(capture.camera.response.decode(image), dtype=np.float32)

    def moments(self, mean: Image, variance: Image, capture: Capture) -> tuple[Image, Image]:
        """Divide the variance by the square of the curve's slope."""
        linear = capture.camera.response.decode(mean)
        return linear, variance / capture.camera.response.slope(linear) ** 2


CHAIN: tuple[ImagingStep, ...] = (
    Lens(),
    FallOff(),
    EffectsOnLight(),
    Mixing(),
    Exposing(),
    PixelNoise(),
    BlackLevel(),
    EffectsOnSignal(),
    Response(),
    Quantisation(),
    Linearisation(),
)
"""The steps, in the order in which light and signal pass them."""


def through_optics(light: Image, capture: Capture) -> Image:
    """Light behind the camera's optics, from light in front of them: the steps before `Mixing`.

    Parameters
    ----------
    light : array, shape (groups, rows, columns)
        Light of every LED group at unit flux, of the wider view that `capture.place` lies in.
    capture : Capture
        How the picture is taken.
    """
    for step in CHAIN[: _mixing()]:
        light = step.apply(light, capture)
    return light


def mixed(light: Image, weights: Array) -> Array:
    """Linear radiance of the channels, (rows, columns, 3), from light (groups, rows, columns)."""
    return np.asarray(np.einsum("cg,grk->rkc", weights, light))


def reported(radiance: Image, capture: Capture) -> NDArray[np.float32]:
    """Picture that the camera reports, its known curve undone: the steps after `Mixing`.

    Parameters
    ----------
    radiance : array, shape (rows, columns, 3)
        Mixed radiance.
    capture : Capture
        How the picture is taken; with a seed, noise is drawn.
    """
    for step in CHAIN[_mixing() + 1 :]:
        radiance = step.apply(radiance, capture)
    return np.asarray(radiance, dtype=np.float32)


def expected(radiance: Image, capture: Capture) -> Array:
    """Linear signal that is expected without noise, (rows, columns, 3), as a share of full scale.

    The converter is left out: within its range its curve is undone in what is measured.
    """
    for step in CHAIN[_mixing() + 1 :]:
        if not step.converts:
            radiance = step.apply(radiance, capture)
    return np.asarray(radiance, dtype=float)


def moments(radiance: Image, variance: Image, capture: Capture) -> tuple[Image, Image]:
    """Mean and variance of what the camera reports, from those of mixed radiance, (rows, columns, 3)."""
    capture = replace(capture, seed=None)  # every step gives its own moments
    for step in CHAIN[_mixing() + 1 :]:
        radiance, variance = step.moments(radiance, variance, capture)
    return radiance, variance


def noise_sigma(signal: Image, capture: Capture) -> Array:
    """Standard deviation of the noise of the picture that is reported, its known curve undone.

    Parameters
    ----------
    signal : array
        Mean of what pixels collect, as a share of full scale, without the black level; any shape.
    capture : Capture
        How the picture is taken, its exposure at 1.
    """
    signal = np.asarray(signal, dtype=float)
    return np.asarray(np.sqrt(moments(signal, np.zeros_like(signal), capture)[1]))


def mean_answers(answered: Callable[[Array], Array], camera: Camera, brightest: float) -> tuple[Array, Array]:
    """Mean answers of a camera whose pixels have their noise before they answer by a curve.

    Parameters
    ----------
    answered : callable
        Answers to signals, shape (..., 3).
    camera : Camera
        What the noise is of.
    brightest : float
        Highest level.

    Returns
    -------
    levels, answers : array, shapes (n,) and (n, 3)
        Signals without noise from zero to the highest level, and the mean answers of the three channels.
    """
    # Even steps of the root: a curve may be steep at zero.
    levels = brightest * np.linspace(0.0, 1.0, LEVELS) ** 2
    weights = np.exp(-(DEVIATES**2) / 2)
    signals = levels[:, None] + noise_sigma(levels - camera.black_level, Capture(camera))[:, None] * DEVIATES
    # The converter cuts at zero what its black level does not lift.
    answers = np.maximum(answered(np.repeat(signals[..., None], 3, axis=-1)), 0.0)
    return levels, np.tensordot(weights / weights.sum(), answers, axes=(0, 1))


def uncut(signal: Array, sigma: Array) -> Array:
    """Derivative of `clipped`: the share of the counts about a signal that are not cut."""
    share = np.ones(signal.shape)
    for channel in np.flatnonzero(sigma):
        share[..., channel] = ndtr(signal[..., channel] / sigma[channel])
    return share


def clipped(signal: Array, sigma: Array) -> Array:
    """Mean of counts about a signal when those below zero are cut to zero; channels of zero `sigma` stay.

    For Gaussian counts it is s Phi(s / sigma) + sigma phi(s / sigma), which tends to s well above the noise.
    """
    if not sigma.any():
        return signal
    found = signal.copy()
    for channel in np.flatnonzero(sigma):
        ratio = signal[..., channel] / sigma[channel]
        density = np.exp(-(ratio**2) / 2) / np.sqrt(2 * np.pi)
        found[..., channel] = sigma[channel] * (ratio * ndtr(ratio) + density)
    return found


def _deviates(seed: int, shape: tuple[int, ...]) -> tuple[np.random.Generator, NDArray[np.float32]]:
    """Standard normal deviates of a seed, and the generator that has drawn them."""
    deviates, state = _drawn(seed, shape)
    random = np.random.default_rng(seed)
    random.bit_generator.state = state
    return random, deviates


@lru_cache(maxsize=4)  # drawing takes a third of the time of a picture, which is often taken again
def _drawn(seed: int, shape: tuple[int, ...]) -> tuple[NDArray[np.float32], Any]:
    random = np.random.default_rng(seed)
    deviates = random.standard_normal(shape, dtype=np.float32)
    deviates.flags.writeable = False
    return deviates, random.bit_generator.state


def _mixing() -> int:
    """Place of `Mixing` in the chain."""
    return next(place for place, step in enumerate(CHAIN) if isinstance(step, Mixing))


def _behind_curve(signal: Image, capture: Capture) -> tuple[Array, Array]:
    """Mean and standard deviation of one sensor pixel behind effects and curve, before quantisation."""
    camera, effects = capture.camera, capture.effects
    if effects is None:
        return camera.behind_curve(signal)

    def answers(values: Array, channel: int) -> Array:
        three = effects.on_signal(np.repeat(values[..., None], CHANNELS, axis=-1))
        return np.clip(camera.response.encode(three), 0.0, 1.0)[..., channel]  # cut before the average

    found = [
        camera.behind_curve(signal[..., channel], partial(answers, channel=channel))
        for channel in range(CHANNELS)
    ]
    mean, sigma = (np.stack(part, axis=-1) for part in zip(*found, strict=True))
    return mean, sigma
