"""Tracing of light fields, once per design."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.ndimage import binary_erosion

from designlab.core.types import Array, Mask, Single
from designlab.simulation.render import gather
from designlab.simulation.render import photons as tracing
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.lightfield import (
    AZIMUTHS,
    CELL_MM,
    FINE_CELL_MM,
    SLANTS,
    WIDEST_SLANT_DEG,
    Field,
    LightField,
    on_membrane,
)
from designlab.simulation.render.tables import held
from designlab.simulation.scene.scene import Scene

STEEPEST_COSINE = 0.02  # light more grazing than this weighs as if it came at this angle
PILOT_SHARE = 0.2  # of the photons, traced beforehand to learn where on the LEDs others are best started
AGAIN_SHARE = 0.25  # of the photons, traced on for light that returns to the membrane, dim and smooth
AGAIN_IN_AIR = 0.5  # likewise, where their landings tell directions only
MOST_LANDINGS = 2**20  # photons whose landings are kept, of a field and group
SMOOTH_CELLS, SMOOTH_DEGREE = 13, 2  # of the polynomial fitted to light that returns, 4.5 mm wide
GATHERED_SHARE = 1 / 256  # of the photons, whose matte reflections in air shine on every point
LATTICE_MM = 2.5  # between the points that they shine on
HALF_FILLED = 0.5  # cells on the membrane's edge count as this full at least
AREA_MARGIN_MM, BESIDE_AREA = 1.0, 0.1  # light further from the sensing area than this is worth less


def bake(
    scene: Scene,
    *,
    area_mm: tuple[float, float],
    photons: int,
    seeds: Sequence[int],
    like: Scene | None = None,
    between: Callable[[], None] = lambda: None,
) -> list[LightField]:
    """Trace independent light fields of an undeformed scene, every LED group at unit flux.

    Where light runs straight from LED to membrane, that direct light is left out: it is integrated over the
    LED's face, which is exact.

    Parameters
    ----------
    scene : Scene
        The undeformed scene.
    area_mm : tuple of float
        Width and height of the part of the membrane that matters most, the sensing area.
    photons : int
        Photons of each field and LED group.
    seeds : sequence of int
        Seed of the random numbers of each field.
    like : Scene, optional
        Scene with as many LEDs, the scene itself when absent, for which starts of photons are chosen: light
        fields chosen alike share their random numbers, so that their difference has little noise.
    between : callable
        Called before each field of each group; it may raise to give up.

    Raises
    ------
    ValueError
        If the groups of `like` have other numbers of LEDs.
    """
    if like is not None and [light.group for light in like.lights] != [light.group for light in scene.lights]:
        raise ValueError(
            f"like: must have as many LEDs in every group, got {len(like.lights)} and {len(scene.lights)}"
        )
    groups = [_baked(scene, group, area_mm, photons, seeds, like, between) for group in range(scene.groups)]
    tables = groups[0][0][1]
    filled = (
        share_filled(scene, tables.low, CELL_MM, tables.coarse),
        share_filled(scene, tables.low, FINE_CELL_MM, tables.fine),
    )
    return [
        LightField(
            first=_field([first for first, *_ in lots], filled) if scene.refracts else None,
            again=_with_gathered(
                _smooth(_field([again for _, again, _, _ in lots], filled), filled[1] > HALF_FILLED),
                [gathered for *_, gathered in lots],
            ),
            landings=tuple(landings for _, _, landings, _ in lots) if scene.refracts else (),
        )
        for lots in zip(*groups, strict=True)
    ]


def _baked(
    scene: Scene,
    group: int,
    area_mm: tuple[float, float],
    photons: int,
    seeds: Sequence[int],
    like: Scene | None,
    between: Callable[[], None],
) -> list[tuple["_Tables", "_Tables", Single, Array | None]]:
    """Light of one group that arrives first, all that arrives later, and the photons that arrive first.

    In air the irradiance by matte reflections is gathered and comes last; what arrives later lacks it then.
    """
    corners = scene.membrane.vertices.min(axis=0), scene.membrane.vertices.max(axis=0)
    tables = [(_Tables(*corners), _Tables(*corners), _Lot()) for _ in seeds]
    # Behind glass the first light comes after two surfaces; in air it is integrated, not traced.
    if scene.path_length <= (3 if scene.refracts else 2):
        return [(first, again, lot.landings(), None) for first, again, lot in tables]
    loaded = tracing.load(scene, group)
    pilot = min(tracing.PILOT, max(1, round(PILOT_SHARE * photons * len(seeds))))

    def is_again(arrival: tracing.Arrival) -> Any:
        return arrival.returned if scene.refracts else arrival.bounces > 0

    def here(arrival: tracing.Arrival) -> Any:
        across, along = (held(side / 2 + AREA_MARGIN_MM) for side in area_mm)
        inside = (dr.abs(arrival.at.p.x) < across) & (dr.abs(arrival.at.p.y) < along)
        return arrival.power * dr.select(inside, 1.0, BESIDE_AREA)

    def worth_again(arrival: tracing.Arrival, active: Any) -> Any:
        return dr.select(active & is_again(arrival), here(arrival), 0.0)

    def worth_first(arrival: tracing.Arrival, active: Any) -> Any:
        return dr.select(active & ~is_again(arrival), here(arrival), 0.0)

    # Fields with a guide in common are independent all the same: it rules their noise, not their mean.
    guides = tracing.learn(
        like or scene,
        group=group,
        seed=seeds[0],
        worth=[worth_again, worth_first],
        loaded=loaded if like is None else tracing.load(like, group),
        photons=pilot,
    )
    share = AGAIN_SHARE if scene.refracts else AGAIN_IN_AIR
    gathered: list[Array | None] = [None] * len(seeds)
    for number, (seed, (first, again, lot)) in enumerate(zip(seeds, tables, strict=True)):
        between()

        def later(arrival: tracing.Arrival, active: Any, *, again: "_Tables" = again) -> None:
            again.add(arrival, active & is_again(arrival), lands=scene.refracts | ~arrival.matte)

        def at_first(
            arrival: tracing.Arrival, active: Any, *, first: "_Tables" = first, lot: "_Lot" = lot
        ) -> None:
            first.add(arrival, active)
            lot.add(arrival, active)

        count = max(1, round(share * photons))
        tracing.trace(
            scene, group=group, photons=count, seed=seed, record=later, loaded=loaded, guide=guides[0]
        )
        if not scene.refracts:
            gathered[number] = _gathered(
                scene, again, group, max(1, round(GATHERED_SHARE * photons)), seed, loaded, guides[0]
            )
        else:
            count = max(1, photons - count)
            lot.prepare(count)
            # Numbers of its own: what both passes have in common would count twice.
            own = int(np.random.SeedSequence([seed, 80]).generate_state(1)[0])
            tracing.trace(
                scene,
                group=group,
                photons=count,
                seed=own,
                record=at_first,
                loaded=loaded,
                guide=guides[1],
                once=True,
            )
    return [
        (first, again, lot.landings(), light)
        for (first, again, lot), light in zip(tables, gathered, strict=True)
    ]


def _gathered(
    scene: Scene, tables: "_Tables", group: int, photons: int, seed: int, loaded: Any, guide: tracing.Guide
) -> Array:
    """Irradiance of fine cells by matte reflections, from a lattice of points by thin-plate splines."""
    rows, columns = tables.fine
    x, y = (tables.low[k] + FINE_CELL_MM * np.arange(n) for k, n in ((0, columns), (1, rows)))
    axes = (np.arange(a[0] + LATTICE_MM / 2, a[-1], LATTICE_MM) for a in (x, y))
    at_x, at_y = (axis.ravel() for axis in np.meshgrid(*axes))
    there = on_membrane(scene, at_x, at_y)
    at_x, at_y = at_x[there], at_y[there]
    found = gather.irradiance(
        scene, at_x, at_y, group=group, photons_traced=photons, seed=seed, loaded=loaded, guide=guide
    )
    known = np.isfinite(found)
    at_x, at_y, found = at_x[known], at_y[known], found[known]
    cells = np.stack([axis.ravel() for axis in np.meshgrid(x, y)], axis=-1)
    return np.asarray(RBFInterpolator(np.stack([at_x, at_y], axis=-1), found)(cells)).reshape(rows, columns)


class _Tables:
    """Where light is added up by place and direction."""

    def __init__(self, low: Array, high: Array) -> None:
        self.low = low
        self.coarse, self.fine = (_cells(low, high, cell_mm) for cell_mm in (CELL_MM, FINE_CELL_MM))
        self._power = dr.zeros(mi.Float, self.coarse[0] * self.coarse[1] * SLANTS * AZIMUTHS)
        self._light = dr.zeros(mi.Float, self.fine[0] * self.fine[1])

    def add(self, arrival: tracing.Arrival, active: Any, *, lands: Any = True) -> None:
        """Add photons that arrive; to the irradiance only those that count as landing."""
        position, normal, towards = arrival.at.p, arrival.at.n, arrival.towards
        cell, inside = _cell(position, self.low, CELL_MM, self.coarse)
        slant = mi.Int32(dr.rad2deg(dr.safe_acos(towards.z)) / WIDEST_SLANT_DEG * SLANTS)
        turn = dr.atan2(towards.y, towards.x) / (2 * dr.pi)
        azimuth = dr.minimum(mi.Int32((turn - dr.floor(turn)) * AZIMUTHS), AZIMUTHS - 1)
        index = (cell * SLANTS + slant) * AZIMUTHS + azimuth
        cosine = dr.maximum(dr.dot(normal, towards), STEEPEST_COSINE)
        # A tilted cell has more area than its projection, which cancels one of the two cosines.
        shared = arrival.power * dr.abs(normal.z)
        dr.scatter_add(self._power, shared / cosine, mi.UInt32(index), active & inside & (slant < SLANTS))
        cell, inside = _cell(position, self.low, FINE_CELL_MM, self.fine)
        dr.scatter_add(self._light, shared, mi.UInt32(cell), active & inside & lands)

    @property
    def power(self) -> Single:
        """Power over projected area (1/mm2), shape (y cells, x cells, slants, azimuths)."""
        table = np.asarray(self._power, dtype=np.float32)
        return table.reshape(*self.coarse, SLANTS, AZIMUTHS) / np.float32(CELL_MM**2)

    @property
    def irradiance(self) -> Single:
        """Irradiance (1/mm2), shape (y fine cells, x fine cells)."""
        return np.asarray(self._light, dtype=np.float32).reshape(self.fine) / np.float32(FINE_CELL_MM**2)


def _field(tables: Sequence[_Tables], filled: tuple[Single, Single]) -> Field:
    """Light of all groups, in cells as bright as where the membrane fills them."""
    coarse, fine = filled
    power = np.stack([t.power for t in tables]) / coarse[..., None, None]
    irradiance = np.stack([t.irradiance for t in tables]) / fine
    low = tables[0].low
    return Field(power, irradiance, float(low[0]), float(low[1]))


def _with_gathered(field: Field, gathered: Sequence[Array | None]) -> Field:
    """Add gathered irradiance of every group."""
    added = [0.0 * field.irradiance[0] if one is None else one for one in gathered]
    return replace(field, irradiance=(field.irradiance + np.array(added)).astype(np.float32))


def _smooth(field: Field, filled: Mask) -> Field:
    """Take noise out of light that was reflected on its way, which varies over millimetres only.

    Each cell gets the value of the quadratic polynomial fitted to the cells around it (Savitzky and Golay
    1964), where all of them lie on the membrane.
    """
    from scipy.signal import savgol_filter  # with much else, which takes a second

    if min(filled.shape) < SMOOTH_CELLS:
        return field
    fitted = field.irradiance
    for axis in (1, 2):
        fitted = savgol_filter(fitted, SMOOTH_CELLS, SMOOTH_DEGREE, axis=axis, mode="nearest")
    inner = binary_erosion(filled, np.ones((SMOOTH_CELLS, SMOOTH_CELLS), dtype=bool))
    return replace(field, irradiance=np.where(inner, fitted, field.irradiance).astype(np.float32))


class _Lot:
    """Photons as they land: the first ones, when there are too many.

    The start of the sequence they begin at is as even as the whole of it; every second point would not be.
    """

    def __init__(self) -> None:
        self._room: Any = None
        self._columns: list[Any] = []

    def prepare(self, photons: int) -> None:
        """Make room."""
        room = min(photons, MOST_LANDINGS)
        self._room, self._share = held(room), held(photons / room)
        self._columns = [dr.zeros(mi.Float, room) for _ in range(7)]

    def add(self, arrival: tracing.Arrival, active: Any) -> None:
        """Keep photons that arrive."""
        kept = active & (arrival.number < self._room)
        place, way = arrival.at.p, arrival.towards
        values = (*place, way.x, way.y, way.z, arrival.power * self._share)
        for column, value in zip(self._columns, values, strict=True):
            dr.scatter(column, value, arrival.number, kept)

    def landings(self) -> Single:
        """Return the photons that were kept, shape (7, photons)."""
        table = np.array([np.asarray(column) for column in self._columns], dtype=np.float32).reshape(7, -1)
        return table[:, table[6] > 0]


def _cells(low: Array, high: Array, cell_mm: float) -> tuple[int, int]:
    """Rows and columns of cells over the membrane, the first one centred at its lowest x and y."""
    columns, rows = (int(np.ceil((high[k] - low[k]) / cell_mm)) + 1 for k in (0, 1))
    return rows, columns


def _cell(position: Any, low: Array, cell_mm: float, shape: tuple[int, int]) -> tuple[Any, Any]:
    """Number of the cell that a point lies in, and whether there is one."""
    column = mi.Int32(dr.floor((position.x - held(float(low[0]))) / cell_mm + 0.5))
    row = mi.Int32(dr.floor((position.y - held(float(low[1]))) / cell_mm + 0.5))
    rows, columns = (mi.Int32(held(count)) for count in shape)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    return row * columns + column, inside


def share_filled(scene: Scene, low: Array, cell_mm: float, shape: tuple[int, int]) -> Single:
    """Share of each cell that the membrane fills, at least half: the others hold too little light."""
    fine = 8  # an even number: the first cells are centred on the edge
    rows, columns = shape
    offsets = (np.arange(fine) + 0.5) / fine - 0.5
    x = low[0] + (np.arange(columns)[:, None] + offsets).ravel() * cell_mm
    y = low[1] + (np.arange(rows)[:, None] + offsets).ravel() * cell_mm
    inside = on_membrane(scene, *np.meshgrid(x, y))
    share = inside.reshape(rows, fine, columns, fine).mean(axis=(1, 3))
    return np.asarray(np.maximum(share, 0.5), dtype=np.float32)
