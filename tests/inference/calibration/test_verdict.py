"""A verdict on a calibration: what is wrong with it is said, and its page holds in a browser."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.inference.calibration.result import Calibration, FittedParameter, FrameResult
from designlab.inference.calibration.verdict import fit_verdict
from designlab.report.calibration import calibration_report
from designlab.report.calibration_pictures import residual_plot
from designlab.report.figures import write_figure
from designlab.sensor.design import preset
from designlab.simulation.directional_light import DirectionalLight
from designlab.simulation.effects.model import SensorModel
from tests.helpers.browser import faults, opened

DESIGN = preset("gelsight-2020-flat")
MEASURED = np.full((12, 16, 3), 0.4) + np.linspace(0, 0.1, 16)[:, None]


def frame(use, before, after, snr_db):
    figures = [
        {"structure_corr": corr, "structure_snr_db": 3.0, "snr_db": snr_db} for corr in (before, after)
    ]
    pose = None if use == "background" else {"x_mm": 0.0, "y_mm": 0.0, "depth_mm": 0.5, "yaw_deg": 0.0}
    return FrameResult(f"{use}.exr", use, *figures, pose, MEASURED, MEASURED, MEASURED + 0.002)


def calibration(**changes):
    usual = Calibration(
        model=SensorModel(design=DESIGN),
        parameters=(FittedParameter("transfer.R.red", "mm2 sr", 900.0, 3.0),),
        correlation=np.eye(1),
        products=(),
        frames=(frame("background", 0.5, 0.9, 30.0), frame("final", 0.6, 0.9, 25.0)),
        transfer=np.array([[900.0, 40.0, 0.0], [150.0, 1400.0, 90.0], [0.0, 60.0, 2000.0]]),
        floor=np.array([0.01, 0.02, 0.0]),
        notes=("a note",),
        provenance={},
    )
    return replace(usual, **changes)


def test_a_fit_that_nothing_speaks_against_is_good():
    assert fit_verdict(calibration()) == ("good", ())


@pytest.mark.parametrize(
    ("changes", "word", "reason"),
    [
        ({"floor": np.array([0.42, 0.42, 0.42])}, "failed", "of the light in channels R, G, B is a floor"),
        ({"floor": np.array([0.0, 0.0, 0.12])}, "doubtful", "27% of the light in channel B is a floor"),
        ({"stuck": True}, "doubtful", "the search ended where no step made the pictures fit better"),
        (
            {"transfer": np.array([[900.0, 0.0, 0.0], [0.0, 1400.0, 0.0], [500.0, 500.0, 1.0]])},
            "failed",
            "no channel sees the light of LED group blue",
        ),
        (
            {"transfer": np.array([[900.0, 0.0, 0.0], [0.0, 1400.0, 0.0], [500.0, 400.0, 300.0]])},
            "failed",
            "LED group blue is the strongest in no channel",
        ),
        (
            {"frames": (frame("background", 0.5, 0.9, 30.0), frame("final", 0.80, 0.78, 25.0))},
            "doubtful",
            "structure correlation 0.80 -> 0.78",
        ),
        (
            {"frames": (frame("background", 0.5, 0.9, 30.0), frame("final", 0.80, 0.60, 25.0))},
            "failed",
            "structure correlation 0.80 -> 0.60",
        ),
        (
            {"frames": (frame("background", 0.5, 0.9, 12.0), frame("final", 0.6, 0.9, 12.0))},
            "doubtful",
            "leaves 25 % of the signal",
        ),
    ],
)
def test_what_speaks_against_a_fit_is_said(changes, word, reason):
    found = fit_verdict(calibration(**changes))
    assert found.word == word
    assert any(reason in each for each in found.reasons), found.reasons


@pytest.mark.parametrize("fall", [0.002, 0.005, 0.009, 0.02, 0.2])
def test_no_fit_is_good_when_structure_fell(fall):
    frames = (frame("background", 0.5, 0.9, 30.0), frame("final", 0.9, 0.9 - fall, 25.0))
    found = fit_verdict(calibration(frames=frames))
    assert found.word != "good"
    assert "structure correlation 0.90" in found.reasons[0]


def test_light_without_transport_has_no_groups_to_judge():
    light = DirectionalLight.of(DESIGN, "diffuse")
    transfer = np.array([[0.3, 0.2], [0.4, 0.1], [0.2, 0.2]])
    assert fit_verdict(calibration(model=light, transfer=transfer)).word == "good"


@pytest.mark.slow
def test_the_page_holds_in_a_browser(tmp_path):
    found = calibration()
    residual = write_figure(residual_plot(found), tmp_path / "residual.png")
    page = calibration_report(
        found, fit_verdict(found), tmp_path / "report.html", design="out/calibrated.toml", residual=residual
    )
    text = page.read_text("utf-8")
    assert "On 1 held-out frame the structure correlation goes from 0.60 to 0.90" in text
    assert "designlab gap diagnose MEASUREMENT --model out/calibrated.toml" in text
    with opened() as browser:
        assert faults(browser, page) == []
