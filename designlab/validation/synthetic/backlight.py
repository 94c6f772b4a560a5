"""The light field within the gel holds what every LED group sends, by place and direction."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from designlab.core.store import digest
from designlab.core.types import Array
from designlab.validation.synthetic.boundaries import gap_transmission, reflectance
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.glass import onto_interface
from designlab.validation.synthetic.surface import HeightField, base_z
from designlab.validation.synthetic.tracing import AZIMUTHS, CHANNELS, COLATITUDES, Glow, Tracer
from geometries import elastomer

Trace = Callable[..., NDArray[np.float32]]  # such as the methods of a tracer

PITCH_MM, GAP_PITCH_MM = 1.0, 0.7  # of the nodes; the shade of a gap between core and gel has sharp edges
MARGIN_MM = 1.0  # of the field around the sensing area
LEVELS = (0.0, 0.4, 0.8)  # heights above the membrane, as shares of the gel's thickness
ABOVE_MM = 3e-3  # nodes of the lowest level lie this far above the membrane
EDGES = ("nearest", "nearest", "nearest", "nearest", "wrap")  # of levels, rows, columns, cells
CLEAR_PATHS = 28  # paths a cell, were all of them worth any; in bundles
LOWEST = 8.0  # paths of the lowest level over those of the others: most of a membrane is not pressed
BUNDLES = (1, 4, 16, 64, 256, 1024)
SLOW_MM, DEGREE = 2.0, 6  # nodes and fit of light that was spread
SPREAD_PATHS, GLOW_PATHS = 15, 5  # paths a cell on average
GLOW_MM = 2.5  # grid of the membrane's own light
ORDERS = 3  # of light from membrane to membrane; each is a tenth of the one before or less
KEPT = 4

_fields: "OrderedDict[str, ImmersedLightField]" = OrderedDict()


class Worth(NamedTuple):
    """How paths are spread over cells.

    `ahead` paths a cell go ahead; a cell's variance is taken over `windows` of neighbours, and it gets paths
    by this `power` of its standard deviation. All paths go by the power `few` of the share of
    cells that are worth any.
    """

    ahead: int
    windows: tuple[tuple[int, ...], ...]
    power: float
    few: float


# Evenly spread draws err by about 1 / n: the sum of squares is least for n as the 2/3rd power.
EVEN = Worth(1, ((0, 1, 1, 3, 3), (0, 3, 3, 3, 3)), 2 / 3, 0.5)
CHANCE = Worth(2, ((1, 3, 3, 3, 3),), 1.0, 0.0)


class Stencil(NamedTuple):
    """Interpolation at points: the first of the nodes that count (points,), their weights (points, nodes)."""

    first: NDArray[np.int64]
    weight: Array


@dataclass(frozen=True, eq=False)
class ImmersedLightField:
    """Radiance (groups, levels, rows, columns, cells) in mW/mm2/sr per mW at nodes within the gel.

    `glow` (groups, rows, columns) is the radiance of the membrane itself, `GLOW_MM` apart over the whole gel.
    """

    x_mm: Array
    y_mm: Array
    height_mm: Array
    radiance: NDArray[np.float32]
    glow: Array

    def along(self, x: Array, y: Array, height: Array) -> tuple["Stencil", "Stencil", "Stencil"]:
        """First node and weights of interpolation at points along x, y and height.

        Cubic polynomials through four nodes in the plane, through all levels in height.
        """
        return (_lagrange(self.x_mm, x), _lagrange(self.y_mm, y), _lagrange(self.height_mm, height))


def directions() -> tuple[Array, Array]:
    """Unit vectors (cells, 3) at the centres of cells, in rows of equal height, and the solid angles."""
    rise, turn = np.meshgrid(
        (np.arange(COLATITUDES) + 0.5) / COLATITUDES,
        2 * np.pi * (np.arange(AZIMUTHS) + 0.5) / AZIMUTHS,
        indexing="ij",
    )
    return _vectors(rise.ravel(), turn.ravel()), np.full(rise.size, 2 * np.pi / rise.size)


def light_field(rig: Rig, *, seed: int = 1) -> ImmersedLightField:
    """Light field of a sensor behind glass; those last used are kept by content.

    Paths are traced backwards from the nodes, stratified in direction. After a pilot, further paths go where
    the pilot scattered most, in proportion to the standard deviation of the irradiance (Neyman 1934).
    """
    key = digest(*_content(rig), seed)
    if key not in _fields:
        _fields[key] = _baked(rig, seed)
        while len(_fields) > KEPT:
            _fields.popitem(last=False)
    _fields.move_to_end(key)
    return _fields[key]


def _content(rig: Rig) -> list[object]:
    """Everything that light on the untouched membrane depends on."""
    glass = rig.glass
    assert glass is not None
    arrays: list[NDArray[Any]] = [
        *rig.emitters,
        *rig.boards,
        rig.face_flux,
        rig.exponent,
        rig.albedo,
        rig.board_reflectance,
    ]
    arrays += [glass.core_absorption_per_mm, glass.gel_absorption_per_mm, glass.outline]
    for wall in glass.walls:
        arrays += [wall.vertices, wall.faces]
    clear = glass.core_index, glass.gel_index, glass.scattering_per_mm, glass.anisotropy, glass.gap
    sizes = glass.thickness_mm, glass.window_mm, glass.interface_radius_mm, glass.package_mm, glass.bonded
    walls = [(wall.name, wall.material) for wall in glass.walls]
    return [arrays, repr((clear, sizes, walls)), rig.elastomer, rig.path_length, rig.sensing_area_mm]


def _baked(rig: Rig, seed: int) -> ImmersedLightField:
    assert rig.glass is not None
    height = np.array(LEVELS) * rig.glass.thickness_mm
    x, y = _axes(rig, PITCH_MM if rig.glass.gap is None else GAP_PITCH_MM)
    found, glow = zip(
        *(_field(rig, part, (x, y, height), seed) for part in _traced_at_once(rig)), strict=True
    )
    return ImmersedLightField(x, y, height, np.concatenate(found), np.concatenate(glow))


def _traced_at_once(rig: Rig) -> list[tuple[int, ...]]:
    """Groups in order, as many in a scene as it has channels; faces on one board may hide each other."""
    parts: list[tuple[int, ...]] = [()]
    boards = [set(rig.carrier[rig.emitters.group == group].tolist()) for group in range(len(rig.flux_mw))]
    for group, own in enumerate(boards):
        if len(parts[-1]) == CHANNELS or any(own & boards[other] for other in parts[-1]):
            parts.append(())
        parts[-1] += (group,)
    return parts


def _axes(rig: Rig, pitch_mm: float) -> list[Array]:
    reaches = [size / 2 + MARGIN_MM for size in rig.sensing_area_mm]
    return [np.linspace(-reach, reach, 2 * int(np.ceil(reach / pitch_mm)) + 1) for reach in reaches]


def _field(
    rig: Rig, groups: tuple[int, ...], axes: tuple[Array, Array, Array], seed: int
) -> tuple[NDArray[np.float32], Array]:
    """Radiance of some groups at nodes by cell: clear light from the LEDs, and spread light; and the glow.

    Clear is what met mirrors and clear boundaries only. Spread light, off boards, ground sides, paint, haze
    and the membrane, varies slowly from place to place: it is traced at fewer nodes and fitted by
    polynomials. The membrane's own light is found on a coarse grid over the whole gel: what the LEDs send,
    and the share of its glow that comes back. The glow is then traced as an emitter, so that few paths do.
    """
    x, y, height = axes
    whole = rig if rig.glass is None else replace(rig, glass=replace(rig.glass, gap=None))
    leds = Tracer(whole, groups)
    outline = np.abs(elastomer.polygon(rig.elastomer)).max(axis=0)
    counts = [2 * int(np.ceil(reach / GLOW_MM)) + 1 for reach in outline]
    whole_x, whole_y = (GLOW_MM * (np.arange(float(count)) - count // 2) for count in counts)
    coarse = _nodes(rig, whole_x, whole_y, np.zeros(1))
    normals = HeightField(rig.elastomer.radius_mm).normals(coarse[:, 0], coarse[:, 1])
    towards, share = directions()
    cosine = np.maximum(normals @ towards.T, 0.0) * share
    albedo = rig.albedo[list(groups), None]

    def glowing(irradiance: Array) -> Tracer:
        return Tracer(whole, groups, glow=Glow(glow(irradiance), GLOW_MM))

    def glow(irradiance: Array) -> Array:
        return (albedo / np.pi * irradiance).reshape(len(groups), *counts[::-1])

    arriving = [(_even(leds.cells, coarse, 4, seed) * cosine).sum(axis=2)]
    for order in range(1, ORDERS):
        arriving.append((_even(glowing(arriving[-1]).cells, coarse, 2, seed + order) * cosine).sum(axis=2))
    slow_x, slow_y = _axes(rig, SLOW_MM)
    ends = height[[0, -1]]
    nodes = _nodes(rig, slow_x, slow_y, ends)
    slow = len(ends), len(slow_y), len(slow_x)
    spread = _where_worth(spread_trace(whole, groups, leds), nodes, slow, SPREAD_PATHS, CHANCE, seed + 11)
    glows = glowing(np.sum(arriving, axis=0)).cells
    spread += _where_worth(glows, nodes, slow, GLOW_PATHS, CHANCE, seed + 12)
    onto = _polynomials(x, y) @ np.linalg.pinv(_polynomials(slow_x, slow_y))
    spread = spread.reshape(len(groups) * len(ends), slow_x.size * slow_y.size, -1)
    low, high = np.moveaxis(
        (onto.astype(np.float32) @ spread).reshape(len(groups), 2, len(y), len(x), -1), 1, 0
    )
    rise = ((height - ends[0]) / (ends[1] - ends[0])).astype(np.float32)
    found = np.stack([(1 - share) * low + share * high for share in rise], axis=1)
    nodes, grid = _nodes(rig, x, y, height), (len(height), len(y), len(x))
    if rig.glass is not None and rig.glass.gap is not None:
        _part(found, rig, groups, nodes)
    clear = clear_trace(rig, groups)
    found += _where_worth(clear, nodes, grid, CLEAR_PATHS, EVEN, seed + 13).reshape(found.shape)
    return found, glow(np.sum(arriving, axis=0))


def clear_trace(rig: Rig, groups: tuple[int, ...]) -> Trace:
    """Trace light of LEDs that nothing has spread, dimmed by what haze takes from it."""
    leds = Tracer(rig, groups)
    return leds.clear if leds.far else Tracer(rig, groups, spreading=False).clear


def spread_trace(rig: Rig, groups: tuple[int, ...], leds: Tracer) -> Trace:
    """Trace light of LEDs that something has spread."""
    if leds.far:
        return leds.spread
    # In haze all light is traced, and what is not spread is taken off with the same random numbers.
    unspread = Tracer(rig, groups, spreading=False, far=False)
    boards = Tracer(rig, groups, spreading=False)

    def traced(nodes: Array, index: NDArray[np.uint32], *, paths: int, seed: int) -> NDArray[np.float32]:
        found = leds.spread(nodes, index, paths=paths, seed=seed)
        found -= unspread.spread(nodes, index, paths=paths, seed=seed)
        return found + boards.spread(nodes, index, paths=paths, seed=seed)

    return traced


def _part(spread: NDArray[np.float32], rig: Rig, groups: tuple[int, ...], nodes: Array) -> None:
    """Dim spread light, in place, where it would have to pass the gap of air between gel and core.

    What the gap mirrors is taken to look like the membrane right below it, under spread light.
    """
    glass = rig.glass
    assert glass is not None
    assert glass.gap is not None
    towards, share = directions()
    flat = spread.reshape(len(groups), len(nodes), -1)
    rise = (towards[:, 2] * share).astype(np.float32)
    for number, node in enumerate(nodes):
        place, cosine = onto_interface(glass, node, towards)
        under = glass.gap.contains(place[:, 0], place[:, 1])
        if not under.any():
            continue
        through = gap_transmission(cosine[under], glass.gel_index, (glass.gel_index, glass.core_index))
        joined = 1.0 - reflectance(cosine[under], glass.gel_index, glass.core_index)
        glow = rig.albedo[list(groups)] / np.pi * (flat[:, number] @ rise)
        flat[:, number, under] *= (through / np.maximum(joined, 1e-6)).astype(np.float32)
        flat[:, number, under] += np.multiply.outer(glow, 1.0 - through).astype(np.float32)


def _polynomials(x: Array, y: Array) -> Array:
    """Legendre polynomials of total degree up to `DEGREE` on a grid, shape (rows x columns, n)."""
    along, up = (
        np.polynomial.legendre.legvander(axis / max(float(np.abs(axis).max()), 1e-9), DEGREE)
        for axis in (x, y)
    )
    pairs = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    return np.stack([np.multiply.outer(up[:, j], along[:, i]).ravel() for i, j in pairs], axis=1)


def _nodes(rig: Rig, x: Array, y: Array, height: Array) -> Array:
    """Places of the nodes (levels x rows x columns, 3); those beyond the gel's outline stand on its rim."""
    level, row, column = (axis.ravel() for axis in np.meshgrid(height, y, x, indexing="ij"))
    share = np.ones(len(row))
    for _ in range(60):  # towards the axis until within the outline; hardly any node lies outside
        outside = ~elastomer.inside(rig.elastomer, share * column * 1.001, share * row * 1.001)
        share[outside] *= 0.98
    column, row = share * column, share * row
    return np.column_stack([column, row, base_z(rig.elastomer.radius_mm, column, row) + level + ABOVE_MM])


