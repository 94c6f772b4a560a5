"""The search: draw designs, set aside what cannot be built, evaluate the rest, and record all of it."""

import contextlib
import itertools
import secrets
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from designlab.core.interrupts import Interrupts
from designlab.core.store import atomic_folder, write_atomic, write_json
from designlab.core.types import Progress
from designlab.core.workers import Submit
from designlab.evaluation.contact_scores import CONTACT_SCORES
from designlab.optimization.outcome import Evaluator, evaluate_design, prepared
from designlab.optimization.study.definition import Study, StudyError
from designlab.optimization.study.folder import (
    METHOD,
    REBUILD,
    SCORE,
    SCORE_FILE,
    finished_trials,
    kept_numbers,
    read_trial,
    trial_folder,
)
from designlab.optimization.study.samplers import distributions, method, sampler
from designlab.sensor.design import Design, dumps

if TYPE_CHECKING:
    import optuna

    from designlab.simulation.effects.model import SensorModel

REFUSED_MM = 1000.0
"""Violation of a design that is refused before its rules can be measured: worse than any that can."""

HEARTBEAT_S = 30.0
"""How often a run says that it is alive, where others share its record."""

SILENT_S = 150.0
"""How long a run must be silent before another takes its trials over."""

POLL_S = 5.0
"""How often a run that has nothing to do asks what the others of a shared record do."""

RUN = "run"
"""Attribute of a trial in a shared record that tells which run has it."""

ALIVE = "alive"
"""Attribute of a shared record, before the name of a run: a count that goes up while that run lives."""

REPEAT = "reuse_of"
"""What a trial with the score of an equal design before names that one by."""

_GIVE_UP = 1000  # infeasible designs in a row after which the ranges are taken to hold no feasible one
_REPEATS = 100  # known designs in a row after which the ranges are taken to hold no other
_FAILURES = 10  # failed evaluations in a row after which something other than the design is at fault


class Task(NamedTuple):
    """A design under evaluation, what is evaluated for it, and the trial it belongs to.

    One over which, or beside which, a process has died is evaluated `alone`.
    """

    trial: "optuna.Trial"
    design: Design
    subject: "Design | SensorModel"
    alone: bool


