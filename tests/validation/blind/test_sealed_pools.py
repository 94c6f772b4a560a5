"""Pools that are scored unseen: families, seeds from a commit, code as it was frozen."""

import subprocess
from collections import Counter
from pathlib import Path

import pytest

from designlab.app import cli
from designlab.inference.diagnosis.likelihood.empirical_errors import dirt_sd, unlisted_sd
from designlab.sensor.design import preset
from designlab.simulation.effects import effect
from designlab.validation.blind import calibration, development, power, sealed
from designlab.validation.blind.frozen import code_digest, frozen
from designlab.validation.blind.pool import AIR, Trial, shard
from designlab.validation.blind.score import same
from designlab.validation.blind.sealed_pools import (
    CONFOUNDED,
    DIRTY_TEST,
    IN_DIRT,
    NAMED_KINDS,
    OVER_LIMIT,
    STRONG,
    TEST,
    detection_limits,
    in_dirt,
)
from designlab.validation.synthetic import effects as planted
from designlab.validation.synthetic.unmodelled import outside_kinds

COMMIT = "0123456789abcdef0123456789abcdef01234567"
POOL = sealed(COMMIT)
DIRTY = sealed(COMMIT, dirt=True)


def family(trial: Trial) -> str:
    return trial.name.split("-")[1]


def test_families_have_the_sizes_stated_on_both_designs_alike() -> None:
    assert Counter(family(trial) for trial in POOL) == TEST
    for name in TEST:
        designs = Counter(trial.design for trial in POOL if family(trial) == name)
        assert set(designs) == set(AIR)
        assert abs(designs[AIR[0]] - designs[AIR[1]]) <= 0.2 * TEST[name]


def test_every_kind_is_hidden_at_twice_its_limit() -> None:
    single = [trial for trial in POOL if family(trial) == "single"]
    kinds = Counter(trial.kind for trial in single)
    assert len(kinds) >= 20
    assert set(kinds) <= set(planted.names())
    assert max(kinds.values()) - min(kinds.values()) <= 1
    for trial in single:
        ((kind, strength),) = trial.effects.items()
        limit = detection_limits()[kind][trial.design]
        assert strength == pytest.approx(min(OVER_LIMIT * limit, STRONG))
    assert len({trial.design for trial in single if trial.kind == "vignetting"}) == 2


def test_pairs_can_be_told_apart_and_half_of_them_are_hard_to() -> None:
    pairs = [tuple(trial.effects) for trial in POOL if family(trial) == "pair"]
    assert all(len(pair) == 2 and not same(*pair) for pair in pairs)
    listed = [pair for pair in pairs if pair in CONFOUNDED]
    assert len(listed) == len(pairs) // 2
    assert len(set(pairs)) >= len(pairs) // 2 + len(CONFOUNDED)
    assert all(strength >= 1.0 for t in POOL if family(t) == "pair" for strength in t.effects.values())


def test_outside_and_left_out_sets_hide_what_the_catalogue_lacks() -> None:
    outside = Counter(trial.kind for trial in POOL if family(trial) == "outside")
    assert len(outside) >= 8
    assert set(outside) <= set(outside_kinds())
    left_out = [trial for trial in POOL if family(trial) == "left_out"]
    assert {effect(trial.kind).stage for trial in left_out} == {effect(kind).stage for kind in NAMED_KINDS}
    for trial in left_out:
        stage = effect(trial.kind).stage
        assert set(trial.without) >= {kind for kind in NAMED_KINDS if effect(kind).stage == stage}
        assert trial.effects == {trial.kind: 3.0}


def test_sensors_with_a_labs_dirt_have_a_pool_of_their_own() -> None:
    assert Counter(trial.name.split("-")[2] for trial in DIRTY) == DIRTY_TEST
    assert all(trial.dirt for trial in [*DIRTY, *calibration(dirt=True)])
    assert not any(trial.dirt for trial in [*POOL, *calibration()])
    single = [trial for trial in DIRTY if trial.name.startswith("dirty-test-single")]
    assert len({trial.kind for trial in single}) >= 20
    for kind in NAMED_KINDS:
        hidden = {(trial.design, trial.effects[kind]) for trial in single if trial.kind == kind}
        assert {design for design, _ in hidden} == set(AIR)
        for design, strength in hidden:
            limit = min(OVER_LIMIT * detection_limits()[kind][design], STRONG)
            beyond = in_dirt(kind, design)
            assert strength in [max(limit, beyond, least) for least in IN_DIRT]
    usual = Counter(strength for trial in single for strength in trial.effects.values())
    assert all(usual[strength] > len(single) / 8 for strength in IN_DIRT)
    # Of a fall-off of the lens, three standard deviations of what dirt makes of it, and half as much again.
    assert in_dirt("vignetting", AIR[0]) == pytest.approx(4.5 * dirt_sd("vignetting"), rel=1e-3)
    assert in_dirt("black_level", AIR[0]) == 0.0


