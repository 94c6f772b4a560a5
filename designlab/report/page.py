"""Building blocks of a page: one HTML file that needs no network, with tables, pictures and figures."""

import base64
import html
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from designlab.core import __version__

if TYPE_CHECKING:
    import plotly.graph_objects


def _text(name: str) -> str:
    """Text of a file beside this module."""
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
COLOURS = ("#1f5fa8", "#d1541e", "#2f855a", "#7b4ea3", "#b7791f", "#4a5568")
"""Colours of figures, in order: blue, orange, green, purple, ochre, grey."""

_STYLE = "\n" + _text("page.css").replace("FONT", FONT)


class Html(str):
    """Text that is HTML already; every other text is escaped."""

    __slots__ = ()


class Section(NamedTuple):
    """A heading and the blocks below it: results of the functions of this module."""

    title: str
    blocks: tuple[Html, ...]


class Column(NamedTuple):
    """A column of a table: key in the rows, heading, unit, and key of the standard error if there is one."""

    key: str
    title: str
    unit: str = ""
    se: str = ""


def page(title: str, sections: Iterable[Section], *, subtitle: str = "") -> Html:
    """Assemble a page.

    Parameters
    ----------
    title, subtitle : str
        Heading and the line below it.
    sections : iterable of Section
        The content; sections without blocks are left out.

    Returns
    -------
    Html
        A complete document: style, pictures and scripts are inside it.
    """
    body = "".join(
        f"<section><h2>{html.escape(section.title)}</h2>{''.join(section.blocks)}</section>"
        for section in sections
        if section.blocks
    )
    script = f"<script>{_plotly_script()}</script>" if 'class="plotly' in body else ""
    below = f'<p class="subtitle">{html.escape(subtitle)}</p>' if subtitle else ""
    return Html(
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{html.escape(title)}</title>'
        f"<style>{_STYLE}</style>{script}</head><body><main><h1>{html.escape(title)}</h1>{below}"
        f"{body}<footer>designlab {__version__}</footer></main></body></html>\n"
    )


def paragraph(text: str, *, note: bool = False) -> Html:
    """One paragraph; text between backquotes is set as code."""
    parts = html.escape(text).split("`")
    marked = "".join(f"<code>{part}</code>" if index % 2 else part for index, part in enumerate(parts))
    return Html(f'<p class="note">{marked}</p>' if note else f"<p>{marked}</p>")


def facts(values: Mapping[str, Any]) -> Html:
    """Names and values, one pair a line; empty values are left out."""
    pairs = "".join(
        f"<dt>{html.escape(name)}</dt><dd>{_escaped(value)}</dd>"
        for name, value in values.items()
        if value != ""
    )
    return Html(f"<dl>{pairs}</dl>")


def table(rows: Sequence[Mapping[str, Any]], columns: Sequence[Column | str], *, caption: str = "") -> Html:
    """Rows as a table; numbers are right-aligned and rounded, with their standard error where there is one.

    Parameters
    ----------
    rows : sequence of mappings
        One mapping a row; absent values and NaN show as a dash.
    columns : sequence of Column or str
        What to show, in order; a bare key serves as its own heading.
    """
    chosen = [column if isinstance(column, Column) else Column(column, column) for column in columns]
    numeric = {c.key: any(_is_number(row.get(c.key)) for row in rows) for c in chosen}
    head = "".join(
        f"<th{_number_class(numeric[c.key])}>{html.escape(c.title)}"
        + (f'<span class="unit">{html.escape(c.unit)}</span>' if c.unit not in ("", "1") else "")
        + "</th>"
        for c in chosen
    )
    body = "".join(
        "<tr>"
        + "".join(
            f"<td{_number_class(numeric[c.key])}>{_cell(row.get(c.key), row.get(c.se))}</td>" for c in chosen
        )
        + "</tr>"
        for row in rows
    )
    above = f"<caption>{html.escape(caption)}</caption>" if caption else ""
    return Html(
        f'<div class="scroll"><table>{above}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def picture(source: str | Path | bytes, caption: str, *, alt: str = "") -> Html:
    """A picture, kept inside the page.

    Parameters
    ----------
    source : path or bytes
        A PNG, JPEG or SVG file, or the bytes of a PNG.
    caption : str
        Line below it, which also serves those who do not see the picture unless `alt` is given.

    Raises
    ------
    ValueError
        If the file is of another kind.
    """
    kinds = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".svg": "svg+xml"}
    if isinstance(source, bytes):
        kind, data = "png", source
    else:
        path = Path(source)
        if path.suffix.lower() not in kinds:
            raise ValueError(f"{path}: a page takes pictures as {', '.join(kinds)}")
        kind, data = kinds[path.suffix.lower()], path.read_bytes()
    encoded = base64.b64encode(data).decode()
    return Html(
        f'<figure><img alt="{html.escape(alt or caption, quote=True)}" '
        f'src="data:image/{kind};base64,{encoded}">{_caption(caption)}</figure>'
    )


