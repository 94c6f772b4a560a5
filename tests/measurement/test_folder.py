"""Measurement folders: what is read, what is refused and in which words, and how presses are split."""

import os
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from designlab.core.images import from_srgb, to_srgb, write_image
from designlab.measurement import (
    MeasuredFrame,
    Measurement,
    MeasurementError,
    load_measurement,
    write_measurement,
)

MEASURED = os.environ.get("DESIGNLAB_MEASURED")
CROP = [1000, 700, 400, 300]


def press(file, x, y, **more):
    return {"file": file, "kind": "press", "probe": "sphere:4", "depth_mm": 0.5, "centre_mm": [x, y], **more}


def write(folder, frames, *, size=(30, 40), channels=3, **top):
    folder.mkdir(exist_ok=True)
    for frame in frames:
        if isinstance(frame, dict) and "file" in frame and not (folder / frame["file"]).exists():
            write_image(folder / frame["file"], np.full((*size, channels), 0.25, dtype=np.float32))
    content = {"sensor": "gelsight-2020-flat", "response": "linear", **top, "frame": frames}
    (folder / "measurement.toml").write_text(tomli_w.dumps(content))
    return folder


def good_frames():
    return [
        {"file": "background.exr", "kind": "background", "crop_px": CROP},
        {"file": "dark.exr", "kind": "dark", "leds": [], "crop_px": CROP},
        press("p.exr", 1.0, -2.0, yaw_deg=10.0, crop_px=CROP, sigma={"depth_mm": 0.02}),
    ]


def test_folder_and_file_load_alike_and_missing_fields_stay_unknown(tmp_path):
    folder = write(tmp_path / "set", good_frames())
    measurement = load_measurement(folder)
    assert load_measurement(str(folder / "measurement.toml")) == measurement
    background, dark, pressed = measurement.frames
    assert (background.exposure, background.leds, background.repeat, background.gel_rotation_deg) == (
        None,
    ) * 4
    assert pressed.sigma.depth_mm == 0.02
    assert pressed.sigma.centre_mm is None
    assert dark.leds == ()
    assert not dark.lit
    assert background.lit
    assert measurement.image(background).shape == (30, 40, 3)
    assert measurement.mm_per_px is None


def test_frames_become_presses_and_views(tmp_path):
    measurement = load_measurement(write(tmp_path / "set", good_frames()))
    background, _, pressed = measurement.frames
    assert measurement.press(background) is None
    found = measurement.press(pressed)
    assert (found.probe.kind, found.probe.size_mm, found.depth_mm) == ("sphere", 4.0, 0.5)
    assert (found.centre_mm, found.yaw_deg) == ((1.0, -2.0), 10.0)
    assert measurement.view(pressed, measurement.design()) == (1000.0, 700.0, 400.0, 300.0, 40, 30)


def test_images_are_read_only_and_follow_the_file(tmp_path):
    folder = write(tmp_path / "set", good_frames())
    measurement = load_measurement(folder)
    frame = measurement.frames[0]
    with pytest.raises(ValueError, match="read-only"):
        measurement.image(frame)[0, 0, 0] = 1.0
    write_image(folder / "background.exr", np.full((30, 40, 3), 0.75, dtype=np.float32))
    os.utime(folder / "background.exr", ns=(1, 1))
    assert measurement.image(frame)[0, 0, 0] == 0.75


@pytest.mark.parametrize(
    ("response", "expected"),
    [("linear", 0.25), ("srgb", float(from_srgb(np.float64(0.25)))), ("gamma:2.0", 0.0625)],
)
def test_response_is_undone(tmp_path, response, expected):
    measurement = load_measurement(write(tmp_path / "set", good_frames(), response=response))
    assert measurement.linear(measurement.frames[0]) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("response", ["linear", "srgb"])
