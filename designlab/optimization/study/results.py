"""Results of a study are a table of trials, its Pareto front, a shortlist and importances."""

import itertools
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from designlab.core.fields import unit_of
from designlab.optimization.study.definition import BASE, VARIANT, Study
from designlab.optimization.study.folder import METHOD, read_confirmations, read_trial, reading
from designlab.optimization.study.front import losses, pareto, valid
from designlab.optimization.study.shortlist import picks, trades
from designlab.sensor.design import Design

if TYPE_CHECKING:
    import optuna
    import pandas as pd

    from designlab.simulation.effects.model import SensorModel

STATES = ("complete", "infeasible", "failed", "interrupted", "running", "waiting")
"""What may become of a trial; the design of an interrupted one is tried again in another trial."""

CONFIRMING = ("fast", "standard", "reference")
"""Fidelities at which designs are evaluated again, in this order, from that of the search on."""

LEVEL = 0.95  # of the intervals of differences, all of them together


DEADLY = "the process that evaluated it died twice"

_FEWEST_FOR_IMPORTANCE = 10


@dataclass(frozen=True)
class Results:
    """A study, the table of its trials (see `load_results`), and the unit of each score.

    `warnings` say where a sensor model was used beyond what it was fitted to; `storage` is the URL of the
    database that holds the record, if it is not in the folder.
    """

    folder: Path
    study: Study
    frame: "pd.DataFrame"
    units: dict[str, str]
    warnings: tuple[str, ...] = ()
    storage: str | None = field(default=None, repr=False)

    @property
    def confirmed(self) -> "pd.DataFrame":
        """Scores of the designs that were evaluated again, see `confirmed`.

        A column ``violated`` has the constraints that these scores break.
        """
        import pandas as pd

        known = {BASE, *self.frame.loc[self.frame["state"] == "complete", "trial"]}
        found = confirmed(
            record
            for record in read_confirmations(self.folder)
            if record["trial"] in known and self.subject(record["trial"]).digest == record["design"]
        )
        broken = [
            [name for name, bound in self.study.constraints.items() if bound.broken_by(float(row[name])) > 0]
            for _, row in found.iterrows()
        ]
        return found.assign(violated=pd.Series([b or None for b in broken], found.index, dtype=object))

    @property
    def evaluated(self) -> int:
        """Number of different designs that were evaluated."""
        return int(((self.frame["state"] == "complete") & self.frame["reuse_of"].isna()).sum())

    @property
    def reached(self) -> str | None:
        """Highest fidelity at which designs were evaluated again."""
        done = set(self.confirmed["fidelity"])
        return next((fidelity for fidelity in reversed(CONFIRMING) if fidelity in done), None)

    @property
    def nearest(self) -> "pd.Series[Any] | None":
        """Where every evaluated design breaks a constraint, the one that breaks fewest, if there is any."""
        done = self.frame[self.frame["state"] == "complete"]
        if done.empty or not self.valid.empty:
            return None
        return done.iloc[int(done["violated"].map(len).to_numpy().argmin())]

    @property
    def start(self) -> "pd.Series[Any] | None":
        """The trial of the base design, if it was evaluated."""
        values = self.study.start()
        rows = self.frame[self.frame["state"] == "complete"]
        for path, value in (values or {}).items():
            rows = rows[rows[path] == value]
        return None if values is None or rows.empty else rows.iloc[0]

    @property
    def valid(self) -> "pd.DataFrame":
        """The evaluated designs that keep the constraints."""
        return valid(self.frame)

    @property
    def pareto(self) -> "pd.DataFrame":
        """The evaluated designs that no other beats in every objective."""
        return pareto(self.frame, self.study.objectives)

    @property
    def picks(self) -> "pd.DataFrame":
        """A shortlist of the Pareto front, see `picks`."""
        return picks(self.frame, self.study.objectives, parameters=self.study.varied)

    def trades_in_words(self, called: Callable[[str], str] = str) -> dict[int, str]:
        """What each design of the shortlist trades: against the base, or else the first.

        Objectives and parameters are called as asked.
        """
        chosen = self.picks
        if chosen.empty:
            return {}
        reference = chosen.iloc[0] if self.start is None else self.start
        study = self.study
        units = {**self.units, **{path: unit_of(path) for path in study.varied}}
        return trades(chosen, reference, self.frame, study.objectives, study.varied, units, called)

    def design(self, trial: int) -> Design:
        """Return the design of a trial by its number."""
        rows = self.frame[self.frame["trial"] == trial]
        if rows.empty:
            raise ValueError(f"trial: the study has no trial {trial}")
        variant = _native(rows.iloc[0][VARIANT]) if self.study.variants else None
        values = {path: _native(rows.iloc[0][path]) for path in self.study.active(variant)}
        name = f"{self.study.base.name}, trial {trial} of {self.study.name}"
        return self.study.design({VARIANT: variant, **values}).replace({"name": name})

    def subject(self, trial: int) -> "Design | SensorModel":
        """Return what is evaluated in a trial, or in `BASE`: its design with the effects of the study."""
        return self.study.subject(self.study.base if trial == BASE else self.design(trial))

    def curse(self) -> dict[str, dict[str, float]]:
        """How much of the search's gains over the base design is gone with fresh seeds.

        At the fidelity of the search itself that is chance, the winner's curse; at a higher one what the
        search's pictures lack comes on top.

        Returns
        -------
        dict
            For each fidelity of confirmation, objective to the share of the gain over the base that is gone,
            in the median of the designs confirmed; those without a gain are left out.
        """
        again, start, objectives = self.confirmed, self.start, self.study.objectives
        screened = self.frame[self.frame["state"] == "complete"].set_index("trial")
        found: dict[str, dict[str, float]] = {}
        for fidelity in CONFIRMING:
            rows = again[again["fidelity"] == fidelity]
            base, own = rows[rows["trial"] == BASE], rows[rows["trial"] != BASE]
            if start is None or base.empty or own.empty:
                continue
            first = losses(screened.loc[own["trial"]], objectives) - losses(start.to_frame().T, objectives)
            last = losses(own, objectives) - losses(base, objectives)
            shares = 1.0 - last / np.where(first < 0, first, np.nan)
            found[fidelity] = {
                name: float(np.nanmedian(column))
                for name, column in zip(objectives, shares.T, strict=True)
                if np.isfinite(column).any()
            }
        return found

    def curse_in_words(self, called: Callable[[str], str] = str) -> list[str]:
        """Sentences about `curse`, an objective being called as asked."""
        sentences = []
        for fidelity, shares in self.curse().items():
            by_chance = fidelity == self.study.fidelity
            why = "by chance (winner's curse)" if by_chance else f"at {fidelity} fidelity"
            said = ", ".join(f"{called(name)} {_gone(share)}" for name, share in shares.items())
            sentences.append(f"Of the search's gains over the base, in the median, gone {why}: {said}.")
        return sentences

    def gains(self) -> "pd.DataFrame":
        """How the confirmed designs differ from the base, at the highest fidelity reached.

        The errors of a design and the base count as independent. They share their presses, so differences are
        surer than stated. Intervals hold all together in 95 of 100 studies (Bonferroni).

        Returns
        -------
        DataFrame
            One row a design and objective: ``trial``, ``fidelity``, ``objective``, ``base``, ``base_se``,
            ``value``, ``value_se``; ``difference`` from the base with ends ``low`` and ``high`` of its
            interval; ``seen``, whether that holds no zero; ``better``, whether it is to the better then;
            ``violated``, constraints that the design breaks.
        """
        import pandas as pd
        from scipy.stats import norm  # with much else, which takes a second

        columns = ["trial", "fidelity", "objective", "base", "base_se", "value", "value_se"]
        columns += ["difference", "low", "high", "seen", "better", "violated"]
        again, reached = self.confirmed, self.reached
        rows = again[again["fidelity"] == reached]
        base, own = rows[rows["trial"] == BASE], rows[rows["trial"] != BASE]
        found = []
        compared = list(
            itertools.product(own.iterrows(), () if base.empty else self.study.objectives.items())
        )
        for (_, row), (name, way) in compared:
            here, there = (float(one[name]) for one in (base.iloc[0], row))
            errors = float(base.iloc[0][f"{name}_se"]), float(row[f"{name}_se"])
            room = float(norm.isf((1 - LEVEL) / 2 / len(compared)) * math.hypot(*errors))
            change = there - here
            seen = abs(change) > room
            better = seen and (change > 0) == (way == "maximise")
            values = (row["trial"], reached, name, here, errors[0], there, errors[1], change)
            ends = change - room, change + room
            found.append(dict(zip(columns, (*values, *ends, seen, better, row["violated"]), strict=True)))
        return pd.DataFrame(found, columns=columns)

    def counts(self) -> dict[str, int]:
        """Number of trials in each of `STATES`."""
        return {state: int((self.frame["state"] == state).sum()) for state in STATES}

    def rejections(self) -> dict[str, int]:
        """How many infeasible designs each rule rejected, most frequent first; a design may break several."""
        infeasible = self.frame[self.frame["state"] == "infeasible"]
        reasons = zip(infeasible["reason"], infeasible["broken"], strict=True)
        return dict(Counter(rule for reason, rules in reasons for rule in rules or [reason]).most_common())

    def failures(self) -> dict[str, int]:
        """Why no score could be had of feasible designs, and of how many, most frequent first."""
        reasons = self.frame.loc[self.frame["state"] == "failed", "reason"].value_counts()
        return {str(reason): int(count) for reason, count in reasons.items()}

    def to_json(self) -> dict[str, Any]:
        """Plain data: counts, rejections, Pareto front and shortlist with parameters and scores."""
        columns = ["trial", *self.study.varied, *_score_columns(self.frame, self.study)]
        return {
            "study": self.study.name,
            "folder": str(self.folder),
            "press_plan": self.study.presses.to_json(),
            "objectives": dict(self.study.objectives),
            "units": dict(self.units),
            "warnings": list(self.warnings),
            "trials": self.counts(),
            "evaluated": self.evaluated,
            "rejections": self.rejections(),
            "failures": self.failures(),
            "pareto": _rows(self.pareto, columns),
            "picks": _rows(self.picks, [*columns, "pick"]),
            "trades": {str(number): words for number, words in self.trades_in_words().items()},
            "robust": None if self.study.robust is None else self.study.robust.model_dump(mode="json"),
            "confirmed": _rows(
                self.confirmed,
                ["trial", "fidelity", "seeds", "violated", *_score_columns(self.frame, self.study)],
            ),
            "winners_curse": self.curse(),
        }


