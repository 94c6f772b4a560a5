"""The three-dimensional part of the picture: solids, lights and lines in a PyVista plotter."""

from collections.abc import Iterable
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from designlab.core.types import Array
from designlab.fabrication import group_colour, package_colour, parts
from designlab.report.plots import SENSING_COLOUR
from designlab.sensor.design import Design
from designlab.sensor.mirror import Mirror
from geometries.elastomer import base_mm, polygon
from geometries.leds import Emitter, bodies, emitters
from geometries.mesh import from_solid

if TYPE_CHECKING:
    import cadquery
    import pyvista


WIDTH_PX, HEIGHT_PX = 1800, 1300
VIEW_AZIMUTH_DEG, VIEW_ELEVATION_DEG = -62.0, 24.0
CUT_HALF_ANGLE_DEG = 68.0
"""The housing is open this far to both sides of the viewer."""
_DRAWN_TOLERANCE_MM = 0.02
_MEMBRANE_POINTS = 400
_MEMBRANE_GAP_MM = 0.02


def scene(design: Design, indentation: tuple[Array, Array, Array] | None, *, cutaway: bool) -> Any:
    """Put everything into a PyVista plotter that looks at it from the front, slightly from above.

    Parameters
    ----------
    design : Design
        The sensor.
    indentation : tuple of arrays, optional
        x (columns,), y (rows,; descending) and height (rows, columns) of the pressed membrane (mm).
    cutaway : bool
        Cut the housing open towards the viewer.
    """
    import pyvista

    shapes = parts(design)
    plotter: Any = pyvista.Plotter(off_screen=True, window_size=[WIDTH_PX, HEIGHT_PX], lighting="light kit")
    plotter.set_background("white")
    plotter.enable_depth_peeling(12)
    thin = 0.0035 * _height_mm(design)

    def add(mesh: Any, colour: str | tuple[float, float, float], **look: Any) -> None:
        plotter.add_mesh(mesh, color=colour, **look)

    smooth = {"smooth_shading": True, "split_sharp_edges": True, "feature_angle": 25.0}
    housing = _opened(shapes["housing"], design) if cutaway else shapes["housing"]
    add(_mesh(housing), "#9aa1ad", opacity=1.0 if cutaway else 0.2, ambient=0.12, specular=0.15, **smooth)
    add(_mesh(shapes["gelcore"]), "#a9d6ee", opacity=0.16, specular=0.9, specular_power=40, **smooth)
    add(_mesh(shapes["elastomer"]), "#f3b877", opacity=0.15, specular=0.3, **smooth)
    for name, colour in (("gelcore", "#2f7fa8"), ("elastomer", "#b8752c")):
        edges = _mesh(shapes[name]).extract_feature_edges(25.0).strip(join=True)
        add(edges.tube(radius=0.5 * thin), colour, opacity=0.75)
    colours = [group_colour(group) for group in design.leds.groups]
    for solid, body in zip(shapes["led_array"].Solids(), bodies(design.leds), strict=True):
        held = [design.leds.groups[index] for index in body.groups]
        r, g, b = (0.15 + 0.45 * channel for channel in package_colour(held))
        add(_mesh(solid), (r, g, b), ambient=0.1)
    for emitter in side_by_side(emitters(design.leds)):
        length_mm = 0.45 * design.leds.placement_of(emitter.group).radius_mm
        add(_face(emitter), colours[emitter.group], lighting=False)
        add(_arrow(emitter, length_mm), colours[emitter.group], lighting=False)
    _add_membrane(plotter, design, indentation)
    add(_sensing_area(design).tube(radius=1.2 * thin), SENSING_COLOUR, lighting=False)
    for line in _frustum(design):
        add(line.tube(radius=0.6 * thin), SENSING_COLOUR, lighting=False, opacity=0.6)
    add(_camera_body(design), "#59616f", specular=0.4, **smooth)
    _aim(plotter, design)
    return plotter


def _height_mm(design: Design) -> float:
    camera, housing = design.camera, design.housing
    top = max(housing.top_mm + housing.plate_mm, camera.position_mm[2] + 2 * camera.body_radius_mm)
    return top - min(housing.bottom_mm, 0.0)


