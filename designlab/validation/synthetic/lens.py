"""The lens acts between membrane and pixels: distortion, blur, fall-off, stray light, drops and ghosts."""

import numpy as np
from scipy.fft import dctn, fft2, fftfreq, idctn, ifft2
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import j1

from designlab.core.types import Array
from designlab.sensor.camera import Camera, View
from designlab.validation.synthetic.generator_sensor import Rig, TrueLens

GLARE_WIDTHS = 0.3  # sigma of stray light in widths of the picture
GHOST_SIZE = 0.3  # of a ghost over the LED as the camera would see it
DROP_BLUR = 0.12  # sigma behind a drop over its radius


def seen(camera: Camera, lens: TrueLens, column: Array, row: Array) -> tuple[Array, Array]:
    """Places of an ideal picture that are seen at places of the real one (px of the full sensor).

    The cubic d (1 + magnification + radial r^2) = d' is solved for d by Newton's method.
    """
    if not (lens.radial or lens.magnification):
        return column, row
    x_c, y_c = camera.centre_px
    right, down = column - x_c, row - y_c
    wanted = camera.radius_px(column, row) / camera.half_diagonal_px
    r = wanted / (1 + lens.magnification)
    for _ in range(20):
        r = r - (r * (1 + lens.magnification + lens.radial * r**2) - wanted) / np.maximum(
            1 + lens.magnification + 3 * lens.radial * r**2, 0.05
        )
    scale = np.where(wanted > 0, r / np.maximum(wanted, 1e-12), 1 / (1 + lens.magnification))
    return x_c + right * scale, y_c + down * scale


def disc_px(camera: Camera, lens: TrueLens) -> float:
    """Radius of the disc of blur in columns of the full sensor: a disc's rms for each axis is half of it."""
    return 2 * lens.blur_um / 1000 * camera.focal_px / camera.position_mm[2]


def margin(camera: Camera, lens: TrueLens, view: View) -> int:
    """Output pixels around a view that have to be known."""
    if not lens.blur_um:
        return 0
    most_px = disc_px(camera, lens) * max(1.0, camera.pixel_aspect)
    return int(np.ceil(most_px * view.columns / view.width_px)) + 2


def blurred(picture: Array, *, radius: float, aspect: float = 1.0) -> Array:
    """Blur by a uniform disc of a radius in columns, (groups, rows, columns), continued by mirroring.

    The spectrum is multiplied by that of a disc, 2 J1(k R) / (k R), which has no pixels. These are `aspect`
    times as wide as high, so that the disc is so many times as high in rows as it is wide in columns.
    """
    if radius <= 0:
        return picture
    pad = int(np.ceil(radius * max(1.0, aspect))) + 4
    rows, columns = picture.shape[1:]
    wide = np.pad(picture, ((0, 0), (pad, pad), (pad, pad)), mode="symmetric")
    k_y, k_x = (2 * np.pi * fftfreq(n) for n in wide.shape[1:])
    z = radius * np.hypot(k_y[:, None] * aspect, k_x[None, :])
    disc = np.where(z < 1e-6, 1.0, 2 * j1(z) / np.maximum(z, 1e-6))
    spread = ifft2(fft2(wide) * disc).real
    return np.asarray(spread[:, pad : pad + rows, pad : pad + columns])


def falloff(camera: Camera, lens: TrueLens, view: View) -> Array:
    """Vignetting as a power of the cosine of the angle at which light meets the sensor, (rows, columns).

    The power is the one that loses in the picture's furthest corner what the parabola 1 - loss r^2 does.
    """
    column, row = view.centres()
    if not lens.corner_loss:
        return np.ones(column.shape)
    square = camera.radius_px(column, row) ** 2
    cosine = 1 / np.sqrt(1 + square / camera.focal_px**2)
    power = np.log(1 - lens.corner_loss * square.max() / camera.half_diagonal_px**2) / np.log(cosine.min())
    return np.asarray(cosine**power)


