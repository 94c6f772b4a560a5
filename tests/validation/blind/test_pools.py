"""Pools of planted sets, and what their scores count."""

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import pytest

from designlab.app import cli
from designlab.core.progress import silent
from designlab.core.store import write_json
from designlab.inference.diagnosis.result import Level
from designlab.measurement import Measurement
from designlab.measurement.frames import MeasuredFrame
from designlab.sensor.design import preset
from designlab.simulation.effects import effect
from designlab.validation.blind import (
    Crew,
    Outcome,
    Transferred,
    Trial,
    development,
    further,
    power,
    run,
    score,
    transfers,
)
from designlab.validation.blind.detection import in_units
from designlab.validation.blind.frozen import code_digest
from designlab.validation.blind.pool import AIR, KITS, frames_of
from designlab.validation.blind.runner import kept
from designlab.validation.blind.score import rate, reliability
from designlab.validation.blind.transfer import HIGHER_MM, MORE_TILT_DEG, other, removed, summary
from designlab.validation.synthetic import effects as planted
from designlab.validation.synthetic.unmodelled import outside_kinds
from tests.helpers.outcomes import outcome

POOL = development()


def test_the_pool_holds_what_it_should() -> None:
    assert sum(trial.kind == "nothing" for trial in POOL) == 30
    assert len({trial.kind for trial in POOL if trial.effects}) >= 16
    assert sum(bool(trial.outside) for trial in POOL) == 18
    assert len({trial.name for trial in POOL}) == len({trial.seed for trial in POOL}) == len(POOL)
    assert not {t.seed for t in development(base=10_000)} & {t.seed for t in POOL}


def test_every_set_can_be_planted() -> None:
    known = set(planted.names())
    for trial in POOL:
        assert preset(trial.design).name == trial.design
        assert set(trial.effects) <= known
        assert set(trial.outside) <= set(outside_kinds())


def test_one_set_of_each_design_comes_first_then_the_last_and_what_is_there_is_kept(tmp_path) -> None:
    @dataclass(frozen=True)
    class Record:
        trial: dict

    trials = [Trial(f"t{k}", design, k) for k, design in enumerate("aabab")]
    ran: list[str] = []

    def fails_at(name: str):
        def one(trial: Trial, folder: Path) -> Record:
            ran.append(trial.name)
            if trial.name == name:
                raise RuntimeError(name)
            return Record(asdict(trial))

        return one

    with pytest.raises(RuntimeError, match="t3"):
        kept(trials, tmp_path, "records", fails_at("t3"), silent, Crew())
    assert ran == ["t0", "t2", "t4", "t3"]
    told: list[tuple[int, int]] = []
    found = kept(
        trials, tmp_path, "records", fails_at(""), lambda _, done, total: told.append((done, total)), Crew()
    )
    assert ran[4:] == ["t1", "t3"]
    assert [one["trial"]["name"] for one in found] == [trial.name for trial in trials]
    assert told[0] == (3, 5)
    assert told[-1] == (5, 5)
    stronger = [*trials[:4], replace(trials[4], effects={"vignetting": 1.0})]
    with pytest.raises(ValueError, match=r"t4-4\.json: holds a set that was defined otherwise"):
        kept(stronger, tmp_path, "records", fails_at(""), silent, Crew())


@pytest.mark.parametrize(
    ("text", "words"), [('{"trial": ', "is damaged"), ("[]", "no record"), ("{}", "otherwise")]
)
def test_a_damaged_record_is_named(tmp_path, text, words) -> None:
    path = tmp_path / "outcomes" / "t-1.json"
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"t-1\.json: .*{words}"):
        run([Trial("t", AIR[0], 1)], tmp_path)


def test_records_of_another_version_are_named(tmp_path) -> None:
    trial = Trial("t", AIR[0], 1)
    write_json(tmp_path / "outcomes" / "t-1.json", {"trial": asdict(trial), "verdict": "named"})
    with pytest.raises(ValueError, match="another version"):
        run([trial], tmp_path)


def test_strengths_are_told_in_the_units_of_their_parameters() -> None:
    design = preset(AIR[0])
    position = "0.25 mm (radial_mm, height_mm, tangential_mm)"
    assert in_units("led_position", 0.5, design) == position
    assert in_units("contact_profile", 0.5, design) == "0.1 (tail_share)"  # its length only shapes it


