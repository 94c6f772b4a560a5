"""Commands about studies: run, status, report."""

import os
import shlex
import sys
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from designlab.app.cli.arguments.studies import STORAGE_VARIABLE
from designlab.app.cli.console import Result
from designlab.app.cli.shared import table
from designlab.core.progress import bar

if TYPE_CHECKING:
    import pandas as pd

    from designlab.optimization.study import Results


def run(args: Namespace) -> Result:
    """Run or resume a study."""
    from designlab.evaluation.illumination_scores import SCORES
    from designlab.optimization.study import (
        StudyError,
        StudyInterrupted,
        load_results,
        load_study,
        run_study,
    )
    from designlab.optimization.study.effort import Effort, budget_s, within
    from designlab.optimization.study.folder import RECORD_FILE

    given = Path(args.study)
    folder = _folder(given, args.out)
    file = given / "study.toml" if given.is_dir() else given
    study = load_study(file)
    if args.depth_mm is not None or args.force_n is not None:
        study = study.pressed(depth_mm=args.depth_mm, force_n=args.force_n)
    try:
        study.require_scores(SCORES)
    except StudyError as error:
        raise StudyError(f"{file}: {error}") from None
    wanted = study.trials if args.trials is None else args.trials
    study = study.model_copy(update={"trials": wanted})
    if args.no_confirm:
        study = study.model_copy(update={"plan": study.plan.model_copy(update={"promoted": 0})})
    if args.budget:
        study, wanted = within(study, budget_s(args.budget))
    kept = (folder / RECORD_FILE).is_file() and not args.storage and not args.rebuild
    done = load_results(folder).evaluated if kept else 0
    print(Effort.of(study, trials=wanted, done=done).text(), file=sys.stderr)
    try:
        results = run_study(
            study,
            out=folder,
            workers=args.workers,
            trials=wanted,
            storage=args.storage,
            rebuild=args.rebuild,
        )
    except StudyInterrupted as interrupt:
        text = str(interrupt).partition(";")[0]
        raise StudyInterrupted(f"{text}; to resume: {_again(args)}") from None
    return Result(results.to_json(), summary(results, wanted))


def _again(args: Namespace) -> str:
    """Return the command that goes on."""
    words = ["designlab", "study", "run", args.study]
    words += ["--out", args.out] if args.out else []
    words += ["--workers", str(args.workers)] if args.workers > 1 else []
    words += ["--depth-mm", str(args.depth_mm)] if args.depth_mm else []
    words += ["--force-n", str(args.force_n)] if args.force_n else []
    words += ["--trials", str(args.trials)] if args.trials else []
    words += ["--budget", args.budget] if args.budget else []
    words += ["--no-confirm"] if args.no_confirm else []
    if args.storage and args.storage != os.environ.get(STORAGE_VARIABLE):
        words += ["--storage", "URL"]  # it may hold a password
    return shlex.join(words)


def status(args: Namespace) -> Result:
    """Say how far a study is."""
    from designlab.optimization.study import load_results

    results = load_results(_folder(Path(args.study), args.out), storage=args.storage)
    data = {**results.to_json(), "wanted": results.study.trials}
    return Result(data, summary(results, results.study.trials))


def report(args: Namespace) -> Result:
    """Write the page about a study."""
    from designlab.optimization.study import load_results
    from designlab.report.study import study_report

    folder = _folder(Path(args.study), args.results)
    with bar() as progress:
        progress("record of the study", 0, 1)
        results = load_results(folder, storage=args.storage)
        page = Path(args.output) if args.output else folder / "report.html"
        study_report(results, page, progress=progress)
    return Result({"report": str(page), **results.to_json()}, f"report: {page}")


def _folder(given: Path, out: str | None) -> Path:
    """Folder of the results of a study file, or the folder itself."""
    if out is not None:
        return Path(out)
    return given if given.is_dir() else given.with_name(f"{given.stem}-out")


def summary(results: "Results", wanted: int) -> str:
    """Tell in lines what a study has found, of the number of designs that it is to evaluate."""
    counts = results.counts()
    lines = [
        f"{results.study.name}: {results.evaluated} of {wanted} designs evaluated, "
        f"{counts['infeasible']} infeasible, {counts['failed']} failed, {counts['running']} running"
    ]
    for words, reasons in (("rejected by", results.rejections()), ("failed since", results.failures())):
        if reasons:
            lines.append(f"{words}: " + ", ".join(f"{reason} ({n})" for reason, n in reasons.items()))
    study = results.study
    lines.append(f"presses of every design: {study.presses.text()}")
    lines += _broken(results)
    titles = [*study.varied, *(study.called(name) for name in study.objectives)]
    rows = [
        (
            f"{row['trial']}",
            row["pick"],
            *(_cell(row[path]) for path in study.varied),
            *(_score(row, name) for name in study.objectives),
        )
        for _, row in results.picks.iterrows()
    ]
    if rows:
        lines += ["shortlist, with standard errors:", table(("trial", "why", *titles), rows)]
    if trades := results.trades_in_words():
        other = "the first" if results.start is None else "the base design"
        lines.append(f"what each trades against {other}:")
        lines += [f"  trial {number}: {words}" for number, words in trades.items()]
    lines += _confirmed(results)
    lines += [f"warning: {warning}" for warning in results.warnings]
    lines.append(f"results: {results.folder}")
    return "\n".join(lines)


def _broken(results: "Results") -> list[str]:
    """Lines about the designs that break a constraint, and how near the nearest comes where all do."""
    broken = results.frame["violated"].dropna()
    counts = {name: sum(name in names for names in broken) for name in results.study.constraints}
    if not any(counts.values()):
        return []
    lines = ["break a constraint: " + ", ".join(f"{name} ({n})" for name, n in counts.items() if n)]
    nearest = results.nearest
    if nearest is not None:
        bounds = results.study.constraints
        kept = ", ".join(
            f"{name} {_score(nearest, name)}, must be {bounds[name].text()}" for name in nearest["violated"]
        )
        lines.append(f"no design keeps them all; trial {nearest['trial']} breaks fewest: {kept}")
    return lines


def _confirmed(results: "Results") -> list[str]:
    """Lines about the designs that were evaluated again: at the highest fidelity that was reached."""
    from designlab.optimization.study.definition import BASE

    again, objectives = results.confirmed, list(results.study.objectives)
    fidelity = results.reached
    if fidelity is None:
        return []
    better = {(g["trial"], g["objective"]): f", {_difference(g)}" for _, g in results.gains().iterrows()}
    rows = [
        (
            "base" if row["trial"] == BASE else f"{row['trial']}",
            *(_score(row, name) + better.get((row["trial"], name), "") for name in objectives),
            ", ".join(row["violated"] or ()) or "-",
        )
        for _, row in again[again["fidelity"] == fidelity].iterrows()
    ]
    lines = [
        f"confirmed at {fidelity} fidelity with fresh seeds:",
        table(("trial", *(results.study.called(name) for name in objectives), "breaks"), rows),
    ]
    return lines + results.curse_in_words()


def _difference(gain: "pd.Series[Any]") -> str:
    """How a confirmed design differs from the base, if chance would not make as much."""
    if not gain["seen"]:
        return "no difference seen"
    return f"{'better' if gain['better'] else 'worse'} by {abs(gain['difference']):.2g}"


def _score(row: "pd.Series[Any]", name: str) -> str:
    error = row.get(f"{name}_se")
    return f"{row[name]:.4g}" + ("" if error is None or error != error else f" ± {error:.2g}")


def _cell(value: Any) -> str:
    if value is None or value != value:  # a parameter of another variant
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
