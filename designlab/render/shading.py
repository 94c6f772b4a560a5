"""Pictures of presses from the light field of a design: a sum over directions instead of rays.

A press changes the membrane's slope, lifts it and shadows it, but hardly the light that arrives from afar.
So the light that falls on the undeformed membrane is traced once, and each press is shaded from it:

- far from the indentation the picture is that of the untouched gel, kept free of grain;
- near it, the sum over direction bins with the foreshortening of the deformed normal, the parallax of the
  lifted point and the horizon of the indentation, relative to the same sum without a press;
- light that goes straight from an LED through air is integrated over the LED's face instead of bins;
- light that one wall of the indentation throws on another is gathered along the horizon, one bounce of it.

Bias figures are in docs/validation.md.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.camera import View
from designlab.coating import coating_brdf
from designlab.press import Surface
from designlab.render.direct import Response, Sources, irradiance_vector, sources
from designlab.render.eye import Eye
from designlab.render.lightfield import AZIMUTHS, Bins, LightField, on_membrane
from designlab.render.look import look
from designlab.render.nodes import Choice, Nodes, base_normals, nodes_of
from designlab.render.stray import stray
from designlab.render.tables import bilinear, held
from designlab.render.walls import FURTHEST_MM, between_walls, horizon_of
from designlab.render.window import transmission
from designlab.scene import Coating, Dielectric, Scene
from designlab.viewing import Rays

Array = NDArray[np.float64]
Single = NDArray[np.float32]
LONGEST_SHADOW_MM = 12.0
SHADOW_REACH = 4.0  # shadows reach at least this many times the height of what casts them: light at 14 deg
LOWEST_SHARE = 0.02  # of a point's light, the most grazing, whose shadows may be cut short
LATTICE_MM = 1.0  # between the points at which the most grazing light is looked for
LOBE_STRIDE = 10  # of the nodes at which the untouched gel's lobe is summed
STRAY_PHOTONS = 2_000_000  # for each group; the light they show is dim and smooth


class Shader:
    """Shades presses of one design.

    Parameters
    ----------
    field : LightField
        Light on the undeformed membrane, without what comes straight from the LEDs through air.
    scene : Scene
        The undeformed scene.
    untouched : Surface
        The undeformed membrane on the grid that all presses share.
    seed : int
        Seed of stray light.
    """

    def __init__(self, field: LightField, scene: Scene, untouched: Surface, *, seed: int) -> None:
        self._field, self._scene, self._untouched, self._seed = field, scene, untouched, seed
        self._bins = [field.bins(group) for group in range(scene.groups)]
        self._sources: list[Sources | None] = [
            None if scene.refracts else sources(scene, group) for group in range(scene.groups)
        ]
        x, y = np.meshgrid(untouched.x_mm, untouched.y_mm)
        normal = base_normals(untouched)
        smooth, binned = [], []
        for group, bins in enumerate(self._bins):
            at = [(y - field.y_mm) / bins.pitch_mm, (x - field.x_mm) / bins.pitch_mm]
            coarse = [map_coordinates(v, at, order=1, mode="nearest") for v in bins.vector]
            light, source = field.irradiance_at(group, x, y), self._sources[group]
            if source is not None:
                direct = irradiance_vector(scene, source, group, untouched, field, bins)
                fine = [map_coordinates(v, at, order=3, mode="nearest") for v in direct]
                light = light + np.einsum("krc,krc->rc", normal, fine)
            smooth.append(np.maximum(light, 0.0))
            binned.append(np.einsum("krc,krc->rc", normal, coarse))
        # Irradiance of the untouched gel at every grid node, free of grain, and by interpolation of the bins.
        # A wide lens also sees what lies beside the gel: its black rim.
        self._smooth = np.array(smooth, dtype=np.float32) * on_membrane(scene, x, y)
        self._binned = np.array(binned, dtype=np.float32)
        self._reach = max([SHADOW_REACH, *(self._shadow_reach(group) for group in range(scene.groups))])
        self._lobe: tuple[Rays, Single] | None = None
        self._passed: tuple[Rays, Array] | None = None
        self._stray: tuple[View, Single] | None = None

    def radiance(self, surface: Surface, scene: Scene, rays: Rays) -> Single:
        """Radiance of every group at the camera, shape (groups, rows, columns), at unit flux.

        Parameters
        ----------
        surface : Surface
            The pressed membrane, on the grid of the untouched one.
        scene : Scene
            The pressed scene; of it only the membrane's coating and the window matter.
        rays : Rays
            Where the pixels look.
        """
        albedo = _albedo(scene, surface)
        reach_mm = min(self._reach * float(surface.height_mm.max()), LONGEST_SHADOW_MM)
        choice = Choice.near(surface, reach_mm)
        coating = scene.membrane.material
        specular = coating.specular if isinstance(coating, Coating) else 0.0
        light, lobe = self._smooth, self._mirrored(scene, rays) if specular else np.float32(0)
        if choice is not None:
            nodes = nodes_of(surface, choice.nodes)
            horizon = horizon_of(surface, nodes, max(reach_mm, FURTHEST_MM))
            light = light.copy()
            for group in range(scene.groups):
                own = np.maximum(self._local(group, choice.nodes), 1e-12)
                pressed = np.asarray(self._light(group, nodes, horizon, _facing(nodes)))
                light[group] *= choice.spread(pressed / own, 1.0)
            if scene.path_length > (4 if scene.refracts else 2):
                between = between_walls(surface, nodes, albedo / np.pi * light)
                light += np.array([choice.spread(added, 0.0) for added in between])
            if specular:
                lobe = lobe + self._mirrored_change(scene, rays, nodes, horizon, choice)
        grids = albedo * ((1 - specular) / np.float32(np.pi) * light + specular * lobe)
        if self._passed is None or self._passed[0] is not rays:
            self._passed = rays, transmission(scene, self._untouched, rays)
        if self._stray is None or self._stray[0] != scene.view:
            around = replace(self._scene, view=scene.view)
            self._stray = scene.view, stray(around, photons_per_group=STRAY_PHOTONS, seed=self._seed)
        return np.asarray(look(grids, surface, rays) * self._passed[1] + self._stray[1], dtype=np.float32)

    def _light(self, group: int, nodes: Nodes, horizon: Any | None, response: Response) -> Any:
        """Sum over all light at membrane nodes, each direction weighted with its `response`."""
        import drjit as dr

        total = _binned_light(self._field, self._bins[group], nodes, horizon, response)
        source = self._sources[group]
        if source is not None:
            total = total + source.light(nodes, horizon, response)
        dr.eval(total)
        return total

    def _local(self, group: int, chosen: NDArray[np.bool_]) -> Single:
        """Irradiance of nodes without a press, by the same sums as with one."""
        total, source = self._binned[group][chosen], self._sources[group]
        if source is not None:
            nodes = nodes_of(self._untouched, chosen)
            total = total + np.asarray(source.light(nodes, None, _facing(nodes)))
        return np.asarray(total)

    def _shadow_reach(self, group: int) -> float:
        """Length of the longest shadow that counts, for a height of one.

        It follows from the elevation above the gel below which hardly any light of the group arrives, with
        every point counting the same, since shadows are longest where light is weak.
        """
        step = max(1, round(LATTICE_MM / self._untouched.pitch_mm))
        there = np.zeros(self._untouched.height_mm.shape, dtype=bool)
        there[::step, ::step] = True
        there &= np.isfinite(self._untouched.base_mm) & (self._smooth[group] > 0)
        grid_x, grid_y = np.meshgrid(self._untouched.x_mm, self._untouched.y_mm)
        points = np.stack([grid_x[there], grid_y[there], self._untouched.base_mm[there]], axis=-1)
        normals = np.moveaxis(base_normals(self._untouched), 0, -1)[there]
        bins, source = self._bins[group], self._sources[group]
        row = np.clip(np.rint((points[:, 1] - self._field.y_mm) / bins.pitch_mm), 0, bins.power.shape[1] - 1)
        column = np.clip(
            np.rint((points[:, 0] - self._field.x_mm) / bins.pitch_mm), 0, bins.power.shape[2] - 1
        )
        sines = [normals @ bins.direction.T]
        fluence = [bins.power[:, row.astype(int), column.astype(int)].T]
        if source is not None:
            way = source.patches[None, :, :3] - points[:, None]
            distance = np.linalg.norm(way, axis=-1)
            sines.append(np.einsum("pkc,pc->pk", way, normals) / distance)
            leaving = -np.einsum("pkc,kc->pk", way, source.patches[:, 9:12]) / distance
            fluence.append(source.patches[None, :, 13] * np.maximum(leaving, 0.0) / np.pi / distance**2)
        sine, weight = np.concatenate(sines, axis=1), np.concatenate(fluence, axis=1)
        weight = np.maximum(weight, 0.0) * np.maximum(sine, 0.0)
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-30)
        order = np.argsort(sine, axis=None)
        share = np.cumsum(weight.ravel()[order])
        if not share.size or share[-1] <= 0:
            return 0.0
        lowest = float(
            np.clip(sine.ravel()[order][np.searchsorted(share, LOWEST_SHARE * share[-1])], 1e-3, 1)
        )
        return float(np.sqrt(1 - lowest**2) / lowest)

    def _mirrored(self, scene: Scene, rays: Rays) -> Single:
        """Radiance towards the camera that the untouched gel's lobe returns, for a reflectance of one."""
        if self._lobe is None or self._lobe[0] is not rays:
            lattice = np.zeros(self._untouched.height_mm.shape, dtype=bool)
            lattice[::LOBE_STRIDE, ::LOBE_STRIDE] = True
            nodes = nodes_of(self._untouched, lattice)
            shape = lattice[::LOBE_STRIDE, ::LOBE_STRIDE].shape
            at = np.indices(lattice.shape) / LOBE_STRIDE
            response = _lobe(nodes, scene, rays)
            sums = [np.asarray(self._light(g, nodes, None, response)) for g in range(scene.groups)]
            grids = [map_coordinates(s.reshape(shape), at, order=3, mode="nearest") for s in sums]
            self._lobe = rays, np.array(grids, dtype=np.float32)
        return self._lobe[1]

    def _mirrored_change(
        self, scene: Scene, rays: Rays, nodes: Nodes, horizon: Any, choice: Choice
    ) -> Single:
        """By how much a press changes what the lobe returns."""
        before = nodes_of(self._untouched, choice.nodes)
        after_press, at_rest = _lobe(nodes, scene, rays), _lobe(before, scene, rays)
        found = []
        for group in range(scene.groups):
            pressed = self._light(group, nodes, horizon, after_press)
            untouched = self._light(group, before, None, at_rest)
            found.append(choice.spread(np.asarray(pressed - untouched), 0.0))
        return np.array(found)


