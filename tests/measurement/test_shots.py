from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.distance import pdist

from designlab.measurement import (
    MeasuredFrame,
    Measurement,
    MeasurementError,
    load_measurement,
    write_measurement,
)
from designlab.measurement.quality.invariants import invariants
from designlab.measurement.shots import Observations, Shot, observe, within
from designlab.measurement.usable_frames import is_single, observe_apart, spread_out
from designlab.sensor.camera import Camera
from designlab.sensor.design import preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.imaging import Capture, noise_sigma, reported
from geometries.probes import parse

DESIGN, ELASTIC = preset("gelsight-2020-flat"), preset("gelsight-2020-flat-elastic")
ROWS, COLUMNS, BINNED = 90, 120, 81.0
CROP = (700, 500, COLUMNS * 9, ROWS * 9)
PLACES = ((-4.0, -3.0), (4.0, -2.0), (0.0, 3.0))


def exposed(level: float, seed: int, camera: Camera = DESIGN.camera) -> np.ndarray:
    """A flat picture with a gradient from left to right, as the camera reports it."""
    ramp = np.broadcast_to(np.linspace(0.5, 1.5, COLUMNS)[None, :, None], (ROWS, COLUMNS, 3))
    return reported(level * ramp, Capture(camera, seed=seed, binned=BINNED))


def measured(
    folder, *, camera: Camera = DESIGN.camera, dark=True, repeats=3, response="linear", extra=(), **over
):
    """A set of pictures with known noise; what they show does not matter here."""
    frames, images = [], {}

    def take(file, level, **fields):
        frames.append(MeasuredFrame.model_validate({"file": file, "crop_px": CROP, **fields}))
        images[file] = exposed(level, seed=len(frames), camera=camera)

    if dark:
        take("dark.exr", 0.0, kind="dark", leds=())
    for repeat in range(repeats):
        take(f"background-{repeat}.exr", 0.2, kind="background", repeat=repeat)
    for number, centre in enumerate(PLACES):
        press = {
            "kind": "press",
            "probe": "sphere:4",
            "depth_mm": 0.5,
            "centre_mm": centre,
            "sigma": {"depth_mm": 0.02, "centre_mm": 0.05},
            "split": ("train", "select", "final")[number],
        }
        take(f"press-{number}.exr", 0.2, **press | over)
    for file, level, fields in extra:
        take(file, level, **fields)
    measurement = Measurement(sensor="gelsight-2020-flat", response=response, frames=tuple(frames))
    return load_measurement(write_measurement(measurement, images, folder))


def test_noise_from_repeats_is_that_of_the_camera(tmp_path) -> None:
    seen = observe(measured(tmp_path / "m"), DESIGN, columns=128)
    background = next(shot for shot in seen.shots if shot.press is None)
    assert seen.noise_source == "repeated frames"
    assert len(background.files) == 3
    stated = (
        noise_sigma(background.signal - DESIGN.camera.black_level, Capture(DESIGN.camera, binned=BINNED)) ** 2
        / 3
    )
    np.testing.assert_allclose(np.median(background.variance / stated), 1.0, rtol=0.05)


def test_noise_without_repeats_is_the_stated_one_and_said_to_be_assumed(tmp_path) -> None:
    seen = observe(measured(tmp_path / "m", repeats=1), DESIGN, columns=128)
    background = next(shot for shot in seen.shots if shot.press is None)
    stated = (
        noise_sigma(background.signal - DESIGN.camera.black_level, Capture(DESIGN.camera, binned=BINNED)) ** 2
    )
    np.testing.assert_allclose(np.median(background.variance / stated), 1.0, rtol=0.05)
    assert any("floor is assumed" in note for note in seen.notes)
    assert not seen.repeats


