"""Incident light on the undeformed membrane, traced once per design; shading any press from it costs a sum.

The light that falls on the membrane is kept as power per position cell and direction bin. A press changes
the membrane's slope, lifts it and shadows it, but hardly the light that arrives: shading sums the bins with
the foreshortening of the deformed normal, the parallax of the lifted point and the horizon of the
indentation. Left out: light reflected from wall to wall of the same indentation. Error figures are in
docs/validation.md.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.press import Surface
from designlab.render import photons
from designlab.scene import Dielectric, Scene
from designlab.viewing import Rays

FloatArray = NDArray[np.float64]
STEEPEST_COSINE = 0.02  # light more grazing than this weighs as if it came at this angle
FURTHEST_MM = 4.0  # reach of shadows and of parallax
PHOTONS_PER_SAMPLE = 300_000  # lets one effort setting rule both photons and the path tracer's samples
AZIMUTHS, SLANTS, CELL_MM = 48, 33, 1.0
WIDEST_SLANT_DEG = 99.0  # on a dome light can come from slightly below the apex plane


@dataclass(frozen=True, eq=False)
class LightField:
    """Light on the undeformed membrane.

    Attributes
    ----------
    power : array, shape (groups, y cells, x cells, slants, azimuths)
        Fluence per bin at unit flux: power over projected area, 1/mm2.
    x_mm, y_mm : float
        Centre of the first cell.
    """

    power: NDArray[np.float32]
    x_mm: float
    y_mm: float

    @cached_property
    def directions(self) -> FloatArray:
        """Unit vectors towards the light, shape (slants, azimuths, 3)."""
        slant = np.radians((np.arange(SLANTS) + 0.5) * WIDEST_SLANT_DEG / SLANTS)
        azimuth = (np.arange(AZIMUTHS) + 0.5) * 2 * np.pi / AZIMUTHS
        s, a = np.meshgrid(slant, azimuth, indexing="ij")
        return np.stack([np.sin(s) * np.cos(a), np.sin(s) * np.sin(a), np.cos(s)], axis=-1)


def bake(scene: Scene, *, samples: int, seed: int) -> LightField:
    """Trace the light field of an undeformed scene, every LED group at unit flux."""
    import drjit as dr
    import mitsuba as mi

    low, high = scene.membrane.vertices.min(axis=0), scene.membrane.vertices.max(axis=0)
    columns, rows = (int(np.ceil((high[k] - low[k]) / CELL_MM)) + 1 for k in (0, 1))
    bins = SLANTS * AZIMUTHS
    groups = []
    for group in range(scene.groups):
        table = dr.zeros(mi.Float, rows * columns * bins)

        def record(
            position: Any, towards: Any, normal: Any, power: Any, active: Any, *, table: Any = table
        ) -> None:
            column = mi.Int32(dr.floor((position.x - float(low[0])) / CELL_MM + 0.5))
            row = mi.Int32(dr.floor((position.y - float(low[1])) / CELL_MM + 0.5))
            slant = mi.Int32(dr.rad2deg(dr.safe_acos(towards.z)) / WIDEST_SLANT_DEG * SLANTS)
            turn = dr.atan2(towards.y, towards.x) / (2 * dr.pi)
            azimuth = dr.minimum(mi.Int32((turn - dr.floor(turn)) * AZIMUTHS), AZIMUTHS - 1)
            inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows) & (slant < SLANTS)
            index = ((row * columns + column) * SLANTS + slant) * AZIMUTHS + azimuth
            cosine = dr.maximum(dr.dot(normal, towards), STEEPEST_COSINE)
            # A tilted cell has more area than its projection, which cancels one of the two cosines.
            dr.scatter_add(table, power / cosine * dr.abs(normal.z), mi.UInt32(index), active & inside)

        photons.trace(scene, group=group, photons=samples * PHOTONS_PER_SAMPLE, seed=seed, record=record)
        groups.append(
            np.asarray(table, dtype=np.float32).reshape(rows, columns, SLANTS, AZIMUTHS) / CELL_MM**2
        )
    return LightField(_edges_filled(np.stack(groups), scene, low), float(low[0]), float(low[1]))


def _edges_filled(power: NDArray[np.float32], scene: Scene, low: FloatArray) -> NDArray[np.float32]:
    """Scale up cells that the membrane fills only in part; they hold too little light (at most twofold)."""
    fine = 8
    rows, columns = power.shape[1:3]
    offsets = (np.arange(fine) + 0.5) / fine - 0.5
    x = low[0] + (np.arange(columns)[:, None] + offsets).ravel() * CELL_MM
    y = low[1] + (np.arange(rows)[:, None] + offsets).ravel() * CELL_MM
    inside = _on_membrane(scene, *np.meshgrid(x, y))
    share = inside.reshape(rows, fine, columns, fine).mean(axis=(1, 3))
    return np.asarray(power / np.maximum(share, 0.5)[None, :, :, None, None], dtype=np.float32)


def _on_membrane(scene: Scene, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
    """Points within the outline of the membrane."""
    from scipy.spatial import ConvexHull

    triangles = scene.membrane.vertices[scene.membrane.faces][:, :, :2]
    outline = triangles.reshape(-1, 2)
    hull = ConvexHull(outline[:: max(1, len(outline) // 200_000)])
    points = np.stack([x, y], axis=-1)
    return np.asarray((points @ hull.equations[:, :2].T + hull.equations[:, 2] <= 1e-9).all(axis=-1))


def shade(field: LightField, scene: Scene, surface: Surface, rays: Rays) -> NDArray[np.float32]:
    """Radiance of every group at the camera, shape (groups, rows, columns), as `path.radiance` gives it."""
    import drjit as dr
    import mitsuba as mi

    x, y = rays.hit(surface)
    p, q = (surface.sample(slope, x, y) for slope in surface.gradient)
    height = surface.sample(surface.height_mm, x, y)
    length = np.sqrt(1 + p**2 + q**2)
    pixels = {
        "x": x, "y": y, "h": height, "nx": -p / length, "ny": -q / length, "nz": 1 / length,
    }  # fmt: skip
    at = {
        name: mi.Float(np.ascontiguousarray(value.ravel(), dtype=np.float32))
        for name, value in pixels.items()
    }
    horizon = _horizon(surface, at)
    # A wide lens also sees what lies beside the gel: its black rim.
    view = _transmission(scene, rays) * _on_membrane(scene, x, y)
    albedo = _membrane_albedo(scene)
    images = []
    for group in range(scene.groups):
        irradiance = _irradiance(field, group, at, horizon)
        dr.eval(irradiance)
        images.append(albedo[group] / np.pi * np.asarray(irradiance).reshape(x.shape) * view)
    return np.stack(images).astype(np.float32)


def _irradiance(field: LightField, group: int, at: dict[str, Any], horizon: Any) -> Any:
    """Sum over the direction bins that hold light, in one kernel with a loop over them."""
    import drjit as dr
    import mitsuba as mi

    rows, columns = field.power.shape[1:3]
    total = field.power[group].sum(axis=(0, 1))
    used = np.argwhere(total > 1e-6 * total.max())
    table = field.power[group].transpose(2, 3, 0, 1)[used[:, 0], used[:, 1]]
    power = mi.Float(np.ascontiguousarray(table, dtype=np.float32).ravel())
    direction = field.directions[used[:, 0], used[:, 1]]
    elevation = np.tan(np.pi / 2 - np.arccos(np.clip(direction[:, 2], -1, 1)))
    half_bin = np.radians(WIDEST_SLANT_DEG / SLANTS) / 2
    slant = np.arccos(np.clip(direction[:, 2], -1, 1))
    lower, upper = (
        np.tan(np.pi / 2 - slant - half_bin),
        np.tan(np.pi / 2 - np.maximum(slant - half_bin, 1e-3)),
    )
    columns_of = [direction[:, 0], direction[:, 1], direction[:, 2], lower, upper, elevation]
    dx, dy, dz, low, high, _ = (mi.Float(c.astype(np.float32)) for c in columns_of)
    azimuth = mi.UInt32(used[:, 1].astype(np.uint32))
    count = dr.width(at["x"])
    pixel = dr.arange(mi.UInt32, count)

    def going(k: Any, _: Any) -> Any:
        return k < len(used)

    def step(k: Any, irradiance: Any) -> Any:
        x, y, z = (dr.gather(mi.Float, c, k) for c in (dx, dy, dz))
        facing = dr.maximum(at["nx"] * x + at["ny"] * y + at["nz"] * z, 0.0)
        # Light that reaches a lifted point would have met the undeformed membrane further away.
        drift = dr.minimum(
            at["h"] / dr.maximum(z, 1e-3), FURTHEST_MM / dr.maximum(dr.sqrt(x * x + y * y), 1e-3)
        )
        value = _bilinear(
            power, at["x"] - drift * x, at["y"] - drift * y, field, k * (rows * columns), rows, columns
        )
        rim = dr.gather(mi.Float, horizon, pixel * AZIMUTHS + dr.gather(mi.UInt32, azimuth, k))
        lower, upper = dr.gather(mi.Float, low, k), dr.gather(mi.Float, high, k)
        visible = dr.clip((upper - rim) / (upper - lower), 0.0, 1.0)
        return k + 1, irradiance + value * facing * visible

    _, irradiance = dr.while_loop(
        (dr.zeros(mi.UInt32, count), dr.zeros(mi.Float, count)), going, step, labels=("k", "irradiance")
    )
    return irradiance


def _bilinear(power: Any, x: Any, y: Any, field: LightField, first: Any, rows: int, columns: int) -> Any:
    import drjit as dr
    import mitsuba as mi

    u = dr.clip((x - field.x_mm) / CELL_MM, 0.0, columns - 1.001)
    v = dr.clip((y - field.y_mm) / CELL_MM, 0.0, rows - 1.001)
    column, row = mi.UInt32(u), mi.UInt32(v)
    a, b = u - mi.Float(column), v - mi.Float(row)
    index = first + row * columns + column
    top = dr.lerp(dr.gather(mi.Float, power, index), dr.gather(mi.Float, power, index + 1), a)
    bottom = dr.lerp(
        dr.gather(mi.Float, power, index + columns), dr.gather(mi.Float, power, index + columns + 1), a
    )
    return dr.lerp(top, bottom, b)


def _horizon(surface: Surface, at: dict[str, Any]) -> Any:
    """Tangent of the indentation's horizon at every pixel and azimuth, flattened with azimuth last."""
    import drjit as dr
    import mitsuba as mi

    count = dr.width(at["x"])
    if not surface.height_mm.any():
        return dr.full(mi.Float, -1e6, count * AZIMUTHS)
    rows, columns = surface.height_mm.shape
    z = mi.Float(np.nan_to_num(surface.z_mm).astype(np.float32).ravel())
    raised = mi.Float(surface.height_mm.astype(np.float32).ravel())
    index = dr.arange(mi.UInt32, count * AZIMUTHS)
    pixel, turn = index // AZIMUTHS, mi.Float(index % AZIMUTHS)
    angle = (turn + 0.5) * (2 * dr.pi / AZIMUTHS)
    dx, dy = dr.cos(angle), dr.sin(angle)
    x, y = dr.gather(mi.Float, at["x"], pixel), dr.gather(mi.Float, at["y"], pixel)
    x_first, y_first, pitch = float(surface.x_mm[0]), float(surface.y_mm[0]), surface.pitch_mm

    def sample(table: Any, px: Any, py: Any) -> Any:
        u = dr.clip((px - x_first) / pitch, 0.0, columns - 1.001)
        v = dr.clip((y_first - py) / pitch, 0.0, rows - 1.001)
        column, row = mi.UInt32(u), mi.UInt32(v)
        a, b, k = u - mi.Float(column), v - mi.Float(row), row * columns + column
        top = dr.lerp(dr.gather(mi.Float, table, k), dr.gather(mi.Float, table, k + 1), a)
        bottom = dr.lerp(
            dr.gather(mi.Float, table, k + columns), dr.gather(mi.Float, table, k + columns + 1), a
        )
        return dr.lerp(top, bottom, b)

    here = sample(z, x, y)

    def going(distance: Any, _: Any) -> Any:
        return distance < FURTHEST_MM

    def step(distance: Any, rim: Any) -> Any:
        px, py = x + distance * dx, y + distance * dy
        slope = (sample(z, px, py) - here) / distance
        rim = dr.select(sample(raised, px, py) > 1e-3, dr.maximum(rim, slope), rim)
        return distance * 1.1 + 0.5 * pitch, rim

    _, rim = dr.while_loop(
        (dr.full(mi.Float, 1.5 * pitch, count * AZIMUTHS), dr.full(mi.Float, -1e6, count * AZIMUTHS)),
        going,
        step,
        labels=("distance", "rim"),
    )
    dr.eval(rim)
    return rim