def _facing(nodes: Nodes) -> Response:
    """Cosine between the membrane's normal and the light: what makes fluence irradiance."""
    import drjit as dr

    return lambda towards: dr.maximum(dr.dot(nodes.normal, towards), 0.0)


def _lobe(nodes: Nodes, scene: Scene, rays: Rays) -> Response:
    """BRDF of the coating's lobe towards the camera, for a reflectance of one, times the light's cosine."""
    import drjit as dr
    import mitsuba as mi

    coating = scene.membrane.material
    assert isinstance(coating, Coating)
    seen = Eye.of(rays).look(nodes.x, nodes.y, nodes.z)
    view = dr.normalize(mi.Vector3f(seen.slope_x, seen.slope_y, 1.0))
    cos_out = dr.dot(nodes.normal, view)

    def response(towards: Any) -> Any:
        cos_in = dr.dot(nodes.normal, towards)
        cos_half = dr.dot(nodes.normal, dr.normalize(towards + view))
        value = coating_brdf(
            dr.maximum(cos_in, 1e-4),
            dr.maximum(cos_out, 1e-4),
            cos_half,
            reflectance=1.0,
            specular=1.0,
            roughness=coating.roughness,
        )
        return dr.select((cos_in > 0) & (cos_out > 0), value * cos_in, 0.0)

    return response