def test_a_probe_put_there_again_says_nothing_of_noise(tmp_path) -> None:
    """Its place differs by a little, which would pass for noise of the pixels at the edge of the imprint."""
    again = {"kind": "press", "probe": "sphere:4", "depth_mm": 0.5, "centre_mm": PLACES[0], "repeat": 1}
    again |= {"sigma": {"depth_mm": 0.02, "centre_mm": 0.05}, "split": "train"}
    presses = [("press-9.exr", 0.3, again), ("press-8.exr", 0.2, again | {"repeat": 2})]
    seen = observe(measured(tmp_path / "m", repeats=1, extra=presses), DESIGN, columns=128)
    assert not seen.repeats
    with_background = observe(measured(tmp_path / "n", extra=presses), DESIGN, columns=128)
    without = observe(measured(tmp_path / "o"), DESIGN, columns=128)
    background = [next(s for s in o.shots if s.press is None).variance for o in (with_background, without)]
    np.testing.assert_allclose(*background, rtol=0.02)


def test_a_channel_that_is_zero_in_all_repeats_has_the_noise_of_the_camera(tmp_path) -> None:
    whole = measured(tmp_path / "m", dark=False)
    images = {frame.file: np.array(whole.image(frame)) for frame in whole.frames}
    for frame in whole.frames:
        if frame.kind == "background":
            images[frame.file][..., 2] = 0.0
    blank = load_measurement(write_measurement(whole, images, tmp_path / "blank"))
    seen = observe(blank, DESIGN, columns=128)
    assert all(np.isfinite(shot.variance).all() and (shot.variance > 0).all() for shot in seen.shots)


def test_repeats_in_which_a_channel_is_about_dark_can_be_compared(tmp_path) -> None:
    """A tenth of the brightest channel is the limit; one repeat is a little above, the other below."""
    whole = measured(tmp_path / "m", repeats=2)
    images = {frame.file: np.array(whole.image(frame)) for frame in whole.frames}
    images["background-0.exr"][..., 2] *= 0.1002
    images["background-1.exr"][..., 2] *= 0.0998
    dim = load_measurement(write_measurement(whole, images, tmp_path / "dim"))
    (repeats,) = (each for each in invariants(dim, DESIGN) if each.name == "repeats")
    assert repeats.passed


@pytest.mark.parametrize(("probe", "turns"), [("sphere:4", False), ("cone:4", False), ("cylinder:4", True)])
def test_probes_of_revolution_alone_are_not_turned(tmp_path, probe, turns) -> None:
    """The cylinder lies: its imprint is a bar."""
    seen = observe(measured(tmp_path / "m", probe=probe), DESIGN, columns=128)
    assert {shot.pose_sigma[3] > 0 for shot in seen.shots if shot.press is not None} == {turns}


def test_drift_between_repeats_is_not_taken_for_noise(tmp_path) -> None:
    drifted = [("background-9.exr", 0.21, {"kind": "background", "repeat": 9})]
    seen = observe(measured(tmp_path / "m", extra=drifted), DESIGN, columns=128)
    background = next(shot for shot in seen.shots if shot.press is None)
    stated = (
        noise_sigma(background.signal - DESIGN.camera.black_level, Capture(DESIGN.camera, binned=BINNED)) ** 2
        / 4
    )
    np.testing.assert_allclose(np.median(background.variance / stated), 1.0, rtol=0.06)


def test_black_level_is_that_of_the_dark_frame(tmp_path) -> None:
    lifted = DESIGN.camera.model_copy(update={"black_level": 0.06})
    seen = observe(measured(tmp_path / "m", camera=lifted), DESIGN, columns=128)
    np.testing.assert_allclose(seen.black_level, 0.06, atol=2e-5)
    background = next(shot for shot in seen.shots if shot.press is None)
    assert background.signal.mean() == pytest.approx(0.2, rel=1e-3)
    assert not background.clip_sigma.any()


def test_black_level_of_a_camera_that_clips_at_zero_is_zero(tmp_path) -> None:
    seen = observe(measured(tmp_path / "m"), DESIGN, columns=128)
    # Half of the dark values are cut to zero; their mean would be 0.4 standard deviations of the read noise.
    read = DESIGN.camera.read_noise_e / DESIGN.camera.full_well_e / np.sqrt(BINNED)
    assert np.abs(seen.black_level).max() < 0.03 * read


