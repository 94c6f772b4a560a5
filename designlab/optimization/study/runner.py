"""Run a study: in this process or several, with progress, interruptible and resumable."""

from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from designlab.core.interrupts import Interrupts
from designlab.core.progress import bar
from designlab.core.types import Progress
from designlab.core.workers import death, submitter
from designlab.evaluation.contact_scores import OWN_PRESSES
from designlab.evaluation.illumination_scores import SCORES
from designlab.optimization.outcome import Evaluator, Simulated
from designlab.optimization.study.confirm import confirm
from designlab.optimization.study.definition import Study
from designlab.optimization.study.folder import opened
from designlab.optimization.study.results import Results, load_results
from designlab.optimization.study.robust import RobustEvaluator
from designlab.optimization.study.search import StudyRun

_DEATHS = 5  # deaths in a row, no design being finished between, after which more than designs is at fault


class StudyInterrupted(KeyboardInterrupt):
    """A study was stopped by the user; the text says how far it came and how to resume it."""


def run_study(
    study: Study,
    *,
    out: str | Path,
    trials: int | None = None,
    workers: int = 1,
    progress: bool = True,
    evaluator: Evaluator | None = None,
    storage: str | None = None,
    rebuild: bool = False,
) -> Results:
    """Run a study until its number of designs is evaluated; go on where an earlier run in the folder ended.

    The first design is the base design, if the ranges hold it. Every design is evaluated with the study's own
    presses and seed, so designs are compared on the same presses with the same random numbers. Infeasible
    designs are recorded and never evaluated, equal designs are evaluated once. With one worker, a study that
    was killed and resumed gives the same trials as one that was not.

    Parameters
    ----------
    study : Study
        What to vary and what to improve.
    out : str or Path
        Folder of the study: ``study.toml``, the record ``study.db``, and design and score of each evaluated
        trial under ``trials/NNNN``.
    trials : int, optional
        Number of evaluated designs in the end, those of earlier runs included; the study's own when absent.
    workers : int
        Processes that evaluate at the same time. With more than one, a script needs the usual
        ``if __name__ == "__main__":`` guard, and `evaluator` must be a function of a module.
    progress : bool
        Whether to show a bar with the time left on stderr.
    evaluator : callable, optional
        Called as ``evaluator(design, fidelity=..., seed=...)``; simulation when absent.
    storage : str, optional
        URL of a database, ``postgresql+psycopg://user@host/name``, that holds the record instead of
        ``study.db``: runs of the same study on other machines, each with a folder of its own, work together.
        Designs of a run that dies are tried again by the others.
    rebuild : bool
        Whether to set the record in the folder aside, if it is damaged or lost, and make a new one of the
        scores that are kept beside it. Infeasible designs are drawn anew.

    Returns
    -------
    Results
        All trials so far.

    Raises
    ------
    StudyError
        If the folder holds another study, or an objective names no score.
    StudyInterrupted
        If the user pressed Ctrl-C; nothing that was finished is lost.
    RuntimeError
        If evaluations fail repeatedly, no feasible design is found, or another run holds the folder.
    """
    total = study.trials if trials is None else trials
    if total < 1 or workers < 1:
        raise ValueError(f"trials and workers must be at least 1, got trials {total}, workers {workers}")
    if evaluator is None:
        study.require_scores(SCORES)
    folder = Path(out)
    with opened(folder, study, storage=storage, rebuild=rebuild) as record:
        robust = study.robust
        asked = {*study.objectives, *study.constraints}
        scored = evaluator or Simulated(
            presses=study.presses,
            all_scores=not asked.isdisjoint(OWN_PRESSES),
            as_built=robust is not None,
        )
        if robust is not None:
            scored = RobustEvaluator(scored, robust, study.objectives)
        search = StudyRun(study, folder, record, scored, shared=storage is not None)
        with Interrupts() as interrupts:
            if rebuild:
                search.rebuild()
            search.recover()
            try:
                with bar("design", begun=search.done, keep=True, shown=progress) as tell:
                    _run(search, total, workers, interrupts, tell)
                if study.plan.promoted:
                    found = load_results(folder, storage=storage)
                    with bar("evaluation", keep=True, shown=progress) as tell:
                        confirm(found, scored, workers=workers, interrupts=interrupts, progress=tell)
            except KeyboardInterrupt:
                raise StudyInterrupted(
                    f"study {study.name!r} interrupted after {search.done} of {total} designs; "
                    f"run it again with the same folder, {folder}, to resume"
                ) from None
    return load_results(folder, storage=storage)


def _run(search: StudyRun, total: int, workers: int, interrupts: Interrupts, progress: Progress) -> None:
    deaths = 0
    while True:
        before = search.done
        try:
            with submitter(workers, interrupts) as submit:
                search.run(total, workers=workers, submit=submit, interrupts=interrupts, progress=progress)
                return
        except BrokenProcessPool as error:
            search.recover()
            deaths = deaths + 1 if search.done == before else 1
            if deaths == _DEATHS:
                raise RuntimeError(
                    f"{death(workers)}; what is finished is kept: the same command goes on"
                ) from error
        except BaseException:
            search.recover(interrupted=True)
            raise
