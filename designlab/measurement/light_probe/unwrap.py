"""From a picture of the ball to incident light: which way every pixel looks after the mirror, and how far."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.light_probe.sight import cropped
from designlab.measurement.light_probe.window import passed
from designlab.sensor.camera import View
from designlab.sensor.design import CHANNELS, Design
from designlab.sensor.led_mounting import seated
from designlab.simulation.optics.viewing_rays import Rays, rays

DEGREE = 5  # of the polynomials that lead from a place in the sensor to the pixel that looks there
FIT_POINTS = 40  # along each side of the picture
STEPS = 8  # to the pixel that shows a direction; each leaves about the ball's radius over twice its distance
DARKEST = 1e-3  # share of light below which a pixel is not brightened


@dataclass(frozen=True, eq=False)
class Unwrapped:
    """A picture of the ball as light that arrives at it, pixel by pixel.

    Every direction has its own origin: the point of the ball that mirrors it. Light from near sources
    therefore covers fewer directions here than as seen from any one point; `seen_sr` undoes that for a known
    distance.

    Attributes
    ----------
    names : tuple of str
        Channels: LED groups of a simulated picture, R, G, B of a camera's.
    radiance : array, shape (channels, rows, columns)
        Radiance of the light before it met the ball, in the picture's unit; NaN beside the ball.
    on_ball : bool array, shape (rows, columns)
        Pixels whose centre sees the ball.
    origin_mm : array, shape (rows, columns, 3)
        Point of the ball that the pixel sees; NaN beside it.
    direction : array, shape (rows, columns, 3)
        Unit vector from there towards the light.
    cosine : array, shape (rows, columns)
        Cosine of the angle of incidence.
    led_mm : array, shape (rows, columns)
        Distance from there, straight on, to the plane of the LED face whose middle is next to the direction.
    spread : array, shape (3, rows, columns)
        Cross-section of the bundle of rays of a pixel at distance t: spread[0] t^2 + spread[1] t + spread[2].
    view : View
        Part of the camera's sensor that the arrays cover: the ball and a narrow border.
    """

    names: tuple[str, ...]
    radiance: Array
    on_ball: NDArray[np.bool_]
    origin_mm: Array
    direction: Array
    cosine: Array
    led_mm: Array
    spread: Array
    probe: LightProbe
    view: View
    rays: Rays

    @property
    def solid_angle_sr(self) -> Array:
        """Solid angle of the directions of each pixel, shape (rows, columns); zero beside the ball."""
        return np.asarray(self.spread[0])

    def seen_sr(self, distance_mm: Array | float) -> Array:
        """Solid angle under which what a pixel shows at a distance is seen from the pixel's own origin."""
        return np.asarray(self.spread[0] + self.spread[1] / distance_mm + self.spread[2] / distance_mm**2)

    @property
    def whole(self) -> bool:
        """Whether the picture shows all of the ball that the camera can see."""
        rim = self.on_ball
        return not (rim[0].any() or rim[-1].any() or rim[:, 0].any() or rim[:, -1].any())

    @cached_property
    def _places(self) -> "_Places":
        return _Places.of(self.rays, self.probe.middle_mm[2])

    def pixel_of(self, direction: Array) -> tuple[Array, Array]:
        """Row and column, whole at pixel centres, that show light from directions (..., 3), unit vectors.

        Not a number for directions that the ball does not show: behind it, or mirrored out of the picture.
        """
        towards = np.asarray(direction, dtype=float)
        middle = np.array(self.probe.middle_mm)
        upward = np.broadcast_to([0.0, 0.0, 1.0], towards.shape)
        at = np.broadcast_to(middle, towards.shape)
        # The viewing direction hardly changes over the ball, so that this contracts fast.
        with np.errstate(invalid="ignore", divide="ignore"):
            for _ in range(STEPS):
                normal = towards + upward
                normal = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
                at = middle + self.probe.radius_mm * normal
                drop = at[..., 2] - middle[2]
                slopes = upward[..., :2] / upward[..., 2:]
                row, column, slope = self._places.find(at[..., :2] - drop[..., None] * slopes)
                upward = np.concatenate([slope, np.ones((*slope.shape[:-1], 1))], axis=-1)
                upward = upward / np.linalg.norm(upward, axis=-1, keepdims=True)
            rows, columns = self.on_ball.shape
            inside = (row >= 0) & (row <= rows - 1) & (column >= 0) & (column <= columns - 1)
            shown = inside & ((normal * upward).sum(axis=-1) > 0)
        return np.where(shown, row, np.nan), np.where(shown, column, np.nan)


