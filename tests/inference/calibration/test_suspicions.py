"""Usual faults of pictures are named, with cause and remedy; correct sets are never accused."""

import functools

import numpy as np
import pytest

from designlab.app import cli
from designlab.core.images import to_srgb
from designlab.inference.calibration import calibrate
from designlab.inference.calibration.imaging import Rendered
from designlab.inference.calibration.problem import Problem
from designlab.inference.calibration.suspicions import faults, picture
from designlab.measurement import (
    MeasuredFrame,
    Measurement,
    MeasurementError,
    check,
    load_measurement,
    refuse,
)
from designlab.measurement import write_measurement as write
from designlab.measurement.shots import observe
from designlab.sensor.design import preset
from designlab.validation.synthetic import plant

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


def spoilt(measurement, folder, change, *, files=None, **fields):
    """Write the set anew with its pictures changed, or those of some files."""
    images = {
        frame.file: np.ascontiguousarray(
            change(measurement.image(frame))
            if files is None or frame.file in files
            else measurement.image(frame)
        ).astype(np.float32)
        for frame in measurement.frames
    }
    return load_measurement(write(measurement.model_copy(update=fields), images, folder))


class Examined:
    """A set simulated once; faults are looked for in it as it is, and spoilt."""

    def __init__(self, measurement, design):
        self.seen = observe(measurement, design, columns=COLUMNS)
        problem = Problem(Rendered(design, 32), self.seen.shots, (), seed=0)
        self.bases = problem.bases(problem.start(), range(len(self.seen.shots)))
        flux = np.array([group.flux_mw for group in design.leds.groups])
        self.transfer = design.mixing_matrix * flux
        self.design = design

    def faults(self, measurement, response="linear"):
        seen = observe(measurement, self.design, columns=COLUMNS)
        pictures = [picture(shot, shot.lit, self.bases[n]) for n, shot in enumerate(seen.shots)]
        return faults(pictures, seen.black_level, self.transfer, response)


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
        (found,) = examined(name).faults(spoilt(planted(name), tmp_path / "m", change))
        assert (found.name, found.strong) == (expected, True)
        assert set(found.files) == {f.file for f in planted(name).frames if f.lit}
        said = {"bgr": "hold BGR", "gbr": "hold GBR", "half": "180 deg", "srgb": "sRGB"}
        assert said.get(fault, "mirrored") in found.cause

    @pytest.mark.parametrize("fault", FAULTS)
    def test_a_fault_of_one_press_is_named_with_its_file(self, planted, examined, tmp_path, name, fault):
        expected, change = FAULTS[fault]
        file = next(f.file for f in planted(name).frames if (f.probe or "").startswith("triangle"))
        (found,) = examined(name).faults(spoilt(planted(name), tmp_path / "m", change, files={file}))
        assert (found.name, found.files) == (expected, (file,))

    def test_linear_pictures_declared_srgb_are_named(self, planted, examined, tmp_path, name):
        wrong = spoilt(planted(name), tmp_path / "m", lambda image: np.maximum(image, 0.0), response="srgb")
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
    swapped = spoilt(measurement, tmp_path / "m", lambda image: image[..., order], files={file})
    assert examined(NAMES[0]).faults(swapped) == ()
    order = list(np.roll([0, 1, 2], 1))
    swapped = spoilt(measurement, tmp_path / "n", lambda image: image[..., order], files={file})
    (found,) = examined(NAMES[0]).faults(swapped)
    assert (found.name, found.files) == ("channels", (file,))


@pytest.mark.renders
@pytest.mark.parametrize("green", [1.0, 1.6])
def test_a_swapped_press_is_found_whichever_channel_is_brightest(planted, examined, tmp_path, green):
    """OpenCV's order leaves green in its place."""
    factor = np.array([1.0, green, 1.0], np.float32)
    brighter = spoilt(planted(NAMES[0]), tmp_path / "m", lambda image: image * factor)
    file = next(f.file for f in brighter.frames if (f.probe or "").startswith("triangle"))
    swapped = spoilt(brighter, tmp_path / "n", lambda image: image[..., ::-1], files={file})
    (found,) = examined(NAMES[0]).faults(swapped)
    assert (found.name, found.files) == ("channels", (file,))


