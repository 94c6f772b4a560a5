"""From gradients to height: Poisson's equation, with weights and a robust option."""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, DTypeLike
from scipy.fft import dctn, dstn, idctn, idstn, next_fast_len
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import LinearOperator, cg

from designlab.core.types import Array, Mask

Boundary = Literal["neumann", "dirichlet"]

# Weights below this share of the largest would let the height drift between the pixels that count.
_LEAST_WEIGHT = 1e-4
_ROBUST_ROUNDS = 10
_TOLERANCE = 1e-8
_SINGLE_TOLERANCE = 1e-4  # from which single precision does
_COURSE_PX = 2.0  # grain of weights that the preconditioner leaves out
READ_SHARE = 0.3
"""Share of the slopes read off the colours in `blended`."""
CLEAR = 2.0
"""Standard deviations of noise from which a detail of a slope counts."""
NOISE_PER_MEDIAN = 1.4826
"""Standard deviation of normal noise over the median of its size."""
_TINY = 1e-30
# Huber's tuning constant: 95 % efficiency on normal errors.
_HUBER = 1.345


def integrate(
    p: ArrayLike,
    q: ArrayLike,
    *,
    pitch_mm: float | tuple[float, float],
    boundary: Boundary = "neumann",
    weights: ArrayLike | None = None,
    robust: bool = False,
    tolerance: float = _TOLERANCE,
) -> Array:
    """Integrate gradients to the height whose differences fit them best in the least-squares sense.

    The Poisson equation is solved by fast transforms on the pixel grid. Differences of neighbouring pixels
    are compared with the mean of their gradients, so that a height is returned exactly where those agree, and
    to second order in the pitch otherwise. With weights, or robustly, conjugate gradients solve the weighted
    equation. Their preconditioner is the unweighted solver, scaled by the weights; where pixels have no
    weight, algebraic multigrid, which holes do not slow down.

    Parameters
    ----------
    p, q : array, shape (rows, columns)
        dz/dx and dz/dy; row 0 is at +y.
    pitch_mm : float or pair of float
        Distance of pixels, or distances along x and y (mm).
    boundary : str
        ``dirichlet``: the border pixels are at height 0. ``neumann``: the border is free and its mean is 0.
    weights : array, shape (rows, columns), optional
        How much each pixel's gradient counts, from 0 (shadowed, masked: bridged from around) up.
    robust : bool
        Let gradients that no height can explain count less: Huber's loss of the residual in place of its
        square, its scale taken from the median residual.
    tolerance : float
        Relative residual at which the weighted or robust solution is accepted.

    Returns
    -------
    array, shape (rows, columns)
        Height (mm).

    Raises
    ------
    ValueError
        If shapes differ, a gradient is not finite, a weight is negative, or the pitch is not positive.
    """
    p, q = np.asarray(p, dtype=float), np.asarray(q, dtype=float)
    if p.shape != q.shape or p.ndim != 2 or min(p.shape) < 3:
        raise ValueError(f"p, q: must have one shape of at least 3 x 3 pixels, got {p.shape} and {q.shape}")
    bad = int((~np.isfinite(p) | ~np.isfinite(q)).sum())
    if bad:
        raise ValueError(f"p, q: must be finite, {bad} of {p.size} pixels are not")
    pitch_x_mm, pitch_y_mm = pitch_mm if isinstance(pitch_mm, tuple) else (pitch_mm, pitch_mm)
    if not (pitch_x_mm > 0 and pitch_y_mm > 0):
        raise ValueError(f"pitch_mm: must be positive, got {pitch_x_mm:g} and {pitch_y_mm:g} mm")
    if boundary not in ("neumann", "dirichlet"):
        raise ValueError(f"boundary: must be neumann or dirichlet, got {boundary!r}")
    # gradients between pixels; y falls as the row index rises
    along_x = (p[:, 1:] + p[:, :-1]) / (2 * pitch_x_mm)
    along_y = -(q[1:] + q[:-1]) / (2 * pitch_y_mm)
    solve = _poisson_solver(p.shape, pitch_x_mm, pitch_y_mm, boundary)
    height = solve(_divergence(along_x, along_y))
    if weights is not None or robust:
        given = _checked_weights(weights, p.shape)
        between_x, between_y = np.minimum(given[:, 1:], given[:, :-1]), np.minimum(given[1:], given[:-1])
        kind = _WithHoles if (given == 0).any() else _Weighted
        operator = kind(_Grid(p.shape, pitch_x_mm, pitch_y_mm, boundary), tolerance)
        if weights is not None:
            height = operator.solve(along_x, along_y, between_x, between_y, height)
        for _ in range(_ROBUST_ROUNDS if robust else 0):
            # in units of slope
            error_x = np.diff(height, axis=1) / pitch_x_mm - along_x * pitch_x_mm
            error_y = np.diff(height, axis=0) / pitch_y_mm - along_y * pitch_y_mm
            scale = NOISE_PER_MEDIAN * np.median(np.abs(np.concatenate([error_x.ravel(), error_y.ravel()])))
            if scale <= _TOLERANCE:
                break
            doubt_x, doubt_y = (np.maximum(np.abs(e) / (_HUBER * scale), 1.0) for e in (error_x, error_y))
            height = operator.solve(along_x, along_y, between_x / doubt_x, between_y / doubt_y, height)
    if boundary == "neumann":
        height = height - np.concatenate([height[0], height[-1], height[1:-1, 0], height[1:-1, -1]]).mean()
    return np.asarray(height)


