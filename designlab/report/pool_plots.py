"""Plots about a pool of generated sets: reliability of the confidence, detection limits."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from designlab.report.figures import new_figure
from designlab.report.page import COLOURS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLUE, GREY = COLOURS[0], COLOURS[-1]
FREE = 0.05  # of the confidence: an error up to here is shaded


def reliability_plot(bins: Sequence[Mapping[str, float]]) -> "Figure":
    """Share of right names over stated confidence, with 95 % intervals and the number of names."""
    figure = new_figure(5.0, 4.4)
    axes = figure.add_subplot()
    ends = np.array([0.0, 1.0])
    axes.fill_between(ends, ends - FREE, ends + FREE, color=GREY, alpha=0.15, linewidth=0)
    axes.plot(ends, ends, color=GREY, linewidth=1, linestyle=":")
    stated, right = (np.array([b[key] for b in bins]) for key in ("confidence", "right"))
    low, high = (np.array([b[key] for b in bins]) for key in ("low", "high"))
    axes.errorbar(stated, right, [right - low, high - right], fmt="o", color=BLUE, capsize=3)
    # Few names have long intervals: numbers below their ends stand apart where confidences are much the same.
    for x, y, each in zip(stated, low, bins, strict=True):
        axes.annotate(
            f"{each['names']}", (x, y), xytext=(0, -5), textcoords="offset points", ha="center", va="top",
            fontsize=8.5, color=BLUE, bbox={"facecolor": "white", "alpha": 0.8, "linewidth": 0, "pad": 0.5},
        )  # fmt: skip
    axes.set(xlabel="stated confidence", ylabel="share of names that were right")
    axes.set(xlim=(0, 1.02), ylim=(0, 1.02), aspect="equal")
    return figure


MARKS = "so^v"
"""Of the sets of each design."""


def limits_plot(limits: Mapping[str, Mapping[str, Any]]) -> "Figure":
    """Sets named right or not over strength, and the limits with their 95 % intervals, smallest on top."""
    kinds = sorted(limits, key=lambda kind: -float(limits[kind]["strength"]))
    figure = new_figure(7.2, 1.2 + 0.32 * len(kinds))
    axes = figure.add_subplot()
    tried = [(row, *each) for row, kind in enumerate(kinds) for each in limits[kind]["tried"]]
    designs = sorted({design for *_, design in tried}, reverse=True)
    for place, design in enumerate(designs):
        for right, face, name in ((True, GREY, "named right"), (False, "white", "not")):
            own = [(s, row) for row, s, seen, of in tried if of == design and seen == right]
            x, y = np.array(own).reshape(-1, 2).T
            axes.plot(
                x, y + 0.28 - 0.22 * place, MARKS[place % len(MARKS)], color=GREY, markerfacecolor=face,
                markersize=4.5, label=f"{design}, {name}",
            )  # fmt: skip
    least, most = (end(strength for _, strength, *_ in tried) for end in (min, max))
    middle = np.array([float(limits[kind]["strength"]) for kind in kinds])
    low = np.array([limits[kind]["low"] or least / 2 for kind in kinds])
    high = np.array([limits[kind]["high"] or 2 * most for kind in kinds])
    rows = np.arange(len(kinds)) - 0.22  # below the marks of the sets
    away = [np.maximum(middle - low, 0), np.maximum(high - middle, 0)]
    axes.errorbar(
        middle,
        rows,
        xerr=away,
        fmt="D",
        color=BLUE,
        markersize=4.5,
        elinewidth=1,
        label="half are named right",
    )
    axes.set_yticks(range(len(kinds)), [kind.replace("_", " ") for kind in kinds])
    axes.set_xscale("log", base=2)
    axes.set_xlim(least / 2, 2 * most)
    marks = 2.0 ** np.arange(np.ceil(np.log2(least)), np.floor(np.log2(most)) + 1)
    axes.set_xticks(marks, [f"{mark:g}" if mark >= 1 else f"1/{1 / mark:g}" for mark in marks])
    axes.set_xlabel("strength (prior standard deviations)")
    axes.grid(axis="x", color="#dde1e7")
    figure.legend(loc="outside upper center", ncols=2, frameon=False, fontsize=9)
    return figure
