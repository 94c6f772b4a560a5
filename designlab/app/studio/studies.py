"""What the study view shows: the front of a study while it runs or when it is done."""

from typing import Any, NamedTuple

from designlab.app.studio.messages import StudyJob


class StudyState(NamedTuple):
    """State of a study.

    Attributes
    ----------
    name, words : str
        The study, and how far it is.
    figure : mapping or None
        Figure of the front, as Plotly's plain data; None before the first design was evaluated.
    rows : list of mapping
        The shortlist.
    finished : bool
        Whether all designs were evaluated.
    """

    name: str
    words: str
    figure: dict[str, Any] | None
    rows: list[dict[str, str]]
    finished: bool


def state(job: StudyJob) -> StudyState:
    """Read the state of a study, also while it runs."""
    from designlab.optimization.study import load_results
    from designlab.report import study_plots
    from designlab.report.yardsticks import score_label

    results = load_results(job.folder)
    study, counts = results.study, results.counts()
    words = (
        f"{results.evaluated} of {study.trials} designs evaluated, {counts['infeasible']} cannot be built, "
        f"{counts['failed']} failed, {counts['running']} running"
    )
    objectives = list(study.objectives)
    figure = None
    if results.evaluated and len(objectives) > 1:
        figure = study_plots.pareto(results, *objectives[:2])
    elif results.evaluated:
        figure = study_plots.progress(results)[0]
    rows = []
    for _, row in results.picks.iterrows():
        told = {"trial": str(row["trial"]), "why": str(row["pick"])}
        told |= {path: _shown(row[path]) for path in study.varied}
        told |= {score_label(name, results.units.get(name, "")): _shown(row[name]) for name in objectives}
        rows.append(told)
    plain = None if figure is None else dict(figure.to_plotly_json())
    return StudyState(study.name, words, plain, rows, results.evaluated >= study.trials)


def _shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
