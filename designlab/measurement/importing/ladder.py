"""The response of a camera from an exposure ladder: one scene, taken with known ratios of exposure."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array

DARKEST, BRIGHTEST = 0.04, 0.96  # of full scale: what is used of a picture
GROUPS = 64  # of pixels alike, whose mean is taken
QUANTILES = (0.01, 0.99)  # of a group, that have to lie within the range used
DEGREES = range(6)
LEAST_EQUATIONS = 30
LEAST_RATIO = 1.5
MOST_MISFIT = 0.1  # of the logarithm: beyond, the pictures are no ladder
LEVELS = 256


class LadderError(ValueError):
    """Pictures or a table from which no response follows; the text says why."""


@dataclass(frozen=True, eq=False)
class Tabulated:
    """A growing curve from encoded to linear values, both shares of full scale.

    Attributes
    ----------
    encoded, linear : array, shape (levels,)
        From 0 to 1; between them the curve is linear.
    known : tuple of float
        Encoded values between which it was measured; beyond, it is continued.
    """

    encoded: Array
    linear: Array
    known: tuple[float, float] = (0.0, 1.0)

    def __post_init__(self) -> None:
        for name in ("encoded", "linear"):
            values = getattr(self, name)
            if values.ndim != 1 or len(values) < 2 or values[0] != 0 or values[-1] != 1:
                raise LadderError(f"{name}: must run from 0 to 1")
            if not (np.diff(values) > 0).all():
                raise LadderError(f"{name}: must grow")

    def decode(self, encoded: NDArray[np.floating]) -> Array:
        """Linear values of encoded ones."""
        return np.asarray(np.interp(encoded, self.encoded, self.linear))


def estimate_response(pictures: Sequence[Array], exposures: Sequence[float]) -> Tabulated:
    """Find the curve under which pictures of one scene differ by their exposures only.

    As Debevec and Malik (1997, doi:10.1145/258734.258884) the logarithm of the inverse curve is found by
    linear least squares, here as g(m) = c0 ln m + c1 m + ... + cn m^n: a pure gamma is c0 alone, and few
    numbers are to be found, as with the polynomials of Mitsunaga and Nayar
    (1999, doi:10.1109/CVPR.1999.786966).
    Pixels alike are averaged first, so that noise and steps of 8 bits hardly count. The degree is the one
    with the least Bayesian information criterion. All channels share the curve.

    Parameters
    ----------
    pictures : sequence of array, shape (rows, columns, channels)
        Encoded values as shares of full scale, black level zero.
    exposures : sequence of float
        Relative exposures.

    Raises
    ------
    LadderError
        If the pictures do not determine a curve.
    """
    if len(pictures) < 2 or len(pictures) != len(exposures):
        raise LadderError(f"a ladder needs at least 2 pictures with an exposure each, got {len(pictures)}")
    if len({picture.shape for picture in pictures}) > 1:
        raise LadderError(f"pictures must agree in size, got {' and '.join(str(p.shape) for p in pictures)}")
    if min(exposures) <= 0 or max(exposures) < LEAST_RATIO * min(exposures):
        raise LadderError(
            f"exposures must be positive and span a ratio of {LEAST_RATIO} at least, got {list(exposures)}"
        )
    dim, bright, ratio = _pairs(pictures, exposures)
    if len(ratio) < LEAST_EQUATIONS:
        raise LadderError(
            f"too little of the scene is between {DARKEST:.0%} and {BRIGHTEST:.0%} of full scale in two "
            "pictures at once; choose exposures nearer each other, a scene with bright and dark parts, and "
            "keep the camera still"
        )
    fits = []
    for degree in DEGREES:
        powers = np.arange(1, degree + 1)
        matrix = np.column_stack([np.log(dim / bright), dim[:, None] ** powers - bright[:, None] ** powers])
        found = np.linalg.lstsq(matrix, ratio, rcond=None)[0]
        square = float(np.mean((matrix @ found - ratio) ** 2)) + 1e-12
        fits.append((len(ratio) * np.log(square) + (degree + 1) * np.log(len(ratio)), square, found))
    _, square, found = min(fits, key=lambda fit: fit[0])
    if square**0.5 > MOST_MISFIT:
        raise LadderError(
            f"no curve explains the pictures: {square**0.5:.0%} are left; suspected cause: the scene, the "
            "lights, gain or white balance changed, or the exposures are others than stated"
        )
    encoded = np.linspace(0.0, 1.0, LEVELS)
    inside = encoded[1:]
    log = found[0] * np.log(inside) + sum(c * (inside**k - 1) for k, c in enumerate(found[1:], start=1))
    linear = np.append(0.0, np.exp(log))
    if not (np.diff(linear) > 0).all():
        raise LadderError("the curve found does not grow everywhere; more exposures are needed")
    return Tabulated(encoded, linear, (float(dim.min()), float(bright.max())))


def _pairs(pictures: Sequence[Array], exposures: Sequence[float]) -> tuple[Array, Array, Array]:
    """Mean values of like pixels in two pictures each, and the logarithm of the ratio of exposures."""
    order = np.argsort(exposures, kind="stable")
    dim, bright, ratio = [], [], []
    for channel in range(pictures[0].shape[-1]):
        values = np.stack([pictures[number][..., channel].ravel() for number in order])
        alike = np.array_split(np.argsort(values.mean(axis=0), kind="stable"), GROUPS)
        groups = [values[:, places] for places in alike if len(places)]
        mean = np.stack([group.mean(axis=1) for group in groups], axis=1)
        # Quantiles: a hot pixel must not cost its group.
        low, high = (np.stack([np.quantile(g, q, axis=1) for g in groups], axis=1) for q in QUANTILES)
        used = (low > DARKEST) & (high < BRIGHTEST)
        for short, long in combinations(range(len(order)), 2):
            both = used[short] & used[long]
            step = np.log(exposures[order[short]] / exposures[order[long]])
            if step != 0:
                dim.append(mean[short, both])
                bright.append(mean[long, both])
                ratio.append(np.full(int(both.sum()), step))
    return np.concatenate(dim), np.concatenate(bright), np.concatenate(ratio)


def read_table(path: str | Path) -> Tabulated:
    """Read a curve: lines of two numbers, encoded and linear, each from 0 to 1; others are skipped.

    Raises
    ------
    LadderError
        Naming file and rule.
    """
    rows = []
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise LadderError(f"{path}: cannot be read as text: {error}") from None
    for number, line in enumerate(lines, start=1):
        text = line.partition("#")[0].strip()
        if not text or (number == 1 and text[0].isalpha()):
            continue
        try:
            encoded, linear = (float(part) for part in text.replace(",", " ").split())
        except ValueError:
            raise LadderError(f"{path}: line {number}: must be two numbers, got {text!r}") from None
        rows.append((encoded, linear))
    try:
        return Tabulated(*np.array(rows, dtype=float).reshape(-1, 2).T)
    except LadderError as error:
        raise LadderError(f"{path}: {error}") from None


def table_text(curve: Tabulated) -> str:
    """Write a curve as `read_table` reads it."""
    low, high = curve.known
    lines = [f"{e:.6g},{v:.8g}" for e, v in zip(curve.encoded, curve.linear, strict=True)]
    return "\n".join(["encoded,linear", f"# measured from {low:.3g} to {high:.3g}", *lines, ""])
