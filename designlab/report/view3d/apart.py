"""Pictures of a sensor taken apart: parts in place, parts on their way in, and the body cut open."""

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from designlab.report.view3d import draw_job
from geometries.mesh import from_solid

if TYPE_CHECKING:
    import cadquery

MESHES = "meshes.npz"
WIDTH_PX, HEIGHT_PX = 1200, 960
AZIMUTH_DEG, ABOVE_DEG, BELOW_DEG = -62.0, 22.0, -24.0
_TOLERANCE_MM, _ANGLE_DEG = 0.03, 8.0
NEAR_MM = 200.0  # towards the viewer; the projection is parallel, so the arrow stays beside its part
_ARROW = "#d1541e"

Vector = tuple[float, float, float]
Colour = tuple[float, float, float, float]


class Drawn(NamedTuple):
    """A part in a picture: name, distance from its place (mm), whether it is cut open, and has an arrow."""

    part: str
    away_mm: Vector = (0.0, 0.0, 0.0)
    opened: bool = False
    arrow: bool = False


class Apart(NamedTuple):
    """A picture: file name, parts, and whether it is seen from below."""

    file: str
    parts: tuple[Drawn, ...]
    below: bool


def pictures_apart(
    shapes: Mapping[str, "cadquery.Shape"],
    colours: Mapping[str, Colour],
    pictures: Sequence[Apart],
    folder: Path,
    *,
    timeout_s: float = 300.0,
) -> str:
    """Draw parts off screen, in a process of its own: without OpenGL there is a reason, not a crash.

    Parameters
    ----------
    shapes : mapping of str to cadquery.Shape
        Parts in the sensor frame (mm).
    colours : mapping of str to (float, float, float, float)
        Their colours, sRGB and opacity.
    pictures : sequence of Apart
        What to draw.
    folder : Path
        Where the PNG files are written.
    timeout_s : float
        Time (s) after which drawing is given up.

    Returns
    -------
    str
        Why there is no picture; empty if all were drawn.
    """
    import cadquery

    with tempfile.TemporaryDirectory(prefix="designlab-apart-") as work:
        job, meshes = Path(work), dict[str, Any]()
        for name in {drawn.part for picture in pictures for drawn in picture.parts}:
            solids = cadquery.Workplane().newObject(shapes[name].Solids())
            mesh = from_solid(solids, tolerance_mm=_TOLERANCE_MM, angular_tolerance_deg=_ANGLE_DEG)
            meshes[f"{name}.vertices"] = np.asarray(mesh.vertices)
            meshes[f"{name}.faces"] = np.asarray(mesh.faces)
        np.savez(job / MESHES, **meshes)
        wanted = {"colours": dict(colours), "pictures": [_plain(picture) for picture in pictures]}
        (job / "job.json").write_text(json.dumps(wanted), encoding="utf-8")
        reason = draw_job(job, timeout_s)
        if not reason:
            for picture in pictures:
                (folder / picture.file).write_bytes((job / picture.file).read_bytes())
    return reason


def _plain(picture: Apart) -> dict[str, Any]:
    parts = [[drawn.part, list(drawn.away_mm), drawn.opened, drawn.arrow] for drawn in picture.parts]
    return {"file": picture.file, "parts": parts, "below": picture.below}


def draw_apart(job: Path) -> None:
    """Draw the pictures of a job folder into it."""
    stored = np.load(job / MESHES)
    wanted = json.loads((job / "job.json").read_text(encoding="utf-8"))
    for picture in wanted["pictures"]:
        _draw(stored, wanted["colours"], picture, job / picture["file"])


def _draw(
    stored: Mapping[str, Any], colours: Mapping[str, Colour], picture: dict[str, Any], path: Path
) -> None:
    import pyvista

    plotter: Any = pyvista.Plotter(off_screen=True, window_size=[WIDTH_PX, HEIGHT_PX], lighting="light kit")
    plotter.set_background("white")
    plotter.enable_depth_peeling(8)
    azimuth = np.radians(AZIMUTH_DEG)
    towards = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    elevation = np.radians(BELOW_DEG if picture["below"] else ABOVE_DEG)
    view = np.cos(elevation) * towards + np.array([0.0, 0.0, np.sin(elevation)])
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for name, away, opened, arrow in picture["parts"]:
        points, faces = stored[f"{name}.vertices"] + away, stored[f"{name}.faces"]
        mesh = pyvista.PolyData(points, np.column_stack([np.full(len(faces), 3), faces]).ravel())
        if opened:  # the half towards the viewer is taken away
            mesh = mesh.clip_closed_surface(normal=-towards, origin=points.mean(axis=0) * (0.0, 0.0, 1.0))
            if not mesh.n_points:
                continue
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
        *colour, opacity = colours[name]
        plotter.add_mesh(
            mesh, color=colour, opacity=opacity, ambient=0.15, specular=0.15, split_sharp_edges=True,
            smooth_shading=True, feature_angle=30.0,
        )  # fmt: skip
        edges = mesh.extract_feature_edges(30.0)
        if edges.n_cells:
            plotter.add_mesh(edges, color="#20242b", line_width=1.5, opacity=max(opacity, 0.6))
        if arrow:
            _arrow(plotter, mesh, np.asarray(away), view)
    focus, reach = (low + high) / 2, float(np.linalg.norm(high - low))
    plotter.camera.focal_point = focus
    plotter.camera.position = focus + 5 * reach * view
    plotter.camera.up = (0, 0, 1)
    plotter.enable_parallel_projection()
    right = np.array([-towards[1], towards[0], 0.0])
    up = np.cross(view, right)
    corners = np.array(
        [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    )
    tall, wide = (float(np.ptp((corners - focus) @ axis)) for axis in (up, right))
    plotter.camera.parallel_scale = 0.53 * max(tall, wide * HEIGHT_PX / WIDTH_PX)
    plotter.camera.clipping_range = (0.1 * reach, 12 * reach)
    plotter.enable_anti_aliasing("ssaa")
    plotter.screenshot(str(path))
    plotter.close()


def _arrow(plotter: Any, drawn: Any, away: Any, view: Any) -> None:
    """Arrow from the middle of a part, as it is drawn, towards its place, before all else.

    Of several pieces that go in together, it starts at the largest or first.
    """
    import pyvista

    length = float(np.linalg.norm(away))
    start = np.asarray(drawn.extract_largest().center) + NEAR_MM * view
    plotter.add_mesh(
        pyvista.Arrow(
            start=start,
            direction=-away,
            scale=0.8 * length,
            tip_length=0.25,
            tip_radius=0.06,
            shaft_radius=0.02,
        ),
        color=_ARROW,
        lighting=False,
    )