def with_glare(picture: Array, *, share: float) -> Array:
    """Send a share of the light of a picture (rows, columns, channels) all over it.

    The cosine transform continues the picture by mirroring, so that a Gaussian needs one product there.
    """
    if not share:
        return picture
    rows, columns = picture.shape[:2]
    sigma = GLARE_WIDTHS * columns
    decay = [np.exp(-((np.pi * np.arange(n) / n * sigma) ** 2) / 2) for n in (rows, columns)]
    wide = idctn(dctn(picture, axes=(0, 1)) * decay[0][:, None, None] * decay[1][None, :, None], axes=(0, 1))
    return np.asarray((1 - share) * picture + share * wide)


def colour_shifted(picture: Array, camera: Camera, view: View, *, shift: float) -> Array:
    """Magnify red and reduce blue about the principal point; picture (rows, columns, 3)."""
    if not shift:
        return picture
    x_c, y_c = camera.centre_px
    column = (x_c - view.x_px) * view.columns / view.width_px - 0.5
    row = (y_c - view.y_px) * view.rows / view.height_px - 0.5
    grid = np.mgrid[: view.rows, : view.columns].astype(float)
    moved = picture.copy()
    for channel, scale in ((0, 1 / (1 + shift)), (2, 1 / (1 - shift))):
        place = [row + (grid[0] - row) * scale, column + (grid[1] - column) * scale]
        moved[..., channel] = map_coordinates(picture[..., channel], place, order=3, mode="nearest")
    return moved


def behind_drop(picture: Array, drop: tuple[float, float, float, float]) -> Array:
    """Picture (groups, rows, columns) with a drop on the lens: blurred and shifted within a soft circle.

    `drop` is its centre, radius and shift towards the right, in widths of the picture.
    """
    x, y, radius, shift = drop
    rows, columns = picture.shape[1:]
    row, column = np.mgrid[:rows, :columns].astype(float)
    away = np.hypot(column + 0.5 - x * columns, row + 0.5 - y * columns) / (radius * columns)
    within = np.clip((1 - away) / 0.2, 0.0, 1.0)
    place = [row, column - within * shift * columns]
    changed = np.empty_like(picture)
    for number, layer in enumerate(picture):
        soft = gaussian_filter(layer, DROP_BLUR * radius * columns, mode="nearest")
        changed[number] = map_coordinates(soft, place, order=1, mode="nearest")
    return np.asarray(picture + within * (changed - picture))


def ghosts(rig: Rig, view: View) -> Array:
    """Mirror images of the LEDs of every group, of unit mean brightness, shape (groups, rows, columns).

    Light that is reflected twice between lenses shows what lies outside the picture, turned by 180 deg about
    the principal point and reduced.
    """
    camera = rig.camera
    x_c, y_c = camera.centre_px
    column, row = view.centres()
    found = np.zeros((len(rig.flux_mw), *column.shape))
    for group, centre, _, across, _, half in zip(*rig.emitters, strict=True):
        to = centre - np.array(camera.position_mm)
        right, down = camera.focal_px * to[0] / -to[2], -camera.focal_px * to[1] / -to[2]
        scale = camera.focal_px / -to[2] * GHOST_SIZE
        # In widths of a pixel, whatever its height.
        u, v = column - x_c + GHOST_SIZE * right, (row - y_c) / camera.pixel_aspect + GHOST_SIZE * down
        # Along the row of LEDs, whose direction a turn by 180 deg keeps, and across it.
        axis = across[:2] / np.hypot(*across[:2])
        along, off = u * axis[0] - v * axis[1], u * axis[1] + v * axis[0]
        soft = 0.25 * half[0] * scale
        edges = [
            np.clip((scale * size - np.abs(d)) / soft + 0.5, 0, 1)
            for d, size in ((along, half[0]), (off, half[0] / 2))
        ]
        found[group] = np.maximum(found[group], edges[0] * edges[1])
    return found
