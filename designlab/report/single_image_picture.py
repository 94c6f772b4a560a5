"""A single picture beside the models: measured, as given, corrected, and what each leaves."""

from typing import TYPE_CHECKING

import numpy as np

from designlab.inference.diagnosis.result import PictureComparison
from designlab.report.figures import new_figure
from designlab.sensor.design import CHANNELS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BRIGHT, GAMMA = 99.5, 2.2
LEFT_PERCENTILE = 99.0
DIMMED = 0.8  # blocks that were fitted to, in the measured picture
CAPTION = (
    "The picture and the models, light and pose fitted; blocks darker in the measured picture were fitted "
    "to, the others judge. Below: what is left, one colour scale."
)


def models_plot(found: PictureComparison) -> "Figure":
    """Measured, as given and corrected, and of each channel what both models leave."""
    real, models = found.measured, {"given": found.given, "corrected": found.corrected}
    white = np.percentile(real, BRIGHT, axis=(0, 1))
    left = {name: 100 * (real - image) / real.mean(axis=(0, 1)) for name, image in models.items()}
    limit = float(np.percentile(np.abs(left["given"]), LEFT_PERCENTILE))
    figure = new_figure(9.6, 9.4)
    axes = figure.subplots(3, 3)
    titles = {"measured": "measured", "given": "model as given", "corrected": "corrected model"}
    for axis, (name, title) in zip(axes[0], titles.items(), strict=True):
        shown = np.clip(models.get(name, real) / white, 0, 1) ** (1 / GAMMA)
        if name == "measured":
            shown = np.where(found.fitted[..., None], DIMMED * shown, shown)
        axis.imshow(shown, interpolation="nearest")
        axis.set_title(title, fontsize=10)
    for row, name in enumerate(models, start=1):
        for channel, colour in enumerate(CHANNELS):
            image = axes[row, channel].imshow(
                left[name][..., channel], cmap="RdBu_r", vmin=-limit, vmax=limit, interpolation="nearest"
            )
            axes[row, channel].set_title(f"{colour}, {titles[name]}", fontsize=10)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    bar = figure.colorbar(image, ax=axes[1:], shrink=0.8, extend="both")
    bar.set_label("measured − simulated (% of the channel's mean)")
    return figure
