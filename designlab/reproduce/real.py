"""The one public picture of the paper's sensor: as the published values give it, and calibrated."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from designlab import metrics
from designlab.compare import FIGURES
from designlab.design import CHANNELS, preset
from designlab.reproduce.sizes import Size

MEASURED_VARIABLE = "DESIGNLAB_MEASURED"
"""Environment variable that names a folder of real pictures; without it this experiment is left out."""

SENSOR, SET = "gelsight-2020-flat", "gelsight-flat"
COLUMNS = {"full": 160, "reduced": 64}
PICTURE = "residual.png"

Progress = Callable[[str, int, int], None]


def real(
    folder: str | Path, *, size: Size, seed: int = 1, progress: Progress | None = None
) -> dict[str, Any]:
    """Calibrate the preset on the real picture.

    Parameters
    ----------
    folder : path
        Where the picture of what is left goes.
    size : Size
        Its name chooses how many columns are compared.
    seed : int
        Seed of the light transport.
    progress : callable, optional
        Called with the stage, pictures done and pictures expected in it.

    Returns
    -------
    dict
        ``frames`` with figures before and after and of a constant picture, ``parameters``, ``notes`` and the
        ``picture`` relative to the folder; or ``left_out`` with the reason.
    """
    named = os.environ.get(MEASURED_VARIABLE)
    if not named:
        return {"left_out": f"left out: {MEASURED_VARIABLE} names no folder of real pictures"}
    place = Path(named) / SET
    if not place.is_dir():
        return {"left_out": f"left out: the folder that {MEASURED_VARIABLE} names has no {SET}"}

    from designlab.calibrate import calibrate
    from designlab.calibrate.pictures import draw
    from designlab.measurement import load_measurement

    columns = COLUMNS[size.name]
    found = calibrate(load_measurement(place), preset(SENSOR), columns=columns, seed=seed, progress=progress)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    draw(found, folder / PICTURE)
    frames = []
    for frame in found.frames:
        constant = np.broadcast_to(frame.measured.mean(axis=(0, 1)), frame.measured.shape)
        frames.append(
            {
                "file": frame.file,
                "use": frame.use,
                "before": _figures(frame.before),
                "after": _figures(frame.after),
                "constant": _figures(metrics.compare(constant, frame.measured)),
            }
        )
    data = found.to_json()
    return {
        "columns": columns,
        "frames": frames,
        "parameters": data["parameters"],
        "notes": data["notes"],
        "picture": PICTURE,
    }


def _figures(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of all channels together and of each; None where one has no value."""
    whole: dict[str, Any] = {name: _finite(figures[name]) for name in FIGURES}
    whole["channels"] = {
        channel: {name: _finite(figures["channels"][channel][name]) for name in FIGURES}
        for channel in CHANNELS
    }
    return whole


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
