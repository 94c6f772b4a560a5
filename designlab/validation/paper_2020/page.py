"""The HTML page about a reproduction: one file that needs no other."""

from collections.abc import Sequence
from typing import Any

from designlab.report.page import Html, Section, page, paragraph, picture, table
from designlab.validation.paper_2020.content import Chapter, Illustration, Table, Text

TITLE = "The 2020 experiments, reproduced"


def html_page(result: dict[str, Any], content: Sequence[Chapter]) -> str:
    """Write the content as HTML.

    Parameters
    ----------
    result : dict
        ``size`` and ``seed`` go below the title.
    content : sequence of Chapter
        What `sections` returned.
    """
    parts = [Section(part.title, tuple(_block(block) for block in part.blocks)) for part in content]
    return page(TITLE, parts, subtitle=f"arXiv 2012.13184, {result['size']} size, seed {result['seed']}")


def _block(block: Text | Table | Illustration) -> Html:
    if isinstance(block, Text):
        return paragraph(block.text, note=block.note)
    if isinstance(block, Table):
        return table(block.rows, block.columns, caption=block.caption)
    return picture(block.path, block.caption)
