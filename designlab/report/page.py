"""Building blocks of a page: one HTML file that needs no network, with tables, pictures and figures."""

import base64
import gzip
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from markupsafe import Markup

from designlab.core import __version__

if TYPE_CHECKING:
    import plotly.graph_objects
    from jinja2 import Template


def _text(name: str) -> str:
    """Text of a file beside this module."""
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


Html = Markup
"""Text that is HTML already; every other text is escaped."""
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"
COLOURS = ("#1f5fa8", "#d1541e", "#2f855a", "#7b4ea3", "#b7791f", "#4a5568")
"""Colours of figures, in order: blue, orange, green, purple, ochre, grey."""

MICROMETRES = re.compile(r"(?<=\d )um\b")
"""As messages in ASCII write them."""

LARGE_BYTES = 60_000  # of a picture that is kept in a page as WebP
WEBP_QUALITY = 90  # of 100: text in plots stays sharp

_STYLE = "\n" + _text("page.css").replace("FONT", FONT)


class Section(NamedTuple):
    """A heading and the blocks below it: results of the functions of this module.

    A folded section shows its heading until somebody opens it.
    """

    title: str
    blocks: tuple[Html, ...]
    folded: bool = False


class Lead(NamedTuple):
    """The first screen of a page: a question, its answer, a picture, and what to do next.

    Parameters
    ----------
    question : str
        What the reader wants to know.
    answer : tuple of Html
        One or two paragraphs of a sentence each, with figure, unit and interval.
    picture : Html, optional
        The picture that shows it.
    next_words, next_command : str
        What to do next, and the command that does it.
    word, kind : str
        A verdict in a word, and whether it is "good", "fair", "poor" or nothing of the kind.
    """

    question: str
    answer: tuple[Html, ...]
    picture: Html | None = None
    next_words: str = ""
    next_command: str = ""
    word: str = ""
    kind: str = ""


class Column(NamedTuple):
    """A column of a table: key in the rows, heading, unit, and key of the standard error if there is one."""

    key: str
    title: str
    unit: str = ""
    se: str = ""


class _Head(NamedTuple):
    """Heading of a column as the template needs it."""

    title: str
    unit: str
    numeric: bool


def page(
    title: str,
    sections: Iterable[Section],
    *,
    subtitle: str = "",
    lead: Lead | None = None,
    links: Sequence[Html] = (),
) -> Html:
    """Assemble a page.

    Parameters
    ----------
    title, subtitle : str
        Heading and the line below it.
    sections : iterable of Section
        The content; sections without blocks are left out.
    lead : Lead, optional
        The first screen.
    links : sequence of Html
        Links to other pages, above the heading.

    Returns
    -------
    Html
        A complete document: style, pictures and scripts are inside it.
    """
    sections = [section for section in sections if section.blocks]
    shown = [block for section in sections for block in section.blocks]
    shown += [lead.picture] if lead is not None and lead.picture is not None else []
    scripts = [Html(_plotly_script())] if any('class="plotly' in block for block in shown) else []
    scripts += [Html(_OPEN_LARGE)] if any('class="large"' in block for block in shown) else []
    made = _block("page", title, subtitle, lead, sections, links, Html(_STYLE), scripts, __version__)
    return Html(made.lstrip())


def paragraph(text: str, *, note: bool = False) -> Html:
    """One paragraph, see `prose`."""
    return _block("paragraph", prose(text), note)


def prose(text: str) -> Html:
    """Text of a message as a page sets it: what stands between backquotes as code, and um as µm."""
    if isinstance(text, Html):
        return text
    parts = text.split("`")
    if len(parts) % 2 == 0:  # a backquote without its partner is a character
        parts[-2:] = ["`".join(parts[-2:])]
    return _block("prose", [part if at % 2 else MICROMETRES.sub("µm", part) for at, part in enumerate(parts)])


def facts(values: Mapping[str, Any]) -> Html:
    """Names and values, one pair a line; empty values are left out."""
    return _block("facts", [(name, value) for name, value in values.items() if value != ""])


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
    heads = [
        _Head(c.title, "" if c.unit == "1" else c.unit, any(_is_number(row.get(c.key)) for row in rows))
        for c in chosen
    ]
    cells = [
        [(head, _cell(row.get(c.key), row.get(c.se))) for head, c in zip(heads, chosen, strict=True)]
        for row in rows
    ]
    return _block("table", heads, cells, caption)