@pytest.mark.renders
def test_noise_and_other_light_powers_are_no_fault(planted, examined, tmp_path):
    """Channels 30 % brighter and dimmer, noise of 2 % of full scale."""
    rng = np.random.default_rng(5)
    gains = np.array([1.3, 0.7, 1.0])
    noisy = spoilt(
        planted(NAMES[0]),
        tmp_path / "m",
        lambda image: image * gains + 0.02 * rng.standard_normal(image.shape),
    )
    assert examined(NAMES[0]).faults(noisy) == ()
    assert check(noisy) == ()


def smooth(low, high):
    row, column = np.indices((24, 32)) / 32
    return np.stack([low + (high - low) * each for each in (column, row / 0.75, 1 - column)], axis=-1)


def square(value):
    return np.full((24, 32, 3), value, dtype=np.float32)


class TestWithoutModel:
    """Pictures made by formula."""

    def written(self, folder, frames, images, response="linear", sensor="unknown"):
        measurement = Measurement(sensor=sensor, response=response, frames=tuple(frames))
        return load_measurement(write(measurement, images, folder))

    def test_presses_without_a_pose_are_noted_and_left_out(self, planted, tmp_path):
        correct = planted(NAMES[0])
        press = next(frame for frame in correct.frames if frame.kind == "press")
        lost = press.model_copy(update={"file": "lost.exr", "depth_mm": None, "centre_mm": None})
        images = {frame.file: correct.image(frame) for frame in correct.frames}
        images["lost.exr"] = correct.image(press) * np.float32(1.001)
        both = correct.model_copy(update={"frames": (*correct.frames, lost)})
        (found,) = check(load_measurement(write(both, images, tmp_path / "m")))
        assert (found.name, found.files, found.strong) == ("no_pose", ("lost.exr",), False)
        assert "depth_mm and centre_mm unknown" in found.evidence

    def test_a_set_of_presses_without_any_pose_stops(self, tmp_path):
        frames = [MeasuredFrame(file="a.exr", kind="press", probe="sphere")]
        alone = self.written(tmp_path / "m", frames, {"a.exr": square(0.3)})
        (found,) = check(alone)
        assert found.strong
        assert "probe size and depth_mm and centre_mm" in found.evidence
        with pytest.raises(MeasurementError, match=r"no_pose: a\.exr: .*remedy: .*--trust no_pose"):
            refuse(alone, check(alone))
        assert refuse(alone, check(alone), ["no_pose"])[0].startswith("trusted although no_pose")

    @pytest.mark.parametrize(("share", "named"), [(0.02, False), (0.2, True)])
    def test_saturation_is_refused_from_a_twentieth_of_a_channel(self, tmp_path, share, named):
        image = np.random.default_rng(0).uniform(0.2, 0.9, (50, 60, 3)).astype(np.float32)
        image.reshape(-1, 3)[: int(share * 3000), 1] = 1.0
        found = check(
            self.written(tmp_path / "m", [MeasuredFrame(file="a.exr", kind="background")], {"a.exr": image})
        )
        assert [each.name for each in found] == ["saturated"] * named
        if named:
            assert "20.0% of the pixels of green" in found[0].evidence

    def test_floating_point_numbers_in_another_unit_are_no_long_exposure(self, tmp_path):
        image = np.random.default_rng(0).uniform(0.2, 9.0, (50, 60, 3)).astype(np.float32)
        (found,) = check(
            self.written(tmp_path / "m", [MeasuredFrame(file="a.exr", kind="background")], {"a.exr": image})
        )
        assert "a unit of its own" in found.cause
        assert "full scale is 1" in found.remedy

    def test_values_cut_below_full_scale_are_saturated_too(self, tmp_path):
        row, column = np.indices((60, 80)) / 60
        smooth = (0.9 - 1.2 * (row - 0.5) ** 2 - 0.9 * (column - 0.6) ** 2)[..., None] * np.ones(3)
        frames = [MeasuredFrame(file="a.tif", kind="background")]

        def counts(image):  # 10 bits in a file of 16
            return np.round(image * 1023).astype(np.uint16)

        whole = self.written(tmp_path / "whole", frames, {"a.tif": counts(smooth)})
        assert check(whole) == ()
        cut = self.written(tmp_path / "cut", frames, {"a.tif": counts(np.minimum(smooth, 0.87))})
        (found,) = check(cut)
        assert found.name == "saturated"
        assert "one highest value" in found.evidence

    @pytest.mark.parametrize(
        ("true", "declared", "dark"),
        [
            ("srgb", "linear", True),
            ("linear", "srgb", True),
            ("linear", "srgb", False),
            ("linear", "linear", True),
            ("linear", "linear", False),
        ],
    )
    def test_lights_that_do_not_add_up_tell_the_response(self, tmp_path, true, declared, dark):
        rng = np.random.default_rng(2)
        column = np.linspace(0.0, 1.0, 32)
        shapes = [1.2 - column, 0.2 + column, 0.6 + 0.4 * np.sin(6 * column)]
        mixing = np.array([[0.25, 0.08, 0.04], [0.1, 0.2, 0.1], [0.03, 0.1, 0.3]])
        single = [
            np.tile(shape[None, :, None] * mixing[:, group], (24, 1, 1)) for group, shape in enumerate(shapes)
        ]
        scenes = {"all": sum(single), **dict(zip(("red", "green", "blue"), single, strict=True))}
        kinds = [MeasuredFrame(file="all.exr", kind="background")]
        kinds += [
            MeasuredFrame(file=f"{n}.exr", kind="background", leds=(n,)) for n in ("red", "green", "blue")
        ]
        if dark:
            scenes["dark"] = np.zeros((24, 32, 3))
            kinds.append(MeasuredFrame(file="dark.exr", kind="dark"))
        encode = to_srgb if true == "srgb" else np.asarray
        images = {
            f"{name}.exr": encode(np.maximum(scene + 0.02 + 0.002 * rng.standard_normal(scene.shape), 0))
            for name, scene in scenes.items()
        }
        small = preset(NAMES[0]).replace({"camera.width_px": 32, "camera.height_px": 24})
        from designlab.sensor.design import dumps

        (tmp_path / "sensor.toml").write_text(dumps(small), encoding="utf-8")
        found = check(
            self.written(tmp_path / "m", kinds, images, declared, sensor=str(tmp_path / "sensor.toml"))
        )
        assert [each.name for each in found] == ["nonlinear"] * (true != declared)
        if found:
            assert f'response = "{true}"' in found[0].remedy

    @pytest.mark.parametrize("true", ["srgb", "linear"])
    def test_an_exposure_ladder_tells_the_response(self, tmp_path, true):
        scene = smooth(0.05, 0.2)
        encode = to_srgb if true == "srgb" else np.asarray
        frames = [MeasuredFrame(file=f"{e}.exr", kind="background", exposure=e) for e in (1, 4)]
        images = {f"{e}.exr": encode(scene * e) for e in (1, 4)}
        found = check(self.written(tmp_path / "m", frames, images))
        assert [each.name for each in found] == ["nonlinear"] * (true == "srgb")

    @pytest.mark.parametrize(("error", "strong"), [(0.12, None), (0.25, False), (1.0, True)])
    def test_light_that_does_not_add_up_with_any_response_is_named(self, tmp_path, error, strong):
        """A ladder of 4 whose long picture is brighter than stated; a tenth is left to lamps and shutters."""
        scene = smooth(0.05, 0.1)
        frames = [MeasuredFrame(file="dark.exr", kind="dark")]
        frames += [MeasuredFrame(file=f"{e}.exr", kind="background", exposure=e) for e in (1, 4)]
        images = {"dark.exr": 0 * scene, "1.exr": scene, "4.exr": 4 * scene * (1 + error)}
        found = check(self.written(tmp_path / "m", frames, images))
        assert [(each.name, each.strong) for each in found] == [("not_additive", strong)] * (
            strong is not None
        )

    def test_a_colour_matrix_that_cuts_at_zero_is_noted(self, tmp_path):
        design = preset(NAMES[0])
        effects = {"colour_mixing": {"G_from_red": -0.3, "B_from_green": -0.3}}
        plant(
            design, effects=effects, out=tmp_path / "m", seed=1, presses=PRESSES[:1], columns=24, kit="small"
        )
        (found,) = check(load_measurement(tmp_path / "m"))
        assert (found.name, found.strong) == ("not_additive", False)
        assert "colour matrix" in found.cause

    @pytest.mark.slow
    @pytest.mark.parametrize(
        ("shape", "cause"),
        [
            ((40, 30), "turned by 90 deg"),
            ((30, 30), "a part of the sensor was saved"),
            ((3000, 4000), "enlarged, or comes from another camera"),
        ],
    )
    def test_the_cause_of_a_wrong_size_is_said(self, tmp_path, shape, cause):
        image = np.full((*shape, 3), 0.3, dtype=np.float16)
        frames = [MeasuredFrame(file="a.exr", kind="background")]
        with pytest.raises(MeasurementError, match=rf"frame 1 \(a\.exr\): field file.*{cause}.*remedy"):
            self.written(tmp_path / "m", frames, {"a.exr": image}, sensor=NAMES[0])
        unknown = self.written(tmp_path / "unknown", frames, {"a.exr": image})
        with pytest.raises(MeasurementError, match=cause):
            check(unknown, preset(NAMES[0]))

    def test_what_is_trusted_has_a_name(self, planted):
        with pytest.raises(ValueError, match="trust: one of no_pose, damaged"):
            refuse(planted(NAMES[0]), (), ["everything"])


