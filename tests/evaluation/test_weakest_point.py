"""The worst place and its reason, on maps in which the fault is planted."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.evaluation.weakest_point import GelMaps, PressMaps, worst_of_gel, worst_of_presses

X, Y = np.meshgrid(np.linspace(-8, 8, 129), np.linspace(6, -6, 97))
NAMES = ("red", "green", "blue")
AT = (4.0, -3.0)
NEAR = np.hypot(X - AT[0], Y - AT[1]) < 1.5
FAULT = np.exp(-((X - AT[0]) ** 2 + (Y - AT[1]) ** 2) / 2.0)  # of 1 mm width
AZIMUTHS = np.radians([90.0, 210.0, 330.0])


def gel(*, level=1.0, slant_deg=60.0, stray=0.0, light=None):
    """Three channels, each lit by its own distant light, with photon noise."""
    light = np.ones((*X.shape, 3)) if light is None else light
    membrane = 0.4 * np.broadcast_to(level, X.shape)[..., None] * light
    along = np.tan(np.radians(np.broadcast_to(slant_deg, X.shape)))[..., None]
    response = membrane[..., None] * (
        -along[..., None] * np.stack([np.cos(AZIMUTHS), np.sin(AZIMUTHS)], axis=-1)
    )
    veil = np.broadcast_to(stray, X.shape)[..., None] * 0.4 * np.ones(3)
    signal = membrane + veil
    everywhere = np.ones(X.shape, dtype=bool)
    return GelMaps(
        x_mm=X, y_mm=Y, area=everywhere, seen=everywhere, saturated=signal.max(axis=-1) >= 1,
        light=light / light.mean(axis=(0, 1)), signal=signal, stray=veil,
        sigma=np.sqrt(signal / 10000 + 1e-6), response=response,
    )  # fmt: skip


def one_dark_group():
    light = np.ones((*X.shape, 3))
    light[..., 1] -= 0.97 * FAULT
    return light


@pytest.mark.parametrize(
    ("maps", "reason", "detail"),
    [
        (gel(level=1 - 0.8 * FAULT), "dark", ""),
        (gel(slant_deg=60 - 40 * FAULT), "flat response", ""),
        (gel(stray=1.5 * FAULT, level=0.5), "stray light", ""),
        (gel(light=one_dark_group()), "shadowed", "green"),
        (gel(level=1 + 3 * FAULT), "saturated", ""),
        (replace(gel(), seen=~NEAR), "out of view", ""),
    ],
    ids=["dark", "flat", "stray", "shadowed", "saturated", "unseen"],
)
def test_the_planted_fault_is_found_and_named(maps, reason, detail):
    place = worst_of_gel(maps, NAMES)
    assert (place.reason, place.detail) == (reason, detail)
    assert np.hypot(place.x_mm - AT[0], place.y_mm - AT[1]) < 0.3
    assert place.times > 1.25


def test_an_even_gel_has_no_worst_place():
    place = worst_of_gel(gel(level=1 - 0.1 * FAULT), NAMES)
    assert place.reason == "even"
    assert 1 <= place.times < 1.25


def test_what_lies_outside_the_sensing_area_does_not_count():
    inside = (np.abs(X) < 2) & (np.abs(Y) < 2)
    assert worst_of_gel(replace(gel(level=1 - 0.8 * FAULT), area=inside), NAMES).reason == "even"
    with pytest.raises(ValueError, match="must see some of the sensing area"):
        worst_of_gel(replace(gel(), seen=np.zeros_like(inside)), NAMES)


def test_the_factors_multiply_to_the_limit():
    maps = gel(level=1 - 0.5 * FAULT, slant_deg=60 - 20 * FAULT, stray=0.2 * FAULT)
    product = np.prod(list(maps.factors().values()), axis=0)
    ratio = product / maps.limit_deg
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-9)


def press(**changes):
    """A contact of 3 mm around the fault, with an error of 2 deg that rises to 12 deg there."""
    content = {
        "error_deg": 2 + 10 * FAULT,
        "region": np.hypot(X - AT[0], Y - AT[1]) < 3,
        "saturated": np.zeros(X.shape, dtype=bool),
        "light": np.ones((*X.shape, 3)),
        "slope": np.full(X.shape, 0.2),
        "facing": np.ones(X.shape),
        "name": "star:6",
    }
    return PressMaps(**(content | changes))


def shaded():
    light = np.ones((*X.shape, 3))
    light[..., 2] -= 0.95 * NEAR
    return light


@pytest.mark.parametrize(
    ("changes", "maps", "reason", "detail"),
    [
        ({"saturated": NEAR}, gel(), "saturated", "star:6"),
        ({"facing": 1 - 0.99 * FAULT}, gel(), "out of view", "star:6"),
        ({"light": shaded()}, gel(), "shadowed", "star:6, blue"),
        ({"slope": 0.2 + 0.8 * FAULT}, gel(), "steep", "star:6"),
        ({}, gel(level=1 - 0.8 * FAULT), "dark", "star:6"),
        ({}, gel(slant_deg=60 - 40 * FAULT), "flat response", "star:6"),
        ({}, gel(stray=1.8 * FAULT, level=0.3), "stray light", "star:6"),
        ({}, gel(), "calibration", "star:6"),
    ],
    ids=["saturated", "hidden", "shadowed", "steep", "dark", "flat", "stray", "calibration"],
)
def test_the_reason_for_the_greatest_error_of_a_press(changes, maps, reason, detail):
    good = press(error_deg=np.full(X.shape, 1.0), name="sphere:4")
    place = worst_of_presses([good, press(**changes), good], maps, NAMES, steepest=0.6)
    assert (place.reason, place.detail, place.press) == (reason, detail, 1)
    assert np.hypot(place.x_mm - AT[0], place.y_mm - AT[1]) < 0.3
    assert 9 < place.value_deg < 12