def gallery(pictures: Iterable[Html]) -> Html:
    """Pictures side by side."""
    inside = "".join(pictures)
    return Html(f'<div class="gallery">{inside}</div>' if inside else "")


def plotly_figure(
    figure: "plotly.graph_objects.Figure",
    caption: str = "",
    *,
    height_px: int = 460,
    pictures: Mapping[str, Path] | None = None,
) -> Html:
    """An interactive figure in the style of the page.

    Parameters
    ----------
    pictures : mapping of str to path, optional
        PNG files to show while the pointer is on a mark with that key as its `customdata`.
    """
    figure.update_layout(
        template="plotly_white",
        font={"family": FONT, "size": 13, "color": "#1c2330"},
        colorway=COLOURS,
        height=height_px,
        hoverlabel={"align": "left", "font_size": 12},
    )
    if figure.layout.margin.l is None:
        figure.update_layout(margin={"l": 70, "r": 30, "t": 30, "b": 60})
    drawn = figure.to_html(
        full_html=False,
        include_plotlyjs=False,
        config={"displaylogo": False, "responsive": True, "modeBarButtons": [["toImage", "resetScale2d"]]},
        post_script=[_SHOW_PICTURES] if pictures else None,
    )
    encoded = {
        key: f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"
        for key, path in (pictures or {}).items()
    }
    beside = (
        f'<img class="pointed" alt="" hidden><script type="application/json">{json.dumps(encoded)}</script>'
        if encoded
        else ""
    )
    return Html(f'<figure class="plotly">{beside}{drawn}{_caption(caption)}</figure>')


_SHOW_PICTURES = "\n" + _text("show_pictures.js")


def label(name: str, unit: str = "") -> str:
    """Turn the name of a score or parameter into an axis title: its unit moves into brackets.

    Examples
    --------
    >>> label("normal_error_median_deg", "deg")
    'normal error median (deg)'
    """
    bare = name.removesuffix(f"_{unit.lower()}") if unit else name
    words = bare.replace("_", " ")
    return f"{words} ({unit})" if unit not in ("", "1") else words


def rounded(value: float, se: float | None = None) -> str:
    """Write a number for people: four significant digits, or two digits of its standard error.

    Examples
    --------
    >>> rounded(12.3456, 0.0213)
    '12.346 ± 0.021'
    """
    if not math.isfinite(value):
        return "–"
    if se is None or not math.isfinite(se) or se <= 0:
        return f"{value:.0f}" if abs(value) >= 1e4 and abs(value) < 1e7 else f"{value:.4g}"
    decimals = max(0, 1 - math.floor(math.log10(se)))
    if decimals > 6:
        return f"{value:.4g}"
    return f"{value:.{decimals}f} ± {se:.{decimals}f}"


def _cell(value: Any, se: Any) -> str:
    if value is None or value != value:
        return "–"
    if not _is_number(value):
        return _escaped(value)
    text = rounded(float(value), float(se) if _is_number(se) else None)
    number, sign, error = text.partition(" ± ")
    return f'{number}<span class="se"> ± {error}</span>' if sign else number


def _escaped(value: Any) -> str:
    return value if isinstance(value, Html) else html.escape(str(value))


def _is_number(value: Any) -> bool:
    import numbers

    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def _number_class(numeric: bool) -> str:
    return ' class="number"' if numeric else ""


def _caption(text: str) -> str:
    return f"<figcaption>{html.escape(text)}</figcaption>" if text else ""


@cache
def _plotly_script() -> str:
    from plotly.offline import get_plotlyjs

    script: str = get_plotlyjs()
    return script
