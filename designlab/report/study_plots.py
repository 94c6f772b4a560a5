"""Interactive figures of a study."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from designlab.core.fields import unit_of
from designlab.optimization.study import Results, Study, history
from designlab.optimization.study.definition import VARIANT
from designlab.report.page import COLOURS, label, rounded
from designlab.report.yardsticks import score_label

if TYPE_CHECKING:
    import pandas as pd
    import plotly.graph_objects

BLUE, ORANGE, GREEN = COLOURS[:3]
GREY = "#b6bdc8"
MOST_ACROSS = 4  # panels of slices side by side


def pareto(results: Results, first: str, second: str) -> "plotly.graph_objects.Figure":
    """Two scores of every evaluated design, with error bars: front, shortlist, start and the rest."""
    import plotly.graph_objects as go

    front, picks = results.pareto, results.picks
    done = results.valid
    rest = done[~done["trial"].isin(front["trial"]) & done["reuse_of"].isna()]
    figure = go.Figure()
    groups = [("other designs", rest, GREY, 6, "circle"), ("Pareto front", front, BLUE, 9, "circle")]
    groups.append(("shortlist", picks, ORANGE, 12, "circle"))
    if results.start is not None:
        groups.append(("starting design", results.start.to_frame().T, GREEN, 13, "diamond"))
    if len(results.study.objectives) == 2:
        stairs = front.sort_values(first)
        figure.add_scatter(
            x=stairs[first], y=stairs[second], mode="lines", line={"color": BLUE, "width": 1, "dash": "dot"},
            hoverinfo="skip", showlegend=False,
        )  # fmt: skip
    for name, rows, colour, size, symbol in groups:
        if len(rows):
            figure.add_scatter(
                x=rows[first],
                y=rows[second],
                error_x=_bars(rows, first, colour),
                error_y=_bars(rows, second, colour),
                mode="markers+text" if name == "shortlist" else "markers",
                text=[f"{number}" for number in rows["trial"]] if name == "shortlist" else None,
                textposition="top right",
                marker={
                    "color": colour,
                    "size": size,
                    "symbol": symbol,
                    "line": {"color": "white", "width": 1},
                },
                hovertext=_hover(results, rows),
                hoverinfo="text",
                customdata=[str(number) for number in rows["trial"]],
                name=name,
            )
    figure.update_layout(
        xaxis_title=_aim(results, first),
        yaxis_title=_aim(results, second),
        legend={"orientation": "h", "y": 1.06, "x": 0},
    )
    return figure


def parallel(results: Results) -> "plotly.graph_objects.Figure":
    """Parameters and objectives of every evaluated design as lines over parallel axes."""
    import plotly.graph_objects as go

    study = results.study
    done = results.valid[results.valid["reuse_of"].isna()]
    names = [*study.varied, *study.objectives]
    scaled, ends = _scaled(done, names, study)
    figure = go.Figure()
    groups = {
        GREY: ~done["trial"].isin(results.pareto["trial"]),
        BLUE: done["trial"].isin(results.pareto["trial"]) & ~done["trial"].isin(results.picks["trial"]),
        ORANGE: done["trial"].isin(results.picks["trial"]),
    }
    for colour, member in groups.items():
        rows = done[member]
        for heights, text in zip(scaled[member].to_numpy(), _hover(results, rows), strict=True):
            figure.add_scatter(
                x=list(range(len(names))),
                y=heights,
                mode="lines+markers",
                line={"color": colour, "width": 1 if colour == GREY else 2},
                marker={"size": 5},
                opacity=0.6 if colour == GREY else 0.9,
                hovertext=text,
                hoverinfo="text",
                showlegend=False,
            )
    for position, name in enumerate(names):
        figure.add_vline(x=position, line={"color": "#8a93a1", "width": 1}, layer="below")
        for height, text in zip((0, 1), ends[name], strict=True):
            figure.add_annotation(
                x=position, y=height, text=text, showarrow=False, yshift=-14 if height == 0 else 14
            )
    units = {path: unit_of(path) for path in study.varied} | dict(results.units)
    called = {name: study.called(name) for name in study.objectives}
    titles = [
        score_label(called.get(name, name), units.get(name, "")).replace(" (", "<br>(") for name in names
    ]
    figure.update_xaxes(
        tickvals=list(range(len(names))), ticktext=titles, showgrid=False, side="bottom", zeroline=False
    )
    figure.update_yaxes(visible=False, range=[-0.1, 1.1])
    figure.update_layout(margin={"l": 50, "r": 50, "t": 20, "b": 70}, hovermode="closest")
    return figure


def slices(results: Results) -> tuple["plotly.graph_objects.Figure", int]:
    """Each objective over each parameter, all evaluated designs; and the number of rows of panels."""
    from plotly.subplots import make_subplots

    study, done = results.study, results.valid[results.valid["reuse_of"].isna()]
    names, objectives = list(study.parameters), list(study.objectives)
    across = min(len(names), MOST_ACROSS)
    bands = -(-len(names) // across)
    rows = bands * len(objectives)
    figure = make_subplots(rows=rows, cols=across, vertical_spacing=0.5 / rows / 2, horizontal_spacing=0.03)
    front = done["trial"].isin(results.pareto["trial"])
    for number, name in enumerate(names):
        band, column = divmod(number, across)
        for place, objective in enumerate(objectives):
            row = band * len(objectives) + place + 1
            for chosen, colour, size in ((~front, GREY, 5), (front, BLUE, 7)):
                figure.add_scatter(
                    x=done.loc[chosen, name], y=done.loc[chosen, objective], mode="markers",
                    marker={"color": colour, "size": size}, hovertext=_hover(results, done[chosen]),
                    hoverinfo="text", row=row, col=column + 1,
                )  # fmt: skip
            if column == 0:
                title = score_label(study.called(objective), results.units.get(objective, ""))
                figure.update_yaxes(title_text=title.replace(" (", "<br>("), row=row, col=1)
            else:
                figure.update_yaxes(showticklabels=False, row=row, col=column + 1)
            if place == len(objectives) - 1:
                figure.update_xaxes(title_text=label(name, unit_of(name)), row=row, col=column + 1)
            else:
                figure.update_xaxes(showticklabels=False, row=row, col=column + 1)
    figure.update_layout(showlegend=False, margin={"l": 90, "r": 20, "t": 15, "b": 55})
    return figure, rows


def importance(shares: Mapping[str, Mapping[str, float]], results: Results) -> "plotly.graph_objects.Figure":
    """Share of the variation of each objective that each parameter explains, in percent."""
    import plotly.graph_objects as go

    study = results.study
    figure = go.Figure()
    for name, share in shares.items():
        figure.add_bar(
            y=[label(path, unit_of(path)) for path in study.varied],
            x=[100 * share.get(path, 0.0) for path in study.varied],
            orientation="h",
            name=score_label(study.called(name), results.units.get(name, "")),
            hovertemplate="%{y}: %{x:.0f} %",
        )
    figure.update_xaxes(title="share of variation explained (%)", range=[0, 100])
    figure.update_yaxes(automargin=True, autorange="reversed")
    figure.update_layout(barmode="group", legend={"orientation": "h", "y": 1.15, "x": 0})
    return figure


def progress(results: Results) -> tuple["plotly.graph_objects.Figure", int]:
    """Best value of each objective over the evaluated designs; and the number of panels."""
    from plotly.subplots import make_subplots

    best = history(results.frame, results.study.objectives)
    done = results.valid
    names = list(best.columns.drop("trial"))
    order = np.arange(1, len(done) + 1)
    figure = make_subplots(rows=len(names), cols=1, shared_xaxes=True, vertical_spacing=0.05)
    for row, name in enumerate(names, start=1):
        if name in done:
            figure.add_scatter(
                x=order, y=done[name], mode="markers", marker={"color": GREY, "size": 6},
                hovertext=_hover(results, done), hoverinfo="text", row=row, col=1,
            )  # fmt: skip
        figure.add_scatter(
            x=order, y=best[name], mode="lines", line={"color": BLUE, "shape": "hv"}, hoverinfo="skip",
            row=row, col=1,
        )  # fmt: skip
        title = score_label(results.study.called(name), results.units.get(name, "")).replace(" (", "<br>(")
        figure.update_yaxes(
            title_text=title if name in done else "hypervolume<br>(share of last)", row=row, col=1
        )
    figure.update_xaxes(title_text="evaluated designs", row=len(names), col=1)
    figure.update_layout(showlegend=False, margin={"l": 90, "r": 30, "t": 15, "b": 55})
    return figure, len(names)


def _bars(rows: "pd.DataFrame", name: str, colour: str) -> dict[str, Any]:
    if f"{name}_se" not in rows:
        return {}
    errors = rows[f"{name}_se"].astype(float)
    return {"type": "data", "array": errors, "color": colour, "thickness": 1, "width": 3}


def _aim(results: Results, name: str) -> str:
    arrow = "larger is better →" if results.study.objectives[name] == "maximise" else "← smaller is better"
    return f"{score_label(results.study.called(name), results.units.get(name, ''))}   {arrow}"


def _hover(results: Results, rows: "pd.DataFrame") -> list[str]:
    """Text of every design: number, scores with standard errors, parameters with units."""
    study = results.study
    texts = []
    for _, row in rows.iterrows():
        lines = [f"<b>trial {row['trial']}</b>"]
        for name, unit in results.units.items():
            if name in row and row[name] == row[name]:
                value = rounded(float(row[name]), float(row.get(f"{name}_se", np.nan)))
                lines.append(f"{score_label(study.called(name), unit)}: {value}")
        for path in study.varied:
            value = row[path]
            if value is None or value != value:  # a parameter of another variant
                continue
            shown = rounded(float(value)) if isinstance(value, float | int | np.number) else str(value)
            lines.append(f"{label(path, unit_of(path))}: {shown}")
        texts.append("<br>".join(lines))
    return texts


def _scaled(
    done: "pd.DataFrame", names: list[str], study: Study
) -> tuple["pd.DataFrame", dict[str, tuple[str, str]]]:
    """Scale columns to 0..1 between the ends of their axes; return also what stands at both ends."""
    scaled, ends = done[names].copy(), {}
    for name in names:
        parameter = study.parameters.get(name)
        if name == VARIANT or (parameter is not None and parameter.choices is not None):
            choices = list(study.variants) if parameter is None else list(parameter.choices or ())
            numbers = {choice: float(place) for place, choice in enumerate(choices)}
            place = done[name].map(numbers)  # missing of other variants: the line has a gap there
            low, high = 0.0, float(len(choices) - 1)
            ends[name] = (str(choices[0]), str(choices[-1]))
        else:
            place = done[name].astype(float)
            if parameter is not None and parameter.low is not None and parameter.high is not None:
                low, high = parameter.low, parameter.high
            else:
                low, high = float(place.min()), float(place.max())
            ends[name] = (rounded(low), rounded(high))
            if parameter is not None and parameter.log:
                place, low, high = place.map(np.log), float(np.log(low)), float(np.log(high))
        scaled[name] = (place - low) / (high - low) if high > low else 0.5
    return scaled, ends
