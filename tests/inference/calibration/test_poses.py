"""Places and depths that nobody noted: read off pictures of the independent generator."""

import json

import numpy as np
import pytest

from designlab.inference.calibration.poses import posed
from designlab.measurement import (
    MeasuredFrame,
    Measurement,
    MeasurementError,
    load_measurement,
    write_measurement,
)
from designlab.sensor.design import preset
from designlab.validation.synthetic import answer_path, plant

FLAT, ELASTIC = preset("gelsight-2020-flat"), preset("gelsight-2020-flat-elastic")


def planted(folder, design, press, **how):
    """A background and a press, as a lab notes it, and what was really pressed."""
    options = {"kit": "small", "presses": [press], "columns": 64, "unlisted": False, "seed": 3}
    whole = load_measurement(plant(design, effects={}, out=folder / "whole", **options | how))
    (true,) = json.loads(answer_path(folder / "whole").read_text(encoding="utf-8"))["presses"]
    kept = [f for f in whole.frames if f.file in ("background-0.exr", "press-01.exr")]
    part = whole.model_copy(update={"frames": tuple(kept)})
    images = {frame.file: whole.image(frame) for frame in kept}
    return load_measurement(write_measurement(part, images, folder / "part")), true


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.recovery
@pytest.mark.llvm
@pytest.mark.parametrize(
    ("design", "probe", "depth_mm", "centre_mm", "yaw_deg"),
    [
        (FLAT, "sphere:4", 0.4, (-3.0, 2.0), 0.0),
        pytest.param(ELASTIC, "sphere:4", 0.8, (2.5, -2.0), 0.0, marks=pytest.mark.full),
        (FLAT, "triangle:5", 0.5, (1.5, -1.5), 20.0),
    ],
)
def test_place_depth_and_yaw_are_read_off_the_picture(tmp_path, design, probe, depth_mm, centre_mm, yaw_deg):
    press = {"probe": probe, "depth_mm": depth_mm, "centre_mm": centre_mm, "yaw_deg": yaw_deg}
    measurement, true = planted(tmp_path, design, press, noted="nothing", placed=False)
    frame = measurement.frames[-1]
    assert (frame.depth_mm, frame.centre_mm, frame.yaw_deg) == (None, None, None)
    read = posed(measurement, design)
    found = read.measurement.frames[-1]
    np.testing.assert_allclose(found.centre_mm, true["centre_mm"], atol=0.1)
    assert found.depth_mm == pytest.approx(true["depth_mm"], abs=0.08)
    if probe.startswith("triangle"):
        assert found.yaw_deg == pytest.approx(true["yaw_deg"], abs=2.0)
    # What is known of the depth stays as wide as the range: 95 % of it lie in 5 to 60 % of the thickness.
    assert found.sigma.depth_mm == pytest.approx(0.55 * design.elastomer.thickness_mm / 4, rel=1e-3)
    place, depth = read.notes
    assert "no place is stated; read off its difference to background-0.exr" in place
    assert "wider intervals" in depth


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.llvm
def test_a_stated_place_and_range_hold(tmp_path):
    press = {"probe": "sphere:4", "depth_mm": 0.5, "centre_mm": (1.0, 1.0), "yaw_deg": 0.0}
    measurement, true = planted(tmp_path, FLAT, press, noted="nothing")
    gel, shown = measurement.frames
    ranged = shown.model_copy(update={"depth_range_mm": (0.3, 0.7)})
    read = posed(measurement.model_copy(update={"frames": (gel, ranged)}), FLAT)
    found = read.measurement.frames[-1]
    assert found.centre_mm == (1.0, 1.0)
    assert found.depth_mm == pytest.approx(true["depth_mm"], abs=0.08)
    assert found.sigma.depth_mm == pytest.approx(0.1)
    (note,) = read.notes
    assert "between 0.3 and 0.7 mm (as stated)" in note


def pictures(folder, *frames):
    """Pictures that show nothing."""
    made = tuple(MeasuredFrame.model_validate(frame) for frame in frames)
    images = {frame.file: np.full((36, 48, 3), 0.3, dtype=np.float32) for frame in made}
    return load_measurement(write_measurement(Measurement(response="linear", frames=made), images, folder))


PRESS = {"file": "p.exr", "kind": "press", "probe": "sphere:4", "crop_px": (0, 0, 1640, 1230)}
GEL = {"file": "g.exr", "kind": "background", "crop_px": (0, 0, 1640, 1230)}


@pytest.mark.parametrize(
    "known",
    [
        {"depth_mm": 0.5, "centre_mm": (0.0, 0.0)},
        {"force_n": 0.5, "centre_mm": (0.0, 0.0)},
        {"contact_diameter_mm": 1.5, "centre_mm": (0.0, 0.0)},
    ],
)
def test_a_set_that_states_all_stays_as_it_is(tmp_path, known):
    measurement = pictures(tmp_path / "m", PRESS | known, GEL)
    read = posed(measurement, ELASTIC)
    assert read.measurement is measurement
    assert read.notes == ()


@pytest.mark.parametrize(("column", "row"), [(24, 18), (40, 18), (24, 6)])
def test_pixels_are_lengths_by_the_camera_where_no_scale_is_stated(tmp_path, column, row):
    seen = {"centre_px": (column, row), "contact_diameter_px": 4.0}
    whole = pictures(tmp_path / "m", PRESS | seen, GEL)
    measurement, design = posed(whole, FLAT).measurement, FLAT
    frame = measurement.frames[0]
    from designlab.simulation.optics.viewing_rays import rays

    there = rays(design, measurement.view(frame, design))
    assert frame.centre_mm == (there.x_mm[row, column], there.y_mm[row, column])
    assert frame.contact_diameter_mm == pytest.approx(4 * np.mean(there.pitch_mm))


@pytest.mark.faults
@pytest.mark.parametrize(
    ("press", "gel", "words"),
    [
        ({"depth_mm": 0.5}, False, "no picture of the untouched gel with the same LEDs"),
        ({"depth_mm": 0.5, "leds": ["red"]}, True, "no picture of the untouched gel with the same LEDs"),
        ({"depth_mm": 0.5}, True, "no contact is seen"),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path, press, gel, words):
    frames = [PRESS | press, *([GEL] if gel else [])]
    read = posed(pictures(tmp_path / "m", *frames), FLAT)
    assert read.measurement.frames[0].centre_mm is None
    assert words in read.notes[0]
    assert read.notes[0].startswith("p.exr: its pose cannot be read off the picture")


@pytest.mark.faults
@pytest.mark.parametrize(
    ("press", "words"),
    [
        ({"depth_range_mm": (1.95, 3.0), "centre_mm": (0.0, 0.0)}, "thickness of 2 mm"),
        ({"depth_mm": 0.5, "centre_px": (99.0, 5.0)}, "centre_px: lies in the picture"),
        ({"crop_px": (0, 0, 8000, 6000)}, "crop_px: lies on the sensor"),
        ({"leds": ["ultraviolet"]}, "leds: groups of the model"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path, press, words):
    with pytest.raises(MeasurementError, match=words):
        posed(pictures(tmp_path / "m", PRESS | press), FLAT)
