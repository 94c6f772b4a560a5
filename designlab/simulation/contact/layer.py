"""Contact with an elastic gel: a layer bonded to its core, pressed along z."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from designlab.core.types import Array
from designlab.mechanics.contact import (
    CATCH,
    DEEPEST,
    FORCE_TOLERANCE,
    MOST_ROUNDS,
    ContactSolution,
    NotConverged,
)
from designlab.mechanics.contact import press as press_layer
from designlab.sensor.contact import LayerContact
from designlab.simulation.contact.along_normal import Turn
from designlab.simulation.contact.approach import (
    above_mm,
    first_touch_mm,
    named,
    over_gel_mm,
    reach_mm,
    require_room,
)
from designlab.simulation.contact.press import Press
from designlab.simulation.contact.surface import Mechanics, Surface
from geometries.elastomer import Elastomer, base_gradient, base_mm, inside, interface_mm, polygon

SMALL_STRAIN = 0.5  # of the thickness; beyond it forces are 4 % off and more (docs/validation.md)
FLOWS = 0.77  # of the thickness; finite elements without friction find no equilibrium beyond it
FEW_CELLS = 3.0  # of radius
GIVES_WAY = 0.45  # of the force, by a free edge at the contact's rim (docs/validation.md)
DIRECTIONS = 32  # in which the edge of the gel is looked for
FREE_EDGE = 2.0  # thicknesses; nearer to the pad's edge it gives way, which the model does not know
GRIPS = 1.0  # coefficient of friction beyond which sticking is an upper bound (estimate)
STEEPEST_DEG = 30.0  # of the membrane where it is touched


class _Plane(NamedTuple):
    """A plane that touches the undeformed membrane where the probe touches first."""

    origin: Array
    across: Array
    along: Array
    normal: Array


@dataclass(frozen=True, eq=False)
class _Solved:
    """A contact, the plane it was solved on, and the row and column of that plane's lattice it starts at.

    Columns of the lattice run along `frame.across`, rows against `frame.along`; (0, 0) is its origin.
    """

    contact: ContactSolution
    frame: _Plane
    first: tuple[int, int]
    softened: float  # share of the force that is left beside the free edge of the gel
    edge_mm: float  # least distance from the contact to that edge

    @property
    def force_n(self) -> Array:
        """Force on the gel along x, y and z (N)."""
        right, down = self.contact.tangential_force_n
        normal = self.contact.force_n * self.softened * self.frame.normal
        return np.asarray(normal + right * self.frame.across - down * self.frame.along)


def deform(
    untouched: Surface,
    elastomer: Elastomer,
    contact: LayerContact,
    press: Press,
    *,
    turn: Turn | None = None,
) -> Surface:
    """Deform the membrane by a press.

    The membrane moves along its normal as a flat layer would on the plane that touches it where the probe
    touches first. On a dome the depth is split into its part along that normal and, where there is friction,
    the shear along the plane.

    Parameters
    ----------
    untouched : Surface
        The undeformed membrane.
    elastomer, contact, press : Elastomer, LayerContact, Press
        The gel, what it is made of, and the indentation.
    turn : Turn, optional
        Where on a dome the apex of this membrane really is: the gel's edge is there.

    Returns
    -------
    Surface
        The pressed membrane; it touches nowhere if the press lies beside the surface.

    Raises
    ------
    ValueError
        If the press is deeper than the gel, beside it or beyond its edge, or where the membrane is too steep.
    OutOfReach
        If no depth reaches the force.
    NotConverged
        If no solution was found.
    """
    bare = contact.model_copy(update={"skin_length_mm": 0.0})
    solved = _solved(elastomer, bare, press, untouched.pitch_mm, _written_ns(press), turn)
    solution, frame, skin_mm = solved.contact, solved.frame, contact.skin_length_mm
    steepness = float(frame.normal[2])
    normal = _seen(untouched, solved, partial(solution.displacement, smoothing_mm=skin_mm))
    touched = _seen(untouched, solved, partial(_placed, solution.touched.astype(float)))
    force = solved.force_n
    mechanics = Mechanics(
        depth_mm=solution.depth_mm / steepness,
        force_n=float(force[2]),
        shear_force_n=(float(force[0]), float(force[1])),
        contact_area_mm2=solution.contact_area_mm2,
        contact_radius_mm=solution.contact_radius_mm,
        bulge_um=max(-1000.0 * float(normal.min()) / steepness, 0.0),
    )
    return replace(
        untouched,
        height_mm=normal / steepness,
        contact=touched > 0.5,
        mechanics=mechanics,
        warnings=_warnings(solved),
        moved=partial(_moved, untouched, solved, skin_mm),
    )


def least_thickness_mm(presses: Iterable[Press]) -> float:
    """Thickness of a gel that takes these presses with room to spare for deeper ones (mm).

    Of presses that state a depth; at this thickness gel may begin to flow out under the deepest.
    """
    return max((press.depth_mm for press in presses if press.depth_mm is not None), default=0.0) / FLOWS


def _written_ns(press: Press) -> int:
    """When the file of a probe that is a mesh was written; 0 of other probes."""
    return 0 if press.probe.file is None else Path(press.probe.file).stat().st_mtime_ns


@lru_cache(maxsize=128)
def _solved(
    elastomer: Elastomer,
    contact: LayerContact,
    press: Press,
    pitch_mm: float,
    written_ns: int,
    turn: Turn | None,
) -> _Solved:
    """Solve a contact once for all pictures of it, and anew when the file of its probe was written."""
    del written_ns  # is part of the key alone
    if press.moves_sideways and not contact.friction:
        raise ValueError(
            "contact.friction: must be above 0 where a press has shear_mm or twist_deg, a probe without "
            "friction moves nothing sideways"
        )
    frame = _frame(elastomer, press)
    steepness = float(frame.normal[2])
    steep_deg = math.degrees(math.acos(min(steepness, 1.0)))
    if steep_deg > STEEPEST_DEG:
        raise ValueError(
            f"press.centre_mm: the membrane is {steep_deg:.3g} deg steep where {named(press)} "
            f"touches it; presses on an elastic gel need {STEEPEST_DEG:g} deg or less"
        )
    thickness_mm, room_mm = _thickness_mm(elastomer, frame), _room_mm(elastomer, press, frame)
    layer = contact.layer(thickness_mm=thickness_mm)
    require_room(press, room_mm)
    deepest_mm = DEEPEST * room_mm * steepness if press.depth_mm is None else press.depth_mm * steepness
    gap, first = _gap(elastomer, press, frame, pitch_mm, CATCH * deepest_mm)
    axis = _axis(press, frame, first, pitch_mm)
    shift = _in_plane(frame, (*press.shear_mm, 0.0))
    lean = _in_plane(frame, (0.0, 0.0, 1 / steepness))

    def solve(force_n: float | None) -> _Solved:
        solution = press_layer(
            gap,
            layer,
            pitch_mm=pitch_mm,
            depth_mm=None if press.depth_mm is None else deepest_mm,
            force_n=force_n,
            deepest_mm=deepest_mm,
            friction=contact.friction,
            shift_mm=shift,
            lean=lean,
            twist_deg=-press.twist_deg,
            axis=axis,
        )
        points = _points(frame, first, solution)[solution.touched]
        touched = (points if turn is None else turn.forth(points))[:, :2]
        if not inside(elastomer, *touched.T).all():
            x_mm, y_mm = press.centre_mm if turn is None else turn.place_mm[:2]
            raise ValueError(
                f"press: {named(press)} at ({x_mm:g}, {y_mm:g}) mm "
                f"touches the edge of the gel, {elastomer.width_mm:g} mm wide; contact must end on the "
                "membrane"
            )
        distance = _to_edge_mm(touched, elastomer)
        softened = 1 - GIVES_WAY * float(np.exp(-2 * layer.decay_per_mm * distance).mean())
        return _Solved(solution, frame, first, softened, float(distance.min()))

    if press.force_n is None:
        return solve(None)
    # What friction on a slope and the free edge of the gel add or take is known once it is solved.
    normal_n = press.force_n / steepness
    for _ in range(MOST_ROUNDS):
        solved = solve(normal_n)
        found = float(solved.force_n[2])
        asked = solved.contact.force_n * press.force_n / found
        if min(abs(found / press.force_n - 1), abs(asked / normal_n - 1)) < FORCE_TOLERANCE:
            return solved  # asked alike: where the force jumps no depth has it
        normal_n = asked
    raise NotConverged(f"press.force_n: {press.force_n:g} N were not met in {MOST_ROUNDS} rounds")


def _to_edge_mm(touched: Array, elastomer: Elastomer) -> Array:
    """Distance from the rim of a contact to the edge of the gel, in directions around it (mm)."""
    corners = polygon(elastomer)
    side = np.roll(corners, -1, axis=0) - corners
    outward = np.stack([side[:, 1], -side[:, 0]], axis=1) / np.linalg.norm(side, axis=1)[:, None]
    middle = touched.mean(axis=0)
    ahead = np.sum((corners - middle) * outward, axis=1)  # from the middle to each side's line
    turns = np.linspace(0.0, 2 * np.pi, DIRECTIONS, endpoint=False)
    ways = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    facing = ways @ outward.T
    with np.errstate(divide="ignore"):
        reach = np.where(facing > 1e-9, ahead / np.where(facing > 1e-9, facing, 1.0), np.inf).min(axis=1)
    return np.asarray(np.maximum(reach - ((touched - middle) @ ways.T).max(axis=0), 0.0))


def _frame(elastomer: Elastomer, press: Press) -> _Plane:
    if elastomer.shape == "flat":
        return _Plane(np.zeros(3), *np.eye(3))
    x, y = over_gel_mm(press, elastomer, 201)
    base = base_mm(elastomer, x, y)
    above = above_mm(press, base, x, y)
    if not np.isfinite(above).any():
        raise ValueError(
            f"press.centre_mm: {named(press)} at ({press.centre_mm[0]:g}, {press.centre_mm[1]:g}) mm "
            "lies beside the gel"
        )
    first = int(above.argmax())
    place = np.array([x.flat[first], y.flat[first], base.flat[first]])
    p, q = (float(slope) for slope in base_gradient(elastomer, place[0], place[1]))
    normal = np.array([-p, -q, 1.0]) / math.sqrt(1 + p**2 + q**2)
    across = np.array([1.0, 0.0, p]) / math.sqrt(1 + p**2)
    return _Plane(place, across, np.cross(normal, across), normal)


def _thickness_mm(elastomer: Elastomer, frame: _Plane) -> float:
    """Thickness between membrane and core along the normal."""
    if elastomer.shape == "dome":
        return elastomer.thickness_mm
    x, y, z = frame.origin
    return (float(interface_mm(elastomer, x, y)) - float(z)) / float(frame.normal[2])


def _room_mm(elastomer: Elastomer, press: Press, frame: _Plane) -> float:
    """Depth at which the probe, or the gel where it touches first, would meet the core."""
    x, y, z = frame.origin
    straight = float(interface_mm(elastomer, x, y)) - float(z)
    foremost = float(interface_mm(elastomer, *press.centre_mm)) + first_touch_mm(press, elastomer)
    return min(straight, foremost, _thickness_mm(elastomer, frame) / float(frame.normal[2]))


def _gap(
    elastomer: Elastomer, press: Press, frame: _Plane, pitch_mm: float, most_mm: float
) -> tuple[Array, tuple[int, int]]:
    """Distance from membrane to probe along the normal, up to the most; row and column of its first point."""
    middle = _axis_point(press, frame)
    reach = reach_mm(press) / float(frame.normal[2]) + pitch_mm
    # Of a plate larger than the gel what lies far beside it is left out.
    most = math.hypot(elastomer.width_mm, elastomer.length_mm) / 2 + float(np.linalg.norm(middle)) + pitch_mm
    columns = _indices(float(middle @ frame.across), reach, most, pitch_mm)
    rows = _indices(-float(middle @ frame.along), reach, most, pitch_mm)
    point = _on_plane(frame, rows, columns, pitch_mm)
    x, y = point[..., 0], point[..., 1]
    above = above_mm(press, base_mm(elastomer, x, y), x, y)
    gap = (first_touch_mm(press, elastomer) - above) * float(frame.normal[2])
    near = gap < most_mm
    if not near.any():
        return np.full((1, 1), np.inf), (0, 0)
    used_rows, used_columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
    used = np.s_[used_rows[0] : used_rows[-1] + 1, used_columns[0] : used_columns[-1] + 1]
    gap = np.where(near, np.maximum(gap, 0.0), np.inf)[used]
    return gap, (int(rows[used_rows[0]]), int(columns[used_columns[0]]))


def _indices(middle_mm: float, reach_mm: float, most_mm: float, pitch_mm: float) -> NDArray[np.int_]:
    low, high = max(middle_mm - reach_mm, -most_mm), min(middle_mm + reach_mm, most_mm)
    return np.arange(math.ceil(low / pitch_mm), math.floor(high / pitch_mm) + 1)


def _on_plane(frame: _Plane, rows: NDArray[np.int_], columns: NDArray[np.int_], pitch_mm: float) -> Array:
    """Points of the lattice on the touching plane (mm), shape (rows, columns, 3)."""
    across, down = columns[None, :, None] * pitch_mm, rows[:, None, None] * pitch_mm
    return np.asarray(frame.origin + across * frame.across - down * frame.along)


def _points(frame: _Plane, first: tuple[int, int], solution: ContactSolution) -> Array:
    """Points of the grid of a contact (mm), shape (rows, columns, 3)."""
    (row, column), (rows, columns) = first, solution.pressure_mpa.shape
    return _on_plane(frame, row + np.arange(rows), column + np.arange(columns), solution.pitch_mm)


def _in_plane(frame: _Plane, path: tuple[float, float, float]) -> tuple[float, float]:
    """Part of a path along columns and rows of the touching plane (mm)."""
    return float(np.dot(path, frame.across)), -float(np.dot(path, frame.along))


def _axis_point(press: Press, frame: _Plane) -> Array:
    """Where the probe's axis meets the touching plane, from its origin (mm)."""
    x, y = np.subtract(press.centre_mm, frame.origin[:2])
    return np.array([x, y, -(x * frame.normal[0] + y * frame.normal[1]) / frame.normal[2]])