def test_names_sets_gaps_and_intervals_are_counted() -> None:
    nothing, wrong = Trial("n", AIR[0], 1), Trial("w", AIR[0], 2, {"vignetting": 1.0})
    right = Trial("r", AIR[0], 3, {"vignetting": 1.0})
    strange = Trial("s", AIR[0], 4, outside={"debris": 1.0})
    both = Trial("b", AIR[0], 5, {"vignetting": 1.0, "banding": 1.0})
    lacking = Trial("l", AIR[0], 6, {"vignetting": 3.0}, without=("vignetting",))
    found = score(
        [
            outcome(nothing, verdict="at_floor", sets=[]),
            outcome(nothing, verdict="named", sets=[["banding"]]),
            outcome(right, verdict="named", sets=[["vignetting"]], after=2.0, corner_loss=0.3),
            outcome(wrong, verdict="ambiguous", sets=[["albedo_field", "vignetting"]], after=7.0),
            outcome(strange, verdict="partial", sets=[["banding"]]),
            outcome(strange, verdict="named", sets=[["banding"]]),
            outcome(both, verdict="named", sets=[["banding"], ["vignetting"]]),
            outcome(both, verdict="partial", sets=[["banding"]]),
            outcome(lacking, verdict="unexplained", sets=[]),
            outcome(lacking, verdict="ambiguous", sets=[["albedo_field", "led_profile"]]),
        ]
    )
    for part in ("nothing", "outside"):
        assert (found[part]["sets"], found[part]["named"]["share"]) == (2, 0.5)
    assert [found["pair"][k]["share"] for k in ("right_first", "all_named")] == [1.0, 0.5]
    left_out = found["left_out"]
    assert [left_out[k]["share"] for k in ("named", "named_or_ambiguous", "abstained")] == [
        0.0,
        0.5,
        0.5,
    ]
    single = found["single"]
    assert [single[k]["share"] for k in ("right_first", "truth_in_set", "intervals_hold")] == [0.5, 1.0, 1.0]
    assert single["set_size_mean"] == 1.5
    assert found["confusion"]["nothing"] == {"at_floor": 1, "banding": 1}
    assert single["value_error_median"] == pytest.approx(0.1)
    assert single["control_removed_median"] == 0.1
    assert found["confusion"]["vignetting, not in the catalogue"] == {"unexplained": 1, "albedo_field": 1}
    assert found["confusion"]["vignetting"] == {"vignetting": 1, "albedo_field": 1}
    assert single["gap_removed_median"] == pytest.approx((0.9 + 0.4) / 2)


def test_what_names_with_much_confidence_are_worth_is_counted() -> None:
    def said(hidden: str, names: list[str], *confidence: float) -> Outcome:
        trial = Trial("t", AIR[0], 1, {hidden: 1.0} if hidden else {})
        made = outcome(trial, verdict="named", sets=[[name] for name in names])
        return replace(made, confidence=list(confidence))

    found = score(
        [
            said("vignetting", ["vignetting"], 0.95),
            said("vignetting", ["vignetting", "banding"], 0.9, 0.7),
            said("vignetting", ["led_tilt"], 0.9),
            said("vignetting", ["vignetting", "led_tilt"], 0.6, 0.4),  # the second is said to be doubtful
            said("", ["led_tilt"], 0.4),
            said("banding", []),
        ]
    )
    single = found["single"]
    assert [single[k]["share"] for k in ("sure", "further_wrong")] == [3 / 5, 1 / 5]
    assert (found["sure_names"]["share"], found["sure_names"]["sets"]) == (pytest.approx(2 / 3), 3)
    # Taken in turn: right, wrong (of two alike the worse), right, right, wrong.
    curve = found["risk_coverage"]
    assert curve["area"] == pytest.approx((0 + 1 / 2 + 1 / 3 + 1 / 4 + 2 / 5) / 5)
    assert (curve["names"], curve["wrong"]) == (5, 2 / 5)
    assert score([said("banding", [])])["risk_coverage"] is None


def test_confidence_is_compared_with_how_often_names_are_right() -> None:
    # Of names that are said to be 90 % sure 6 of 10 are right, of those said to be 50 % sure half.
    said = [(0.9, k < 6) for k in range(10)] + [(0.5, k < 5) for k in range(10)]
    found = reliability(said)
    assert found is not None
    assert [(b["confidence"], b["right"], b["names"]) for b in found["bins"]] == [
        (pytest.approx(0.5), 0.5, 10),
        (pytest.approx(0.9), 0.6, 10),
    ]
    assert found["error"] == pytest.approx((10 * 0.0 + 10 * 0.3) / 20)
    assert reliability([(0.9, True)]) is None


