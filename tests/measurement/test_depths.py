"""Depths of presses that state none."""

import math
import re

import pytest
from pydantic import ValidationError

from designlab.measurement import Measurement, MeasurementError
from designlab.measurement.depths import by_circle, by_force, cap_depth_mm
from designlab.measurement.frames import MeasuredFrame
from designlab.sensor.design import preset
from designlab.sensor.field_errors import explain
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from geometries.probes import parse

FLAT, ELASTIC = preset("gelsight-2020-flat"), preset("gelsight-2020-flat-elastic")
BALL = parse("sphere:5")


def mechanics(press: Press):
    contact = indent(ELASTIC.elastomer, ELASTIC.contact, press, area_mm=ELASTIC.sensing_area_mm, pitch_mm=0.1)
    assert contact.mechanics is not None
    return contact.mechanics


def test_a_press_by_force_goes_as_deep_as_one_to_that_depth_takes() -> None:
    stated = Press(probe=BALL, depth_mm=0.6, centre_mm=(1.0, -1.0))
    force = mechanics(stated).force_n
    by = Press(probe=BALL, force_n=force, centre_mm=(1.0, -1.0))
    found, sure = by_force(by, ELASTIC, 0.0)
    assert found.stated_depth_mm == pytest.approx(0.6, rel=0.01)
    assert found.force_n is None
    # A tenth more of force and a fifth more of modulus; a thin layer is stiffer than Hertz's power of 2/3.
    _, unsure = by_force(by, ELASTIC, 0.1 * force)
    assert 0.4 * 0.2 * 0.6 < sure < 0.67 * 0.2 * 0.6
    assert unsure == pytest.approx(sure * math.hypot(0.1, 0.2) / 0.2)


def test_a_kernel_knows_no_force() -> None:
    with pytest.raises(ValueError, match="knows no force"):
        by_force(Press(probe=BALL, force_n=1.0), FLAT, 0.1)


def test_a_circle_tells_the_depth_of_a_ball() -> None:
    """Where the gel follows the ball it is that of the cap; an elastic gel touches a smaller circle."""
    of_cap = Press(probe=BALL, depth_mm=cap_depth_mm(BALL, 1.5))
    rigid, _ = by_circle(of_cap, FLAT, 1.5)
    assert rigid.stated_depth_mm == pytest.approx(0.5)
    elastic, doubt = by_circle(of_cap, ELASTIC, 1.5)
    assert mechanics(elastic).contact_radius_mm == pytest.approx(1.5, rel=0.02)
    assert 0.5 < elastic.stated_depth_mm < 1.0  # Hertz: a^2 = R d, twice the cap's depth
    assert doubt == pytest.approx(0.2 * elastic.stated_depth_mm)


def frame(**fields: object) -> tuple[Measurement, MeasuredFrame]:
    one = MeasuredFrame(file="p.exr", kind="press", centre_mm=(0.0, 0.0), contact_radius_px=30, **fields)
    return Measurement(frames=(one,), mm_per_px=0.05), one


@pytest.mark.parametrize(
    ("probe", "stated", "depth_mm"),
    [
        ("sphere:5", {"contact_diameter_mm": 3.0}, 0.5),
        ("sphere:5", {"contact_diameter_px": 60.0}, 0.5),
        ("sphere:10", {"contact_diameter_mm": 6.0}, 1.0),
        ("sphere:10", {"contact_radius_px": 60.0}, 1.0),
    ],
)
def test_a_circle_is_stated_by_its_diameter_too(
    probe: str, stated: dict[str, float], depth_mm: float
) -> None:
    one = MeasuredFrame(file="p.exr", kind="press", centre_mm=(0.0, 0.0), probe=probe, **stated)
    press = Measurement(frames=(one,), mm_per_px=0.05).press(one)
    assert press is not None
    assert press.depth_mm == pytest.approx(depth_mm)


@pytest.mark.faults
@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"contact_diameter_mm": 1.0, "contact_radius_px": 3.0}, "contact_diameter_mm: says the same as"),
        ({"probe": "star:5", "contact_diameter_mm": 1.0}, "tells the depth of a sphere alone"),
        ({"force_n": 1.0, "depth_range_mm": (0.1, 0.2)}, "depth_range_mm: .*force_n tells it"),
        ({"contact_diameter_px": 9.0, "depth_range_mm": (0.1, 0.2)}, "contact_diameter_px tells it"),
        ({"depth_range_mm": (0.0, 0.2)}, "depth_range_mm: .*0 < least"),
        ({"depth_range_mm": (0.4, 0.2)}, "depth_range_mm: .*least < greatest"),
        ({"kind": "background", "probe": None, "depth_range_mm": (0.1, 0.2)}, "is for a press"),
        ({"kind": "background", "probe": None, "contact_diameter_mm": 1.0}, "is for a press"),
        ({"kind": "background", "probe": None, "direction": "normal"}, "direction: is for a press"),
        ({"direction": "up"}, "direction: .*'axis' or 'normal'"),
    ],
)
def test_what_cannot_be_meant_of_a_depth_is_refused_by_field(fields: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError) as refused:
        MeasuredFrame.model_validate({"file": "p.exr", "kind": "press", "probe": "sphere:4"} | fields)
    assert re.search(words, explain(refused.value))


def test_what_is_not_stated_is_not_written() -> None:
    """Digests of sets from before these fields were known stay what they were."""
    written = MeasuredFrame(file="p.exr", kind="press", probe="sphere:4").model_dump(mode="json")
    later = {"contact_diameter_mm", "contact_diameter_px", "depth_range_mm", "direction"}
    assert not later & set(written)


@pytest.mark.parametrize(("stated", "meant"), [(None, "axis"), ("axis", "axis"), ("normal", "normal")])
def test_a_press_goes_along_the_axis_unless_it_says_otherwise(stated: str | None, meant: str) -> None:
    measurement, one = frame(probe="sphere:5", direction=stated)
    press = measurement.press(one)
    assert press is not None
    assert press.direction == meant


def test_a_frame_with_a_circle_is_a_press() -> None:
    measurement, one = frame(probe="sphere:5")
    press = measurement.press(one)
    assert press is not None
    assert press.depth_mm == pytest.approx(0.5)
    measurement, one = frame(probe="sphere:5", force_n=2.0)
    press = measurement.press(one)
    assert press is not None
    assert press.force_n == 2.0


@pytest.mark.parametrize(
    ("probe", "words"), [("star:5", "of a sphere alone"), ("sphere:2.8", "below the ball's radius of 1.4 mm")]
)
def test_a_circle_that_tells_no_depth_is_named(probe: str, words: str) -> None:
    measurement, one = frame(probe=probe)
    with pytest.raises(MeasurementError, match=words):
        measurement.press(one)
