"""The page about a gap, from the data that its command prints as JSON."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from designlab.report.page import (
    Column,
    Html,
    Section,
    facts,
    label,
    page,
    paragraph,
    picture,
    table,
)
from designlab.store import write_atomic


def gap_report(
    report: Mapping[str, Any],
    target: str | Path,
    *,
    title: str = "Gap between simulation and measurement",
    pictures: Mapping[Path, str] | None = None,
    sections: Sequence[Section] = (),
) -> Path:
    """Write the page about a diagnosis.

    Parameters
    ----------
    report : mapping
        What ``gap diagnose --json`` prints: ``verdict``, ``effects``, ``where``, ``gap``,
        ``next_measurement``, ``model``.
    target : path
        HTML file to write.
    title : str
        Heading.
    pictures : mapping of path to str, optional
        Picture files and their captions.
    sections : sequence of Section
        Further sections, placed last.
    """
    effects = [
        {
            "effect": effect["name"],
            "parameter": label(name, parameter.get("unit", "")),
            **parameter,
            "confidence": effect.get("confidence"),
            "others": ", ".join(
                other for other in effect.get("coherence_set", ()) if other != effect["name"]
            ),
        }
        for effect in report.get("effects", ())
        for name, parameter in effect["parameters"].items()
    ]
    effect_columns = [
        Column("effect", "effect"),
        Column("parameter", "parameter"),
        Column("value", "value"),
        Column("low", "95 % from"),
        Column("high", "to"),
        Column("confidence", "confidence"),
        Column("others", "not told apart from"),
    ]
    splits = [{"frames": name, **values} for name, values in report.get("gap", {}).items()]
    split_columns = [
        Column("frames", "frames"),
        Column("before", "before"),
        Column("after", "after"),
        Column("floor", "noise floor"),
    ]
    where = list(report.get("where", ()))
    where_columns = [Column(name, name) for name in ("region", "channel", "frames", "share")]
    verdict: list[Html] = [paragraph(_VERDICTS.get(report["verdict"], report["verdict"]))]
    if report.get("next_measurement"):
        verdict.append(paragraph(f"Measure next: {report['next_measurement']}"))
    if report.get("model"):
        verdict.append(facts({"updated model": report["model"]}))
    content = [
        Section("Verdict", tuple(verdict)),
        Section("Effects", (table(effects, effect_columns, caption=_CONFIDENCE),) if effects else ()),
        Section("Gap", (table(splits, split_columns, caption=_GAP),) if splits else ()),
        Section("Where", (table(where, where_columns, caption=_WHERE),) if where else ()),
        Section("Pictures", tuple(picture(path, caption) for path, caption in (pictures or {}).items())),
        Section("Candidates", (_candidates(report["candidates"]),) if report.get("candidates") else ()),
        Section("Notes", tuple(paragraph(note) for note in report.get("notes", ()))),
        *sections,
    ]
    return write_atomic(target, page(title, content))


def _candidates(candidates: Sequence[Mapping[str, Any]]) -> Html:
    """Every candidate that was tried, rejected ones too."""
    columns = [
        Column("round", "round"),
        Column("name", "candidate"),
        Column("outcome", "outcome"),
        Column("evidence", "evidence"),
        Column("gain", "share of the gap closed on held-out presses", se="se"),
        Column("improved", "share of them improved"),
    ]
    return table(candidates, columns, caption=_CANDIDATES)


_CONFIDENCE = (
    "Confidence: share of the effect in the evidence of those that do as well, limited by the number of "
    "held-out presses; not calibrated."
)
_CANDIDATES = (
    "Evidence: logarithm of the Bayes factor against the model without the effect, divided by how many "
    "neighbouring values err alike; ten or more is needed."
)
_GAP = "Mean squared residual in units of the noise; the final frames were used for nothing else."
_WHERE = "Shares of the excess over noise and granted errors, before the update."
_VERDICTS = {
    "named": "The gap is explained by the effects below.",
    "ambiguous": "Several effects explain the gap equally well on these frames.",
    "partial": "The effects below explain part of the gap; the rest is above the noise.",
    "unexplained": "No known effect explains the gap.",
    "at_floor": "Simulation and measurement agree to within the noise.",
}