class StudyRun:
    """One run of a study on its record.

    A trial takes a slot: 0, 1, 2, ... The seed of a draw depends on the study's seed and the slot alone, so a
    run that was interrupted and resumed proposes what an uninterrupted one does.
    """

    def __init__(
        self,
        study: Study,
        folder: Path,
        record: "optuna.Study",
        evaluator: Evaluator,
        *,
        shared: bool = False,
    ) -> None:
        self.study = study
        self.folder = folder
        self.record = record
        self.evaluator = evaluator
        self.shared = shared
        self.distributions = distributions(study)
        self._known: dict[str, int] = {}  # design digest -> number of the trial that evaluated it
        self._refused: dict[str, dict[str, Any]] = {}  # design digest -> why evaluation found it infeasible
        self._followers: dict[str, list[Task]] = {}  # trials that wait for an equal design under evaluation
        self._own: set[int] = set()  # numbers of the trials that this run holds
        self._signs: dict[int, tuple[Any, float]] = {}  # of each other trial: last sign of life, since when
        # Runs that share a record draw at the same time: each has luck of its own.
        self._luck = [secrets.randbits(32)] if shared else []
        self._rejected = 0  # in a row: before a picture is made, or by the evaluation itself
        self._repeated = 0  # in a row
        self._failed = 0
        self.done = 0
        self.infeasible = 0

    def rebuild(self) -> None:
        """Fill an empty record with the trials whose scores are kept in the folder, under their numbers.

        What was infeasible or failed is not kept there, and drawn again.
        """
        from optuna.samplers import RandomSampler
        from optuna.trial import TrialState

        kept = finished_trials(self.folder)
        self.record.sampler = RandomSampler(seed=0)  # nothing is drawn
        for number in range(max(kept, default=-1) + 1):
            if number not in kept:
                self.record.tell(self.record.ask(), state=TrialState.FAIL)
                continue
            attributes = {"slot": number} | {k: kept[number][k] for k in (METHOD,) if k in kept[number]}
            self.record.enqueue_trial(dict(kept[number]["parameters"]), user_attrs=attributes)
            trial = self.record.ask(self.distributions)
            self._tell(trial, kept[number]["scores"], _repeat(kept[number]))

    def recover(self, *, interrupted: bool = False) -> None:
        """Settle the trials that were running when their run ended.

        One whose score had been written is completed from it. Any other is marked failed and its design tried
        again: always after an interruption by the user, once, and alone, after a death of the process, since
        the design may have been its cause.
        """
        import optuna
        from optuna.trial import TrialState

        trials = self.record.get_trials(deepcopy=False)
        lost = [number for number in kept_numbers(self.folder) if number >= len(trials)]
        if lost and not self.shared:  # what is drawn next would take their place
            raise StudyError(f"{self.folder}: the record lacks trial {lost[0]}, which is kept; {REBUILD}")
        for trial in trials:
            if trial.state != TrialState.RUNNING or (self.shared and trial.number not in self._own):
                continue
            saved = read_trial(self.folder, trial)
            if saved is not None and saved.get("parameters") == trial.params:
                live = optuna.trial.Trial(self.record, trial._trial_id)
                self._tell(live, saved["scores"], _repeat(saved) | ({SCORE: saved} if self.shared else {}))
                continue
            retry(self.study, self.record, trial, died=not interrupted)
            self.record.tell(trial.number, state=TrialState.FAIL, skip_if_finished=self.shared)
        self._own.clear()
        self._rejected = _rejected_last(trials)
        start = self.study.start()
        if not trials and start is not None:
            self.record.enqueue_trial(start, user_attrs={"slot": 0})
        self._followers.clear()
        self._count()

    def _count(self) -> None:
        """Learn from the record which designs are done."""
        from optuna.trial import TrialState

        complete = self.record.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        pruned = self.record.get_trials(deepcopy=False, states=(TrialState.PRUNED,))
        self.infeasible = sum("rejected" in trial.user_attrs for trial in pruned)
        self.done = sum(REPEAT not in trial.user_attrs for trial in complete)
        known = set(self._known.values())
        for trial in complete:
            if trial.number not in known:
                self._known.setdefault(self.study.design(trial.params).digest, trial.number)

    def run(
        self,
        total: int,
        *,
        workers: int,
        submit: Submit,
        interrupts: Interrupts,
        progress: Progress,
    ) -> None:
        """Evaluate designs until there are `total`, by all runs that share the record together.

        Ends as well where one design after another is drawn that is known.
        """
        running: dict[Future[dict[str, Any]], Task] = {}
        with self._living() if self.shared else contextlib.nullcontext():
            while True:
                while self._has_room(running, workers) and self._started(running) < total:
                    interrupts.check()
                    task = self._propose()
                    if self._repeated >= _REPEATS:
                        total = self.done + self._others() + len(running)
                    if task is not None:
                        while running and task.alone:
                            self._collect(running, interrupts)
                        arguments = (self.evaluator, task.subject, self.study.fidelity, self.study.seed)
                        running[submit(evaluate_design, *arguments)] = task
                        self._followers[task.design.digest] = []
                    progress(f"search, {self.infeasible} infeasible", self.done, total)
                if not running and self.done >= total:
                    return
                if running:
                    self._collect(running, interrupts)
                else:
                    with interrupts.allowed():
                        time.sleep(POLL_S)  # should another run die, its designs are evaluated here
                progress(f"search, {self.infeasible} infeasible", self.done, total)

    def _collect(self, running: dict[Future[dict[str, Any]], Task], interrupts: Interrupts) -> None:
        """Wait for an evaluation to end, and record what has ended."""
        with interrupts.allowed():
            finished = wait(running, return_when=FIRST_COMPLETED).done
        for future in sorted(finished, key=lambda one: one.exception() is not None):
            self._finish(running[future], future.result())
            del running[future]

    def _has_room(self, running: Mapping[Any, Task], workers: int) -> bool:
        """Whether one more evaluation may start: none does beside a design that may kill its worker."""
        return len(running) < workers and not any(task.alone for task in running.values())

    def _started(self, running: Mapping[Any, Task]) -> int:
        return self._others() + self.done + len(running)

    def _others(self) -> int:
        """How many designs other runs of a shared record have under evaluation; what they did is counted."""
        from optuna.trial import TrialState

        if not self.shared:
            return 0
        self._count()
        running = self.record.get_trials(deepcopy=False, states=(TrialState.RUNNING,))
        others = [trial for trial in running if trial.number not in self._own]
        # Clocks of machines differ: by its own, this run tells how long the same sign has stood.
        alive, now, before = self.record.user_attrs, time.monotonic(), self._signs
        self._signs = {}
        for trial in others:
            run = trial.user_attrs.get(RUN)
            sign = run, alive.get(f"{ALIVE} {run}")
            known = before.get(trial.number, (None, now))
            self._signs[trial.number] = known if known[0] == sign else (sign, now)
        silent = [trial for trial in others if now - self._signs[trial.number][1] > SILENT_S]
        for trial in silent:
            self._take_over(trial)
        return len(others) - len(silent)

    def _take_over(self, trial: "optuna.trial.FrozenTrial") -> None:
        """Give up a trial whose run has died, and try its design again."""
        from optuna.exceptions import UpdateFinishedTrialError
        from optuna.trial import TrialState

        try:
            self.record.tell(trial.number, state=TrialState.FAIL)
        except (UpdateFinishedTrialError, ValueError):
            return  # another run was first, or it has ended after all
        retry(self.study, self.record, trial)

    @contextlib.contextmanager
    def _living(self) -> Iterator[None]:
        """Tell the other runs of a shared record that this one is alive."""
        from optuna.exceptions import StorageInternalError

        ended = threading.Event()

        def live() -> None:
            for count in itertools.count():
                with contextlib.suppress(StorageInternalError):  # which the search itself will meet
                    self.record.set_user_attr(f"{ALIVE} {self._luck[0]}", count)
                if ended.wait(HEARTBEAT_S):
                    return

        thread = threading.Thread(target=live, daemon=True)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def _propose(self) -> Task | None:
        """Draw one design; None if it is settled without an evaluation: infeasible, or known already."""
        from optuna.exceptions import UpdateFinishedTrialError

        try:
            trial = self._draw()
        except UpdateFinishedTrialError:
            if not self.shared:
                raise
            return None  # drawing took so long that another run took this one for dead
        subject, reason, broken = prepared(lambda: self.study.subject(self.study.design(trial.params)))
        if subject is None:
            self._reject(trial, reason, broken)
            return None
        design = subject if isinstance(subject, Design) else subject.design
        task = Task(trial, design, subject, alone=bool(trial.user_attrs.get("deaths", 0)))
        if design.digest in self._refused:
            why = self._refused[design.digest]
            self._reject(trial, why["infeasible"], why["broken"])
            return None
        if design.digest in self._known:
            self._reuse(task, self._known[design.digest])
            return None
        if design.digest in self._followers:
            self._followers[design.digest].append(task)
            self._repeated += 1
            return None
        self._repeated = 0
        return task

    def _draw(self) -> "optuna.Trial":
        """Draw the parameters of a trial and sign it."""
        slot, attempt = self._free_slot()
        entropy = np.random.SeedSequence([self.study.seed, slot, attempt, *self._luck])
        seed = int(entropy.generate_state(1)[0])
        # designs without a score count as what cannot be built
        name = method(self.study, rejected=self._rejected + self._failed)
        self.record.sampler = sampler(self.study, name, seed, infeasible=self.infeasible)
        trial = self.record.ask(self.distributions)
        if self.shared:
            self._own.add(trial.number)
            trial.set_user_attr(RUN, self._luck[0])
        if "slot" not in trial.user_attrs:
            trial.set_user_attr(METHOD, name)
            trial.set_user_attr("slot", slot)  # last: what has a slot is tried again as it is after a death
        return trial

    def _free_slot(self) -> tuple[int, int]:
        """Smallest slot that no trial holds, and how many designs drawn for it were abandoned."""
        from optuna.trial import TrialState

        taken: set[int] = set()
        attempts: dict[int, int] = {}
        for trial in self.record.get_trials(deepcopy=False):
            slot = trial.user_attrs.get("slot")
            if slot is None:
                continue
            failed = trial.state == TrialState.FAIL
            if not failed:
                taken.add(slot)
            attempts[slot] = attempts.get(slot, 0) + failed - ("retry_of" in trial.user_attrs)
        slot = next(slot for slot in range(len(taken) + 1) if slot not in taken)
        return slot, attempts.get(slot, 0)

    def _reject(self, trial: "optuna.Trial", reason: str, broken: Mapping[str, float]) -> None:
        """Record an infeasible design: pruned, with a constraint from which the sampler learns."""
        violation_mm = sum(broken.values()) if broken else REFUSED_MM
        note = {"rejected": {"reason": reason, "broken": dict(broken)}}
        self._settle(trial, None, note, {"violation_mm": violation_mm})
        self.infeasible += 1
        self._rejected += 1
        if self._rejected >= _GIVE_UP:
            raise RuntimeError(
                f"study {self.study.name!r}: no feasible design among the last {_GIVE_UP}; the last breaks "
                f"{reason}. Change the ranges or the base design"
            )

    def _finish(self, task: Task, outcome: dict[str, Any]) -> None:
        followers = self._followers.pop(task.design.digest, [])
        if "infeasible" in outcome:
            self._refused[task.design.digest] = outcome
            for each in (task, *followers):
                self._reject(each.trial, outcome["infeasible"], outcome["broken"])
            return
        self._rejected = 0
        reason = outcome.get("failed") or self._unusable(outcome["scores"])
        if reason:
            for each in (task, *followers):
                self._fail(each.trial, reason)
            return
        self._failed = 0
        done = next((one for one in (task, *followers) if self._complete(one, outcome)), None)
        if done is None:
            return
        self._known[task.design.digest] = done.trial.number
        for follower in followers[followers.index(done) + 1 if done in followers else 0 :]:
            self._reuse(follower, done.trial.number)

    def _fail(self, trial: "optuna.Trial", reason: str) -> None:
        """Record a design of which no score can be had; tpe learns to keep away from it."""
        self._settle(trial, None, {"failed": reason}, {"violation_mm": REFUSED_MM})
        self._failed += 1
        if self._failed >= _FAILURES:
            raise RuntimeError(
                f"study {self.study.name!r}: {_FAILURES} evaluations in a row failed, "
                f"the last one (trial {trial.number}) because: {reason}"
            )

    def _complete(self, task: Task, outcome: Mapping[str, Any]) -> bool:
        """Keep the score of a design; False if another run has taken the trial over meanwhile."""
        # The folder comes first: after a kill before the record knows of it, the trial is completed from it.
        content = {
            "trial": task.trial.number,
            "parameters": task.trial.params,
            "margins": task.design.margins(),
            **outcome,
        }
        if METHOD in task.trial.user_attrs:
            content[METHOD] = task.trial.user_attrs[METHOD]
        with atomic_folder(trial_folder(self.folder, task.trial.number), replace=True) as folder:
            write_atomic(folder / "design.toml", dumps(task.design))
            if not isinstance(task.subject, Design):
                write_atomic(folder / "model.toml", task.subject.dumps())
            write_json(folder / SCORE_FILE, content)
        notes = _repeat(outcome) | ({SCORE: content} if self.shared else {})
        if not self._tell(task.trial, outcome["scores"], notes):
            return False
        self.done += not _repeat(outcome)
        return True

    def _tell(
        self,
        trial: "optuna.Trial",
        scores: Mapping[str, Mapping[str, Any]],
        notes: Mapping[str, Any] | None = None,
    ) -> bool:
        """Give a trial its objectives, and by how much it breaks the constraints; see `_settle`."""
        broken = {
            name: bound.broken_by(float(scores[name]["value"]))
            for name, bound in self.study.constraints.items()
        }
        values = [float(scores[name]["value"]) for name in self.study.objectives]
        return self._settle(trial, values, notes or {}, broken)

    def _settle(
        self,
        trial: "optuna.Trial",
        values: list[float] | None,
        notes: Mapping[str, Any],
        constraints: Mapping[str, float],
    ) -> bool:
        """End a trial: complete with its objectives, or pruned without.

        Returns
        -------
        bool
            False if another run has taken the trial over, since this one was not heard of for long.
        """
        from optuna.exceptions import UpdateFinishedTrialError
        from optuna.trial import TrialState

        self._own.discard(trial.number)
        try:
            for name, note in notes.items():
                trial.set_user_attr(name, note)
            for name, violation in constraints.items():
                trial.set_constraint(name, violation)
            state = TrialState.PRUNED if values is None else None
            self.record.tell(trial, values, state=state)
        except (UpdateFinishedTrialError, ValueError):
            # A trial that has ended takes no notes (the former) and no end (the latter).
            if not self.shared:
                raise
            return False
        return True

    def _reuse(self, task: Task, number: int) -> None:
        """Complete a trial with the score of an equal design; it does not count as one evaluated."""
        self._rejected = 0
        self._repeated += 1
        (first,) = [t for t in self.record.get_trials(deepcopy=False) if t.number == number]
        saved = read_trial(self.folder, first)
        if saved is None:
            raise StudyError(f"{trial_folder(self.folder, number)}: the score of a complete trial is missing")
        score = {name: saved[name] for name in ("scores", "seconds", "warnings") if name in saved}
        self._complete(task, score | {REPEAT: number})

    def _unusable(self, scores: Mapping[str, Mapping[str, Any]]) -> str | None:
        """Why scores cannot serve the study, if so; an objective or bound that is no score is an error."""
        asked = (*self.study.objectives, *self.study.constraints)
        lacking = [name for name in asked if name not in scores]
        if lacking and all(name in CONTACT_SCORES for name in lacking):
            return f"{lacking[0]}: this design has no such score"  # kernels know no force
        self.study.require_scores(scores)
        for name in asked:
            if scores[name]["value"] is None:
                return f"{name} is not a finite number"
        return None


