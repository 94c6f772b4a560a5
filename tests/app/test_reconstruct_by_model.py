"""`designlab reconstruct --design`: shapes by a model of the sensor, and where sensor and model disagree."""

import json

import numpy as np
import pytest

from designlab.app import cli
from designlab.core.images import read_image, write_image
from designlab.core.metrics import normal_error_deg
from designlab.evaluation.protocol import error_region
from designlab.inference.calibration.from_model import views_that_fit
from designlab.reconstruction.height import normals
from designlab.sensor.design import preset
from designlab.sensor.response_curve import Response
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Frame, Simulator
from designlab.validation.synthetic import plant, unseal
from designlab.validation.synthetic.generate import cropped_view

COLUMNS = 80
SENSORS = {
    "gelsight-2020-flat": "gelsight-2020-flat-core",
    "gelsight-2020-dome": "gelsight-2020-flat",
    "gelsight-2020-flat-elastic": "gelsight-2020-flat-core",
}
"""Sensors, and models that they are not."""
USUAL, *FURTHER = SENSORS
FULL = pytest.mark.full  # of minutes each, with the others of their kind
PRESSES = [
    {"probe": "sphere:4", "depth_mm": 0.5, "centre_mm": [1.5, -1.0], "yaw_deg": 0.0},
    {"probe": "sphere:5", "depth_mm": 0.8, "centre_mm": [-2.0, 1.5], "yaw_deg": 0.0},
    {"probe": "cylinder:4", "depth_mm": 0.4, "centre_mm": [0.5, 1.0], "yaw_deg": 0.0},
]


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """Sets of the independent generator, by sensor."""
    made = {}

    def of(sensor):
        if sensor not in made:
            out = tmp_path_factory.mktemp("sets") / sensor
            made[sensor] = plant(
                preset(sensor), effects={}, out=out, seed=5, presses=PRESSES, columns=COLUMNS, kit="small"
            )
        return made[sensor]

    return of


def arguments(folder, model, out, *more):
    crop, _ = cropped_view(preset(folder.name), COLUMNS)
    pictures = sorted(map(str, folder.glob("press-*.exr")))
    return [
        *("reconstruct", *pictures, "--design", model, "--background", str(folder / "background-0.exr")),
        *(
            "--crop-px",
            ",".join(map(str, crop)),
            "--out",
            str(out),
            "--files",
            "height",
            "normals",
            "--json",
            *more,
        ),
    ]


@pytest.fixture
def said(capsys):
    """Run the command and give its exit status and what it says."""

    def run(words):
        capsys.readouterr()
        status = cli.main([str(word) for word in words])
        ended = capsys.readouterr()
        return status, json.loads(ended.out) if ended.out else None, ended.err

    return run


def truth(folder, number):
    """What the pixels of a planted picture see."""
    design = preset(folder.name)
    _, view = cropped_view(design, COLUMNS)
    pose = unseal(folder)["presses"][number]
    press = Press(
        probe=PRESSES[number]["probe"], depth_mm=pose["depth_mm"], centre_mm=tuple(pose["centre_mm"])
    )
    simulator = Simulator(design, view=view, seed=0)
    nothing = np.zeros((3, view.rows, view.columns), dtype=np.float32)
    return Frame(press, simulator.surface(press), simulator.rays, nothing, np.eye(3))


@pytest.mark.slow
@pytest.mark.renders
@pytest.mark.parametrize("sensor", [USUAL, *(pytest.param(name, marks=FULL) for name in FURTHER)])
def test_the_right_model_gives_shapes_as_good_as_it_says(planted, said, tmp_path, sensor):
    folder = planted(sensor)
    status, told, _ = said(arguments(folder, sensor, tmp_path))
    assert status == 0
    model = told["model"]
    assert not any("disagree" in text for text in model["warnings"])
    assert any("not for your sensor" in note for note in told["notes"])
    normal, height = [], []
    for number, row in enumerate(told["shapes"]):
        frame = truth(folder, number)
        region = error_region(frame)
        found = np.load(tmp_path / f"{row['name']}-normals.npy")
        normal.append(normal_error_deg(found, normals(*frame.gradient))[region].mean())
        off = np.load(tmp_path / f"{row['name']}-height.npy") - frame.height_mm
        height.append(1000 * np.sqrt((off[region] ** 2).mean()))
    assert np.mean(normal) < 2 * model["normal_error_deg"]
    assert np.sqrt(np.mean(np.square(height))) < 2 * model["height_error_um"]