def _gone(share: float) -> str:
    """Share of a gain that is gone, in words: fresh seeds may also show more of it."""
    return f"{share:.0%}" if round(share, 2) >= 0 else f"none ({-share:.0%} more)"


def load_results(out: str | Path, *, storage: str | None = None) -> Results:
    """Read the results of a study, also while it is running.

    Parameters
    ----------
    out : str or Path
        Folder of the study.
    storage : str, optional
        URL of the database that holds its record, if that is not in the folder.

    Returns
    -------
    Results
        Its ``frame`` has one row a trial: ``trial``, ``state`` (one of `STATES`), a column for each
        parameter (dotted path), for each score its value, ``<score>_se`` and ``<score>_bias_bound``;
        ``method``, the sampler that drew it; ``violation_mm``, ``reason`` and ``broken`` (names of the rules)
        of infeasible designs; ``violated``,
        constraints that the scores of a complete trial break; ``reuse_of``, the trial that evaluated an
        equal design before. Where there are variants, ``variant`` names the trial's, and parameters of others
        are missing.

    Raises
    ------
    StudyError
        If the folder holds no study.
    """
    import pandas as pd

    folder = Path(out)
    with reading(folder, storage) as (study, record):
        units: dict[str, str] = {}
        warnings: dict[str, None] = {}
        trials = record.get_trials(deepcopy=False)
        retried = {trial.user_attrs.get("retry_of") for trial in trials}
        rows = [_row(study, folder, trial, trial.number in retried, units, warnings) for trial in trials]
    columns = ["trial", "state", *study.varied]
    frame = pd.DataFrame(rows, columns=columns if not rows else None)
    for name in (*columns, "method", "violation_mm", "reason", "broken", "violated", "reuse_of"):
        if name not in frame:
            frame[name] = None
    frame = frame.astype({"reuse_of": "Int64", "violation_mm": float})
    # A table whose trials are all of one kind must not differ in its columns' kinds from any other.
    for name in ("method", "violated"):
        frame[name] = frame[name].astype(object).where(frame[name].notna(), None)
    # Columns set one by one lie apart, and pandas warns of a hundred such.
    return Results(folder, study, frame.copy(), units, tuple(warnings), storage)