def border_surface(height_mm: Array) -> Array:
    """The surface of least slope that has the border pixels of a height, shape (rows, columns).

    It is harmonic: what a height lacks that was integrated with its border at 0.
    """
    flow = np.diff(height_mm, axis=1), np.diff(height_mm, axis=0)
    return np.asarray(height_mm - _poisson_solver(height_mm.shape, 1.0, 1.0, "dirichlet")(_divergence(*flow)))


def normals(p: ArrayLike, q: ArrayLike) -> Array:
    """Unit normals (-p, -q, 1) / sqrt(1 + p^2 + q^2), shape (..., 3), of a surface with gradients p and q."""
    p, q = np.asarray(p, dtype=float), np.asarray(q, dtype=float)
    direction = np.stack([-p, -q, np.ones_like(p)], axis=-1)
    return np.asarray(direction / np.linalg.norm(direction, axis=-1, keepdims=True))


def gradients_of(height_mm: ArrayLike, *, pitch_mm: float) -> tuple[Array, Array]:
    """Central differences p = dz/dx, q = dz/dy of a height (mm) on a grid whose row 0 is at +y."""
    height_mm = np.asarray(height_mm, dtype=float)
    down, right = np.gradient(height_mm, pitch_mm)
    return np.asarray(right), np.asarray(-down)


def blended(
    p: Array,
    q: Array,
    height_mm: Array,
    *,
    pitch_mm: float | tuple[float, float],
    mask: Mask | None = None,
) -> tuple[Array, Array]:
    """Slopes between those read off the colours and those of the height integrated from them.

    A height corrects slopes that no surface can have. But it also spreads the errors of a steep rim over the
    flat gel around, whose slopes the colours tell well. A mean of both errs less than either. What differs
    from pixel to pixel no height holds. Of that, what stands out of the noise is taken as read, by the
    non-negative garrote (Breiman 1995), so that coarse pixels blur nothing.

    Parameters
    ----------
    p, q : array, shape (rows, columns)
        dz/dx and dz/dy, as read.
    height_mm : array, shape (rows, columns)
        The height that `integrate` makes of them.
    pitch_mm : float or pair of float
        Distance of pixels, or distances along x and y (mm).
    mask : bool array, shape (rows, columns), optional
        Pixels whose colours tell slopes; the others have those of the height.
    """
    pitch_x_mm, pitch_y_mm = pitch_mm if isinstance(pitch_mm, tuple) else (pitch_mm, pitch_mm)
    own_p, own_q = np.gradient(height_mm, pitch_x_mm, axis=1), -np.gradient(height_mm, pitch_y_mm, axis=0)
    return _blended(p, own_p, mask), _blended(q.T, own_q.T, None if mask is None else mask.T).T


def _blended(read: Array, own: Array, mask: Mask | None) -> Array:
    """Slopes along the rows, from those read and those of the height."""
    if mask is not None:
        read = np.where(mask, read, own)
    beside = np.pad(read, ((0, 0), (1, 1)), mode="reflect")
    even = (beside[:, :-2] + 2 * read + beside[:, 2:]) / 4  # all that differences of a height can hold
    detail = read - even
    size = np.abs(detail if mask is None else detail[mask])
    noise = NOISE_PER_MEDIAN * float(np.median(size)) if size.size else 0.0
    clear = np.maximum(1 - (CLEAR * noise) ** 2 / np.maximum(detail**2, _TINY), 0)
    found = own + READ_SHARE * (even - own) + clear * detail
    return np.asarray(found if mask is None else np.where(mask, found, own))


