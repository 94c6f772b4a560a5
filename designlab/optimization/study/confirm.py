"""Confirmation evaluates the best designs of a search again, with more effort and other random numbers.

The best of many noisy scores is too good on average (winner's curse), since its noise was chosen with it.
Fresh seeds have no part in that choice. Of a robust study they draw fresh copies too: those that the search
was made with suited its best by chance.
"""

from contextlib import closing
from functools import partial
from typing import TYPE_CHECKING

from designlab.core.store import write_json
from designlab.core.types import Progress
from designlab.core.workers import finished
from designlab.optimization.outcome import Evaluator, evaluate_design
from designlab.optimization.study.definition import BASE, Study
from designlab.optimization.study.folder import confirmation_path
from designlab.optimization.study.results import CONFIRMING, Results, levels
from designlab.optimization.study.shortlist import picks

if TYPE_CHECKING:
    import pandas as pd

    from designlab.core.interrupts import Interrupts

FRESH = 1_000_003  # between the seed of a search and those of its confirmation


def confirm(
    results: Results,
    evaluator: Evaluator,
    *,
    workers: int,
    interrupts: "Interrupts",
    progress: Progress,
) -> None:
    """Evaluate the best designs again, by the study's plan; what is there already is kept.

    The best of the search are evaluated with a fresh seed at its own fidelity, which tells what of their
    scores was chance, and at those above; the best at the highest of the plan; each beside the base.
    """
    study = results.study
    if not study.plan.promoted or results.pareto.empty:
        return
    best = picks(results.frame, study.objectives, most=study.plan.promoted, parameters=study.varied)
    promoted = tuple(int(trial) for trial in best["trial"])
    again = partial(_run, results, evaluator, workers, interrupts, progress)
    *first, last = levels(study)
    for fidelity in first or [last]:
        again((BASE, *promoted), fidelity, fresh(study, fidelity, 1))
        confirmed = results.confirmed
        rows = _as_trials(confirmed[confirmed["fidelity"] == fidelity], results)
        best = picks(rows, study.objectives, most=study.plan.confirmed, parameters=study.varied)
    trials = tuple(int(trial) for trial in best["trial"])
    if trials:
        again((BASE, *trials), last, fresh(study, last, study.plan.seeds))


def fresh(study: Study, fidelity: str, count: int) -> tuple[int, ...]:
    """Seeds that neither the search nor another fidelity has used."""
    first = (study.seed + FRESH * (1 + CONFIRMING.index(fidelity))) % 2**31
    return tuple(first + k for k in range(count))


def _run(
    results: Results,
    evaluator: Evaluator,
    workers: int,
    interrupts: "Interrupts",
    progress: Progress,
    trials: tuple[int, ...],
    fidelity: str,
    seeds: tuple[int, ...],
) -> None:
    """Evaluate designs with every seed at a fidelity."""
    wanted = [(trial, seed) for trial in trials for seed in seeds]
    subjects = {trial: results.subject(trial) for trial in trials}
    paths = {
        (trial, seed): confirmation_path(results.folder, trial, subjects[trial].digest, fidelity, seed)
        for trial, seed in wanted
    }
    missing = [call for call in wanted if not paths[call].is_file()]
    done = len(wanted) - len(missing)
    progress(f"confirming, {fidelity}", done, len(wanted))
    calls = [(evaluate_design, evaluator, subjects[trial], fidelity, seed) for trial, seed in missing]
    with closing(finished(calls, workers=workers, interrupts=interrupts)) as outcomes:
        for place, outcome in outcomes:
            trial, seed = missing[place]
            digest = subjects[trial].digest
            about = {"trial": trial, "design": digest, "fidelity": fidelity, "seed": seed}
            write_json(paths[trial, seed], about | outcome)
            done += 1
            progress(f"confirming, {fidelity}", done, len(wanted))


def _as_trials(again: "pd.DataFrame", results: Results) -> "pd.DataFrame":
    """Confirmed designs as rows of the table of trials."""
    varied = results.frame[["trial", *results.study.varied]]
    own = again[again["trial"] != BASE].merge(varied, on="trial")
    return own.assign(state="complete", reuse_of=None)
