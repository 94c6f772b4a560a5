"""The page about a study: what was found, the designs to compare first, and how far the search came."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from designlab.core.fields import unit_of
from designlab.core.progress import silent
from designlab.core.store import write_atomic
from designlab.core.types import Progress
from designlab.evaluation.press_plan import PRESS_RULES
from designlab.optimization.study import Results, importance, load_results
from designlab.optimization.study.definition import VARIANT
from designlab.optimization.study.folder import trial_folder
from designlab.report import study_plots
from designlab.report.page import (
    Column,
    Html,
    Lead,
    Section,
    counted,
    difference_text,
    facts,
    gallery,
    label,
    page,
    paragraph,
    picture,
    plotly_figure,
    rounded,
    table,
    unbroken,
    word,
)
from designlab.report.yardsticks import HEADLINES, YARDSTICKS, score_label
from designlab.sensor.design import dumps, preset_names
from designlab.sensor.feasibility import RULES

MOST_DEPICTED = 16  # designs of the front that get pictures
_CAPTIONS = {"untouched": "untouched gel", "press": "a ball of 4 mm, pressed"}


def study_report(
    results: Results | str | Path,
    target: str | Path | None = None,
    *,
    pictures: bool = True,
    links: Sequence[Html] = (),
    progress: Progress = silent,
) -> Path:
    """Write the page about a study.

    Parameters
    ----------
    results : Results or path
        A study, or its folder.
    target : path, optional
        HTML file to write; ``report.html`` in the folder of the study when absent.
    pictures : bool
        Whether to render two pictures of each design of the front that has none yet (some seconds each).
    links : sequence of Html
        Links to the pages that lead here.
    progress : callable, optional
        Called with what is drawn, how much of it is done, and of how much.

    Returns
    -------
    Path
        The file written; it needs no other file and no network.

    Raises
    ------
    StudyError
        If the folder holds no study.
    OSError
        If the page cannot be written.
    """
    found = results if isinstance(results, Results) else load_results(results)
    path = Path(target) if target is not None else found.folder / "report.html"
    if pictures:
        shown = list(dict.fromkeys([*found.picks["trial"], *found.pareto["trial"].iloc[:MOST_DEPICTED]]))
        for done, number in enumerate(shown):
            progress(f"pictures of design {number}", done, len(shown))
            _depict(found, int(number))
        progress("page", len(shown), len(shown))
    study = found.study
    sections = [
        Section("Confirmed with fresh seeds", _confirmation(found)),
        Section("Shortlist", _shortlist(found)),
        Section("All scores of the shortlist", _further(found), folded=True),
        Section("Trade-off", _trade_off(found)),
        Section("What matters", _importance(found)),
        Section("Best of the search", _result(found)),
        Section("Parameters of all designs", _parallel(found), folded=True),
        Section("Scores over parameters", _slices(found), folded=True),
        Section("Progress", _progress(found), folded=True),
        Section("Designs left out", _rejections(found), folded=True),
        Section("The search", _definition(found), folded=True),
    ]
    subtitle = f"{counted(found.evaluated, 'design')} evaluated, starting from {study.base.name}"
    text = page(f"Study: {study.name}", sections, subtitle=subtitle, lead=_lead(found), links=links)
    return write_atomic(path, text)


def _result(results: Results) -> tuple[Html, ...]:
    counts = results.counts()
    if results.evaluated == 0:
        return (paragraph("No design has been evaluated yet."),)
    nearest = results.nearest
    if nearest is not None:
        bounds = results.study.constraints
        text = "; ".join(
            f"{name} {nearest[name]:.4g}, must be {bounds[name].text()}" for name in nearest["violated"]
        )
        words = f"None of {results.evaluated} evaluated designs keeps the constraints. "
        return (paragraph(f"{words}Trial {nearest['trial']} breaks fewest: {text}."),)
    start = results.start
    rows = []
    study = results.study
    for name, way in study.objectives.items():
        values = results.valid[name].to_numpy(dtype=float)
        best = results.valid.iloc[int(values.argmax() if way == "maximise" else values.argmin())]
        rows.append(
            {
                "score": score_label(study.called(name), results.units.get(name, "")),
                "aim": f"{way}",
                "start": None if start is None else start[name],
                "start_se": None if start is None else start.get(f"{name}_se"),
                "best": best[name],
                "best_se": best.get(f"{name}_se"),
                "trial": f"trial {best['trial']}",
            }
        )
    columns = [Column("score", "score"), Column("aim", "aim")]
    if start is not None:
        columns.append(Column("start", "starting design", se="start_se"))
    columns += [Column("best", "best found", se="best_se"), Column("trial", "by")]
    waiting = counts["running"] + counts["waiting"]
    text = (
        f"On the Pareto front: {len(results.pareto)} of {results.evaluated} evaluated designs. No other is "
        "better than one of these in every objective. The values after ± are standard errors. All designs "
        "see the same presses, so differences between them are surer than these."
    )
    if study.robust is not None:
        text += f" Every value is one over {study.robust.copies} copies of the design as they would be built."
    unfinished = (
        [paragraph(f"The study is not finished: {waiting} more trials are under way.")] if waiting else []
    )
    return (table(rows, columns), paragraph(text), *unfinished)


def _shortlist(results: Results) -> tuple[Html, ...]:
    if results.picks.empty:
        return ()
    study = results.study
    headlines = [name for name in HEADLINES if name in results.units and name not in study.objectives]
    shown = [
        picture(path, f"trial {number}: {_CAPTIONS.get(path.stem, path.stem)}")
        for number in results.picks["trial"]
        for path in sorted(trial_folder(results.folder, number).glob("*.png"), reverse=True)
    ]
    number = int(results.picks.iloc[0]["trial"])
    file = trial_folder(results.folder, number) / "design.toml"
    note = (
        "Each design is kept in the study's folder as `trials/NNNN/design.toml`. To get the files to make "
        f"one: `designlab export {file} --out DIR`"
    )
    other = "the first" if results.start is None else "the starting design"
    words = [
        paragraph(f"Trial {number}, against {other}: {text}.")
        for number, text in results.trades_in_words(lambda name: _called(results, name)).items()
    ]
    shortlisted = _compared(results, [*study.objectives, *headlines, *study.varied])
    return (shortlisted, *words, gallery(shown), paragraph(note, note=True))


def _further(results: Results) -> tuple[Html, ...]:
    """The other scores of the shortlist."""
    told = (*results.study.objectives, *HEADLINES)
    names = [name for name in results.units if name not in told]
    return () if results.picks.empty or not names else (_compared(results, names),)


def _compared(results: Results, names: Sequence[str]) -> Html:
    """Scores and parameters of the shortlist, beside those of the starting design."""
    study, units = results.study, dict(results.units)
    designs = [(f"trial {row['trial']}", _pick(row["pick"]), row) for _, row in results.picks.iterrows()]
    if results.start is not None and results.start["trial"] not in set(results.picks["trial"]):
        designs.append((f"trial {results.start['trial']}", "starting design", results.start))
    rows: list[dict[str, Any]] = []
    for name in names:
        if name in units:
            row: dict[str, Any] = {"quantity": score_label(study.called(name), units[name])}
        else:
            row = {"quantity": label(name, unit_of(name))}
        for title, _, design in designs:
            row |= {title: design.get(name), f"{title} se": design.get(f"{name}_se")}
        rows.append(row)
    columns = [Column("quantity", "")]
    columns += [Column(title, title, reason, f"{title} se") for title, reason, _ in designs]
    return table(rows, columns)


def _confirmation(results: Results) -> tuple[Html, ...]:
    """What the best designs scored when they were evaluated again, beside the base."""
    gains = results.gains()
    if gains.empty:
        return ()
    units = dict(results.units)
    rows: list[dict[str, Any]] = [
        {
            **{str(name): value for name, value in row.items()},
            "design": f"trial {row['trial']}",
            "score": score_label(results.study.called(row["objective"]), units.get(row["objective"], "")),
            "change": _change(row),
            "verdict": word("better", "good")
            if row["better"]
            else word("worse", "poor")
            if row["seen"]
            else "no difference seen",
            "breaks": ", ".join(row["violated"] or ()) or "–",
        }
        for row in gains.to_dict(orient="records")
    ]
    columns = [
        Column("design", "design"),
        Column("score", "score"),
        Column("base", "base design", se="base_se"),
        Column("value", "design", se="value_se"),
        Column("change", "difference (interval)"),
        Column("verdict", ""),
        Column("breaks", "breaks"),
    ]
    fidelity = gains["fidelity"].iloc[0]
    text = (
        f"Evaluated again at {fidelity} fidelity with random numbers that had no part in the search. "
        "Intervals of the differences hold all together in 95 of 100 studies."
    )
    words = results.curse_in_words(lambda name: score_label(name, units.get(name, "")))
    return (table(rows, columns), paragraph(text), *map(paragraph, words))


def _called(results: Results, name: str) -> str:
    """Name of a score or parameter in a sentence, where its unit follows its value."""
    study = results.study
    titled = label(name, unit_of(name)) if name in study.varied else score_label(study.called(name))
    return titled.partition(" (")[0]


def _pick(pick: str) -> str:
    """Why a design is on the shortlist, with the names of scores as people read them."""
    return re.sub(r"\w+", lambda m: score_label(m[0]) if m[0] in YARDSTICKS else m[0].replace("_", " "), pick)


def _change(gain: Mapping[Any, Any]) -> Html:
    """Difference from the base with its interval."""
    return unbroken(difference_text(gain["difference"], gain["low"], gain["high"]))


def _best(results: Results) -> tuple[Html, ...]:
    """The best value of each objective, and that of the starting design."""
    parts = []
    for name, way in results.study.objectives.items():
        values = results.valid[name].to_numpy(dtype=float)
        best = results.valid.iloc[int(values.argmax() if way == "maximise" else values.argmin())]
        shown = [best] if results.start is None else [best, results.start]
        unit = results.units.get(name, "").replace("um", "µm")
        texts = [
            f"{rounded(row[name], row.get(f'{name}_se'))} {'' if unit in ('', '1') else unit}".strip()
            for row in shown
        ]
        parts.append(f"{_called(results, name)} {' (start '.join(texts)}{')' if len(texts) > 1 else ''}")
    return (paragraph(f"Best so far: {'; '.join(parts)}."),)


def _base(results: Results) -> str | Path:
    """What the command line takes for the base design: a preset, or the file of its trial."""
    base = results.study.base
    if base.name in preset_names() or results.start is None:
        return base.name
    return trial_folder(results.folder, int(results.start["trial"])) / "design.toml"


def _lead(results: Results) -> Lead:
    """Whether the search found something better, by designs that were evaluated again."""
    study, gains, units = results.study, results.gains(), results.units
    question = f"Is there a better sensor than {study.base.name}?"
    start = f"designlab study run {results.folder}"
    if results.picks.empty:
        text = "No design that keeps the constraints has been evaluated yet."
        return Lead(question, (paragraph(text),), None, "Go on with the search:", start)
    own = None if results.start is None else int(results.start["trial"])
    number = next((int(each) for each in results.picks["trial"] if each != own), own)
    file = trial_folder(results.folder, int(number or 0)) / "design.toml"
    depicted = file.parent / "press.png"
    shown = picture(depicted, f"Trial {number}: {_CAPTIONS['press']}") if depicted.is_file() else None
    if number == own:
        designs = counted(results.evaluated, "design")
        text = f"None of {designs} is better than {study.base.name} in any objective."
        return Lead(
            question,
            (paragraph(text), *_best(results)),
            shown,
            "Go on with the search:",
            start,
            "none seen",
            "fair",
        )
    if gains.empty:
        text = (
            f"The search has evaluated {counted(results.evaluated, 'design')}. Its best were not evaluated "
            "again, so part of what they gain is chance."
        )
        return Lead(
            question,
            (*_best(results), paragraph(text)),
            shown,
            "Evaluate the best again with the base:",
            f"designlab evaluate {_base(results)} {file} --compare",
            "not confirmed",
            "fair",
        )
    told, better = [], False
    for trial, rows in gains.groupby("trial", sort=False):
        parts = []
        for row in rows.to_dict(orient="records"):
            better = better or bool(row["better"])
            unit = units.get(row["objective"], "").replace("um", "µm")
            after = "" if unit in ("", "1") else f" {unit}"
            way = "no difference seen" if not row["seen"] else "better" if row["better"] else "worse"
            parts.append(
                f"{_called(results, row['objective'])} {row['value']:.3g}{after}, "
                f"not {row['base']:.3g}{after}: {way}, difference {_change(row)}{after}"
            )
        told.append(f"Trial {trial} against {study.base.name}: {'; '.join(parts)}.")
    fidelity = gains["fidelity"].iloc[0]
    note = f"Both were evaluated again at {fidelity} fidelity with fresh random numbers."
    return Lead(
        question,
        (*map(paragraph, told), paragraph(note, note=True)),
        shown,
        "Get the files to make one:",
        f"designlab export {file} --out parts",
        "yes, in some scores" if better else "none seen",
        "good" if better else "fair",
    )


def _trade_off(results: Results) -> tuple[Html, ...]:
    if results.pareto.empty:
        return ()
    caption = "Every evaluated design, with standard errors. Point at one to see its parameters and scores."
    first, *others = results.study.objectives
    drawn = [study_plots.pareto(results, first, other) for other in others]
    pictures = {
        str(number): path
        for number in results.pareto["trial"]
        if (path := trial_folder(results.folder, int(number)) / "press.png").is_file()
    }
    return tuple(plotly_figure(figure, caption, height_px=520, pictures=pictures) for figure in drawn)


def _parallel(results: Results) -> tuple[Html, ...]:
    if results.pareto.empty:
        return ()
    caption = "Each line is a design; those of the Pareto front are blue, the shortlist is orange."
    return (plotly_figure(study_plots.parallel(results), caption),)


def _slices(results: Results) -> tuple[Html, ...]:
    if results.pareto.empty:
        return ()
    caption = "Each point is a design; those of the Pareto front are blue."
    figure, rows = study_plots.slices(results)
    return (plotly_figure(figure, caption, height_px=100 + 170 * rows),)


def _importance(results: Results) -> tuple[Html, ...]:
    shares = importance(results.folder, storage=results.storage)
    if not shares:
        return ()
    caption = (
        "Share of the variation of each score that a parameter explains over its range (functional ANOVA of "
        "a random forest fitted to the evaluated designs)."
    )
    height_px = 120 + 28 * len(results.study.parameters) * len(shares)
    return (plotly_figure(study_plots.importance(shares, results), caption, height_px=height_px),)


def _progress(results: Results) -> tuple[Html, ...]:
    if results.pareto.empty:
        return ()
    caption = "Points are designs in the order of their evaluation, lines the best so far."
    if len(results.study.objectives) == 2:
        caption += " The hypervolume measures the whole front: its last value is 1."
    figure, panels = study_plots.progress(results)
    return (plotly_figure(figure, caption, height_px=90 + 190 * panels),)


def _rejections(results: Results) -> tuple[Html, ...]:
    counts = results.counts()
    blocks = []
    rejections = results.rejections()
    if rejections:
        text = (
            f"{counts['infeasible']} proposed designs cannot be built and were not simulated. "
            "A design may break several rules."
        )
        demands = RULES | PRESS_RULES
        rows = [
            {"rule": rule, "text": demands.get(rule, ""), "count": count}
            for rule, count in rejections.items()
        ]
        columns = [Column("rule", "rule"), Column("text", "what it demands"), Column("count", "designs")]
        blocks += [paragraph(text), table(rows, columns)]
    broken = results.frame["violated"].dropna()
    if len(broken):
        rows = [
            {
                "score": score_label(name, results.units.get(name, "")),
                "bound": bound.text(),
                "count": sum(name in names for names in broken),
            }
            for name, bound in results.study.constraints.items()
        ]
        columns = [Column("score", "score"), Column("bound", "must be"), Column("count", "designs break it")]
        text = f"{len(broken)} evaluated designs break a constraint and are left out above."
        blocks += [paragraph(text), table(rows, columns)]
    if failures := results.failures():
        rows = [{"reason": reason, "count": count} for reason, count in failures.items()]
        columns = [Column("reason", "could not be scored because"), Column("count", "designs")]
        blocks.append(table(rows, columns))
    return tuple(blocks)


def _definition(results: Results) -> tuple[Html, ...]:
    study = results.study
    rows = []
    if study.variants:
        rows.append({"path": VARIANT, "values": ", ".join(study.variants)})
    for path, parameter in study.parameters.items():
        values = (
            ", ".join(str(choice) for choice in parameter.choices)
            if parameter.choices is not None
            else f"{parameter.low:g} to {parameter.high:g}"
            + (f" in steps of {parameter.step:g}" if parameter.step is not None else "")
            + (" (logarithmic)" if parameter.log else "")
        )
        only = "" if parameter.variant is None else f" (variant {parameter.variant})"
        rows.append({"path": path + only, "values": f"{values} {unit_of(path)}".strip()})
    settings: Mapping[str, Any] = {
        "starting design": study.base.name,
        "effects of the model": ", ".join(effect["name"] for effect in study.effects),
        "presses of every design": study.presses.text(),
        "fidelity": study.fidelity,
        "seed": study.seed,
        "search method": ", ".join(results.frame["method"].dropna().unique()) or study.sampler,
        "folder": str(results.folder.resolve()),
    }
    columns = [Column("path", "parameter"), Column("values", "searched over")]
    return (facts(settings), table(rows, columns))


def _depict(results: Results, number: int) -> None:
    """Render the untouched gel and one press of an evaluated design, if it has no pictures yet."""
    folder = trial_folder(results.folder, number)
    if any(folder.glob("*.png")):
        return
    from designlab.core.images import tone_map, write_image
    from designlab.simulation.simulator import render

    subject, seed = results.subject(number), results.study.seed
    press = results.study.presses.press("sphere:4", 1.0)
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "design.toml").is_file():  # another machine has evaluated it
        write_atomic(folder / "design.toml", dumps(results.design(number)))
    untouched = render(subject, columns=320, samples=32, seed=seed).mixed
    pressed = render(subject, press, columns=320, samples=32, seed=seed).mixed
    white = float(np.percentile(untouched, 99.9))  # the same for both, so that they can be compared
    write_image(folder / "untouched.png", tone_map(untouched, white))
    write_image(folder / "press.png", tone_map(pressed, white))
