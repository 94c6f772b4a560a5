"""Plots of light around a ball, and what all plots share: extents in mm, labels, colours."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from designlab.core.types import Array
from designlab.measurement.light_probe.lobes import Lobe, Lobes
from designlab.measurement.light_probe.panels import Panel, Panels
from designlab.measurement.light_probe.polar import PolarMap
from designlab.report.figures import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

Extent = tuple[float, float, float, float]
BRIGHTEST_PERCENTILE = 99.5  # of all groups: the end of the colour scale
NOT_COUNTED = "#e8eaee"
SENSING_COLOUR = "#c2185b"  # outline of the sensing area
RELIEF_SHADING, RELIEF_HEIGHT = 8.0, 0.35  # heights of a relief: for its light; its box over the width
NOT_SHOWN = 0.25  # grey of directions that the ball does not show
CHANNEL_COLOURS = {"red": "#ff3b30", "r": "#ff3b30", "green": "#30d158", "g": "#30d158",
                   "blue": "#2f7bff", "b": "#2f7bff", "white": "#ffffff"}  # fmt: skip
OTHER_COLOURS = ("#ff9f0a", "#bf5af2", "#64d2ff", "#ffd60a", "#ff6482")
LABEL_GAP_DEG = 6.0  # between a lobe and its number
LABEL_REACH_DEG = 30.0  # lobes nearer than this are labelled away from each other


def extent_mm(x_mm: Array, y_mm: Array) -> Extent:
    """Edges (left, right, bottom, top) in mm of an image whose pixels see the points (x, y)."""
    half_x = float(np.median(np.diff(x_mm, axis=1))) / 2
    half_y = float(np.median(-np.diff(y_mm, axis=0))) / 2
    return (
        float(np.median(x_mm[:, 0])) - half_x,
        float(np.median(x_mm[:, -1])) + half_x,
        float(np.median(y_mm[-1])) - half_y,
        float(np.median(y_mm[0])) + half_y,
    )


def light_map(
    light: PolarMap, found: Lobes, *, traced: Panels | None = None, title: str = "Light probe"
) -> "Figure":
    """Light around the ball by direction, with its lobes numbered, and a table of them beside it.

    Parameters
    ----------
    light : PolarMap
        Incident radiance; each channel is shown in its own colour, as a share of its peak.
    found : Lobes
        Lobes of the same channels.
    traced : Panels, optional
        LED faces mirrored in closed form; the table then says how far each lobe lies from its face.
    title : str
        What the picture shows.
    """
    from matplotlib.patheffects import withStroke

    figure = new_figure(11.6, 5.8)
    left, right = figure.subfigures(1, 2, squeeze=False)[0]
    axes = left.add_subplot(projection="polar")
    colours = _channel_colours(light.names)
    peaks = np.maximum(np.nanmax(light.radiance, axis=(1, 2)), 1e-30)
    shares = np.clip(light.radiance / peaks[:, None, None], 0, 1)
    picture = np.clip(np.einsum("cnm,ck->nmk", np.nan_to_num(shares), colours), 0, 1)
    picture[np.isnan(light.radiance).all(axis=0)] = NOT_SHOWN
    half_deg = (light.polar_deg[1] - light.polar_deg[0]) / 2
    turn = np.radians(np.append(light.azimuth_deg, light.azimuth_deg[0] + 360) - half_deg)
    rings = np.append(light.polar_deg - half_deg, light.polar_deg[-1] + half_deg)
    axes.pcolormesh(turn, rings, picture, shading="flat", rasterized=True)
    axes.set_ylim(0, rings[-1])
    axes.set_yticks([30.0, 60.0, 90.0], ["30°", "60°", "90°"], color="w", fontsize=7.5)
    axes.set_rlabel_position(15.0)
    axes.set_xticks(np.radians(np.arange(0, 360, 30)))
    axes.tick_params(axis="x", labelsize=8)
    axes.grid(color="w", linewidth=0.4, alpha=0.4)
    axes.plot(np.linspace(0, 2 * np.pi, 361), np.full(361, 90.0), color="w", linewidth=1.0)
    axes.set_title(f"{title}\nradius: angle from the camera's axis, 90°: plane of the gel", fontsize=10)
    for number, lobe in enumerate(found.lobes, start=1):
        # Beside the lobe, on the side away from the others of its LED.
        near = [o for o in found.of(lobe.channel) if o is not lobe and _apart_deg(o, lobe) < LABEL_REACH_DEG]
        inward = bool(near) and lobe.polar_deg < np.mean([o.polar_deg for o in near]) - 1.0
        at = lobe.polar_deg + (-1.0 if inward else 1.0) * (lobe.width_deg[1] / 2 + LABEL_GAP_DEG)
        axes.text(
            np.radians(lobe.azimuth_deg),
            min(max(at, 3.0), rings[-1] - 3.0),
            str(number),
            color="w",
            fontsize=9,
            fontweight="bold",
            ha="center",
            va="center",
            path_effects=[withStroke(linewidth=2.5, foreground="k")],
        )
    _lobe_table(right, found, traced, colours, light.names)
    return figure


def _lobe_table(
    figure: "SubFigure", found: Lobes, traced: Panels | None, colours: Array, names: Sequence[str]
) -> None:
    axes = figure.add_subplot()
    axes.set_axis_off()
    heads = ["", "channel", "polar", "azimuth", "solid angle", "width × height"]
    rows = [
        [
            str(number),
            lobe.channel,
            f"{lobe.polar_deg:.1f}°",
            f"{lobe.azimuth_deg:.1f}°",
            f"{lobe.seen_sr:.4f} sr" + (" cut" if lobe.cut else ""),
            f"{lobe.width_deg[0]:.1f}° × {lobe.width_deg[1]:.1f}°",
        ]
        for number, lobe in enumerate(found.lobes, start=1)
    ]
    if traced is not None:
        heads.append("from its LED")
        for row, lobe in zip(rows, found.lobes, strict=True):
            own = [panel for panel in traced.panels if panel.group == lobe.channel and panel.visible > 0]
            apart = min((_apart_deg(panel, lobe) for panel in own), default=float("nan"))
            row.append(f"{apart:.2f}°")
    widths = [0.05, 0.13, 0.12, 0.13, 0.17, 0.22, 0.18][: len(heads)]
    table = axes.table(cellText=rows, colLabels=heads, colWidths=widths, loc="upper center", cellLoc="center")
    table.auto_set_font_size(False)
    table.set_fontsize(8.5)
    table.scale(1.0, 1.5)
    for (line, column), cell in table.get_celld().items():
        cell.set_edgecolor("#c8ccd4")
        cell.set_linewidth(0.5)
        if line == 0:
            cell.set_facecolor(NOT_COUNTED)
        elif column == 1:
            colour = colours[list(names).index(found.lobes[line - 1].channel)]
            cell.get_text().set_color(tuple(0.75 * colour))
            cell.get_text().set_fontweight("bold")
    axes.set_title("Lobes above half of their channel's peak" if found.threshold == 0.5 else
                   f"Lobes above {found.threshold:.0%} of their channel's peak", fontsize=10)  # fmt: skip


def _apart_deg(a: Lobe | Panel, b: Lobe) -> float:
    return float(np.degrees(np.arccos(np.clip(np.dot(a.direction, b.direction), -1.0, 1.0))))


def _channel_colours(names: Sequence[str]) -> Array:
    """RGB of every channel: by its name where it is that of a colour, else in turn."""
    from matplotlib.colors import to_rgb

    others = iter(OTHER_COLOURS * (1 + len(names) // len(OTHER_COLOURS)))
    return np.array([to_rgb(CHANNEL_COLOURS.get(name.lower()) or next(others)) for name in names])


def draw_relief(axes: Any, x_mm: Array, y_mm: Array, height_mm: Array, span_mm: tuple[float, float]) -> None:
    """Draw a surface in 3D, lit from the side, its heights stretched.

    Parameters
    ----------
    axes : Axes3D
        Where it is drawn.
    x_mm, y_mm : array, shapes (columns,) and (rows,)
        Places.
    height_mm : array, shape (rows, columns)
        Heights.
    span_mm : pair of float
        Ends of the scale of heights.
    """
    from matplotlib import colormaps
    from matplotlib.colors import LightSource

    across, along = np.meshgrid(x_mm, y_mm)
    colours = LightSource(azdeg=315, altdeg=50).shade(
        height_mm,
        cmap=colormaps["viridis"],
        vert_exag=RELIEF_SHADING,
        blend_mode="soft",
        vmin=span_mm[0],
        vmax=span_mm[1],
    )
    axes.plot_surface(
        across, along, height_mm, facecolors=colours, rstride=1, cstride=1, shade=False, antialiased=False
    )
    wide, deep = float(np.ptp(x_mm)), float(np.ptp(y_mm))
    axes.set_box_aspect((wide, deep, RELIEF_HEIGHT * max(wide, deep)))
    axes.set_zlim(*span_mm)
    axes.view_init(elev=42, azim=-60)
    axes.tick_params(labelsize=7, pad=-2)
    axes.set_xlabel("x (mm)", fontsize=8, labelpad=-4)
    axes.set_ylabel("y (mm)", fontsize=8, labelpad=-4)
    axes.set_zticks([])
    axes.set_title("Relief; heights stretched", fontsize=10)


def label_axes(axes: "Axes", title: str) -> None:
    """Title and axes in mm of a picture of the gel."""
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
