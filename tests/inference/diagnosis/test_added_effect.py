"""A new effect is one class: the one that the docs show is found without another line of the program."""

import numpy as np
import pytest

from designlab.inference.diagnosis import diagnose
from designlab.measurement import Measurement, load_measurement, write_measurement
from designlab.report.diagnosis_folder import write_diagnosis
from designlab.sensor.design import preset
from designlab.simulation.effects.model import load_model
from designlab.validation.synthetic import plant
from tests.helpers.added_effect import documented, register

DESIGN = preset("gelsight-2020-flat")
LOSS = 0.15
COLUMNS, SAMPLES, SEED = 48, 32, 20
RIVALS = ("vignetting", "colour_mixing", "black_level", "exposure_drift")

pytestmark = [pytest.mark.recovery, pytest.mark.slow, pytest.mark.renders]


def smeared(measurement: Measurement, folder) -> Measurement:
    """The set as a camera half behind a smear takes it, by the columns of the files alone."""
    (dark,) = (measurement.image(frame) for frame in measurement.frames if frame.kind == "dark")
    pictures = {}
    for frame in measurement.frames:
        picture, (left_px, _, width_px, _) = measurement.image(frame), frame.crop_px
        column_px = left_px + (np.arange(picture.shape[1]) + 0.5) * width_px / picture.shape[1]
        right = column_px > DESIGN.camera.width_px / 2
        light = picture - dark.mean()
        pictures[frame.file] = (dark.mean() + light * (1 - LOSS * right)[:, None]).astype(np.float32)
    return load_measurement(write_measurement(measurement, pictures, folder))


def test_the_effect_of_the_docs_is_found(tmp_path, monkeypatch) -> None:
    register(smear := documented("CONTRIBUTING.md", "Smear"), monkeypatch)
    options = {"kit": "small", "kit_seed": 1, "columns": COLUMNS, "unlisted": False}
    plain = load_measurement(plant(DESIGN, effects={}, out=tmp_path / "plain", seed=SEED, **options))
    report = diagnose(
        smeared(plain, tmp_path / "smeared"),
        DESIGN,
        out=tmp_path / "report",
        seed=SEED,
        catalogue=(smear.name, *RIVALS),
        columns=COLUMNS,
        samples=SAMPLES,
    )
    assert (report.verdict, [found.name for found in report.effects]) == ("named", ["smear"])
    loss = report.effects[0].parameters["loss"]
    assert loss.low < LOSS < loss.high
    assert loss.value == pytest.approx(LOSS, abs=0.01)
    final = report.gap["final"]
    assert final.before - final.after > 0.9 * (final.before - final.floor)
    write_diagnosis(report)
    assert load_model(report.model).effects[0].values == {"loss": loss.value}