def _axis(press: Press, frame: _Plane, first: tuple[int, int], pitch_mm: float) -> tuple[float, float]:
    """Column and row of the probe's axis on the grid of the contact."""
    middle = _axis_point(press, frame)
    column, row = float(middle @ frame.across) / pitch_mm, -float(middle @ frame.along) / pitch_mm
    return column - first[1], row - first[0]


def _seen(
    untouched: Surface, solved: _Solved, made: Callable[[tuple[int, int], tuple[int, int]], Array]
) -> Array:
    """Field of the contact on the grid of the surface.

    `made` gives it on a lattice of the touching plane, from its shape and where the contact starts on it.
    """
    (row, column), pitch_mm, frame = solved.first, untouched.pitch_mm, solved.frame
    if frame.normal[2] == 1.0 and not frame.origin.any():  # the lattice is the surface's own
        top, left = round(-untouched.y_mm[0] / pitch_mm), round(untouched.x_mm[0] / pitch_mm)
        shape = len(untouched.y_mm), len(untouched.x_mm)
        return made(shape, (row - top, column - left))
    x, y = np.meshgrid(untouched.x_mm, untouched.y_mm)
    away = np.stack([x, y, np.nan_to_num(untouched.base_mm)], axis=-1) - frame.origin
    columns, rows = away @ frame.across / pitch_mm, -(away @ frame.along) / pitch_mm
    left, top = math.floor(columns.min()) - 1, math.floor(rows.min()) - 1
    shape = math.ceil(rows.max()) + 2 - top, math.ceil(columns.max()) + 2 - left
    field = made(shape, (row - top, column - left))
    return np.asarray(map_coordinates(field, [rows - top, columns - left], order=3, mode="nearest"))


