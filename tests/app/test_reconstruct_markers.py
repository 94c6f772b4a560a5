"""`designlab reconstruct` on a gel with printed markers: shapes without them, and the shear by them."""

import json

import numpy as np
import pytest

from designlab.app import cli
from designlab.core.images import write_image
from designlab.evaluation.protocol import EvaluationProtocol, error_region
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Simulator, exposure

DESIGN = preset("default").replace(
    {"contact.friction": 0.8, "optics.marker_pitch_mm": 1.2, "optics.marker_diameter_mm": 0.4}
)
PRESSES = [
    Press(probe=probe, depth_mm=depth, centre_mm=centre, shear_mm=shear)
    for probe, depth, centre, shear in (
        ("sphere:4", 0.5, (1.0, 0.5), (0.1, 0.0)),
        ("sphere:6", 0.6, (-2.0, 1.0), (-0.05, 0.15)),
        ("cylinder:4", 0.4, (0.3, -1.0), (-0.1, -0.1)),
        ("star:6", 0.5, (-0.5, 0.4), (0.15, -0.05)),
        ("triangle:5", 0.4, (2.0, -0.5), (0.0, 0.12)),
        ("sphere:4", 0.4, (-2.5, -1.5), (0.08, 0.1)),
    )
]


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """Pictures of the presses, the design, and the frames."""
    folder = tmp_path_factory.mktemp("pictures")
    simulator = Simulator(DESIGN, columns=240, seed=4)
    untouched = simulator.frame(None)
    protocol = EvaluationProtocol(DESIGN, exposure(DESIGN, untouched), 4)
    write_image(folder / "background.exr", protocol.picture(untouched, 0))
    frames = [simulator.frame(press) for press in PRESSES]
    for number, frame in enumerate(frames):
        write_image(folder / f"press-{number}.exr", protocol.picture(frame, 1 + number))
    DESIGN.save(folder / "design.toml")
    return folder, frames


@pytest.fixture(scope="module")
def out(taken, tmp_path_factory):
    """Shapes by the design, and what the command says."""
    folder, _ = taken
    made = tmp_path_factory.mktemp("shapes") / "out"
    pictures = [str(folder / f"press-{number}.exr") for number in range(len(PRESSES))]
    words = ["reconstruct", *pictures, "--background", str(folder / "background.exr")]
    words += ["--design", str(folder / "design.toml"), "--out", str(made)]
    assert cli.main(words) == 0
    return made, words


@pytest.mark.slow
@pytest.mark.renders
def test_shear_is_found_within_a_fifth(taken, out):
    _, frames = taken
    rows = json.loads((out[0] / "shapes.json").read_text())["shapes"]
    assert len(rows) == len(frames)
    for row, frame in zip(rows, frames, strict=True):
        off = np.array(row["shear_n"]) - frame.mechanics.shear_force_n
        assert np.hypot(*off) < 0.2 * np.hypot(*frame.mechanics.shear_force_n), row["name"]
        assert row["markers"] > 40
        assert row["markers_moved_mm"] > 0
        assert min(row["shear_error_n"]) > 0


@pytest.mark.slow
@pytest.mark.renders
def test_markers_leave_shapes_as_they_are(taken, out):
    _, frames = taken
    for number, frame in enumerate(frames):
        region = error_region(frame)
        off = np.load(out[0] / f"press-{number}-height.npy") - frame.height_mm
        assert np.sqrt((off[region] ** 2).mean()) < 0.08
    page = (out[0] / "report.html").read_text()
    assert "shear, right and up" in page
    assert "markers found in the background" in page
    assert (
        (out[0] / "shapes.csv")
        .read_text()
        .startswith(
            "file,frame,depth_mm,contact_area_mm2,force_n,force_low_n,force_high_n,"
            "markers,markers_moved_mm,shear_x_n,shear_y_n,warnings"
        )
    )


@pytest.mark.slow
@pytest.mark.renders
@pytest.mark.parametrize(
    ("more", "known"),
    [
        pytest.param((), True, marks=pytest.mark.full),
        pytest.param(("--camera-mm", "30"), True, marks=pytest.mark.full),
        (("--markers", "none"), False),
    ],
)
def test_the_kept_map_knows_the_markers(out, tmp_path, capsys, more, known):
    made, words = out
    start = words.index("--background")
    capsys.readouterr()
    named = [*words[:start], "--calibration", str(made / "calibration.npz"), "--gel", "gelsight-mini"]
    status = cli.main([*named, "--out", str(tmp_path / "again"), "--files", "height", "--json", *more])
    rows = json.loads(capsys.readouterr().out)["shapes"]
    assert status == 0
    assert all((row.get("shear_n") is not None) == known for row in rows)


@pytest.mark.faults
@pytest.mark.parametrize(
    ("more", "rule"),
    [
        (
            ("--camera-mm", "30", "--design", "default", "--background", "b.exr"),
            "--camera-mm: is for --calibration",
        ),
        (("--camera-mm", "0", "--calibration", "c.npz"), "--camera-mm: must be above 0 mm"),
        (("--camera-mm", "-3", "--calibration", "c.npz"), "--camera-mm: must be above 0 mm"),
    ],
)
def test_a_distance_that_cannot_be_is_refused(tmp_path, capsys, more, rule):
    picture = tmp_path / "press.exr"
    write_image(picture, np.full((10, 10, 3), 0.5, dtype=np.float32))
    assert cli.main(["reconstruct", str(picture), *more, "--out", str(tmp_path / "out")]) == 2
    assert rule in capsys.readouterr().err
