"""What an indentation does to itself: the horizon that shadows it, and light from wall to wall."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from designlab.core.types import Single
from designlab.simulation.contact.surface import Surface
from designlab.simulation.render.engine import dr, mi
from designlab.simulation.render.lightfield import AZIMUTHS
from designlab.simulation.render.nodes import RAISED_MM, Nodes, NodeTables
from designlab.simulation.render.tables import cell, held, on_device, within

FURTHEST_MM = 4.0  # reach of parallax
BEYOND_MM = 20.0  # reach of light that the gel around throws on a wall
NO_HORIZON = -1e6  # tangent of a horizon right below
GATHER_AZIMUTHS = 16  # directions in which light from other walls is looked for


def _turns(nodes: Nodes, azimuths: int) -> tuple[Any, Any, Any, Any, Any]:
    """Return (node, x, y, dx, dy) for every node and azimuth, azimuth last."""
    index = dr.arange(mi.UInt32, dr.width(nodes.x) * azimuths)
    node = index // azimuths
    angle = (mi.Float(index % azimuths) + 0.5) * (2 * dr.pi / azimuths)
    x, y = dr.gather(mi.Float, nodes.x, node), dr.gather(mi.Float, nodes.y, node)
    return node, x, y, dr.cos(angle), dr.sin(angle)


def horizon_of(surface: Surface, nodes: Nodes, reach_mm: float) -> Any:
    """Tangent of the indentation's horizon at every node and azimuth, flattened with azimuth last.

    Only gel that is raised hides light: a bulge slopes by a few degrees, and what its own slope turns away
    from the light is foreshortening.
    """
    if not (surface.height_mm > RAISED_MM).any():
        return dr.full(mi.Float, NO_HORIZON, dr.width(nodes.x) * AZIMUTHS)
    grid = NodeTables.of(surface)
    _, x, y, dx, dy = _turns(nodes, AZIMUTHS)
    here = grid.sample(grid.z, x, y)
    count = dr.width(x)
    last = dr.minimum(_leaves(surface, x, y, dx, dy), held(float(reach_mm)))

    def going(distance: Any, _: Any) -> Any:
        return distance < last

    def step(distance: Any, rim: Any) -> Any:
        px, py = x + distance * dx, y + distance * dy
        z, raised = grid.above(px, py)
        rim = dr.select(raised > RAISED_MM, dr.maximum(rim, (z - here) / distance), rim)
        # Steps grow with the distance: far walls subtend less.
        return distance * 1.1 + 0.5 * grid.pitch_mm, rim

    _, rim = dr.while_loop(
        (dr.full(mi.Float, 1.5 * surface.pitch_mm, count), dr.full(mi.Float, NO_HORIZON, count)),
        going,
        step,
        labels=("distance", "rim"),
    )
    dr.eval(rim)
    return rim


def _leaves(surface: Surface, x: Any, y: Any, dx: Any, dy: Any) -> Any:
    """Distance at which a way across leaves the rectangle around all that is raised; none where it misses."""
    raised = surface.height_mm > RAISED_MM
    sides = (x, dx, surface.x_mm[raised.any(axis=0)]), (y, dy, surface.y_mm[raised.any(axis=1)])
    margin = surface.pitch_mm
    enters, leaves = within((place, way, at.min() - margin, at.max() + margin) for place, way, at in sides)
    return dr.select(enters < leaves, leaves, 0.0)


class Around(NamedTuple):
    """Radiance of the whole undeformed membrane, on a lattice wider than the grid of a surface.

    Parameters
    ----------
    radiance : array, shape (groups, rows, columns)
        Row 0 at the least y.
    x_mm, y_mm, pitch_mm : float
        Where the first point is, and how far the next one.
    """

    radiance: Single
    x_mm: float
    y_mm: float
    pitch_mm: float

    def tables(self) -> Callable[[Any, Any], list[Any]]:
        """Look-up on the device: radiance of every group at points (mm), nothing beside the membrane."""
        tables = [on_device(image) for image in self.radiance]
        rows, columns = (held(n) for n in self.radiance.shape[1:])
        x_mm, y_mm, pitch_mm = (held(float(v)) for v in self[1:])

        def at(x: Any, y: Any) -> list[Any]:
            index, inside = cell((x - x_mm) / pitch_mm, (y - y_mm) / pitch_mm, rows, columns)
            return [dr.gather(mi.Float, table, index, inside) for table in tables]

        return at


def between_walls(surface: Surface, nodes: Nodes, radiance: Single, around: Around) -> Single:
    """Irradiance of the nodes by light from the membrane itself, shape (groups, nodes).

    Seen from a node, each step outwards that rises above the horizon so far shows a strip of membrane between
    two elevations; its cosine-weighted solid angle is closed. Strips of undeformed membrane count only where
    the undeformed node would not see them: that light is part of the light field.
    """
    grid = NodeTables.of(surface)
    node, x, y, dx, dy = _turns(nodes, GATHER_AZIMUTHS)
    count = dr.width(x)
    here = grid.sample(grid.z, x, y)
    normal = dr.gather(mi.Vector3f, nodes.normal, node)
    ahead = normal.x * dx + normal.y * dy
    own = -ahead / dr.maximum(normal.z, 1e-3)
    undeformed = dr.gather(mi.Float, nodes.base_p, node) * dx + dr.gather(mi.Float, nodes.base_q, node) * dy
    tables = [on_device(image) for image in radiance]
    beyond = around.tables()

    def going(distance: Any, *_: Any) -> Any:
        return distance < BEYOND_MM

    def step(distance: Any, rim: Any, below: Any, *sums: Any) -> Any:
        px, py = x + distance * dx, y + distance * dy
        z, raised = grid.above(px, py)
        slope = (z - here) / distance
        top = dr.select(raised > RAISED_MM, slope, dr.minimum(slope, undeformed))
        seen = _strip(dr.maximum(rim, top), ahead, normal.z) - below
        index, inside = cell(*grid.place(px, py), grid.rows, grid.columns)
        added = tuple(
            s + seen * dr.select(inside, dr.gather(mi.Float, table, index, inside), far)
            for s, table, far in zip(sums, tables, beyond(px, py), strict=True)
        )
        rim = dr.maximum(rim, slope)
        return distance * 1.2 + 0.5 * grid.pitch_mm, rim, _strip(rim, ahead, normal.z), *added

    start = dr.full(mi.Float, 1.5 * surface.pitch_mm, count)
    zeros = tuple(dr.zeros(mi.Float, count) for _ in tables)
    _, _, _, *sums = dr.while_loop((start, own, _strip(own, ahead, normal.z), *zeros), going, step)
    dr.eval(*sums)  # one loop for all groups
    share = 2 * np.pi / GATHER_AZIMUTHS
    return np.stack([np.asarray(s).reshape(-1, GATHER_AZIMUTHS).sum(axis=1) * share for s in sums]).astype(
        np.float32
    )


def _strip(tangent: Any, ahead: Any, up: Any) -> Any:
    """Integral of the cosine over elevation, up to the one of the given tangent."""
    square = tangent * tangent
    return ahead * 0.5 * (dr.atan(tangent) + tangent / (1 + square)) + up * 0.5 * square / (1 + square)