def levels(study: Study) -> tuple[str, ...]:
    """Fidelities at which the best designs of a study are evaluated again, in this order."""
    first, last = (CONFIRMING.index(fidelity) for fidelity in (study.fidelity, study.plan.highest))
    return CONFIRMING[first : last + 1] or (study.fidelity,)


def confirmed(records: Iterable[Mapping[str, Any]]) -> "pd.DataFrame":
    """Scores of designs that were evaluated again after a search, means over seeds.

    Parameters
    ----------
    records : iterable of mapping
        What is kept of each evaluation.

    Returns
    -------
    DataFrame
        One row a design and fidelity: ``trial`` (`BASE` for the base design), ``fidelity``, ``seeds`` (how
        many), and for each score its mean, ``<score>_se`` and ``<score>_bias_bound``. Those that failed are
        missing.
    """
    import pandas as pd

    found: dict[tuple[int, str], list[Mapping[str, Any]]] = {}
    for record in records:
        if "scores" in record:
            found.setdefault((record["trial"], record["fidelity"]), []).append(record["scores"])
    rows = []
    for (trial, fidelity), scores in found.items():
        row: dict[str, Any] = {"trial": trial, "fidelity": fidelity, "seeds": len(scores)}
        for name in [name for name in scores[0] if all(name in each for each in scores)]:
            values, errors, bounds = (
                np.array([_number(s[name][key]) for s in scores]) for key in ("value", "se", "bias_bound")
            )
            row[name], row[f"{name}_bias_bound"] = float(values.mean()), float(bounds.max())
            row[f"{name}_se"] = float(np.sqrt((errors**2).sum()) / len(scores))
        rows.append(row)
    return pd.DataFrame(rows, columns=["trial", "fidelity", "seeds"] if not rows else None)


