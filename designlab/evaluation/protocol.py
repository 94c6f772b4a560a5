"""The evaluation protocol takes pictures of presses as a camera does, and reconstructs them."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from designlab.core.metrics import normal_error_deg
from designlab.core.types import Array, Mask
from designlab.reconstruction import KernelCalibration, NearField, blended, fit_kernel, normals
from designlab.reconstruction.kernel import GradientEstimate
from designlab.reconstruction.markers import Markers, without
from designlab.reconstruction.pictures import colour_change, level_of, noise_share, smoothing_for
from designlab.sensor.design import Design
from designlab.simulation import imaging
from designlab.simulation.effects.model import SensorModel
from designlab.simulation.imaging import Capture, reported
from designlab.simulation.simulator import Frame
from geometries.elastomer import base_gradient

Thing = TypeVar("Thing")
MOST_THREADS = 4  # beyond these NumPy's own lock leaves no gain

# Errors count over the contact grown by this: a flat background would make any median look good.
GROWN_MM = 0.5
MOVED_SHARE = 0.02  # of the largest height: gel that is higher or lower than that has moved
SMOOTHING_PX = 2.0  # illumination is smooth; render noise is not, and would pass for unevenness
# Of the near field: pixels of simulated presses differ from its model by some 3 %; most slopes are gentle.
MODEL_ERROR, EXPECTED_SLOPE = 0.03, 0.5


def sub_seed(seed: int, stage: int, number: int) -> int:
    """Independent seed of one draw."""
    return int(np.random.SeedSequence([seed, stage, number]).generate_state(1)[0])


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """One test press: the picture, what was reconstructed from it, and the truth."""

    frame: Frame
    image: NDArray[np.float32]
    normals: Array
    true_normals: Array
    height_mm: Array
    region: NDArray[np.bool_]
    error_deg: Array

    @property
    def moved(self) -> NDArray[np.bool_]:
        """Pixels that see gel raised or lowered: where gel bulges, more than the region that counts."""
        return np.asarray(
            np.abs(self.frame.height_mm) > MOVED_SHARE * float(self.frame.surface.height_mm.max())
        )

    @property
    def height_error_um(self) -> Array:
        """Errors of height in the region that counts, one a pixel."""
        return np.asarray(1000 * (self.height_mm - self.frame.height_mm)[self.region])


@dataclass(frozen=True)
class EvaluationProtocol:
    """Camera and reconstruction around rendered frames.

    `model` has the effects that act on the camera's signal, `markers` the printed dots that `with_markers`
    found, which are filled in as `reconstruct` fills them in.
    """

    design: Design
    exposure: float
    seed: int
    model: SensorModel | None = None
    markers: Markers | None = None

    def with_markers(self, untouched: Frame, again: Frame) -> Self:
        """Find the printed markers of the untouched gel, if the design has any."""
        if not self.design.optics.marker_pitch_mm:
            return self
        return replace(self, markers=Markers.found_in(self._mean(untouched, again)))

    def capture(self, *, seed: int | None = None, binned: float = 1.0) -> Capture:
        """How the camera takes a picture; without a seed, without noise."""
        return Capture(self.design.camera, self.model, exposure=self.exposure, seed=seed, binned=binned)

    def picture(self, frame: Frame, number: int) -> NDArray[np.float32]:
        """What the camera reports, the curve of the design undone; its noise follows from the number."""
        capture = self.capture(seed=sub_seed(self.seed, 4, number), binned=_binned(frame))
        return reported(frame.mixed, capture)

    def background(self, untouched: Frame, again: Frame) -> NDArray[np.floating]:
        """Picture of the untouched gel that presses are compared with."""
        # A lab averages many frames of it; smoothing stands for that.
        mean = self._mean(untouched, again)
        if self.markers is not None:
            mean = without(mean, self.markers.covered)
        return np.asarray(gaussian_filter(mean, sigma=(SMOOTHING_PX, SMOOTHING_PX, 0)))

    def _mean(self, untouched: Frame, again: Frame) -> NDArray[np.floating]:
        return np.asarray((self.picture(untouched, 0) + self.picture(again, 1)) / 2)

    def bare(self, image: NDArray[np.float32]) -> tuple[NDArray[np.float32], Mask | None]:
        """A picture whose printed markers are filled in from around, and where they were."""
        if self.markers is None:
            return image, None
        covered = self.markers.followed(image).covered
        return without(image, covered).astype(np.float32), covered

    def calibrate(self, untouched: Frame, again: Frame, balls: Sequence[Frame]) -> KernelCalibration:
        """Calibrate on the balls."""
        background = np.asarray(self.background(untouched, again), dtype=float)
        x, y = untouched.rays.x_mm, untouched.rays.y_mm
        pictures = each_of(lambda k: self.bare(self.picture(balls[k], 10 + k)), len(balls))
        images, covered = zip(*pictures, strict=True)
        truths = each_of(lambda k: balls[k].gradient, len(balls))
        shares = [self._noise_share(ball, 10 + number, background) for number, ball in enumerate(balls)]
        return fit_kernel(
            images,
            background,
            [p for p, _ in truths],
            [q for _, q in truths],
            x,
            y,
            smoothing_px=smoothing_for(shares),
            covered=covered,
        )

    def _noise_share(self, ball: Frame, number: int, background: Array) -> float:
        """Noise of the camera in a picture of a ball, as a share of the change of colour in its contact."""
        clean = np.asarray(reported(ball.mixed, self.capture(binned=_binned(ball))), dtype=float)
        noise = (self.picture(ball, number) - clean) / level_of(background)
        return noise_share(noise, colour_change(clean, background), ball.contact)

    def reconstruct(
        self, calibration: KernelCalibration, tests: Sequence[Frame], *, numbers: Sequence[int] | None = None
    ) -> list[Reconstruction]:
        """Reconstruct test presses; of those with equal numbers, the camera's noise is the same."""
        chosen = range(len(tests)) if numbers is None else numbers
        return each_of(
            lambda k: self._one(calibration, tests[k], self.picture(tests[k], 100 + chosen[k])), len(tests)
        )

    def near_field(self, untouched: Frame, response: NDArray[np.floating]) -> NearField:
        """Light of the untouched gel as the camera sees it, from which presses need no calibration.

        Parameters
        ----------
        untouched : Frame
            The untouched gel.
        response : array, shape (groups, rows, columns, 2)
            What `Simulator.slope_response` gives.
        """
        camera, mix = self.design.camera, self.exposure * untouched.weights
        stray = np.zeros_like(untouched.basis) if untouched.stray is None else untouched.stray

        def noise_sigma(signal: Array) -> Array:
            collected = np.clip(signal, camera.black_level, 1.0) - camera.black_level
            return imaging.noise_sigma(collected, Capture(camera, self.model, binned=_binned(untouched)))

        light = gaussian_filter(untouched.basis - stray, sigma=(0, SMOOTHING_PX, SMOOTHING_PX))
        base_p, base_q = base_gradient(self.design.elastomer, *untouched.seen_mm)
        return NearField.of(
            np.maximum(light, 0.0),
            response,
            mix,
            noise_sigma=noise_sigma,
            offset=imaging.expected(imaging.mixed(stray, untouched.weights), self.capture()),
            base=(np.nan_to_num(base_p), np.nan_to_num(base_q)),
            reflectance=self.design.per_group("membrane_albedo"),
            model_error=MODEL_ERROR,
            expected_slope=EXPECTED_SLOPE,
        )

    def _one(
        self, calibration: KernelCalibration, frame: Frame, image: NDArray[np.float32]
    ) -> Reconstruction:
        image, filled = self.bare(image)
        found = calibration.estimate(image, filled=filled)
        true_p, true_q = frame.gradient
        base_p, base_q = base_gradient(self.design.elastomer, *frame.seen_mm)
        height_mm = _height_mm(found, frame)
        p, q = blended(found.p, found.q, height_mm, pitch_mm=frame.rays.pitch_mm)
        estimated = normals(p + base_p, q + base_q)
        truth = normals(true_p + base_p, true_q + base_q)
        region = error_region(frame)
        return Reconstruction(
            frame=frame,
            image=image,
            normals=estimated,
            true_normals=truth,
            height_mm=height_mm,
            region=region,
            error_deg=normal_error_deg(estimated, truth),
        )


