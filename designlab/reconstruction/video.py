"""Shapes at the rate of video: the maps of a calibration read from a table, heights on a coarser grid."""

from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.fft import dstn, idstn
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_array

from designlab.core.images import resize_area
from designlab.core.types import Array, Mask, Single
from designlab.reconstruction.colour_table import ColourTable
from designlab.reconstruction.height import CLEAR, NOISE_PER_MEDIAN, READ_SHARE
from designlab.reconstruction.lab import LabCalibration
from designlab.reconstruction.markers import FILLED
from designlab.reconstruction.methods import outputs_at
from designlab.reconstruction.pictures import level_of

MOST_CELLS = 100_000  # of one pixel; more take more time than a video leaves
_STEEPEST = 0.97  # sine of the steepest slope that is believed
_LEAST_WEIGHT = 1e-3
_COURSE_CELLS = 1.0  # grain of weights that the preconditioner leaves out
_ROUNDS, _SETTLED = 24, 3e-3


class VideoShape(NamedTuple):
    """What mode video reconstructs.

    Attributes
    ----------
    height_mm : array, shape (rows, columns)
        Height of the pixels above the undeformed membrane.
    cells : array, shape (2, cells, cells)
        Slopes dz/dx and dz/dy of the cells, see `height.blended`.
    cell_px : int
        Pixels along a cell.
    mm_per_px : float
        Distance of pixels.
    beyond_mm : array, shape (rows, columns), optional
        What of the height no colour tells.
    """

    height_mm: NDArray[Any]
    cells: NDArray[Any]
    cell_px: int
    mm_per_px: float
    beyond_mm: NDArray[Any] | None = None

    def raised(self, by_mm: NDArray[Any]) -> "VideoShape":
        """The same shape with a height added that no colour tells, as that of its border is."""
        return self._replace(height_mm=self.height_mm + by_mm, beyond_mm=by_mm)

    def normals(self) -> NDArray[Any]:
        """Unit normals at the pixels, shape (rows, columns, 3), between those of the cells."""
        beyond = np.zeros_like(self.height_mm) if self.beyond_mm is None else self.beyond_mm
        found = np.empty((*beyond.shape, 3), dtype=np.float32)
        _normals(self.cells, self.cell_px, beyond, np.float32((1 - READ_SHARE) / self.mm_per_px), found)
        return found


