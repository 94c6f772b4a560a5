"""Sets as labs have them: what was not noted costs certainty, and is said; nothing fails for it."""

import json

import numpy as np
import pytest

from designlab.core.images import to_srgb
from designlab.inference.diagnosis.diagnose import diagnose
from designlab.measurement import load_measurement
from designlab.report.diagnosis_folder import write_diagnosis
from designlab.sensor.design import preset
from designlab.validation.synthetic import answer_path, plant
from tests.helpers.spoilt_sets import changed

ELASTIC, FLAT = preset("gelsight-2020-flat-elastic"), preset("gelsight-2020-flat")
PLACES = ((-4.0, -3.0), (4.0, -2.0), (0.0, 3.0))
PRESSES = [{"probe": "sphere:4", "depth_mm": 0.5, "centre_mm": place, "yaw_deg": 0.0} for place in PLACES]
CATALOGUE = ["vignetting", "depth_offset"]
HIDDEN = {"vignetting": {"corner_loss": 0.5}}
SURE = ("named", 0.7)  # what no set of these may say at more


def planted(folder, design, presses=PRESSES, effects=HIDDEN, **how):
    options = {"kit": "small", "presses": presses, "columns": 32, "unlisted": False, "seed": 2} | how
    return load_measurement(plant(design, effects=effects, out=folder / "set", **options))


def diagnosed(measurement, design, folder, **how):
    options = {"catalogue": CATALOGUE, "samples": 48, "columns": 32, "seed": 0} | how
    report = diagnose(measurement, design, out=folder / "out", **options)
    return report, write_diagnosis(report, pictures=False)


def honest(report):
    """No effect that was not hidden is sure, and few frames make none sure."""
    wrong = [effect for effect in report.effects if effect.name not in HIDDEN]
    assert report.verdict in ("named", "ambiguous", "partial", "unexplained", "at_floor")
    assert all(effect.confidence <= SURE[1] for effect in report.effects)
    assert report.verdict != "named" or not wrong


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.llvm
@pytest.mark.parametrize("noted", ["force", pytest.param("circle", marks=pytest.mark.full)])
def test_presses_by_force_or_circle(tmp_path, noted):
    measurement = planted(tmp_path, ELASTIC, noted=noted)
    assert all(frame.depth_mm is None for frame in measurement.frames)
    report, _ = diagnosed(measurement, ELASTIC, tmp_path)
    honest(report)
    of = {"force": "its depth is that of its force", "circle": "its depth is that of the contact circle"}
    assert sum(of[noted] in note and "give or take" in note for note in report.notes) == len(PRESSES)


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.full
@pytest.mark.llvm
def test_poses_from_the_pictures_alone(tmp_path):
    report, written = diagnosed(planted(tmp_path, FLAT, noted="nothing", placed=False), FLAT, tmp_path)
    honest(report)
    true = json.loads(answer_path(tmp_path / "set").read_text(encoding="utf-8"))["presses"]
    found = [shot.press for shot in report.seen.shots if shot.press is not None]
    for press, pose in zip(found, true, strict=True):
        np.testing.assert_allclose(press.centre_mm, pose["centre_mm"], atol=0.15)
    assert any("read off the pictures" in reserve for reserve in written["reserves"])
    assert sum("wider intervals" in note for note in report.notes) == len(PRESSES)


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.full
@pytest.mark.llvm
def test_no_repeats(tmp_path):
    whole = planted(tmp_path, FLAT)
    once = changed(whole, tmp_path / "once", drop={"background-1.exr", "background-2.exr"})
    report, written = diagnosed(once, FLAT, tmp_path)
    honest(report)
    assert report.verdict != "named"
    assert any("no frame was taken twice" in reserve for reserve in written["reserves"])


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.llvm
def test_a_background_and_one_press(tmp_path):
    whole = planted(tmp_path, FLAT, PRESSES[:1], noted="nothing", placed=False)
    kept = {"background-0.exr", "press-01.exr"}
    two = changed(whole, tmp_path / "two", drop={f.file for f in whole.frames} - kept)
    report, written = diagnosed(two, FLAT, tmp_path)
    honest(report)
    assert report.verdict != "named"
    assert all(effect.confidence <= 0.5 for effect in report.effects)
    assert any("n = 1: one picture of one press" in text for text in written["statement"])


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.full
@pytest.mark.llvm
def test_eight_bits_in_srgb(tmp_path):
    def eight_bits(image):
        return np.round(255 * to_srgb(np.clip(image, 0, 1))) / 255

    coarse = changed(planted(tmp_path, FLAT), tmp_path / "coarse", pictures=eight_bits, response="srgb")
    report, _ = diagnosed(coarse, FLAT, tmp_path)
    honest(report)
    assert "vignetting" in [effect.name for effect in report.effects]


AZIMUTHS = ((90.0, 210.0, 150.0), (30.0, 210.0, 330.0), (150.0, 270.0, 30.0))


@pytest.mark.renders
@pytest.mark.slow
@pytest.mark.recovery
@pytest.mark.llvm
@pytest.mark.parametrize(
    "azimuths_deg", [AZIMUTHS[0], *(pytest.param(each, marks=pytest.mark.full) for each in AZIMUTHS[1:])]
)
def test_groups_at_other_sides_are_named_and_no_effect_instead(tmp_path, azimuths_deg):
    there = {f"leds.groups.{n}.azimuth_deg": [azimuth] for n, azimuth in enumerate(azimuths_deg)}
    turned = FLAT.replace(there)
    whole = planted(tmp_path, turned, PRESSES[:1], {})
    kept = {"background-0.exr", "press-01.exr"}
    two = changed(whole, tmp_path / "two", drop={f.file for f in whole.frames} - kept, sensor=FLAT.name)
    report, written = diagnosed(two, FLAT, tmp_path)
    (found,) = report.effects
    assert found.name == "led_layout"
    assert report.verdict == "partial"  # two pictures bear no more
    assert [group.azimuth_deg[0] for group in report.updated.design.leds.groups] == list(azimuths_deg)
    moved = {
        f"{group.name}_azimuth_deg"
        for group, azimuth in zip(FLAT.leds.groups, azimuths_deg, strict=True)
        if group.azimuth_deg[0] != azimuth
    }
    assert set(found.parameters) == moved
    assert any("from other sides than drawn" in note and "--layout" in note for note in written["notes"])
    assert report.candidates == ()
    assert any("no effect was tried beside it" in text for text in written["statement"])
