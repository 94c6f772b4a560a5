"""What is left is measured, and said what it looks like."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import idctn

from designlab.inference.diagnosis.emulator.rendering import fill
from designlab.inference.diagnosis.emulator.snapshots import Bank
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.grain import grain
from designlab.inference.diagnosis.likelihood.noise import LONG_LENGTH, spectrum
from designlab.inference.diagnosis.result import Unexplained
from designlab.inference.diagnosis.selection.held_out import CLOSED, Judged, judge
from designlab.inference.diagnosis.verdict.unexplained import unexplained
from designlab.simulation.effects import SensorModel
from tests.helpers.small_sensor import DESIGN, seeing, shots

pytestmark = pytest.mark.renders

TRAIN, HELD_OUT = [0, 1, 2], [3, 4]


@pytest.fixture(scope="module")
def bank(renders) -> Bank:
    return fill(renders, SensorModel.of(DESIGN), shots(SensorModel.of(DESIGN)), ())


def departing(bank: Bank, *, smooth: float = 0.0, rough: float = 0.0) -> Fitter:
    """Shots of the sensor as it is, but for a smooth departure of all light, and grain of single frames."""
    fitter = seeing(bank, SensorModel.of(DESIGN))
    random = np.random.default_rng(2)
    shape = fitter.bank.shots[0].signal.shape
    power = np.sqrt(spectrum(shape[:2], LONG_LENGTH))
    power[0, 0] = 0.0
    field = idctn(power[..., None] * random.standard_normal(shape), axes=(0, 1), norm="ortho")
    away = 1 + smooth * field / field.std()
    own = [
        replace(shot, signal=shot.signal * (away + rough * random.standard_normal(shape)))
        for shot in fitter.bank.shots
    ]
    return fitter.of(replace(fitter.bank, shots=tuple(own)), [])


def ends(fitter: Fitter) -> Judged:
    """Held-out shots, by the sensor as it is, once grain is known."""
    start = fitter.fit(fitter.start(TRAIN), (), TRAIN).state
    fitter.measure(start)
    fitter.grain = grain(fitter, start, [*TRAIN, *HELD_OUT])
    fitter.measure(start)
    fit = fitter.fit(start, (), TRAIN)
    return judge(fitter, fit, HELD_OUT)


def left_of(fitter: Fitter) -> Unexplained:
    judged = ends(fitter)
    return unexplained(fitter, dict.fromkeys(range(5), judged.state), [(judged, judged)])


def test_a_smooth_departure_of_light_is_told_by_its_size(bank) -> None:
    found = left_of(departing(bank, smooth=0.03, rough=0.005))
    assert found.smooth_rms == pytest.approx(0.03, rel=0.35)
    assert found.parts["smooth"] > 0.8
    assert found.grain_rms == pytest.approx(0.005, rel=0.2)
    assert found.share == pytest.approx(1.0)  # no effect was added


def test_a_smooth_departure_without_grain_is_no_error_of_the_light(bank) -> None:
    """Rather an effect is missing, and all of it counts as left."""
    missing = departing(bank, smooth=0.03)
    found = left_of(missing)
    assert found.smooth_rms == found.grain_rms == 0.0
    assert found.parts["smooth"] > 0.8
    assert ends(departing(bank, smooth=0.03, rough=0.005)).excess < CLOSED < ends(missing).excess


def test_grain_of_single_frames_is_told_by_its_size(bank) -> None:
    found = left_of(departing(bank, rough=0.015))
    assert found.grain_rms == pytest.approx(0.015, rel=0.2)
    assert found.parts["grain"] > 0.7
    assert found.smooth_rms < 0.004


def test_one_frame_that_is_wrong_is_named(bank) -> None:
    fitter = departing(bank)
    bad = fitter.bank.shots[2]
    wrong = replace(bad, signal=bad.signal * np.linspace(0.8, 1.2, bad.signal.shape[1])[None, :, None])
    own = [*fitter.bank.shots]
    own[2] = wrong
    found = left_of(fitter.of(replace(fitter.bank, shots=tuple(own)), []))
    assert found.frame == bad.files[0]