def test_kits_have_fewer_frames_of_the_same_set() -> None:
    frames = [
        MeasuredFrame(file="dark.exr", kind="dark"),
        MeasuredFrame(file="red.exr", kind="background", leds=("red",)),
        MeasuredFrame(file="all.exr", kind="background"),
        MeasuredFrame(file="short.exr", kind="background", exposure=0.5),
        MeasuredFrame(file="turned.exr", kind="background", gel_rotation_deg=180.0),
        MeasuredFrame(file="press.exr", kind="press", probe="sphere:4"),
        MeasuredFrame(file="further-01.exr", kind="dark"),
    ]
    measurement = Measurement(frames=tuple(frames))
    kept = {kit: [frame.file.split(".")[0] for frame in frames_of(measurement, kit).frames] for kit in KITS}
    assert kept["hour"] == [frame.file.split(".")[0] for frame in frames]
    assert kept["no_dark"] == kept["hour"][1:]
    assert kept["no_groups"] == ["dark", *kept["hour"][2:]]
    assert kept["plain"] == ["all", "press", "further-01"]
    hour, plain = Trial("t", "d", 1), Trial("t", "d", 1, kit="plain")
    assert hour.set_label == plain.set_label
    assert hour.label != plain.label
    assert replace(hour, further=({"kind": "dark"},)).set_label != hour.set_label


def test_ambiguous_sets_are_settled_when_the_right_name_alone_is_left() -> None:
    trial = Trial("a", AIR[0], 1, {"vignetting": 1.0})
    before = outcome(trial, verdict="ambiguous", sets=[["albedo_field", "vignetting"]])
    ends = [
        outcome(trial, verdict="named", sets=[["vignetting"]]),
        outcome(trial, verdict="ambiguous", sets=[["vignetting", "albedo_field"]]),
        outcome(trial, verdict="named", sets=[["albedo_field"]]),
        outcome(trial, verdict="unexplained", sets=[]),
    ]
    found = further.summary([(before, after) for after in ends])
    assert [row["resolved"] for row in found["rows"]] == [True, False, False, False]
    assert (found["resolved"]["share"], found["sets"]) == (0.25, 4)
    assert further.summary([])["resolved"] is None


def test_transfers_are_of_effects_that_hold_for_other_designs() -> None:
    pool = transfers(POOL)
    assert len(pool) >= 20
    assert all(effect(trial.kind).transferable for trial in pool)
    assert len({trial.kind for trial in pool}) >= 8
    assert {trial.design for trial in pool} == set(AIR)
    assert {trial.name for trial in pool} <= {trial.name for trial in POOL}
    left_out = Trial("l", AIR[0], 1, {"led_profile": 3.0}, without=("led_profile",))
    assert transfers([left_out]) == []


@pytest.mark.parametrize("name", sorted({trial.design for trial in transfers(POOL)}))
def test_the_other_design_can_be_built_and_takes_every_effect(name: str) -> None:
    design = preset(name)
    changed = other(design)  # infeasible ones raise
    assert changed.leds.height_mm == pytest.approx(design.leds.height_mm + HIGHER_MM)
    assert changed.leds.tilt_deg == pytest.approx(design.leds.tilt_deg + MORE_TILT_DEG)
    for trial in transfers(POOL):
        if trial.design == name:
            assert effect(trial.kind).parameters(changed) == effect(trial.kind).parameters(design)


def test_intervals_of_rates_are_those_of_tables() -> None:
    # 0 of 10 and 5 of 10: Clopper and Pearson's table.
    none, half = rate([False] * 10), rate([True] * 5 + [False] * 5)
    assert none is not None
    assert half is not None
    assert (none["low"], none["high"]) == pytest.approx((0.0, 0.3085), abs=1e-4)
    assert (half["low"], half["high"]) == pytest.approx((0.1871, 0.8129), abs=1e-4)
    assert rate([]) is None


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (["--pool", "power", "--only", "nosuch"], "no set's name matches 'nosuch'"),
        (["--transfer", "--kit", "plain"], "--transfer: is for --kit hour"),
        (["--transfer", "--only", "nothing"], "--transfer: none of these 30 sets hides one effect"),
        (["--only", "("], "must be a regular expression"),
        (["--workers", "0"], "must lie between 1 and 256"),
        (["--only", "nothing-00", "--dask", "nonsense://x"], "nonsense"),
    ],
)
def test_wrong_settings_of_a_benchmark_are_one_line(words, rule, tmp_path, capsys) -> None:
    assert cli.main(["gap", "benchmark", *words, "--out", str(tmp_path / "out")]) in (1, 2)
    error = capsys.readouterr().err
    assert rule in error
    assert error.count("designlab: ") == 1
    assert "defect" not in error