class VideoMaps:
    """A calibration made fast.

    Colours are smoothed over some pixels before they are read, so cells of about that size lose nothing:
    maps are read and slopes integrated on cells, and heights and slopes then interpolated to the pixels.

    Parameters
    ----------
    calibration : LabCalibration
        The maps.
    taught : array, shape (samples, 3)
        Changes of colour that the balls showed.

    Raises
    ------
    ValueError
        If the pictures have other than three colours.
    """

    def __init__(self, calibration: LabCalibration, taught: Array) -> None:
        self.calibration = calibration
        pixels = calibration.background.shape[0] * calibration.background.shape[1]
        least = 1 if pixels <= MOST_CELLS else 2
        self.cell_px = max(least, int(calibration.setup.smoothing_px))
        self.table = ColourTable.of(partial(_outputs, calibration), taught)
        self._detail = calibration.detail_px / self.cell_px if calibration.rim is not None else 0.0
        rows, columns = calibration.background.shape[:2]
        self._cells = -(-rows // self.cell_px), -(-columns // self.cell_px)
        # what is left of the smoothing once the mean over a cell is taken
        left = calibration.setup.smoothing_px**2 - (self.cell_px**2 - 1) / 12
        self._smoothing = np.sqrt(max(left, 0.0)) / self.cell_px
        self._solver = _Poisson(self._cells, self.cell_px * calibration.setup.mm_per_px)
        self._up = _interpolation(rows, self._cells[0], self.cell_px)
        self._across = _interpolation(columns, self._cells[1], self.cell_px)

    def warm_up(self) -> None:
        """Compile what is compiled, so that the first picture takes no longer than others."""
        self.shape(self.change(self.calibration.background.astype(np.float32))).normals()

    def on(self, calibration: LabCalibration) -> "VideoMaps":
        """The same maps on another picture of the untouched gel."""
        made = object.__new__(type(self))
        made.__dict__.update({k: v for k, v in vars(self).items() if k != "_background"})
        made.calibration = calibration
        return made

    @cached_property
    def _background(self) -> tuple[Single, Single]:
        """The untouched gel, and what a change of it is divided by."""
        background, spread = self.calibration.background, self.calibration.spread
        level = np.broadcast_to(background.mean(axis=(0, 1)), (*self._cells, len(spread)))
        if self.calibration.setup.relative_to == "place":
            level = resize_area(level_of(background), *self._cells)
        return background.astype(np.float32), (1 / (level * spread)).astype(np.float32)

    def change(self, image: NDArray[Any], covered: Mask | None = None) -> NDArray[Any]:
        """Change of colour on cells, in units of the spread, shape (cells, cells, 3).

        Cells that markers cover are filled in from around.
        """
        background, scale = self._background
        found = np.empty((*self._cells, 3), dtype=np.float32)
        _binned(image, background, scale, self.cell_px, found)
        return self._smoothed(found if covered is None else _filled(found, ~covered))

    def _smoothed(self, values: Single) -> Single:
        if not self._smoothing:
            return values
        sigma = (self._smoothing, self._smoothing, 0)
        return np.asarray(gaussian_filter(values, sigma, mode="nearest", truncate=3.0))

    def shape(self, change: NDArray[Any], filled: Mask | None = None) -> VideoShape:
        """Height at the pixels and slopes of the cells.

        Parameters
        ----------
        change : array, shape (cells, cells, 3)
            Change of colour on cells.
        filled : bool array, shape (cells, cells), optional
            Cells whose marker was filled in. They count little, and their slopes are those of the height.
        """
        found = self.table(change)
        slopes = np.empty((4, *self._cells), dtype=np.float32)
        _gradients(found, slopes)
        weight = np.exp(-found[..., 4])
        if filled is None:
            filled = np.zeros(self._cells, dtype=bool)
        height = self._solver.weighted(slopes[0], slopes[1], weight, filled)
        if self._detail:
            more = self._solver.weighted(slopes[2] - slopes[0], slopes[3] - slopes[1], weight, filled)
            height += self._solver.fine(more, self._detail)
        mm_per_px = self.calibration.setup.mm_per_px
        cells = _blended(slopes[2:], height, np.float32(self.cell_px * mm_per_px), filled)
        pixels = np.ascontiguousarray((self._across @ (self._up @ height).T).T)
        return VideoShape(pixels, cells, self.cell_px, mm_per_px)


def _blended(read: Single, height: Single, cell_mm: np.float32, filled: Mask) -> Single:
    """Slopes of cells between those read and those of the height, see `height.blended`."""
    detail, found = np.empty_like(read), np.empty_like(read)
    _details(read, detail)
    # every third cell tells the noise as well; what was filled in has none
    told = [np.abs(part[::3, ::3][~filled[::3, ::3]]) for part in detail]
    noise = [NOISE_PER_MEDIAN * float(np.median(part)) if part.size else 0.0 for part in told]
    _blend(read, detail, height, cell_mm, (CLEAR * np.array(noise, np.float32)) ** 2, filled, found)
    return found


def _filled(values: Single, free: Mask) -> Single:
    """Values whose cells that are not free are filled in from coarser and coarser means of the others."""
    if free.all():
        return values
    if not free.any():
        return np.zeros_like(values)
    rows, columns = free.shape
    even = (-rows % 2, -columns % 2)
    known = np.pad(free, ((0, even[0]), (0, even[1]))).astype(np.float32)[..., None]
    kept = np.pad(np.where(free[..., None], values, 0), ((0, even[0]), (0, even[1]), (0, 0)))
    count, total = (
        each[::2, ::2] + each[1::2, ::2] + each[::2, 1::2] + each[1::2, 1::2] for each in (known, kept)
    )
    coarse = _filled(np.asarray(total / np.maximum(count, 1), np.float32), count[..., 0] > 0)
    finer = coarse.repeat(2, axis=0).repeat(2, axis=1)[:rows, :columns]
    return np.asarray(np.where(free[..., None], values, finer))


def _outputs(calibration: LabCalibration, colour: Array, place: Array) -> Array:
    """What the table holds: slopes by both maps, and the logarithm of the expected error; (N, 5)."""
    if calibration.alike is None:
        raise ValueError("mode: video needs maps of one method, as `designlab calibrate --balls` writes them")
    slopes, errors = calibration.alike
    found = outputs_at(slopes, colour, place)
    if calibration.rim is None:
        found = np.tile(found, 2)
    course = outputs_at(errors[:1], colour, place) if errors else np.zeros((len(colour), 1))
    return np.concatenate([found, course], axis=1)


class _Poisson:
    """Poisson's equation on cells, with height 0 at the edge of the picture."""

    def __init__(self, cells: tuple[int, int], cell_mm: float) -> None:
        self._cell = np.float32(cell_mm)
        down, across = (np.pi * np.arange(1, count + 1) / count for count in cells)
        waves = (2 - 2 * np.cos(across)) + (2 - 2 * np.cos(down))[:, None]
        self._inverse = (1 / waves).astype(np.float32)
        self._squared = (across**2 + down[:, None] ** 2).astype(np.float32)

    def _solved(self, source: Single) -> Single:
        return np.asarray(idstn(dstn(source, type=2, overwrite_x=False) * self._inverse, type=2))

    def fine(self, height: Single, sigma_cells: float) -> Single:
        """A height without what a Gaussian of some cells leaves of it."""
        kept = 1 - np.exp(-self._squared * np.float32(sigma_cells**2 / 2))
        return np.asarray(idstn(dstn(height, type=2) * kept, type=2))

    def weighted(self, p: Single, q: Single, weight: Single, filled: Mask) -> Single:
        """Height whose slopes fit best, by conjugate gradients; see `height.integrate`."""
        weight = np.maximum(weight / weight.max(), np.float32(_LEAST_WEIGHT))
        # Filled cells are small holes: their edges in the preconditioner would keep heights from settling.
        course = gaussian_filter(np.log(weight), _COURSE_CELLS, mode="nearest")
        scale = np.exp(-course / 2)
        weight[filled] *= np.float32(FILLED)
        rest, step_of = np.empty_like(p), np.empty_like(p)
        _source(p, q, weight, rest)
        height = np.zeros_like(p)
        near = scale * self._solved(scale * rest)
        along, power = near.copy(), _dot(rest, near)
        start = power
        for _ in range(_ROUNDS):
            _applied(along, weight, step_of)
            share = np.float32(power / max(_dot(along, step_of), 1e-30))
            height += share * along
            rest -= share * step_of
            near = scale * self._solved(scale * rest)
            before, power = power, _dot(rest, near)
            if power <= _SETTLED**2 * start:
                break
            along = near + np.float32(power / before) * along
        return np.asarray(self._cell * height)


def _interpolation(pixels: int, cells: int, cell_px: int) -> csr_array:
    """Cubic interpolation from cells to pixels; beyond the edge heights go on with their sign turned."""
    at = (np.arange(pixels) + 0.5) / cell_px - 0.5
    first = np.floor(at).astype(int) - 1
    t = (at - np.floor(at))[:, None]
    # Keys 1981
    weights = np.concatenate(
        [
            -0.5 * t + t**2 - 0.5 * t**3,
            1 - 2.5 * t**2 + 1.5 * t**3,
            0.5 * t + 2 * t**2 - 1.5 * t**3,
            -0.5 * t**2 + 0.5 * t**3,
        ],
        axis=1,
    )
    cell = first[:, None] + np.arange(4)
    outside = (cell < 0) | (cell >= cells)
    cell = np.where(cell < 0, -1 - cell, np.where(cell >= cells, 2 * cells - 1 - cell, cell))
    row = np.repeat(np.arange(pixels), 4)
    signed = np.where(outside, -weights, weights)
    return csr_array((signed.ravel().astype(np.float32), (row, cell.ravel())), shape=(pixels, cells))


@njit(cache=True, nogil=True, fastmath=True)
def _binned(image: Single, background: Single, scale: Single, cell_px: int, found: Single) -> None:
    rows, columns = image.shape[:2]
    for row in range(found.shape[0]):
        for column in range(found.shape[1]):
            a = b = c = np.float32(0)
            count = 0
            for i in range(row * cell_px, min((row + 1) * cell_px, rows)):
                for j in range(column * cell_px, min((column + 1) * cell_px, columns)):
                    a += image[i, j, 0] - background[i, j, 0]
                    b += image[i, j, 1] - background[i, j, 1]
                    c += image[i, j, 2] - background[i, j, 2]
                    count += 1
            found[row, column, 0] = a * scale[row, column, 0] / count
            found[row, column, 1] = b * scale[row, column, 1] / count
            found[row, column, 2] = c * scale[row, column, 2] / count


@njit(cache=True, nogil=True, fastmath=True)
def _gradients(found: Single, slopes: Single) -> None:
    """Gradients of slope vectors, see `methods.slope_gradients`."""
    for row in range(found.shape[0]):
        for column in range(found.shape[1]):
            for first in (0, 2):
                x, y = found[row, column, first], found[row, column, first + 1]
                size = np.sqrt(x * x + y * y)
                cut = min(np.float32(1), np.float32(_STEEPEST) / max(size, np.float32(1e-12)))
                x, y = x * cut, y * cut
                up = np.sqrt(1 - x * x - y * y)
                slopes[first, row, column], slopes[first + 1, row, column] = x / up, y / up


@njit(cache=True, nogil=True, fastmath=True)
def _source(p: Single, q: Single, weight: Single, source: Single) -> None:
    """Weighted divergence of slopes, its sign turned; y falls as the row rises."""
    rows, columns = p.shape
    for row in range(rows):
        for column in range(columns):
            own = weight[row, column]
            right, left = own * p[row, column], own * p[row, column]
            down, up = own * q[row, column], own * q[row, column]
            if column < columns - 1:
                w = min(own, weight[row, column + 1])
                right = w * (p[row, column] + p[row, column + 1]) / 2
            if column > 0:
                w = min(own, weight[row, column - 1])
                left = w * (p[row, column] + p[row, column - 1]) / 2
            if row < rows - 1:
                w = min(own, weight[row + 1, column])
                down = w * (q[row, column] + q[row + 1, column]) / 2
            if row > 0:
                w = min(own, weight[row - 1, column])
                up = w * (q[row, column] + q[row - 1, column]) / 2
            source[row, column] = left - right + down - up


@njit(cache=True, nogil=True, fastmath=True)
def _dot(one: Single, other: Single) -> float:
    # threads of a linear-algebra library would wait for each other longer than this takes
    total = 0.0
    for row in range(one.shape[0]):
        for column in range(one.shape[1]):
            total += one[row, column] * other[row, column]
    return total


@njit(cache=True, nogil=True, fastmath=True)
def _applied(height: Single, weight: Single, found: Single) -> None:
    """Weighted second difference, its sign turned, of a height that is 0 at the edge."""
    rows, columns = height.shape
    for row in range(rows):
        for column in range(columns):
            own, here = weight[row, column], height[row, column]
            total = np.float32(0)
            if column < columns - 1:
                total += min(own, weight[row, column + 1]) * (here - height[row, column + 1])
            else:
                total += own * 2 * here
            if column > 0:
                total += min(own, weight[row, column - 1]) * (here - height[row, column - 1])
            else:
                total += own * 2 * here
            if row < rows - 1:
                total += min(own, weight[row + 1, column]) * (here - height[row + 1, column])
            else:
                total += own * 2 * here
            if row > 0:
                total += min(own, weight[row - 1, column]) * (here - height[row - 1, column])
            else:
                total += own * 2 * here
            found[row, column] = total


@njit(cache=True, nogil=True, fastmath=True)
def _details(read: Single, detail: Single) -> None:
    """What differs from cell to cell: p along the rows, q along the columns, mirrored at the edge."""
    rows, columns = read.shape[1:]
    for row in range(rows):
        above, below = abs(row - 1), rows - 1 - abs(rows - 2 - row)
        for column in range(columns):
            left, right = abs(column - 1), columns - 1 - abs(columns - 2 - column)
            detail[0, row, column] = (2 * read[0, row, column] - read[0, row, left] - read[0, row, right]) / 4
            detail[1, row, column] = (
                2 * read[1, row, column] - read[1, above, column] - read[1, below, column]
            ) / 4


@njit(cache=True, nogil=True, fastmath=True)
def _blend(
    read: Single,
    detail: Single,
    height: Single,
    cell_mm: np.float32,
    least: Single,
    filled: Mask,
    found: Single,
) -> None:
    """Slopes of cells; details whose square is below `least` are noise."""
    rows, columns = height.shape
    told = np.float32(READ_SHARE)
    own = 1 - told
    for row in range(rows):
        above, below = max(row - 1, 0), min(row + 1, rows - 1)
        for column in range(columns):
            left, right = max(column - 1, 0), min(column + 1, columns - 1)
            rise = (height[row, right] - height[row, left]) / (cell_mm * (right - left))
            fall = (height[above, column] - height[below, column]) / (cell_mm * (below - above))
            if filled[row, column]:
                found[0, row, column], found[1, row, column] = rise, fall
                continue
            for axis, slope in ((0, rise), (1, fall)):
                fine = detail[axis, row, column]
                even = read[axis, row, column] - fine
                clear = max(1 - least[axis] / max(fine * fine, np.float32(1e-30)), np.float32(0))
                found[axis, row, column] = own * slope + told * even + clear * fine


@njit(cache=True, nogil=True, fastmath=True)
def _normals(slopes: Single, cell_px: int, beyond: Single, share: np.float32, found: Single) -> None:
    """Unit normals at the pixels: slopes between those of cells, and a share of those of a height."""
    rows, columns = beyond.shape
    cell, half = np.float32(1 / cell_px), np.float32(0.5)
    last_row, last_column = slopes.shape[1] - 1, slopes.shape[2] - 1
    for row in range(rows):
        above, below = max(row - 1, 0), min(row + 1, rows - 1)
        v = min(max((row + half) * cell - half, np.float32(0)), np.float32(last_row))
        i = min(int(v), last_row - 1)
        v -= np.float32(i)
        for column in range(columns):
            left, right = max(column - 1, 0), min(column + 1, columns - 1)
            u = min(max((column + half) * cell - half, np.float32(0)), np.float32(last_column))
            j = min(int(u), last_column - 1)
            u -= np.float32(j)
            p = share * (beyond[row, right] - beyond[row, left]) / (right - left)
            q = share * (beyond[above, column] - beyond[below, column]) / (below - above)
            p += (1 - v) * ((1 - u) * slopes[0, i, j] + u * slopes[0, i, j + 1])
            p += v * ((1 - u) * slopes[0, i + 1, j] + u * slopes[0, i + 1, j + 1])
            q += (1 - v) * ((1 - u) * slopes[1, i, j] + u * slopes[1, i, j + 1])
            q += v * ((1 - u) * slopes[1, i + 1, j] + u * slopes[1, i + 1, j + 1])
            size = 1 / np.sqrt(1 + p * p + q * q)
            found[row, column, 0] = -p * size
            found[row, column, 1] = -q * size
            found[row, column, 2] = size
