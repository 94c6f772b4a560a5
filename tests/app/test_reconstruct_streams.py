"""`designlab reconstruct` on videos, folders that fill, bad input; killed, interrupted, on a full disk."""

import errno
import json
import os
import signal
import time

import numpy as np
import pytest
import tifffile
from PIL import Image

from designlab.app import cli
from designlab.core.images import write_image
from designlab.report.reconstruction import reconstruction_report
from tests.helpers.ball_pictures import UNTOUCHED, of_other_sensor, pressed, pressed_twice
from tests.helpers.processes import until
from tests.reconstruction.test_lab import SHAPE, slopes

pytestmark = pytest.mark.slow

PROGRAM = """
import os, signal, sys, time
from designlab.app.cli import main
from designlab.core import journal

kept = journal.Journal.append
def slowly(self, row):
    kept(self, row)
    time.sleep(float(os.environ.get("PAUSE", 0)))
journal.Journal.append = slowly
signal.signal(signal.SIGINT, signal.default_int_handler)  # also where the tests run in the background
sys.exit(main(sys.argv[1:]))
"""


def bytes_of(image):
    return np.round(255 * image).astype(np.uint8)


def frames(count):
    """Presses that go deeper and come up again."""
    return [
        bytes_of(pressed((50 + at, 60), 6.0 + 7 * np.sin(np.pi * (at + 0.5) / count))) for at in range(count)
    ]


@pytest.fixture
def said(calibration_file, capsys):
    """Run the command and give its exit status, what it says as JSON, and its error."""

    def run(*words, mode="video"):
        capsys.readouterr()
        status = cli.main(
            [
                "reconstruct",
                *map(str, words),
                "--calibration",
                str(calibration_file),
                "--mode",
                mode,
                "--json",
            ]
        )
        ended = capsys.readouterr()
        assert ended.out, ended.err
        return status, json.loads(ended.out), ended.err

    return run


@pytest.mark.parametrize(("suffix", "every"), [("mp4", 5), ("tif", 4), ("gif", 7)])
def test_a_video_at_a_stride_goes_on_where_it_ended(said, tmp_path, suffix, every):
    path, out = tmp_path / f"press.{suffix}", tmp_path / "out"
    made = frames(15)
    if suffix == "mp4":
        cv2 = pytest.importorskip("cv2")
        video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 25, SHAPE[::-1])
        for frame in made:
            video.write(np.ascontiguousarray(frame[..., ::-1]))
        video.release()
    elif suffix == "tif":
        tifffile.imwrite(path, np.stack(made), photometric="rgb")
    else:
        first, *others = map(Image.fromarray, made)
        first.save(path, save_all=True, append_images=others)
    status, told, _ = said(path, "--every", every, "--out", out, "--gel", "solaris")
    assert status == 0
    assert [row["frame"] for row in told["shapes"]] == list(range(0, 15, every))
    assert [row["name"] for row in told["shapes"]] == [f"press-{at:06d}" for at in range(0, 15, every)]
    assert all(0 < row["force_low_n"] < row["force_n"] < row["force_high_n"] for row in told["shapes"])
    assert all(row["depth_mm"] > 0.03 for row in told["shapes"])
    assert np.load(out / f"press-{every:06d}-height.npy").shape == SHAPE
    before = {each: each.stat().st_mtime_ns for each in out.glob("*-height.npy")}
    status, told, _ = said(path, "--every", 1, "--out", out, "--gel", "solaris")
    assert len(told["shapes"]) == 15
    assert {each: each.stat().st_mtime_ns for each in before} == before


@pytest.mark.faults
def test_a_killed_run_loses_no_frame_that_was_finished(calibration_file, said, processes, tmp_path):
    path, out = tmp_path / "press.tif", tmp_path / "out"
    tifffile.imwrite(path, np.stack(frames(12)), photometric="rgb")
    words = ["reconstruct", path, "--calibration", calibration_file, "--mode", "video", "--out", out]
    for kill in (signal.SIGKILL, signal.SIGINT):
        before = len(list(out.glob("*-height.npy"))) if out.is_dir() else 0
        process = processes.start(*words, PAUSE="0.3")
        until(lambda before=before: len(list(out.glob("*-height.npy"))) >= before + 3, "three frames")
        process.send_signal(kill)
        process.communicate(timeout=60)
        assert process.returncode == (-signal.SIGKILL if kill == signal.SIGKILL else 130)
    finished = [json.loads(line)["frame"] for line in (out / "shapes.jsonl").read_text().splitlines()[1:]]
    assert len(finished) >= 4
    kept = {out / f"press-{at:06d}-height.npy": None for at in finished}
    kept = {each: each.stat().st_mtime_ns for each in kept}
    status, told, _ = said(path, "--out", out)
    assert status == 0
    assert len(told["shapes"]) == 12
    assert {each: each.stat().st_mtime_ns for each in kept} == kept
    assert [each for each in out.iterdir() if each.name.endswith(".partial")] == []


