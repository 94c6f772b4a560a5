"""Faults of sets that show without any simulation are named; correct sets pass."""

import numpy as np
import pytest

from designlab.core.images import to_srgb
from designlab.measurement import (
    MeasuredFrame,
    Measurement,
    MeasurementError,
    check,
    load_measurement,
    refuse,
    write_measurement,
)
from designlab.sensor.design import dumps
from tests.helpers.spoilt_sets import DESIGN, PRESSES, changed, planted


def names(measurement):
    return [(each.name, each.files) for each in check(measurement) if each.strong]


def half(image):
    return (np.arange(image.shape[0]) > image.shape[0] / 2)[:, None, None]


class TestFrames:
    """What shows without any simulation."""

    @pytest.mark.slow
    def test_a_blank_picture_and_half_a_picture_are_named(self, whole, tmp_path):
        for number, spoil in enumerate(
            (lambda image: np.full_like(image, 0.3), lambda image: np.where(half(image), 0.5, image))
        ):
            wrong = changed(whole, tmp_path / str(number), files={"press-03.exr"}, pictures=spoil)
            assert ("damaged", ("press-03.exr",)) in names(wrong)

    def test_a_copy_under_another_name_is_named(self, whole, tmp_path):
        first = whole.image(next(f for f in whole.frames if f.file == "background-0.exr"))
        wrong = changed(whole, tmp_path / "m", files={"background-1.exr"}, pictures=lambda image: first)
        assert names(wrong) == [("copied", ("background-0.exr", "background-1.exr"))]

    def test_a_repeat_of_something_else_is_named(self, whole, tmp_path):
        wrong = changed(
            whole, tmp_path / "m", files={"background-1.exr"}, pictures=lambda image: image[:, ::-1]
        )
        assert names(wrong) == [("odd", ("background-1.exr",))]

    def test_printed_markers_are_named(self, tmp_path):
        (found,) = check(planted(tmp_path / "m", outside={"printed_markers": 1.0}, columns=96, presses=[]))
        assert (found.name, found.strong) == ("markers", True)
        # Dots of 0.5 mm every 2 mm on a gel of 18 mm by 14 mm, those at the edge not counted.
        assert 30 <= int(found.evidence.split()[0]) <= 80

    def test_saturated_pictures_are_named(self, whole, tmp_path):
        wrong = changed(whole, tmp_path / "m", pictures=lambda image: np.minimum(12 * image, 1))
        assert "saturated" in [name for name, _ in names(wrong)]


def smooth(low, high):
    row, column = np.indices((24, 32)) / 32
    return np.stack([low + (high - low) * each for each in (column, row / 0.75, 1 - column)], axis=-1)


def square(value):
    return np.full((24, 32, 3), value, dtype=np.float32)


class TestWithoutModel:
    """Pictures made by formula."""

    def written(self, folder, frames, images, response="linear", sensor="unknown"):
        measurement = Measurement(sensor=sensor, response=response, frames=tuple(frames))
        return load_measurement(write_measurement(measurement, images, folder))

    def test_presses_without_a_pose_are_noted_and_left_out(self, whole, tmp_path):
        correct = whole
        press = next(frame for frame in correct.frames if frame.kind == "press")
        lost = press.model_copy(update={"file": "lost.exr", "depth_mm": None, "centre_mm": None})
        images = {frame.file: correct.image(frame) for frame in correct.frames}
        images["lost.exr"] = correct.image(press) * np.float32(1.001)
        both = correct.model_copy(update={"frames": (*correct.frames, lost)})
        (found,) = check(load_measurement(write_measurement(both, images, tmp_path / "m")))
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
        small = DESIGN.replace({"camera.width_px": 32, "camera.height_px": 24})

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
        effects = {"colour_mixing": {"G_from_red": -0.3, "B_from_green": -0.3}}
        (found,) = check(planted(tmp_path / "m", effects, presses=PRESSES[:1], columns=24))
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
            self.written(tmp_path / "m", frames, {"a.exr": image}, sensor=DESIGN.name)
        unknown = self.written(tmp_path / "unknown", frames, {"a.exr": image})
        with pytest.raises(MeasurementError, match=cause):
            check(unknown, DESIGN)

    def test_what_is_trusted_has_a_name(self, whole):
        with pytest.raises(ValueError, match="trust: one of no_pose, damaged"):
            refuse(whole, (), ["everything"])
