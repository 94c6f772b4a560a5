"""Frames compared with each other tell the effects apart that they are there for."""

import numpy as np
import pytest

from designlab.measurement.quality.invariants import corners, invariants
from tests.helpers.spoilt_sets import DESIGN, changed, planted


class TestInvariants:
    """Each tells the effects apart that it is there for."""

    def passed(self, measurement):
        return {each.name: each.passed for each in invariants(measurement, DESIGN)}

    def test_all_hold_in_a_set_without_a_fault(self, whole):
        passed = self.passed(whole)
        assert passed.pop("exposure ladder") is None
        assert passed.pop("turned gel") is None
        assert set(passed.values()) == {True}

    def test_frames_that_are_missing_are_said_to_be(self, whole, tmp_path):
        few = changed(
            whole,
            tmp_path / "m",
            drop={"dark.exr", "background-red.exr", "background-1.exr", "background-2.exr"},
        )
        passed = self.passed(few)
        assert [passed[name] for name in ("superposition", "repeats", "dark")] == [None, None, None]

    @pytest.mark.parametrize(
        ("effect", "fails"),
        [
            ("exposure_drift", "repeats"),
            ("banding", "repeats"),
            ("albedo_field", "turned gel"),
            ("black_level", "exposure ladder"),
        ],
    )
    def test_each_fails_for_its_effect(self, hour, effect, fails):
        failed = [name for name, held in self.passed(hour(effect)).items() if held is False]
        assert fails in failed

    def test_a_press_that_is_not_where_it_is_said_to_be_shows_beside_it(self, whole, tmp_path):
        wrong = changed(
            whole, tmp_path / "m", files={"press-02.exr"}, frames=lambda f: {"centre_mm": (5.0, 4.0)}
        )
        assert self.passed(wrong)["press over background"] is False

    def test_a_flat_field_shows_what_the_lens_loses_in_the_corners(self, tmp_path):
        loss = 0.3
        hidden = {"vignetting": {"corner_loss": loss}}
        found = {}
        for name, effects in (("plain", {}), ("dim", hidden)):
            measurement = planted(tmp_path / name, effects, presses=[], flat_field=True)
            frame = next(f for f in measurement.frames if f.kind == "flat_field")
            found[name] = corners(np.asarray(measurement.linear(frame), dtype=float))
        assert found["dim"] < found["plain"]
        assert any(each.name == "flat field" for each in invariants(measurement, DESIGN))
