"""The results of a diagnosis in its folder: the updated model, pictures, a page, and a report of it all."""

from pathlib import Path
from typing import Any

from designlab.core.store import write_json
from designlab.inference.diagnosis.result import GapReport, PictureComparison, PressComparison
from designlab.report import gap_pictures, single_image_picture
from designlab.report.figures import write_figure
from designlab.report.gap import gap_report
from designlab.report.gap_text import limits, statement

REPORT = "report.json"


def write_diagnosis(report: GapReport, *, pictures: bool = True, page: Path | None = None) -> dict[str, Any]:
    """Write what a diagnosis has found into the folder of its model.

    ``report.json`` comes last: where that is, all others are, and of the same run.

    Parameters
    ----------
    report : GapReport
        What `designlab.inference.diagnosis.diagnose` found.
    pictures : bool
        Whether to draw what is left.
    page : Path, optional
        HTML page to write about it.

    Returns
    -------
    dict
        Content of ``report.json``, see ``docs/gap.md``.
    """
    folder = report.model.parent
    (folder / REPORT).unlink(missing_ok=True)
    drawn = _drawn(report.shown, folder) if pictures and report.shown is not None else {}
    content = report_content(report, drawn)
    report.updated.save(report.model)
    if page is not None:
        gap_report(content, page)
    write_json(folder / REPORT, content)
    return content


def report_content(report: GapReport, pictures: dict[str, str]) -> dict[str, Any]:
    """Data of a diagnosis, each with what is said of it in words, and captions of the pictures."""
    words: dict[str, dict[str, Any]] = {
        "verdict": {"statement": list(statement(report))},
        "next": {"limits": list(limits(report))},
        "provenance": {"pictures": pictures},
    }
    content: dict[str, Any] = {}
    for name, value in report.to_json().items():
        content |= {name: value, **words.get(name, {})}
    return content


def _drawn(shown: PressComparison | PictureComparison, folder: Path) -> dict[str, str]:
    """Files of the pictures and their captions."""
    if isinstance(shown, PictureComparison):
        path = write_figure(single_image_picture.models_plot(shown), folder / "picture.png")
        return {str(path): single_image_picture.CAPTION}
    found = {}
    for name, figure, caption in gap_pictures.plots(shown):
        found[str(write_figure(figure, folder / name, trimmed=True))] = caption
    return found