def picture(source: str | Path | bytes, caption: str, *, alt: str = "") -> Html:
    """A picture, kept inside the page; it opens large.

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
    if kind in ("png", "jpeg") and len(data) > LARGE_BYTES:
        kind, data = "webp", _smaller(data)
    encoded = base64.b64encode(data).decode()
    return _block("picture", f"data:image/{kind};base64,{encoded}", alt or caption, caption)


def _smaller(data: bytes) -> bytes:
    """The same picture as WebP, a third of the bytes."""
    import io

    from PIL import Image

    written = io.BytesIO()
    with Image.open(io.BytesIO(data)) as opened:
        opened.convert("RGB").save(written, "WEBP", quality=WEBP_QUALITY, method=4)
    return written.getvalue()


def gallery(pictures: Iterable[Html]) -> Html:
    """Pictures side by side."""
    shown = list(pictures)
    return _block("gallery", shown) if shown else Html("")


def pair(left: Html, right: Html) -> Html:
    """Two blocks side by side where there is room."""
    return _block("pair", left, right)


def heading(text: str) -> Html:
    """A heading within a section."""
    return _block("heading", text)


def listed(lines: Iterable[str]) -> Html:
    """Lines of a list, see `prose`."""
    return _block("listed", [prose(line) for line in lines])


def word(text: str, kind: str) -> Html:
    """A word of a verdict: `kind` is "good", "fair" or "poor"."""
    return _block("word", text, kind)


def under(text: str, below: str) -> Html:
    """Text with a note under it."""
    return _block("under", text, below)


def unbroken(text: str) -> Html:
    """Text that stays on one line."""
    return _block("unbroken", text)


def link(target: str, text: str) -> Html:
    """A link to a file beside the page."""
    return _block("link", target, text)


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
    drawn = re.sub(r'<script( type="text/javascript")?>', '<script type="text/figure">', drawn)
    encoded = {
        key: f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"
        for key, path in (pictures or {}).items()
    }
    beside = Html(json.dumps(encoded)) if encoded else None  # base64 and trial numbers, nothing to escape
    return _block("plot", Html(drawn), beside, caption)


_SHOW_PICTURES = "\n" + _text("show_pictures.js")
_OPEN_LARGE = "\n" + _text("open_large.js")


def counted(number: int, what: str) -> str:
    """A number of things.

    Examples
    --------
    >>> counted(1, "design"), counted(3, "design")
    ('1 design', '3 designs')
    """
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


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


def difference_text(value: float, low: float, high: float, *, signed: bool = True) -> str:
    """Write a difference with its interval, to two digits of half the interval.

    Examples
    --------
    >>> difference_text(-0.0519, -25.41, 25.3)
    '0 (-25 to +25)'
    >>> difference_text(0.0393, 0.0336, 0.045, signed=False)
    '0.0393 (0.0336 to 0.0450)'
    """
    half = (high - low) / 2
    decimals = min(max(0, 1 - math.floor(math.log10(half))), 6) if math.isfinite(half) and half > 0 else 4
    sign = "+" if signed else ""
    texts = (
        f"{number:{sign}.{decimals}f}" if round(number, decimals) else "0" for number in (value, low, high)
    )
    return "{} ({} to {})".format(*texts)


def _cell(value: Any, se: Any) -> tuple[Any, str]:
    """A value for people, and its standard error."""
    if value is None or value != value:
        return "–", ""
    if not _is_number(value):
        return value if isinstance(value, Html) else str(value), ""
    text = rounded(float(value), float(se) if _is_number(se) else None)
    number, _, error = text.partition(" ± ")
    return number, error


def _is_number(value: Any) -> bool:
    import numbers

    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def _block(name: str, *content: Any) -> Html:
    """A block of the template."""
    made: str = getattr(_template().module, name)(*content)
    return Html(made)


@cache
def _template() -> "Template":
    import jinja2

    return jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    ).from_string(_text("blocks.html"))


@cache
def _plotly_script() -> str:
    from plotly.offline import get_plotlyjs

    packed = gzip.compress(get_plotlyjs().encode(), mtime=0)
    return _text("unpack.js").replace("PACKED", base64.b64encode(packed).decode())