@pytest.mark.slow
def test_a_finished_pool_is_scored_from_its_records(tmp_path, capsys) -> None:
    for trial in power():
        if trial.name.startswith("power-vignetting"):
            (strength,) = trial.effects.values()
            seen = [["vignetting"]] if strength >= {AIR[0]: 0.5, AIR[1]: 1.0}[trial.design] else []
            record = outcome(trial, verdict="named" if seen else "at_floor", sets=seen)
            write_json(tmp_path / "outcomes" / f"{trial.name}-{trial.seed}.json", asdict(record))
    words = ["gap", "benchmark", "--pool", "power", "--only", "vignetting", "--out", str(tmp_path)]
    assert cli.main(words) == 0
    table = capsys.readouterr().out
    assert "power-vignetting-dome-0.25" in table
    limit = json.loads((tmp_path / "score.json").read_text())["limits"]["vignetting"]
    assert 0.25 < limit["strength"] < 1.0
    assert [0.5, False, AIR[1]] in limit["tried"]
    assert [0.5, True, AIR[0]] in limit["tried"]
    assert limit["designs"][AIR[0]] < limit["designs"][AIR[1]]
    assert limit["low"] < limit["strength"] < limit["high"]
    records = [json.loads(line) for line in (tmp_path / "records.jsonl").read_text().splitlines()]
    assert len(records) == 24
    record = next(r for r in records if r["set"] == "power-vignetting-dome-2-a")
    assert record["hidden"] == {"vignetting": 2.0}
    assert record["named"] == ["vignetting"]
    assert record["family"] == "single"


@pytest.mark.slow
def test_sets_on_record_are_not_run_again_and_count(tmp_path, capsys) -> None:
    """Sets that lie in neither folder would be run, which takes minutes: the other half is on record."""
    there, here = tmp_path / "there", tmp_path / "here"
    for trial in power():
        if trial.name.startswith("power-vignetting"):
            folder = there if trial.design == AIR[0] else here
            named = replace(outcome(trial, verdict="named", sets=[["vignetting"]]), code=code_digest())
            write_json(folder / "outcomes" / f"{trial.name}-{trial.seed}.json", asdict(named))
    words = ["gap", "benchmark", "--pool", "power", "--only"]
    assert cli.main([*words, "vignetting-flat", "--out", str(there)]) == 0
    records = there / "records.jsonl"
    both = [*words, "vignetting", "--out", str(here), "--records", str(records)]
    assert cli.main([*both, "--json"]) == 0
    found = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert found["single"]["sets"] == len(found["rows"]) == 24
    assert len((here / "records.jsonl").read_text().splitlines()) == 24

    text = records.read_text()
    for changed, said in (
        (text.replace(code_digest(), "0123abcd4567"), "line 1: set power-vignetting-flat-0.0625-a was run"),
        (text.replace('"seed"', '"sead"'), "line 1: is no record"),
        (text[:-5], "line 12: is no record"),
    ):
        records.write_text(changed)
        assert cli.main(both) == 2
        assert said in capsys.readouterr().err
    records.unlink()
    assert cli.main(both) == 2
    assert "--records" in capsys.readouterr().err
    assert cli.main([*both, "--further"]) == 2
    assert "hold scores alone" in capsys.readouterr().err


def transferred(before: float, after: float, floor: float) -> Transferred:
    share = removed(Level(before, after, floor, floor))
    return Transferred(
        asdict(Trial("t", "d", 1)), {}, "named", [], [], [], before, after, floor, share, [], 1.0
    )


def test_the_share_of_the_gap_removed_and_its_median() -> None:
    assert removed(Level(11.0, 3.0, 2.0, 1.0)) == pytest.approx(0.8)
    assert removed(Level(11.0, 16.0, 2.0, 1.0)) == pytest.approx(-0.5)  # a correction that makes it worse
    assert removed(Level(1.9, 1.45, 2.0, 1.0)) == pytest.approx(0.5)
    assert removed(Level(1.05, 1.0, 2.0, 1.0)) is None
    found = summary(
        [transferred(11.0, after, 1.0) for after in (1.0, 3.0, 6.0)] + [transferred(0.9, 0.8, 1.0)]
    )
    assert found["sets"] == 4
    assert found["without_gap"] == 1
    assert found["median"] == pytest.approx(0.8)
    # The median of three drawn anew is the least or the greatest of them in 7 of 27 cases each.
    assert (found["low"], found["high"]) == pytest.approx((0.5, 1.0))