def test_no_two_pools_share_a_set() -> None:
    pools = [POOL, sealed(COMMIT[::-1]), DIRTY, calibration(), calibration(dirt=True), development(), power()]
    seeds = [seed for pool in pools for seed in {trial.seed for trial in pool}]
    assert len(seeds) == len(set(seeds)) == sum(len(pool) for pool in pools)
    assert sealed(COMMIT) == POOL
    places = {trial.kit_seed for pool in pools[:3] for trial in pool}
    assert len(places) == 3  # where the test presses, nobody has seen
    assert places.isdisjoint({trial.kit_seed for pool in pools[3:] for trial in pool})


def test_shards_are_parts_of_one_pool_with_sets_of_all_families() -> None:
    parts = [shard(POOL, f"{k}/4") for k in range(1, 5)]
    assert sorted(trial.seed for part in parts for trial in part) == sorted(trial.seed for trial in POOL)
    assert all({family(trial) for trial in part} == set(TEST) for part in parts)
    assert shard(POOL, None) == POOL
    assert len({strength for t in shard(power(), "1/6") for strength in t.effects.values()}) == 6


def test_what_was_learnt_covers_the_catalogue_in_the_package() -> None:
    for kind in NAMED_KINDS:
        for p in effect(kind).parameters(preset(AIR[0])):
            assert 0 < unlisted_sd(kind, p.name, shape=p.shape) < 2
    assert unlisted_sd("never seen", "x", shape=False) > 0
    # A length that only shapes a contact is known worse than how strong that is.
    tail = [unlisted_sd("contact_profile", f"tail_{name}", shape=name == "mm") for name in ("share", "mm")]
    assert tail[0] < tail[1]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """Git checkout with code in two commits."""

    def git(*arguments: str) -> None:
        who = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
        subprocess.run(["git", *who, *arguments], cwd=tmp_path, check=True, capture_output=True)

    git("init", "-q")
    for folder, text in (("designlab", "one"), ("docs", "first"), ("geometries", "g")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "file.py").write_text(text)
    git("add", ".")
    git("commit", "-qm", "first")
    (tmp_path / "docs" / "file.py").write_text("second")
    git("commit", "-qam", "documents")
    return tmp_path


def test_the_code_must_be_what_was_frozen(checkout: Path) -> None:
    first, second = hashes(checkout)
    assert frozen(first[:8], root=checkout) == first
    assert frozen(second, root=checkout) == second  # documents alone have changed
    (checkout / "designlab" / "new.py").write_text("more")
    with pytest.raises(ValueError, match=r"1 files differ, designlab/new\.py"):
        frozen(first, root=checkout)
    (checkout / "designlab" / "file.py").write_text("two")
    with pytest.raises(ValueError, match=r"2 files differ, designlab/file\.py"):
        frozen(first, root=checkout)


def test_later_code_may_run_a_pool_again_if_its_sets_are_the_same(checkout: Path) -> None:
    first, _ = hashes(checkout)
    (checkout / "designlab" / "file.py").write_text("two")
    assert frozen(first, again=True, root=checkout) == first
    (checkout / "designlab" / "validation" / "blind").mkdir(parents=True)
    (checkout / "designlab" / "validation" / "blind" / "limits.json").write_text("{}")
    with pytest.raises(ValueError, match=r"1 files differ, designlab/validation/blind/limits\.json"):
        frozen(first, again=True, root=checkout)


def test_the_digest_of_the_code_changes_with_it_alone(checkout: Path) -> None:
    def now() -> str:
        code_digest.cache_clear()
        return code_digest(checkout)

    before = now()
    (checkout / "docs" / "file.py").write_text("third")
    assert now() == before
    (checkout / "geometries" / "data.toml").write_text("a = 1")
    assert now() != before


def hashes(checkout: Path) -> list[str]:
    """Commits, oldest first."""
    done = subprocess.run(
        ["git", "rev-list", "--reverse", "HEAD"], cwd=checkout, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


@pytest.mark.parametrize("commit", ["nothing", "--all", "HEAD", "0123456789"])
def test_what_is_no_hash_of_a_commit_is_named(checkout: Path, commit: str) -> None:
    with pytest.raises(ValueError, match="must be the hash of a commit of this checkout"):
        frozen(commit, root=checkout)


def test_only_the_checkout_itself_will_do(checkout: Path) -> None:
    # An installed copy within a checkout is not what git compares.
    (checkout / "designlab" / "installed").mkdir()
    with pytest.raises(ValueError, match="needs a git checkout"):
        frozen(hashes(checkout)[0], root=checkout / "designlab" / "installed")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--pool", "test"], "--frozen"),
        (["--frozen", "HEAD"], "--frozen"),
        (["--pool", "test", "--frozen", "no-such-commit"], "no-such-commit"),
        (["--pool", "calibration", "--base", "7"], "--base"),
        (["--pool", "calibration", "--again"], "--again"),
        (["--pool", "power", "--dirt"], "--dirt"),
        (["--shard", "5/4"], "5/4"),
        (["--shard", "half"], "half"),
        (["--shard", "999/1000"], "999/1000"),
        (["--transfer", "--kit", "plain"], "--transfer"),
        (["--transfer", "--further"], "--further"),
    ],
)
def test_what_cannot_be_asked_for_is_one_line(arguments, words, tmp_path, capsys) -> None:
    assert cli.main(["gap", "benchmark", *arguments, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()
