"""Blur of a lens that is focused on one plane: size of the blur disc, and a picture blurred by it.

Light from a point passes the whole opening of the lens, and meets in a point of the picture only where the
lens is focused. `radius_px` follows rays through the edge of the opening, refraction included. `blur`
averages the finished picture over the discs; it leaves out that points of the opening look past an obstacle
on different sides of it.
"""

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.simulation.contact.surface import Surface
from designlab.simulation.optics.viewing_rays import Rays, rays

SMALLEST_PX = 0.02  # of radius: less is no blur
STEP_PX = 0.5  # between radii for which a whole picture is blurred
MOST_STEPS = 48
SUPERSAMPLES = 16  # along each side of a pixel of the disc's edge
BISECTIONS = 8


def radius_px(design: Design, view: View, surface: Surface) -> Array:
    """Radius of the disc in output pixels over which each pixel sees the membrane, shape (rows, columns).

    Off the axis of a window the disc becomes an ellipse; the circle of this radius has the same spread.
    """
    if design.camera.defocus is None:
        return np.zeros((view.rows, view.columns))
    centre = rays(design, view)
    z = surface.sample(np.nan_to_num(surface.z_mm), *centre.hit(surface))
    to_pixels = _pixels_per_mm(centre, z)
    square = np.zeros(z.shape)
    for point in ((1.0, 0.0), (0.0, 1.0)):
        shift_mm = _shift(centre, rays(design, view, lens_point=point), z)
        square += ((to_pixels @ shift_mm[..., None]) ** 2).sum(axis=(-2, -1))
    return np.asarray(np.sqrt(square / 2))


def _shift(centre: Rays, other: Rays, z: Array) -> Array:
    """Way along x and y from one ray of each pixel to another at height z (mm), shape (rows, columns, 2)."""
    x = other.x_mm - centre.x_mm + z * (other.slope_x - centre.slope_x)
    y = other.y_mm - centre.y_mm + z * (other.slope_y - centre.slope_y)
    return np.stack([x, y], axis=-1)


def _pixels_per_mm(centre: Rays, z: Array) -> Array:
    """Derivatives of row and column by x and y on a plane at height z (mm), shape (rows, columns, 2, 2)."""
    by_pixel = [
        np.stack([a + z * b for a, b in zip(np.gradient(place), np.gradient(slope), strict=True)], axis=-1)
        for place, slope in ((centre.x_mm, centre.slope_x), (centre.y_mm, centre.slope_y))
    ]
    return np.linalg.inv(np.stack(by_pixel, axis=-2))


def blur(image: NDArray[np.float32], radius: Array, *, squared: bool = False) -> NDArray[np.float32]:
    """Average a picture over discs whose radius varies over it.

    Parameters
    ----------
    image : array, shape (..., rows, columns)
        The sharp picture; beyond its edge it is continued in proportion.
    radius : array, shape (rows, columns)
        Radius of the disc around each pixel, in pixels.
    squared : bool
        Whether to sum by the squares of the discs' weights, as variances of independent pixels add up.
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
            disc = _disc(float(node))
            total += weight * _summed(image, disc**2 if squared else disc)
    return np.maximum(total, 0.0).astype(np.float32)


def _summed(image: NDArray[np.float32], disc: Array) -> Array:
    """Sum around every pixel by the weights of a disc."""
    from scipy.signal import oaconvolve  # with much else, which takes a second

    reach = disc.shape[0] // 2
    still = [(0, 0)] * (image.ndim - 2)
    padded = np.pad(
        image.astype(float), [*still, (reach, reach), (reach, reach)], "reflect", reflect_type="odd"
    )
    kernel = disc.reshape((1,) * (image.ndim - 2) + disc.shape)
    return np.asarray(oaconvolve(padded, kernel, mode="valid", axes=(-2, -1)))


def _disc(radius: float) -> Array:
    """Weights of the pixels in a disc; their variance along each axis is that of the disc, radius^2 / 4."""
    if radius < 1.0:
        # Smaller than a pixel: only the variance matters.
        side = radius**2 / 8
        row = np.array([side, 1 - 2 * side, side])
        return np.outer(row, row)
    reach = int(np.ceil(radius + 0.5))
    fine = np.arange((2 * reach + 1) * SUPERSAMPLES) + 0.5
    offset = fine / SUPERSAMPLES - (reach + 0.5)
    shape = 2 * reach + 1, SUPERSAMPLES, 2 * reach + 1, SUPERSAMPLES
    pixel = np.arange(-reach, reach + 1)
    # That pixels are squares adds about 1/12 to the variance, so the disc they cover must be smaller.
    low, high = 0.0, radius
    weights = np.zeros((2 * reach + 1, 2 * reach + 1))
    for _ in range(BISECTIONS):
        covered = (low + high) / 2
        inside = (offset[:, None] ** 2 + offset[None] ** 2 <= covered**2).astype(float)
        weights = inside.reshape(shape).sum(axis=(1, 3))
        weights /= weights.sum()
        wide = weights.sum(axis=0) @ pixel**2 > radius**2 / 4
        low, high = (low, covered) if wide else (covered, high)
    return weights