@pytest.mark.faults
@pytest.mark.parametrize("written", [5, 9, 14])
def test_a_full_disk_loses_no_frame_that_was_finished(said, tmp_path, monkeypatch, written):
    path, out = tmp_path / "press.tif", tmp_path / "out"
    tifffile.imwrite(path, np.stack(frames(8)), photometric="rgb")
    left, flush = written, os.fsync

    def full(descriptor):
        nonlocal left
        left -= 1
        if left < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        flush(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        status, told, _ = said(path, "--out", out)
    assert status == 1
    assert "No space left on device; make room and run the same command again" in told["error"]
    lines = (out / "shapes.jsonl").read_text().splitlines()
    status, told, _ = said(path, "--out", out)
    assert status == 0
    assert len(told["shapes"]) == 8
    assert (out / "shapes.jsonl").read_text().splitlines()[: len(lines) - 1] == lines[:-1]


@pytest.mark.faults
def test_a_folder_that_a_camera_fills_is_watched(calibration_file, processes, tmp_path):
    filling, out = tmp_path / "camera", tmp_path / "out"
    filling.mkdir()
    made = frames(4)
    Image.fromarray(made[0]).save(filling / "0.png")
    words = [
        "reconstruct",
        "--watch",
        filling,
        "--calibration",
        calibration_file,
        "--mode",
        "video",
        "--out",
        out,
        "--json",
    ]
    process = processes.start(*words)
    until(lambda: (out / "0-height.npy").is_file(), "the picture that was there")
    Image.fromarray(made[1]).save(tmp_path / "whole.png")
    whole = (tmp_path / "whole.png").read_bytes()
    with (filling / "1.png").open("wb") as slow:  # as a slow camera writes
        for part in range(4):
            slow.write(whole[part * len(whole) // 4 : (part + 1) * len(whole) // 4])
            slow.flush()
            time.sleep(0.4)
    (filling / "broken.png").write_bytes(whole[:200])
    (filling / "notes.txt").write_text("no picture")
    until(lambda: (out / "1-height.npy").is_file(), "the picture that came slowly")
    Image.fromarray(made[2]).save(filling / "2.png")
    until(lambda: (out / "2-height.npy").is_file(), "the next picture")
    time.sleep(7)  # until the broken one is given up
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=120)
    told = json.loads(output)
    assert [row["name"] for row in told["shapes"]] == ["0", "1", "2"], errors
    assert [os.path.basename(each["file"]) for each in told["refused"]] == ["broken.png"]
    assert process.returncode == 1
    assert (out / "report.html").is_file()


@pytest.mark.faults
@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--watch", "absent"], "--watch: absent: no such folder"),
        ([], "PICTURES: name files, folders or patterns, or give --watch FOLDER"),
        (["a.png", "--watch", "."], "--watch: takes the place of PICTURES"),
        (["absent.mp4"], "PICTURES: absent.mp4: no such file"),
        (["a.png", "--every", "0"], "--every"),
        (["a.png", "--mode", "fast"], "--mode"),
        (["a.png", "--files", "heights"], "--files"),
    ],
)
def test_options_that_make_no_sense_are_refused(calibration_file, tmp_path, monkeypatch, capsys, words, line):
    monkeypatch.chdir(tmp_path)
    Image.fromarray(bytes_of(pressed())).save("a.png")
    assert cli.main(["reconstruct", *words, "--calibration", str(calibration_file), "--out", "out"]) == 2
    assert line in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.faults
def test_bad_pictures_are_refused_or_read_as_they_are(said, tmp_path):
    image = bytes_of(pressed())
    good = Image.fromarray(image)
    good.save(tmp_path / "plain.png")
    good.convert("L").save(tmp_path / "grey.png")
    clear = good.convert("RGBA")
    clear.save(tmp_path / "opaque.png")
    clear.putalpha(Image.fromarray(image[..., 0]))
    clear.save(tmp_path / "clear.png")
    exif = Image.Exif()
    exif[0x0112] = 6
    good.save(tmp_path / "turned.png", exif=exif)
    good.convert("CMYK").save(tmp_path / "inks.tif")
    good.crop((0, 0, 100, 100)).save(tmp_path / "small.png")
    good.transpose(Image.Transpose.ROTATE_90).save(tmp_path / "upright.png")
    write_image(tmp_path / "deep.png", pressed(), bits=16)
    write_image(tmp_path / "none.png", UNTOUCHED)
    write_image(tmp_path / "two.png", pressed_twice(((40, 40), 9.0), ((100, 80), 9.0)))
    other = of_other_sensor(*slopes((60, 60), 14.0)[:2], turned_deg=180.0, gradient=2.0)
    write_image(tmp_path / "other.png", other)
    (tmp_path / "empty.mp4").write_bytes(b"")
    status, told, _ = said(tmp_path, "--out", tmp_path / "out")
    assert status == 1
    rows = {row["name"]: row for row in told["shapes"]}
    refused = {os.path.basename(each["file"]): each["reason"] for each in told["refused"]}
    for name in ("plain", "opaque", "turned", "deep"):
        assert rows[name]["depth_mm"] == pytest.approx(rows["plain"]["depth_mm"], rel=0.02)
    assert "of 1 channels" in refused["grey.png"]
    assert "alpha channel" in refused["clear.png"]
    assert "CMYK" in refused["inks.tif"]
    assert "got 100 x 100 pixels" in refused["small.png"]
    assert "got 120 x 140 pixels" in refused["upright.png"]
    assert "video is damaged" in refused["empty.mp4"]
    assert rows["none"]["depth_mm"] == 0
    assert any("nothing touches" in text for text in rows["none"]["warnings"])
    assert rows["two"]["warnings"] == []
    assert "other.png" in refused or any("sensor" in text for text in rows["other"]["warnings"])
    assert all(str(tmp_path) in reason for reason in refused.values())


