"""Light probe frames of a measurement folder."""

import numpy as np
import pytest

from designlab.measurement import (
    MeasuredFrame,
    Measurement,
    MeasurementError,
    ball_of,
    light_of,
    load_measurement,
)
from designlab.measurement import write_measurement as write
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.light_probe.lobes import lobes
from designlab.measurement.light_probe.polar import unit_vectors
from designlab.measurement.light_probe.sight import probe_view
from designlab.measurement.light_probe.unwrap import unwrap
from designlab.sensor.design import preset

DESIGN = preset("gelsight-2020-flat")
PROBE = LightProbe(centre_mm=(0.5, -0.4))
BLACK = 0.04


def frame(**changes):
    content = {"file": "ball.exr", "kind": "light_probe", "probe": "ball:4.0", "centre_mm": PROBE.centre_mm}
    return MeasuredFrame.model_validate(content | {"crop_px": CROP} | changes)


def whole_pixels():
    view = probe_view(DESIGN, PROBE, columns=100)
    return int(view.x_px) - 20, int(view.y_px) - 10, 340, 320


CROP = whole_pixels()


@pytest.fixture(scope="module")
def image():
    """Two round spots of light, as the camera of the preset sees them in the ball."""
    view = probe_view(DESIGN, PROBE, columns=16)._replace(
        x_px=CROP[0], y_px=CROP[1], width_px=CROP[2], height_px=CROP[3], columns=CROP[2], rows=CROP[3]
    )
    blank = unwrap(np.ones((CROP[3], CROP[2], 3)), design=DESIGN, probe=PROBE, view=view)
    left, top = round(blank.view.x_px) - CROP[0], round(blank.view.y_px) - CROP[1]
    picture = np.full((CROP[3], CROP[2], 3), BLACK, dtype=np.float32)
    for channel, azimuth in ((0, 90.0), (2, 330.0)):
        row, column = np.nonzero(blank.direction @ unit_vectors(65.0, azimuth) > np.cos(np.radians(7.0)))
        picture[row + top, column + left, channel] += 0.5
    return picture


def folder_of(tmp_path, image, *frames, sensor="gelsight-2020-flat", response="linear"):
    measurement = Measurement(sensor=sensor, response=response, frames=frames)
    arrays = {f.file: image if f.kind == "light_probe" else np.full_like(image, BLACK) for f in frames}
    return load_measurement(write(measurement, arrays, tmp_path / "set"))


def test_a_measured_frame_unwraps_to_where_its_light_came_from(tmp_path, image):
    dark = MeasuredFrame(file="dark.exr", kind="dark", crop_px=CROP)
    measured = folder_of(tmp_path, image, frame(), dark)
    found = measured.frames[0]
    assert found.probe == "sphere:4.0"
    assert ball_of(measured, found) == PROBE
    red, blue = lobes(light_of(measured, found)).lobes
    assert (red.channel, blue.channel) == ("R", "B")
    assert (red.polar_deg, red.azimuth_deg) == pytest.approx((65.0, 90.0), abs=0.1)
    assert (blue.polar_deg, blue.azimuth_deg) == pytest.approx((65.0, 330.0), abs=0.1)
    assert red.solid_angle_sr == pytest.approx(2 * np.pi * (1 - np.cos(np.radians(7.0))), rel=0.02)


def test_the_ball_may_be_given_by_its_outline(tmp_path, image):
    """Outline of the ball that was asked for: from the eye its half angle is asin(r / distance)."""
    camera, middle = DESIGN.camera, np.array(PROBE.middle_mm)
    way = middle - camera.position_mm
    column, row = camera.project(way[0], way[1], -way[2])
    radius_px = camera.focal_px * np.tan(np.arcsin(2.0 / np.linalg.norm(way)))
    seen = {"centre_mm": None, "centre_px": (column - CROP[0], row - CROP[1]), "contact_radius_px": radius_px}
    measured = folder_of(tmp_path, image, frame(**seen, lowest_mm=0.0))
    probe = ball_of(measured, measured.frames[0])
    assert probe.centre_mm == pytest.approx(PROBE.centre_mm, abs=0.01)
    wrong = folder_of(tmp_path, image, frame(**seen, lowest_mm=0.0, probe="sphere:5.0"))
    with pytest.raises(
        MeasurementError, match=r"frame 1 \(ball.exr\): field contact_radius_px: diameter_mm: .*5 mm"
    ):
        ball_of(wrong, wrong.frames[0])


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"centre_mm": None}, "field centre_mm: unknown; give it, or the ball's outline"),
        ({"probe": "sphere"}, "field probe: its size is unknown, write sphere:diameter_mm, got 'sphere'"),
        ({"probe": None}, "field probe: its size is unknown"),
        ({"probe": "sphere:60"}, "field probe: field diameter_mm: .* less than or equal to 50"),
        ({"probe": "sphere:30"}, "field probe: light_probe.diameter_mm: must be below .* mm, .* got 30 mm"),
        ({"centre_mm": (-6.0, 0.0)}, "field probe: light_probe.centre_mm: the picture must show at least"),
    ],
)  # fmt: skip
def test_a_ball_that_is_unknown_or_does_not_fit_is_named(tmp_path, image, changes, text):
    measured = folder_of(tmp_path, image, frame(**changes))
    with pytest.raises(MeasurementError, match=rf"frame 1 \(ball.exr\): {text}"):
        light_of(measured, measured.frames[0])


def test_what_is_needed_to_unwrap_is_named(tmp_path, image):
    unknown = folder_of(tmp_path, image, frame(), sensor="unknown")
    with pytest.raises(
        MeasurementError, match=r"field sensor: must be known to unwrap ball.exr, got 'unknown'"
    ):
        light_of(unknown, unknown.frames[0])
    coded = folder_of(tmp_path, image, frame(), response="unknown")
    with pytest.raises(MeasurementError, match="field response: must be known"):
        light_of(coded, coded.frames[0])
    dark = folder_of(tmp_path, image, MeasuredFrame(file="dark.exr", kind="dark", crop_px=CROP))
    with pytest.raises(MeasurementError, match="field kind: must be light_probe, got 'dark'"):
        ball_of(dark, dark.frames[0])


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ({"kind": "light_probe", "probe": "star:4"}, "probe: a light probe is a sphere:.*, got 'star:4'"),
        ({"kind": "press", "probe": "star:4", "lowest_mm": 0.0}, "lowest_mm: .* light_probe .* is a press"),
        ({"kind": "background", "immersed": True}, "immersed: .* light_probe .* is a background"),
    ],
)  # fmt: skip
def test_fields_that_do_not_belong_are_refused(content, text):
    with pytest.raises(ValueError, match=text):
        MeasuredFrame.model_validate({"file": "a.exr"} | content)