def test_a_channel_without_light_knows_that_it_is_clipped(tmp_path) -> None:
    off = [("unlit.exr", 0.0, {"kind": "background", "leds": ("red",)})]
    seen = observe(measured(tmp_path / "m", extra=off), DESIGN, columns=128)
    unlit = next(shot for shot in seen.shots if shot.files == ("unlit.exr",))
    read = DESIGN.camera.read_noise_e / DESIGN.camera.full_well_e / np.sqrt(BINNED)
    np.testing.assert_allclose(unlit.clip_sigma, read, rtol=0.1)
    np.testing.assert_array_equal(unlit.lit, [1.0, 0.0, 0.0])


def test_saturated_values_are_left_out(tmp_path) -> None:
    bright = [("bright.exr", 0.8, {"kind": "background", "leds": ("green",)})]
    seen = observe(measured(tmp_path / "m", extra=bright), DESIGN, columns=128)
    shot = next(shot for shot in seen.shots if shot.files == ("bright.exr",))
    assert shot.valid[:, :80].all()
    assert not shot.valid[:, 95:].any()  # 0.8 x 1.3 of full scale and more
    assert any("bright.exr" in note and "saturated" in note for note in seen.notes)


def test_frames_are_binned_with_their_noise(tmp_path) -> None:
    measurement = measured(tmp_path / "m")
    whole, coarse = (observe(measurement, DESIGN, columns=columns) for columns in (128, 64))
    first, second = whole.shots[0], coarse.shots[0]
    assert second.signal.shape == (45, 60, 3)
    assert second.view[:4] == first.view[:4]
    np.testing.assert_allclose(second.signal.mean(), first.signal.mean(), rtol=1e-6)
    np.testing.assert_allclose(second.variance.mean(), first.variance.mean() / 4, rtol=1e-6)


def test_a_mask_of_the_files_pixels_holds_in_binned_shots(tmp_path) -> None:
    shots = observe(measured(tmp_path / "m"), DESIGN, columns=COLUMNS // 2).shots
    mask = np.ones((ROWS, COLUMNS), dtype=bool)
    mask[3, 8:11] = False  # of the binned row 1, columns 4 and 5
    for before, after in zip(shots, within(mask, shots), strict=True):
        assert before.valid.all()
        assert np.argwhere(~after.valid[..., 0]).tolist() == [[1, 4], [1, 5]]
        assert (after.valid == after.valid[..., :1]).all()
    assert within(None, shots) is shots
    with pytest.raises(ValueError, match=r"mask: must have the size of background-0\.exr, got \(90, 60\)"):
        within(mask[:, :60], shots)


def test_poses_carry_their_stated_doubt(tmp_path) -> None:
    seen = observe(measured(tmp_path / "m"), DESIGN, columns=128)
    press = next(shot for shot in seen.shots if shot.press)
    np.testing.assert_allclose(press.pose_sigma, [0.05, 0.05, 0.02, 0.0])  # a ball has no yaw


def test_poses_without_stated_doubt_are_noted(tmp_path) -> None:
    seen = observe(measured(tmp_path / "m", sigma=None), DESIGN, columns=128)
    assert any("press-0.exr" in note and "not stated" in note for note in seen.notes)


def test_exposure_scales_the_light(tmp_path) -> None:
    longer = [("longer.exr", 0.4, {"kind": "background", "exposure": 2.0})]
    seen = observe(measured(tmp_path / "m", extra=longer), DESIGN, columns=128)
    shot = next(shot for shot in seen.shots if shot.files == ("longer.exr",))
    np.testing.assert_array_equal(shot.lit, [2.0, 2.0, 2.0])


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"kind": "press", "probe": "sphere", "depth_mm": 0.5, "centre_mm": (1.0, 1.0)}, "size is unknown"),
        ({"kind": "press", "probe": "sphere:4", "centre_mm": (1.0, 1.0)}, "depth_mm: unknown"),
        ({"kind": "press", "probe": "sphere:4", "depth_mm": 0.5}, "centre_mm: unknown"),
        ({"kind": "press", "probe": "sphere:4", "force_n": 2.0, "centre_mm": (1.0, 1.0)}, "knows no force"),
        ({"kind": "background", "gel_rotation_deg": 180.0}, "turned gel"),
        ({"kind": "flat_field"}, "lens and camera alone"),
        ({"kind": "light_probe", "probe": "sphere:4"}, "for calibrate"),
    ],
)
def test_frames_that_cannot_be_compared_are_left_out_by_name(tmp_path, fields, reason) -> None:
    seen = observe(measured(tmp_path / "m", extra=[("odd.exr", 0.2, fields)]), DESIGN, columns=128)
    assert all("odd.exr" not in shot.files for shot in seen.shots)
    assert any("odd.exr: left out" in note and reason in note for note in seen.notes)