def test_a_folder_without_shapes_takes_those_of_another_run(calibration_file, said, tmp_path, capsys):
    write_image(tmp_path / "small.png", pressed()[:50])
    write_image(tmp_path / "press.png", pressed())
    out = str(tmp_path / "out")
    words = ["reconstruct", str(tmp_path / "small.png"), "--calibration", str(calibration_file), "--out", out]
    assert cli.main(words) == 2
    assert "no picture could be used" in capsys.readouterr().err
    status, told, _ = said(tmp_path / "press.png", "--out", out)  # by another mode
    assert status == 0
    assert [row["name"] for row in told["shapes"]] == ["press"]


def test_drift_is_said_in_json_for_background_and_pictures(said, tmp_path):
    write_image(tmp_path / "press.png", np.clip(1.1 * pressed(), 0, 1))
    write_image(tmp_path / "today.png", 0.9 * UNTOUCHED)
    status, told, _ = said(
        tmp_path / "press.png",
        "--background",
        tmp_path / "today.png",
        "--out",
        tmp_path / "out",
        mode="accurate",
    )
    assert status == 0
    assert told["background_drift"]["gain"] == pytest.approx([0.9, 0.9, 0.9], abs=0.01)
    (row,) = told["shapes"]
    assert row["drift"]["gain"] == pytest.approx([1.1 / 0.9] * 3, abs=0.02)
    assert row["drift"]["shift_px"] in (None, [0, 0])
    assert any("brightness has changed by +22%, +22%, +22%" in text for text in row["warnings"])


@pytest.mark.faults
@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (["--modulus-mpa", "0"], "--modulus-mpa: must be above 0 MPa, got 0"),
        (["--modulus-mpa", "0.4", "--gel", "solaris"], "--modulus-mpa: is stated beside --gel"),
        (["--modulus-sd-mpa", "0.1"], "--modulus-sd-mpa: belongs to --modulus-mpa"),
        (["--modulus-mpa", "0.4", "--modulus-sd-mpa", "-0.1"], "--modulus-sd-mpa: must be at least 0 MPa"),
    ],
)
def test_a_modulus_that_cannot_be_meant_is_refused(said, tmp_path, words, rule):
    Image.fromarray(frames(1)[0]).save(tmp_path / "press.png")
    status, _, wrong = said(tmp_path / "press.png", "--out", tmp_path / "out", *words)
    assert status == 2
    assert rule in wrong


def test_the_interval_of_a_force_holds_what_is_known_of_the_modulus(said, tmp_path):
    Image.fromarray(frames(9)[8]).save(tmp_path / "press.png")
    widths = []
    for words in (["0.4", "--modulus-sd-mpa", "0.01"], ["0.4"], ["0.4", "--modulus-sd-mpa", "0.12"]):
        out = tmp_path / f"out-{len(widths)}"
        _, told, _ = said(tmp_path / "press.png", "--out", out, "--modulus-mpa", *words)
        (row,) = told["shapes"]
        widths.append((row["force_high_n"] - row["force_low_n"]) / row["force_n"])
    assert widths[0] < widths[1] < widths[2]


@pytest.mark.parametrize("count", [60, 700, 5000])
def test_the_page_of_many_frames_stays_small(tmp_path, count):
    random = np.random.default_rng(0)
    rows = [
        {
            "file": "/a/long/folder/of/a/lab/press.mp4",
            "frame": at,
            "name": f"press-{at:06d}",
            "depth_mm": float(np.sin(3.1 * at / count)),
            "contact_area_mm2": float(random.uniform(1, 5)),
            "force_n": 1.0,
            "warnings": [f"{at % 90}% of the pixels that change have colours that no ball showed, and so on"],
        }
        for at in range(count)
    ]
    shown = np.hypot(*np.indices((700, 1300)))[..., None] % 200 + random.normal(scale=4, size=(700, 1300, 3))
    for at in (0, count - 1, count // 2):
        Image.fromarray(shown.astype(np.uint8)).save(tmp_path / f"press-{at:06d}.png")
    about = {"normal_error_deg": 2.0, "height_error_um": 10.0}
    page = reconstruction_report(
        rows, tmp_path, tmp_path / "report.html", about=about, matter=[rows[0], rows[-1]]
    )
    assert page.stat().st_size < 3_000_000
    text = page.read_text()
    assert "Over time" in text
    assert text.count("colours that no ball showed") < 5
    assert len((tmp_path / "shapes.csv").read_text().splitlines()) == count + 1
