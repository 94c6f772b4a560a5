"""Files that earlier code wrote are still read; those of a later format are refused in one line.

`written_before/` and `planted/` were written by the code at commit 3016e41 (`record.py --files`). Where a
format is changed on purpose, expect here the one line that says what to do, and keep the old file.
"""

import gzip
import json
import shutil

import pytest

import designlab as dl
from designlab.app.cli import main
from designlab.inference.diagnosis import diagnose
from designlab.measurement import load_measurement
from designlab.optimization.study import load_results, load_study
from designlab.simulation.effects.model import load_model
from tests.regression import cases

WRITTEN = cases.HERE / "written_before"
STUDY_OUT = WRITTEN / "finished_study"
STARTER_STUDY = "053a7a0b7a2ab7126b99b5858d91ae81b54c3bcc30f66419b1b24ff99225685e"
COMPARED_THEN = (
    "press-04.exr",
    0.00102214324982,
)  # a frame and how far the model was from it, when the file was written


class Reached(Exception):
    """Ends a command that would take long once it has begun with its real work."""


@pytest.fixture
def study_out(tmp_path):
    """The finished study, whose record is kept compressed."""
    folder = tmp_path / "study-out"
    shutil.copytree(STUDY_OUT, folder, ignore=shutil.ignore_patterns("*.gz"))
    (folder / "study.db").write_bytes(gzip.decompress((STUDY_OUT / "study.db.gz").read_bytes()))
    return folder


@pytest.fixture
def refusal(capfd):
    """Run a command that must be refused, and return the one line that it says."""

    def runner(*words):
        capfd.readouterr()
        assert main([str(word) for word in words]) == 2
        (line,) = capfd.readouterr().err.splitlines()
        return line

    return runner


def test_a_design():
    """Its digest is what studies, caches and models know it by."""
    design = dl.load(WRITTEN / "design.toml")
    preset = json.loads((WRITTEN / "diagnosis" / "run.json").read_text())["model"]
    assert design.digest == dl.preset(cases.FLAT).digest
    assert load_model(WRITTEN / "design.toml").digest == preset


def test_a_sensor_model_with_what_was_found():
    model = load_model(WRITTEN / "diagnosis" / "model.toml")
    report = json.loads((WRITTEN / "diagnosis" / "report.json").read_text())
    found = {
        (effect["name"], name): value["value"]
        for effect in report["effects"]
        for name, value in effect["parameters"].items()
    }
    assert found
    kept = {(effect.name, name): value for effect in model.effects for name, value in effect.values.items()}
    for key, value in found.items():
        assert kept[key] == pytest.approx(value, rel=1e-5), key


def test_a_model_of_directional_light():
    found = cases.command("compare", WRITTEN / "phong.toml", cases.PLANTED)
    file, mse = COMPARED_THEN
    (same,) = [frame for frame in found["frames"] if frame["file"] == file]
    assert same["mse"] == pytest.approx(mse, rel=1e-4)  # the file keeps fewer digits


def test_a_measurement():
    measurement = load_measurement(cases.PLANTED)
    assert measurement.design().digest == dl.preset(cases.FLAT).digest
    split = {use: len(frames) for use, frames in measurement.split().items()}
    assert split == {"train": 2, "select": 2, "final": 2}
    for frame in measurement.frames:
        assert measurement.image(frame).shape == (18, 24, 3)


def test_the_starters_study_file():
    study = load_study(WRITTEN / "study.toml")
    assert study.base.digest == dl.preset(cases.FLAT).digest
    assert set(study.parameters) == {"leds.height_mm", "leds.tilt_deg"}
    assert study.digest == STARTER_STUDY


def test_a_finished_study(study_out):
    found = cases.command("study", "status", study_out)
    recorded = json.loads((cases.RECORDED / "study.json").read_text())
    assert cases.differences(found, recorded, {"": 1e-9}) == []


def test_a_finished_study_is_not_run_again(study_out):
    assert load_results(study_out).evaluated == 6
    assert cases.command("study", "run", study_out)["evaluated"] == 6


def test_a_study_whose_record_is_made_anew(study_out):
    before = cases.command("study", "status", study_out)
    after = cases.command("study", "run", study_out, "--rebuild")
    assert after["trials"]["complete"] == before["trials"]["complete"]
    assert after["pareto"] == before["pareto"]


def test_a_diagnosis_is_known_to_be_of_the_same_frames_model_and_seed(tmp_path):
    """Otherwise the same command would not go on there, but be refused."""
    folder = tmp_path / "diagnosis"
    shutil.copytree(WRITTEN / "diagnosis", folder)
    measured = load_measurement(cases.some(cases.THREE_PLACES, tmp_path / "measured"))

    def stop(*step):
        raise Reached

    with pytest.raises(Reached):
        diagnose(measured, dl.preset(cases.FLAT), out=folder, seed=0, samples=8, progress=stop)
    with pytest.raises(ValueError, match="another seed"):
        diagnose(measured, dl.preset(cases.FLAT), out=folder, seed=1, samples=8, progress=stop)


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ("study.toml", ("study", "run")),
        ("diagnosis/model.toml", ("evaluate",)),
        ("phong.toml", ("calibrate", cases.PLANTED, "--out", "out", "--model")),
    ],
)
def test_a_later_format_is_refused_in_one_line(file, words, tmp_path, refusal):
    text = (WRITTEN / file).read_text(encoding="utf-8")
    assert "version = 1" in text or "format = 2" in text
    later = tmp_path / "later.toml"
    later.write_text(text.replace("version = 1", "version = 99").replace("format = 2", "format = 99"))
    line = refusal(*words, later)
    assert "later.toml" in line
    assert "99" in line
