"""The one public picture of the paper's sensor: as the published values give it, and calibrated."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from designlab.core import metrics
from designlab.core.progress import named, silent
from designlab.core.types import Progress
from designlab.measurement.compare import FIGURES, compare_model
from designlab.sensor.design import CHANNELS, preset
from designlab.validation.paper_2020.accuracy import SAMPLES, at_poses, poses_of
from designlab.validation.paper_2020.sizes import Size

MEASURED_VARIABLE = "DESIGNLAB_MEASURED"
"""Environment variable that names a folder of real pictures; without it this experiment is left out."""

SENSOR, SET = "gelsight-2020-flat", "gelsight-flat"
COLUMNS = {"full": 160, "reduced": 64}
PICTURE = "residual.png"
ROUNDING = 1e-12  # figures below are zero: the structure of a constant picture


def real(folder: str | Path, size: Size, seed: int = 1, progress: Progress = silent) -> dict[str, Any]:
    """Calibrate the preset on the real picture.

    Parameters
    ----------
    folder : path
        Where the picture of what is left goes.
    size : Size
        Its name chooses how many columns are fitted.
    seed : int
        Seed of the light transport.
    progress : callable, optional
        Called with the stage, pictures done and pictures expected in it.

    Returns
    -------
    dict
        ``frames`` with figures in full resolution before and after and of a constant picture, ``parameters``,
        ``notes`` and the ``picture`` relative to the folder; or ``left_out`` with the reason.
    """
    measured = os.environ.get(MEASURED_VARIABLE)
    if not measured:
        return {"left_out": f"left out: {MEASURED_VARIABLE} names no folder of real pictures"}
    place = Path(measured) / SET
    if not place.is_dir():
        return {"left_out": f"left out: the folder that {MEASURED_VARIABLE} names has no {SET}"}

    from designlab.inference.calibration import calibrate
    from designlab.measurement import load_measurement
    from designlab.report.calibration_pictures import residual_plot
    from designlab.report.figures import write_figure

    measurement, columns = load_measurement(place), COLUMNS[size.name]
    found = calibrate(
        measurement, preset(SENSOR), columns=columns, seed=seed, progress=named(progress, "fitting, ")
    )
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_figure(residual_plot(found), folder / PICTURE)
    models = {
        "before": (preset(SENSOR), measurement),
        "after": (found.model, at_poses(measurement, poses_of(found))),
    }
    pairs = {
        name: compare_model(
            model, own, samples=SAMPLES, seed=seed, progress=named(progress, f"comparing {name}, ")
        ).pairs
        for name, (model, own) in models.items()
    }
    frames = []
    for before, after in zip(pairs["before"], pairs["after"], strict=True):
        constant = np.broadcast_to(before.real.mean(axis=(0, 1)), before.real.shape)
        frames.append(
            {
                "file": before.file,
                "before": _figures(before.figures),
                "after": _figures(after.figures),
                "constant": _figures(metrics.compare(constant, before.real)),
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
    if not np.isfinite(value):
        return None
    return float(value) if abs(value) > ROUNDING else 0.0
