"""Plots of an evaluation: untouched gel, light, information limit, errors, and each press with its relief."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from designlab.core.images import tone_map
from designlab.core.types import Array, Mask
from designlab.evaluation.protocol import Reconstruction
from designlab.evaluation.response_maps import counted_at, sensing_area
from designlab.evaluation.score import Evaluation
from designlab.evaluation.weakest_point import Place
from designlab.report.figures import new_figure
from designlab.report.plots import (
    BRIGHTEST_PERCENTILE,
    NOT_COUNTED,
    SENSING_COLOUR,
    Extent,
    draw_relief,
    extent_mm,
    label_axes,
)
from designlab.simulation.simulator import metered

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_COLUMNS = 3  # of panels
CONTOUR_SMOOTHING_PX = 10.0  # contours of a noisy picture would be ragged
LEAST_ERROR_DEG, LEAST_ERROR_UM = 5.0, 20.0  # ends of the scales of errors are not below
PRESS_ERROR_DEG = 15.0  # end of the scale of one press, the same for all
RELIEF_COLUMNS = 70  # of the surface drawn
RELIEF_REACH = 1.6  # of the contact's extent around its middle that is drawn
KEY_DEG = 60.0  # slope at the rim of the colour key


class Scale(NamedTuple):
    """Upper ends of the scales of pictures; designs that are compared share them.

    Parameters
    ----------
    signal : float
        Signal shown as white.
    share : float
        Light of an LED group over its mean.
    limit_deg, error_deg, height_error_um : float
        Information limit, and errors of normals and heights.
    """

    signal: float
    share: float
    limit_deg: float
    error_deg: float
    height_error_um: float

    @classmethod
    def of(cls, *found: Evaluation) -> "Scale":
        """The scale that holds all of several evaluations."""
        each = [
            cls(
                float(np.percentile(one.untouched.mixed * one.exposure, 99.9)) or 1.0,
                _top(np.stack(list(shares(one).values()))),
                _top(limits_deg(one)),
                max(_top(mean_errors(one.presses)[0]), LEAST_ERROR_DEG),
                max(_top(mean_errors(one.presses)[1]), LEAST_ERROR_UM),
            )
            for one in found
        ]
        return cls(*(max(values) for values in zip(*each, strict=True)))


def figures(found: Evaluation, scale: Scale | None = None) -> dict[str, "Figure"]:
    """Figures of an evaluation by the names of their files.

    Parameters
    ----------
    found : Evaluation
        What is drawn.
    scale : Scale, optional
        Ends of the scales; those that suit this evaluation when absent.
    """
    scale = scale or Scale.of(found)
    untouched, worst = found.untouched, found.score.worst
    extent = extent_mm(*counted_at(found.design, untouched))
    drawn = {
        "background.png": background(untouched.mixed * found.exposure, extent, scale.signal),
        "uniformity.png": uniformity(shares(found), extent, scale.share),
        "information.png": information(limits_deg(found), extent, scale.limit_deg, worst["gel"]),
        "errors.png": errors(found.presses, extent, scale, worst["press"]),
    }
    if found.design.sensing_area_shape != "rectangle":  # which fills the picture
        area = sensing_area(found.design, untouched)
        for figure in drawn.values():
            _outline(figure, area, extent)
    if found.presses:
        hardest = worst["press"].press
        drawn["relief.png"] = felt(found.presses[hardest or 0], extent)
    for number, one in enumerate(found.presses):
        assert one.frame.press is not None  # every test frame has one
        mark = worst["press"] if worst["press"].press == number else None
        drawn[f"press-{number + 1:02d}-{one.frame.press.probe.kind}.png"] = press(one, extent, mark)
    return drawn


def shares(found: Evaluation) -> dict[str, Array]:
    """Light of each LED group on the untouched gel over its mean where the camera meters it."""
    area = metered(found.design, found.untouched)
    return {
        name: image / (image if area is None else image[area]).mean()
        for name, image in zip(found.design.group_names, found.untouched.basis, strict=True)
    }


def limits_deg(found: Evaluation) -> Array:
    """Information limit of each pixel in deg, NaN where there is no picture."""
    return np.where(found.gel.seen & ~found.gel.saturated, found.gel.limit_deg, np.nan)


def mean_errors(presses: Sequence[Reconstruction]) -> tuple[Array, Array]:
    """Mean size of the errors of normals (deg) and heights (um) at each place, NaN where no press counts."""
    normals = [_counted(one, one.error_deg) for one in presses]
    heights = [_counted(one, 1000 * np.abs(one.height_mm - one.frame.height_mm)) for one in presses]
    number = np.isfinite(normals).sum(axis=0)
    deg, um = (
        np.where(number > 0, np.nansum(maps, axis=0) / np.maximum(number, 1), np.nan)
        for maps in (normals, heights)
    )
    return deg, um


def background(signal: NDArray[Any], extent: Extent, white: float) -> "Figure":
    """Untouched gel as the camera shows it, brightened until `white` is white."""
    figure = new_figure(5.6, 4.2)
    axes = figure.add_subplot()
    axes.imshow(tone_map(signal, white), extent=extent)
    label_axes(axes, "Untouched gel, camera picture")
    return figure


def uniformity(groups: Mapping[str, Array], extent: Extent, top: float) -> "Figure":
    """Illumination of the untouched gel by each LED group, relative to its mean, see `shares`."""
    columns = min(len(groups), MOST_COLUMNS)
    rows = -(-len(groups) // columns)
    figure = new_figure(4.0 * columns + 0.6, 3.4 * rows + 0.2)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, (name, share) in zip(panels, groups.items(), strict=False):
        shown = axes.imshow(share, extent=extent, cmap="cividis", vmin=0, vmax=top)
        contours = axes.contour(
            np.flipud(gaussian_filter(share, CONTOUR_SMOOTHING_PX, mode="nearest")),
            levels=[0.5, 0.75, 1.25, 1.5],
            extent=extent,
            colors="w",
            linewidths=0.6,
        )
        axes.clabel(contours, fontsize=7, fmt="%g")
        label_axes(axes, f"LED group {name}")
    for axes in panels[len(groups) :]:
        axes.set_visible(False)
    figure.colorbar(shown, ax=list(panels), label="radiance / mean of the group", shrink=0.85, extend="max")
    return figure


def information(limit_deg: Array, extent: Extent, top: float, worst: Place) -> "Figure":
    """Least tilt that camera noise makes up, NaN where there is no picture, and where it is worst."""
    figure = new_figure(5.6, 4.2)
    axes = figure.add_subplot()
    axes.set_facecolor(NOT_COUNTED)
    shown = axes.imshow(limit_deg, extent=extent, cmap="viridis", vmin=0, vmax=top)
    figure.colorbar(shown, ax=axes, label="information limit (deg)", shrink=0.85, extend="max")
    label_axes(axes, "Tilt that camera noise makes up")
    _mark(axes, worst, extent)
    return figure


def errors(presses: Sequence[Reconstruction], extent: Extent, scale: Scale, worst: Place) -> "Figure":
    """Errors over all test presses: their mean at each place, and where the normals err most."""
    deg, um = mean_errors(presses)
    figure = new_figure(10.4, 4.0)
    panels = figure.subplots(1, 2)
    for axes, mean, name, unit, top in (
        (panels[0], deg, "Normal error, mean of the test presses", "normal error (deg)", scale.error_deg),
        (panels[1], um, "Height error, mean size", "height error (µm)", scale.height_error_um),
    ):
        axes.set_facecolor(NOT_COUNTED)
        shown = axes.imshow(mean, extent=extent, cmap="magma_r", vmin=0, vmax=top)
        figure.colorbar(shown, ax=axes, label=unit, shrink=0.85, extend="max")
        label_axes(axes, name)
    _mark(panels[0], worst, extent)
    return figure


def press(shown: Reconstruction, extent: Extent, mark: Place | None = None) -> "Figure":
    """One press: picture, normals, errors, and the surface as map, relief and profile beside the truth."""
    pressed = shown.frame.press
    assert pressed is not None  # every test frame has one
    figure = new_figure(16.0, 6.6)
    mechanics = shown.frame.mechanics
    depth_mm = pressed.stated_depth_mm if mechanics is None else mechanics.depth_mm
    figure.suptitle(f"{pressed.probe.text} mm pressed {depth_mm:.2f} mm deep")
    grid = figure.add_gridspec(2, 4, width_ratios=[1.0, 1.1, 1.1, 1.0])
    picture = figure.add_subplot(grid[0, 0])
    picture.imshow(tone_map(shown.image), extent=extent)
    label_axes(picture, "Camera picture")
    for place, field, name in (
        (grid[0, 1], shown.normals, "Normals, reconstructed"),
        (grid[0, 2], shown.true_normals, "Normals, truth"),
    ):
        axes = figure.add_subplot(place)
        axes.imshow(normal_colours(field), extent=extent)
        label_axes(axes, name)
    normals_key(figure.add_subplot(grid[0, 3]))
    wrong = figure.add_subplot(grid[1, 0])
    drawn = wrong.imshow(
        _counted(shown, shown.error_deg), extent=extent, cmap="magma_r", vmin=0, vmax=PRESS_ERROR_DEG
    )
    wrong.set_facecolor(NOT_COUNTED)
    figure.colorbar(drawn, ax=wrong, label="normal error (deg)", extend="max", shrink=0.8)
    label_axes(wrong, "Error on and around the contact")
    if mark is not None:
        _mark(wrong, mark, extent)
    truth_mm = shown.frame.height_mm
    top = 1.1 * float(truth_mm.max())
    low = min(-0.1 * top, float(truth_mm.min()))
    height = figure.add_subplot(grid[1, 1])
    drawn = height.imshow(shown.height_mm, extent=extent, cmap="viridis", vmin=low, vmax=top)
    figure.colorbar(drawn, ax=height, label="height (mm)", shrink=0.8)
    label_axes(height, "Height, reconstructed; the line is the profile's")
    ends = profile_line(pressed.centre_mm, pressed.yaw_deg, extent)
    height.plot(*ends, color="w", linewidth=1.0, linestyle="--")
    relief(figure.add_subplot(grid[1, 2], projection="3d"), shown, extent, (low, top))
    profile(figure.add_subplot(grid[1, 3]), shown, extent, ends)
    return figure


def felt(shown: Reconstruction, extent: Extent) -> "Figure":
    """What the sensor feels of one press: its picture, the relief found from it, and a profile."""
    pressed = shown.frame.press
    assert pressed is not None
    figure = new_figure(7.4, 6.0)
    grid = figure.add_gridspec(2, 2, height_ratios=[1.25, 1.0])
    picture = figure.add_subplot(grid[0, 0])
    picture.imshow(tone_map(shown.image), extent=extent)
    label_axes(picture, f"Camera picture of {pressed.probe.text} mm")
    ends = profile_line(pressed.centre_mm, pressed.yaw_deg, extent)
    picture.plot(*ends, color="w", linewidth=1.0, linestyle="--")
    picture.set_xlim(extent[:2])
    picture.set_ylim(extent[2:])
    top = 1.1 * float(shown.frame.height_mm.max())
    low = min(-0.1 * top, float(shown.frame.height_mm.min()))
    relief(figure.add_subplot(grid[0, 1], projection="3d"), shown, extent, (low, top))
    profile(figure.add_subplot(grid[1, :]), shown, extent, ends)
    return figure


def normal_colours(normals: Array) -> Array:
    """Colours of unit normals: red grows with x, green with y, blue with z."""
    return np.clip(normals * 0.5 + 0.5, 0, 1)


def normals_key(axes: "Axes") -> None:
    """Draw which colour stands for which slope: a ball seen from above, out to `KEY_DEG`."""
    across = np.linspace(-1, 1, 201) * np.sin(np.radians(KEY_DEG))
    x, y = np.meshgrid(across, -across)
    z = np.sqrt(np.clip(1 - x**2 - y**2, 0, 1))
    colours = normal_colours(np.stack([x, y, z], axis=-1))
    inside = x**2 + y**2 <= np.sin(np.radians(KEY_DEG)) ** 2
    reach = float(across[-1])
    axes.imshow(np.where(inside[..., None], colours, 1.0), extent=(-reach, reach, -reach, reach))
    turn = np.linspace(0, 2 * np.pi, 181)
    for slope in (30.0, KEY_DEG):
        r = np.sin(np.radians(slope))
        axes.plot(r * np.cos(turn), r * np.sin(turn), color="w" if slope < KEY_DEG else "k", linewidth=0.7)
        axes.text(0, -r + 0.03, f"{slope:g}°", ha="center", va="bottom", fontsize=8, color="k")
    axes.text(0, 0, "flat", ha="center", va="center", fontsize=8)
    for x_at, y_at, text in ((reach, 0, "+x"), (0, reach, "+y")):
        axes.annotate(text, (x_at, y_at), (1.18 * x_at, 1.18 * y_at), ha="center", va="center", fontsize=9)
    axes.set_xlim(-1.3 * reach, 1.3 * reach)
    axes.set_ylim(-1.3 * reach, 1.3 * reach)
    axes.set_axis_off()
    axes.set_title("Colours of normals: where they point, and slope", fontsize=10)


def relief(axes: Any, shown: Reconstruction, extent: Extent, span_mm: tuple[float, float]) -> None:
    """Draw the reconstructed surface around the contact, lit from the side, its heights not to scale."""
    rows, columns = shown.height_mm.shape
    x = np.linspace(extent[0], extent[1], columns)
    y = np.linspace(extent[3], extent[2], rows)
    inside_x, inside_y = np.flatnonzero(shown.region.any(axis=0)), np.flatnonzero(shown.region.any(axis=1))
    part = tuple(slice(*_around(inside, count)) for inside, count in ((inside_y, rows), (inside_x, columns)))
    step = max(1, (part[1].stop - part[1].start) // RELIEF_COLUMNS)
    chosen = slice(part[0].start, part[0].stop, step), slice(part[1].start, part[1].stop, step)
    draw_relief(axes, x[chosen[1]], y[chosen[0]], shown.height_mm[chosen], span_mm)


def profile(axes: "Axes", shown: Reconstruction, extent: Extent, ends: tuple[Array, Array]) -> None:
    """Draw heights along a line, reconstructed and true."""
    rows, columns = shown.height_mm.shape
    x, y = (np.linspace(a, b, 4 * columns) for a, b in ends)
    places = (
        (extent[3] - y) / (extent[3] - extent[2]) * rows - 0.5,
        (x - extent[0]) / (extent[1] - extent[0]) * columns - 0.5,
    )
    along = np.hypot(x - x[0], y - y[0])
    along -= along[-1] / 2
    for field, name, colour, width in (
        (shown.frame.height_mm, "truth", "#a3adbb", 2.6),
        (shown.height_mm, "reconstructed", "#d1541e", 1.3),
    ):
        heights = map_coordinates(field, places, order=1, mode="nearest")
        axes.plot(along, heights, label=name, color=colour, linewidth=width)
    axes.legend(fontsize=8, frameon=False)
    axes.set_xlabel("along the line (mm)")
    axes.set_ylabel("height (mm)")
    axes.grid(color="#e2e6ec", linewidth=0.6)
    axes.set_title("Profile through the probe's middle", fontsize=10)


def profile_line(centre_mm: tuple[float, float], yaw_deg: float, extent: Extent) -> tuple[Array, Array]:
    """Ends (x, y) in mm of the line through a probe's middle along its own x, within the picture."""
    direction = np.array([np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))])
    low, high = np.array([extent[0], extent[2]]), np.array([extent[1], extent[3]])
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.stack([(low - centre_mm) / direction, (high - centre_mm) / direction])
    begin = float(np.nanmax(np.min(ways, axis=0)))
    end = float(np.nanmin(np.max(ways, axis=0)))
    points = np.array([centre_mm + begin * direction, centre_mm + end * direction])
    return points[:, 0], points[:, 1]


def _around(inside: NDArray[np.int_], count: int) -> tuple[int, int]:
    """First and last index, and one more, of what is drawn around the contact."""
    if not inside.size:
        return 0, count
    middle, half = (inside[0] + inside[-1]) / 2, RELIEF_REACH * max(inside[-1] - inside[0], 4) / 2
    return max(0, int(middle - half)), min(count, int(middle + half) + 1)


def _top(values: Array) -> float:
    """End of a colour scale: most of the finite values lie below."""
    told = values[np.isfinite(values)]
    return float(np.percentile(told, BRIGHTEST_PERCENTILE)) if told.size else 1.0


def _counted(press: Reconstruction, values: Array) -> Array:
    """Values of a press, NaN where they do not count."""
    return np.where(press.region, values, np.nan)


def _outline(figure: "Figure", area: Mask, extent: Extent) -> None:
    """Outline of the sensing area in every picture of a figure."""
    for axes in figure.axes:
        if axes.images:
            axes.contour(np.flipud(area), levels=[0.5], extent=extent, colors=SENSING_COLOUR, linewidths=1.4)


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
