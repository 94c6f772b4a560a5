"""Light that reaches the camera other than straight from the membrane: through haze, mirrored in the window.

Both are smooth over the picture and hardly depend on the press, so they are traced coarsely for the untouched
gel and added to every picture. Left out: light of the membrane that a bright housing throws back.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from designlab.matter import Dielectric, Diffuse, Medium
from designlab.refraction import crossing_mm
from designlab.render import path, photons
from designlab.render.eye import Eye
from designlab.scene import Scene, Shape
from designlab.viewing import Rays

Array = NDArray[np.float64]
Single = NDArray[np.float32]
HAZE_COLUMNS = 16  # of the picture of haze, which strongly forward scattering would make grainy in finer ones
HAZE_BLUR = 1.0  # of its pixels, standard deviation: takes off what grain is left
COARSER = 8  # pixels of the picture, along each side, to one of the housing's mirror image
FEWEST = 12  # columns of that
MIRROR_SAMPLES = 256


def stray(scene: Scene, *, photons_per_group: int, seed: int) -> Single:
    """Stray light of every LED group at unit flux, shape (groups, rows, columns)."""
    found = np.zeros((scene.groups, scene.view.rows, scene.view.columns), dtype=np.float32)
    if scatters(scene):
        haze = Haze(scene)
        for group in range(scene.groups):
            collect = haze.collector(group)
            photons.trace(
                scene,
                group=group,
                photons=photons_per_group,
                seed=seed,
                record=_nothing,
                scattered=collect.add,
            )
            found[group] += haze.picture(collect)
    if any(shape.name.startswith("housing") for shape in scene.shapes) and scene.refracts:
        found += _mirrored(scene, seed)
    return found


def scatters(scene: Scene) -> bool:
    """Whether the gelcore is hazy."""
    return scene.refracts and _boundary(scene, "window").inside.scattering_per_mm > 0


def _nothing(arrival: photons.Arrival, active: Any) -> None:
    pass


def _boundary(scene: Scene, name: str) -> Dielectric:
    material = _shape(scene, name).material
    assert isinstance(material, Dielectric)
    return material


def _shape(scene: Scene, name: str) -> Shape:
    return next(shape for shape in scene.shapes if shape.name == name)


class Haze:
    """Light that the haze of the gelcore throws into the camera through the window.

    Each time a photon is scattered in the core, the share of it that goes towards the camera is seen by the
    pixel in that direction.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._core = _boundary(scene, "window").inside
        self._window_mm = float(_shape(scene, "window").vertices[:, 2].max())
        self._coarse = _coarse(scene, HAZE_COLUMNS)
        self._eye = Eye.of(self._rays())

    def _rays(self) -> Rays:
        """Viewing rays in the core, as if it reached down to z = 0."""
        camera, view = self._scene.camera, self._coarse.view
        right, up, forward = camera.unproject(*view.centres())
        tan_x, tan_y = right / forward, up / forward
        x, y, z = camera.position_mm
        layers = [(self._window_mm, self._core.index), (z - self._window_mm, 1.0)]
        scale, slope = crossing_mm(np.hypot(tan_x, tan_y), layers)
        return Rays(x + scale * tan_x, y + scale * tan_y, -slope * tan_x, -slope * tan_y, 1.0)

    def collector(self, group: int) -> "_Collector":
        """Return an empty coarse picture to collect light in."""
        extinction = self._core.absorption_per_mm[group] + self._core.scattering_per_mm
        return _Collector(self._eye, self._coarse, self._core, extinction, self._window_mm)

    def picture(self, collected: "_Collector") -> Single:
        """Collected light at the size of the scene's picture."""
        view = self._coarse.view
        grainy = np.asarray(collected.table).reshape(view.rows, view.columns)
        return _enlarged(gaussian_filter(grainy, HAZE_BLUR, mode="nearest"), self._scene)


class _Collector:
    def __init__(self, eye: Eye, coarse: Scene, core: Medium, extinction: float, window_mm: float) -> None:
        import drjit as dr
        import mitsuba as mi

        self._eye, self._view, self._core = eye, coarse.view, core
        self._extinction, self._window_mm = extinction, window_mm
        self.table = dr.zeros(mi.Float, coarse.view.rows * coarse.view.columns)

    def add(self, event: photons.Scattering, active: Any) -> None:
        """See what photons scatter towards the camera."""
        import drjit as dr
        import mitsuba as mi

        at = event.position
        seen = self._eye.look(at.x, at.y, at.z)
        column, row = mi.Int32(dr.floor(seen.column + 0.5)), mi.Int32(dr.floor(seen.row + 0.5))
        active = active & (column >= 0) & (column < self._view.columns) & (row >= 0) & (row < self._view.rows)
        towards = dr.normalize(mi.Vector3f(seen.slope_x, seen.slope_y, 1.0))
        g = self._core.anisotropy
        cosine = dr.dot(event.direction, towards)
        phase = (1 - g * g) / (4 * dr.pi * dr.power(1 + g * g - 2 * g * cosine, 1.5))
        reflected, *_ = mi.fresnel(towards.z, 1 / self._core.index)
        kept = (1 - reflected) * dr.exp(-self._extinction * (self._window_mm - at.z) / towards.z)
        # Radiance falls with the square of the index on leaving the core.
        value = event.power * phase * kept / (towards.z * seen.area * self._core.index**2)
        dr.scatter_add(self.table, value, mi.UInt32(dr.maximum(row * self._view.columns + column, 0)), active)


def _mirrored(scene: Scene, seed: int) -> Single:
    """What the camera sees of a bright housing in the window, by path tracing over a black membrane."""
    coarse = _coarse(scene, max(FEWEST, scene.view.columns // COARSER))
    black = Diffuse((0.0,) * scene.groups)
    shapes = tuple(
        replace(shape, material=black if shape.name == "membrane" else _clear(shape.material))
        for shape in coarse.shapes
    )
    seen = path.radiance(replace(coarse, shapes=shapes), samples=MIRROR_SAMPLES, seed=seed)
    return np.stack([_enlarged(image, scene) for image in seen])


def _clear(material: Any) -> Any:
    """The same material with scattered light lost: haze is counted elsewhere."""
    if not isinstance(material, Dielectric):
        return material

    def lossy(medium: Medium) -> Medium:
        absorption = tuple(a + medium.scattering_per_mm for a in medium.absorption_per_mm)
        return replace(medium, absorption_per_mm=absorption, scattering_per_mm=0.0)

    return replace(material, inside=lossy(material.inside), outside=lossy(material.outside))


def _coarse(scene: Scene, columns: int) -> Scene:
    """The same scene at the resolution of stray light."""
    view = scene.view
    columns = min(view.columns, columns)
    rows = max(1, round(columns * view.rows / view.columns))
    return replace(scene, view=view._replace(columns=columns, rows=rows))


def _enlarged(coarse: NDArray[np.floating], scene: Scene) -> Single:
    """Interpolate between the centres of coarse pixels."""
    rows, columns = scene.view.rows, scene.view.columns
    at = [
        (np.arange(fine) + 0.5) * count / fine - 0.5
        for fine, count in zip((rows, columns), coarse.shape, strict=True)
    ]
    grid = np.meshgrid(*at, indexing="ij")
    return np.asarray(map_coordinates(coarse, grid, order=1, mode="nearest"), dtype=np.float32)