class _Places(NamedTuple):
    """Polynomials from the point (x, y) where a viewing ray crosses the height of the ball's middle."""

    centre: Array
    scale: float
    coefficients: Array

    @staticmethod
    def of(rays: Rays, z_mm: float) -> "_Places":
        rows, columns = (
            np.unique(np.linspace(0, n - 1, FIT_POINTS).round().astype(int)) for n in rays.x_mm.shape
        )
        some = np.ix_(rows, columns)
        x, y = rays.x_mm + rays.slope_x * z_mm, rays.y_mm + rays.slope_y * z_mm
        points = np.stack([x[some].ravel(), y[some].ravel()], axis=-1)
        centre = points.mean(axis=0)
        scale = float(np.abs(points - centre).max())
        row, column = np.meshgrid(rows, columns, indexing="ij")
        slopes = rays.slope_x[some], rays.slope_y[some]
        wanted = np.stack([field.ravel() for field in (row, column, *slopes)])
        terms = _terms((points - centre) / scale)
        return _Places(centre, scale, np.linalg.lstsq(terms.T, wanted.T, rcond=None)[0].T)

    def find(self, points: Array) -> tuple[Array, Array, Array]:
        """Row, column and slopes of the viewing ray through points (..., 2)."""
        found = np.tensordot(self.coefficients, _terms((points - self.centre) / self.scale), axes=1)
        return found[0], found[1], np.moveaxis(found[2:], 0, -1)


def _terms(points: Array) -> Array:
    x, y = np.clip(points[..., 0], -2, 2), np.clip(points[..., 1], -2, 2)  # beyond the picture all the same
    powers_x, powers_y = [np.ones_like(x)], [np.ones_like(y)]
    for _ in range(DEGREE):
        powers_x.append(powers_x[-1] * x)
        powers_y.append(powers_y[-1] * y)
    pairs = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    return np.stack([powers_x[i] * powers_y[j] for i, j in pairs])


def unwrap(
    image: NDArray[np.floating],
    *,
    design: Design,
    probe: LightProbe,
    view: View,
    names: Sequence[str] = CHANNELS,
    groups: Sequence[int] | None = None,
) -> Unwrapped:
    """Turn a linear picture of the ball, simulated or measured, into the light that arrives at it.

    The reflectance of the ball, vignetting and losses at gelcore and window are divided out; viewing rays
    refract at window and gelcore.

    Parameters
    ----------
    image : array, shape (rows, columns, channels) or (rows, columns)
        Linear radiance, or signal above black.
    design : Design
        The sensor; its gel is taken for removed.
    probe : LightProbe
        The ball and where it lies.
    view : View
        The part of the camera's sensor that the picture shows.
    names : sequence of str
        Name of each channel.
    groups : sequence of int, optional
        LED group whose wavelength each channel has; when absent the group that the channel responds to most.

    Raises
    ------
    ValueError
        If the picture has not the size of the view, does not show the ball, or names do not fit.
    """
    picture = np.asarray(image, dtype=float)
    picture = picture[..., None] if picture.ndim == 2 else picture
    if picture.ndim != 3 or picture.shape[:2] != (view.rows, view.columns):
        shape = " x ".join(str(n) for n in picture.shape)
        raise ValueError(
            f"image: must have the view's {view.rows} rows and {view.columns} columns, has shape {shape}"
        )
    if len(names) != picture.shape[2]:
        raise ValueError(
            f"names: one for each of the image's {picture.shape[2]} channels, got {', '.join(names)}"
        )
    if groups is None:
        groups = _dominant_groups(design, len(names))
    probe.require_room(design)
    view, place = cropped(design, probe, view)
    picture = picture[place]
    bare = probe.around(design)
    looks = rays(bare, view)
    mirror = _mirror(looks, probe)
    if not mirror.on_ball.any():
        x, y = probe.centre_mm
        raise ValueError(
            f"light_probe.centre_mm: the ball must appear in the picture, none of the {view.columns} x "
            f"{view.rows} pixels sees it at ({x:g}, {y:g}) mm"
        )
    falloff = design.camera.vignette(view)
    cosine = np.where(mirror.on_ball, mirror.cosine, 1.0)
    light = []
    for channel, group in enumerate(groups):
        kept = probe.reflected(cosine, design, group)
        kept = kept * falloff * passed(bare, view, looks, group)
        light.append(picture[..., channel] / np.maximum(kept, DARKEST))
    return Unwrapped(
        names=tuple(names),
        radiance=np.where(mirror.on_ball, np.stack(light), np.nan),
        on_ball=mirror.on_ball,
        origin_mm=mirror.origin,
        direction=mirror.direction,
        cosine=mirror.cosine,
        led_mm=_led_distance_mm(design, mirror.origin, mirror.direction),
        spread=mirror.spread,
        probe=probe,
        view=view,
        rays=looks,
    )


