"""Where LED groups shine from: sensors whose rows stand elsewhere than drawn, by a background and a press."""

from types import SimpleNamespace

import layout_sensors
import numpy as np
import pytest

from designlab.core.fields import field_at
from designlab.inference.calibration import calibrate
from designlab.inference.calibration.layout import (
    GroupPlace,
    as_searched,
    layout_fields,
    layout_words,
    search_layout,
)
from designlab.inference.calibration.result import Calibration, FittedParameter
from designlab.inference.calibration.verdict import FALLEN
from designlab.measurement import (
    MeasuredFrame,
    Measurement,
    MeasurementError,
    load_measurement,
    write_measurement,
)
from designlab.measurement.quality.suspicion import NAMES
from designlab.measurement.transfer import predicted
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Simulator
from geometries.probes import parse

DESIGN = preset("gelsight-2020-flat")
TRANSFER = np.array([[900.0, 40.0, 0.0], [150.0, 1400.0, 90.0], [0.0, 60.0, 2000.0]])
FLOOR = np.array([0.01, 0.02, 0.0])


def made(folder, design):
    """A background and a ball of a sensor, with crosstalk and noise."""
    view = design.camera.full_view()._replace(columns=48, rows=36)
    simulator = Simulator(design, view=view, samples=64, seed=7)
    stated = {"probe": "sphere:4", "depth_mm": 0.6, "centre_mm": (2.0, 1.0)}
    press = Press(probe=parse("sphere:4"), depth_mm=0.6, centre_mm=(2.0, 1.0))
    frames = (
        MeasuredFrame(file="background.exr", kind="background"),
        MeasuredFrame.model_validate({"file": "press.exr", "kind": "press", **stated}),
    )
    noise = np.random.default_rng(1)
    images = {}
    for frame, shown in zip(frames, (None, press), strict=True):
        light = predicted(TRANSFER, FLOOR, np.ones(3), simulator.frame(shown).basis.astype(float))
        light = light / 1.3 / light.max() * 0.9
        images[frame.file] = (light + 0.002 * noise.standard_normal(light.shape)).astype(np.float32)
    measurement = Measurement(sensor=DESIGN.name, response="linear", frames=frames)
    return load_measurement(write_measurement(measurement, images, folder))


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.recovery
@pytest.mark.full
@pytest.mark.parametrize("azimuths_deg", [(90, 210, 150), (90, 210, 330), (30, 150, 270)])
def test_azimuths_of_all_groups_are_found(tmp_path, azimuths_deg):
    there = {f"leds.groups.{n}.azimuth_deg": [float(azimuth)] for n, azimuth in enumerate(azimuths_deg)}
    found = search_layout(made(tmp_path / "m", DESIGN.replace(there)), DESIGN, seed=1)
    assert [place.found_deg for place in found.places] == list(azimuths_deg)
    assert [group.azimuth_deg[0] for group in found.design.leds.groups] == list(azimuths_deg)
    assert all(place.worse > 1 for place in found.places)
    assert (found.drawn > 2) == (
        azimuths_deg != (90, 210, 330)
    )  # where they are as drawn, nothing beats that
    assert found.left < 0.05


@pytest.mark.renders
@pytest.mark.slow
def test_figures_before_are_of_the_design_as_drawn(tmp_path):
    moved = DESIGN.replace({"leds.groups.2.azimuth_deg": [150.0], "leds.groups.0.height_mm": 7.0})
    options = {"columns": 16, "samples": 4, "free": (), "seed": 1, "trust": NAMES}
    found = calibrate(made(tmp_path / "m", moved), moved, drawn=DESIGN, **options)
    gel = next(frame for frame in found.frames if frame.pose is None)
    half = gel.measured.shape[1] // 2
    for picture, from_the_right in ((gel.given, True), (gel.measured, False), (gel.simulated, False)):
        blue = picture[..., 2]
        assert (blue[:, half:].mean() > blue[:, :half].mean()) == from_the_right


@pytest.mark.renders
@pytest.mark.full
@pytest.mark.recovery
@pytest.mark.parametrize("name", ["turned", "elastic"])
def test_rows_of_made_sensors_are_right_or_not_told(tmp_path, name):
    found = layout_sensors.run(name, tmp_path, columns=48, seed=4)
    assert [row for row in found["rows"] if row[-1] == "wrong"] == []
    assert all(word == "right" for _, what, *_, word in found["rows"] if what == "azimuth_deg")
    assert found["verdict"] != "good" or found["after"] > found["before"] - FALLEN[0]