class TestForces:
    def shot_of(self, folder, design, **fields):
        at = {"kind": "press", "probe": "sphere:4", "centre_mm": (1.0, 1.0), "split": "train"}
        seen = observe(measured(folder, extra=[("f.exr", 0.2, at | fields)]), design, columns=128)
        return next(shot for shot in seen.shots if "f.exr" in shot.files), seen.notes

    def test_depth_and_force_make_a_press_to_the_depth_with_a_measured_force(self, tmp_path) -> None:
        fields = {"depth_mm": 0.5, "force_n": 2.0, "sigma": {"force_n": 0.1}}
        shot, _ = self.shot_of(tmp_path / "m", ELASTIC, **fields)
        assert (shot.press.depth_mm, shot.press.force_n) == (0.5, None)
        assert (shot.force_n, shot.force_sigma_n) == (2.0, 0.1)

    def test_a_doubt_that_is_not_stated_is_a_share_of_the_force_and_said(self, tmp_path) -> None:
        shot, notes = self.shot_of(tmp_path / "m", ELASTIC, depth_mm=0.5, force_n=2.0)
        assert shot.force_sigma_n == pytest.approx(0.1)
        assert any("f.exr: how well force_n is known" in note for note in notes)

    def test_a_force_alone_makes_a_press_by_force_of_fixed_depth(self, tmp_path) -> None:
        shot, _ = self.shot_of(tmp_path / "m", ELASTIC, force_n=2.0, shear_mm=(0.1, 0.0), twist_deg=3.0)
        assert (shot.press.depth_mm, shot.press.force_n) == (None, 2.0)
        assert (shot.press.shear_mm, shot.press.twist_deg) == ((0.1, 0.0), 3.0)
        assert shot.pose_sigma[2] == 0.0
        assert np.isinf(shot.force_sigma_n)

    def test_the_smoothing_kernel_does_not_use_a_force_and_says_so(self, tmp_path) -> None:
        shot, notes = self.shot_of(tmp_path / "m", DESIGN, depth_mm=0.5, force_n=2.0)
        assert np.isinf(shot.force_sigma_n)
        assert any("f.exr: its force_n is not used" in note for note in notes)

    def test_a_force_of_a_frame_without_contact_is_refused(self) -> None:
        with pytest.raises(ValidationError, match="force_n: is for a press, this one is a background"):
            MeasuredFrame(file="b.exr", kind="background", force_n=1.0)


def test_unknown_response_is_refused(tmp_path) -> None:
    with pytest.raises(MeasurementError, match="field response: must be known"):
        observe(measured(tmp_path / "m", response="unknown"), DESIGN, columns=128)


def test_too_few_places_are_refused(tmp_path) -> None:
    deeper = {"kind": "press", "probe": "sphere:4", "depth_mm": 0.7, "centre_mm": (0.0, 0.0)}
    extra = [("deeper.exr", 0.2, deeper)]
    with pytest.raises(
        MeasurementError, match=r"presses at 3 places or more .* none is left for select, final"
    ):
        observe_apart(
            measured(tmp_path / "m", centre_mm=(0.0, 0.0), split=None, extra=extra), DESIGN, columns=128
        )


def test_presses_are_split_by_place(tmp_path) -> None:
    seen = observe(measured(tmp_path / "m", split=None), DESIGN, columns=128)
    assert [len(seen.of(use)) for use in ("background", "train", "select", "final")] == [1, 1, 1, 1]


