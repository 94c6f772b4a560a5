"""Pictures of a diagnosis: where the excess is, and measured, simulated and residual side by side."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from designlab.core.store import write_atomic
from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.selection.held_out import squared
from designlab.report.plots import CHANNEL_COLOURS, Extent, extent_mm
from designlab.sensor.design import CHANNELS, Design
from designlab.simulation.simulator import Frame

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

Stand = tuple[Fitter, State]
"""A state and the pictures it is to be combined from."""


def draw(before: Stand, after: Stand, frame: Callable[[int], Frame], out: Path) -> dict[Path, str]:
    """Draw the final press that differs most before, and the untouched gel.

    Parameters
    ----------
    before, after : Stand
        The model as given and the updated one; the latter is left out where nothing was added.
    frame : callable
        Geometry of a shot by its number.
    out : Path
        Folder of the pictures.

    Returns
    -------
    dict of Path to str
        Files and their captions.
    """
    fitter, state = before
    shots = fitter.bank.shots
    final = [n for n, shot in enumerate(shots) if shot.use == "final"]
    worst = max(final, key=lambda n: squared(fitter, state, n)[0])
    untouched = [n for n, shot in enumerate(shots) if shot.press is None and not shot.gel_rotation_deg]
    brightest = max(untouched, key=lambda n: float(shots[n].lit.sum()))
    press = shots[worst].press
    assert press is not None
    stands = {"as given": before} if not after[1].values else {"as given": before, "updated": after}
    chosen = {"untouched gel": brightest, "worst final press": worst}
    extent = extent_mm(*frame(brightest).seen_mm)
    found = {
        _where(stands, chosen, frame(worst).contact, extent, out / "where.png"): (
            "Where the excess is: squared residual over its floor, mean of the channels, on the sensor's "
            "own axes; "
            "black is explained. The white line is the edge of the contact; the words at the border are the "
            "LED groups."
        )
    }
    for name, number, what in (
        ("press", worst, f"{press.probe.text} pressed {press.depth_mm:g} mm deep, a final press"),
        ("background", brightest, "Untouched gel"),
    ):
        path = _compared(stands, number, extent, out / f"compared-{name}.png")
        found[path] = (
            f"{what} ({shots[number].files[0]}). Pictures share one scale, residuals another, both in "
            "percent "
            "of the channel's mean in the measurement. Grey was not compared."
        )
    return found


def _compared(stands: dict[str, Stand], number: int, extent: Extent, path: Path) -> Path:
    """Measured, simulated by each stand, and their residuals, one row a channel."""
    fitter, _ = next(iter(stands.values()))
    shot = fitter.bank.shots[number]
    level = np.array([max(float(shot.signal[..., c].mean()), 1e-9) for c in range(3)]) / 100
    pictures = {"measured": _shown(shot.signal / level, shot.valid)}
    residuals = {}
    for name, (own, state) in stands.items():
        predicted = own.forward.predict(state, number)
        pictures[f"simulated, {name}"] = _shown(predicted / level, shot.valid)
        left = gaussian_filter((shot.signal - predicted) / level, (SMOOTHING_PX, SMOOTHING_PX, 0))
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
    return _saved(figure, path)


def _where(
    stands: dict[str, Stand],
    chosen: dict[str, int],
    contact: NDArray[np.bool_],
    extent: Extent,
    path: Path,
) -> Path:
    """Excess of the squared residual over its floor, one row a stand, one column a shot."""
    from matplotlib.colors import LogNorm

    fitter = next(iter(stands.values()))[0]
    excess: dict[tuple[str, str], Array] = {
        (stand, what): _excess(own, state, number)
        for stand, (own, state) in stands.items()
        for what, number in chosen.items()
    }
    largest = max(_quantile(image, LARGEST) for image in excess.values())
    scale = LogNorm(1.0, max(largest, 10.0))
    figure = _figure(len(chosen), len(stands), extent, panel_in=3.3)
    axes = figure.subplots(len(stands), len(chosen), squeeze=False)
    for row, stand in enumerate(stands):
        for column, what in enumerate(chosen):
            axis = axes[row, column]
            _prepared(axis)
            image = axis.imshow(
                np.maximum(excess[stand, what], 1.0),
                extent=extent,
                cmap="magma",
                norm=scale,
                interpolation="nearest",
            )
            if fitter.bank.shots[chosen[what]].press is not None:
                axis.contour(contact, [0.5], colors="white", linewidths=0.8, extent=extent, origin="upper")
            if row == column == 0:
                _name_leds(axis, fitter.forward.design, extent)
            axis.set_title(f"{what}, model {stand}", fontsize=9)
            if row == len(stands) - 1:
                axis.set_xlabel("x (mm)", fontsize=8)
            if column == 0:
                axis.set_ylabel("y (mm)", fontsize=8)
    bar = figure.colorbar(image, ax=axes, shrink=0.85, extend="both")
    bar.ax.set_yticks(marks := [m for m in MARKS if m <= scale.vmax], [f"{m:g}" for m in marks])
    bar.ax.minorticks_off()
    bar.set_label("squared residual over its floor (times)", fontsize=8)
    bar.ax.tick_params(labelsize=8)
    return _saved(figure, path)


def _excess(fitter: Fitter, state: State, number: int) -> Array:
    """Smoothed squared residual over its floor, mean of the channels, NaN where nothing was compared."""
    shot, noise = fitter.bank.shots[number], fitter.noises[number]
    z = np.where(shot.valid, (shot.signal - fitter.forward.predict(state, number)) / noise.sigma, 0.0)
    granted = np.where(shot.valid, (noise.granted / noise.sigma) ** 2, 0.0)
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
    from matplotlib.figure import Figure

    shape = (extent[3] - extent[2]) / (extent[1] - extent[0])
    size = panel_in * columns + 0.9, (panel_in * shape + 0.25) * rows + 0.9
    return Figure(figsize=size, layout="compressed")


def _prepared(axis: "Axes") -> None:
    axis.set_facecolor(NOT_COMPARED)
    axis.tick_params(labelsize=7.5, color=INK)


def _shown(image: Array, valid: NDArray[np.bool_]) -> Array:
    return np.asarray(np.where(valid, image, np.nan))


def _quantile(image: Array, share: float) -> float:
    return float(np.nanquantile(image, share)) if np.isfinite(image).any() else 1.0


def _saved(figure: "Figure", path: Path) -> Path:
    import io

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DOTS_PER_INCH, bbox_inches="tight", pad_inches=0.08)
    return write_atomic(path, buffer.getvalue())