def _dominant_groups(design: Design, channels: int) -> list[int]:
    if channels != len(CHANNELS):
        raise ValueError(f"groups: needed for a picture that has not three channels but {channels}")
    return [int(group) for group in design.mixing_matrix.argmax(axis=1)]


class _Mirror(NamedTuple):
    on_ball: NDArray[np.bool_]
    origin: Array
    direction: Array
    cosine: Array
    spread: Array


def _mirror(looks: Rays, probe: LightProbe) -> _Mirror:
    """Follow viewing rays to the ball and on, with their derivatives by row and column.

    Ray differentials as in Igehy, SIGGRAPH 1999, here exact up to the differences of neighbouring rays.
    """
    one, zero = np.ones_like(looks.x_mm), np.zeros_like(looks.x_mm)
    slope = np.stack([looks.slope_x, looks.slope_y, one], axis=-1)
    start = np.stack([looks.x_mm, looks.y_mm, zero], axis=-1)
    length = np.linalg.norm(slope, axis=-1, keepdims=True)
    upward = slope / length
    away = start - np.array(probe.middle_mm)
    along = _dot(away, upward)
    under_root = along**2 - _dot(away, away) + probe.radius_mm**2
    on_ball = under_root[..., 0] > 0
    reach = -along + np.sqrt(np.where(under_root > 0, under_root, np.nan))
    point = start + reach * upward
    normal = (away + reach * upward) / probe.radius_mm
    cosine = _dot(upward, normal)
    direction = 2 * cosine * normal - upward
    points, directions = [], []
    for axis in (0, 1):
        d_start, d_slope = (np.gradient(a, axis=axis, edge_order=2) for a in (start, slope))
        d_upward = (d_slope - upward * _dot(upward, d_slope)) / length
        sideways = d_start + reach * d_upward
        d_point = sideways - upward * _dot(sideways, normal) / cosine
        d_normal = d_point / probe.radius_mm
        d_cosine = _dot(d_upward, normal) + _dot(upward, d_normal)
        points.append(d_point)
        directions.append(2 * (d_cosine * normal + cosine * d_normal) - d_upward)

    def triple(a: Array, b: Array) -> Array:
        return np.asarray(_dot(direction, np.cross(a, b))[..., 0])

    spread = np.stack(
        [
            triple(directions[0], directions[1]),
            triple(points[0], directions[1]) + triple(directions[0], points[1]),
            triple(points[0], points[1]),
        ]
    )
    spread = np.where(on_ball, spread * np.sign(spread[0]), 0.0)
    return _Mirror(on_ball, point, direction, cosine[..., 0], spread)


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=-1, keepdims=True))


def _led_distance_mm(design: Design, origin: Array, direction: Array) -> Array:
    """Distance along each direction to the plane of the LED face whose middle is next to it."""
    nearest, found = np.full(origin.shape[:-1], -np.inf), np.full(origin.shape[:-1], np.nan)
    for face in seated(design)[1]:
        way = np.array(face.centre_mm) - origin
        distance = np.linalg.norm(way, axis=-1)
        cosine = (way * direction).sum(axis=-1) / distance
        normal = np.array(face.normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = (way @ normal) / (direction @ normal)
        # Far beside the face its plane means nothing.
        plane = np.clip(np.where(plane > 0, plane, distance), distance / 2, distance * 2)
        nearer = cosine > nearest
        nearest, found = np.where(nearer, cosine, nearest), np.where(nearer, plane, found)
    return found