def _transmission(scene: Scene, rays: Rays) -> FloatArray:
    """Share of the membrane's radiance that reaches the camera: Fresnel losses, widening of the beam."""
    boundaries = {s.name: s.material for s in scene.shapes if isinstance(s.material, Dielectric)}
    if not boundaries:
        return np.ones_like(rays.x_mm)
    window, interface = boundaries["window"], boundaries["interface"]
    tangent = np.hypot(rays.slope_x, rays.slope_y)
    # n sin(theta) is the same in every layer.
    sine = interface.inside.index * tangent / np.sqrt(1 + tangent**2)
    passed = np.ones_like(tangent)
    for boundary in (interface, window):
        passed *= 1.0 - _fresnel(sine, boundary.inside.index, boundary.outside.index)
    return np.asarray(passed / interface.inside.index**2)


def _fresnel(invariant: FloatArray, inside: float, outside: float) -> FloatArray:
    """Reflectance of unpolarised light at a smooth boundary; `invariant` is n sin(theta)."""
    cos_in, cos_out = np.sqrt(1 - (invariant / inside) ** 2), np.sqrt(1 - (invariant / outside) ** 2)
    senkrecht = (inside * cos_in - outside * cos_out) / (inside * cos_in + outside * cos_out)
    parallel = (outside * cos_in - inside * cos_out) / (outside * cos_in + inside * cos_out)
    return np.asarray((senkrecht**2 + parallel**2) / 2)


def _membrane_albedo(scene: Scene) -> tuple[float, ...]:
    surface = scene.membrane.material
    if isinstance(surface, Dielectric):
        raise ValueError("membrane: must be opaque, is a dielectric")
    return surface.reflectance
