"""Values of effects in words: every parameter has its phrase, with size, way, unit and interval."""

import pytest

from designlab.inference.diagnosis.result import Found, Value
from designlab.report.effect_words import _phrases, told
from designlab.sensor.design import preset
from designlab.simulation.effects import CATALOGUE

DESIGNS = ("gelsight-2020-flat", "gelsight-2020-flat-core", "gelsight-2020-flat-elastic")


def value(at, low, high, *, null=0.0, sd=1.0, unit="1"):
    return Value(value=at, low=low, high=high, null=null, sd=sd, unit=unit, bounds=(-9.0, 9.0), fit_sd=0.1)


@pytest.mark.parametrize("each", CATALOGUE, ids=lambda each: each.name)
def test_every_parameter_but_shapes_has_a_phrase_for_both_ways(each):
    for name in DESIGNS:
        for p in each.parameters(preset(name)):
            if not p.shape:
                (more, less), _ = _phrases(each.name, p.name)
                assert "{" in more
                assert "{" in less


@pytest.mark.parametrize(
    ("effect", "parameter", "given", "text"),
    [
        (
            "led_tilt",
            "red_tilt_deg",
            value(4.61, 3.7, 5.6, sd=3.0, unit="deg"),
            "red LEDs point 4.6 deg (3.7 to 5.6) more towards the gel than drawn",
        ),
        (
            "led_tilt",
            "red_tilt_deg",
            value(-4.61, -5.6, -3.7, sd=3.0, unit="deg"),
            "red LEDs point 4.6 deg (3.7 to 5.6) less towards the gel than drawn",
        ),
        (
            "contact_kernel",
            "length_ratio",
            value(1.8, 1.7, 1.9, null=1.0, sd=0.4),
            "the gel smooths contacts over a length 80 % (70 to 90) longer than stated",
        ),
        (
            "colour_mixing",
            "R_from_green",
            value(0.021, 0.01, 0.03, sd=0.1),
            "channel R sees 2 % (1 to 3) more of the green LEDs than stated",
        ),
        (
            "point_spread",
            "sigma_um",
            value(101.0, 90.0, 112.0, sd=75.0, unit="um"),
            "the picture is blurred by 101 µm (90 to 112) at the gel (standard deviation)",
        ),
    ],
)
def test_a_value_is_told_with_its_size_way_unit_and_interval(effect, parameter, given, text):
    assert told(Found(effect, {parameter: given}, 0.9, (effect,))) == text


def test_the_largest_sure_values_are_told_alone():
    parameters = {
        "red_tilt_deg": value(1.0, -0.5, 2.5, sd=3.0, unit="deg"),  # may be nothing
        "green_tilt_deg": value(3.0, 2.0, 4.0, sd=3.0, unit="deg"),
        "blue_turn_deg": value(6.0, 5.0, 7.0, sd=3.0, unit="deg"),
    }
    first, second = told(Found("led_tilt", parameters, 0.9, ("led_tilt",))).split("; ")
    assert first.startswith("blue LEDs point 6 deg (5 to 7) counter-clockwise")
    assert second.startswith("green LEDs point 3 deg (2 to 4) more towards the gel")
    nothing = {"red_tilt_deg": parameters["red_tilt_deg"]}
    assert told(Found("led_tilt", nothing, 0.9, ("led_tilt",))) == ""
