"""Pictures of presses from the light field of a design: sums over directions instead of rays.

A press changes the membrane's slope, lifts it and shadows it, but hardly the light that arrives from afar.
So the light that falls on the undeformed membrane is traced once, and each press is shaded from it:

- far from the indentation the picture is that of the untouched gel, kept free of grain;
- near it, it changes by the difference of two sums over direction bins, with and without the press: with the
  foreshortening of the deformed normal, the parallax of the lifted point, the horizon of the indentation;
- light on its first way behind glass takes its averages from photons instead, see `landings`;
- light that goes straight from an LED through air is integrated over the LED's face instead of bins;
- where gel bulges, which may be all over the picture but is smooth, what its slope does to the light of the
  undeformed membrane is taken for every point, and what is left of the difference of sums for few;
- light that one wall of the indentation throws on another, or the gel around on it, is gathered along the
  horizon, one bounce of it.

How far pictures are off is in docs/validation.md.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from designlab.core.types import Mask, Single
from designlab.sensor.camera import View
from designlab.simulation.contact.surface import Surface
from designlab.simulation.optics.viewing_rays import Rays
from designlab.simulation.render.binned import Binned
from designlab.simulation.render.direct import Direct
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.eye import Eye
from designlab.simulation.render.landings import FirstLight, IrradianceChange
from designlab.simulation.render.lightfield import LightField, on_membrane
from designlab.simulation.render.look import look
from designlab.simulation.render.nodes import Choice, Nodes, Response, base_normals, facing, nodes_of
from designlab.simulation.render.tables import held
from designlab.simulation.render.walls import FURTHEST_MM, Around, between_walls, horizon_of
from designlab.simulation.render.window import transmission
from designlab.simulation.scene.coating import coating_brdf
from designlab.simulation.scene.scene import Coating, Dielectric, Scene

LONGEST_SHADOW_MM = 12.0
SHADOW_REACH = 4.0  # shadows reach at least this many times the height of what casts them: light at 14 deg
LOWEST_SHARE = 0.02  # of a point's light, the most grazing, whose shadows may be cut short
AROUND_MM = 0.5  # between the points of the membrane beyond the grid
LATTICE_MM = 2.0  # between the points at which the most grazing light is looked for
SMALL_SLOPE = 0.02  # by which the gel is tilted to see how the lobe answers
LOBE_STRIDE = 10  # of the nodes at which the untouched gel's lobe is summed
KERNEL_MM = 0.2  # standard deviation of the kernel over which photons correct the sums
WIDE_MM = 0.4  # likewise, of the kernel for what the narrow one cannot tell from the grain of the photons
SIGNIFICANT = 2.0  # times the variance of the grain, below which a difference between the two is grain
PASSES = 3  # of the correction: each takes what the kernel of the one before has left at sharp edges
KERNEL_REACH = 4.0  # standard deviations after which it ends
LEAST_SHARE = 0.02  # of the mean irradiance: where less is left than that, ratios mean nothing
MOST_GAIN = 1.5  # from a sum over direction bins to the irradiance of the untouched gel


class _UnderWay(NamedTuple):
    """Light at the nodes of a press, which the device still sums: of each group, straight and again."""

    surface: Surface
    choice: Choice
    nodes: Nodes
    horizon: Any
    sums: list[tuple[Any, Any]]


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
    stray_light : callable
        Gives the stray light that the camera of a scene sees, shape (groups, rows, columns).
    """

    def __init__(
        self, field: LightField, scene: Scene, untouched: Surface, stray_light: Callable[[Scene], Single]
    ) -> None:
        self._scene, self._untouched, self._stray_light = scene, untouched, stray_light
        groups = range(scene.groups)
        self._straight: list[Binned | Direct] = [
            Binned(field.first, group, untouched) if field.first else Direct(scene, group, untouched)
            for group in groups
        ]
        self._again = [Binned(field.again, group, untouched, fine=field.first is None) for group in groups]
        self._landings = field.landings
        # A wide lens also sees what lies beside the gel: its black rim.
        self._there = on_membrane(scene, *np.meshgrid(untouched.x_mm, untouched.y_mm))
        self._light_around: tuple[Single, float, float] | None = None
        self._lobe: tuple[Rays, Single] | None = None
        self._stray: tuple[View, Single] | None = None
        self._under_way: _UnderWay | None = None

    def radiance(
        self, surface: Surface, scene: Scene, rays: Rays, *, following: Surface | None = None
    ) -> Single:
        """Radiance of every group at the camera, shape (groups, rows, columns), at unit flux.

        Parameters
        ----------
        surface : Surface
            The pressed membrane, on the grid of the untouched one.
        scene : Scene
            The pressed scene; of it only the membrane's coating and the window matter.
        rays : Rays
            Where the pixels look.
        following : Surface, optional
            The press that is shaded next: its sums are begun before this one's are finished.
        """
        pressed, self._under_way = self._under_way, None
        if pressed is None or pressed.surface is not surface:
            pressed = self._begun(surface)
        albedo = _albedo(scene, surface)
        coating = scene.membrane.material
        specular = coating.specular if isinstance(coating, Coating) else 0.0
        groups = range(scene.groups)
        # Beside the gel there is nothing to be lit, nor to light walls.
        light = self._there * np.array(
            [self._straight[g].irradiance + self._again[g].irradiance for g in groups]
        )
        lobe = self._mirrored(scene, rays) if specular else np.float32(0)
        if pressed is not None:
            sums = [(np.asarray(straight), np.asarray(again)) for straight, again in pressed.sums]
            landed = [first.change(surface) for first in self._first]
            if following is not None:
                self._under_way = self._begun(following)
            tilted = self._tilted(surface) if surface.bulges else None
            light += np.array(
                [self._change(g, surface, pressed.choice, sums[g], landed, tilted) for g in groups]
            )
            light = np.maximum(light, 0.0)
            if scene.path_length > (4 if scene.refracts else 2):
                between = between_walls(surface, pressed.nodes, albedo / np.pi * light, self._around(albedo))
                light += np.array([pressed.choice.spread(added, 0.0) for added in between])
            if specular:
                lobe = lobe + self._mirrored_change(scene, rays, pressed)
        grids = self._there * albedo * ((1 - specular) / np.float32(np.pi) * light + specular * lobe)
        straight = look(grids, surface, rays) * transmission(self._scene, self._untouched, rays)
        return np.asarray(straight + self.stray(scene.view), dtype=np.float32)

    def stray(self, view: View) -> Single:
        """Part of every picture that is not straight from the membrane, shape (groups, rows, columns)."""
        if self._stray is None or self._stray[0] != view:
            self._stray = view, self._stray_light(replace(self._scene, view=view))
        return self._stray[1]

    def response(self, scene: Scene, rays: Rays) -> Single:
        """Change of the untouched gel's picture per unit slope of the membrane.

        Each pixel's own slope counts; what slopes around it would throw there does not.

        Parameters
        ----------
        scene, rays : Scene, Rays
            As of `radiance`.

        Returns
        -------
        array, shape (groups, rows, columns, 2)
            Derivative of the radiance at unit flux by p = dz/dx and q = dz/dy.
        """
        untouched = self._untouched
        p, q = np.nan_to_num(untouched.base_p), np.nan_to_num(untouched.base_q)
        length = np.sqrt(1 + p**2 + q**2)
        coating = scene.membrane.material
        specular = coating.specular if isinstance(coating, Coating) else 0.0
        by_slope = []
        for slope, axis in ((p, 0), (q, 1)):
            light = np.zeros((scene.groups, *p.shape))
            for group in range(scene.groups):
                for part in (self._straight[group], self._again[group]):
                    summed = (part.vector[2] - p * part.vector[0] - q * part.vector[1]) / length
                    # Cells of the bins are wider than those of the irradiance.
                    gain = np.clip(part.irradiance / np.maximum(summed, 1e-30), 0.0, MOST_GAIN)
                    light[group] -= gain * (part.vector[axis] / length + summed * slope / length**2)
            change = (1 - specular) / np.pi * light
            if specular:
                change = change + specular * self._lobe_response(scene, rays, axis)
            grids = np.asarray(self._there * _albedo(scene, untouched) * change, dtype=np.float32)
            by_slope.append(look(grids, untouched, rays))
        return np.asarray(np.stack(by_slope, axis=-1) * transmission(self._scene, untouched, rays)[..., None])

    def _lobe_response(self, scene: Scene, rays: Rays, axis: int) -> Single:
        """Derivative of what the lobe returns by one slope, for a reflectance of one."""
        high, low = (self._lobe_of(scene, rays, tilted=(axis, side * SMALL_SLOPE)) for side in (1, -1))
        return np.asarray((high - low) / (2 * SMALL_SLOPE), dtype=np.float32)

    @cached_property
    def _first(self) -> list[FirstLight]:
        found = [FirstLight(landings, self._untouched) for landings in self._landings]
        self._landings = ()  # the device holds them now
        return found

    @cached_property
    def _reach(self) -> float:
        """Length of shadows for a height of one."""
        return max([SHADOW_REACH, *map(self._shadow_reach, range(self._scene.groups))])

    def _around(self, albedo: Single) -> Around:
        """Radiance of the undeformed membrane, also beyond the grid of presses."""
        mean = albedo.mean(axis=(1, 2), keepdims=True) / np.float32(np.pi)
        if self._light_around is None:
            low, high = (getattr(self._scene.membrane.vertices, of)(axis=0)[:2] for of in ("min", "max"))
            x, y = (np.arange(a, b + AROUND_MM, AROUND_MM) for a, b in zip(low, high, strict=True))
            there = on_membrane(self._scene, *np.meshgrid(x, y))
            parts = zip(self._straight, self._again, strict=True)
            light = np.array([(a.irradiance_at(x, y) + b.irradiance_at(x, y)) * there for a, b in parts])
            self._light_around = light, float(low[0]), float(low[1])
        light, x_mm, y_mm = self._light_around
        return Around(mean * light, x_mm, y_mm, AROUND_MM)

    def _begun(self, surface: Surface) -> _UnderWay | None:
        """Have the device sum the light at the nodes of a press; None where nothing is pressed."""
        raised_mm, lowest_mm = float(surface.height_mm.max()), min(float(surface.height_mm.min()), 0.0)
        reach_mm = min(self._reach * (raised_mm - lowest_mm), LONGEST_SHADOW_MM) if raised_mm > 0 else 0.0
        choice = Choice.near(surface, reach_mm)
        if choice is None:
            return None
        nodes = nodes_of(surface, choice.nodes)
        horizon = horizon_of(surface, nodes, max(reach_mm, FURTHEST_MM))
        response = facing(nodes)
        sums = [
            (straight.light(nodes, horizon, response), again.light(nodes, horizon, response))
            for straight, again in zip(self._straight, self._again, strict=True)
        ]
        dr.eval(sums)
        return _UnderWay(surface, choice, nodes, horizon, sums)

    def _change(
        self,
        group: int,
        surface: Surface,
        choice: Choice,
        sums: tuple[Single, Single],
        landed: Sequence[IrradianceChange],
        tilted: list[list[Single]] | None,
    ) -> Single:
        """By how much a press changes the irradiance of every grid node, but for light from wall to wall."""
        changes = []
        for number, pressed in enumerate(sums):
            part = (self._straight, self._again)[number][group]
            own = part.at_rest(choice.nodes)
            # Where light ends sharply the sum, from cells that are wider, may be far from the irradiance.
            gain = np.clip(part.irradiance[choice.nodes] / np.maximum(own, 1e-30), 0.0, MOST_GAIN)
            change = (pressed - own) * gain
            if tilted is None:
                changes.append(choice.spread(change, 0.0))
            else:
                own_slope = tilted[group][number]
                changes.append(own_slope + choice.spread(change - own_slope[choice.nodes], 0.0))
        straight, again = changes
        if landed:
            straight = self._corrected(group, surface.pitch_mm, straight, landed[group])
        return straight + again

    def _tilted(self, surface: Surface) -> list[list[Single]]:
        """By how much slopes alone change the irradiance of every grid node, under the light at rest there.

        Of each group, and of light that comes straight and again.
        """
        normals = np.nan_to_num(np.moveaxis(surface.normals, -1, 0).astype(np.float32, order="C"))
        return [
            [np.maximum(np.einsum("krc,krc->rc", normals, vector), 0.0) - rest for vector, rest in own]
            for own in self._vectors
        ]

    @cached_property
    def _vectors(self) -> list[list[tuple[Single, Single]]]:
        """Of each group and kind of light: vector irradiance, shape (3, rows, columns), and irradiance."""
        normals = base_normals(self._untouched)
        found = []
        for parts in zip(self._straight, self._again, strict=True):
            own = []
            for part in parts:
                summed = np.einsum("krc,krc->rc", normals, part.vector)
                gain = np.clip(part.irradiance / np.maximum(summed, 1e-30), 0.0, MOST_GAIN)
                vector = np.where(self._there, gain * part.vector, 0.0).astype(np.float32)
                own.append((vector, np.maximum(np.einsum("krc,krc->rc", normals, vector), 0.0)))
            found.append(own)
        return found

    def _corrected(self, group: int, pitch_mm: float, change: Single, landed: IrradianceChange) -> Single:
        """Change of straight light whose mean over a kernel is that of photons, its detail that of the sums.

        The sums over direction bins know neither the edges of beams nor the horizon between two azimuths.
        Where photons and sums differ by no more than the grain of the photons, a wider kernel compares them.
        """
        told = landed.told
        if told is not None and not told.any():
            return change
        rest = self._there * self._straight[group].irradiance
        if not rest.any():
            return change
        narrow, wide = KERNEL_MM / pitch_mm, WIDE_MM / pitch_mm
        least = LEAST_SHARE * float(rest.mean())
        found = np.zeros_like(change) if told is None else change.copy()
        margin = KERNEL_REACH * max((PASSES + 1) * narrow, 2 * wide)
        part = _window((change != 0) | (landed.light != 0) if told is None else told > 0, round(margin))
        rest, change, by_photons, squares = (a[part] for a in (rest, change, landed.light, landed.squares))
        light = np.maximum(rest + change, 0.0)
        sums = light
        wanted = _mean(rest + by_photons, narrow)
        ratio = (_mean(rest + by_photons, wide) + least) / (_mean(light, wide) + least)
        smooth = np.maximum(ratio, 0.0) * _mean(light, narrow)
        # The variance of a Gaussian mean: the kernel's square is narrower by the root of two.
        grain = _mean(squares, narrow / np.sqrt(2)) / (4 * np.pi * KERNEL_MM**2)
        seen = _mean((wanted - smooth) ** 2, wide)
        sure = np.clip(1 - SIGNIFICANT * _mean(grain, wide) / np.maximum(seen, 1e-30), 0.0, 1.0)
        wanted = smooth + sure * (wanted - smooth)
        for _ in range(PASSES):
            mean = _mean(light, narrow)
            # Less light than in the sums dims them, which leaves dark what both call dark; more is added.
            dimmed = np.minimum((np.maximum(wanted, 0.0) + least) / (mean + least), 1.0)
            light = light * dimmed + np.maximum(wanted - mean, 0.0)
        if told is not None:
            light = sums + told[part] * (light - sums)
        found[part] = light - rest
        return found

    def _light(self, group: int, nodes: Nodes, horizon: Any | None, response: Response) -> Any:
        """Sum over all light at membrane nodes, each direction weighted with its `response`."""
        total = sum(part[group].light(nodes, horizon, response) for part in (self._straight, self._again))
        dr.eval(total)
        return total

    def _shadow_reach(self, group: int) -> float:
        """Length of the longest shadow that counts, for a height of one.

        It follows from the elevation above the gel below which hardly any light of the group arrives, with
        every point counting the same, since shadows are longest where light is weak.
        """
        parts = self._straight[group], self._again[group]
        step = max(1, round(LATTICE_MM / self._untouched.pitch_mm))
        chosen = np.zeros(self._untouched.height_mm.shape, dtype=bool)
        chosen[::step, ::step] = True
        chosen &= self._there & (sum(part.irradiance for part in parts) > 0)
        grid_x, grid_y = np.meshgrid(self._untouched.x_mm, self._untouched.y_mm)
        points = np.stack([grid_x[chosen], grid_y[chosen], self._untouched.base_mm[chosen]], axis=-1)
        normals = np.moveaxis(base_normals(self._untouched), 0, -1)[chosen]
        towards, fluence = (
            np.concatenate(pair, axis=1) for pair in zip(*(p.arriving(points) for p in parts), strict=True)
        )
        sine = np.einsum("pkc,pc->pk", towards, normals)
        weight = np.maximum(fluence, 0.0) * np.maximum(sine, 0.0)
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
            self._lobe = rays, self._lobe_of(scene, rays)
        return self._lobe[1]

    def _lobe_of(self, scene: Scene, rays: Rays, *, tilted: tuple[int, float] = (0, 0.0)) -> Single:
        """Like `_mirrored`, with one slope (0: along x, 1: along y) increased everywhere."""
        lattice = np.zeros(self._untouched.height_mm.shape, dtype=bool)
        lattice[::LOBE_STRIDE, ::LOBE_STRIDE] = True
        nodes = nodes_of(self._untouched, lattice)
        axis, slope = tilted
        if slope:
            steeper = [b + held(slope) * (k == axis) for k, b in enumerate((nodes.base_p, nodes.base_q))]
            nodes = replace(nodes, normal=dr.normalize(mi.Vector3f(-steeper[0], -steeper[1], 1.0)))
        shape = lattice[::LOBE_STRIDE, ::LOBE_STRIDE].shape
        at = np.indices(lattice.shape) / LOBE_STRIDE
        response = _lobe(nodes, scene, rays)
        # Beyond a dome there is no membrane, and no number; splines would carry that everywhere.
        sums = [np.nan_to_num(np.asarray(self._light(g, nodes, None, response))) for g in range(scene.groups)]
        grids = [map_coordinates(s.reshape(shape), at, order=3, mode="nearest") for s in sums]
        return np.array(grids, dtype=np.float32)

    def _mirrored_change(self, scene: Scene, rays: Rays, pressed: _UnderWay) -> Single:
        """By how much a press changes what the lobe returns."""
        nodes, horizon, choice = pressed.nodes, pressed.horizon, pressed.choice
        before = nodes_of(self._untouched, choice.nodes)
        after_press, at_rest = _lobe(nodes, scene, rays), _lobe(before, scene, rays)
        found = []
        for group in range(scene.groups):
            after = self._light(group, nodes, horizon, after_press)
            untouched = self._light(group, before, None, at_rest)
            found.append(choice.spread(np.asarray(after - untouched), 0.0))
        return np.array(found)


def _mean(image: Single, sigma_px: float) -> Single:
    """Mean over a Gaussian kernel."""
    return np.asarray(gaussian_filter(image, sigma_px, truncate=KERNEL_REACH))


def _window(mask: Mask, margin: int) -> tuple[slice, slice]:
    """Rows and columns that hold the mask and a margin around it."""
    filled = [np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0)]
    rows, columns = (
        slice(max(at[0] - margin, 0), at[-1] + margin + 1) if at.size else slice(0) for at in filled
    )
    return rows, columns


def _lobe(nodes: Nodes, scene: Scene, rays: Rays) -> Response:
    """BRDF of the coating's lobe towards the camera, for a reflectance of one, times the light's cosine."""
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
