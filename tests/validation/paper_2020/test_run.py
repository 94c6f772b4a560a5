"""How a reproduction goes on after an interruption, what it refuses, and its small experiments."""

import json
from dataclasses import replace

import pytest

from designlab.app import cli
from designlab.validation.paper_2020 import run
from designlab.validation.paper_2020.probe import probe
from designlab.validation.paper_2020.run import RESULTS, STAGES, Experiment, Growing, reproduce
from designlab.validation.paper_2020.sizes import SIZES
from designlab.validation.paper_2020.timing import PAPER_MS, timing

TINY = replace(SIZES["reduced"], binned=20, timing_px=(30,), timing_samples=(4, 8))


@pytest.fixture
def quick(monkeypatch, result):
    """Experiments that give made-up figures, and tell that they ran."""
    ran = []

    def stage(name):
        def does(folder, size, seed, within):
            ran.append(name)
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "work.txt").write_text(f"{seed}")
            for step in range(4):
                within("working", step, 4)
            return result["stages"][name]

        return Experiment(f"stage {name}", does, lambda size: 10.0)

    monkeypatch.setattr(run, "STAGES", {name: stage(name) for name in STAGES})
    return ran


def test_a_second_call_repeats_nothing_and_says_the_same(quick, tmp_path):
    told = []
    first = reproduce(
        tmp_path / "out", size="reduced", progress=lambda what, done, of: told.append((what, done / of))
    )
    assert quick == ["probe", "recovery", "accuracy", "timing", "real"]
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert ("stage timing: working", pytest.approx(0.75)) in told
    files = {name: (tmp_path / "out" / name).read_text() for name in ("report.html", "reproduction.md")}
    again = reproduce(tmp_path / "out", size="reduced")
    assert len(quick) == 5
    assert again == first
    assert files == {name: (tmp_path / "out" / name).read_text() for name in files}
    written = json.loads((tmp_path / "out" / "result.json").read_text())
    assert written["stages"] == first["stages"]
    assert str(tmp_path) not in json.dumps(written), "the folder may be moved"


@pytest.mark.parametrize("ending", [KeyboardInterrupt, SystemExit])
def test_what_was_not_finished_is_done_again_and_nothing_else(quick, tmp_path, monkeypatch, ending):
    good = run.STAGES["accuracy"]

    def killed(folder, size, seed, within):
        folder.mkdir()
        (folder / ".half.0123456789abcdef.partial").write_text("a file that was being written")
        raise ending

    monkeypatch.setitem(run.STAGES, "accuracy", good._replace(run=killed))
    with pytest.raises(ending):
        reproduce(tmp_path, size="reduced")
    assert quick == ["probe", "recovery"]
    assert not (tmp_path / "result.json").exists()
    monkeypatch.setitem(run.STAGES, "accuracy", good)
    assert list((tmp_path / "accuracy").iterdir())
    shares = []
    reproduce(tmp_path, size="reduced", progress=lambda what, done, of: shares.append(done))
    assert sorted(path.name for path in (tmp_path / "accuracy").iterdir()) == ["result.json", "work.txt"]
    assert quick == ["probe", "recovery", "accuracy", "timing", "real"]
    assert shares[0] == 0.0, "time left is that of what is left"


def test_what_was_left_out_is_tried_again(quick, tmp_path, monkeypatch):
    good = run.STAGES["real"]
    monkeypatch.setitem(run.STAGES, "real", good._replace(run=lambda *_: {"left_out": "left out: no folder"}))
    assert reproduce(tmp_path, size="reduced")["stages"]["real"] == {"left_out": "left out: no folder"}
    monkeypatch.setitem(run.STAGES, "real", good)
    assert "frames" in reproduce(tmp_path, size="reduced")["stages"]["real"]
    assert quick[-1] == "real"
    assert len(quick) == 5