def test_the_error_of_rounding_is_told_from_the_counts_of_a_file(tmp_path, response):
    light = np.random.default_rng(0).uniform(0.2, 0.6, (90, 120, 3))
    encoded = to_srgb(light) if response == "srgb" else light
    frames = [
        {"file": "8.png", "kind": "background"},
        {"file": "32.exr", "kind": "background", "exposure": 2.0},
    ]
    folder = tmp_path / "set"
    folder.mkdir()
    write_image(folder / "8.png", encoded)
    write_image(folder / "32.exr", encoded.astype(np.float32))
    measurement = load_measurement(write(folder, frames, response=response))
    rounded, whole = measurement.frames
    missed, told = measurement.linear(rounded) - light, measurement.rounding(rounded)
    for part in (light < 0.4, light > 0.4):
        rms = np.sqrt((missed[part] ** 2).mean())
        assert np.sqrt((told[part] ** 2).mean()) == pytest.approx(rms, rel=0.03)
    assert not measurement.rounding(whole).any()


def test_unknown_response_gives_no_linear_values(tmp_path):
    measurement = load_measurement(write(tmp_path / "set", good_frames(), response="unknown"))
    with pytest.raises(MeasurementError, match="response"):
        measurement.linear(measurement.frames[0])


def changed(index, **changes):
    frames = good_frames()
    frames[index] = {key: value for key, value in (frames[index] | changes).items() if value is not None}
    return frames


@pytest.mark.parametrize(
    ("frames", "top", "words"),
    [
        (changed(2, probe=None), {}, ["frame 3", "p.exr", "probe", "a press needs"]),
        (changed(2, probe="banana:3"), {}, ["frame 3", "probe", "banana"]),
        (changed(2, probe="lost.stl"), {}, ["frame 3", "probe", "lost.stl"]),
        (changed(2, probe="sphere:4:r0.2"), {}, ["frame 3", "probe", "edge_radius_mm"]),
        (changed(2, depth_mm=-1.0), {}, ["frame 3", "depth_mm", "-1"]),
        (changed(2, depth_mm=float("nan")), {}, ["frame 3", "depth_mm", "finite"]),
        (changed(2, centre_mm=[1.0]), {}, ["frame 3", "centre_mm"]),
        (changed(2, colour="red"), {}, ["frame 3", "colour", "unknown field"]),
        (changed(2, split="test"), {}, ["frame 3", "split", "test"]),
        (changed(1, leds=["red"]), {}, ["frame 2", "dark.exr", "leds", "no LED is on"]),
        (changed(0, leds=["white"]), {}, ["frame 1", "leds", "red, green, blue", "white"]),
        (changed(0, kind="photo"), {}, ["frame 1", "background.exr", "kind", "photo"]),
        (changed(0, exposure=0.0), {}, ["frame 1", "exposure", "0"]),
        (changed(0, crop_px=[2400, 700, 400, 300]), {}, ["frame 1", "crop_px", "2592 x 1944"]),
        (changed(0, crop_px=[0, 0, 0, 300]), {}, ["frame 1", "crop_px", "width and height"]),
        (changed(0, crop_px=[0, 0, 20, 15]), {}, ["frame 1", "crop_px", "20 x 15 px", "40 x 30 px"]),
        (changed(0, crop_px=[0, 0, 400, 200]), {}, ["frame 1", "crop_px", "one binning"]),
        (changed(0, crop_px=None), {}, []),
        (changed(1, file="background.exr"), {}, ["frame 1", "file", "each frame has its own"]),
        (good_frames(), {"response": "log"}, ["response", "log"]),
        (good_frames(), {"response": "gamma:99"}, ["response", "gamma:99"]),
        (good_frames(), {"sensor": "no-such-sensor"}, ["sensor", "no-such-sensor"]),
        (good_frames(), {"colour": "red"}, ["colour", "unknown field"]),
        (good_frames(), {"mm_per_px": 0.0}, ["mm_per_px"]),
        ([], {}, ["frame", "at least one"]),
        (["text"], {}, ["frame 1"]),
    ],
)
def test_every_broken_rule_names_file_frame_and_field(tmp_path, frames, top, words):
    folder = write(tmp_path / "set", frames, **top)
    if not words:  # 4:3 images of the whole 4:3 sensor are in order
        assert load_measurement(folder)
        return
    with pytest.raises(MeasurementError) as caught:
        load_measurement(folder)
    for word in ["measurement.toml" if "sensor" not in top else "set", *words]:
        assert word in str(caught.value)


