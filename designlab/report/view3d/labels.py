"""The flat part of the picture: names of the parts with leaders, axes and a scale bar."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.fabrication import group_colour
from designlab.report.figures import write_figure
from designlab.report.plots import SENSING_COLOUR
from designlab.report.view3d.space import (
    CUT_HALF_ANGLE_DEG,
    HEIGHT_PX,
    VIEW_AZIMUTH_DEG,
    WIDTH_PX,
    side_by_side,
)
from designlab.sensor.design import Design
from geometries.elastomer import base_mm, inside
from geometries.leds import emitters

Point = tuple[float, float, float]
_INK = "#22252b"
_DPI = 150
_SPACING_PX = 100.0
_MARGIN_PX = 30.0


class Label(NamedTuple):
    """Text beside the picture and the point (mm) it speaks of."""

    text: str
    anchor_mm: Point
    colour: str


def labels(design: Design, *, deepest_mm: float | None) -> list[Label]:
    """Name, main figures and a visible point of every part; `deepest_mm` is the indentation, if any."""
    core, gel, housing, camera = design.gelcore, design.elastomer, design.housing, design.camera
    optics, leds = design.optics, design.leds
    x_c, y_c, z_c = camera.position_mm
    outer = housing.inner_radius_mm + housing.wall_mm
    cut = np.radians(VIEW_AZIMUTH_DEG + CUT_HALF_ANGLE_DEG)
    rim = housing.inner_radius_mm + housing.wall_mm / 2
    half_w, half_h = design.sensing_area_mm[0] / 2, design.sensing_area_mm[1] / 2
    top = gel.thickness_mm + core.height_mm
    narrowed = core.height_mm * float(np.tan(np.radians(core.draft_deg)))
    curvature = f", R {gel.radius_mm:g} mm" if gel.radius_mm else ""
    depth = "untouched" if deepest_mm is None else f"pressed {deepest_mm:.2g} mm deep"
    found = [
        Label(
            f"camera\n{camera.horizontal_fov_deg:g}° wide, at z = {z_c:g} mm",
            (x_c, y_c, z_c + camera.body_radius_mm),
            "#59616f",
        ),
        Label(
            f"housing\n{2 * outer:g} mm across, wall {housing.wall_mm:g} mm",
            (float(rim * np.cos(cut)), float(rim * np.sin(cut)), 0.7 * housing.top_mm),
            "#4a4f59",
        ),
        Label(
            f"gelcore\n{core.shape}, {optics.gelcore_material}, {core.width_mm:g} x {core.height_mm:g} mm",
            _edge(design, VIEW_AZIMUTH_DEG - 112, top, inset_mm=narrowed),
            "#2f7fa8",
        ),
        Label(
            f"gel\n{gel.shape}, {optics.elastomer_material}, {gel.thickness_mm:g} mm{curvature}",
            _edge(design, VIEW_AZIMUTH_DEG - 25, None),
            "#b8752c",
        ),
        Label(f"membrane\n{depth}", _on_membrane(design, -0.6 * half_w, -0.2 * half_h), "#6f6a61"),
        Label(
            f"sensing area\n{design.sensing_area}",
            _on_membrane(design, *design.sensing_area.ends_mm[1]),
            SENSING_COLOUR,
        ),
    ]
    faces = side_by_side(emitters(leds))
    for index, group in enumerate(leds.groups):
        count = group.count * len(group.azimuth_deg)
        plural = "s" if count > 1 else ""
        found.append(
            Label(
                f"{group.name}, {count} LED{plural}\n{group.colour}, {leds.package}",
                next(face.centre_mm for face in faces if face.group == index),
                _darkened(group_colour(group)),
            )
        )
    return found


def compose(name: str, image: NDArray[Any], found: Sequence[Label], camera: Any, path: Path) -> None:
    """Write labels into the margins beside the drawing, axes and a scale bar, and save the picture.

    Parameters
    ----------
    name : str
        Title.
    image : array, shape (HEIGHT_PX, WIDTH_PX, 3)
        The drawing.
    found : sequence of Label
        What to name.
    camera : pyvista.Camera
        Parallel camera that made the drawing.
    path : Path
        PNG file.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_PX / _DPI, HEIGHT_PX / _DPI), dpi=_DPI)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(image)
    axes.set_axis_off()
    axes.set_xlim(0, WIDTH_PX)
    axes.set_ylim(HEIGHT_PX, 0)
    project, px_per_mm = _projection(camera)
    pixels = [project(label.anchor_mm) for label in found]
    by_column = sorted(range(len(found)), key=lambda i: pixels[i][0])
    half = len(found) // 2
    for side, members in (("left", by_column[:half]), ("right", by_column[half:])):
        members = sorted(members, key=lambda i: pixels[i][1])
        rows = spread_rows([pixels[i][1] for i in members], low=0.11 * HEIGHT_PX, high=0.84 * HEIGHT_PX)
        for row, index in zip(rows, members, strict=True):
            column = _MARGIN_PX if side == "left" else WIDTH_PX - _MARGIN_PX
            _annotate(axes, found[index], pixels[index], (column, row), side)
    axes.text(_MARGIN_PX, 48, name, fontsize=16, weight="bold", va="center", color=_INK, parse_math=False)
    bar = 10 * px_per_mm
    right = WIDTH_PX - _MARGIN_PX
    axes.plot([right - bar, right], [HEIGHT_PX - 36] * 2, color=_INK, lw=3, solid_capstyle="butt")
    axes.text(right - bar / 2, HEIGHT_PX - 60, "10 mm", ha="center", va="center", fontsize=10, color=_INK)
    _draw_axes(axes, project, px_per_mm)
    write_figure(figure, path)