def _even(trace: Trace, nodes: Array, paths: int, seed: int) -> NDArray[np.float32]:
    """Radiance at nodes by cell, shape (groups, nodes, cells), from as many paths in every cell."""
    shape = len(nodes), COLATITUDES * AZIMUTHS
    index = np.arange(shape[0] * shape[1], dtype=np.uint32)
    return trace(nodes, index, paths=paths, seed=seed).reshape(-1, *shape)


def _where_worth(
    trace: Trace, nodes: Array, grid: tuple[int, int, int], paths: int, kind: Worth, seed: int
) -> NDArray[np.float32]:
    """Radiance at nodes by cell, shape (groups, nodes, cells), from `paths` paths a cell or fewer.

    A few more paths a cell go ahead and say where they are worth most. They are not counted: where they met
    light by chance it would be too bright, and nothing but they would be there where they missed it.

    Parameters
    ----------
    grid : tuple
        Levels, rows and columns of the nodes.
    """
    shape = *grid, COLATITUDES, AZIMUTHS
    index = np.arange(np.prod(shape), dtype=np.uint32)
    rise = directions()[0][:, 2].astype(np.float32).reshape(shape[3:])
    variance = np.zeros(shape, dtype=np.float32)
    for number in range(kind.ahead):
        ahead = trace(nodes, index, paths=1, seed=seed + 100 * number)
        for values in ahead.reshape(len(ahead), *shape):
            whole = max(float((values * rise).mean()) ** 2, 1e-30)
            # Neighbours tell what one path cannot: an edge runs through them, or light is met by chance.
            for window in kind.windows:
                mean, second = (uniform_filter(a, window, mode=EDGES) for a in (values, values**2))
                variance += np.maximum(second - mean**2, 0.0) / whole
    worth = (np.sqrt(variance) * rise) ** kind.power
    worth[0] *= LOWEST
    worth = worth.ravel()
    worth *= paths * float((worth > 0).mean()) ** kind.few / max(float(worth.mean()), 1e-30)
    found = np.zeros((len(ahead), len(index)), dtype=np.float32)
    ends = [0.0, *(np.sqrt(a * b) for a, b in pairwise(BUNDLES)), np.inf]
    for number, (bundle, (low, high)) in enumerate(zip(BUNDLES, pairwise(ends), strict=True)):
        chosen = index[(worth >= low) & (worth < high)]
        if len(chosen):
            found[:, chosen] = trace(nodes, chosen, paths=bundle, seed=seed + 1 + number)
    return found.reshape(len(found), len(nodes), -1)


def _vectors(rise: Array, turn: Array) -> Array:
    level = np.sqrt(1.0 - rise**2)
    return np.stack([level * np.cos(turn), level * np.sin(turn), rise], axis=-1)


def _lagrange(nodes: Array, at: Array) -> Stencil:
    """Four nodes (or all, where fewer) around each point, and the weights of their values."""
    order = min(4, len(nodes))
    at = np.clip(at, nodes[0], nodes[-1])
    first = np.clip(np.searchsorted(nodes, at) - order // 2, 0, len(nodes) - order)
    near = nodes[first[:, None] + np.arange(order)]
    weights = np.ones((len(at), order))
    for i in range(order):
        for j in range(order):
            if i != j:
                weights[:, i] *= (at - near[:, j]) / (near[:, i] - near[:, j])
    return Stencil(first, weights)
