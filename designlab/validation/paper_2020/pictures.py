"""One press as measured and as every model shows it, what is left, and where the structure agrees."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from designlab.core.images import tone_map
from designlab.measurement.compare import Pair
from designlab.report.figures import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

QUANTILE = 0.998


def models_plot(pairs: Mapping[str, Pair]) -> "Figure":
    """Draw a row for each model: its picture beside the true one, the difference, the map of SSIM.

    Differences are of the mean of the channels, on one scale for all models.
    """
    from skimage.metrics import structural_similarity

    first = next(iter(pairs.values()))
    white = float(np.percentile(first.real, 99.8))
    errors = {name: (pair.simulated - pair.real).mean(axis=-1) for name, pair in pairs.items()}
    level = float(first.real.mean())
    limit = 100 * max(float(np.quantile(np.abs(error), QUANTILE)) for error in errors.values()) / level
    figure = new_figure(13.2, 3.35 * len(pairs))
    axes = figure.subplots(len(pairs), 4)
    for row, (name, pair) in enumerate(pairs.items()):
        maps = [
            structural_similarity(
                pair.simulated[..., c], pair.real[..., c], data_range=np.ptp(pair.real[..., c]), full=True
            )[1]
            for c in range(3)
        ]
        axes[row, 0].imshow(tone_map(pair.real, white))
        axes[row, 1].imshow(tone_map(pair.simulated, white))
        error = axes[row, 2].imshow(100 * errors[name] / level, cmap="RdBu_r", vmin=-limit, vmax=limit)
        ssim = axes[row, 3].imshow(np.mean(maps, axis=0), cmap="viridis", vmin=0.0, vmax=1.0)
        figure.colorbar(error, ax=axes[row, 2], shrink=0.85, label="% of the mean")
        figure.colorbar(ssim, ax=axes[row, 3], shrink=0.85)
        figures = pair.figures
        titles = (
            "true sensor",
            f"{name}\nSNR {figures['snr_db']:.1f} dB",
            f"model − true\nstructure corr. {figures['structure_corr']:.2f}",
            f"SSIM map\nmean {figures['ssim']:.2f}",
        )
        for axis, title in zip(axes[row], titles, strict=True):
            axis.set_title(title, fontsize=10)
            axis.set_xticks([])
            axis.set_yticks([])
    figure.suptitle(f"{first.file}, not fitted", fontsize=11)
    return figure
