"""Changes between the untouched gel and a press, and pictures of other sensors."""

from contextlib import contextmanager

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from designlab.reconstruction.drift import Untouched, drift_between
from designlab.reconstruction.reconstructor import Reconstructor
from tests.helpers.ball_pictures import UNTOUCHED, coin, of_other_sensor, pressed, pressed_twice
from tests.reconstruction.test_lab import SHAPE, slopes

GAINS = [(1.1, 1.1, 1.1), (0.85, 0.85, 0.85), (1.08, 1.0, 0.92), (1.0, 1.0, 0.94)]
GRAIN = gaussian_filter(np.random.default_rng(0).normal(size=SHAPE), 1.0)[..., None] * 0.1


@contextmanager
def warnings_or_refusal():
    said = []
    try:
        yield said
    except ValueError as error:
        said.append(str(error))


@pytest.fixture(scope="module")
def both(calibration_file):
    return {mode: Reconstructor.load(calibration_file, mode=mode) for mode in ("accurate", "video")}


@pytest.mark.parametrize("gain", GAINS)
@pytest.mark.parametrize("contact_px", [0.0, 8.0, 16.0])
def test_brightness_and_white_balance_are_found_beside_a_press(gain, contact_px):
    image = pressed(contact_px=contact_px) if contact_px else UNTOUCHED
    noise = 0.005 * np.random.default_rng(1).normal(size=image.shape)
    found = drift_between(Untouched.of(UNTOUCHED), image * np.array(gain) + noise, place=False)
    assert found.known
    np.testing.assert_allclose(found.gain, gain, atol=0.012)
    assert max(found.gain_error) < 0.01


@pytest.mark.parametrize("gain", GAINS)
@pytest.mark.parametrize("dots", [False, True])
def test_brightness_is_found_in_a_large_picture(gain, dots):
    """Of 480 x 640 pixels, of which dots that may be left out hide a part, and a press another."""
    rows, columns = np.indices((480, 640))
    untouched = (0.5 + 0.2 * columns / 640)[..., None] * np.ones(3)
    image = untouched * np.array(gain) + 0.005 * np.random.default_rng(3).normal(size=untouched.shape)
    image[100:300, 150:400] *= (1.5, 0.7, 1.1)
    hidden = np.hypot(rows % 40 - 20, columns % 40 - 20) < 4
    image[hidden] *= 0.1 if dots else 1.0
    found = drift_between(Untouched.of(untouched), image, place=False, free=~hidden if dots else None)
    assert found.known
    np.testing.assert_allclose(found.gain, gain, atol=0.005)
    assert found.untouched == pytest.approx(1 - 200 * 250 / (480 * 640), abs=0.03)


@pytest.mark.parametrize(("right", "up"), [(3, 0), (-2, 5), (0, -4)])
def test_a_gel_that_moves_is_found_beside_a_press(right, up):
    textured = UNTOUCHED * (1 + GRAIN)
    image = np.roll(pressed() * (1 + GRAIN), (-up, right), axis=(0, 1))
    assert drift_between(Untouched.of(textured), image).shift_px == (right, up)
    assert drift_between(Untouched.of(textured), pressed() * (1 + GRAIN)).shift_px == (0, 0)
    smooth = drift_between(Untouched.of(UNTOUCHED), pressed() + 0.002 * GRAIN[::-1])
    assert smooth.shift_px in (None, (0, 0))


@pytest.mark.parametrize("share", [0.0, 0.05, 0.1])
def test_what_too_little_of_the_gel_tells_is_not_known(share):
    image = UNTOUCHED * np.random.default_rng(2).uniform(0.5, 1.5, size=(*SHAPE, 1)).astype(np.float32)
    image = np.kron(image[::10, ::10], np.ones((10, 10, 1)))[: SHAPE[0], : SHAPE[1]]
    image[: int(share * SHAPE[0])] = UNTOUCHED[: int(share * SHAPE[0])]
    found = drift_between(Untouched.of(UNTOUCHED), image, place=False)
    assert not found.known
    assert found.plain()["gain"] is None


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["accurate", "video"])
@pytest.mark.parametrize("gain", GAINS)
def test_a_change_of_exposure_or_white_balance_is_corrected_and_said(both, mode, gain):
    as_usual = both[mode](pressed(), pressure=False)
    drifted = both[mode](np.clip(pressed() * np.array(gain), 0, 1), pressure=False)
    assert drifted.depth_mm == pytest.approx(as_usual.depth_mm, rel=0.05)
    assert any("this is corrected" in text for text in drifted.warnings), drifted.warnings
    assert as_usual.warnings == ()


@pytest.mark.slow
@pytest.mark.faults
@pytest.mark.parametrize("mode", ["accurate", "video"])
@pytest.mark.parametrize(
    "sensor",
    [
        {"turned_deg": 180.0, "gradient": 2.0},
        {"turned_deg": 60.0, "colours": ((1, 0.3, 0), (0.1, 0.5, 0.3), (0, 0.2, 0.8)), "gradient": 1.5},
        {"colours": ((0.33, 0.33, 0.33),) * 3, "gradient": 2.0},
        {"turned_deg": 120.0, "gradient": 1.5},
    ],
)
@pytest.mark.parametrize("object_of", ["coin", "ball"])
def test_a_coin_on_another_sensor_is_refused_or_flagged(both, mode, sensor, object_of):
    p, q = coin(SHAPE) if object_of == "coin" else slopes((60, 60), 14.0)[:2]
    image = of_other_sensor(p, q, **sensor)
    with warnings_or_refusal() as said:
        said += both[mode](image, pressure=False).warnings
    assert any("sensor" in text and ("calibrate" in text or "exposure" in text) for text in said), said


@pytest.mark.slow
@pytest.mark.parametrize(
    "image", [pressed(), pressed((80, 70), 13.0), pressed_twice(((40, 40), 9.0), ((100, 80), 9.0))]
)
def test_presses_on_the_sensor_itself_are_not_taken_for_others(both, image):
    for reconstructor in both.values():
        assert reconstructor(image, pressure=False).warnings == ()