def _albedo(scene: Scene, surface: Surface) -> Single:
    """Reflectance of the membrane at every grid node, shape (groups, rows, columns)."""
    coating = scene.membrane.material
    if isinstance(coating, Dielectric):
        raise ValueError("membrane: must be opaque, is a dielectric")
    shape = surface.height_mm.shape
    found = np.empty((scene.groups, *shape), dtype=np.float32)
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    for group in range(scene.groups):
        found[group] = coating.reflectance[group]
        if isinstance(coating, Coating) and coating.texture is not None:
            values = coating.texture.layer(group)
            rows, columns = values.shape
            at = [
                (0.5 - y / coating.texture.height_mm) * rows - 0.5,
                (x / coating.texture.width_mm + 0.5) * columns - 0.5,
            ]
            found[group] *= map_coordinates(values, at, order=1, mode="nearest")
    return found


def _binned_light(
    field: LightField, bins: Bins, nodes: Nodes, horizon: Any | None, response: Response
) -> Any:
    """Sum over the direction bins that hold light, in one kernel with a loop over them."""
    import drjit as dr
    import mitsuba as mi

    count = dr.width(nodes.x)
    if not len(bins.azimuth):
        return dr.zeros(mi.Float, count)
    rows, columns, number = (held(n) for n in (*bins.power.shape[1:], len(bins.azimuth)))
    x_mm, y_mm = held(field.x_mm), held(field.y_mm)
    power = mi.Float(bins.power.ravel())
    tables = [mi.Float(np.ascontiguousarray(c, dtype=np.float32)) for c in bins.direction.T]
    low, high = mi.Float(bins.lower.astype(np.float32)), mi.Float(bins.upper.astype(np.float32))
    azimuth = mi.UInt32(bins.azimuth.astype(np.uint32))
    node = dr.arange(mi.UInt32, count)

    def going(k: Any, _: Any) -> Any:
        return k < number

    def step(k: Any, total: Any) -> Any:
        towards = mi.Vector3f(*(dr.gather(mi.Float, c, k) for c in tables))
        # Light that reaches a lifted point would have met the undeformed membrane further away.
        sinking = dr.maximum(towards.z - nodes.base_p * towards.x - nodes.base_q * towards.y, 1e-3)
        across = dr.maximum(dr.sqrt(towards.x * towards.x + towards.y * towards.y), 1e-3)
        drift = dr.minimum(nodes.height / sinking, FURTHEST_MM / across)
        u = (nodes.x - drift * towards.x - x_mm) / bins.pitch_mm
        v = (nodes.y - drift * towards.y - y_mm) / bins.pitch_mm
        value = bilinear(power, u, v, rows, columns, k * (rows * columns)) * response(towards)
        if horizon is not None:
            rim = dr.gather(mi.Float, horizon, node * AZIMUTHS + dr.gather(mi.UInt32, azimuth, k))
            lower, upper = dr.gather(mi.Float, low, k), dr.gather(mi.Float, high, k)
            value = value * dr.clip((upper - rim) / (upper - lower), 0.0, 1.0)
        return k + 1, total + value

    _, total = dr.while_loop(
        (dr.zeros(mi.UInt32, count), dr.zeros(mi.Float, count)), going, step, labels=("k", "total")
    )
    return total
