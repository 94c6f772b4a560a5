"""Patterns of the sensor, bands and the grain of the simulation, told from one another."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.inference.diagnosis.emulator.forward import Forward
from designlab.inference.diagnosis.emulator.rendering import fill
from designlab.inference.diagnosis.emulator.snapshots import Bank
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter, with_strength
from designlab.inference.diagnosis.likelihood.fixed_pattern import (
    found_pattern,
    in_few_places,
    in_few_waves,
)
from designlab.inference.diagnosis.likelihood.monte_carlo_noise import monte_carlo_noise
from designlab.inference.diagnosis.likelihood.noise import DARK_LIGHT
from designlab.inference.diagnosis.selection.criterion import MOST_IN_PLACES, MOST_IN_WAVES
from designlab.inference.diagnosis.selection.forward_selection import ForwardSelection
from designlab.inference.diagnosis.selection.held_out import judge
from designlab.inference.diagnosis.selection.screening import scan_of, with_scanned
from designlab.inference.diagnosis.verdict.intervals import values
from designlab.simulation.effects import SensorModel, effect
from tests.helpers.small_sensor import DESIGN, GAINS, VIEW, applied, seeing, shots

pytestmark = pytest.mark.renders


@pytest.fixture(scope="module")
def bank(renders) -> Bank:
    return fill(renders, SensorModel.of(DESIGN), shots(SensorModel.of(DESIGN))[:4], ["vignetting"])


def test_the_strength_of_a_pattern_lies_in_its_interval(bank) -> None:
    pattern = 0.008 * np.random.default_rng(4).standard_normal(bank.shots[0].signal.shape)
    dirty = tuple(replace(shot, signal=shot.signal * (1 + pattern)) for shot in bank.shots)
    fitter = Fitter(replace(bank, shots=dirty))
    train = [0, 1, 2]
    start = fitter.fit(fitter.start(train), (), train)
    fitter.measure(start.state)
    found = found_pattern(fitter, start.state, train)
    state = start.state.with_pattern("fixed_pattern", found.values, found.rms)
    value = values(fitter, replace(start, state=state), "fixed_pattern", train)["rms"]
    assert value.low < 0.008 < value.high
    assert value.low > 0.5 * 0.008
    assert value.high < 2 * 0.008
    assert value.value == pytest.approx(0.008, rel=0.1)


@pytest.mark.parametrize("pitch_px", [3.3, 2.4])
def test_a_pattern_of_few_waves_is_not_taken_for_the_sensors_own(bank, pitch_px) -> None:
    noise = np.random.default_rng(4).standard_normal(bank.shots[0].signal.shape)
    rows, columns = noise.shape[:2]
    waves = np.sin(2 * np.pi * (np.arange(columns) + 0.4 * np.arange(rows)[:, None]) / pitch_px)
    assert in_few_waves(noise) == pytest.approx(0.09, abs=0.02)
    assert in_few_waves(noise + 0.1 * waves[..., None]) < MOST_IN_WAVES
    assert in_few_waves(waves[..., None] + 0.1 * noise) > 2 * MOST_IN_WAVES

    moire = tuple(replace(shot, signal=shot.signal * (1 + 0.01 * waves[..., None])) for shot in bank.shots)
    fitter = Fitter(replace(bank, shots=moire))
    start = fitter.fit(fitter.start([0, 1, 2]), (), [0, 1, 2]).state
    fitter.measure(start)
    search = ForwardSelection(fitter, ["fixed_pattern"], [0, 1, 2], [3])
    search.run(start)
    assert not search.winners
    assert "in few waves" in next(c.outcome for c in search.tried if c.name == "fixed_pattern")


def test_a_wavy_gel_is_no_fine_pattern(bank) -> None:
    """What is smooth over some pixels is no pattern of the sensor, however strong."""
    rows, columns = bank.shots[0].signal.shape[:2]
    across, down = (np.arange(count) / count for count in (columns, rows))
    wave = 0.004 * np.cos(6 * np.pi * across) * np.cos(5 * np.pi * down)[:, None]
    wavy = tuple(replace(shot, signal=shot.signal * (1 + wave[..., None])) for shot in bank.shots)
    fitter = Fitter(replace(bank, shots=wavy))
    start = fitter.fit(fitter.start([0, 1, 2]), (), [0, 1, 2]).state
    fitter.measure(start)
    assert found_pattern(fitter, start, [0, 1, 2]).evidence < 0


def test_strength_and_period_of_bands_lie_in_their_intervals(bank) -> None:
    period, amplitude, train = scan_of("banding").values[60], 0.015, [0, 1, 2]
    phases = (0.3, 2.0, 4.1)
    waves = effect("banding").waves(bank.shots[0].view, {"period_rows": period})
    shots = [
        replace(
            shot,
            signal=shot.signal
            * (1 + amplitude * np.tensordot([np.cos(p), np.sin(p)], waves, axes=1))[..., None],
        )
        for shot, p in zip(bank.shots, phases, strict=False)
    ]
    fitter = Fitter(replace(bank, shots=(*shots, *bank.shots[3:])))
    state = fitter.start(train)
    state = state.with_values("banding", {"amplitude": 0.0, "period_rows": 1.01 * period})
    fit = fitter.fit(state, ["banding"], train)
    fit = replace(fit, state=with_strength(fit.state, "banding"))
    found = values(fitter, fit, "banding", train)
    assert found["amplitude"].low < amplitude < found["amplitude"].high
    assert found["amplitude"].high < 1.6 * amplitude
    assert found["period_rows"].low < period < found["period_rows"].high
    assert found["period_rows"].high < 1.2 * period


def test_a_slope_of_brightness_is_no_long_wave(bank) -> None:
    """Of a sensor of few rows, the longest bands of large ones would be slopes."""
    train, view = [0, 1, 2], VIEW._replace(height_px=240.0)
    rows = np.linspace(-1, 1, VIEW.rows)[:, None, None]
    tilted = [
        replace(bank.shots[n], view=view, signal=bank.shots[n].signal * (1 + slope * rows))
        for n, slope in zip(train, (0.02, -0.01, 0.015), strict=True)
    ]
    fitter = Fitter(replace(bank, shots=(*tilted, *bank.shots[3:])))
    state = fitter.start(train)
    fitter.measure(state)
    found = with_scanned(fitter, state, "banding", train)
    assert found.values["banding"]["period_rows"] < 1.1 * view.height_px


SHARED, OWN = 0.012, 0.006  # relative grain of all pictures alike, and of each press alone
REPEATS = 8


@pytest.fixture(scope="module")
def grainy(bank) -> Bank:
    """The bank with pictures of light counted in photons; what is measured has no grain."""
    random = np.random.default_rng(5)

    def white() -> np.ndarray:
        return random.standard_normal((REPEATS, *bank.pictures[0].light.shape)) * np.sqrt(REPEATS)

    pictures, shared = [], white()
    for picture in bank.pictures:
        chance = SHARED * shared + (OWN * white() if picture.pose else 0.0)
        mean = chance.mean(axis=0)
        pictures.append(
            replace(picture, light=picture.light * (1 + mean), spread=picture.light * (chance - mean))
        )
    return replace(bank, pictures=tuple(pictures))


def test_grain_of_the_mean_of_repeats_is_told_from_their_spread(grainy) -> None:
    forward, state = Forward(grainy), State(GAINS)
    for number, expected in enumerate([SHARED, *[np.hypot(SHARED, OWN)] * 3]):
        found = monte_carlo_noise(forward, state)[number]
        assert found is not None
        light = forward.predict(state, number)
        ratio = np.sqrt((found.sigma**2).mean() / (light**2).mean())
        assert ratio == pytest.approx(expected, rel=0.08)
        # Errors are relative to the light, but where it is dark.
        expected_shared = SHARED**2 * (light**2 / (light**2 + DARK_LIGHT**2)).mean(axis=(0, 1))
        np.testing.assert_allclose(found.shared, expected_shared, rtol=0.1)
        assert found.power.mean() == pytest.approx(1.0)
        assert found.power[:8, :8].mean() == pytest.approx(1.0, rel=0.2)  # it is white


def test_pictures_taken_once_have_no_grain_to_tell(bank) -> None:
    assert monte_carlo_noise(Forward(bank), State(GAINS)) == [None] * len(bank.shots)


def test_grain_of_the_simulation_is_no_pattern_of_the_sensor(grainy) -> None:
    train = [0, 1, 2]
    blind = Fitter(replace(grainy, pictures=tuple(replace(p, spread=None) for p in grainy.pictures)))
    assert found_pattern(blind, blind.fit(blind.start(train), (), train).state, train).evidence > 10
    fitter = Fitter(grainy)
    start = fitter.fit(fitter.start(train), (), train)
    assert found_pattern(fitter, start.state, train).evidence < 0
    left = judge(fitter, start, [3])
    assert left.mean < 1.3 * left.floor.mean()


def test_an_effect_is_found_through_grain(grainy) -> None:
    fitter, train = seeing(grainy, applied("vignetting")), [0, 1, 2]
    fit = fitter.fit(fitter.start(train), ["vignetting"], train)
    found = values(fitter, fit, "vignetting", train)["corner_loss"]
    assert 0.2 < found.low < 0.5 < found.high < 0.8


def test_a_reflection_lies_in_few_places_and_noise_does_not():
    noise = np.random.default_rng(1).standard_normal((60, 80, 3))
    spots = np.zeros_like(noise)
    spots[20:24, 30:35] = 20.0
    assert in_few_places(noise) == pytest.approx(0.09, abs=0.02)
    assert in_few_places(noise + 0.05 * spots) < MOST_IN_PLACES
    assert in_few_places(spots + 0.5 * noise) > 2 * MOST_IN_PLACES
