"""Normal equations of all unknowns over many shots give steps, reduced information and evidence."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.emulator.state import State, Unknown
from designlab.inference.diagnosis.likelihood.noise import (
    LONG_LENGTH,
    SMOOTH_ALIKE,
    Noise,
    spectrum,
    transformed,
)

# Neighbouring values share the small errors that no noise model lists, so that their number says too much:
# the likelihood is raised to the power of one over this (coarsened posterior, Miller and Dunson 2019).
ALIKE = 32.0
MOST_TURNS = 10  # of each unknown to a bound and back
SIZES = np.array([0.0, *np.geomspace(0.002, 0.1, 60)])  # of a smooth error, relative, that are tried
WEAK = 1e-4  # power of long waves, over the most, that tells nothing of their size
WEAKEST = 1e-9  # power of smooth errors, over the most, that is none


@dataclass(frozen=True, eq=False)
class Shared:
    """What shots of one size show of smooth errors that they have in common, by coefficient and channel.

    There is one of all light, of a size that is granted, and one of the light of each LED group, whose size
    is fitted; errors here are relative to the light.

    Attributes
    ----------
    total : array, shape (1 + groups, n)
        Sum of what is left of the shots, weighed by how much each tells of each error.
    weight : array, shape (1 + groups, 1 + groups, n)
        Information about the errors.
    granted, long : array, shape (n,)
        Variance of the error granted, and of those of unit size whose size is fitted.
    """

    total: Array
    weight: Array
    granted: Array
    long: Array

    def factors(self, smooth_rms: Array | float) -> tuple[Array, Array]:
        """Root of the errors' prior variance (1 + groups, n), and a triangular root of their information.

        That is of shape (n, 1 + groups, 1 + groups), of errors in units of that root. Sizes may have an axis
        of their own, which comes first.
        """
        fitted = np.multiply.outer(np.asarray(smooth_rms), np.sqrt(self.long))
        granted = np.broadcast_to(np.sqrt(self.granted), fitted.shape)
        root = np.stack([granted, *[fitted] * (len(self.total) - 1)], axis=-2)
        inner = root[..., :, None, :] * self.weight * root[..., None, :, :]
        return root, np.linalg.cholesky(np.moveaxis(inner, -1, -3) + np.eye(len(self.total)))

    def explained(self, smooth_rms: Array | float) -> tuple[Array, Array]:
        """How much less shots are off by with such errors, and the logarithm of their determinant."""
        root, lower = self.factors(smooth_rms)
        right = np.moveaxis(root * self.total, -2, -1)[..., None]
        less = (np.linalg.solve(lower, right) ** 2).sum(axis=(-3, -2, -1))
        return less, 2 * np.log(np.diagonal(lower, axis1=-2, axis2=-1)).sum(axis=(-2, -1))

    def only(self, told: NDArray[np.bool_]) -> "Shared":
        """Return the same of some of the coefficients."""
        return Shared(self.total[:, told], self.weight[..., told], self.granted[told], self.long[told])

    def beside(self, known: "Shared") -> "Shared":
        """Return the same of these shots and others."""
        return replace(self, total=self.total + known.total, weight=self.weight + known.weight)


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
        told = part.long > WEAK * part.long.max()
        less, logdet = part.only(told).explained(SIZES)
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

    Values are whitened by their noise, transformed by cosines, in which smooth errors are independent, and
    weighed by the inverse of the covariance: of each coefficient it is what a shot has alone on the diagonal
    and what all have in common beyond (Sherman and Morrison 1950). All is divided by `alike`, but smooth
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
        rows = (coefficients / np.sqrt(own.alone).astype(np.float32)).reshape(len(coefficients), -1)
        part = np.asarray(rows @ rows.T, dtype=float)
        gram[np.ix_(used, used)] += part[:-1, :-1]
        right[used] += part[:-1, -1]
        misfit += float(part[-1, -1])
        key = shot.signal.shape[:2]
        if key not in common:
            common[key] = _Sums(own, size, share, alike)
        common[key].add(coefficients, [*used, size], own)
    logdet, shared = 0.0, {}
    for key, sums in common.items():
        shown = shared[key] = sums.shared()
        if before := (known or {}).get(key):
            shown = shown.beside(before)
            sums.total[:, -1] += before.total
            less, less_logdet = before.explained(state.smooth_rms)
            misfit, logdet = misfit + float(less), logdet - float(less_logdet - before.explained(0.0)[1])
        logdet += float(shown.explained(state.smooth_rms)[1] - shown.explained(0.0)[1])
        root, lower = shown.factors(state.smooth_rms)
        sides = np.moveaxis(root[:, None] * sums.total, -1, 0)  # (n, 1 + groups, unknowns and residual)
        combined = np.linalg.solve(lower, sides).reshape(-1, size + 1)
        part = combined.T @ combined
        gram -= part[:-1, :-1]
        right -= part[:-1, -1]
        misfit -= float(part[-1, -1])
    return System(tuple(unknowns), gram / alike, right / alike, misfit / alike + logdet, now, shared, logdet)


class _Sums:
    """Sums over shots of one size of what tells the errors that they have in common."""

    def __init__(self, noise: Noise, unknowns: int, share: float, alike: float) -> None:
        # The mean of all is what gains are fitted for.
        granted = noise.common(mean=False, share=share)
        long = np.repeat(spectrum(noise.sigma.shape[:2], LONG_LENGTH)[..., None], 3, axis=-1) / alike
        long[0, 0] = 0.0
        # Smooth errors have few coefficients.
        self.strong = granted > WEAKEST * granted.max()
        self.granted, self.long = granted[self.strong], long[self.strong]
        sources = len(noise.levels)
        self.total = np.zeros((sources, unknowns + 1, len(self.granted)))
        self.weight = np.zeros((sources, sources, len(self.granted)))

    def add(self, coefficients: NDArray[np.float32], used: Sequence[int], noise: Noise) -> None:
        """Add a shot: coefficients of columns and of what is left, and which of the unknowns they are of."""
        alone = np.broadcast_to(noise.alone, self.strong.shape)[self.strong]
        levels = np.broadcast_to(noise.levels[:, None, None], (len(noise.levels), *self.strong.shape))
        levels = levels[:, self.strong]
        self.total[:, used] += (levels / alone)[:, None] * coefficients[:, self.strong]
        self.weight += levels[:, None] * levels / alone

    def shared(self) -> Shared:
        """What the shots show."""
        return Shared(self.total[:, -1].copy(), self.weight, self.granted, self.long)


def log_evidence(information: Array, right: Array) -> float:
    """Logarithm of the Bayes factor of parameters against their null: Gaussian, priors of unit variance."""
    if not len(right):
        return 0.0
    matrix = information + np.eye(len(right))
    _, logdet = np.linalg.slogdet(matrix)
    return float(0.5 * right @ np.linalg.solve(matrix, right) - 0.5 * logdet)
