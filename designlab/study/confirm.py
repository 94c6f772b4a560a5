"""Confirmation: the best designs of a search are evaluated again, with more effort and other random numbers.

The best of many noisy scores is too good on average (winner's curse), since its noise was chosen with it.
Fresh seeds have no part in that choice. Of a robust study they draw fresh copies too: those that the search
was made with suited its best by chance.
"""

from collections.abc import Callable
from contextlib import closing
from typing import TYPE_CHECKING, NamedTuple

from designlab.attempt import Evaluator, evaluate_design
from designlab.store import write_json
from designlab.study.definition import BASE, Study
from designlab.study.folder import confirmation_path
from designlab.study.results import CONFIRMING, Results
from designlab.study.shortlist import picks
from designlab.workers import finished

if TYPE_CHECKING:
    import pandas as pd

    from designlab.interrupts import Interrupts

FRESH = 1_000_003  # between the seed of a search and those of its confirmation


class Stage(NamedTuple):
    """A round of confirmation: designs, effort, seeds."""

    trials: tuple[int, ...]
    fidelity: str
    seeds: tuple[int, ...]


def confirm(
    results: Results,
    evaluator: Evaluator,
    *,
    workers: int,
    interrupts: "Interrupts",
    on_progress: Callable[[str, int, int], None],
) -> None:
    """Evaluate the best designs again, by the study's plan; what is there already is kept.

    The best of the search go to standard fidelity, the best of those to the highest, each beside the base.
    """
    study = results.study
    if study.plan is None or results.pareto.empty:
        return
    best = picks(results.frame, study.objectives, most=study.plan.promoted, parameters=study.varied)
    efforts = (study.plan.promoted, 1), (study.plan.confirmed, study.plan.seeds)
    for fidelity, (most, seeds) in zip(CONFIRMING, efforts, strict=True):
        trials = tuple(int(trial) for trial in best["trial"].iloc[:most])
        stage = Stage((BASE, *trials), fidelity, fresh(study, fidelity, seeds))
        _run(stage, results, evaluator, workers, interrupts, on_progress)
        again = results.confirmed
        rows = _as_trials(again[again["fidelity"] == fidelity], results)
        best = picks(rows, study.objectives, most=most, parameters=study.varied)
        if best.empty:
            return


def fresh(study: Study, fidelity: str, count: int) -> tuple[int, ...]:
    """Seeds that neither the search nor another fidelity has used."""
    first = (study.seed + FRESH * (1 + CONFIRMING.index(fidelity))) % 2**31
    return tuple(first + k for k in range(count))


def _run(
    stage: Stage,
    results: Results,
    evaluator: Evaluator,
    workers: int,
    interrupts: "Interrupts",
    on_progress: Callable[[str, int, int], None],
) -> None:
    wanted = [(trial, seed) for trial in stage.trials for seed in stage.seeds]
    subjects = {trial: results.subject(trial) for trial in stage.trials}
    paths = {
        (trial, seed): confirmation_path(results.folder, trial, subjects[trial].digest, stage.fidelity, seed)
        for trial, seed in wanted
    }
    missing = [call for call in wanted if not paths[call].is_file()]
    done = len(wanted) - len(missing)
    on_progress(stage.fidelity, done, len(wanted))
    calls = [(evaluate_design, evaluator, subjects[trial], stage.fidelity, seed) for trial, seed in missing]
    with closing(finished(calls, workers=workers, interrupts=interrupts)) as outcomes:
        for place, outcome in outcomes:
            trial, seed = missing[place]
            digest = subjects[trial].digest
            about = {"trial": trial, "design": digest, "fidelity": stage.fidelity, "seed": seed}
            write_json(paths[trial, seed], about | outcome)
            done += 1
            on_progress(stage.fidelity, done, len(wanted))


def _as_trials(again: "pd.DataFrame", results: Results) -> "pd.DataFrame":
    """Confirmed designs as rows of the table of trials, those that break a constraint now marked."""
    import pandas as pd

    study = results.study
    own = again[again["trial"] != BASE].merge(results.frame[["trial", *study.varied]], on="trial")
    broken = [
        [name for name, bound in study.constraints.items() if bound.broken_by(float(row[name])) > 0] or None
        for _, row in own.iterrows()
    ]
    marked = pd.Series(broken, index=own.index, dtype=object)
    return own.assign(state="complete", reuse_of=None, violated=marked)
