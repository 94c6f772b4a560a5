"""A set that is suspicious stops a calibration, unless what is suspicious is trusted."""

import numpy as np
import pytest

from designlab.app import cli
from designlab.inference.calibration import calibrate
from designlab.measurement import MeasurementError
from tests.helpers.spoilt_sets import COLUMNS, DESIGN, PRESSES, changed, planted


@pytest.fixture(scope="module")
def correct(tmp_path_factory):
    return planted(tmp_path_factory.mktemp("correct") / "m", presses=PRESSES[1:3])


def swapped(measurement, folder):
    return changed(measurement, folder, pictures=lambda image: image[..., ::-1])


def words(measurement, out):
    return ["calibrate", str(measurement.folder), "--model", DESIGN.name, "--out", str(out)]


@pytest.mark.renders
def test_swapped_channels_stop_the_command_with_two(correct, tmp_path, capsys):
    wrong = swapped(correct, tmp_path / "m")
    assert cli.main([*words(wrong, tmp_path / "out"), "--columns", str(COLUMNS)]) == 2
    said = capsys.readouterr().err
    assert "channels: background-red.exr" in said
    assert "suspected cause: the files' channels hold BGR" in said
    assert "remedy: " in said
    assert "--trust channels" in said
    assert not (tmp_path / "out").exists()


def test_a_saturated_picture_stops_the_command_with_two(correct, tmp_path, capsys):
    file = correct.frames[5].file
    wrong = changed(correct, tmp_path / "m", pictures=lambda image: np.minimum(9 * image, 1), files={file})
    assert cli.main(words(wrong, tmp_path / "out")) == 2
    assert f"saturated: {file}: " in capsys.readouterr().err


@pytest.mark.renders
def test_what_is_trusted_is_noted(correct, tmp_path):
    wrong = swapped(correct, tmp_path / "m")
    kept = [f for f in wrong.frames if f.kind == "background" and f.leds is None][:1]
    few = wrong.model_copy(update={"frames": tuple(kept)})
    found = calibrate(few, DESIGN, columns=COLUMNS, samples=16, free=(), trust=("channels",))
    assert any(note.startswith("trusted although channels: ") for note in found.notes)
    with pytest.raises(MeasurementError, match="channels"):
        calibrate(few, DESIGN, columns=COLUMNS, samples=16, free=())
