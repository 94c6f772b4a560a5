"""The page about a pool of generated sets: how often diagnoses were right, and how sure they were."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from designlab.core.store import write_atomic
from designlab.report.figures import write_figure
from designlab.report.page import Column, Html, Section, page, paragraph, picture, table
from designlab.report.pool_plots import limits_plot, reliability_plot

_FAMILIES = {
    "nothing": "nothing hidden",
    "single": "one effect hidden",
    "pair": "two effects hidden",
    "outside": "a cause outside the catalogue",
    "left_out": "an effect whose class was taken out of the catalogue",
}
_RATES = {
    "named": "a name without reserve",
    "right_first": "the right name first",
    "all_named": "all named",
    "truth_in_set": "all in the reported sets",
    "sure": "a first name with a confidence of 0.9 or more",
    "further_wrong": "a further name that is wrong",
    "intervals_hold": "95 % intervals hold the truth",
    "named_or_ambiguous": "a name without reserve, or several to choose from",
    "abstained": "unexplained, partial or refused",
}
_MEDIANS = {
    "set_size_mean": "effects in the first set, mean",
    "gap_removed_median": "share of the gap removed on presses that decided nothing, median",
    "control_removed_median": "the same by a wrong effect of the same size, median",
    "value_error_median": "error of values over their distance from null, median",
}
_RELIABILITY = (
    "Names given, in bins of equal mass: how sure the reports were of them, and the share "
    "that was right, with its 95 % interval. On the line both agree."
)
_LIMITS = (
    "Each mark is a set: filled where the right name came first. Squares: the strength at which half of the "
    "sets are named right, with its 95 % interval."
)
_CONFUSION = "The name that came first, or the verdict where there was none, and of how many sets."


def pool_report(score: Mapping[str, Any], target: str | Path, *, title: str) -> Path:
    """Write the page about a pool.

    Parameters
    ----------
    score : mapping
        As `designlab.validation.blind.score` gives it.
    target : path
        HTML file to write; the plots in it are written beside it, ``reliability.png`` and ``limits.png``.
    title : str
        Heading.
    """
    folder, sure, limits = Path(target).parent, score["confidence"], score["limits"]
    said: tuple[Html, ...] = ()
    limited: tuple[Html, ...] = ()
    if sure is not None:
        plot = write_figure(reliability_plot(sure["bins"]), folder / "reliability.png")
        words = f"Mean distance of the two over {sure['names']} names: {sure['error']:.3f}."
        if (relied := score["sure_names"]) is not None:
            ends = f"{relied['low']:.1%} to {relied['high']:.1%}"
            words += f" Of {relied['sets']} names with 0.9 or more {relied['share']:.1%} ({ends}) were right."
        if (curve := score["risk_coverage"]) is not None:
            words += f" Area under the risk-coverage curve of first names: {curve['area']:.4f}."
        said = (paragraph(words), picture(plot, _RELIABILITY))
    if limits:
        limited = (picture(write_figure(limits_plot(limits), folder / "limits.png"), _LIMITS),)
    content = [
        Section("Rates", _rates(score)),
        Section("How sure, and how often right", said),
        Section("How large an effect must be", limited),
        Section("What was said of what", _confusion(score["confusion"])),
        Section("Every set", (table(_sets(score["rows"]), _SET_COLUMNS),)),
    ]
    return write_atomic(target, page(title, content))


def _rates(score: Mapping[str, Any]) -> tuple[Html, ...]:
    rates: list[dict[str, Any]] = []
    medians: list[dict[str, Any]] = []
    for family, name in _FAMILIES.items():
        found = score[family]
        for key, what in _RATES.items():
            if (rate := found.get(key)) is not None:
                ends = f"{rate['low']:.1%} to {rate['high']:.1%}"
                rates.append(
                    {"family": name, "what": what, "share": f"{rate['share']:.1%}", "interval": ends}
                    | {"sets": rate["sets"]}
                )
        for key, what in _MEDIANS.items():
            if (value := found.get(key)) is not None:
                shown = f"{value:.2f}" if key == "set_size_mean" else f"{value:.0%}"
                medians.append({"family": name, "what": what, "value": shown})
    columns = [
        Column("family", "of sets with"),
        Column("what", "how often"),
        Column("share", "share"),
        Column("interval", "95 % interval"),
        Column("sets", "of"),
    ]
    blocks = [table(rates, columns)]
    if medians:
        blocks.append(
            table(medians, [Column("family", "of sets with"), Column("what", ""), Column("value", "")])
        )
    if len(codes := score["codes"]) > 1:
        blocks.append(
            paragraph(
                f"The code changed on the way; digests of the {len(codes)} versions: {', '.join(codes)}."
            )
        )
    return tuple(blocks)


def _confusion(found: Mapping[str, Mapping[str, int]]) -> tuple[Html, ...]:
    if not found:
        return ()
    rows = [
        {
            "hidden": hidden.replace("_", " ").replace("+", " and "),
            "sets": sum(said.values()),
            "said": _counted(said),
        }
        for hidden, said in sorted(found.items())
    ]
    columns = [Column("hidden", "hidden"), Column("sets", "sets"), Column("said", "said first")]
    return (paragraph(_CONFUSION, note=True), table(rows, columns))


def _counted(said: Mapping[str, int]) -> str:
    ordered = sorted(said.items(), key=lambda item: -item[1])
    return ", ".join(f"{name.replace('_', ' ')} {count}" for name, count in ordered)


_SET_COLUMNS = [
    Column("set", "set"),
    Column("design", "design"),
    Column("hidden", "hidden"),
    Column("verdict", "verdict"),
    Column("named", "named"),
    Column("alike", "would do as well"),
    Column("removed", "gap removed"),
    Column("seconds", "processor time", "s"),
]


def _sets(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    return [
        {
            "set": row["set"],
            "design": row["design"],
            "hidden": ", ".join(row["hidden"]),
            "verdict": row["verdict"].split(":")[0].replace("_", " "),
            "named": ", ".join(row["named"]),
            "alike": "; ".join(", ".join(names[1:]) for names in row["sets"] if len(names) > 1),
            "removed": "" if row["gap_removed"] is None else f"{row['gap_removed']:.0%}",
            "seconds": round(row["seconds"], 1),
        }
        for row in rows
    ]
