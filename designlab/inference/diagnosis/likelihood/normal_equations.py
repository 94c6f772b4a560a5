"""Normal equations of all unknowns over many shots give steps, reduced information and evidence."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.emulator.state import State, Unknown
from designlab.inference.diagnosis.likelihood.noise import (
    SMOOTH_ALIKE,
    Noise,
    long_waves,
    transformed,
)

# Neighbouring values share the small errors that no noise model lists, so that their number says too much:
# the likelihood is raised to the power of one over this (coarsened posterior, Miller and Dunson 2019).
ALIKE = 32.0
MOST_TURNS = 10  # of each unknown to a bound and back
SIZES = np.array([0.0, *np.geomspace(0.002, 0.1, 60)])  # of a smooth error, relative, that are tried
WEAKEST = 1e-9  # power of smooth errors, over the most, that is none


@dataclass(frozen=True, eq=False)
class Shared:
    """What shots of one size show of smooth errors that they have in common.

    There is one of all light, of a size that is granted, told by coefficient and channel; and there are waves
    of the light of each LED group, relative to it at each place, whose size is fitted.

    Attributes
    ----------
    granted, total, weight : array, shape (n,)
        Variance of the granted error, sum of what is left of the shots, weighed by how much each tells of it,
        and information about it.
    power, wave_total : array, shape (waves,)
        Variance of the waves in an error of unit size, and the same sum for them.
    wave_weight : array, shape (waves, waves)
        Information about the waves.
    cross : array, shape (waves, n)
        Information about a wave that is also about the granted error.
    """

    granted: Array
    total: Array
    weight: Array
    power: Array
    wave_total: Array
    wave_weight: Array
    cross: Array

    @property
    def shrink(self) -> Array:
        """Variance that is left of the granted error, (n,)."""
        return np.asarray(self.granted / (1.0 + self.granted * self.weight))

    @cached_property
    def of_waves(self) -> Array:
        """Information about the waves beside the granted error, (waves, waves)."""
        return np.asarray(self.wave_weight - (self.cross * self.shrink) @ self.cross.T)

    @cached_property
    def _turned(self) -> tuple[Array, Array]:
        """Information about independent mixtures of waves of unit size, and the sum for them, (waves,)."""
        root = np.sqrt(self.power)
        values, vectors = np.linalg.eigh(root[:, None] * self.of_waves * root)
        total = self.wave_total - self.cross @ (self.shrink * self.total)
        return np.maximum(values, 0.0), vectors.T @ (root * total)

    def explained(self, smooth_rms: Array | float) -> tuple[Array, Array]:
        """How much less shots are off by with such errors, and the logarithm of their determinant.

        Sizes may have any shape, which both then have.
        """
        values, total = self._turned
        square = np.multiply.outer(np.asarray(smooth_rms) ** 2, np.ones(len(values)))
        less = float((self.shrink * self.total**2).sum())
        less = less + (square * total**2 / (1.0 + square * values)).sum(axis=-1)
        logdet = float(np.log1p(self.granted * self.weight).sum()) + np.log1p(square * values).sum(axis=-1)
        return less, logdet

    def beside(self, known: "Shared") -> "Shared":
        """Return the same of these shots and others."""
        return replace(
            self,
            total=self.total + known.total,
            weight=self.weight + known.weight,
            wave_total=self.wave_total + known.wave_total,
            wave_weight=self.wave_weight + known.wave_weight,
            cross=self.cross + known.cross,
        )


def fitted_size(parts: Iterable[Shared], alike: float) -> float:
    """Most likely size of the smooth errors of the light of LED groups, relative.

    Parameters
    ----------
    parts : iterable of Shared
        Of shots of each size.
    alike : float
        Neighbouring values that count as one.
    """
    lost = np.zeros(len(SIZES))
    for part in parts:
        less, logdet = part.explained(SIZES)
        lost += logdet - less / alike
    return float(SIZES[int(np.argmin(lost))])


@dataclass(frozen=True, eq=False)
class System:
    """Quadratic approximation of half the coarsened misfit in the neighbourhood of a state.

    Attributes
    ----------
    unknowns : tuple of Unknown
        What the columns stand for, in prior standard deviations.
    gram : array, shape (n, n)
        Fisher information.
    right : array, shape (n,)
        Its product with the step that fits best, priors left aside.
    misfit : float
        Squared residual at the state, coarsened, and the logarithm of the determinant of its covariance.
    now : array, shape (n,)
        Where the unknowns are, in prior standard deviations from null.
    shared : mapping of shape to Shared
        What the shots show of the error that they have in common.
    logdet : float
        The logarithm that is part of the misfit; the shots' values have no say in it.
    """

    unknowns: tuple[Unknown, ...]
    gram: Array
    right: Array
    misfit: float
    now: Array
    shared: Mapping[tuple[int, ...], Shared] = field(default_factory=dict)
    logdet: float = 0.0

    def reduced(self, kept: Sequence[int]) -> tuple[Array, Array]:
        """Information and right side of some unknowns, the others fitted along under their priors."""
        kept_ = np.asarray(kept, dtype=int)
        rest = np.setdiff1d(np.arange(len(self.unknowns)), kept_)
        inner = self.gram[np.ix_(rest, rest)] + np.eye(len(rest))
        cross = self.gram[np.ix_(kept_, rest)]
        right = self.right - self.now
        solved = np.linalg.solve(inner, np.column_stack([cross.T, right[rest]]))
        information = self.gram[np.ix_(kept_, kept_)] - cross @ solved[:, :-1]
        return information, right[kept_] - cross @ solved[:, -1]

    def only(self, chosen: Callable[[Unknown], bool]) -> "System":
        """System of some of the unknowns, the others held where they are."""
        kept = [k for k, unknown in enumerate(self.unknowns) if chosen(unknown)]
        unknowns = tuple(self.unknowns[k] for k in kept)
        return System(unknowns, self.gram[np.ix_(kept, kept)], self.right[kept], self.misfit, self.now[kept])

    def step(self, low: Array, high: Array, *, damping: float = 0.0) -> tuple[Array, float]:
        """Step of all unknowns under their priors within bounds, and the fall of the penalised misfit.

        Parameters
        ----------
        low, high : array, shape (n,)
            Bounds of the unknowns in prior standard deviations from null.
        damping : float
            Added to the information about every unknown: what the shots say little about hardly moves.
        """
        matrix = self.gram + (1.0 + damping) * np.eye(len(self.unknowns))
        right = self.right - self.now
        found = np.asarray(np.linalg.solve(matrix, right), dtype=float)
        low, high = low - self.now, high - self.now
        if (found < low).any() or (found > high).any():
            # Sums in single precision may take from the information what the priors hold: one at the least.
            values, vectors = np.linalg.eigh(matrix)
            roots = np.sqrt(np.maximum(values, 1.0))
            nearest = lsq_linear(
                roots[:, None] * vectors.T,
                vectors.T @ right / roots,
                (low, high),
                method="bvls",
                max_iter=MOST_TURNS * len(right),
            )
            found = np.clip(nearest.x, low, high)  # met but for rounding errors
        return found, float(2 * right @ found - found @ matrix @ found)


def system(
    forward: Forward,
    state: State,
    shots: Iterable[int],
    unknowns: Sequence[Unknown],
    noises: Sequence[Noise],
    now: Array,
    *,
    alike: float = ALIKE,
    smooth_alike: float = SMOOTH_ALIKE,
    known: Mapping[tuple[int, ...], Shared] | None = None,
) -> System:
    """Set up the normal equations of unknowns over shots at a state.

    Values are whitened by their noise, transformed by cosines, in which granted errors are independent, and
    weighed by the inverse of the covariance: of each coefficient it is what a shot has alone on the diagonal
    and what all have in common beyond (Sherman and Morrison 1950); waves of the groups' light, which are few,
    are unknowns that are integrated out. All is divided by `alike`, but smooth
    errors granted count as if divided by `smooth_alike`, and those whose size is fitted are not divided.
    `known` is what other shots have shown of the common error: the likelihood is that of these given those.
    """
    share = min(1.0, smooth_alike / alike)
    size = len(unknowns)
    gram, right, misfit = np.zeros((size, size)), np.zeros(size), 0.0
    common: dict[tuple[int, ...], _Sums] = {}
    for number in shots:
        shot, own = forward.bank.shots[number], noises[number]
        used = [k for k, u in enumerate(unknowns) if u.shot in (-1, number)]
        predicted, columns = forward.linear(state, number, [unknowns[k] for k in used])
        scale = np.where(shot.valid, 1.0 / own.sigma, 0.0).astype(np.float32)
        residual = np.asarray(shot.signal - predicted, dtype=np.float32)
        coefficients = transformed(np.concatenate([columns, residual[None]]) * scale, axes=(1, 2))
        weighed = np.asarray(coefficients / np.sqrt(own.alone), dtype=np.float32)
        rows = weighed.reshape(len(coefficients), -1)
        part = np.asarray(rows @ rows.T, dtype=float)
        gram[np.ix_(used, used)] += part[:-1, :-1]
        right[used] += part[:-1, -1]
        misfit += float(part[-1, -1])
        key = shot.signal.shape[:2]
        if key not in common:
            common[key] = _Sums(own, size, share, alike)
        common[key].add(coefficients, rows, [*used, size], own)
    logdet, shared = 0.0, {}
    for key, sums in common.items():
        shown = shared[key] = sums.shared()
        if before := (known or {}).get(key):
            shown = shown.beside(before)
            sums.total[-1] += before.total
            sums.waves[:, -1] += before.wave_total
            less, less_logdet = before.explained(state.smooth_rms)
            misfit, logdet = misfit + float(less), logdet - float(less_logdet - before.explained(0.0)[1])
        logdet += float(shown.explained(state.smooth_rms)[1] - shown.explained(0.0)[1])
        part = (sums.total * shown.shrink) @ sums.total.T
        root = state.smooth_rms * np.sqrt(shown.power)
        inner = root[:, None] * shown.of_waves * root + np.eye(len(root))
        sides = root[:, None] * (sums.waves - shown.cross @ (sums.total * shown.shrink).T)
        combined = np.linalg.solve(np.linalg.cholesky(inner), sides)
        part += combined.T @ combined
        gram -= part[:-1, :-1]
        right -= part[:-1, -1]
        misfit -= float(part[-1, -1])
    return System(tuple(unknowns), gram / alike, right / alike, misfit / alike + logdet, now, shared, logdet)


class _Sums:
    """Sums over shots of one size of what tells the errors that they have in common."""

    def __init__(self, noise: Noise, unknowns: int, share: float, alike: float) -> None:
        # The mean of all is what gains are fitted for.
        granted = noise.common(mean=False, share=share)
        # Smooth errors have few coefficients.
        self.strong = granted > WEAKEST * granted.max()
        self.granted = granted[self.strong]
        count = len(noise.waves)
        _, power = long_waves(noise.sigma.shape[:2])
        self.power = np.tile(power, count // len(power)) / alike
        self.total = np.zeros((unknowns + 1, len(self.granted)))
        self.weight = np.zeros(len(self.granted))
        self.waves = np.zeros((count, unknowns + 1))
        self.wave_weight = np.zeros((count, count))
        self.cross = np.zeros((count, len(self.granted)))

    def add(
        self,
        coefficients: NDArray[np.float32],
        rows: NDArray[np.float32],
        used: Sequence[int],
        noise: Noise,
    ) -> None:
        """Add a shot: coefficients of columns and of what is left, these weighed, and which they are of."""
        alone = np.broadcast_to(noise.alone, self.strong.shape)[self.strong]
        level = np.broadcast_to(noise.all_level, self.strong.shape)[self.strong]
        self.total[used] += level / alone * coefficients[:, self.strong]
        self.weight += level**2 / alone
        self.waves[:, used] += noise.waves.reshape(len(self.waves), rows.shape[1]) @ rows.T
        self.wave_weight += noise.wave_weight
        self.cross += level / np.sqrt(alone) * noise.waves[:, self.strong]

    def shared(self) -> Shared:
        """What the shots show."""
        total, wave_total = self.total[-1].copy(), self.waves[:, -1].copy()
        return Shared(self.granted, total, self.weight, self.power, wave_total, self.wave_weight, self.cross)


def log_evidence(information: Array, right: Array) -> float:
    """Logarithm of the Bayes factor of parameters against their null: Gaussian, priors of unit variance."""
    if not len(right):
        return 0.0
    matrix = information + np.eye(len(right))
    _, logdet = np.linalg.slogdet(matrix)
    return float(0.5 * right @ np.linalg.solve(matrix, right) - 0.5 * logdet)