def test_missing_broken_and_odd_images_are_named(tmp_path):
    folder = write(tmp_path / "set", good_frames())
    write_image(folder / "dark.exr", np.full((20, 40, 3), 0.1, dtype=np.float32))
    with pytest.raises(MeasurementError, match=r"frame 2 \(dark.exr\): field file: .*40 x 30 px.*40 x 20 px"):
        load_measurement(folder)
    (folder / "dark.exr").write_text("no image")
    with pytest.raises(MeasurementError, match=r"frame 2 \(dark.exr\): field file"):
        load_measurement(folder)
    (folder / "dark.exr").unlink()
    with pytest.raises(MeasurementError, match=r"frame 2 \(dark.exr\): field file"):
        load_measurement(folder)


def test_missing_folder_and_bad_toml_are_named(tmp_path):
    with pytest.raises(MeasurementError, match="nowhere: no measurement there"):
        load_measurement(tmp_path / "nowhere")
    (tmp_path / "measurement.toml").write_text("name = ")
    with pytest.raises(MeasurementError, match="not valid TOML"):
        load_measurement(tmp_path)
    (tmp_path / "measurement.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MeasurementError, match="cannot be read"):
        load_measurement(tmp_path)


def spread(count, seed=3):
    centres = np.random.default_rng(seed).uniform(-8, 8, (count, 2)).round(2)
    return [
        press(f"{i}-{depth}.exr", *c.tolist(), repeat=depth)
        for i, c in enumerate(centres)
        for depth in (0, 1)
    ]


def files(split):
    return {name: {frame.file for frame in frames} for name, frames in split.items()}


@pytest.mark.parametrize(
    ("places", "counts"), [(1, (1, 0, 0)), (2, (1, 0, 1)), (3, (1, 1, 1)), (8, (4, 2, 2))]
)
def test_split_shares_out_places_with_all_their_presses(places, counts):
    split = files(Measurement(frames=spread(places)).split())
    assert tuple(len(split[name]) for name in ("train", "select", "final")) == tuple(2 * n for n in counts)
    for found in split.values():
        assert {f"{file.split('-')[0]}-{depth}.exr" for file in found for depth in (0, 1)} == found


def test_split_does_not_depend_on_the_order_of_the_file():
    frames = spread(9)
    assert files(Measurement(frames=frames).split()) == files(Measurement(frames=frames[::-1]).split())


def test_presses_that_nearly_share_a_place_share_a_split():
    frames = [press(f"{i}.exr", 0.2 * i, 0.0) for i in range(5)] + [
        press("a.exr", 6, 0),
        press("b.exr", 0, 6),
    ]
    split = files(Measurement(frames=frames).split())
    assert any({f"{i}.exr" for i in range(5)} <= found for found in split.values())
    assert all(split.values())


def test_stated_split_wins_for_its_place_and_contradictions_are_refused(tmp_path):
    frames = spread(4)
    frames[0]["split"] = "final"
    split = files(Measurement(frames=frames).split())
    assert {"0-0.exr", "0-1.exr"} <= split["final"]
    frames[1]["split"] = "train"
    with pytest.raises(MeasurementError, match=r"0-0.exr.*split"):
        load_measurement(write(tmp_path / "set", frames))


def test_presses_at_unknown_places_are_only_trained_on():
    frames = [*spread(3), {"file": "lost.exr", "kind": "press", "probe": "sphere:4"}]
    assert "lost.exr" in files(Measurement(frames=frames).split())["train"]


def test_centre_read_off_the_image_turns_into_mm(tmp_path):
    frames = [
        {"file": "p.exr", "kind": "press", "probe": "sphere:4", "depth_mm": 0.3, "centre_px": [30.0, 5.0]}
    ]
    measurement = load_measurement(write(tmp_path / "set", frames, sensor="unknown", mm_per_px=0.1))
    # 40 x 30 px: 10 px right of the middle and 10 px above it.
    assert measurement.press(measurement.frames[0]).centre_mm == pytest.approx((1.0, 1.0))
    without = load_measurement(write(tmp_path / "other", frames, sensor="unknown"))
    assert without.centre_mm(without.frames[0]) is None
    with pytest.raises(MeasurementError, match="centre_mm: unknown"):
        without.press(without.frames[0])


@pytest.mark.parametrize(
    ("change", "word"), [({"probe": "sphere"}, "size"), ({"depth_mm": None}, "depth_mm")]
)
def test_presses_that_cannot_be_simulated_say_what_is_unknown(tmp_path, change, word):
    measurement = load_measurement(write(tmp_path / "set", changed(2, **change)))
    with pytest.raises(MeasurementError, match=f"frame 3.*{word}.*unknown"):
        measurement.press(measurement.frames[2])


def test_a_mesh_that_holds_no_body_is_refused_with_its_frame(tmp_path):
    folder = write(tmp_path / "set", changed(2, probe="flat.stl"))
    (folder / "flat.stl").write_bytes(b"no triangles")
    measurement = load_measurement(folder)
    with pytest.raises(MeasurementError, match=r"frame 3 \(p.exr\): .*flat.stl: "):
        measurement.press(measurement.frames[2])


def test_writing_and_reading_give_the_same_set(tmp_path):
    source = load_measurement(write(tmp_path / "source", good_frames(), name="a", source="b", mm_per_px=0.16))
    images = {frame.file: source.image(frame) * (i + 1) for i, frame in enumerate(source.frames)}
    copy = load_measurement(write_measurement(source, images, tmp_path / "new" / "copy"))
    assert copy.model_dump() == source.model_dump()
    for frame in copy.frames:
        np.testing.assert_array_equal(copy.image(frame), images[frame.file])
    write_measurement(source, images, tmp_path / "new" / "copy")  # a measurement gives way to another
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["copy"]


def test_a_design_file_travels_with_the_set(tmp_path):
    from designlab.sensor.design import dumps, preset

    folder = tmp_path / "source"
    folder.mkdir()
    mine = preset("gelsight-2020-flat").replace({"leds.height_mm": 9.5})
    (folder / "mine.toml").write_text(dumps(mine))
    source = load_measurement(write(folder, good_frames(), sensor="mine.toml"))
    images = {frame.file: source.image(frame) for frame in source.frames}
    copy = load_measurement(write_measurement(source, images, tmp_path / "copy"))
    assert copy.design().digest == mine.digest


def test_other_folders_are_never_overwritten_and_failures_leave_nothing(tmp_path):
    source = load_measurement(write(tmp_path / "source", good_frames()))
    images = {frame.file: source.image(frame) for frame in source.frames}
    other = tmp_path / "thesis"
    other.mkdir()
    (other / "chapter.txt").write_text("precious")
    with pytest.raises(MeasurementError, match="neither empty nor a measurement"):
        write_measurement(source, images, other)
    assert (other / "chapter.txt").read_text() == "precious"
    with pytest.raises(MeasurementError, match=r"no image for p.exr"):
        write_measurement(source, {k: v for k, v in images.items() if k != "p.exr"}, tmp_path / "a")
    with pytest.raises(MeasurementError, match="agree in size"):
        write_measurement(source, images | {"p.exr": np.ones((9, 9, 3), np.float32)}, tmp_path / "a")
    outside = Measurement(frames=(MeasuredFrame(file="../x.exr", kind="background"),))
    with pytest.raises(MeasurementError, match="lies in the folder"):
        write_measurement(outside, {"../x.exr": images["p.exr"]}, tmp_path / "a")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["source", "thesis"]


@pytest.mark.measured
@pytest.mark.skipif(MEASURED is None, reason="DESIGNLAB_MEASURED does not name a folder of real images")
def test_real_sets_load():
    flat = load_measurement(Path(MEASURED) / "gelsight-flat")
    (frame,) = flat.frames
    assert flat.image(frame).shape == (600, 600, 3)
    assert flat.press(frame).probe.kind == "triangle"
    assert flat.view(frame, flat.design()).width_px == 600
    thu = load_measurement(Path(MEASURED) / "thu")
    assert thu.design() is None
    split = thu.split()
    assert all(split.values())
    assert sum(len(frames) for frames in split.values()) == len(thu.frames) - 1
    ladder = [frame for frame in thu.frames if frame.depth_mm is not None]
    assert len({name for name, frames in split.items() for frame in frames if frame in ladder}) == 1