def _divergence(along_x: Array, along_y: Array) -> Array:
    return np.asarray(
        np.diff(along_x, axis=1, prepend=0, append=0) + np.diff(along_y, axis=0, prepend=0, append=0)
    )


def _poisson_solver(
    shape: tuple[int, int], pitch_x_mm: float, pitch_y_mm: float, boundary: Boundary
) -> Callable[[Array], Array]:
    """The solution of the unweighted equation for a divergence over all pixels."""
    fixed = boundary == "dirichlet"
    down, across = (np.arange(1, n - 1) / (n - 1) if fixed else np.arange(n) / n for n in shape)
    eigenvalues = _eigenvalues(across, pitch_x_mm) + _eigenvalues(down, pitch_y_mm)[:, None]
    if not fixed:
        eigenvalues[0, 0] = eigenvalues[0, 1]  # of the constant, which is fixed at the end: anything definite
    inverse = {dtype: (1 / eigenvalues).astype(dtype) for dtype in (np.float32, np.float64)}
    if fixed:
        return lambda d: np.pad(idstn(dstn(d[1:-1, 1:-1], type=1) * inverse[d.dtype.type], type=1), 1)
    return lambda d: np.asarray(idctn(dctn(d) * inverse[d.dtype.type]))


def _nearby_solver(
    shape: tuple[int, int], pitch_x_mm: float, pitch_y_mm: float, boundary: Boundary
) -> Callable[[Array], Array]:
    """Like `_poisson_solver`, on a picture a few pixels larger that transforms are fast for.

    With the border a little further out it is not the solution, but near enough to precondition one.
    """
    if boundary == "neumann":
        return _poisson_solver(shape, pitch_x_mm, pitch_y_mm, boundary)
    rows, columns = (next_fast_len(n - 1, real=True) + 1 for n in shape)
    solve = _poisson_solver((rows, columns), pitch_x_mm, pitch_y_mm, boundary)
    beyond = ((0, rows - shape[0]), (0, columns - shape[1]))
    return lambda d: solve(np.pad(d, beyond))[: shape[0], : shape[1]]


class _Grid(NamedTuple):
    """Pixels of a picture, and what is known of the height at their border."""

    shape: tuple[int, int]
    pitch_x_mm: float
    pitch_y_mm: float
    boundary: Boundary

    @property
    def free(self) -> Mask:
        """Pixels whose height is not given."""
        free = np.ones(self.shape, dtype=bool)
        if self.boundary == "dirichlet":
            free[[0, -1]] = free[:, [0, -1]] = False
        return free


class _Weighted:
    """Weighted Poisson equation by preconditioned conjugate gradients."""

    def __init__(self, grid: _Grid, tolerance: float) -> None:
        self._nearby = _nearby_solver(*grid)
        self._shape, self._tolerance = grid.shape, tolerance
        # What need not be exact is as exact in single precision, and faster.
        self._single = np.float32 if tolerance >= _SINGLE_TOLERANCE else np.float64
        self._per_x, self._per_y = (self._single(1 / p**2) for p in (grid.pitch_x_mm, grid.pitch_y_mm))
        self._free: Array = np.where(grid.free, self._single(1), self._single(0))

    def solve(self, along_x: Array, along_y: Array, weight_x: Array, weight_y: Array, start: Array) -> Array:
        weight_x, weight_y = _shares(weight_x, weight_y, self._single)

        def apply(flat: Array) -> Array:
            height = self._free * flat.reshape(self._shape)
            flow_x = weight_x * np.diff(height, axis=1) * self._per_x
            flow_y = weight_y * np.diff(height, axis=0) * self._per_y
            return np.asarray((-self._free * _divergence(flow_x, flow_y)).ravel())

        # Scaled by the course of the weights on both sides, the unweighted solution is close to the weighted
        # one (Concus and Golub 1973); their grain would roughen it.
        course = gaussian_filter(np.log(_at_pixels(weight_x, weight_y)), _COURSE_PX, mode="nearest")
        scale = self._free * np.exp(-course / 2)

        def nearby(flat: Array) -> Array:
            return np.asarray((-scale * self._nearby(scale * flat.reshape(self._shape))).ravel())

        right = (-self._free * _divergence(weight_x * along_x, weight_y * along_y)).astype(self._single)
        size = right.size
        found, _ = cg(
            LinearOperator((size, size), matvec=apply, dtype=self._single),
            right.ravel(),
            x0=start.ravel().astype(self._single),
            rtol=self._tolerance,
            maxiter=2000,
            M=LinearOperator((size, size), matvec=nearby, dtype=self._single),
        )
        return np.asarray(found.reshape(self._shape), dtype=float)


