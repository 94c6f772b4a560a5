"""Small drawings of the page about a gap: bars over the floor, values with intervals within bounds."""

import html
import math
from collections.abc import Mapping, Sequence
from typing import Any

from designlab.report.page import COLOURS, Html, rounded

BEFORE, AFTER = COLOURS[1], COLOURS[0]
SOFT, LINE, INK, BAND = "#5b6575", "#dde1e7", "#1c2330", "#e3ebf4"
WIDTH, LEFT, RIGHT = 760, 86, 190  # pixels: all, names of the splits, numbers
BAR, PAIR = 15, 50
TICKS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000)
FAR_SD = 4.0  # prior standard deviations that a drawing of a value spans at least
CELL, MARGIN = 190, 8


def gap_bars(gap: Mapping[str, Mapping[str, float]], titles: Mapping[str, str]) -> Html:
    """Squared residuals before and after as bars that begin at what is usual, on a logarithmic scale.

    Parameters
    ----------
    gap : mapping of str to mapping
        ``before``, ``after`` and ``usual`` of every split.
    titles : mapping of str to str
        What stands beside the bars of a split.
    """
    times = {
        split: {name: level[name] / level["usual"] for name in ("before", "after")}
        for split, level in gap.items()
    }
    largest = max(2.0, *(value for pair in times.values() for value in pair.values()))
    room = WIDTH - LEFT - RIGHT

    def x(value: float) -> float:
        return LEFT + room * math.log(max(value, 1.0)) / math.log(largest)

    height = PAIR * len(gap) + 44
    parts = []
    marks = [tick for tick in TICKS if tick <= largest]
    shown = [tick for k, tick in enumerate(marks) if len(marks) <= 7 or tick in (1, 10, 100, 1000, 10000)]
    for tick in shown:
        parts.append(_line(x(tick), 8, x(tick), height - 34, LINE if tick > 1 else INK))
        parts.append(_text(x(tick), height - 19, f"{tick:g}", anchor="middle", colour=SOFT, size=12))
    parts.append(
        _text(
            LEFT + room / 2,
            height - 3,
            "squared residual over what noise, grain and smooth errors leave",
            anchor="middle",
            colour=SOFT,
            size=12,
        )
    )
    for row, (split, level) in enumerate(gap.items()):
        top = 12 + PAIR * row
        parts.append(_text(LEFT - 10, top + BAR + 5, titles.get(split, split), anchor="end", weight=600))
        for k, (name, colour) in enumerate((("before", BEFORE), ("after", AFTER))):
            y = top + k * (BAR + 2)
            long = max(x(times[split][name]) - LEFT, 1.5)
            parts.append(f'<rect x="{LEFT}" y="{y}" width="{long:.1f}" height="{BAR}" fill="{colour}"/>')
            parts.append(_text(LEFT + long + 6, y + BAR - 3, f"{rounded(level[name])} {name}", size=12))
    described = "; ".join(
        f"{titles.get(split, split)}: {level['before']:.3g} before, {level['after']:.3g} after, "
        f"usual {level['usual']:.3g}"
        for split, level in gap.items()
    )
    return Html(f'<figure style="overflow-x:auto">{_svg(WIDTH, height, parts, described)}</figure>')


def interval_bar(parameter: Mapping[str, Any]) -> Html:
    """A value with its interval: what is usual as a band, null as a thin line, bounds as brackets.

    Parameters
    ----------
    parameter : mapping
        ``value``, ``low``, ``high``, ``null``, ``sd``, ``bounds``.
    """
    value, null, sd = parameter["value"], parameter["null"], parameter["sd"]
    lower, upper = parameter["bounds"]
    known = [v for v in (value, parameter["low"], parameter["high"]) if v is not None]
    far = max(FAR_SD * sd, *(1.15 * abs(v - null) for v in known))
    first, last = max(lower, null - far), min(upper, null + far)
    room = CELL - 2 * MARGIN

    def x(at: float) -> float:
        return float(MARGIN + room * (min(max(at, first), last) - first) / max(last - first, 1e-12))

    band = x(null - sd), x(null + sd)
    parts = [
        f'<rect x="{band[0]:.1f}" y="4" width="{band[1] - band[0]:.1f}" height="14" fill="{BAND}"/>',
        _line(MARGIN, 11, CELL - MARGIN, 11, LINE),
        _line(x(null), 3, x(null), 19, SOFT),
    ]
    for end, there, inward in ((lower, first, 4), (upper, last, -4)):
        if end == there:
            parts.append(
                f'<path d="M{x(end) + inward:.1f} 2H{x(end):.1f}V20H{x(end) + inward:.1f}" fill="none" '
                f'stroke="{INK}" stroke-width="1.3"/>'
            )
    if parameter["low"] is not None and parameter["high"] is not None:
        parts.append(_line(x(parameter["low"]), 11, x(parameter["high"]), 11, AFTER, width=5))
    parts.append(f'<circle cx="{x(value):.1f}" cy="11" r="4.2" fill="{AFTER}" stroke="#fff"/>')
    return Html(_svg(CELL, 22, parts, f"{value:.4g} between {lower:g} and {upper:g}"))


def _svg(width: int, height: int, parts: Sequence[str], described: str) -> str:
    return (
        f'<svg role="img" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        f'style="font-family: inherit; vertical-align: middle"><title>{html.escape(described)}</title>'
        f"{''.join(parts)}</svg>"
    )


def _line(x1: float, y1: float, x2: float, y2: float, colour: str, *, width: float = 1.0) -> str:
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}" '
        f'stroke-width="{width:g}"/>'
    )


def _text(
    x: float,
    y: float,
    text: str,
    *,
    anchor: str = "start",
    colour: str = INK,
    size: int = 13,
    weight: int = 400,
) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}" font-size="{size}" '
        f'font-weight="{weight}">{html.escape(text)}</text>'
    )
