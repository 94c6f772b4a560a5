"""Digests by content, files whole or absent, a bounded cache."""

import errno
import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

from designlab.core import store
from designlab.sensor.design import preset


def test_digest_of_a_known_byte_string_is_its_tagged_sha256():
    assert store.digest(b"abc") == hashlib.sha256(b"bytes:3;abc").hexdigest()


def test_equal_content_gives_equal_digests():
    a = np.arange(12.0).reshape(3, 4)
    assert store.digest(a) == store.digest(np.asfortranarray(a)) == store.digest(a.astype(">f8"))
    assert store.digest({"a": 1, "b": 2}) == store.digest({"b": 2, "a": 1})
    assert store.digest([1, "x"]) == store.digest((1, "x"))
    assert store.digest(preset("default")) == store.digest(preset("default"))


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ((np.zeros((2, 3)),), (np.zeros((3, 2)),)),
        ((np.zeros(4, np.float32),), (np.zeros(2, np.float64),)),
        (("ab", "c"), ("a", "bc")),
        ((b"1",), ("1",)),
        ((1,), (True,)),
        ((1,), (1.0,)),
        ((["a"], "b"), (["a", "b"],)),
        (({"a": 1},), ([("a", 1)],)),
        ((None,), ("None",)),
    ],
)
def test_different_content_gives_different_digests(left, right):
    assert store.digest(*left) != store.digest(*right)


def test_digest_is_the_same_in_another_process():
    program = "from designlab.core.store import digest; print(digest({'b': [1, 2.5], 'a': 'x'}, b'1'))"
    environment = os.environ | {"PYTHONHASHSEED": "7"}
    other = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, env=environment, check=True
    )
    assert other.stdout.strip() == store.digest({"a": "x", "b": (1, 2.5)}, b"1")


@pytest.mark.parametrize("part", [object(), {1, 2}, np.array([object()])])
def test_digest_refuses_what_has_no_canonical_content(part):
    with pytest.raises(TypeError, match="canonical content"):
        store.digest(part)


def test_write_atomic_replaces_and_leaves_nothing_else(tmp_path):
    target = tmp_path / "new" / "file.txt"
    store.write_atomic(target, "one")
    store.write_atomic(target, "zwei °")
    assert target.read_text(encoding="utf-8") == "zwei °"
    assert [entry.name for entry in target.parent.iterdir()] == ["file.txt"]


def test_a_failed_write_keeps_the_old_file_and_names_the_path(tmp_path, monkeypatch):
    target = store.write_atomic(tmp_path / "file.txt", "old")

    def full(descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"cannot write .*file\.txt: No space left on device") as caught:
        store.write_atomic(target, "new")
    assert caught.value.errno == errno.ENOSPC
    assert target.read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_place_that_is_not_a_folder_is_named(tmp_path):
    blocker = store.write_atomic(tmp_path / "blocker", "")
    with pytest.raises(OSError, match=r"cannot write .*blocker"):
        store.write_atomic(blocker / "file.txt", "x")
    with pytest.raises(OSError, match=r"cannot write .*blocker"), store.atomic_folder(blocker / "folder"):
        pass


def test_atomic_folder_appears_only_when_complete(tmp_path):
    target = tmp_path / "result"
    with store.atomic_folder(target) as folder:
        (folder / "a.txt").write_text("a")
        assert not target.exists()
    assert (target / "a.txt").read_text() == "a"
    with pytest.raises(FileNotFoundError), store.atomic_folder(target, replace=True) as folder:
        (folder / "absent" / "b.txt").write_text("b")
    assert sorted(entry.name for entry in target.iterdir()) == ["a.txt"]
    with pytest.raises(FileExistsError, match="result exists already"), store.atomic_folder(target):
        pass
    with store.atomic_folder(target, replace=True) as folder:
        (folder / "c.txt").write_text("c")
    assert sorted(entry.name for entry in target.iterdir()) == ["c.txt"]
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["result"]


def test_remove_partial_deletes_leftovers_only(tmp_path):
    store.write_atomic(tmp_path / "kept.txt", "")
    (tmp_path / ".file.0123.partial").write_text("")
    (tmp_path / ".folder.0123.partial").mkdir()
    store.remove_partial(tmp_path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["kept.txt"]


def test_cache_returns_what_was_stored(tmp_path, monkeypatch):
    monkeypatch.setenv(store.CACHE_VARIABLE, str(tmp_path))
    key = store.digest("settings", 1)
    assert store.read_cache(key) is None
    arrays = {"basis": np.random.default_rng(1).random((2, 3), np.float32), "count": np.array(4)}
    assert store.write_cache(key, arrays).is_relative_to(tmp_path)
    found = store.read_cache(key)
    assert found is not None
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype


def test_a_damaged_entry_is_absent_and_deleted(tmp_path):
    path = store.write_cache("ab", {"x": np.arange(1000.0)}, folder=tmp_path)
    path.write_bytes(path.read_bytes()[:500])
    assert store.read_cache("ab", folder=tmp_path) is None
    assert not path.exists()


def test_the_cache_forgets_what_was_used_longest_ago(tmp_path):
    size = store.write_cache("a0", {"x": np.zeros(1000)}, folder=tmp_path).stat().st_size
    for age, key in ((300, "a0"), (200, "a1"), (100, "a2")):
        path = store.write_cache(key, {"x": np.zeros(1000)}, folder=tmp_path)
        stamp = path.stat().st_mtime - age
        os.utime(path, (stamp, stamp))
    assert store.read_cache("a0", folder=tmp_path) is not None  # now the most recent
    store.write_cache("a3", {"x": np.zeros(1000)}, folder=tmp_path, limit_bytes=2 * size)
    assert sorted(path.stem for path in tmp_path.iterdir()) == ["a0", "a3"]


def test_the_cache_is_measured_when_a_hundredth_of_its_limit_is_written(tmp_path, monkeypatch):
    measured = []
    monkeypatch.setattr(store, "_prune", lambda folder, **_: measured.append(len(list(folder.iterdir()))))
    entry = np.zeros(1000)
    size = store.write_cache("a0", {"x": entry}, folder=tmp_path).stat().st_size
    for number in range(1, 12):
        store.write_cache(f"a{number}", {"x": entry}, folder=tmp_path, limit_bytes=450 * size)
    # At first, then each time that more than four and a half entries have been added.
    assert measured == [1, 6, 11]


def test_cache_keys_cannot_leave_the_folder(tmp_path):
    with pytest.raises(ValueError, match=r"letters and digits, got '\.\./x'"):
        store.read_cache("../x", folder=tmp_path)
