"""`compare` of a design and one real picture: it works, or one line says what is missing."""

import json

import numpy as np
import pytest

from designlab.app import cli
from designlab.core.images import to_srgb, write_image
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Simulator
from geometries.probes import parse

DESIGN = preset("gelsight-2020-flat")
CROP = "1024,670,600,600"
VIEW = DESIGN.camera.full_view()._replace(
    x_px=1024.0, y_px=670.0, width_px=600.0, height_px=600.0, columns=60, rows=60
)


@pytest.fixture
def run(capsys):
    def runner(*words):
        status = cli.main(["compare", *map(str, words), "--json"])
        return status, json.loads(capsys.readouterr().out)

    return runner


def blank(path, columns=96, rows=72):
    values = np.random.default_rng(0).uniform(0.2, 0.6, (rows, columns, 3))
    write_image(path, values.astype(np.float32))
    return path


@pytest.mark.faults
@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        (
            "p.png",
            (),
            ("what it shows: --untouched", "where: --at", "how deep", "--response srgb", "`designlab"),
        ),
        ("p.exr", (), ("what it shows", "--background gel.png")),
        ("p.png", ("--probe", "sphere:4", "--at", "0,0", "--depth-mm", "0.4"), ("its response",)),
        ("p.exr", ("--probe", "sphere:4", "--depth-mm", "0.4"), ("needs where: --at X,Y, or --background",)),
        ("p.png", ("--untouched",), ("needs its response",)),
        ("p.exr", ("--untouched", "--probe", "sphere:4"), ("--probe: does not go with --untouched",)),
        ("p.exr", ("--depth-mm", "0.5"), ("--depth-mm: needs --probe",)),
        (
            "p.exr",
            ("--probe", "sphere:4", "--at", "0,0", "--depth-mm", "0.3", "--force-n", "-1"),
            ("force_n",),
        ),
        ("p.exr", ("--probe", "sphere:4", "--at", "0,0", "--depth-range-mm", "0.5,0.2"), ("depth_range_mm",)),
        ("p.exr", ("--probe", "sphere", "--at", "0,0", "--depth-mm", "0.3"), ("size is unknown",)),
        ("p.exr", ("--probe", "star:4", "--at", "0,0", "--contact-diameter-mm", "1"), ("of a sphere alone",)),
        ("p.exr", ("--untouched", "--crop-px", "1,2"), ("must be four whole numbers",)),
        ("p.exr", ("--untouched", "--crop-px", "0,0,700,300"), ("one binning in both directions",)),
    ],
)
def test_one_line_says_what_is_missing(run, tmp_path, name, options, words):
    picture = blank(tmp_path / name)
    status, found = run(DESIGN.name, picture, *options)
    assert status == 2
    assert "\n" not in found["error"]
    for word in words:
        assert word in found["error"]
    assert "/set" not in found["error"]  # the folder made of it is nobody's business


@pytest.mark.faults
def test_options_of_one_picture_are_for_one_picture(run, tmp_path):
    picture = blank(tmp_path / "p.exr")
    status, found = run(picture, picture, "--untouched")
    assert status == 2
    assert found["error"].startswith("--untouched: is for a design and one picture")


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.llvm
@pytest.mark.parametrize("noted", ["pose", "nothing"])
def test_a_picture_and_the_untouched_gel(run, tmp_path, noted):
    press = Press(probe=parse("sphere:4"), depth_mm=0.5, centre_mm=(0.5, -0.3))
    shown = {"press.png": press, "gel.png": None}
    for name, own in shown.items():
        light = Simulator(DESIGN, view=VIEW, samples=64, seed=5).frame(own).mixed
        write_image(tmp_path / name, to_srgb(np.clip(light, 0, 1)).astype(np.float32))
    pose = ("--depth-mm", 0.5, "--at", "0.5,-0.3") if noted == "pose" else ()
    beside = ("--background", tmp_path / "gel.png", "--response", "srgb", "--crop-px", CROP)
    words = (DESIGN.name, tmp_path / "press.png", "--probe", "sphere:4", *pose, *beside, "--samples", 32)
    status, found = run(*words)
    assert status == 0
    assert [frame["file"] for frame in found["frames"]] == ["press.exr"]
    assert [frame["file"] for frame in found["backgrounds"]] == ["gel.exr"]
    assert found["structure_corr"] > 0.95
    assert found["snr_db"] > 20
    read = [note for note in found.get("notes", ()) if "read off" in note or "fits the picture best" in note]
    assert len(read) == (0 if noted == "pose" else 2)


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.llvm
def test_a_press_along_the_normal_of_a_dome_fits_where_that_is_said(run, tmp_path):
    dome = preset("gelsight-2020-dome")
    press = Press(probe=parse("sphere:4"), depth_mm=0.5, centre_mm=(5.0, 0.0), direction="normal")
    full = dome.camera.full_view()
    view = full._replace(columns=48, rows=48 * full.rows // full.columns)
    light = Simulator(dome, view=view, samples=64, seed=5).frame(press).mixed
    write_image(tmp_path / "press.exr", np.asarray(light, np.float32))
    words = (dome.name, tmp_path / "press.exr", "--probe", "sphere:4", "--depth-mm", 0.5, "--at", "5,0")
    found = {}
    for way in ("normal", "axis"):
        status, found[way] = run(*words, "--direction", way, "--samples", 32)
        assert status == 0
    assert found["normal"]["snr_db"] > 30
    assert found["normal"]["snr_db"] > found["axis"]["snr_db"] + 10