class TestCalibrate:
    @pytest.mark.renders
    def test_swapped_channels_stop_the_command_with_two(self, planted, tmp_path, capsys):
        wrong = spoilt(planted(NAMES[0]), tmp_path / "m", FAULTS["bgr"][1])
        words = ["calibrate", str(wrong.folder), "--model", NAMES[0], "--out", str(tmp_path / "out")]
        assert cli.main([*words, "--columns", str(COLUMNS)]) == 2
        said = capsys.readouterr().err
        assert "channels: background-red.exr" in said
        assert "suspected cause: the files' channels hold BGR" in said
        assert "remedy: " in said
        assert "--trust channels" in said
        assert not (tmp_path / "out").exists()

    def test_a_saturated_picture_stops_the_command_with_two(self, planted, tmp_path, capsys):
        correct = planted(NAMES[0])
        wrong = spoilt(
            correct, tmp_path / "m", lambda image: np.minimum(9 * image, 1), files={correct.frames[5].file}
        )
        words = ["calibrate", str(wrong.folder), "--model", NAMES[0], "--out", str(tmp_path / "out")]
        assert cli.main(words) == 2
        assert f"saturated: {correct.frames[5].file}: " in capsys.readouterr().err

    @pytest.mark.renders
    def test_what_is_trusted_is_noted(self, planted, tmp_path):
        wrong = spoilt(planted(NAMES[0]), tmp_path / "m", FAULTS["bgr"][1])
        kept = [f for f in wrong.frames if f.kind == "background" and f.leds is None][:1]
        few = wrong.model_copy(update={"frames": tuple(kept)})
        found = calibrate(few, preset(NAMES[0]), columns=32, samples=16, free=(), trust=("channels",))
        assert any(note.startswith("trusted although channels: ") for note in found.notes)
        with pytest.raises(MeasurementError, match="channels"):
            calibrate(few, preset(NAMES[0]), columns=32, samples=16, free=())
