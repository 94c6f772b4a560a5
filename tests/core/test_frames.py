"""Frames of videos and of files that hold several pictures; a record that a full disk cannot spoil."""

import errno
import os
import sys

import numpy as np
import pytest
import tifffile
from PIL import Image

from designlab.core.frames import frame_count, read_frames
from designlab.core.images import ImageError, read_picture
from designlab.core.journal import Journal, read_journal

ROWS, COLUMNS = 48, 64


def picture(number):
    """A picture that tells its number by its brightness, and red from blue."""
    made = np.full((ROWS, COLUMNS, 3), 30 + 10 * number, dtype=np.uint8)
    made[: ROWS // 2, :, 0] += 60
    return made


def written(path, count):
    frames = [picture(number) for number in range(count)]
    match path.suffix:
        case ".tif":
            tifffile.imwrite(path, np.stack(frames), photometric="rgb")
        case ".tiff":
            tifffile.imwrite(path, np.stack(frames).astype(np.uint16) * 257, photometric="rgb")
        case ".gif" | ".webp":
            first, *others = map(Image.fromarray, frames)
            first.save(path, save_all=True, append_images=others, lossless=True)
        case _:
            cv2 = pytest.importorskip("cv2")
            codec = {".mp4": "mp4v", ".avi": "MJPG"}[path.suffix]
            video = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), 25, (COLUMNS, ROWS))
            for frame in frames:
                video.write(np.ascontiguousarray(frame[..., ::-1]))
            video.release()
    return path


@pytest.mark.parametrize("suffix", [".tif", ".tiff", ".gif", ".webp", ".mp4", ".avi"])
def test_every_frame_is_read_in_its_order_with_its_colours(tmp_path, suffix):
    path = written(tmp_path / f"press{suffix}", 7)
    assert frame_count(path) == 7
    found = dict(read_frames(path, lambda number: number % 3 == 0))
    assert list(found) == [0, 3, 6]
    for number, image in found.items():
        assert image.shape == (ROWS, COLUMNS, 3)
        assert image.dtype == np.float32
        assert np.abs(255 * image - picture(number)).mean() < 6  # videos are compressed


@pytest.mark.parametrize("suffix", [".tif", ".png", ".npy"])
def test_a_single_picture_has_no_frames(tmp_path, suffix):
    path = tmp_path / f"one{suffix}"
    np.save(path, picture(1)) if suffix == ".npy" else Image.fromarray(picture(1)).save(path)
    assert frame_count(path) is None


@pytest.mark.faults
@pytest.mark.parametrize("suffix", [".mp4", ".gif", ".tif", ".avi"])
def test_damaged_files_are_named(tmp_path, suffix):
    whole = written(tmp_path / f"whole{suffix}", 3).read_bytes()
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(whole[:6] + b"?" * 40)
    with pytest.raises(ImageError, match=f"damaged{suffix}"):
        (frame_count(path) and list(read_frames(path, lambda number: True))) or read_picture(path)
    with pytest.raises(ImageError, match="no such file"):
        frame_count(tmp_path / f"absent{suffix}")


@pytest.mark.faults
@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv"])
def test_a_video_without_opencv_says_what_is_missing(tmp_path, monkeypatch, suffix):
    monkeypatch.setitem(sys.modules, "cv2", None)
    path = tmp_path / f"press{suffix}"
    path.write_bytes(b"video")
    with pytest.raises(ImageError, match=r"pip install 'designlab\[video\]'"):
        frame_count(path)


@pytest.mark.faults
@pytest.mark.parametrize("tail", [b"", b'{"name": "thr', b"\x00\x00"])
def test_a_record_loses_only_a_line_that_was_cut_off(tmp_path, tail):
    path = tmp_path / "record.jsonl"
    with Journal(path) as journal:
        journal.append({"name": "one"})
        journal.append({"name": "two"})
    with path.open("ab") as file:
        file.write(tail)
    with Journal(path) as journal:
        assert [row["name"] for row in journal.rows] == ["one", "two"]
        journal.append({"name": "three"})
    assert [row["name"] for row in read_journal(path)] == ["one", "two", "three"]


@pytest.mark.faults
def test_a_record_on_a_full_disk_keeps_what_it_holds(tmp_path, monkeypatch):
    path = tmp_path / "record.jsonl"
    with Journal(path) as journal:
        journal.append({"name": "one"})

        def full(descriptor):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            with pytest.raises(OSError, match=r"cannot write .*record\.jsonl: No space left"):
                journal.append({"name": "two"})
    (tmp_path / "spoilt.jsonl").write_text('{"name": "one"}\n{"na\n{"name": "two"}\n')
    with pytest.raises(ValueError, match=r"spoilt\.jsonl: is damaged"):
        read_journal(tmp_path / "spoilt.jsonl")
    assert read_journal(path)[0] == {"name": "one"}