def _mesh(shape: "cadquery.Shape") -> Any:
    import cadquery
    import pyvista

    solids = cadquery.Workplane().newObject(shape.Solids())
    return pyvista.wrap(from_solid(solids, tolerance_mm=_DRAWN_TOLERANCE_MM, angular_tolerance_deg=4.0))


def _opened(housing: "cadquery.Shape", design: Design) -> "cadquery.Shape":
    """Return the housing without the wedge that faces the viewer; its cut faces are solid."""
    import cadquery

    reach = 3 * (design.housing.inner_radius_mm + design.housing.wall_mm)
    box = housing.BoundingBox()
    low, high = box.zmin - 1, box.zmax + 1
    azimuths = np.radians(VIEW_AZIMUTH_DEG + np.array([-CUT_HALF_ANGLE_DEG, 0.0, CUT_HALF_ANGLE_DEG]))
    corners = [(0.0, 0.0), *((float(reach * np.cos(a)), float(reach * np.sin(a))) for a in azimuths)]
    wedge = cadquery.Workplane("XY", origin=(0, 0, low)).polyline(corners).close().extrude(high - low)
    return cadquery.Compound.makeCompound(housing.cut(wedge.findSolid()).Solids())


def side_by_side(found: Iterable[Emitter]) -> list[Emitter]:
    """Emitting faces as they are drawn: one that groups share is divided among them, along the row."""
    shared: dict[tuple[Any, ...], list[Emitter]] = {}
    for emitter in found:
        place = tuple(round(c, 6) for c in emitter.centre_mm)
        shared.setdefault((emitter.body, place), []).append(emitter)
    drawn = []
    for same in shared.values():
        for number, emitter in enumerate(same):
            half = emitter.half_width_mm / len(same)
            aside = (2 * number + 1 - len(same)) * half
            x, y, z = (c + aside * a for c, a in zip(emitter.centre_mm, emitter.across, strict=True))
            drawn.append(emitter._replace(centre_mm=(x, y, z), half_width_mm=half))
    return drawn


