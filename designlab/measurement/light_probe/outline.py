"""Where the ball lies, from its outline in a picture."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, zoom
from scipy.optimize import least_squares

from designlab.core.types import Array
from designlab.measurement.light_probe.ball import LightProbe
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.simulation.optics.viewing_rays import Rays, rays

SEARCH_PX = 200  # the circle is looked for in a picture no larger than this
SMOOTHING_PX = 1.5
LEAST_SHARE = 0.35  # of the circumference that must show an edge
BAND = 0.06  # of the radius, around the circle that was found first
RIM_POINTS = 180
WRONG = 0.03  # share of the radius by which viewing rays along the outline may miss the ball


@dataclass(frozen=True)
class Outline:
    """A circle in a picture, in pixels of the picture, whole at pixel centres; and how much of it shows."""

    column: float
    row: float
    radius_px: float
    share: float


def find_outline(image: NDArray[np.floating], *, radius_px: tuple[float, float] | None = None) -> Outline:
    """Find the circle that stands out most, by its edge.

    It needs a picture in which the ball differs from what is around it, as under room light; in the dark of a
    black housing a mirror ball has no outline.

    Parameters
    ----------
    image : array, shape (rows, columns) or (rows, columns, channels)
        Picture.
    radius_px : (float, float), optional
        Least and greatest radius; an eighth to half of the shorter side when absent.

    Raises
    ------
    ValueError
        If the range is none, or no circle shows over enough of its circumference.
    """
    grey = np.asarray(image, dtype=float)
    grey = grey if grey.ndim == 2 else grey.mean(axis=2)
    shorter = min(grey.shape)
    least, greatest = radius_px or (shorter / 8, shorter / 2)
    if not 4 <= least < greatest <= max(grey.shape):
        raise ValueError(
            f"radius_px: must run from at least 4 to at most {max(grey.shape)} px, "
            f"got {least:g} to {greatest:g}"
        )
    found = _coarse(grey, least, greatest)
    if found is not None:
        for _ in range(3):
            found = _refined(grey, found)
            if found is None:
                break
    if found is None or found.share < LEAST_SHARE:
        share = 0.0 if found is None else found.share
        raise ValueError(
            f"image: a ball's outline must show over at least {LEAST_SHARE:.0%} of a circle of {least:g} to "
            f"{greatest:g} px, the best shows over {share:.0%}"
        )
    return found


def _coarse(grey: Array, least: float, greatest: float) -> Outline | None:
    from skimage.feature import canny
    from skimage.transform import hough_circle, hough_circle_peaks

    shrink = min(1.0, SEARCH_PX / max(grey.shape))
    small = zoom(gaussian_filter(grey, 0.5 / shrink), shrink, order=1)
    span = float(np.ptp(small))
    if span <= 0:
        return None
    edges = canny(small / span, sigma=1.5, low_threshold=0.02, high_threshold=0.06)
    radii = np.unique(np.arange(max(3, least * shrink), greatest * shrink + 1).round().astype(int))
    votes = hough_circle(edges, radii)
    peaks = hough_circle_peaks(votes, radii, total_num_peaks=1)
    _, columns, rows, found = peaks
    if not len(found):
        return None
    return Outline(float(columns[0]) / shrink, float(rows[0]) / shrink, float(found[0]) / shrink, 0.0)


def _refined(grey: Array, rough: Outline) -> Outline | None:
    """Circle through the steepest place along each radius, next to a rough one."""
    turn = np.linspace(0, 2 * np.pi, 4 * RIM_POINTS, endpoint=False)
    reach = max(BAND * rough.radius_px, 4.0)
    along = np.arange(-reach, reach + 0.25, 0.25)
    radius = rough.radius_px + along
    columns = rough.column + radius[None] * np.cos(turn)[:, None]
    rows = rough.row + radius[None] * np.sin(turn)[:, None]
    inside = (columns >= 0) & (columns <= grey.shape[1] - 1) & (rows >= 0) & (rows <= grey.shape[0] - 1)
    smooth = gaussian_filter(grey, SMOOTHING_PX)
    steep = np.abs(np.gradient(map_coordinates(smooth, [rows, columns], order=1), axis=1))
    steep[~inside] = 0.0
    best = steep.argmax(axis=1)
    height = steep.max(axis=1)
    seen = (height > 0.25 * np.percentile(height, 90)) & (best > 0) & (best < len(along) - 1)
    if seen.sum() < 12:
        return None
    beside = (np.clip(best + k, 0, len(along) - 1) for k in (-1, 0, 1))
    before, at, after = (steep[np.arange(len(turn)), index] for index in beside)
    curve = before - 2 * at + after
    peak = radius[best] + 0.25 * np.where(curve < 0, 0.5 * (before - after) / np.minimum(curve, -1e-30), 0.0)
    x, y = rough.column + peak * np.cos(turn), rough.row + peak * np.sin(turn)

    def misses(circle: Array) -> Array:
        return np.asarray(np.hypot(x[seen] - circle[0], y[seen] - circle[1]) - circle[2])

    fit = least_squares(misses, [rough.column, rough.row, rough.radius_px], loss="soft_l1", f_scale=0.5).x
    near = np.abs(np.hypot(x - fit[0], y - fit[1]) - fit[2]) < 1.5
    return Outline(float(fit[0]), float(fit[1]), float(fit[2]), float((near & seen).mean()))


def locate(
    outline: Outline,
    *,
    design: Design,
    view: View,
    diameter_mm: float,
    lowest_mm: float | None = None,
    immersed: bool = False,
) -> LightProbe:
    """Place a ball of known size so that viewing rays along its outline touch it.

    Sideways it is found to a fraction of a pixel; along the axis only as well as the radius in pixels is
    known: 0.1 % of it is 0.1 % of the distance to the camera. A known height is therefore better given.

    Parameters
    ----------
    outline : Outline
        Circle in the picture.
    design : Design
        The sensor; its gel is taken for removed.
    view : View
        The part of the camera's sensor that the picture shows.
    diameter_mm : float
        Diameter of the ball.
    lowest_mm : float, optional
        Height of its lowest point where it is known; the outline must then have the radius that follows.
    immersed : bool
        Whether a liquid of the gel's index surrounds it.

    Raises
    ------
    ValueError
        If no ball of that size, at that height, has this outline.
    """
    looks = rays(LightProbe(diameter_mm=diameter_mm, immersed=immersed).around(design), view)
    turn = np.linspace(0, 2 * np.pi, RIM_POINTS, endpoint=False)
    columns = outline.column + outline.radius_px * np.cos(turn)
    rows = outline.row + outline.radius_px * np.sin(turn)
    if columns.min() < 0 or rows.min() < 0 or columns.max() > view.columns - 1 or rows.max() > view.rows - 1:
        raise ValueError(
            f"outline: must lie within the picture of {view.columns} x {view.rows} px, the circle at "
            f"({outline.column:.4g}, {outline.row:.4g}) px of {outline.radius_px:.4g} px does not"
        )
    start, upward = _rim(looks, rows, columns)
    radius = diameter_mm / 2

    def passing(x: float, y: float, z: float) -> Array:
        away = start - np.array([x, y, z])
        across = away - (away * upward).sum(axis=1, keepdims=True) * upward
        return np.asarray(np.linalg.norm(across, axis=1) - radius)

    z = radius if lowest_mm is None else lowest_mm + radius
    middle = (start + z * upward / upward[:, 2:]).mean(axis=0)
    if lowest_mm is None:
        fit = least_squares(lambda at: passing(*at), middle, x_scale=[1.0, 1.0, 10.0])
        x, y, z = (float(c) for c in fit.x)
    else:
        # With the height fixed a wrong radius only shifts all distances alike.
        fit = least_squares(lambda at: passing(at[0], at[1], z) - passing(at[0], at[1], z).mean(), middle[:2])
        x, y = (float(c) for c in fit.x)
    misses = passing(x, y, z)
    if np.abs(misses).max() > WRONG * radius:
        height = "" if lowest_mm is None else f" at lowest_mm = {lowest_mm:g} mm"
        raise ValueError(
            f"diameter_mm: a ball of {diameter_mm:g} mm{height} must touch the viewing rays along the "
            f"outline of {outline.radius_px:.4g} px within {WRONG:.0%} of its radius, they pass at "
            f"{radius + float(misses.mean()):.4g} mm from its centre"
        )
    return LightProbe(diameter_mm=diameter_mm, centre_mm=(x, y), lowest_mm=z - radius, immersed=immersed)


def _rim(looks: Rays, rows: Array, columns: Array) -> tuple[Array, Array]:
    """Point at z = 0 and unit direction of viewing rays at fractional pixels."""
    x, y, slope_x, slope_y = (
        map_coordinates(field, [rows, columns], order=1)
        for field in (looks.x_mm, looks.y_mm, looks.slope_x, looks.slope_y)
    )
    upward = np.stack([slope_x, slope_y, np.ones_like(x)], axis=1)
    upward = upward / np.linalg.norm(upward, axis=1, keepdims=True)
    return np.stack([x, y, np.zeros_like(x)], axis=1), upward