def _rejected_last(trials: Sequence["optuna.trial.FrozenTrial"]) -> int:
    """How many designs in a row, up to the last that was settled, could not be built."""
    settled = [trial for trial in trials if trial.state.name in ("COMPLETE", "PRUNED")]
    last = itertools.takewhile(lambda trial: "rejected" in trial.user_attrs, reversed(settled))
    return sum(1 for _ in last)


def _repeat(outcome: Mapping[str, Any]) -> dict[str, Any]:
    """Note of a trial whose score is that of an equal design."""
    return {REPEAT: outcome[REPEAT]} if REPEAT in outcome else {}


def retry(
    study: Study, record: "optuna.Study", trial: "optuna.trial.FrozenTrial", *, died: bool = True
) -> None:
    """Try the design of an abandoned trial again, unless it has been, or its evaluation died twice."""
    retried = {other.user_attrs.get("retry_of") for other in record.get_trials(deepcopy=False)}
    deaths = trial.user_attrs.get("deaths", 0) + int(died)
    complete = "slot" in trial.user_attrs and set(trial.params) == set(distributions(study))
    if complete and deaths < 2 and trial.number not in retried:
        kept = {name: trial.user_attrs[name] for name in ("slot", METHOD) if name in trial.user_attrs}
        attributes = {**kept, "retry_of": trial.number, "deaths": deaths}
        record.enqueue_trial(dict(trial.params), user_attrs=attributes)
