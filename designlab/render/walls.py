"""What an indentation does to itself: the horizon that shadows it, and light from wall to wall."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.press import Surface
from designlab.render.lightfield import AZIMUTHS
from designlab.render.nodes import RAISED_MM, Grid, Nodes
from designlab.render.tables import held

Single = NDArray[np.float32]
FURTHEST_MM = 4.0  # reach of parallax and of light between walls
GATHER_AZIMUTHS = 16  # directions in which light from other walls is looked for


def _turns(nodes: Nodes, azimuths: int) -> tuple[Any, Any, Any, Any, Any]:
    """Return (node, x, y, dx, dy) for every node and azimuth, azimuth last."""
    import drjit as dr
    import mitsuba as mi

    index = dr.arange(mi.UInt32, dr.width(nodes.x) * azimuths)
    node = index // azimuths
    angle = (mi.Float(index % azimuths) + 0.5) * (2 * dr.pi / azimuths)
    x, y = dr.gather(mi.Float, nodes.x, node), dr.gather(mi.Float, nodes.y, node)
    return node, x, y, dr.cos(angle), dr.sin(angle)


def horizon_of(surface: Surface, nodes: Nodes, reach_mm: float) -> Any:
    """Tangent of the indentation's horizon at every node and azimuth, flattened with azimuth last."""
    import drjit as dr
    import mitsuba as mi

    grid = Grid.of(surface)
    _, x, y, dx, dy = _turns(nodes, AZIMUTHS)
    here = grid.sample(grid.z, x, y)
    count, reach = dr.width(x), held(float(reach_mm))

    def going(distance: Any, _: Any) -> Any:
        return distance < reach

    def step(distance: Any, rim: Any) -> Any:
        px, py = x + distance * dx, y + distance * dy
        slope = (grid.sample(grid.z, px, py) - here) / distance
        rim = dr.select(grid.sample(grid.raised, px, py) > RAISED_MM, dr.maximum(rim, slope), rim)
        # Steps grow with the distance: far walls subtend less.
        return distance * 1.1 + 0.5 * grid.pitch_mm, rim

    _, rim = dr.while_loop(
        (dr.full(mi.Float, 1.5 * surface.pitch_mm, count), dr.full(mi.Float, -1e6, count)),
        going,
        step,
        labels=("distance", "rim"),
    )
    dr.eval(rim)
    return rim


def between_walls(surface: Surface, nodes: Nodes, radiance: Single) -> Single:
    """Irradiance of the nodes by light from the membrane itself, shape (groups, nodes).

    Seen from a node, each step outwards that rises above the horizon so far shows a strip of membrane between
    two elevations; its cosine-weighted solid angle is closed. Strips of undeformed membrane count only where
    the undeformed node would not see them: that light is part of the light field.
    """
    import drjit as dr
    import mitsuba as mi

    grid = Grid.of(surface)
    node, x, y, dx, dy = _turns(nodes, GATHER_AZIMUTHS)
    count = dr.width(x)
    here = grid.sample(grid.z, x, y)
    normal = dr.gather(mi.Vector3f, nodes.normal, node)
    ahead = normal.x * dx + normal.y * dy
    own = -ahead / dr.maximum(normal.z, 1e-3)
    undeformed = dr.gather(mi.Float, nodes.base_p, node) * dx + dr.gather(mi.Float, nodes.base_q, node) * dy
    tables = [mi.Float(np.ascontiguousarray(image).ravel()) for image in radiance]

    def going(distance: Any, *_: Any) -> Any:
        return distance < FURTHEST_MM

    def step(distance: Any, rim: Any, below: Any, *sums: Any) -> Any:
        px, py = x + distance * dx, y + distance * dy
        slope = (grid.sample(grid.z, px, py) - here) / distance
        raised = grid.sample(grid.raised, px, py) > RAISED_MM
        top = dr.select(raised, slope, dr.minimum(slope, undeformed))
        seen = _strip(dr.maximum(rim, top), ahead, normal.z) - below
        u, v = grid.place(px, py)
        column = mi.UInt32(dr.clip(u + 0.5, 0.0, mi.Float(grid.columns) - 1))
        row = mi.UInt32(dr.clip(v + 0.5, 0.0, mi.Float(grid.rows) - 1))
        added = tuple(
            s + seen * dr.gather(mi.Float, table, row * grid.columns + column)
            for s, table in zip(sums, tables, strict=True)
        )
        rim = dr.maximum(rim, slope)
        return distance * 1.2 + 0.5 * grid.pitch_mm, rim, _strip(rim, ahead, normal.z), *added

    start = dr.full(mi.Float, 1.5 * surface.pitch_mm, count)
    zeros = tuple(dr.zeros(mi.Float, count) for _ in tables)
    _, _, _, *sums = dr.while_loop((start, own, _strip(own, ahead, normal.z), *zeros), going, step)
    share = 2 * np.pi / GATHER_AZIMUTHS
    return np.stack([np.asarray(s).reshape(-1, GATHER_AZIMUTHS).sum(axis=1) * share for s in sums]).astype(
        np.float32
    )


def _strip(tangent: Any, ahead: Any, up: Any) -> Any:
    """Integral of the cosine over elevation, up to the one of the given tangent."""
    import drjit as dr

    square = tangent * tangent
    return ahead * 0.5 * (dr.atan(tangent) + tangent / (1 + square)) + up * 0.5 * square / (1 + square)
