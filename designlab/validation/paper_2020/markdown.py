"""The same page as Markdown, without its pictures."""

from collections.abc import Sequence
from typing import Any

from designlab.report.page import Column, rounded
from designlab.validation.paper_2020.content import Chapter, Table, Text
from designlab.validation.paper_2020.page import TITLE


def markdown_page(result: dict[str, Any], content: Sequence[Chapter]) -> str:
    """Write the content as Markdown.

    Parameters
    ----------
    result : dict
        ``designlab``, ``size`` and ``seed`` go below the title.
    content : sequence of Chapter
        What `sections` returned; pictures are left out, since they lie elsewhere.
    """
    made = f"designlab {result['designlab']}, {result['size']} size, seed {result['seed']}"
    blocks = [f"# {TITLE}", f"arXiv 2012.13184; written by `designlab reproduce`, {made}."]
    for part in content:
        written = [_block(block) for block in part.blocks if isinstance(block, Text | Table)]
        if written:
            blocks += [f"## {part.title}", *written]
    return "\n\n".join(blocks) + "\n"


def _block(block: Text | Table) -> str:
    return block.text if isinstance(block, Text) else _table(block)


def _table(table: Table) -> str:
    numeric = {
        column.key: any(isinstance(row.get(column.key), int | float) for row in table.rows)
        for column in table.columns
    }
    head = _line([_heading(column) for column in table.columns])
    rule = _line(["---:" if numeric[column.key] else "---" for column in table.columns])
    rows = [_line([_cell(row.get(column.key)) for column in table.columns]) for row in table.rows]
    caption = [table.caption, ""] if table.caption else []
    return "\n".join([*caption, head, rule, *rows])


def _heading(column: Column) -> str:
    return f"{column.title} ({column.unit})" if column.unit not in ("", "1") else column.title


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _cell(value: Any) -> str:
    if value is None or value != value:
        return "–"
    if isinstance(value, int | float):
        return rounded(float(value))
    return " ".join(str(value).replace("|", "\\|").split())
