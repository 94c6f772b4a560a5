"""Usual faults of pictures are named, with cause and remedy; correct sets are never accused."""

import functools

import numpy as np
import pytest

from designlab.core.images import to_srgb
from designlab.measurement import check, load_measurement
from designlab.measurement.quality.model_check import against_model
from designlab.measurement.shots import observe
from designlab.sensor.design import preset
from designlab.simulation.simulator import Simulator
from designlab.validation.synthetic import plant
from tests.helpers.spoilt_sets import changed

COLUMNS = 32
PRESSES = (
    {"probe": "sphere:5", "depth_mm": 0.5, "centre_mm": (-2.5, 1.5), "yaw_deg": 0.0},
    {"probe": "triangle:5", "depth_mm": 0.5, "centre_mm": (2.0, 1.0), "yaw_deg": 15.0},
)
FAULTS = {
    "srgb": ("nonlinear", lambda image: to_srgb(np.maximum(image, 0.0))),
    "bgr": ("channels", lambda image: image[..., ::-1]),
    "gbr": ("channels", lambda image: image[..., [1, 2, 0]]),
    "left-right": ("mirrored", lambda image: image[:, ::-1]),
    "up-down": ("mirrored", lambda image: image[::-1]),
    "half": ("mirrored", lambda image: image[::-1, ::-1]),
}


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """Sets made by ray casting: poses 0.05 mm off, lights 10 % off, camera noise."""

    @functools.cache
    def make(name, seed=3):
        out = tmp_path_factory.mktemp(name) / "m"
        plant(preset(name), effects={}, out=out, seed=seed, presses=PRESSES, columns=COLUMNS, kit="small")
        return load_measurement(out)

    return make


class Examined:
    """A set simulated once; faults are looked for in it as it is, and spoilt."""

    def __init__(self, measurement, design):
        self.design = design
        self.bases = [
            Simulator(design, view=shot.view, samples=32, seed=0).frame(shot.press).basis.astype(float)
            for shot in observe(measurement, design, columns=COLUMNS).shots
        ]

    def faults(self, measurement, response="linear"):
        seen = observe(measurement, self.design, columns=COLUMNS)
        found = against_model(
            seen.shots,
            self.bases,
            black=seen.black_level,
            transfer=self.design.mixing_matrix * [group.flux_mw for group in self.design.leds.groups],
            response=response,
        )
        assert found.missed.passed == (not found.suspicions)
        return found.suspicions


@pytest.fixture(scope="module")
def examined(planted):
    return functools.cache(lambda name: Examined(planted(name), preset(name)))


NAMES = ("gelsight-2020-flat", "gelsight-2020-dome")


@pytest.mark.renders
@pytest.mark.parametrize("name", NAMES)
class TestFaults:
    def test_a_correct_set_is_not_accused(self, planted, examined, name):
        assert examined(name).faults(planted(name)) == ()
        assert check(planted(name)) == ()

    @pytest.mark.parametrize("fault", FAULTS)
    def test_a_fault_of_all_pictures_is_named(self, planted, examined, tmp_path, name, fault):
        expected, change = FAULTS[fault]
        (found,) = examined(name).faults(changed(planted(name), tmp_path / "m", pictures=change))
        assert (found.name, found.strong) == (expected, True)
        assert set(found.files) == {f.file for f in planted(name).frames if f.lit}
        said = {"bgr": "hold BGR", "gbr": "hold GBR", "half": "180 deg", "srgb": "sRGB"}
        assert said.get(fault, "mirrored") in found.cause

    @pytest.mark.parametrize("fault", FAULTS)
    def test_a_fault_of_one_press_is_named_with_its_file(self, planted, examined, tmp_path, name, fault):
        expected, change = FAULTS[fault]
        file = next(f.file for f in planted(name).frames if (f.probe or "").startswith("triangle"))
        (found,) = examined(name).faults(
            changed(planted(name), tmp_path / "m", pictures=change, files={file})
        )
        assert (found.name, found.files) == (expected, (file,))

    def test_linear_pictures_declared_srgb_are_named(self, planted, examined, tmp_path, name):
        wrong = changed(
            planted(name), tmp_path / "m", pictures=lambda image: np.maximum(image, 0.0), response="srgb"
        )
        (found,) = examined(name).faults(wrong, "srgb")
        assert (found.name, 'response = "linear"' in found.remedy) == ("nonlinear", True)


@pytest.mark.renders
def test_a_wrong_model_is_no_fault_of_the_pictures(planted):
    """Lens 20 % off, kernel five times as long, lights moved: no fault explains what is left."""
    measurement, design = planted(NAMES[0]), preset(NAMES[0])
    fov = design.camera.horizontal_fov_deg
    for changes in (
        {"camera.horizontal_fov_deg": 0.8 * fov},
        {"camera.horizontal_fov_deg": 1.2 * fov, "contact.kernel_length_mm": 0.3},
        {
            "leds.height_mm": design.leds.height_mm + 1.5,
            "leds.tilt_deg": design.leds.tilt_deg + 10,
            "mixing": [[1, 0.45, 0.2], [0.4, 1, 0.45], [0.1, 0.4, 1]],
        },
    ):
        assert Examined(measurement, design.replace(changes)).faults(measurement) == ()


@pytest.mark.renders
def test_the_order_of_channels_is_not_told_by_dim_ones(planted, examined, tmp_path):
    """One LED group lights one channel; the others hold what any small effect puts there."""
    measurement = planted(NAMES[0])
    single = {f.file: f.leds[0] for f in measurement.frames if f.leds is not None and len(f.leds) == 1}
    file, group = next(iter(single.items()))
    bright = ["red", "green", "blue"].index(group)
    dim = [channel for channel in range(3) if channel != bright]
    order = [0, 1, 2]
    order[dim[0]], order[dim[1]] = dim[1], dim[0]
    swapped = changed(measurement, tmp_path / "m", pictures=lambda image: image[..., order], files={file})
    assert examined(NAMES[0]).faults(swapped) == ()
    order = list(np.roll([0, 1, 2], 1))
    swapped = changed(measurement, tmp_path / "n", pictures=lambda image: image[..., order], files={file})
    (found,) = examined(NAMES[0]).faults(swapped)
    assert (found.name, found.files) == ("channels", (file,))


@pytest.mark.renders
@pytest.mark.parametrize("green", [1.0, 1.6])
def test_a_swapped_press_is_found_whichever_channel_is_brightest(planted, examined, tmp_path, green):
    """OpenCV's order leaves green in its place."""
    factor = np.array([1.0, green, 1.0], np.float32)
    brighter = changed(planted(NAMES[0]), tmp_path / "m", pictures=lambda image: image * factor)
    file = next(f.file for f in brighter.frames if (f.probe or "").startswith("triangle"))
    swapped = changed(brighter, tmp_path / "n", pictures=lambda image: image[..., ::-1], files={file})
    (found,) = examined(NAMES[0]).faults(swapped)
    assert (found.name, found.files) == ("channels", (file,))


@pytest.mark.renders
def test_noise_and_other_light_powers_are_no_fault(planted, examined, tmp_path):
    """Channels 30 % brighter and dimmer, noise of 2 % of full scale."""
    rng = np.random.default_rng(5)
    gains = np.array([1.3, 0.7, 1.0])
    noisy = changed(
        planted(NAMES[0]),
        tmp_path / "m",
        pictures=lambda image: image * gains + 0.02 * rng.standard_normal(image.shape),
    )
    assert examined(NAMES[0]).faults(noisy) == ()
    assert check(noisy) == ()
