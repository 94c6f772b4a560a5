"""Response maps hold, for each pixel, signal, noise and response to slope of the gel and of test presses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from designlab.core.types import Array, Mask
from designlab.evaluation import illumination, noise_limit
from designlab.evaluation.illumination import within
from designlab.evaluation.protocol import SMOOTHING_PX, EvaluationProtocol, Reconstruction, sub_seed
from designlab.evaluation.weakest_point import GelMaps, PressMaps
from designlab.sensor.design import Design
from designlab.simulation.imaging import Capture, expected, mixed, noise_sigma
from designlab.simulation.simulator import Frame, Simulator
from geometries.elastomer import base_mm

Pixels = tuple[slice, slice]

LEAST_LEVEL = 0.01  # of the brightest: noise does not vanish where it is darker
RESPONSE_DRAWS = 10
DETAIL_COLUMNS = 160  # of the maps: they need no finer ones
STEEP_PERCENTILE = 99.0


def sensing_area(design: Design, frame: Frame) -> Mask:
    """Pixels of a frame of the untouched gel that see the sensing area."""
    return design.sensing_area.holds(*counted_at(design, frame))


def counted_at(design: Design, frame: Frame) -> tuple[Array, Array]:
    """Points (x, y) in mm by which pixels of a frame of the untouched gel count.

    Those of the membrane. Where the sensing area is a rectangle they are those of the plane that touches its
    apex, as in all scores on record: under a dome they lie further out.
    """
    if design.sensing_area_shape == "rectangle":
        return frame.rays.x_mm, frame.rays.y_mm
    return frame.seen_mm


def seen(design: Design, frame: Frame) -> Mask:
    """Pixels of a frame's view that lie on the camera's sensor and see the membrane."""
    camera = design.camera
    rows, columns = frame.rays.x_mm.shape
    column, row = design.view(columns).centres()
    on_sensor = (column >= 0) & (column <= camera.width_px) & (row >= 0) & (row <= camera.height_px)
    assert on_sensor.shape == (rows, columns)
    gel = design.elastomer
    x, y = counted_at(design, frame)
    on_gel = within(x, y, (gel.width_mm, gel.length_mm)) & np.isfinite(base_mm(gel, x, y))
    return np.asarray(on_sensor & on_gel)


def thinned(frame: Frame) -> Pixels:
    """Every few pixels of a frame, at least `DETAIL_COLUMNS` columns of them if it has as many."""
    step = step_of(frame)
    return slice(None, None, step), slice(None, None, step)


def step_of(frame: Frame) -> int:
    """Step between the `thinned` pixels of a frame."""
    return max(1, int(frame.rays.x_mm.shape[1]) // DETAIL_COLUMNS)


def signal_of(
    protocol: EvaluationProtocol, frame: Frame, pixels: Pixels = (slice(None), slice(None))
) -> Array:
    """Linear signal as a share of full scale, black level included, shape (rows, columns, channels)."""
    return expected(mixed(frame.basis[:, *pixels], frame.weights), protocol.capture())


@dataclass(frozen=True, eq=False)
class Responses:
    """Response to slope of each LED group's light from the membrane, on `thinned` pixels.

    Attributes
    ----------
    best : array, shape (rows, columns, groups, 2)
        Derivative of a frame's basis by the slopes along x and y.
    others : sequence of arrays of the same shape
        As it might be as well.
    factor : float
        What makes a standard error of the scatter of figures of `others`.
    """

    best: Array
    others: Sequence[Array]
    factor: float

    def figures(self, of: Callable[[Array], Any]) -> tuple[Array, Array]:
        """Figures of the best response, and their standard errors."""
        others = [of(other) for other in self.others]
        return np.asarray(of(self.best)), np.asarray(self.factor * np.std(others, axis=0))


def slope_responses(simulator: Simulator, untouched: Frame, balls: Sequence[Frame]) -> Responses:
    """Sum over the directions of the light field; without one, as on ``scalar_rgb``, fitted to the balls."""
    if not simulator.has_light_field:
        fitted = _fitted_responses(untouched, balls)
        return Responses(fitted[0], fitted[1:], np.sqrt(len(balls) - 1))  # the jackknife
    thin = thinned(untouched)
    best, half = (
        np.moveaxis(simulator.slope_response(half=number)[:, *thin], 0, 2).astype(float)
        for number in (None, 0)
    )
    noise = half - best
    random = np.random.default_rng(sub_seed(simulator.seed, 7, 1))
    light = membrane_light(untouched)[thin][..., None]
    others = [best + drawn(noise, light, random, images=(2,)) for _ in range(RESPONSE_DRAWS)]
    return Responses(best, others, np.sqrt(RESPONSE_DRAWS / (RESPONSE_DRAWS - 1)))


def drawn(
    noise: NDArray[np.floating],
    level: NDArray[np.floating],
    random: np.random.Generator,
    *,
    images: tuple[int, ...],
) -> NDArray[np.floating]:
    """Another draw of the noise of a stack of images: shifted as a whole, its sign changed at random.

    A difference of two renders shows the noise of each place once; elsewhere in the picture it is alike, but
    for its growth with the root of the level. Its grain stays as it is.

    Parameters
    ----------
    noise : array
        Noise of a stack of images.
    level : array, of a shape that fits it
        What the power of the noise follows: the light there, or that power itself.
    random : Generator
        Of shifts and signs.
    images : tuple of int
        Axes along which images are counted, each with a sign of its own; the first two others are rows and
        columns.
    """
    rows, columns = (axis for axis in range(noise.ndim) if axis not in images and axis < 3)
    floor = LEAST_LEVEL * np.abs(level).max(axis=(rows, columns), keepdims=True)
    root = np.sqrt(np.maximum(level, np.maximum(floor, 1e-30)))
    shift = [int(random.integers(noise.shape[axis])) for axis in (rows, columns)]
    signs = random.choice(
        [-1.0, 1.0], size=[noise.shape[axis] if axis in images else 1 for axis in range(noise.ndim)]
    )
    return np.asarray(signs * np.roll(noise / root, shift, axis=(rows, columns)) * root)


def _fitted_responses(untouched: Frame, balls: Sequence[Frame]) -> list[Array]:
    """All balls, then each left out in turn, see `noise_limit.responses`."""
    thin = thinned(untouched)
    rays = untouched.rays
    return noise_limit.responses(
        [membrane_light(ball)[thin] for ball in balls],
        gaussian_filter(membrane_light(untouched), (SMOOTHING_PX, SMOOTHING_PX, 0))[thin],
        [(p[thin], q[thin]) for p, q in (ball.gradient for ball in balls)],
        rays.x_mm[thin],
        rays.y_mm[thin],
    )


def membrane_light(frame: Frame) -> Array:
    """Light of each group straight from the membrane, shape (rows, columns, groups)."""
    basis = frame.basis if frame.stray is None else frame.basis - frame.stray
    return np.moveaxis(np.asarray(basis, dtype=float), 0, -1)


def gel_maps(protocol: EvaluationProtocol, untouched: Frame, response: Array) -> GelMaps:
    """Maps in which the worst place of the untouched gel is looked for, on the pixels of the response.

    Parameters
    ----------
    protocol : EvaluationProtocol
        Camera and exposure.
    untouched : Frame
        The untouched gel.
    response : array, shape (rows, columns, groups, 2)
        The best of `slope_responses`.
    """
    design, camera = protocol.design, protocol.design.camera
    thin = thinned(untouched)
    smooth = [gaussian_filter(i, SMOOTHING_PX, mode="nearest")[thin] for i in untouched.basis]
    light = np.stack(smooth, axis=-1)
    area = sensing_area(design, untouched)[thin]
    visible = seen(design, untouched)[thin]
    mix = protocol.exposure * untouched.weights
    signal = light @ mix.T
    stray = np.zeros_like(light) if untouched.stray is None else np.moveaxis(untouched.stray, 0, -1)[thin]
    binned = max(untouched.rays.binned, 1.0)
    x, y = counted_at(design, untouched)
    return GelMaps(
        x_mm=x[thin],
        y_mm=y[thin],
        area=area,
        seen=visible,
        saturated=illumination.saturated(signal_of(protocol, untouched, thin)),
        light=light / light[area & visible].mean(axis=0),
        signal=signal,
        stray=stray @ mix.T,
        sigma=noise_sigma(signal, Capture(camera, binned=binned)),
        response=np.einsum("cg,rkgi->rkci", mix, response),
    )


def press_maps(
    protocol: EvaluationProtocol, untouched: Frame, results: Sequence[Reconstruction]
) -> list[PressMaps]:
    """Maps in which the worst place of the test presses is looked for, on the pixels of `gel_maps`."""
    thin = thinned(untouched)
    rays = untouched.rays
    away = np.stack([rays.slope_x, rays.slope_y, np.ones_like(rays.x_mm)], axis=-1)[thin]
    away /= np.linalg.norm(away, axis=-1, keepdims=True)
    floor = 1e-3 * untouched.basis.mean(axis=(1, 2), keepdims=True)
    found = []
    for result in results:
        frame = result.frame
        assert frame.press is not None
        p, q = frame.gradient
        relative = frame.basis[:, *thin] / np.maximum(untouched.basis, floor)[:, *thin]
        found.append(
            PressMaps(
                error_deg=result.error_deg[thin],
                region=result.region[thin],
                saturated=illumination.saturated(signal_of(protocol, frame, thin)),
                light=np.moveaxis(relative, 0, -1),
                slope=np.hypot(p, q)[thin],
                facing=np.einsum("rki,rki->rk", result.true_normals[thin], away),
                name=frame.press.probe.text,
            )
        )
    return found


def steepest_slope(balls: Sequence[Frame]) -> float:
    """Slope that 99 % of the pixels on the calibration balls' flanks do not exceed."""
    slopes = [np.hypot(*(g[thinned(ball)] for g in ball.gradient)) for ball in balls]
    flanks = np.concatenate([slope[slope > noise_limit.GENTLEST] for slope in slopes])
    return float(np.percentile(flanks, STEEP_PERCENTILE))