def _row(
    study: Study,
    folder: Path,
    trial: "optuna.trial.FrozenTrial",
    retried: bool,
    units: dict[str, str],
    warnings: dict[str, None],
) -> dict[str, Any]:
    deadly = trial.user_attrs.get("deaths", 0) > 0 and trial.state.name == "FAIL" and not retried
    state = "failed" if deadly else _state(trial)
    used = (VARIANT, *study.active(trial.params.get(VARIANT)))
    values = {name: value for name, value in trial.params.items() if name in used}
    row: dict[str, Any] = {"trial": trial.number, "state": state, **values}
    row["method"] = trial.user_attrs.get(METHOD)
    if state == "complete":
        row |= dict(zip(study.objectives, trial.values, strict=True))
        saved = read_trial(folder, trial) or {}
        warnings |= dict.fromkeys(saved.get("warnings", ()))
        for name, estimate in saved.get("scores", {}).items():
            units[name] = estimate["unit"]
            row[name] = _number(estimate["value"])
            row[f"{name}_se"] = _number(estimate["se"])
            row[f"{name}_bias_bound"] = _number(estimate["bias_bound"])
        row["reuse_of"] = saved.get("reuse_of")
        broken = [name for name in study.constraints if trial.constraints.get(name, 0.0) > 0.0]
        row["violated"] = broken or None
    rejected = trial.user_attrs.get("rejected", {})
    row["violation_mm"] = trial.constraints.get("violation_mm")
    row["reason"] = DEADLY if deadly else rejected.get("reason", trial.user_attrs.get("failed"))
    row["broken"] = list(rejected.get("broken", {})) or None
    return row


def _state(trial: "optuna.trial.FrozenTrial") -> str:
    if trial.state.name == "PRUNED":
        return "failed" if "failed" in trial.user_attrs else "infeasible"
    return {"COMPLETE": "complete", "FAIL": "interrupted"}.get(trial.state.name, trial.state.name.lower())


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _native(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def _score_columns(frame: "pd.DataFrame", study: Study) -> list[str]:
    names = [column.removesuffix("_se") for column in frame.columns if column.endswith("_se")]
    ordered = dict.fromkeys([*(name for name in study.objectives if name in names), *names])
    return [column for name in ordered for column in (name, f"{name}_se")]


def _rows(frame: "pd.DataFrame", columns: list[str]) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for _, row in frame.iterrows():
        values = {column: _native(row[column]) for column in columns if column in frame}
        rows.append({name: None if value != value else value for name, value in values.items()})
    return rows


def importance(out: str | Path, *, storage: str | None = None) -> dict[str, dict[str, float]] | None:
    """Share of each objective's variation that each parameter explains (functional ANOVA of a random forest).

    Returns
    -------
    dict or None
        Objective to parameter to share; None while fewer than ten designs are evaluated.
    """
    from optuna.importance import FanovaImportanceEvaluator, get_param_importances
    from optuna.trial import TrialState

    with reading(Path(out), storage) as (study, record):
        done = record.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        if len(done) < _FEWEST_FOR_IMPORTANCE:
            return None
        shares: dict[str, dict[str, float]] = {}
        for index, name in enumerate(study.objectives):
            if np.ptp([trial.values[index] for trial in done]) == 0:
                continue

            def target(trial: "optuna.trial.FrozenTrial", index: int = index) -> float:
                return float(trial.values[index])

            evaluator = FanovaImportanceEvaluator(seed=study.seed)
            found = get_param_importances(record, evaluator=evaluator, target=target)
            shares[name] = {path: float(share) for path, share in found.items()}
    return shares
