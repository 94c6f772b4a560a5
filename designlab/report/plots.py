"""Plots of images, normals, heights and light for people: one scale, units, colour bars."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from designlab.core.images import tone_map
from designlab.core.types import Array
from designlab.evaluation.protocol import Reconstruction
from designlab.evaluation.weakest_point import Place
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
MOST_COLUMNS = 3  # of panels
NOT_SHOWN = 0.25  # grey of directions that the ball does not show
CHANNEL_COLOURS = {"red": "#ff3b30", "r": "#ff3b30", "green": "#30d158", "g": "#30d158",
                   "blue": "#2f7bff", "b": "#2f7bff", "white": "#ffffff"}  # fmt: skip
OTHER_COLOURS = ("#ff9f0a", "#bf5af2", "#64d2ff", "#ffd60a", "#ff6482")
LABEL_GAP_DEG = 6.0  # between a lobe and its number
LABEL_REACH_DEG = 30.0  # lobes nearer than this are labelled away from each other
CONTOUR_SMOOTHING_PX = 10.0  # contours of a noisy picture would be ragged


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


def background(signal: NDArray[Any], extent: Extent) -> "Figure":
    """Untouched gel as the camera shows it, brightened to its own white."""
    figure = new_figure(5.6, 4.2)
    axes = figure.add_subplot()
    axes.imshow(tone_map(signal), extent=extent)
    _label(axes, "Untouched gel, camera picture")
    return figure


def uniformity(groups: Mapping[str, Array], extent: Extent) -> "Figure":
    """Illumination of the untouched gel by each LED group, relative to its mean."""
    columns = min(len(groups), MOST_COLUMNS)
    rows = -(-len(groups) // columns)
    figure = new_figure(4.0 * columns + 0.6, 3.4 * rows + 0.2)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    relative = {name: image / image.mean() for name, image in groups.items()}
    brightest = float(np.percentile(np.stack(list(relative.values())), BRIGHTEST_PERCENTILE))
    for axes, (name, image) in zip(panels, relative.items(), strict=False):
        shown = axes.imshow(image, extent=extent, cmap="cividis", vmin=0, vmax=brightest)
        contours = axes.contour(
            np.flipud(gaussian_filter(image, CONTOUR_SMOOTHING_PX, mode="nearest")),
            levels=[0.5, 0.75, 1.25, 1.5],
            extent=extent,
            colors="w",
            linewidths=0.6,
        )
        axes.clabel(contours, fontsize=7, fmt="%g")
        _label(axes, f"LED group {name}")
    for axes in panels[len(groups) :]:
        axes.set_visible(False)
    figure.colorbar(shown, ax=list(panels), label="radiance / mean of the group", shrink=0.85, extend="max")
    return figure


def information(limit_deg: Array, extent: Extent, worst: Place) -> "Figure":
    """Least tilt that camera noise makes up, NaN where there is no picture, and where it is worst."""
    figure = new_figure(5.6, 4.2)
    axes = figure.add_subplot()
    told = limit_deg[np.isfinite(limit_deg)]
    top = float(np.percentile(told, BRIGHTEST_PERCENTILE)) if told.size else 1.0
    axes.set_facecolor(NOT_COUNTED)
    shown = axes.imshow(limit_deg, extent=extent, cmap="viridis", vmin=0, vmax=top)
    figure.colorbar(shown, ax=axes, label="information limit (deg)", shrink=0.85, extend="max")
    _label(axes, "Tilt that camera noise makes up")
    _mark(axes, worst, extent)
    return figure


def errors(presses: Sequence[Reconstruction], extent: Extent, worst: Place) -> "Figure":
    """Errors over all test presses: their mean at each place, and where the normals err most.

    Parameters
    ----------
    presses : sequence of Reconstruction
        The test presses.
    extent : tuple of float
        See `extent_mm`.
    worst : Place
        Where the normals err most.
    """
    error_deg = [_counted(one, one.error_deg) for one in presses]
    height_error_um = [_counted(one, 1000 * np.abs(one.height_mm - one.frame.height_mm)) for one in presses]
    figure = new_figure(10.4, 4.0)
    panels = figure.subplots(1, 2)
    for axes, maps, name, unit, least in (
        (panels[0], error_deg, "Normal error, mean of the test presses", "normal error (deg)", 5.0),
        (panels[1], height_error_um, "Height error, mean size", "height error (µm)", 20.0),
    ):
        counted = np.isfinite(maps).sum(axis=0)
        mean = np.where(counted > 0, np.nansum(maps, axis=0) / np.maximum(counted, 1), np.nan)
        top = max(float(np.nanpercentile(mean, BRIGHTEST_PERCENTILE)), least)
        axes.set_facecolor(NOT_COUNTED)
        shown = axes.imshow(mean, extent=extent, cmap="magma_r", vmin=0, vmax=top)
        figure.colorbar(shown, ax=axes, label=unit, shrink=0.85, extend="max")
        _label(axes, name)
    _mark(panels[0], worst, extent)
    return figure


def press(shown: Reconstruction, extent: Extent, mark: Place | None = None) -> "Figure":
    """One press: picture, normals and heights beside the truth, and where the normals err."""
    pressed, true_height_mm = shown.frame.press, shown.frame.height_mm
    assert pressed is not None  # every test frame has one
    figure = new_figure(12.6, 6.4)
    mechanics = shown.frame.mechanics
    depth_mm = pressed.stated_depth_mm if mechanics is None else mechanics.depth_mm
    figure.suptitle(f"{pressed.probe.text} mm pressed {depth_mm:.2f} mm deep")
    panels = figure.subplots(2, 3)
    panels[0, 0].imshow(tone_map(shown.image), extent=extent)
    _label(panels[0, 0], "Camera picture")
    for axes, field, name in (
        (panels[0, 1], shown.normals, "Normals, reconstructed"),
        (panels[0, 2], shown.true_normals, "Normals, truth"),
    ):
        axes.imshow(np.clip(field * 0.5 + 0.5, 0, 1), extent=extent)
        _label(axes, name)
    error_deg = _counted(shown, shown.error_deg)
    drawn = panels[1, 0].imshow(error_deg, extent=extent, cmap="magma_r", vmin=0, vmax=15)
    panels[1, 0].set_facecolor(NOT_COUNTED)
    figure.colorbar(drawn, ax=panels[1, 0], label="normal error (deg)", extend="max")
    _label(panels[1, 0], "Error on and around the contact")
    if mark is not None:
        _mark(panels[1, 0], mark, extent)
    top = float(true_height_mm.max())
    low = min(-0.1 * top, float(true_height_mm.min()))
    for axes, field, name in (
        (panels[1, 1], shown.height_mm, "Height, reconstructed"),
        (panels[1, 2], true_height_mm, "Height, truth"),
    ):
        drawn = axes.imshow(field, extent=extent, cmap="viridis", vmin=low, vmax=1.1 * top)
        figure.colorbar(drawn, ax=axes, label="height (mm)")
        _label(axes, name)
    return figure


def _counted(press: Reconstruction, values: Array) -> Array:
    """Values of a press, NaN where they do not count."""
    return np.where(press.region, values, np.nan)


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


def _mark(axes: "Axes", place: Place, extent: Extent) -> None:
    """Ring and reason at a place, written towards the middle of the picture."""
    left, right, bottom, top = extent
    x, y = place.x_mm, place.y_mm
    width, height = right - left, top - bottom
    for colour, line_pt in (("k", 2.6), ("w", 1.2)):
        axes.plot(x, y, "o", ms=13, mfc="none", mec=colour, mew=line_pt, clip_on=False)
    beside_x = x + (0.06 if x < (left + right) / 2 else -0.06) * width
    beside_y = y + (0.08 if y < (bottom + top) / 2 else -0.08) * height
    axes.text(
        beside_x,
        beside_y,
        f"worst: {place.reason}" if place.reason != "even" else "worst, though even",
        fontsize=8.5,
        ha="left" if x < (left + right) / 2 else "right",
        va="center",
        bbox={"boxstyle": "round,pad=0.25", "facecolor": "w", "edgecolor": "k", "linewidth": 0.6},
    )
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)


def _label(axes: "Axes", title: str) -> None:
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
