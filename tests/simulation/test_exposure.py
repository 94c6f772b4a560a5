"""Exposure time, gain and drive level: proportional up to full scale, by radiometry, refused by name."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from designlab.app.cli import main
from designlab.sensor.design import DesignError, dumps, loads, preset
from designlab.simulation.imaging import Capture, expected, noise_sigma
from designlab.simulation.simulator import exposure, saturation_share

CORE = preset("default")
TIMED = CORE.replace(
    {
        "camera.exposure_time_ms": 2.0,
        "camera.quantum_efficiency": 0.6,
        "camera.aperture_mm": 1.5,
        "camera.sensitivity": "imx219",
    }
)


@pytest.mark.physics
@pytest.mark.parametrize(
    ("changes", "factor"),
    [
        ({"camera.exposure_time_ms": 4.0}, 2.0),
        ({"camera.gain_db": 20 * np.log10(2.0)}, 2.0),
        ({"camera.aperture_mm": 3.0}, 4.0),
        ({"camera.full_well_e": 2 * CORE.camera.full_well_e}, 0.5),
        ({"camera.quantum_efficiency": 0.3}, 0.5),
        ({"camera.width_px": 3280, "camera.height_px": 2464}, 0.25),  # a quarter of the light a pixel
    ],
)
def test_the_signal_goes_with_time_gain_opening_and_pixel(changes, factor):
    changed = TIMED.replace(changes)
    assert changed.fixed_exposure == pytest.approx(factor * TIMED.fixed_exposure, rel=1e-9)


@pytest.mark.physics
def test_the_electrons_of_a_pixel_follow_from_radiometry():
    # One narrow group at 600 nm, seen at 0.5 electrons per photon at the peak of a flat sensitivity.
    flat = {"wavelength_nm": [400, 800], "red": [1, 1], "green": [1, 1], "blue": [1, 1], "per": "photon"}
    design = TIMED.replace(
        {
            "camera.sensitivity": flat,
            "camera.quantum_efficiency": 0.5,
            "leds.groups.0.wavelength_nm": 600.0,
            "leds.groups.0.width_nm": 0.5,
        }
    )
    camera = design.camera
    radiance = 0.3  # mW/mm2/sr of that group
    power_w = 1e-3 * radiance * np.pi * 0.75**2 / (camera.focal_px**2)
    electrons = 0.5 * power_w * 2e-3 * 600e-9 / (6.62607015e-34 * 299792458.0)
    mixed = design.mixing_matrix[0, 0] * radiance
    assert design.fixed_exposure * mixed * camera.full_well_e == pytest.approx(electrons, rel=1e-4)


@pytest.mark.parametrize("drive", [0.25, 0.5, 1.0])
def test_a_drive_level_scales_the_light_of_its_group_alone(drive):
    driven = CORE.replace({"leds.groups.1.drive": drive})
    np.testing.assert_allclose(driven.transfer_mw[:, 1], drive * CORE.transfer_mw[:, 1])
    np.testing.assert_array_equal(driven.transfer_mw[:, [0, 2]], CORE.transfer_mw[:, [0, 2]])


@pytest.mark.parametrize("gain_db", [0.0, 6.0, 20.0])
def test_gain_leaves_fewer_electrons_and_so_more_noise(gain_db):
    camera = CORE.replace(
        {"camera.gain_db": gain_db, "camera.read_noise_e": 0.0, "camera.bit_depth": 16}
    ).camera
    sigma = float(noise_sigma(np.array([0.5]), Capture(camera))[0])
    assert sigma == pytest.approx(np.sqrt(0.5 * 10 ** (gain_db / 20) / camera.full_well_e), rel=1e-3)


@pytest.mark.parametrize("level", [0.2, 0.4, 0.8])
def test_doubling_the_exposure_doubles_the_signal_until_full_scale(level):
    fixed = CORE.replace({"camera.exposure": level})
    twice = CORE.replace({"camera.exposure": 2 * level})
    light = np.linspace(0.0, 1.2, 60).reshape(4, 5, 3)
    one, two = (
        np.clip(expected(light, Capture(d.camera, exposure=exposure(d))), 0.0, 1.0) for d in (fixed, twice)
    )
    np.testing.assert_allclose(two, np.minimum(2 * one, 1.0), rtol=1e-12)


def test_the_saturated_share_counts_pixels_at_full_scale():
    frame = SimpleNamespace(mixed=np.repeat(np.linspace(0.0, 2.0, 100)[None, :, None], 3, axis=2))
    for level, share in ((0.4, 0.0), (1.0, 0.5), (2.0, 0.75)):
        assert saturation_share(CORE.replace({"camera.exposure": level}), frame) == pytest.approx(
            share, abs=0.011
        )
    assert saturation_share(CORE, frame) is None


def test_designs_without_these_fields_keep_digest_and_camera():
    assert "gain" not in repr(CORE.camera)
    assert "drive" not in dumps(CORE)
    assert loads(dumps(TIMED)) == TIMED


@pytest.mark.renders
def test_render_says_and_warns_what_is_saturated(tmp_path, capsys):
    shares = []
    for level in (0.5, 5000.0):
        design = CORE.replace({"camera.exposure": level})
        path = design.save(tmp_path / f"{level}.toml")
        assert main(["render", str(path), "-o", str(tmp_path / "x.png"), "--columns", "40", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        shares.append(found["saturation_share"])
        assert bool(found["warnings"]) == (found["saturation_share"] > 0.001)
    assert shares[0] < 0.001 < shares[1]
    assert "full scale" in found["warnings"][0]


@pytest.mark.faults
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera.exposure": 1.0}, ["exposure_time_ms", "got both"]),
        ({"camera.quantum_efficiency": None}, ["quantum_efficiency", "exposure_time_ms"]),
        ({"camera.aperture_mm": None}, ["aperture_mm", "f_number", "exposure_time_ms"]),
        ({"leds.relative_flux": True}, ["camera.exposure_time_ms", "relative_flux"]),
        ({"camera.exposure_time_ms": -1.0}, ["camera.exposure_time_ms", "-1"]),
        ({"camera.gain_db": -6.0}, ["camera.gain_db", "-6"]),
        ({"leds.groups.0.drive": 1.5}, ["leds.groups.0.drive", "1.5"]),
        ({"leds.groups.0.drive": 0.0}, ["leds.groups.0.drive", "0"]),
    ],
)
def test_what_does_not_go_together_is_refused_by_name(changes, words):
    with pytest.raises(DesignError) as refused:
        TIMED.replace(changes)
    for word in words:
        assert word in str(refused.value)