def test_a_diagnosis_sees_every_frame_by_itself_with_all_that_lies_under_it(tmp_path) -> None:
    lifted = DESIGN.camera.model_copy(update={"black_level": 0.05})
    turned = ("turned.exr", 0.2, {"kind": "background", "gel_rotation_deg": 180.0})
    press = {"kind": "press", "probe": "sphere:4", "depth_mm": 0.5, "centre_mm": PLACES[0], "split": "train"}
    both = ("both.exr", 0.2, press | {"gel_rotation_deg": 180.0})
    seen = observe_apart(measured(tmp_path / "m", camera=lifted, extra=[turned, both]), DESIGN, columns=128)
    assert [len(seen.of(use)) for use in ("dark", "background", "train", "select", "final")] == [
        1,
        4,
        2,
        1,
        1,
    ]
    dark = seen.shots[seen.of("dark")[0]]
    assert not dark.lit.any()
    assert dark.signal.mean() == pytest.approx(0.05, abs=1e-3)
    turned_by = {shot.files[0]: shot.gel_rotation_deg for shot in seen.shots if shot.gel_rotation_deg}
    assert turned_by == {"turned.exr": 180.0, "both.exr": 180.0}


def test_channels_cut_at_zero_are_not_compared_where_they_are_dark(tmp_path) -> None:
    cut = measured(tmp_path / "m", extra=[("off.exr", 0.0, {"kind": "background", "leds": ("red",)})])
    seen = observe_apart(cut, DESIGN, columns=128)
    dark = next(shot for shot in seen.shots if shot.files == ("off.exr",))
    assert not dark.valid.any()
    assert all(shot.valid.all() for shot in seen.shots if shot.press is not None)


@pytest.mark.parametrize("design", [DESIGN, ELASTIC])
def test_a_ball_without_depth_stands_where_its_contact_circle_says(tmp_path, design) -> None:
    fields = {"kind": "press", "probe": "sphere:4", "centre_mm": (1.0, 1.0), "contact_radius_px": 9.0}
    folder = measured(tmp_path / "m", extra=[("c.exr", 0.2, fields)])
    seen = observe(folder.model_copy(update={"mm_per_px": 0.1}), design, columns=128)
    shot = next(shot for shot in seen.shots if shot.files == ("c.exr",))
    depth_mm = shot.press.stated_depth_mm
    if design is DESIGN:
        assert depth_mm == pytest.approx(2.0 - np.sqrt(4.0 - 0.81))
    else:
        assert depth_mm > 0.25  # an elastic gel sinks around the ball
    assert shot.pose_sigma[2] == pytest.approx(0.2 * depth_mm)
    assert any("c.exr: its depth is that of the contact circle" in note for note in seen.notes)


def test_a_diagnosis_presses_by_force_to_the_depth_that_it_takes(tmp_path) -> None:
    fields = {"kind": "press", "probe": "sphere:4", "centre_mm": (1.0, 1.0), "force_n": 2.0}
    seen = observe_apart(measured(tmp_path / "m", extra=[("f.exr", 0.2, fields)]), ELASTIC, columns=128)
    shot = next(shot for shot in seen.shots if shot.files == ("f.exr",))
    surface = indent(
        ELASTIC.elastomer, ELASTIC.contact, shot.press, area_mm=ELASTIC.sensing_area_mm, pitch_mm=0.1
    )
    assert surface.mechanics is not None
    assert surface.mechanics.force_n == pytest.approx(2.0, rel=0.02)
    assert shot.pose_sigma[2] > 0.05 * shot.press.stated_depth_mm
    assert any("f.exr: its depth is that of its force" in note for note in seen.notes)


