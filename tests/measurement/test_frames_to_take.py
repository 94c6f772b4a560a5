"""Frames that could be taken next, from those there are."""

from dataclasses import replace

import pytest

from designlab.measurement.frames_to_take import DARK, frames_to_take, in_words
from designlab.measurement.usable_frames import observe_apart
from tests.helpers.spoilt_sets import COLUMNS, DESIGN, planted


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    measurement = planted(tmp_path_factory.mktemp("whole") / "m")
    seen = observe_apart(measurement, DESIGN, columns=COLUMNS)
    return [shot for shot in seen.shots if shot.lit.any()]


def test_cameras_are_taken_to_end_at_zero_unless_they_are_seen_not_to(shots):
    for lower, ends in ((0.0, True), (1.0, False)):
        some = [replace(shots[0], signal=shots[0].signal - lower), *shots[1:]]
        dark = next(each for each in frames_to_take(some, DESIGN.group_names) if each.frame == DARK)
        assert dark.shot.clips == (ends,) * 3
        assert not dark.shot.lit.any()


def test_the_deepest_press_of_each_place_that_was_fitted_to_is_asked_for_in_each_light(shots):
    fitted = [shot.press for shot in shots if shot.use == "train"]
    places = {press.centre_mm for press in fitted}
    deepest = max(press.depth_mm for press in fitted)
    asked = [each for each in frames_to_take(shots, DESIGN.group_names) if each.frame["kind"] == "press"]
    assert {tuple(each.frame["centre_mm"]) for each in asked} == places
    assert {each.frame["depth_mm"] for each in asked} == {deepest}
    assert len(asked) == len(places) * len(DESIGN.group_names)
    for each in asked:
        assert each.shot.lit.tolist() == [name == each.alone for name in DESIGN.group_names]


def test_frames_that_differ_by_their_light_alone_are_said_as_one(shots):
    backgrounds = frames_to_take(shots, DESIGN.group_names)[:3]
    red, green, blue = DESIGN.group_names
    assert in_words(backgrounds) == f"a background with the {red}, {green} and {blue} LEDs, each alone"
    assert in_words(backgrounds[:1]) == f"a background with the {red} LEDs alone"