def _face(emitter: Emitter) -> Any:
    import pyvista

    centre = np.asarray(emitter.centre_mm) + 0.02 * np.asarray(emitter.normal)
    across = emitter.half_width_mm * np.asarray(emitter.across)
    down = emitter.half_height_mm * np.asarray(emitter.down)
    corners = [centre + a * across + d * down for a, d in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return pyvista.PolyData(np.array(corners), faces=[4, 0, 1, 2, 3])


def _arrow(emitter: Emitter, length_mm: float) -> Any:
    """Arrow in the emitting direction."""
    import pyvista

    return pyvista.Arrow(
        start=emitter.centre_mm,
        direction=emitter.normal,
        scale=length_mm,
        tip_length=0.25,
        tip_radius=0.06,
        shaft_radius=0.02,
        tip_resolution=32,
        shaft_resolution=32,
    )


def _add_membrane(
    plotter: "pyvista.Plotter", design: Design, indentation: tuple[Array, Array, Array] | None
) -> None:
    """Draw the membrane within the gel's outline; where it is pressed, its colour is the depth."""
    import pyvista
    from scipy.interpolate import RegularGridInterpolator

    # Rays from the middle to the outline, so that the grid ends exactly there.
    gel = design.elastomer
    corners = polygon(gel, segments=_MEMBRANE_POINTS)
    along = np.linspace(0, 1, max(2, 4 * _MEMBRANE_POINTS // len(corners)))[:-1, None]
    rim = np.vstack([a + along * (b - a) for a, b in pairwise([*corners, corners[0]])] + [corners[:1]])
    share = np.linspace(0.0, 1.0 - 1e-9, _MEMBRANE_POINTS)[:, None]
    x, y = share * rim[:, 0], share * rim[:, 1]
    z, pressed = base_mm(gel, x, y), np.zeros(x.shape)
    if indentation is not None:
        columns, rows, height = indentation
        height_at = RegularGridInterpolator(
            (rows[::-1], columns), height[::-1], bounds_error=False, fill_value=0.0
        )
        pressed = height_at((y, x))
    # Just outside the gel's own outer face, or the two would fight for the pixels.
    outside = _MEMBRANE_GAP_MM / (gel.radius_mm or np.inf)
    gap = _MEMBRANE_GAP_MM * (1 - (z / gel.radius_mm if gel.radius_mm else 0.0))
    grid = pyvista.StructuredGrid((1 + outside) * x, (1 + outside) * y, z + pressed - gap)
    grid["depth"] = pressed.ravel(order="F")
    membrane = grid.extract_surface()
    look: dict[str, Any] = {"specular": 0.5, "specular_power": 12, "smooth_shading": True}
    if indentation is None:
        plotter.add_mesh(membrane, color="#dddad4", **look)
    else:
        shades = ["#dddad4", "#7b5ea7", "#2d1e5e"]
        deepest = max(float(pressed.max()), 1e-6)  # a bulge has the colour of untouched gel
        plotter.add_mesh(
            membrane, scalars="depth", clim=(0.0, deepest), cmap=shades, show_scalar_bar=False, **look
        )


def _sensing_area(design: Design) -> Any:
    """Outline of the sensing area on the untouched membrane."""
    import pyvista

    outline = design.sensing_area.outline_mm(per_side=60)
    path = np.vstack([outline, outline[:1]])
    z = np.nan_to_num(base_mm(design.elastomer, path[:, 0], path[:, 1]))
    return pyvista.lines_from_points(np.column_stack([path, z]))


def _frustum(design: Design) -> list[Any]:
    import pyvista

    x, y = design.sensing_area.ends_mm.T
    ends = np.column_stack([x, y, np.nan_to_num(base_mm(design.elastomer, x, y))])
    camera = design.camera
    if camera.mirror is None:
        return [pyvista.Line(camera.position_mm, end) for end in ends]
    eye, (_, _, normal) = np.array(camera.eye_mm), camera.mirror.axes
    ahead = (np.asarray(camera.mirror.centre_mm) - eye) @ normal
    met = [eye + (end - eye) * ahead / ((end - eye) @ normal) for end in ends]
    below = [pyvista.Line(at, end) for at, end in zip(met, ends, strict=True)]
    return below + [pyvista.Line(camera.position_mm, at) for at in met] + [_mirror(camera.mirror)]


def _mirror(mirror: Mirror) -> Any:
    """Outline of the camera's mirror."""
    import pyvista

    across, along, _ = mirror.axes
    signs = [(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]
    half = np.array(signs) * (mirror.width_mm / 2, mirror.height_mm / 2)
    return pyvista.lines_from_points(np.asarray(mirror.centre_mm) + half @ np.stack([across, along]))


def _camera_body(design: Design) -> Any:
    """Lens barrel above the centre of projection."""
    import pyvista

    (x, y, z), radius = design.camera.position_mm, design.camera.body_radius_mm
    barrel = pyvista.Cylinder(
        center=(x, y, z + radius), direction=(0, 0, 1), radius=radius, height=2 * radius, resolution=120
    )
    return barrel.triangulate()


def _aim(plotter: Any, design: Design) -> None:
    """Parallel projection that holds the whole sensor in the middle part of the picture."""
    low, tall = min(design.housing.bottom_mm, 0.0), _height_mm(design)
    reach = design.housing.inner_radius_mm + design.housing.wall_mm
    elevation, azimuth = np.radians(VIEW_ELEVATION_DEG), np.radians(VIEW_AZIMUTH_DEG)
    level = np.cos(elevation)
    direction = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    focus = np.array([0.0, 0.0, low + tall / 2])
    plotter.camera.focal_point = focus
    plotter.camera.position = focus + 10 * (reach + tall) * direction
    plotter.camera.up = (0, 0, 1)
    plotter.enable_parallel_projection()
    seen_tall = tall * level + 2 * reach * np.sin(elevation)
    seen_wide = 2 * reach * HEIGHT_PX / (0.56 * WIDTH_PX)
    plotter.camera.parallel_scale = 0.54 * max(seen_tall, seen_wide)
    plotter.camera.clipping_range = (1.0, 30 * (reach + tall))
    plotter.enable_anti_aliasing("ssaa")
