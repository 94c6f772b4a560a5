"""A diagnosis that is killed at any moment goes on where it was, and no report of it is half-written."""

import json
import shutil
import signal
import time

import numpy as np
import pytest

from designlab.inference.diagnosis import diagnose
from designlab.measurement import load_measurement
from designlab.report.diagnosis_folder import write_diagnosis
from designlab.sensor.design import preset
from designlab.validation.synthetic import plant
from tests.helpers.processes import until
from tests.helpers.told import Told

pytestmark = [pytest.mark.faults, pytest.mark.renders]

DESIGN = preset("gelsight-2020-flat")
SEED = 3
SETTINGS = {"catalogue": ("vignetting",), "columns": 16, "samples": 4}
PRESSES = [
    {"probe": "sphere:4", "depth_mm": 0.4, "centre_mm": place, "yaw_deg": 0.0}
    for place in ((-4.0, -3.0), (4.0, -2.0), (0.0, 3.0))
]

PROGRAM = """
import json, sys, time
from pathlib import Path
from designlab.report import diagnosis_folder
from designlab.sensor.design import preset
from designlab.inference.diagnosis import diagnose
from designlab.measurement import load_measurement

def wait(content, page):
    time.sleep(600)

def show(stage, done, total):
    print(stage, done, flush=True)

if __name__ == "__main__":
    measurement, design, out, seed, settings, hang = sys.argv[1:]
    if hang == "hang":
        diagnosis_folder.gap_report = wait
    found = diagnose(
        load_measurement(measurement), preset(design), out=out, seed=int(seed), progress=show,
        **json.loads(settings),
    )
    page = Path(out) / "report.html" if hang else None
    diagnosis_folder.write_diagnosis(found, pictures=False, page=page)
"""


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A small set with a hidden effect."""
    folder = tmp_path_factory.mktemp("kill") / "measurement"
    hidden = {"vignetting": {"corner_loss": 0.3}}
    return plant(DESIGN, effects=hidden, out=folder, seed=SEED, kit="small", presses=PRESSES, columns=16)


@pytest.fixture(scope="module")
def told():
    """What a run tells that nothing interrupted."""
    return Told()


@pytest.fixture(scope="module")
def whole(measured, told):
    """Report of a run that nothing interrupted, and what it leaves in its folder."""
    out = measured.with_name("whole")
    found = diagnose(load_measurement(measured), DESIGN, out=out, seed=SEED, progress=told, **SETTINGS)
    write_diagnosis(found, pictures=False)
    return contents(out), pictures(out)


@pytest.fixture
def start(measured, processes):
    """Start the diagnosis in a process of its own."""

    def starter(out, *, hang=False):
        return processes.start(measured, DESIGN.name, out, SEED, json.dumps(SETTINGS), "hang" if hang else "")

    return starter


def contents(out):
    """The report without what says how it came about."""
    report = json.loads((out / "report.json").read_text())
    for name in ("seconds", "rendered"):
        del report["provenance"][name]
    for candidate in report["candidates"]:
        candidate.pop("seconds", None)
    return json.loads(json.dumps(report).replace(str(out), "OUT"))


def assert_alike(one, other):
    """Same but for the rounding of sums, the order of which threads decide.

    Fits end where a step changes little, so their values agree to that, not to the last digits of the sums.
    """
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_alike(one[key], other[key])
    elif isinstance(one, list):
        assert len(one) == len(other)
        for mine, theirs in zip(one, other, strict=True):
            assert_alike(mine, theirs)
    elif isinstance(one, float):
        assert one == pytest.approx(other, rel=1e-3, abs=1e-6)
    else:
        assert one == other


def pictures(out):
    """Kept pictures: a file that was written anew has another number."""
    return {path.name: path.stat().st_ino for path in (out / "renders").glob("*.npz")}


def kill(process):
    process.send_signal(signal.SIGKILL)
    process.communicate()


def lines(process, number):
    """Wait for lines of progress."""
    return all(process.stdout.readline() for _ in range(number))


def wait_for(path, process):
    until(lambda: path.exists() or process.poll() is not None, f"{path} does not appear", seconds=300)
    assert path.exists(), process.communicate()[1]


@pytest.mark.slow
def test_killed_diagnoses_end_like_one_that_was_not(start, whole, tmp_path):
    report, all_pictures = whole
    out, random = tmp_path / "cut", np.random.default_rng(1)
    kept = {}
    for stage in range(2):
        process = start(out)
        # A third of the pictures further each time, somewhere within one or while it is stored.
        assert lines(process, 1 + (stage + 1) * len(all_pictures) // 3)
        time.sleep(random.uniform(0, 0.1))
        kill(process)
        assert not (out / "report.json").exists()
        now = pictures(out)
        assert kept.items() <= now.items(), "a picture was rendered again"
        kept = now
    assert 0 < len(kept) < len(all_pictures)
    process = start(out)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 0, errors
    assert_alike(contents(out), report)
    ended = pictures(out)
    assert ended.keys() == all_pictures.keys()
    assert kept.items() <= ended.items(), "a picture was rendered again"
    rendered = json.loads((out / "report.json").read_text())["provenance"]["rendered"]
    assert rendered == len(ended) - len(kept)
    assert not list(out.rglob("*.partial"))


@pytest.mark.slow
def test_a_run_killed_between_its_results_leaves_no_report(start, whole, measured, tmp_path):
    report, _ = whole
    out = tmp_path / "cut"
    shutil.copytree(measured.with_name("whole"), out)
    (out / "model.toml").unlink()
    process = start(out, hang=True)
    wait_for(out / "model.toml", process)
    kill(process)
    # The report of the run before went before its model was replaced.
    assert not (out / "report.json").exists()
    again = diagnose(load_measurement(measured), DESIGN, out=out, seed=SEED, **SETTINGS)
    assert again.provenance["rendered"] == 0
    write_diagnosis(again, pictures=False)
    assert_alike(contents(out), report)


def test_the_share_that_is_done_only_rises(whole, told):
    told.assert_only_rises()
    assert {"pictures of the model", "trying vignetting", "refining"} <= set(told.said)


def test_a_folder_of_another_diagnosis_is_refused(whole, measured):
    out = measured.with_name("whole")
    before = (out / "report.json").read_bytes()
    with pytest.raises(ValueError, match=r"whole: holds a diagnosis with another seed .*choose another"):
        diagnose(load_measurement(measured), DESIGN, out=out, seed=SEED + 1, **SETTINGS)
    other = DESIGN.replace({"leds.height_mm": DESIGN.leds.height_mm + 1})
    with pytest.raises(ValueError, match="holds a diagnosis of another model"):
        diagnose(load_measurement(measured), other, out=out, seed=SEED, **SETTINGS)
    assert (out / "report.json").read_bytes() == before