def _annotate(axes: Any, label: Label, pixel: Sequence[float], place: Sequence[float], side: str) -> None:
    title, _, rest = label.text.partition("\n")
    arrow = {"arrowstyle": "-", "color": label.colour, "lw": 1.1, "shrinkA": 6, "shrinkB": 0}
    box = {"boxstyle": "round,pad=0.25", "fc": "white", "ec": "none", "alpha": 0.9}
    axes.annotate(
        f"{title}\n{rest}",
        xy=pixel,
        xytext=place,
        ha=side,
        va="center",
        fontsize=10,
        linespacing=1.35,
        color=label.colour,
        arrowprops=arrow,
        bbox=box,
    )
    axes.plot(*pixel, "o", ms=5, color=label.colour, mec="white", mew=0.8)


def _draw_axes(axes: Any, project: Callable[[Point], tuple[float, float]], px_per_mm: float) -> None:
    """Triad of the sensor frame in the lower left corner."""
    origin = np.array([110.0, HEIGHT_PX - 60.0])
    zero = np.array(project((0.0, 0.0, 0.0)))
    for name, unit in (("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0)), ("z", (0.0, 0.0, 1.0))):
        step = 70.0 / px_per_mm * (np.array(project(unit)) - zero)
        axes.annotate(
            "",
            xy=origin + step,
            xytext=origin,
            arrowprops={"arrowstyle": "-|>", "color": _INK, "lw": 1.3, "shrinkA": 0},
        )
        axes.text(*(origin + 1.25 * step), name, fontsize=10, ha="center", va="center", color=_INK)


def _projection(camera: Any) -> tuple[Callable[[Point], tuple[float, float]], float]:
    """Map from a point (mm) to column and row of the picture, and pixels per mm, of a parallel camera."""
    focus = np.asarray(camera.focal_point)
    toward = np.asarray(camera.position) - focus
    toward = toward / np.linalg.norm(toward)
    right = np.cross(camera.up, toward)
    right = right / np.linalg.norm(right)
    up = np.cross(toward, right)
    scale = HEIGHT_PX / (2 * float(camera.parallel_scale))

    def project(point: Point) -> tuple[float, float]:
        offset = np.asarray(point) - focus
        return WIDTH_PX / 2 + scale * float(offset @ right), HEIGHT_PX / 2 - scale * float(offset @ up)

    return project, scale


def spread_rows(wanted: Sequence[float], *, low: float, high: float) -> list[float]:
    """Rows near the wanted ones (ascending) that keep their distance and stay within bounds."""
    rows = list(wanted)
    for index in range(len(rows)):
        rows[index] = max(rows[index], low if index == 0 else rows[index - 1] + _SPACING_PX)
    for index in reversed(range(len(rows))):
        rows[index] = min(rows[index], high if index == len(rows) - 1 else rows[index + 1] - _SPACING_PX)
    return rows


def _on_membrane(design: Design, x_mm: float, y_mm: float) -> Point:
    return x_mm, y_mm, float(np.nan_to_num(base_mm(design.elastomer, x_mm, y_mm)))


def _edge(design: Design, azimuth_deg: float, height_mm: float | None, *, inset_mm: float = 0.0) -> Point:
    """Point near the gel's outline in a direction: at a height, or in the middle of the gel's edge."""
    gel, azimuth = design.elastomer, np.radians(azimuth_deg)
    for radius in np.linspace(gel.width_mm, 0.5, 400):
        x, y = float(radius * np.cos(azimuth)), float(radius * np.sin(azimuth))
        if inside(gel, x, y):
            x, y = x * (1 - inset_mm / radius), y * (1 - inset_mm / radius)
            base = _on_membrane(design, x, y)[2]
            return x, y, base + gel.thickness_mm / 2 if height_mm is None else height_mm
    return 0.0, 0.0, gel.thickness_mm


def _darkened(colour: tuple[float, float, float]) -> str:
    r, g, b = (round(255 * 0.72 * channel) for channel in colour)
    return f"#{r:02x}{g:02x}{b:02x}"