def _placed(field: Array, shape: tuple[int, int], origin: tuple[int, int]) -> Array:
    """Put a field at a place of a larger grid, or as much of it as lies there."""
    whole = np.zeros(shape)
    low = [max(start, 0) for start in origin]
    high = [min(start + own, end) for start, own, end in zip(origin, field.shape, shape, strict=True)]
    if low[0] < high[0] and low[1] < high[1]:
        own = np.s_[low[0] - origin[0] : high[0] - origin[0], low[1] - origin[1] : high[1] - origin[1]]
        whole[low[0] : high[0], low[1] : high[1]] = field[own]
    return whole


def _moved(untouched: Surface, solved: _Solved, skin_mm: float) -> tuple[Array, Array]:
    """How far the skin moved along x and y (mm)."""
    frame, solution = solved.frame, solved.contact

    def sideways(axis: int, shape: tuple[int, int], origin: tuple[int, int]) -> Array:
        return np.asarray(solution.tangential_displacement(shape, origin, smoothing_mm=skin_mm)[axis])

    right, down = (_seen(untouched, solved, partial(sideways, axis)) for axis in (0, 1))
    moved_x, moved_y = (right * frame.across[k] - down * frame.along[k] for k in (0, 1))
    if frame.normal[:2].any():
        normal = _seen(untouched, solved, partial(solution.displacement, smoothing_mm=skin_mm))
        moved_x, moved_y = moved_x + normal * frame.normal[0], moved_y + normal * frame.normal[1]
    return np.asarray(moved_x), np.asarray(moved_y)


