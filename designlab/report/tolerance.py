"""The page about copies of a design: how many are good, how scores spread, which spread is to blame."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from designlab.core.fields import unit_of
from designlab.core.store import write_atomic
from designlab.optimization.tolerance import Tolerance
from designlab.report.page import (
    COLOURS,
    Column,
    Html,
    Lead,
    Section,
    label,
    page,
    paragraph,
    plotly_figure,
    table,
)
from designlab.report.yardsticks import YARDSTICKS, score_label

if TYPE_CHECKING:
    import plotly.graph_objects

BLUE, ORANGE, GREY = COLOURS[0], COLOURS[1], COLOURS[-1]
_CALIBRATED = {
    "each": "each calibrated on its own",
    "once": "reconstructed with the calibration of the drawing",
}
MOST_GOOD, HALF_GOOD = 0.9, 0.5  # share of good copies from which the answer is good, or fair
SHOWN = 10  # worst offenders that are drawn


def tolerance_report(found: Tolerance, target: str | Path) -> Path:
    """Write the page about copies of a design.

    Parameters
    ----------
    found : Tolerance
        The copies.
    target : path
        HTML file to write; it needs no other file and no network.
    """
    copies = len(found.copies)
    yields = [_yield(found, name) for name in found.headline()]
    sections = [
        Section("What is to blame", _blame(found)),
        Section("Yield of the other scores", tuple(yields[1:])),
        Section("All scores", (_scores(found),), folded=True),
        Section("What differs between copies", (_spreads(found),), folded=True),
        Section("Copies that cannot be built, or not be evaluated", _left_out(found), folded=True),
    ]
    subtitle = f"{copies} copies of {found.design}, {_CALIBRATED[found.calibrate]}"
    lead = Lead(
        question="How many copies of this design will be good?",
        answer=tuple(paragraph(text) for text in (_result(found), _worst(found)) if text),
        picture=yields[0] if yields else None,
        next_words="Tighten what is to blame, in a file of terms, and draw the copies again:",
        next_command="designlab tolerance design.toml --terms terms.toml --out again",
        **_verdict(found),
    )
    text = page(f"Tolerance: {found.design}", sections, subtitle=subtitle, lead=lead)
    return write_atomic(Path(target), text)


def _verdict(found: Tolerance) -> dict[str, str]:
    """Share of good copies as the verdict of the page; none without a specification."""
    if found.good().empty or not found.spec:
        return {}
    share = found.passed()["share"]
    if share >= MOST_GOOD:
        return {"word": "nearly all", "kind": "good"}
    return (
        {"word": "more than half", "kind": "fair"}
        if share >= HALF_GOOD
        else {"word": "less than half", "kind": "poor"}
    )


def _worst(found: Tolerance) -> str:
    """Which spread is most to blame for the spread of the first score."""
    for name in found.headline():
        blame = found.offenders(name)
        if blame is not None and len(blame):
            first = blame.iloc[0]
            return (
                f"Most of the spread of {score_label(name)} comes from {_thing(first['input'])}: "
                f"{100 * first['share']:.0f} % of the variance, give or take {100 * first['ci']:.0f}."
            )
    return ""


def _result(found: Tolerance) -> str:
    if found.good().empty:
        return "No copy could be evaluated."
    if not found.spec:
        name = found.headline()[0]
        own = found.to_json()["scores"][name]
        if any(own[figure] is None for figure in ("nominal", "low_5", "high_95")):
            return "No copy could be evaluated. No specification was given."
        return (
            f"Nine of ten copies have a {score_label(name, own['unit'])} between {own['low_5']:.3g} and "
            f"{own['high_95']:.3g}; the drawing has {own['nominal']:.3g}. No specification was given."
        )
    share = found.passed()
    bounds = "; ".join(
        f"{score_label(name, found.units[name])} {bound.text()}" for name, bound in found.spec.items()
    )
    good, low, high = (100 * share[end] for end in ("share", "low", "high"))
    return (
        f"{good:.0f} % of the copies are good (95 % interval {low:.0f} to {high:.0f} %): they can be built "
        f"and have {bounds}."
    )


def _yield(found: Tolerance, name: str) -> Html:
    """Share of copies that keep each bound of a score, the drawing and the bounds that were given.

    A bound from below where the score must be high, else one from above.
    """
    import plotly.graph_objects as go

    bound = found.spec.get(name)
    if bound is not None:
        at_least = bound.most is None
    else:
        at_least = name in YARDSTICKS and YARDSTICKS[name].rising is True
    way = "at or above" if at_least else "at or below"
    curve, unit = found.yield_curve(name, at_least=at_least), found.units[name]
    if curve.empty:
        return paragraph(f"{score_label(name)}: no copy could be evaluated.")
    figure = go.Figure()
    figure.add_scatter(
        x=curve["value"],
        y=100 * curve["share"],
        mode="lines",
        line={"color": BLUE, "shape": "vh" if at_least else "hv"},
        hovertemplate=f"%{{y:.0f}} % {way} %{{x:.4g}}<extra></extra>",
        showlegend=False,
    )
    _upright(figure, float(found.nominal[name]), "drawing", GREY, place="bottom right")
    if bound is not None:
        for end, text in ((bound.least, "at least"), (bound.most, "at most")):
            if end is not None:
                _upright(figure, end, text, ORANGE)
    figure.update_xaxes(title=score_label(name, unit))
    figure.update_yaxes(title=f"copies {way} (%)", range=[0, 102])
    figure.update_layout(margin={"l": 60, "r": 30, "t": 40, "b": 60})
    return plotly_figure(figure, height_px=340)


def _upright(
    figure: "plotly.graph_objects.Figure", at: float, text: str, colour: str, *, place: str = "top"
) -> None:
    figure.add_vline(
        x=at,
        line={"color": colour, "width": 1.5, "dash": "dot"},
        annotation={"text": text, "font": {"color": colour}},
        annotation_position=place,
    )


def _blame(found: Tolerance) -> tuple[Html, ...]:
    """Share of the variance of each score that each thing drawn explains, worst first."""
    import plotly.graph_objects as go

    blocks = [
        paragraph(
            "First-order shares of the variance, with 95 % intervals. What is left to 100 % is chance, or "
            "things that matter together only.",
            note=True,
        )
    ]
    for name in found.headline():
        blame = found.offenders(name)
        if blame is None:
            blocks.append(paragraph(f"{score_label(name)}: too few copies, or none that differ."))
            continue
        worst = blame.head(SHOWN)
        figure = go.Figure()
        figure.add_bar(
            y=[_thing(each) for each in worst["input"]],
            x=100 * worst["share"],
            error_x={"array": 100 * worst["ci"], "color": GREY, "thickness": 1},
            orientation="h",
            marker={"color": BLUE},
            hovertemplate="%{y}: %{x:.0f} %<extra></extra>",
        )
        figure.update_xaxes(title=f"share of the variance of {score_label(name)} (%)")
        figure.update_yaxes(automargin=True, autorange="reversed")
        figure.update_layout(margin={"l": 20, "r": 30, "t": 10, "b": 60})
        blocks.append(plotly_figure(figure, height_px=90 + 26 * len(worst)))
    return tuple(blocks)


def _thing(name: str) -> str:
    """Name of an input for people."""
    return label(name.removeprefix("effects."), unit_of(name)).replace(".", ", ")


def _scores(found: Tolerance) -> Html:
    said = found.to_json()["scores"]
    rows = [{"score": score_label(name, own["unit"]), **own} for name, own in said.items()]
    columns = [
        Column("score", "score"),
        Column("nominal", "drawing"),
        Column("mean", "mean of copies"),
        Column("sd", "standard deviation"),
        Column("low_5", "5 % are below"),
        Column("high_95", "5 % are above"),
    ]
    return table(rows, columns)


def _spreads(found: Tolerance) -> Html:
    rows: list[dict[str, Any]] = [
        {
            "field": spread.field,
            "sd": f"{100 * spread.sd:g} %"
            if spread.relative
            else f"{spread.sd:g} {unit_of(spread.field)}".strip(),
            "also": ", ".join(spread.also),
            "source": spread.source,
        }
        for spread in found.spreads
    ]
    columns = [
        Column("field", "field or effect"),
        Column("sd", "standard deviation"),
        Column("also", "moves with it"),
        Column("source", "source"),
    ]
    return table(rows, columns)


def _left_out(found: Tolerance) -> tuple[Html, ...]:
    """Copies that cannot be built, and those of which nothing is known."""
    blocks = []
    for copies, words in ((found.unbuilt, "rule that is broken"), (found.failed, "why not evaluated")):
        rows = [{"reason": why, "copies": int(n)} for why, n in copies["reason"].value_counts().items()]
        if rows:
            blocks.append(table(rows, [Column("reason", words), Column("copies", "copies")]))
    return tuple(blocks) or (paragraph("None."),)
