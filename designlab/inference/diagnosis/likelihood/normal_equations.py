"""Normal equations of all unknowns over many shots give steps, reduced information and evidence."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.emulator.state import State, Unknown
from designlab.inference.diagnosis.likelihood.noise import SMOOTH_ALIKE, Noise, transformed

# Neighbouring values share the small errors that no noise model lists, so that their number says too much:
# the likelihood is raised to the power of one over this (coarsened posterior, Miller and Dunson 2019).
ALIKE = 32.0
MOST_TURNS = 10  # of each unknown to a bound and back


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
        Squared residual at the state, coarsened.
    now : array, shape (n,)
        Where the unknowns are, in prior standard deviations from null.
    """

    unknowns: tuple[Unknown, ...]
    gram: Array
    right: Array
    misfit: float
    now: Array

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
) -> System:
    """Set up the normal equations of unknowns over shots at a state.

    Values are whitened by their noise, transformed by cosines, in which smooth errors are independent, and
    weighed by the inverse of the covariance: of each coefficient it is what a shot has alone on the diagonal
    and what all have in common beyond (Sherman and Morrison 1950). All is divided by `alike`, but smooth
    errors count as if divided by `smooth_alike`.
    """
    share = min(1.0, smooth_alike / alike)
    size = len(unknowns)
    gram, right, misfit = np.zeros((size, size)), np.zeros(size), 0.0
    common: dict[tuple[int, ...], NDArray[np.float32]] = {}
    weight: dict[tuple[int, ...], Array] = {}
    latest: dict[tuple[int, ...], Noise] = {}
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
        # What all shots have in common: their sum, weighed by how bright each is.
        key, bright = shot.signal.shape[:2], own.level / own.alone
        total = common.setdefault(key, np.zeros((size + 1, *key, 3), dtype=np.float32))
        total[[*used, size]] += coefficients * bright.astype(np.float32)
        weight[key] = weight.get(key, np.zeros((*key, 3))) + own.level * bright
        latest[key] = own
    for key, total in common.items():
        # The mean of all is what gains are fitted for.
        budget = latest[key].common(mean=False, share=share)
        root = np.sqrt(budget / (1.0 + budget * weight[key])).astype(np.float32)
        shared = (total * root).reshape(size + 1, -1)
        part = np.asarray(shared @ shared.T, dtype=float)
        gram -= part[:-1, :-1]
        right -= part[:-1, -1]
        misfit -= float(part[-1, -1])
    return System(tuple(unknowns), gram / alike, right / alike, misfit / alike, now)


def log_evidence(information: Array, right: Array) -> float:
    """Logarithm of the Bayes factor of parameters against their null: Gaussian, priors of unit variance."""
    if not len(right):
        return 0.0
    matrix = information + np.eye(len(right))
    _, logdet = np.linalg.slogdet(matrix)
    return float(0.5 * right @ np.linalg.solve(matrix, right) - 0.5 * logdet)
