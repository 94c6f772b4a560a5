"""Scores of all presets, as two tables in Markdown: the main ones, and all.

    OMP_NUM_THREADS=1 python benchmarks/preset_scores.py [--fidelity standard --seeds 3 --workers 2] [--write]

With --write the tables take the places of those in docs/presets.md, with today's date. What is finished is
kept in --kept and not evaluated again, unless its preset has changed: remove the folder where the program
has.

Every preset sees presses of its own size at its own places, by the same seeds. What is printed is the mean
over seeds and its standard error: by their spread, or as the evaluations state it if that is larger.
"""

import argparse
import dataclasses
import datetime
import hashlib
import itertools
import json
import math
import os
import re
import statistics
import sys
from pathlib import Path

from designlab.core.interrupts import Interrupts
from designlab.core.store import write_atomic
from designlab.core.workers import finished
from designlab.evaluation.evaluate import FIDELITIES, evaluate
from designlab.evaluation.illumination_scores import Estimate
from designlab.report.page import rounded
from designlab.report.yardsticks import HEADLINES, score_label
from designlab.sensor.design import preset, preset_names, preset_text

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "presets.md"


def over_seeds(found: list[Estimate]) -> Estimate:
    """Mean, with the error by the spread over seeds if that is larger than what each states."""
    values = [each.value for each in found]
    stated = math.hypot(*(each.se for each in found)) / len(found)
    spread = statistics.stdev(values) / math.sqrt(len(values)) if len(values) > 1 else 0.0
    return Estimate(statistics.fmean(values), max(stated, spread), found[0].unit)


def scores_of(name: str, fidelity: str, seed: int, kept: Path) -> dict[str, Estimate]:
    """Scores of a preset, from an earlier run if there was one."""
    stated = hashlib.sha256(preset_text(name).encode()).hexdigest()[:12]
    file = kept / f"{name}-{fidelity}-{seed}-{stated}.json"
    if not file.exists():
        scores = evaluate(preset(name), fidelity=fidelity, seed=seed).score.scores
        write_atomic(file, json.dumps({score: dataclasses.asdict(each) for score, each in scores.items()}))
    return {score: Estimate(**each) for score, each in json.loads(file.read_text("utf-8")).items()}


def main() -> None:
    """Print a row for each score and a column for each preset."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--fidelity", choices=list(FIDELITIES), default="standard")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--write", action="store_true", help="into docs/presets.md")
    parser.add_argument(
        "--kept", type=Path, default=ROOT / "build" / "preset-scores", help="what is finished"
    )
    arguments = parser.parse_args()
    jobs = list(itertools.product(preset_names(), range(arguments.seeds)))
    arguments.kept.mkdir(parents=True, exist_ok=True)
    calls = [(scores_of, name, arguments.fidelity, seed, arguments.kept) for name, seed in jobs]
    runs: dict[str, list[dict[str, Estimate]]] = {name: [] for name in preset_names()}
    with Interrupts() as interrupts:
        for place, found in finished(calls, workers=arguments.workers, interrupts=interrupts):
            name, seed = jobs[place]
            runs[name].append(found)
            print(f"{name}, seed {seed}: done", file=sys.stderr, flush=True)
    columns = {
        name: {score: over_seeds([run[score] for run in own]) for score in own[0]}
        for name, own in runs.items()
    }
    tables = main_scores(columns), all_scores(columns)
    print("\n\n".join(tables))
    if arguments.write:
        text = PAGE.read_text(encoding="utf-8")
        for head, table in zip(("preset", "score"), tables, strict=True):
            old = re.compile(rf"^\| {head} \| (?!what it is).*\n(\|.*\n)+", re.MULTILINE)
            text = old.sub(lambda _, table=table: f"{table}\n", text)
        text = re.sub(r"\d{4}-\d\d-\d\d", str(datetime.date.today()), text)
        PAGE.write_text(text, encoding="utf-8")


def main_scores(columns: dict[str, dict[str, Estimate]]) -> str:
    """A row for each preset, of the scores that stand on the first screen of an evaluation."""
    units = {name: own[name].unit for own in columns.values() for name in HEADLINES if name in own}
    lines = [f"| preset | {' | '.join(score_label(name, units[name]) for name in HEADLINES)} |"]
    lines.append(f"| --- |{' --- |' * len(HEADLINES)}")
    for preset_name, own in columns.items():
        lines.append(f"| `{preset_name}` | {' | '.join(cell(own.get(name)) for name in HEADLINES)} |")
    return "\n".join(lines)


def all_scores(columns: dict[str, dict[str, Estimate]]) -> str:
    """A row for each score, and a column for each preset."""
    lines = [f"| score | {' | '.join(columns)} |", f"| --- |{' --- |' * len(columns)}"]
    for score in dict.fromkeys(score for column in columns.values() for score in column):
        known = [column.get(score) for column in columns.values()]
        unit = next(each.unit for each in known if each is not None)
        title = f"`{score}`" if unit == "1" else f"`{score}` ({unit})"
        lines.append(f"| {title} | {' | '.join(map(cell, known))} |")
    return "\n".join(lines)


def cell(found: Estimate | None) -> str:
    """Value and standard error without their unit; empty for what a preset does not have."""
    return "" if found is None else rounded(found.value, found.se)


if __name__ == "__main__":
    main()
