"""Light that reaches the camera other than straight from the membrane: through haze, mirrored in the window.

Both are smooth over the picture and hardly depend on the press, so they are traced coarsely for the untouched
gel and added to every picture.
"""

from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from designlab.core.types import Single
from designlab.sensor.camera import View
from designlab.sensor.refraction import crossing_mm
from designlab.simulation.optics.viewing_rays import Rays
from designlab.simulation.render import photons
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.eye import Eye, ProjectedPoints
from designlab.simulation.scene.materials import Dielectric, Diffuse
from designlab.simulation.scene.scene import Scene, Shape

COLUMNS = 16  # of the picture of stray light; strongly forward scattering haze makes finer ones grainy
SHARE = 0.25  # of the photons of the picture: stray light is dim and smooth
BLUR = 1.0  # of its pixels, standard deviation: takes off what grain is left


def stray(scene: Scene, *, photons_per_group: int, seed: int) -> Single:
    """Stray light of every LED group at unit flux, shape (groups, rows, columns).

    Parameters
    ----------
    scene : Scene
        Where light goes; its camera sees the stray light.
    photons_per_group : int
        Effort of the picture it is added to.
    seed : int
        Seed of the random numbers.
    """
    found = np.zeros((scene.groups, scene.view.rows, scene.view.columns), dtype=np.float32)
    hazy, bright = scatters(scene), scene.refracts and bool(_housing(scene))
    if not (hazy or bright):
        return found
    for group in range(scene.groups):
        picture = _Picture(scene.view)
        photons.trace(
            scene,
            group=group,
            photons=max(1, round(SHARE * photons_per_group)),
            seed=seed,
            record=_nothing,
            scattered=_Haze(scene, group, picture).scattered if hazy else None,
            housing=_Mirror(scene, group, picture).arrived if bright else None,
        )
        found[group] = picture.enlarged()
    return found


def scatters(scene: Scene) -> bool:
    """Whether the gelcore is hazy."""
    return scene.refracts and _window(scene).inside.scattering_per_mm > 0


def _nothing(arrival: photons.Arrival, active: Any) -> None:
    pass


def _housing(scene: Scene) -> list[Shape]:
    return [shape for shape in scene.shapes if shape.name.startswith("housing")]


def _window(scene: Scene) -> Dielectric:
    material = _window_shape(scene).material
    assert isinstance(material, Dielectric)
    return material


def _window_shape(scene: Scene) -> Shape:
    return next(shape for shape in scene.shapes if shape.name == "window")


class _Picture:
    """Coarse picture in which light is collected."""

    def __init__(self, view: View) -> None:
        columns = min(view.columns, COLUMNS)
        self._fine = view.rows, view.columns
        self.view = view._replace(columns=columns, rows=max(1, round(columns * view.rows / view.columns)))
        self._table = dr.zeros(mi.Float, self.view.rows * self.view.columns)

    def add(self, seen: ProjectedPoints, value: Any, active: Any) -> None:
        """Add a radiance to the pixel that sees it."""
        rows, columns = self.view.rows, self.view.columns
        column, row = mi.Int32(dr.floor(seen.column + 0.5)), mi.Int32(dr.floor(seen.row + 0.5))
        active = active & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        dr.scatter_add(self._table, value, mi.UInt32(dr.maximum(row * columns + column, 0)), active)

    def enlarged(self) -> Single:
        """Picture at the size of the view, smoothed."""
        coarse = np.asarray(self._table).reshape(self.view.rows, self.view.columns)
        smooth = gaussian_filter(coarse, BLUR, mode="nearest")
        at = [
            (np.arange(fine) + 0.5) * count / fine - 0.5
            for fine, count in zip(self._fine, coarse.shape, strict=True)
        ]
        grid = np.meshgrid(*at, indexing="ij")
        return np.asarray(map_coordinates(smooth, grid, order=1, mode="nearest"), dtype=np.float32)


def _rays(scene: Scene, view: View, layers: list[tuple[float, float]]) -> Rays:
    """Viewing rays in the first of plane layers, as if it reached down to z = 0."""
    right, up, forward = scene.camera.unproject(*view.centres())
    tan_x, tan_y = right / forward, up / forward
    x, y, _ = scene.camera.eye_mm
    scale, slope = crossing_mm(np.hypot(tan_x, tan_y), layers)
    return Rays(x + scale * tan_x, y + scale * tan_y, -slope * tan_x, -slope * tan_y, 1.0)


class _Haze:
    """Light that the haze of the gelcore throws into the camera through the window.

    Each time a photon is scattered in the core, the share of it that goes towards the camera is seen by the
    pixel in that direction.
    """

    def __init__(self, scene: Scene, group: int, picture: _Picture) -> None:
        self._core, self._picture = _window(scene).inside, picture
        self._window_mm = float(_window_shape(scene).vertices[:, 2].max())
        self._extinction = self._core.absorption_per_mm[group] + self._core.scattering_per_mm
        layers = [(self._window_mm, self._core.index), (scene.camera.eye_mm[2] - self._window_mm, 1.0)]
        self._eye = Eye.of(_rays(scene, picture.view, layers))

    def scattered(self, event: photons.Scattering, active: Any) -> None:
        """See what photons scatter towards the camera."""
        at = event.position
        seen = self._eye.look(at.x, at.y, at.z)
        towards = dr.normalize(mi.Vector3f(seen.slope_x, seen.slope_y, 1.0))
        g = self._core.anisotropy
        cosine = dr.dot(event.direction, towards)
        phase = (1 - g * g) / (4 * dr.pi * dr.power(1 + g * g - 2 * g * cosine, 1.5))
        reflected, *_ = mi.fresnel(towards.z, 1 / self._core.index)
        kept = (1 - reflected) * dr.exp(-self._extinction * (self._window_mm - at.z) / towards.z)
        # Radiance falls with the square of the index on leaving the core.
        value = event.power * phase * kept / (towards.z * seen.area * self._core.index**2)
        self._picture.add(seen, value, active)


class _Mirror:
    """Inside of a bright housing, seen by the camera as a mirror image in the window.

    Behind the mirror every point of the housing above the window has an image below it, which the camera sees
    along a straight line, dimmed to what the window reflects.
    """

    def __init__(self, scene: Scene, group: int, picture: _Picture) -> None:
        material = _housing(scene)[0].material
        assert isinstance(material, Diffuse)
        self._reflectance, self._picture = material.reflectance[group], picture
        self._index = _window(scene).inside.index
        self._window_mm = float(_window_shape(scene).vertices[:, 2].max())
        self._eye = Eye.of(_rays(scene, picture.view, [(scene.camera.eye_mm[2], 1.0)]))

    def arrived(self, arrival: photons.Arrival, active: Any) -> None:
        """See the mirror image of what photons light up."""
        at, normal = arrival.at.p, arrival.at.n
        height = 2 * self._window_mm - at.z
        seen = self._eye.look(at.x, at.y, height)
        towards = dr.normalize(mi.Vector3f(seen.slope_x, seen.slope_y, 1.0))
        facing = dr.dot(mi.Vector3f(normal.x, normal.y, -normal.z), towards)
        lit = (dr.dot(normal, arrival.towards) > 0) & (facing > 0) & (at.z > self._window_mm)
        reflected, *_ = mi.fresnel(towards.z, self._index)
        value = arrival.power * self._reflectance / np.pi * facing * reflected / (towards.z * seen.area)
        self._picture.add(seen, value, active & lit)
