"""The noise model says how far a perfect model may miss: camera noise, and the error granted to simulation.

The granted error has four parts. Three are white, shares of the signal, of its curvature and of what a press
changes: they belong to the standard deviation of every value. The fourth is smooth over the picture and the
same in all frames, as that of a light source known to a limited accuracy is; fits count it as covariance, so
that small effects of large pictures are not taken for certain. Behind a core light is counted in photons, and
Monte Carlo noise comes on top: it is measured, and mostly the same in all frames, see `monte_carlo_noise`.

No real sensor is lit just as its drawing says: strips have gaps, boards and walls reflect. So the light of
each LED group has a further smooth error, of longer waves, relative to it at each place, whose size is fitted
with every model, see `normal_equations.fitted_size`; and single frames have grain that repeats share, whose
size is measured, see `grain`.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn
from scipy.ndimage import gaussian_laplace

from designlab.core.types import Array
from designlab.measurement.shots import Shot

# Two programs that share no code agree to 0.1 % (rms) on balls and differ by 2 % of the curvature at edges.
SIGNAL_BUDGET = 0.0015
EDGE_BUDGET = 0.03
CONTACT_BUDGET = 0.02  # share of what a press changes: neither probe nor contact model are better known
SMOOTH_BUDGET = 0.005  # smooth error common to all frames, relative: what no catalogue lists, too
SHOT_BUDGET = 0.001  # smooth error of each frame, relative
# Like `normal_equations.ALIKE`: their covariance has counted already how much values err alike.
SMOOTH_ALIKE = 2.0
SMOOTH_LENGTH = 0.15  # of smooth errors, over the picture's width
LONG_LENGTH = 0.25  # likewise, of the part whose size is fitted: boards and walls act from afar
WEAK = 1e-3  # variance of a wave, over the most, below which it is none
EDGE_WIDTH_PX = 0.7
DARK_LIGHT = 0.03  # of full scale: below, smooth errors are absolute
LEAST_VARIANCE = 0.02  # of a coefficient: what is estimated may not make it certain


@dataclass(frozen=True, eq=False)
class MonteCarloNoise:
    """Random error of the simulation's picture of a shot.

    Attributes
    ----------
    sigma : array, shape (rows, columns, 3)
        Standard deviation, in the unit of the signal.
    shared : array, shape (3,)
        Relative variance that all shots have in common.
    power : array, shape (rows, columns)
        Power in the coefficients of a cosine transform, one in the mean.
    """

    sigma: Array
    shared: Array
    power: Array


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviations of a shot's values.

    Attributes
    ----------
    sigma : array, shape (rows, columns, 3)
        Of a value: camera and white errors of the simulation.
    camera : array, shape (rows, columns, 3)
        Of camera and grain alone.
    granted : array, shape (rows, columns, 3)
        Of camera, grain and smooth errors granted: what a model that is right is expected to miss by.
    level : array, shape (3,)
        Root mean square of signal over sigma, what smooth relative errors of the shot are multiples of. Dark
        signal counts as if it were brighter, for errors that are not relative.
    all_level : array, shape (3,)
        Root mean square of all light over sigma, what the granted error that shots share is a multiple of.
    groups : array, shape (groups, rows, columns, 3), or None
        Light of each LED group over sigma, which smooth errors of fitted size are relative to at each place;
        None where there are none.
    random : MonteCarloNoise or None
        Random error of the simulation, part of sigma; None where it is below what is granted anyway.
    shot : float
        Smooth error of the shot alone, relative.
    """

    sigma: Array
    camera: Array
    granted: Array
    level: Array
    all_level: Array
    groups: NDArray[np.float32] | None = None
    random: MonteCarloNoise | None = None
    shot: float = SHOT_BUDGET

    @cached_property
    def alone(self) -> Array:
        """Variance of coefficients, in units of sigma, that no other shot shares, (rows, columns, 3)."""
        power = spectrum(self.sigma.shape[:2])[..., None]
        found = 1.0 + (self.shot * self.level) ** 2 * power
        if self.random is None:
            return found
        share = ((self.random.sigma / self.sigma) ** 2).mean(axis=(0, 1))
        own = np.maximum(share - self.random.shared * self.all_level**2, 0.0)
        return np.asarray(np.maximum(found - share + own * self.random.power[..., None], LEAST_VARIANCE))

    @cached_property
    def waves(self) -> NDArray[np.float32]:
        """Coefficients of long waves of each group's light, over the root of `alone`.

        Shape (groups x waves, rows, columns, 3); none without `groups`.
        """
        if self.groups is None:
            return np.zeros((0, *self.sigma.shape), dtype=np.float32)
        shapes, _ = long_waves(self.sigma.shape[:2])
        light = (self.groups[:, None] * shapes[..., None]).reshape(-1, *self.sigma.shape)
        return np.asarray(transformed(light, axes=(1, 2)) / np.sqrt(self.alone), dtype=np.float32)

    @cached_property
    def wave_weight(self) -> Array:
        """Information about the waves, (groups x waves, groups x waves)."""
        rows = self.waves.reshape(len(self.waves), self.sigma.size)
        return np.asarray(rows @ rows.T, dtype=float)

    def common(self, *, mean: bool = True, share: float = 1.0) -> Array:
        """Variance of coefficients, relative to the light, that all shots share, (rows, columns, 3).

        Without `mean` the mean of the picture, which gains are fitted for, is left out of smooth errors.
        Of their variance `share` counts.
        """
        power = spectrum(self.sigma.shape[:2])
        if not mean:
            power[0, 0] = 0.0
        found = share * SMOOTH_BUDGET**2 * np.repeat(power[..., None], 3, axis=-1)
        return found if self.random is None else found + self.random.shared * self.random.power[..., None]