@pytest.mark.slow
@pytest.mark.renders
@pytest.mark.parametrize(
    ("sensor", "model"),
    [(USUAL, SENSORS[USUAL]), *(pytest.param(name, SENSORS[name], marks=FULL) for name in FURTHER)],
)
def test_a_wrong_model_is_warned_of(planted, said, tmp_path, sensor, model):
    status, told, _ = said(arguments(planted(sensor), model, tmp_path))
    assert status == 0
    disagreeing = [text for text in told["model"]["warnings"] if "disagree" in text]
    assert disagreeing
    assert disagreeing[0] in told["notes"]
    assert all(name in disagreeing[0] for name in ("R:", "G:", "B:", "%"))
    assert "disagree" in (tmp_path / "report.html").read_text()


@pytest.mark.slow
@pytest.mark.renders
def test_the_map_is_kept_for_the_next_pictures(planted, said, tmp_path):
    folder = planted("gelsight-2020-flat")
    _, first, _ = said(arguments(folder, folder.name, tmp_path / "by-model"))
    words = arguments(folder, folder.name, tmp_path / "by-file")
    kept = tmp_path / "by-model" / "calibration.npz"
    start, end = words.index("--design"), words.index("--out")
    status, again, _ = said([*words[:start], "--calibration", kept, *words[end:]])
    assert status == 0
    for one, other in zip(first["shapes"], again["shapes"], strict=True):
        assert other["depth_mm"] == pytest.approx(one["depth_mm"], rel=1e-3)
    assert again["model"]["model"] == folder.name


@pytest.mark.slow
@pytest.mark.renders
@pytest.mark.parametrize("curve", ["srgb", pytest.param("gamma:1.8", marks=FULL)])
def test_a_curve_of_the_camera_is_undone(planted, said, tmp_path, curve):
    folder = planted("gelsight-2020-flat")
    response = Response(curve="srgb") if curve == "srgb" else Response(curve="gamma", gamma=1.8)
    bent = tmp_path / folder.name
    bent.mkdir()
    for path in (folder / "background-0.exr", *folder.glob("press-*.exr")):
        write_image(bent / path.name, response.encode(read_image(path)).astype(np.float32))
    _, straight, _ = said(arguments(folder, folder.name, tmp_path / "straight"))
    status, told, _ = said(arguments(bent, folder.name, tmp_path / "bent", "--response", curve))
    assert status == 0
    for one, other in zip(straight["shapes"], told["shapes"], strict=True):
        assert other["depth_mm"] == pytest.approx(one["depth_mm"], abs=0.01)


@pytest.mark.parametrize(
    ("sensor", "columns"), [("default", 160), ("gelsight-2020-flat", 96), ("digit-like", 120)]
)
def test_pictures_of_the_whole_sensor_and_of_its_area_are_told_apart(sensor, columns):
    design = preset(sensor)
    area = design.view(columns)
    assert "the sensing area" in views_that_fit(design, (area.rows, columns, 3))
    whole = round(columns * design.camera.height_px / design.camera.width_px)
    assert "the camera's whole picture" in views_that_fit(design, (whole, columns, 3))


@pytest.mark.faults
@pytest.mark.parametrize(
    ("rows", "columns", "crop", "rule"),
    [
        (40, 160, None, "whole picture"),
        (160, 60, None, "--crop-px"),
        (120, 160, (0, 0, 9000, 9000), "must lie on the camera's sensor"),
        (120, 160, (0, 0, 300, 300), "proportions of crop_px"),
        (120, 160, (-4, 0, 400, 300), "must lie on the camera's sensor"),
    ],
)
def test_a_picture_that_does_not_fit_the_camera_is_refused(rows, columns, crop, rule):
    with pytest.raises(ValueError, match=rule):
        views_that_fit(preset("gelsight-2020-flat"), (rows, columns, 3), crop)


@pytest.mark.faults
@pytest.mark.parametrize(
    ("more", "rule"),
    [
        ((), "needs one of --calibration FILE and --design MODEL"),
        (("--design", "default", "--calibration", "some.npz"), "needs one of"),
        (("--design", "default"), "needs --background FILE"),
        (("--design", "default", "--background", "{png}"), "--response: required"),
        (("--design", "default", "--background", "{png}", "--response", "log"), "response: one of"),
        (("--design", "no-such", "--background", "{png}", "--response", "srgb"), "no-such"),
        (("--design", "default", "--background", "{png}", "--response", "srgb"), "proportions"),
        (("--calibration", "some.npz", "--response", "srgb"), "--response: is for --design"),
        (("--calibration", "some.npz", "--crop-px", "0,0,9,9"), "--crop-px: is for --design"),
    ],
)
def test_what_is_missing_or_contradicts_is_said_in_a_line(said, tmp_path, more, rule):
    png = tmp_path / "picture.png"
    write_image(png, np.full((10, 40, 3), 0.5, dtype=np.float32))
    words = [str(word).format(png=png) for word in more]
    status, _, error = said(["reconstruct", png, *words, "--out", tmp_path / "out"])
    assert status == 2
    assert rule in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
