"""The page about an evaluation: a verdict first, then maps, all figures, rules and time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from designlab.core.store import write_atomic
from designlab.evaluation.press_plan import PressPlan
from designlab.report.page import (
    Column,
    Html,
    Lead,
    Section,
    facts,
    gallery,
    page,
    pair,
    paragraph,
    picture,
    rounded,
    table,
    under,
    word,
)
from designlab.report.yardsticks import judged, row, summary, worst_place
from designlab.sensor.feasibility import RULES

_MAPS = {
    "background.png": "What the camera sees of the untouched gel, brightened to its own white",
    "information.png": "Information limit: least tilt of a flat membrane that camera noise alone makes up; "
    "the ring marks the worst place; grey is saturated or out of view",
    "errors.png": "Errors of normals and heights over all test presses, on and around the contact; the ring "
    "marks the worst place",
    "uniformity.png": "Light of each LED group on the untouched gel, relative to its mean",
}


DRAWING = "sensor.png"
"""File of the drawing of the sensor, shown where it stands beside the page."""

_CAPTIONS = _MAPS | {
    "relief.png": "The press that it feels worst: picture, the surface found from it, and a profile"
}


def evaluation_report(
    score: Mapping[str, Any],
    target: str | Path,
    *,
    pictures: Mapping[Path, str] | None = None,
    links: Sequence[Html] = (),
) -> Path:
    """Write the page about one evaluation.

    Parameters
    ----------
    score : mapping
        What ``Score.to_json`` gives: ``design``, ``fidelity``, ``seed``, ``press_plan``, ``scores``,
        ``groups``, ``worst``, ``margins``, ``light``, ``seconds``.
    target : path
        HTML file to write.
    pictures : mapping of path to str, optional
        Picture files and their captions; those that `evaluate` left beside the target when absent.
    links : sequence of Html
        Links to the pages that lead here.
    """
    if pictures is None:
        pictures = {path: path.stem.replace("-", " ") for path in sorted(Path(target).parent.glob("*.png"))}
    drawing, felt = ([path for path in pictures if path.name == name] for name in (DRAWING, "relief.png"))
    pictures = {path: caption for path, caption in pictures.items() if path not in [*drawing, *felt]}
    worst = score.get("worst", {})
    depths_mm = score.get("presses", {}).get("depth_mm", ())
    rows = judged(score["scores"], depths_mm)
    worst_press = worst.get("press", {}).get("press")
    places = tuple(paragraph(worst_place(kind, place)) for kind, place in worst.items())
    sections = [
        Section("Main scores", (_verdict_table(rows),) if rows else ()),
        Section("Where it is worst", (*places, *_maps(pictures))),
        Section("The sensor", tuple(picture(path, "The sensor, cut open") for path in drawing)),
        Section("Test presses", _presses(pictures, worst_press), folded=True),
        Section(
            "All scores",
            (_scores(score["scores"], depths_mm), *_groups(score.get("groups", {})), _settings(score)),
            folded=True,
        ),
        Section("Rules", (_margins(score["margins"]),) if score.get("margins") else (), folded=True),
        Section("Time", (_seconds(score["seconds"]),) if score.get("seconds") else (), folded=True),
    ]
    about = [score.get("made_from", ""), score.get("not_buildable", "")]
    about.append(f"fidelity {score.get('fidelity', '')}, seed {score.get('seed', '')}")
    lead = _lead(score, rows, felt or [p for p in pictures if p.name == "background.png"])
    text = page(
        f"Design: {score['design']}",
        sections,
        subtitle="; ".join(filter(None, about)),
        lead=lead,
        links=links,
    )
    return write_atomic(target, text)


def _lead(score: Mapping[str, Any], rows: list[dict[str, Any]], shown: Sequence[Path]) -> Lead | None:
    """How well the sensor feels, in two sentences, with the press that it reconstructs worst."""
    if not rows:
        return None
    told = {
        name: f"{words} {rounded(each['value'], each['se'])} {unit}"
        for name, words, unit in (
            ("normal_error_mean_deg", "surface normals are off by", "deg in the mean"),
            ("height_rmse_um", "heights by", "µm RMS"),
        )
        if (each := score["scores"].get(name)) is not None
    }
    errors = ", ".join(told.values())
    answer = (
        f"{errors[:1].upper()}{errors[1:]}, on presses that the calibration has not seen." if errors else ""
    )
    verdicts = {entry["verdict"].partition(",")[0] for entry in rows}
    kind = next((each for each in ("poor", "fair") if each in verdicts), "good")
    return Lead(
        question="How well would this sensor feel?",
        answer=tuple(paragraph(text) for text in (answer, summary(rows)) if text),
        picture=picture(shown[0], _CAPTIONS[shown[0].name]) if shown else None,
        next_words="Change a figure of the design, and see in which scores it differs:",
        next_command="designlab evaluate design.toml changed.toml --compare --out compared",
        word={"good": "good", "fair": "fair", "poor": "weak somewhere"}[kind],
        kind=kind,
    )


def _verdict_table(rows: list[dict[str, Any]]) -> Html:
    shown = [
        {
            **entry,
            "what": under(entry["title"], entry["meaning"]),
            "word": _coloured(entry["verdict"]),
            "why": under("", entry["limits"]),
        }
        for entry in rows
    ]
    columns = [
        Column("what", "score"),
        Column("value", "value", se="se"),
        Column("word", "verdict"),
        Column("why", "yardstick"),
    ]
    return table(shown, columns)


def _coloured(verdict: str) -> Html:
    return word(verdict, verdict.partition(",")[0])


def _maps(pictures: Mapping[Path, str]) -> tuple[Html, ...]:
    named = {path.name: path for path in pictures}
    blocks = []
    beside = [picture(named[n], _MAPS[n]) for n in ("background.png", "information.png") if n in named]
    blocks += [pair(*beside)] if len(beside) > 1 else beside
    blocks += [picture(named[n], _MAPS[n]) for n in ("errors.png", "uniformity.png") if n in named]
    return tuple(blocks)


def _presses(pictures: Mapping[Path, str], worst: int | None) -> tuple[Html, ...]:
    """The press with the worst place large, the others small."""
    others = {path: caption for path, caption in pictures.items() if path.name not in _MAPS}
    prefix = "" if worst is None else f"press-{worst + 1:02d}-"
    large = [p for p in others if prefix and p.name.startswith(prefix)]
    blocks = [picture(p, f"{others[p]}: the press with the worst place") for p in large]
    small = [picture(p, caption) for p, caption in others.items() if p not in large]
    return (*blocks, gallery(small)) if small else tuple(blocks)


def _scores(scores: Mapping[str, Mapping[str, Any]], depths_mm: Sequence[float]) -> Html:
    rows = [row(name, estimate, depths_mm) for name, estimate in scores.items()]
    for entry in rows:
        entry["word"] = _coloured(entry["verdict"])
    columns = [
        Column("score", "score"),
        Column("value", "value", se="se"),
        Column("word", "verdict"),
        Column("meaning", "meaning"),
    ]
    if any(entry.get("bias_bound") is not None for entry in rows):
        columns.insert(2, Column("bias_bound", "bias at most"))
    return table(rows, columns, caption="The values after ± are standard errors.")


def _groups(groups: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> list[Html]:
    """Figures of each LED group, one row a group."""
    if not groups:
        return []
    figures = next(iter(groups.values()))
    rows = [
        {"group": name}
        | {f: e["value"] for f, e in found.items()}
        | {f"{f}_se": e["se"] for f, e in found.items()}
        for name, found in groups.items()
    ]
    titles = {
        "u0": "U0",
        "cv": "variation",
        "min_max": "least / greatest",
        "nine_point": "nine points",
        "gradient": "gradient",
        "slant_deg": "slant",
        "shadow_share_30deg": "shadows on 30 deg",
    }
    columns = [Column("group", "LED group")]
    columns += [Column(f, titles.get(f, f), e["unit"], se=f"{f}_se") for f, e in figures.items()]
    return [table(rows, columns)]


def _settings(score: Mapping[str, Any]) -> Html:
    settings = {"fidelity": score.get("fidelity", ""), "seed": score.get("seed", "")}
    if plan := score.get("press_plan"):
        settings["presses"] = PressPlan.model_validate(plan).text()
    if light := score.get("light"):
        settings |= {
            "light on the untouched gel": f"random error {light['noise']:.1%} of each mm2",
            "bias of the light": f"{light['bias_mean']:.1%} of the mean, {light['bias_block']:.0%} of 8 x 8 "
            "pixels of 160 columns: the largest of random designs"
            if light["bias_block"]
            else "none",
        }
    return facts(settings)


def _margins(margins: Mapping[str, float]) -> Html:
    rows = [
        {
            "rule": rule,
            "text": RULES.get(rule, ""),
            "slack": -margin,
            "kept": "broken" if margin > 0 else "kept",
        }
        for rule, margin in sorted(margins.items(), key=lambda item: -item[1])
    ]
    columns = [
        Column("rule", "rule"),
        Column("text", "what it demands"),
        Column("slack", "room left", "mm"),
        Column("kept", ""),
    ]
    return table(rows, columns)


def _seconds(seconds: Mapping[str, float] | float) -> Html:
    if not isinstance(seconds, Mapping):
        seconds = {"evaluation": seconds}
    rows = [{"part": part, "time": value} for part, value in seconds.items()]
    return table(rows, [Column("part", "part"), Column("time", "time", "s")])