def noise(
    shot: Shot,
    predicted: Array,
    untouched: Array,
    of_groups: Array | None,
    black: Array | float,
    random: MonteCarloNoise | None = None,
    *,
    grain: float = 0.0,
) -> Noise:
    """Noise of a shot about a prediction, and about that of the untouched gel (rows, columns, 3).

    `of_groups` is what each LED group adds to the signal (groups, rows, columns, 3), None where no smooth
    error of theirs is fitted; `grain` is relative to the light.
    """
    light = predicted - black
    curvature = np.stack([gaussian_laplace(light[..., c], EDGE_WIDTH_PX) for c in range(3)], axis=-1)
    budget = np.hypot(SIGNAL_BUDGET * light, EDGE_BUDGET * curvature)
    budget = np.hypot(budget, CONTACT_BUDGET * (predicted - untouched))
    camera = np.hypot(np.sqrt(shot.variance), grain * light)
    traced = 0.0 if random is None else random.sigma
    sigma = np.hypot(np.hypot(camera, budget), traced)
    lit = np.hypot(light, DARK_LIGHT)
    level = np.sqrt(np.where(shot.valid, (lit / sigma) ** 2, 0.0).mean(axis=(0, 1)))
    all_level = np.sqrt(np.where(shot.valid, (light / sigma) ** 2, 0.0).mean(axis=(0, 1)))
    groups = None if of_groups is None else np.where(shot.valid, of_groups / sigma, 0.0).astype(np.float32)
    granted = np.hypot(np.hypot(camera, np.hypot(SMOOTH_BUDGET, SHOT_BUDGET) * lit), traced)
    return Noise(sigma, camera, granted, level, all_level, groups, random)


def spectrum(shape: tuple[int, int], length: float = SMOOTH_LENGTH) -> Array:
    """Power of a smooth error of unit variance in the coefficients of a cosine transform, (rows, columns)."""
    rows, columns = shape
    length_px = length * columns
    ky, kx = np.pi * np.arange(rows) / rows, np.pi * np.arange(columns) / columns
    power = np.exp(-((ky[:, None] ** 2 + kx[None, :] ** 2) * length_px**2) / 2)
    return np.asarray(power / power.mean())


@lru_cache(maxsize=8)
def long_waves(shape: tuple[int, int]) -> tuple[NDArray[np.float32], Array]:
    """Long waves over a picture, (waves, rows, columns), and the variance of each in an error of unit size.

    The mean, which gains are fitted for, is left out, and so are waves that say nothing of the size.
    """
    power = spectrum(shape, LONG_LENGTH)
    power[0, 0] = 0.0
    told = np.argwhere(power > WEAK * power.max())
    along = [
        np.sqrt(np.where(number > 0, 2.0, 1.0))[:, None]
        * np.cos(np.pi * number[:, None] * (np.arange(side) + 0.5) / side)
        for number, side in zip(told.T, shape, strict=True)
    ]
    return np.einsum("kr,kc->krc", *along).astype(np.float32), power[tuple(told.T)] / power.size


def transformed(values: NDArray[np.floating], *, axes: tuple[int, int] = (0, 1)) -> NDArray[np.float32]:
    """Orthonormal cosine transform over rows and columns, which are the first axes unless told otherwise."""
    return np.asarray(dctn(values.astype(np.float32), axes=axes, norm="ortho"), dtype=np.float32)
