"""Maps of what is left between measurement and model, before and after."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from designlab.design import CHANNELS
from designlab.gap.fit import Fitter
from designlab.gap.forward import State
from designlab.gap.judge import squared
from designlab.store import write_atomic

Array = NDArray[np.float64]

SMOOTHING_PX = 0.7
DOTS_PER_INCH = 110


Stand = tuple[Fitter, State]
"""A state and the pictures it is to be combined from."""


def draw(before: Stand, after: Stand, out: Path) -> dict[Path, str]:
    """Draw the press that differs most before, of those used for nothing else, and the untouched gel.

    Returns
    -------
    dict of Path to str
        Files and their captions.
    """
    fitter, state = before
    shots = fitter.bank.shots
    final = [n for n, shot in enumerate(shots) if shot.use == "final"]
    worst = max(final, key=lambda n: squared(fitter, state, n)[0])
    untouched = [n for n, shot in enumerate(shots) if shot.press is None]
    brightest = max(untouched, key=lambda n: float(shots[n].lit.sum()))
    press = shots[worst].press
    assert press is not None
    shown = {
        "residual-press.png": (
            worst,
            f"{press.probe.text} pressed {press.depth_mm:g} mm deep, a final press",
        ),
        "residual-background.png": (brightest, "Untouched gel"),
    }
    return {
        _figure(before, after, number, out / name): (
            f"{what} ({shots[number].files[0]}): measured minus simulated. Upper row: the model as "
            "given; lower row: the updated model. One colour scale."
        )
        for name, (number, what) in shown.items()
    }


def _figure(before: Stand, after: Stand, number: int, path: Path) -> Path:
    import io

    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot
    from scipy.ndimage import gaussian_filter

    fitter, _ = before
    shot = fitter.bank.shots[number]
    level = np.array([max(float(shot.signal[..., c].mean()), 1e-9) for c in range(3)])
    maps = []
    for own, state in (before, after):
        left = np.where(shot.valid, shot.signal - own.forward.predict(state, number), 0.0)
        maps.append(100 * gaussian_filter(left, (SMOOTHING_PX, SMOOTHING_PX, 0)) / level)
    x, y = fitter.bank.of(number).seen_mm
    extent = (x.min(), x.max(), y.min(), y.max())
    limit = max(float(np.quantile(np.abs(maps[0]), 0.995)), 0.5)
    figure, axes = pyplot.subplots(2, 3, figsize=(10.5, 5.6), sharex=True, sharey=True, layout="constrained")
    for row, (title, images) in enumerate(zip(("as given", "updated"), maps, strict=True)):
        for channel, name in enumerate(CHANNELS):
            axis = axes[row, channel]
            image = axis.imshow(
                images[..., channel],
                extent=extent,
                cmap="RdBu_r",
                vmin=-limit,
                vmax=limit,
                interpolation="nearest",
            )
            axis.set_title(f"{name}, {title}", fontsize=10)
            if row == 1:
                axis.set_xlabel("x (mm)")
            if channel == 0:
                axis.set_ylabel("y (mm)")
    bar = figure.colorbar(image, ax=axes, shrink=0.9, extend="both")
    bar.set_label("measured − simulated (% of the channel's mean signal)")
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=DOTS_PER_INCH)
    pyplot.close(figure)
    return write_atomic(path, buffer.getvalue())