@pytest.mark.parametrize(
    ("value", "se", "truth", "error", "word"),
    [
        (358.0, 0.1, 1.0, -3.0, "right"),
        (-10.0, 1.0, 357.0, -7.0, "wrong"),
        (20.0, 4.0, 357.0, 23.0, "untold"),
        (20.0, None, 357.0, 23.0, "untold"),
    ],
)
def test_how_the_benchmark_judges_an_azimuth(value, se, truth, error, word):
    assert layout_sensors.judged("azimuth_deg", value, se, truth) == (pytest.approx(error), word)


def test_a_fit_frees_azimuth_height_and_tilt_of_each_group():
    design, paths = layout_fields(DESIGN)
    assert len(paths) == 9
    for path in ("leds.groups.0.azimuth_deg.0", "leds.groups.1.height_mm", "leds.groups.2.tilt_deg"):
        assert path in paths
    assert [group.height_mm for group in design.leds.groups] == [DESIGN.leds.height_mm] * 3
    assert [group.tilt_deg for group in design.leds.groups] == [DESIGN.leds.tilt_deg] * 3


@pytest.mark.parametrize(
    ("drawn", "found", "away"), [(330.0, 150.0, 180.0), (90.0, 95.0, 5.0), (350.0, 10.0, 20.0)]
)
def test_how_far_a_group_is_from_where_it_is_drawn(drawn, found, away):
    assert abs(GroupPlace("blue", drawn, found, 1.1).moved_deg) == away


def test_what_was_found_is_said_with_its_interval_or_that_it_is_not_told():
    def parameter(name, value, se):
        return FittedParameter(f"leds.groups.{name}", "deg", value, se)

    found = SimpleNamespace(
        parameters=(
            parameter("0.azimuth_deg.0", 91.0, 0.5),
            parameter("1.azimuth_deg.0", 215.0, 8.0),
            parameter("2.azimuth_deg.0", -210.0, 1.0),
            parameter("2.height_mm", 8.5, 0.1),
            parameter("2.tilt_deg", 20.0, 3.0),
            parameter("0.height_mm", 8.0, None),
        )
    )
    assert layout_words(found, DESIGN) == [
        "LED group red shines from 91 ± 1.0 deg, as drawn",
        "LED group red: these pictures do not tell its height",
        "LED group green: these pictures do not tell its azimuth",
        "LED group blue shines from 150 ± 2.0 deg, drawn at 330 deg",
        "LED group blue: height 8.50 ± 0.20 mm",
        "LED group blue: tilt 20.00 ± 5.88 deg: these pictures do not tell it to 5 deg",
    ]


@pytest.mark.parametrize(
    ("name", "step", "least"),
    [("azimuth_deg.0", 0.7, 1.25), ("height_mm", 0.02, 0.375), ("tilt_deg", 0.5, 1.0)],
)
def test_what_a_fit_left_where_it_began_is_known_to_a_step_of_the_search(name, step, least):
    start, paths = layout_fields(DESIGN)
    path = f"leds.groups.1.{name}"
    assert path in paths
    there = field_at(start, path).value
    parameters = [
        FittedParameter(path, "", there, 0.01),
        FittedParameter(path, "", there + step, 0.01),
        FittedParameter(path, "", there, 4.0),
        FittedParameter(path, "", there, None),
        FittedParameter("elastomer.thickness_mm", "mm", start.elastomer.thickness_mm, 0.01),
    ]
    found = Calibration(
        start, tuple(parameters), np.zeros((5, 5)), (), (), np.zeros((3, 3)), np.zeros(3), (), {}
    )
    left, moved, unsure, untold, other = (p.se for p in as_searched(found, start).parameters)
    assert left == pytest.approx(least / 1.96)
    assert (moved, unsure, untold, other) == (0.01, 4.0, None, 0.01)


def test_a_failed_fit_tells_of_no_group():
    words = layout_words(SimpleNamespace(parameters=()), DESIGN, "failed")
    assert words == [
        f"LED group {name}: not told where it shines from, since the fit failed"
        for name in ("red", "green", "blue")
    ]


def test_a_doubtful_fit_tells_places_without_intervals():
    found = SimpleNamespace(parameters=(FittedParameter("leds.groups.0.azimuth_deg.0", "deg", 26.0, 0.6),))
    (word,) = layout_words(found, DESIGN, "doubtful")
    assert word.startswith("LED group red may shine from about 26 deg, drawn at 90 deg")
    assert "±" not in word


@pytest.mark.faults
def test_too_many_groups_are_refused(tmp_path):
    groups = [
        {"name": f"g{n}", "azimuth_deg": [72.0 * n], "wavelength_nm": 530.0, "flux_mw": 10.0}
        for n in range(5)
    ]
    many = SimpleNamespace(leds=SimpleNamespace(groups=groups))
    with pytest.raises(MeasurementError, match="4 LED groups at most, got 5"):
        search_layout(None, many)
