"""Blur of a lens that is focused on one plane: size of the blur disc, and a picture blurred by it.

Light from a point passes the whole opening of the lens, and meets in a point of the picture only where the
lens is focused. `radius_px` follows rays through the edge of the opening, refraction included. `blur`
averages the finished picture over the discs; it leaves out that points of the opening look past an obstacle
on different sides of it.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import oaconvolve

from designlab.camera import View
from designlab.design import Design
from designlab.press import Surface
from designlab.viewing import Rays, rays

Array = NDArray[np.float64]
SMALLEST_PX = 0.02  # of radius: less is no blur
STEP_PX = 0.5  # between radii for which a whole picture is blurred
MOST_STEPS = 48
SUPERSAMPLES = 16  # along each side of a pixel of the disc's edge


def radius_px(design: Design, view: View, surface: Surface) -> Array:
    """Radius of the disc in output pixels over which each pixel sees the membrane, shape (rows, columns).

    Off the axis of a window the disc becomes an ellipse; the radius is that of the circle of equal area.
    """
    if design.camera.defocus is None:
        return np.zeros((view.rows, view.columns))
    centre = rays(design, view)
    z = surface.sample(np.nan_to_num(surface.z_mm), *centre.hit(surface))
    along_x, along_y = (_shift(centre, rays(design, view, lens_point=point), z) for point in ((1, 0), (0, 1)))
    area = along_x[0] * along_y[1] - along_x[1] * along_y[0]
    return np.asarray(np.sqrt(np.abs(area / _pixel_area_mm2(centre, z))))


def _shift(centre: Rays, other: Rays, z: Array) -> tuple[Array, Array]:
    """Way from one ray of each pixel to another at height z (mm)."""
    return (
        other.x_mm - centre.x_mm + z * (other.slope_x - centre.slope_x),
        other.y_mm - centre.y_mm + z * (other.slope_y - centre.slope_y),
    )


def _pixel_area_mm2(centre: Rays, z: Array) -> Array:
    """Area between the rays of neighbouring pixels on a plane at height z (mm)."""
    x_row, x_column = (
        a + z * b for a, b in zip(np.gradient(centre.x_mm), np.gradient(centre.slope_x), strict=True)
    )
    y_row, y_column = (
        a + z * b for a, b in zip(np.gradient(centre.y_mm), np.gradient(centre.slope_y), strict=True)
    )
    return np.asarray(x_column * y_row - x_row * y_column)


def blur(image: NDArray[np.float32], radius: Array) -> NDArray[np.float32]:
    """Average a picture over discs whose radius varies over it.

    Parameters
    ----------
    image : array, shape (..., rows, columns)
        The sharp picture; what lies outside it is taken to be like its edge.
    radius : array, shape (rows, columns)
        Radius of the disc around each pixel, in pixels.
    """
    smallest, largest = float(radius.min()), float(radius.max())
    if largest < SMALLEST_PX:
        return image
    steps = int(np.clip(np.ceil((largest - smallest) / STEP_PX), 1, MOST_STEPS))
    nodes = np.linspace(smallest, largest, steps + 1)
    # The width of what a point becomes grows with the square of the radius, so that is interpolated.
    place = np.interp(radius**2, nodes**2, np.arange(steps + 1))
    total = np.zeros(image.shape)
    for number, node in enumerate(nodes):
        weight = np.clip(1 - np.abs(place - number), 0.0, 1.0)
        if weight.any():
            total += weight * _blurred(image, float(node))
    return total.astype(np.float32)


def _blurred(image: NDArray[np.float32], radius: float) -> Array:
    disc = _disc(radius)
    reach = disc.shape[0] // 2
    still = [(0, 0)] * (image.ndim - 2)
    padded = np.pad(image.astype(float), [*still, (reach, reach), (reach, reach)], mode="edge")
    kernel = disc.reshape((1,) * (image.ndim - 2) + disc.shape)
    return np.asarray(oaconvolve(padded, kernel, mode="valid", axes=(-2, -1)))


def _disc(radius: float) -> Array:
    """Weights of the pixels in a disc; their variance along each axis is that of the disc, radius^2 / 4."""
    if radius < 1.0:
        # Smaller than a pixel: only the variance matters.
        side = radius**2 / 8
        row = np.array([side, 1 - 2 * side, side])
        return np.outer(row, row)
    # Pixels are squares, which adds 1/12 to the variance.
    covered = np.sqrt(radius**2 - 1 / 3)
    reach = int(np.ceil(covered + 0.5))
    fine = np.arange((2 * reach + 1) * SUPERSAMPLES) + 0.5
    offset = fine / SUPERSAMPLES - (reach + 0.5)
    inside = (offset[:, None] ** 2 + offset[None] ** 2 <= covered**2).astype(float)
    shape = 2 * reach + 1, SUPERSAMPLES, 2 * reach + 1, SUPERSAMPLES
    weights = inside.reshape(shape).sum(axis=(1, 3))
    return np.asarray(weights / weights.sum())