class _WithHoles:
    """Weighted Poisson equation by conjugate gradients and algebraic multigrid (Ruge and Stueben 1987)."""

    def __init__(self, grid: _Grid, tolerance: float) -> None:
        self._shape, self._tolerance = grid.shape, tolerance
        self._per_mm2 = 1 / grid.pitch_x_mm**2, 1 / grid.pitch_y_mm**2
        free = grid.free
        if free.all():
            free[0, 0] = False  # heights are told up to a constant: one is held
        self._free = np.flatnonzero(free)
        # each row of the differences is a pixel less its neighbour to the left or above
        number = np.arange(free.size).reshape(grid.shape)
        pairs = [(number[:, 1:], number[:, :-1]), (number[1:], number[:-1])]
        high, low = (np.concatenate([pair[side].ravel() for pair in pairs]) for side in (0, 1))
        row = np.arange(high.size)
        ones = np.ones(high.size)
        self._differences = coo_array(
            (np.concatenate([ones, -ones]), (np.tile(row, 2), np.concatenate([high, low]))),
            shape=(high.size, free.size),
        ).tocsc()[:, self._free]

    def solve(self, along_x: Array, along_y: Array, weight_x: Array, weight_y: Array, start: Array) -> Array:
        from pyamg import ruge_stuben_solver  # loads for a second

        weights = _shares(weight_x, weight_y)
        steepness = np.concatenate(
            [(w * per_mm2).ravel() for w, per_mm2 in zip(weights, self._per_mm2, strict=True)]
        )
        flow = np.concatenate([(weights[0] * along_x).ravel(), (weights[1] * along_y).ravel()])
        matrix = (self._differences.T @ diags_array(steepness) @ self._differences).tocsr()
        found = ruge_stuben_solver(matrix).solve(
            self._differences.T @ flow, x0=start.ravel()[self._free], tol=self._tolerance, accel="cg"
        )
        height = np.zeros(self._shape)
        height.ravel()[self._free] = found
        return height


def _shares(weight_x: Array, weight_y: Array, dtype: DTypeLike = float) -> tuple[Array, Array]:
    """Weights between pixels as shares of the largest, none of them too small to hold a height."""
    largest = max(weight_x.max(), weight_y.max())
    x, y = (np.asarray(np.maximum(w / largest, _LEAST_WEIGHT), dtype) for w in (weight_x, weight_y))
    return x, y


def _at_pixels(along_x: Array, along_y: Array) -> Array:
    """Mean at each pixel of values between it and its neighbours."""
    shape = along_x.shape[0], along_y.shape[1]
    total, count = np.zeros(shape, dtype=along_x.dtype), np.zeros(shape, dtype=along_x.dtype)
    for between, low, high in (
        (along_x, np.s_[:, :-1], np.s_[:, 1:]),
        (along_y, np.s_[:-1], np.s_[1:]),
    ):
        for side in (low, high):
            total[side] += between
            count[side] += 1
    return total / count


def _checked_weights(weights: ArrayLike | None, shape: tuple[int, ...]) -> Array:
    if weights is None:
        return np.ones(shape)
    weights = np.asarray(weights, dtype=float)
    if weights.shape != shape:
        raise ValueError(f"weights: must have the shape of the gradients {shape}, got {weights.shape}")
    if not np.isfinite(weights).all() or weights.min() < 0 or weights.max() == 0:
        raise ValueError("weights: must be finite, at least 0, and positive somewhere")
    return weights


def _eigenvalues(frequency: Array, pitch_mm: float) -> Array:
    """Eigenvalues of the second difference for modes of `frequency` half-waves per pixel."""
    return np.asarray((2 * np.cos(np.pi * frequency) - 2) / pitch_mm**2)