@pytest.mark.parametrize("times", [1, 3])
def test_a_single_press_is_diagnosed_by_itself_whatever_backgrounds_there_are(tmp_path, times) -> None:
    again = {"kind": "press", "probe": "sphere:4", "depth_mm": 0.5, "centre_mm": PLACES[0], "split": "train"}
    extra = [(f"again-{k}.exr", 0.2, again | {"repeat": k}) for k in range(1, times)]
    folder = measured(tmp_path / "m", extra=extra)
    frames = tuple(frame for frame in folder.frames if frame.file not in ("press-1.exr", "press-2.exr"))
    seen = observe_apart(folder.model_copy(update={"frames": frames}), DESIGN, columns=128)
    assert is_single(seen)
    assert seen.noise_source == "repeated frames"
    (note,) = (note for note in seen.notes if "the only press" in note)
    assert "background-0.exr" in note
    assert ("again-" in note) == (times > 1)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"contact_radius_px": 21.0}, "below the ball's radius"),
        ({"contact_radius_px": 19.9}, "less than the gel is thick"),
        ({"force_n": 900.0}, "its force tells no depth"),
    ],
)
def test_a_press_whose_depth_cannot_be_told_is_left_out_by_name(tmp_path, fields, words) -> None:
    press = {"kind": "press", "probe": "sphere:12", "centre_mm": (0.0, 0.0)} | fields
    if "force_n" in fields:
        press["probe"] = "sphere:4"
    folder = measured(tmp_path / "m", extra=[("odd.exr", 0.2, press)])
    seen = observe_apart(folder.model_copy(update={"mm_per_px": 0.3}), ELASTIC, columns=128)
    assert all("odd.exr" not in shot.files for shot in seen.shots)
    assert any("odd.exr: left out" in note and words in note for note in seen.notes)


def test_where_no_press_is_left_the_error_says_why(tmp_path) -> None:
    words = r"none is left for train, select, final\. press-0\.exr: left out, .* no force.*; 2 more are left"
    with pytest.raises(MeasurementError, match=words):
        observe_apart(measured(tmp_path / "m", depth_mm=None, force_n=1.0), DESIGN, columns=128)


def many_presses(count: int, *, seed: int = 1) -> Observations:
    """Shots of balls at random places and depths, each photographed twice, before a background."""
    draw = np.random.default_rng(seed)
    pixels, noise = np.zeros((2, 2, 3)), np.ones(3)

    def shot(file, use, press):
        view, valid = DESIGN.camera.full_view(), pixels == 0
        return Shot((file,), use, press, np.ones(4), np.ones(3), view, pixels, pixels, valid, noise)

    shots = [shot("background.exr", "background", None)]
    for number in range(count):
        kind = "cone:4" if number % 10 == 0 else "sphere:4"
        x, y, deep = draw.uniform((-6, -4, 0.2), (6, 4, 0.9))
        press = Press(probe=parse(kind), depth_mm=deep, centre_mm=(x, y))
        use = ("train", "select", "final", "train")[number % 4]
        shots += [shot(f"press-{number:02d}-{repeat}.exr", use, press) for repeat in range(2)]
    return Observations(tuple(shots), np.zeros(3), "assumed", False, False, ())


@pytest.mark.parametrize(("count", "most"), [(40, 20), (24, 8), (100, 20)])
def test_of_many_presses_those_that_differ_most_are_kept(count, most):
    seen = many_presses(count)
    kept = spread_out(seen, most)
    assert len(set(kept.presses)) == most
    assert len(kept.presses) == 2 * most, "repeats stay together"
    assert kept.shots[0] is seen.shots[0], "the background stays"
    assert len({shot.press for shot in kept.shots if shot.use == "train"}) == most // 2
    assert {press.probe.kind for press in kept.presses} == {"sphere", "cone"}
    assert f"{most} of {count} presses are used" in kept.notes[-1]
    assert sum(file in kept.notes[-1] for shot in seen.shots for file in shot.files) == 2 * (count - most)

    def closest(presses):
        places = np.array([press.centre_mm for press in set(presses)])
        return pdist(places).min()

    by_chance = [many_presses(most, seed=seed).presses for seed in range(2, 8)]
    assert closest(kept.presses) > np.median([closest(presses) for presses in by_chance])


def test_few_presses_are_all_kept_and_order_of_the_file_does_not_matter():
    seen = many_presses(20)
    assert spread_out(seen, 20) is seen
    turned = replace(seen, shots=seen.shots[:1] + seen.shots[:0:-1])
    assert set(spread_out(turned, 9).presses) == set(spread_out(seen, 9).presses)