def each_of(work: Callable[[int], Thing], count: int) -> list[Thing]:
    """Do independent pieces of work side by side; a core is left for what runs beside them."""
    threads = min((os.cpu_count() or 1) - 1, MOST_THREADS)
    if threads < 2:
        return [work(k) for k in range(count)]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, range(count)))


def _height_mm(found: GradientEstimate, frame: Frame) -> Array:
    """Height above the undeformed membrane, from the border of the picture inwards.

    Slopes leave an offset open. Kernel contact has its border at 0; where a bulge reaches it, the border is
    as high as it truly is on average.
    """
    height_mm = found.height_mm(pitch_mm=frame.rays.pitch_mm)
    if not frame.surface.bulges:
        return height_mm
    true = frame.height_mm
    border = np.concatenate([true[0], true[-1], true[1:-1, 0], true[1:-1, -1]])
    return height_mm + float(border.mean())


def _binned(frame: Frame) -> float:
    """Sensor pixels in a pixel of the picture; a picture finer than the sensor is not noisier for it."""
    return max(frame.rays.binned, 1.0)


def error_region(frame: Frame) -> NDArray[np.bool_]:
    """Pixels on and around the contact of a press, in which errors count."""
    touched, radius_px = frame.contact, GROWN_MM / frame.rays.pitch_mm[0]
    return np.asarray(distance_transform_edt(~touched) <= radius_px) & touched.any()
