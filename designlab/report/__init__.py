"""Self-contained HTML pages: one file each, no network."""

from designlab.report.evaluation import evaluation_report
from designlab.report.gap import gap_report
from designlab.report.page import (
    Column,
    Html,
    Section,
    facts,
    gallery,
    label,
    page,
    paragraph,
    picture,
    plotly_figure,
    table,
)
from designlab.report.pool import pool_report
from designlab.report.study import study_report

__all__ = [
    "Column",
    "Html",
    "Section",
    "evaluation_report",
    "facts",
    "gallery",
    "gap_report",
    "label",
    "page",
    "paragraph",
    "picture",
    "plotly_figure",
    "pool_report",
    "study_report",
    "table",
]