def _warnings(solved: _Solved) -> tuple[str, ...]:
    """Where the model is used beyond what it holds for."""
    solution, found = solved.contact, []
    thickness_mm = solution.layer.thickness_mm
    if solution.depth_mm > SMALL_STRAIN * thickness_mm:
        found.append(
            f"the press is {solution.depth_mm:.3g} mm deep in a gel of {thickness_mm:.3g} mm; beyond "
            f"{SMALL_STRAIN:g} of the thickness the linear model errs by 4 % of the force and more, and "
            f"beyond {FLOWS:g} of it gel may flow out under the probe"
        )
    if solution.contact_radius_mm < FEW_CELLS * solution.pitch_mm:
        found.append(
            f"the contact has a radius of {solution.contact_radius_mm:.2g} mm, on a grid of "
            f"{solution.pitch_mm:.2g} mm; its force may err by 10 % and more"
        )
    reach = FREE_EDGE * thickness_mm
    if solved.edge_mm < reach:
        found.append(
            f"the contact ends {solved.edge_mm:.3g} mm from the edge of the gel, nearer than {FREE_EDGE:g} "
            "thicknesses; the gel gives way there, which the surface lacks"
        )
    needed = solution.needed_friction()
    if needed > 1.01 * GRIPS:
        found.append(
            f"the probe sticks as with a coefficient of friction of {needed:.2g}; more than {GRIPS:g} is "
            "rare, so this is an upper bound of friction"
        )
    return tuple(found)