def test_folders_of_others_are_refused(quick, tmp_path, monkeypatch):
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(ValueError, match=r"must be absent, empty or of an earlier run"):
        reproduce(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["note.txt"]
    out = tmp_path / "out"
    reproduce(out, size="reduced", seed=3)
    for changed, text in (
        ({"size": "full", "seed": 3}, "of another size"),
        ({"size": "reduced", "seed": 4}, "with another seed"),
    ):
        with pytest.raises(ValueError, match=f"holds a reproduction {text} .*; choose another folder"):
            reproduce(out, **changed)
    monkeypatch.setattr(run, "RESULTS", run.RESULTS + 1)
    with pytest.raises(ValueError, match="by another version of the experiments"):
        reproduce(out, size="reduced", seed=3)
    (out / "reproduce.json").write_text("nonsense")
    with pytest.raises(ValueError, match=r"reproduce\.json: must be JSON"):
        reproduce(out, size="reduced", seed=3)
    assert len(quick) == 5
    with pytest.raises(ValueError, match="size: must be one of full, reduced, got 'huge'"):
        reproduce(tmp_path / "other", size="huge")
    assert not (tmp_path / "other").exists()


def test_the_command_prints_what_was_found_or_one_line(quick, tmp_path, monkeypatch, capfd):
    out = tmp_path / "out"
    assert cli.main(["reproduce", "--out", str(out), "--size", "reduced", "--json"]) == 0
    found = json.loads(capfd.readouterr().out)
    assert (found["seed"], found["size"]) == (1, "reduced")
    assert sorted(found["stages"]) == sorted(STAGES)
    for name in ("report", "markdown", "result"):
        assert (out / found[name].rpartition("/")[2]).is_file()
    assert cli.main(["reproduce", "--out", str(out)]) == 2
    assert (
        f"holds a reproduction of another size (results {RESULTS}, seed 1); choose another folder"
        in capfd.readouterr().err
    )
    assert cli.main(["reproduce", "--out", str(tmp_path)]) == 2
    assert "it has files but no reproduce.json" in capfd.readouterr().err

    def failing(folder, size, seed, within):
        raise RuntimeError("the light is off")

    monkeypatch.setitem(run.STAGES, "timing", run.STAGES["timing"]._replace(run=failing))
    assert cli.main(["reproduce", "--out", str(tmp_path / "two"), "--size", "reduced"]) == 1
    err = capfd.readouterr().err
    assert "designlab: reproduce, stage timing: the light is off" in err
    assert not (tmp_path / "two" / "report.html").exists()


def test_shares_of_parts_that_count_anew_only_grow():
    share = Growing({"a": 3.0, "b": 1.0})
    told = [("a: one", 0, 4), ("a: one", 4, 4), ("a: two", 0, 2), ("b", 0, 1), ("b", 1, 1), ("c", 0, 1)]
    found = [share(*each) for each in told]
    assert found == sorted(found)
    assert found == pytest.approx([0.0, 0.75, 0.75, 0.75, 1.0, 1.0])


def test_the_parts_of_accuracy_are_those_it_tells_of():
    from designlab.validation.paper_2020.accuracy import MODELS

    parts = list(STAGES["accuracy"].parts(SIZES["full"]))
    assert len(parts) == 2 * (1 + 2 * len(MODELS))
    for begun in (f"gelsight-2020-dome: {MODELS[1]}: ", f"gelsight-2020-dome: {MODELS[1]}, comparing: "):
        assert [part for part in parts if f"{begun}x".startswith(part)] == [begun]


def test_progress_tells_of_a_hidden_sensor_that_is_being_fitted(monkeypatch, tmp_path):
    from designlab.validation.paper_2020 import recovery

    def repeat(number, folder, *, progress):
        for done in range(6):
            progress("fitting" if done < 3 else "errors", done, 6)
        values = [{"name": "contact.kernel_length_mm", "true": 0.1, "found": 0.11, "se": 0.01}]
        return {"sensor": "made", "values": values}

    monkeypatch.setattr(recovery, "repeat", repeat)
    size, told = replace(TINY, repeats=12), []
    within = run.stage_progress(
        lambda what, done, of: told.append((what, done / of)), STAGES["recovery"], size, 0.0, 900.0
    )
    assert STAGES["recovery"].run(tmp_path, size, 1, within)["covered"]["share"] == 1.0
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert len(set(shares)) > 4 * size.repeats
    begun = dict(told)
    assert begun["hidden sensors: number 1 of 12"] == 0.0
    assert begun["hidden sensors: number 11 of 12"] == pytest.approx(10 / 12, abs=1e-3)


def test_pictures_of_accuracy_are_named_relative_to_its_folder(result, tmp_path):
    """The experiment takes what is kept in its folder, where pictures have whole paths."""
    for name, found in result["stages"]["accuracy"]["sensors"].items():
        place = tmp_path / name.rpartition("-")[2]
        place.mkdir()
        found["pictures"] = {"comparison": str(place / "comparison.png")}
        (place / "accuracy.json").write_text(json.dumps(found))
    found = STAGES["accuracy"].run(tmp_path, SIZES["full"], 1, lambda what, done, of: None)
    pictures = [sensor["pictures"]["comparison"] for sensor in found["sensors"].values()]
    assert pictures == ["flat/comparison.png", "dome/comparison.png"]


@pytest.mark.renders
def test_more_samples_are_nearer_to_the_reference_and_the_fast_estimator_nearest(backend, tmp_path):
    steps = []
    found = timing(tmp_path, size=TINY, progress=lambda what, done, of: steps.append((done, of)))
    assert [(row["px"], row["samples"]) for row in found["path"]] == [(30, 4), (30, 8)]
    coarse, fine = found["path"]
    # Eight samples are two independent passes of four: half the squared error, 3.01 dB.
    assert fine["snr_db"] - coarse["snr_db"] == pytest.approx(3.01, abs=0.5)
    assert fine["ssim"] > coarse["ssim"]
    (fast,) = found["fast"]
    assert fast["snr_db"] > fine["snr_db"]
    assert fast["first_ms"] > fast["next_ms"] > 0
    assert all(row["ms"] > 0 and row["paper_ms"] is None for row in found["path"])
    assert found["device"]
    assert found["backend"] == backend.variant
    assert steps == sorted(steps)
    assert steps[-1][0] < steps[-1][1]
    assert list(tmp_path.iterdir()) == [], "light fields are not kept"
    assert PAPER_MS[600, 8] == 95.0


@pytest.mark.renders
def test_strips_of_the_light_probe_are_where_they_must_appear(backend, tmp_path):
    found = probe(tmp_path, size=TINY)
    assert [strip["channel"] for strip in found["strips"]] == ["red", "red", "green", "green", "blue", "blue"]
    assert len({strip["lobe"] for strip in found["strips"]}) == 6
    assert found["unmatched"] == 0
    for strip in found["strips"]:
        assert strip["apart_deg"] < 0.5
        assert strip["solid_angle_ratio"] == pytest.approx(1.0, abs=0.02)
    assert (tmp_path / found["picture"]).is_file()
