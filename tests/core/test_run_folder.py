"""Folders of runs: whose they are, what is refused in one line, and what goes on."""

import json
import os
import subprocess
import sys

import pytest

from designlab.core.run_folder import claim, locked, require_own, require_same, require_writable, resumed
from designlab.core.store import atomic_folder

DECIDED_BY = {"digest": "of another design", "seed": "with another seed"}


def mine(folder, *, alone=True, **changes):
    run = {"digest": "a" * 64, "seed": 3, "size": (4, 5), "copies": 8} | changes
    claim(folder, "run.json", run, kind="a sweep", decided_by=DECIDED_BY, alone=alone)
    return json.loads((folder / "run.json").read_text())


def test_a_run_marks_its_folder_and_goes_on_there(tmp_path):
    out = tmp_path / "deep" / "out"
    assert mine(out) == {"digest": "a" * 64, "seed": 3, "size": [4, 5], "copies": 8}
    (out / "row.json").write_text("{}")
    (out / f".row.json.{'0' * 32}.partial").write_text("cut off")
    before = (out / "run.json").stat().st_ino
    mine(out)
    assert (out / "run.json").stat().st_ino == before
    assert mine(out, copies=20)["copies"] == 20, "what does not decide may change"
    assert sorted(path.name for path in out.iterdir()) == ["row.json", "run.json"]


def test_another_run_is_refused_in_one_line_that_says_what_is_there(tmp_path):
    mine(tmp_path)
    with pytest.raises(ValueError, match="holds a sweep") as caught:
        mine(tmp_path, digest="b" * 64, seed=4)
    assert str(caught.value) == (
        f"{tmp_path}: holds a sweep of another design and with another seed (seed 3, copies 8); "
        "choose another folder"
    )
    assert json.loads((tmp_path / "run.json").read_text())["seed"] == 3
    with pytest.raises(ValueError, match=r"x\.json: holds a set drawn anew; choose another folder"):
        require_same(tmp_path / "x.json", {}, {"a": 1}, kind="a set", decided_by={"a": "drawn anew"})


@pytest.mark.parametrize("content", ["", "[1]", "\x00"])
def test_a_damaged_marker_is_named_and_kept(tmp_path, content):
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(ValueError, match=r"run\.json: must be JSON that a sweep wrote, is damaged; choose"):
        mine(tmp_path)
    assert (tmp_path / "run.json").read_text() == content


def test_what_others_have_left_is_not_touched(tmp_path):
    (tmp_path / "thesis.tex").write_text("mine")
    with pytest.raises(ValueError, match=r"must be absent, empty or .*; it has files but no run\.json"):
        mine(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    assert mine(tmp_path, alone=False)["seed"] == 3
    with pytest.raises(ValueError, match=r"thesis\.tex: must be a folder, is a file"):
        mine(tmp_path / "thesis.tex")


def test_a_run_that_was_killed_over_its_marker_begins_again(tmp_path):
    (tmp_path / f".run.json.{'0' * 32}.partial").write_text("{")
    require_own(tmp_path, "run.json")
    mine(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


def test_places_are_tried_before_the_work(tmp_path):
    out = tmp_path / "a" / "b"
    require_writable(out, made_with="score.json")
    assert not list(tmp_path.iterdir()), "the results bring the folder"
    require_writable(out)
    assert not list(out.iterdir())
    (out / "note").write_text("")
    require_writable(out)
    with pytest.raises(ValueError, match=r"b: must be absent, .* no score\.json"):
        require_writable(out, made_with="score.json")
    with pytest.raises(OSError, match="cannot write into /proc/out"):
        require_writable("/proc/out")


def test_parts_are_made_once(tmp_path):
    made = []

    def make():
        made.append(1)
        return {"value": 1.5}

    assert resumed(tmp_path / "part.json", make) == resumed(tmp_path / "part.json", make) == {"value": 1.5}
    assert len(made) == 1
    (tmp_path / "part.json").write_text("{")
    with pytest.raises(ValueError, match=r"part\.json: is damaged, delete it and go on"):
        resumed(tmp_path / "part.json", make)


def test_a_folder_is_held_by_one_process_and_let_go_at_its_death(tmp_path):
    program = (
        "import sys; from pathlib import Path; from designlab.core.run_folder import locked\n"
        "with locked(Path(sys.argv[1]), kind='study'): print('held', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ,
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        with (
            pytest.raises(RuntimeError, match="another run of this study is writing there"),
            locked(tmp_path, kind="study"),
        ):
            pass
        other.kill()
    with locked(tmp_path, kind="study"):
        pass


def test_a_folder_behind_a_link_gives_way_and_the_link_stays(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "old").write_text("")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    with atomic_folder(tmp_path / "link", replace=True) as folder:
        (folder / "new").write_text("")
    assert (tmp_path / "link").is_symlink()
    assert [path.name for path in (tmp_path / "real").iterdir()] == ["new"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "real"]
