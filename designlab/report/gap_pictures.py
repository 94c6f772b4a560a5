"""Plots of a diagnosis: where the excess is, and measured, simulated and residual side by side."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import gaussian_filter

from designlab.core.types import Array, Mask
from designlab.inference.diagnosis.result import PressComparison, ShotComparison
from designlab.report.figures import new_figure
from designlab.report.plots import CHANNEL_COLOURS, Extent, extent_mm
from designlab.sensor.design import CHANNELS, Design

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


SMOOTHING_PX = 0.7
DOTS_PER_INCH = 140
PANEL_IN = 1.95  # width of one picture
NOT_COMPARED = "#b6bdc8"
BRIGHTEST, LARGEST = 0.995, 0.995  # quantiles that end the colour scales
LEAST_LIMIT = 0.5  # percent, end of the scale of residuals
INK = "#1c2330"
MARKS = tuple(m * 10**power for power in range(6) for m in (1, 2, 5))

EXCESS = (
    "Where the excess is: squared residual over its floor, mean of the channels, on the sensor's own axes; "
    "black is explained. The white line is the edge of the contact; the words at the border are the LED "
    "groups."
)
RESIDUAL = (
    "{what} ({file}). Pictures share one scale, residuals another, both in percent of the channel's mean in "
    "the measurement. Grey was not compared."
)


def plots(found: PressComparison) -> Iterator[tuple[str, "Figure", str]]:
    """Names of files, figures and captions: where the excess is, and the two shots beside the models."""
    yield "where.png", excess_plot(found), EXCESS
    extent = extent_mm(found.x_mm, found.y_mm)
    press = found.press.shot.press
    assert press is not None
    for name, shown, what in (
        (
            "press",
            found.press,
            f"{press.probe.text} pressed {press.stated_depth_mm:g} mm deep, a final press",
        ),
        ("background", found.untouched, "Untouched gel"),
    ):
        caption = RESIDUAL.format(what=what, file=shown.shot.files[0])
        yield f"compared-{name}.png", residual_plot(shown, extent), caption


def residual_plot(shown: ShotComparison, extent: Extent) -> "Figure":
    """Measured, as each model shows it, and their residuals, one row a channel.

    Parameters
    ----------
    shown : ShotComparison
        The shot; the scale of the residuals is that of the model as given.
    extent : tuple of float
        See `plots.extent_mm`.
    """
    shot = shown.shot
    level = np.array([max(float(shot.signal[..., c].mean()), 1e-9) for c in range(3)]) / 100
    pictures = {"measured": _shown(shot.signal / level, shot.valid)}
    residuals = {}
    for name, predicted in shown.predictions.items():
        pictures[f"simulated, {name}"] = _shown(predicted.signal / level, shot.valid)
        left = gaussian_filter((shot.signal - predicted.signal) / level, (SMOOTHING_PX, SMOOTHING_PX, 0))
        residuals[f"residual, {name}"] = _shown(left, shot.valid)
    brightest = max(_quantile(image, BRIGHTEST) for image in pictures.values())
    limit = max(_quantile(np.abs(residuals["residual, as given"]), LARGEST), LEAST_LIMIT)
    columns = len(pictures) + len(residuals)
    figure = _figure(columns, 3, extent)
    axes = figure.subplots(3, columns, sharex=True, sharey=True, squeeze=False)
    scales: dict[str, dict[str, Any]] = {
        "pictures": {"cmap": "viridis", "vmin": 0.0, "vmax": brightest},
        "residuals": {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit},
    }
    kinds = ["pictures"] * len(pictures) + ["residuals"] * len(residuals)
    drawn = {}
    for column, ((title, image), kind) in enumerate(
        zip({**pictures, **residuals}.items(), kinds, strict=True)
    ):
        axes[0, column].set_title(title.replace(", ", ",\n"), fontsize=9)
        axes[2, column].set_xlabel("x (mm)", fontsize=8)
        for channel in range(3):
            axis = axes[channel, column]
            _prepared(axis)
            drawn[kind] = axis.imshow(
                image[..., channel], extent=extent, interpolation="nearest", **scales[kind]
            )
    for channel, name in enumerate(CHANNELS):
        axes[channel, 0].set_ylabel(f"channel {name}\ny (mm)", fontsize=8)
    words = {"pictures": "signal (%)", "residuals": "measured − simulated (%)"}
    for kind, first, last in (
        ("pictures", 0, len(pictures)),
        ("residuals", len(pictures), columns),
    ):
        bar = figure.colorbar(
            drawn[kind],
            ax=axes[:, first:last],
            location="bottom",
            shrink=0.8,
            aspect=35,
            pad=0.02,
            extend="max" if kind == "pictures" else "both",
        )
        bar.set_label(words[kind], fontsize=8)
        bar.ax.tick_params(labelsize=8)
    return figure


def excess_plot(found: PressComparison) -> "Figure":
    """Excess of the squared residual over its floor, one row a model, one column a shot."""
    from matplotlib.colors import LogNorm

    shots = {"untouched gel": found.untouched, "worst final press": found.press}
    models = list(found.untouched.predictions)
    extent = extent_mm(found.x_mm, found.y_mm)
    excess = {(model, what): _excess(shown, model) for model in models for what, shown in shots.items()}
    largest = max(_quantile(image, LARGEST) for image in excess.values())
    scale = LogNorm(1.0, max(largest, 10.0))
    figure = _figure(len(shots), len(models), extent, panel_in=3.3)
    axes = figure.subplots(len(models), len(shots), squeeze=False)
    for row, model in enumerate(models):
        for column, (what, shown) in enumerate(shots.items()):
            axis = axes[row, column]
            _prepared(axis)
            image = axis.imshow(
                np.maximum(excess[model, what], 1.0),
                extent=extent,
                cmap="magma",
                norm=scale,
                interpolation="nearest",
            )
            if shown.shot.press is not None:
                axis.contour(
                    found.contact, [0.5], colors="white", linewidths=0.8, extent=extent, origin="upper"
                )
            if row == column == 0:
                _name_leds(axis, found.design, extent)
            axis.set_title(f"{what}, model {model}", fontsize=9)
            if row == len(models) - 1:
                axis.set_xlabel("x (mm)", fontsize=8)
            if column == 0:
                axis.set_ylabel("y (mm)", fontsize=8)
    bar = figure.colorbar(image, ax=axes, shrink=0.85, extend="both")
    bar.ax.set_yticks(marks := [m for m in MARKS if m <= scale.vmax], [f"{m:g}" for m in marks])
    bar.ax.minorticks_off()
    bar.set_label("squared residual over its floor (times)", fontsize=8)
    bar.ax.tick_params(labelsize=8)
    return figure


def _excess(shown: ShotComparison, model: str) -> Array:
    """Smoothed squared residual over its floor, mean of the channels, NaN where nothing was compared."""
    shot, predicted = shown.shot, shown.predictions[model]
    z = np.where(shot.valid, (shot.signal - predicted.signal) / predicted.sigma, 0.0)
    granted = np.where(shot.valid, (predicted.granted / predicted.sigma) ** 2, 0.0)
    sums = [gaussian_filter(values.sum(axis=-1), SMOOTHING_PX) for values in (z**2, granted)]
    ratio = sums[0] / np.maximum(sums[1], 1e-12)
    return np.asarray(np.where(shot.valid.any(axis=-1), ratio, np.nan))


def _name_leds(axis: "Axes", design: Design, extent: Extent) -> None:
    """Name every LED group at the border it shines from."""
    left, right, bottom, top = extent
    middle, half = ((left + right) / 2, (bottom + top) / 2), ((right - left) / 2, (top - bottom) / 2)
    for group in design.leds.groups:
        for azimuth in np.radians(np.atleast_1d(group.azimuth_deg)):
            way = np.array([np.cos(azimuth), np.sin(azimuth)])
            reach = 0.88 * min(h / abs(w) for h, w in zip(half, way, strict=True) if abs(w) > 1e-9)
            axis.text(
                middle[0] + reach * way[0],
                middle[1] + reach * way[1],
                group.name,
                color="white",
                fontsize=7.5,
                ha="center",
                va="center",
                bbox={
                    "boxstyle": "round,pad=0.2",
                    "facecolor": "#1c2330cc",
                    "edgecolor": CHANNEL_COLOURS.get(group.name.lower(), "#ffffff"),
                    "linewidth": 1.0,
                },
            )


def _figure(columns: int, rows: int, extent: Extent, *, panel_in: float = PANEL_IN) -> "Figure":
    shape = (extent[3] - extent[2]) / (extent[1] - extent[0])
    width_in, height_in = panel_in * columns + 0.9, (panel_in * shape + 0.25) * rows + 0.9
    return new_figure(width_in, height_in, layout="compressed", dots_per_inch=DOTS_PER_INCH)


def _prepared(axis: "Axes") -> None:
    axis.set_facecolor(NOT_COMPARED)
    axis.tick_params(labelsize=7.5, color=INK)


def _shown(image: Array, valid: Mask) -> Array:
    return np.asarray(np.where(valid, image, np.nan))


def _quantile(image: Array, share: float) -> float:
    return float(np.nanquantile(image, share)) if np.isfinite(image).any() else 1.0
