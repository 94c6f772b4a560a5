"""Measured and simulated picture and what is left between them, for each channel."""

from typing import TYPE_CHECKING

import numpy as np

from designlab.inference.calibration.result import Calibration, FrameResult
from designlab.report.figures import new_figure
from designlab.sensor.design import CHANNELS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

QUANTILE = 0.998


def residual_plot(calibration: Calibration) -> "Figure":
    """Draw the shot of which most is left: a held-out press, else one that was fitted."""
    presses = [frame for frame in calibration.frames if frame.pose is not None] or list(calibration.frames)
    shown = [frame for frame in presses if frame.held_out] or presses
    return _residual(min(shown, key=lambda frame: float(frame.after["snr_db"])))


def _residual(frame: FrameResult) -> "Figure":
    left = frame.measured - frame.simulated
    limit = float(np.quantile(np.abs(left / frame.measured.mean(axis=(0, 1))), QUANTILE)) * 100
    rows, columns = frame.measured.shape[:2]
    height = 1.2 + 3 * 3.1 * min(rows / columns, 1.2)
    figure = new_figure(11.5, height)
    axes = figure.subplots(3, 3)
    for channel, name in enumerate(CHANNELS):
        level = float(np.mean(frame.measured[..., channel]))
        top = float(np.quantile(frame.measured[..., channel], QUANTILE))
        for axis, picture, what in zip(
            axes[channel],
            (frame.measured, frame.simulated, left),
            ("measured", "calibrated", "measured − calibrated"),
            strict=True,
        ):
            residual = picture is left
            image = axis.imshow(
                100 / level * left[..., channel] if residual else picture[..., channel],
                cmap="RdBu_r" if residual else "viridis",
                vmin=-limit if residual else 0.0,
                vmax=limit if residual else top,
                interpolation="nearest",
            )
            axis.set_title(f"{name}, {what}", fontsize=10)
            axis.set_xticks([])
            axis.set_yticks([])
            if what != "measured":
                bar = figure.colorbar(image, ax=axis, shrink=0.9, extend="both" if residual else "max")
                bar.set_label(
                    "% of the channel's mean" if residual else "signal (share of full scale)", fontsize=8
                )
    figure.suptitle(
        f"{frame.file} ({'pose alone fitted' if frame.held_out else 'fitted'}): "
        f"SNR {frame.after['snr_db']:.1f} dB, structure correlation {frame.after['structure_corr']:.2f}",
        fontsize=11,
    )
    return figure
