"""A single picture beside the models: measured, as given, corrected, and what each leaves."""

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from designlab.core.store import write_atomic
from designlab.core.types import Array
from designlab.inference.diagnosis.single_image.blocks import TRAIN, Uses
from designlab.sensor.design import CHANNELS

DOTS_PER_INCH = 110
BRIGHT, GAMMA = 99.5, 2.2
LEFT_PERCENTILE = 99.0
DIMMED = 0.8  # blocks that were fitted to, in the measured picture
NAME = "picture.png"


def draw(images: Mapping[str, Array], uses: Uses, out: Path) -> dict[Path, str]:
    """Draw the three pictures and, of each channel, measured minus simulated.

    Parameters
    ----------
    images : mapping of str to array, shape (rows, columns, 3)
        ``measured``, ``given`` and ``corrected``.
    uses : array, shape (rows, columns)
        Use of every pixel, see `blocks.block_uses`.

    Returns
    -------
    dict of Path to str
        The file and its caption.
    """
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    real = images["measured"]
    white = np.percentile(real, BRIGHT, axis=(0, 1))
    left = {name: 100 * (real - images[name]) / real.mean(axis=(0, 1)) for name in ("given", "corrected")}
    limit = float(np.percentile(np.abs(left["given"]), LEFT_PERCENTILE))
    figure, axes = pyplot.subplots(3, 3, figsize=(9.6, 9.4), layout="constrained")
    titles = {"measured": "measured", "given": "model as given", "corrected": "corrected model"}
    for axis, (name, title) in zip(axes[0], titles.items(), strict=True):
        shown = np.clip(images[name] / white, 0, 1) ** (1 / GAMMA)
        if name == "measured":
            shown = np.where((uses == TRAIN)[..., None], DIMMED * shown, shown)
        axis.imshow(shown, interpolation="nearest")
        axis.set_title(title, fontsize=10)
    for row, name in enumerate(("given", "corrected"), start=1):
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
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=DOTS_PER_INCH)
    pyplot.close(figure)
    path = write_atomic(out / NAME, buffer.getvalue())
    return {
        path: "The picture and the models, light and pose fitted; blocks darker in the measured picture "
        "were fitted to, the others judge. Below: what is left, one colour scale."
    }
