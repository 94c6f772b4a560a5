"""Pools that are scored without being looked at: one teaches what diagnoses are wrong by, one tests, once.

Seeds of the test pool come from the commit that froze the thresholds, so that nobody can have seen its sets.
"""

import hashlib
import json
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from itertools import combinations, count, islice
from typing import Any

import numpy as np

from designlab.inference.diagnosis.likelihood.empirical_errors import surely_beyond_dirt
from designlab.sensor.design import preset
from designlab.simulation.effects import CATALOGUE, effect
from designlab.validation.blind.pool import AIR, KINDS, KIT_SEED, MORE_KINDS, Trial
from designlab.validation.blind.score import same
from designlab.validation.synthetic.unmodelled import outside_kinds

NAMED_KINDS = (*KINDS, *MORE_KINDS)
OVER_LIMIT = 2.0  # strength of single effects, over that of which half are named
STRONG = 3.0  # prior standard deviations of effects that the catalogue lacks, and the most of all others
PAIR_STRENGTH = 1.0  # prior standard deviations, each; more where that is below `OVER_LIMIT`
CALIBRATION_SEED = 50_000
CALIBRATION = {"nothing": 30, "single": 66, "pair": 20, "outside": 16, "left_out": 18}
TEST = {"nothing": 120, "single": 160, "pair": 40, "outside": 60, "left_out": 60}
DIRTY_SEED = 70_000
DIRTY_CALIBRATION = {"nothing": 30, "single": 66, "pair": 20, "outside": 16}
DIRTY_TEST = {"nothing": 120, "single": 120, "pair": 40, "outside": 60}
IN_DIRT = (1.0, 2.0)  # prior standard deviations of effects beside dirt, in turn, where limits are below
OVER_DIRT = 1.5  # likewise, over that from which effects are surely larger than what dirt makes of them

CONFOUNDED = (
    ("veiling_glare", "black_level"),
    ("black_level", "colour_mixing"),
    ("response_curve", "colour_mixing"),
    ("led_profile", "vignetting"),
    ("led_profile", "led_position"),
    ("led_spread", "led_tilt"),
    ("albedo_field", "led_profile"),
    ("point_spread", "contact_kernel"),
    ("contact_kernel", "contact_profile"),
    ("interreflection", "veiling_glare"),
)
"""Pairs of which one does much of what the other does."""


def calibration(*, dirt: bool = False) -> list[Trial]:
    """Pool to learn from: the families of the test pool, fewer of each, other seeds.

    Parameters
    ----------
    dirt : bool
        Whether sensors have a lab's dirt.
    """
    if dirt:
        return _pool("dirty-calibration", DIRTY_CALIBRATION, DIRTY_SEED, KIT_SEED, dirt=True)
    return _pool("calibration", CALIBRATION, CALIBRATION_SEED, KIT_SEED)


def sealed(commit: str, *, dirt: bool = False) -> list[Trial]:
    """Pool of the test.

    Parameters
    ----------
    commit : str
        Full hash of the commit that froze the thresholds.
    dirt : bool
        Whether sensors have a lab's dirt; such sets have seeds of their own.
    """
    text = f"{commit} with dirt" if dirt else commit
    number = int.from_bytes(hashlib.sha256(text.encode()).digest()[:6])
    name, sizes = ("dirty-test", DIRTY_TEST) if dirt else ("test", TEST)
    return _pool(name, sizes, 1_000_000 + number % 10**12, 1_000 + number % 10**6, dirt=dirt)


@cache
def detection_limits() -> dict[str, dict[str, float]]:
    """Strength at which half of the sets are named right, by kind and design, as last measured.

    Prior standard deviations; ``limits.json`` is the part `limits` of the score of the pool of power curves.
    """
    text = files("designlab.validation.blind").joinpath("limits.json").read_text(encoding="utf-8")
    return {kind: limit["designs"] for kind, limit in json.loads(text).items()}


def strength(kind: str, design: str, least: float = 0.0) -> float:
    """Strength of an effect in these pools (prior standard deviations), `least` where that is more."""
    return float(max(min(OVER_LIMIT * detection_limits()[kind][design], STRONG), least))


def in_dirt(kind: str, design: str) -> float:
    """Least strength of an effect beside dirt: what is smaller, dirt hides from whoever looks."""
    parameters = [p for p in effect(kind).parameters(preset(design)) if not p.shape]
    return OVER_DIRT * surely_beyond_dirt(kind, len(parameters))


def pairs() -> Iterator[tuple[str, str]]:
    """Pairs of effects that can be told apart: every second one from the list of the most confounded."""
    alike = [pair for pair in CONFOUNDED if not same(*pair)]
    listed = {frozenset(pair) for pair in alike}
    others = [
        pair for pair in combinations(NAMED_KINDS, 2) if not same(*pair) and frozenset(pair) not in listed
    ]
    order = np.random.default_rng(0).permutation(len(others))
    for number in count():
        yield others[order[number % len(others)]]
        yield alike[number % len(alike)]


def classes() -> dict[str, tuple[str, ...]]:
    """Effects that act on designs in air, by the stage at which they act."""
    found: dict[str, tuple[str, ...]] = {}
    for each in CATALOGUE:
        if each.name in NAMED_KINDS:
            found[each.stage] = (*found.get(each.stage, ()), each.name)
    return found


def _pool(name: str, sizes: dict[str, int], first: int, kit_seed: int, *, dirt: bool = False) -> list[Trial]:
    seeds = count(first)

    def trial(family: str, number: int, design: int, **hidden: Any) -> Trial:
        return Trial(
            f"{name}-{family}-{number:03d}",
            AIR[design % 2],
            next(seeds),
            kit_seed=kit_seed,
            dirt=dirt,
            **hidden,
        )

    found = [trial("nothing", k, k) for k in range(sizes["nothing"])]
    for k in range(sizes["single"]):
        turn, place = divmod(k, len(NAMED_KINDS))
        kind = NAMED_KINDS[place]
        design = turn + place
        least = 0.0
        if dirt:
            least = max(IN_DIRT[(turn // 2 + place) % len(IN_DIRT)], in_dirt(kind, AIR[design % 2]))
        found.append(trial("single", k, design, effects={kind: strength(kind, AIR[design % 2], least)}))
    for k, pair in enumerate(islice(pairs(), sizes["pair"])):
        turn, place = divmod(k // 2, len(CONFOUNDED))
        design = turn + place
        hidden = {}
        for kind in pair:
            least = in_dirt(kind, AIR[design % 2]) if dirt else 0.0
            hidden[kind] = strength(kind, AIR[design % 2], max(PAIR_STRENGTH, least))
        found.append(trial("pair", k, design, effects=hidden))
    kinds = outside_kinds()
    for k in range(sizes["outside"]):
        turn, place = divmod(k, len(kinds))
        found.append(trial("outside", k, turn + place, outside={kinds[place]: 1.0}))
    stages = list(classes().values())
    for k in range(sizes.get("left_out", 0)):
        turn, place = divmod(k, len(stages))
        round_, number = divmod(turn, len(stages[place]))
        kind = stages[place][number]
        missing = {*stages[place], *(name for name in NAMED_KINDS if same(name, kind))}
        without = tuple(sorted(missing))
        found.append(trial("left_out", k, round_ + number + place, effects={kind: STRONG}, without=without))
    return found
