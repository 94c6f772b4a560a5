"""The page about a gap, from the data that its command prints as JSON."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from designlab.core.store import write_atomic
from designlab.inference.diagnosis.selection.criterion import OF_PRESSES
from designlab.report.gap_plots import gap_bars, interval_bar
from designlab.report.gap_text import OF_CLEAN, OF_ONE_PICTURE, USUAL
from designlab.report.page import (
    Column,
    Html,
    Lead,
    Section,
    facts,
    heading,
    label,
    listed,
    page,
    paragraph,
    picture,
    rounded,
    table,
    unbroken,
    word,
)

MOST_PLACES = 12
STANDS_OUT = 1.5  # times the mean of its channel and frames
BARELY = 0.02  # times what every sensor leaves: less beyond is nothing

_KINDS = {"named": "good", "at_floor": "good", "unexplained": "poor"}
_OTHER_KIND = "fair"
_WORDS = {
    "named": "cause named",
    "ambiguous": "two causes or more fit",
    "partial": "partly explained",
    "unexplained": "not explained",
    "at_floor": "no gap",
}
_FRAMES = {"background": "untouched gel", "press": "presses", "dark": "LEDs off"}
_SPLITS = {"train": "fitted to", "select": "chosen by", "final": "final"}
_GAP = (
    "Mean squared residual in units of the noise. Effects were fitted to the first presses and chosen by the "
    "second; the final presses were used for nothing else. The floor is what noise of the camera and the "
    "errors granted to the simulation may leave, usual is what is left where nothing is missing. Bars begin "
    "there."
)
_WHERE = (
    "Shares of the excess over the floor with the model as given. A region stands out where a value "
    "holds well "
    "more of it than one does in the mean of the same channel and frames."
)
_PARAMETERS = (
    "The drawing spans what is usual (band), the value at which the effect does nothing (thin line), and "
    "the hard "
    "bounds where they are near (brackets). Confidence: share of right names among those that looked like it "
    "on generated sets with known answers; of a single picture no such share is known. Values without a unit "
    "are shares or ratios."
)
_CANDIDATES = (
    "Evidence: logarithm of the Bayes factor against the model without the effect, divided by how many "
    f"neighbouring values err alike; {OF_PRESSES.evidence:g} or more is needed, {OF_PRESSES.later:g} beside "
    "other effects. Gain: share of the first gap closed on presses that the candidate was not fitted to. "
    "Values without a unit are shares or ratios."
)


def gap_report(report: Mapping[str, Any], target: str | Path, *, links: Sequence[Html] = ()) -> Path:
    """Write the page about a diagnosis.

    Parameters
    ----------
    report : mapping
        What ``gap diagnose --json`` prints, see ``docs/gap.md``. The pictures that it names must be there.
    target : path
        HTML file to write.
    links : sequence of Html
        Links to the pages that lead here.
    """
    files = {Path(path): caption for path, caption in report["pictures"].items()}
    shown = {path.name: picture(path, caption) for path, caption in files.items()}
    places = shown.pop("where.png", None)
    made = report["provenance"]
    first, *others = report["statement"]
    content = [
        Section("What was found", _effects(report["effects"])),
        Section("In words", tuple(paragraph(_closed(text)) for text in others)),
        Section("Gap before and after", _gap(report["gap"], report["control"])),
        Section("Where the gap is", (*([places] if places else []), *_where(report["where"]))),
        Section("Measured, simulated, left over", tuple(shown.values())),
        Section("What to measure next", _next(report)),
        Section("What this cannot know", _limits(report["limits"], report["overlaps"]), folded=True),
        Section("Every candidate tried", _candidates(report), folded=True),
        Section("Checks of the measurement", _checks(report["checks"]), folded=True),
        Section("Notes", tuple(paragraph(note) for note in report["notes"]), folded=True),
        Section("How it was made", (_made(made, report["model"]),), folded=True),
    ]
    verdict = report["verdict"]
    removed = _removed(report)
    words, command = _what_next(report)
    lead = Lead(
        question="What does the model lack that the sensor has?",
        answer=(paragraph(_closed(first)), *([paragraph(removed)] if removed else [])),
        picture=next(iter(shown.values()), places),
        next_words=words,
        next_command=command,
        word=_WORDS.get(verdict, verdict),
        kind=_KINDS.get(verdict, _OTHER_KIND),
    )
    title, subtitle = "Gap between simulation and measurement", f"measurement {made['measurement']}"
    return write_atomic(target, page(title, content, subtitle=subtitle, lead=lead, links=links))


def _closed(text: str) -> str:
    """The text, with no line break between a figure and its per cent sign."""
    return text.replace(" %", "\u00a0%")


def _removed(report: Mapping[str, Any]) -> str:
    """How far the gap closes on presses, or blocks of a single picture, that decided nothing."""
    final = report["gap"].get("final")
    if not final:
        return ""
    clean = (report.get("unexplained") or {}).get("grain_rms") == 0
    judged, usual = "presses", OF_CLEAN if clean else USUAL
    if "blocks" in report["provenance"]:
        judged, usual = "blocks of the picture", OF_ONE_PICTURE
    before, after = (max(final[name] / final["usual"] - 1, 0.0) for name in ("before", "after"))
    if before < BARELY:
        return f"On the final {judged} no more is left than {usual}."
    return (
        f"On {judged} that decided nothing the excess falls from {_plain(before, 2)} to {_plain(after, 1)}. "
        f"(Excess: squared residual over what is left by {usual}; 0 is no gap.)"
    )


def _plain(value: float, digits: int) -> str:
    """A number with so many significant digits, never as a power of ten."""
    return f"{float(f'{value:.{digits}g}'):.12g}"


def _what_next(report: Mapping[str, Any]) -> tuple[str, str]:
    """What to do after a verdict, and the command that does it."""
    doubtful = report["verdict"] == "partial" and report.get("next_measurement")
    if report["verdict"] in ("named", "partial") and report["effects"] and not doubtful:
        return (
            "Score the sensor as it is, effects included:",
            f"designlab evaluate {report['model']} --out as-it-is",
        )
    if report.get("next_measurement"):
        text = (report.get("next") or {}).get("text") or report["next_measurement"]
        return f"{text[:1].upper()}{text[1:]}.", ""
    if report["verdict"] == "at_floor":
        return "Trust the model for this sensor: design with it.", ""
    return "Look at the pictures of what is left for dirt, marks, a second contact, or another object.", ""


def _where(where: Sequence[Mapping[str, Any]]) -> tuple[Html, ...]:
    if not where:
        return ()
    rows = [
        {
            "region": place["region"],
            "channel": place["channel"],
            "frames": unbroken(_FRAMES.get(place["frames"], place["frames"])),
            "share": round(100 * place["share"], 1),
            "area": round(100 * place["area"], 1),
            "times": _times(place),
            "sign": _sign(place["mean_z"]),
        }
        for place in where[:MOST_PLACES]
    ]
    columns = [
        Column("region", "region"),
        Column("channel", "channel"),
        Column("frames", "frames"),
        Column("share", "of the excess", "%"),
        Column("area", "of the values", "%"),
        *([Column("times", "stands out")] if any(row["times"] for row in rows) else []),
        Column("sign", "measured against simulated"),
    ]
    return (table(rows, columns, caption=_WHERE),)


def _times(place: Mapping[str, Any]) -> str:
    times = place.get("times", 0.0)
    return f"{times:.2g} times" if times >= STANDS_OUT else ""


def _sign(mean_z: float) -> str:
    if abs(mean_z) < 0.5:
        return "brighter here, darker there"
    return f"{'brighter' if mean_z > 0 else 'darker'}, mean {rounded(round(abs(mean_z), 1))} sd"


def _gap(gap: Mapping[str, Mapping[str, float]], control: Mapping[str, Any] | None) -> tuple[Html, ...]:
    if not gap:
        return ()
    rows = [
        {
            **level,
            "frames": f"{_SPLITS.get(name, name)} ({name})" if name != "final" else "final",
            "gone": _gone(level),
        }
        for name, level in gap.items()
    ]
    columns = [
        Column("frames", "presses"),
        Column("before", "before"),
        Column("after", "after"),
        Column("floor", "floor"),
        Column("usual", "usual"),
        Column("gone", "gap gone", "%"),
    ]
    blocks = [gap_bars(gap, _SPLITS), paragraph(_GAP, note=True), table(rows, columns)]
    if control:
        removed = 100 * control["removed"]
        does = (
            f"takes away {removed:.0f} % of the gap"
            if removed >= 0
            else f"widens the gap by {-removed:.0f} %"
        )
        blocks.append(
            paragraph(
                f"Control: a wrong effect of about the same size, `{control['name']}`, fitted in the same "
                f"way, {does} on the final presses."
            )
        )
    return tuple(blocks)


def _gone(level: Mapping[str, float]) -> float | None:
    excess = level["before"] - level["usual"]
    return round(100 * (level["before"] - level["after"]) / excess, 1) if excess > 0 else None


def _effects(effects: Sequence[Mapping[str, Any]]) -> tuple[Html, ...]:
    if not effects:
        return ()
    rows = []
    for effect in effects:
        others = ", ".join(name for name in effect.get("coherence_set", ()) if name != effect["name"])
        for number, (name, p) in enumerate(effect["parameters"].items()):
            first = number == 0
            rows.append(
                {
                    "effect": effect["name"] if first else "",
                    "parameter": label(name, "" if p.get("unit") == "1" else p.get("unit", "")),
                    "value": p["value"],
                    "interval": _interval(p),
                    "bounds": unbroken(f"{p['bounds'][0]:g} to {p['bounds'][1]:g}") if "bounds" in p else "",
                    "drawing": interval_bar(p) if "bounds" in p else "",
                    "confidence": f"{effect['confidence']:.2f}" if first else "",
                    "others": (others or "none") if first else "",
                    "scope": ("the design" if effect.get("transferable", True) else "this unit")
                    if first
                    else "",
                }
            )
    columns = [
        Column("effect", "effect"),
        Column("parameter", "parameter"),
        Column("value", "value"),
        Column("interval", "95 % interval"),
        Column("drawing", ""),
        Column("bounds", "hard bounds"),
        Column("confidence", "confidence"),
        Column("others", "not told apart from"),
        Column("scope", "holds for"),
    ]
    return (table(rows, columns, caption=_PARAMETERS),)


def _interval(p: Mapping[str, Any]) -> Html:
    if p.get("low") is None or p.get("high") is None:
        return unbroken("not known")
    return unbroken(f"{rounded(p['low'])} to {rounded(p['high'])}")


def _next(report: Mapping[str, Any]) -> tuple[Html, ...]:
    if not report.get("next_measurement"):
        return (paragraph("Nothing is missing that would change the verdict."),)
    more = report.get("next") or {}
    text = more.get("text") or report["next_measurement"]
    blocks = [paragraph(f"{text[:1].upper()}{text[1:]}.")]
    found = {}
    if more.get("separation_sd") is not None:
        found["the candidates would differ by"] = (
            f"{more['separation_sd']:.2g} standard deviations (predicted)"
        )
    if more.get("minutes") is not None:
        found["time in the lab"] = f"about {more['minutes']:g} min"
    return (*blocks, facts(found)) if found else tuple(blocks)


def _candidates(report: Mapping[str, Any]) -> tuple[Html, ...]:
    """Every candidate that was tried, round by round, with what became of it."""
    candidates = report.get("candidates", ())
    if not candidates:
        none = "None: simulation and measurement agree to within the floor before any effect is added."
        return (paragraph(none),) if report["verdict"] == "at_floor" else ()
    named = {effect["name"] for effect in report.get("effects", ())}
    columns = [
        Column("name", "candidate"),
        Column("outcome", "outcome"),
        Column("values", "fitted values"),
        Column("evidence", "evidence"),
        Column("gain", "gain", se="se"),
        Column("improved", "presses improved"),
        Column("seconds", "cost", "s"),
    ]
    blocks = [paragraph(_CANDIDATES, note=True)]
    for number in sorted({c["round"] for c in candidates}):
        own = [c for c in candidates if c["round"] == number]
        fitted = [c for c in own if c.get("gain") is not None]
        passed = [c for c in fitted if c["outcome"] == "passed" and c["name"] in named]
        best = max(passed, key=lambda c: c["evidence"])["name"] if passed else ""
        rows = [
            {
                **c,
                "values": _fitted(c),
                "outcome": word("accepted", "good") if c["name"] == best else c["outcome"],
                "improved": f"{100 * c['improved']:.0f} %" if c.get("improved") is not None else None,
            }
            for c in sorted(fitted, key=lambda c: -c["evidence"])
        ]
        blocks.append(heading(f"Round {number}"))
        if rows:
            blocks.append(table(rows, columns))
        screened = sorted(
            (c for c in own if c.get("gain") is None and c.get("evidence") is not None),
            key=lambda c: -c["evidence"],
        )
        if screened:
            listed = ", ".join(f"`{c['name']}` {c['evidence']:.3g}" for c in screened)
            blocks.append(
                paragraph(f"Set aside before fitting, with their evidence by linear approximation: {listed}.")
            )
        blocks += [
            paragraph(f"`{c['name']}`: {c['outcome']}{_amount(c)}.")
            for c in own
            if c.get("gain") is None and c.get("evidence") is None
        ]
    return tuple(blocks)


def _fitted(candidate: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{name.rpartition('.')[2]} {value:.3g}" for name, value in candidate.get("parameters", {}).items()
    )


def _amount(candidate: Mapping[str, Any]) -> str:
    found = _fitted(candidate)
    return f" ({found})" if found else ""


def _checks(checks: Sequence[Mapping[str, Any]]) -> tuple[Html, ...]:
    if not checks:
        return ()
    words = {
        True: "holds",
        False: word("fails", "poor"),
        None: "no frames for it",
    }
    rows = [
        {"name": check["name"], "passed": words[check["passed"]], "figure": check["figure"]}
        for check in checks
    ]
    columns = [
        Column("name", "comparison of frames, without a model"),
        Column("passed", ""),
        Column("figure", "found"),
    ]
    return (table(rows, columns),)


def _limits(limits: Sequence[str], overlaps: Sequence[Mapping[str, Any]]) -> tuple[Html, ...]:
    shown = (listed(limits),) if limits else ()
    if not overlaps:
        return shown
    columns = [
        Column("effect", "what this effect does to these frames"),
        Column("by", "this one can do as well"),
        Column("share", "to"),
    ]
    rows = [{**overlap, "share": f"{100 * overlap['share']:.1f} %"} for overlap in overlaps]
    return (*shown, table(rows, columns))


def _made(made: Mapping[str, Any], model: str) -> Html:
    frames = {use: len(files) for use, files in made.get("frames", {}).items() if files}
    return facts(
        {
            "updated model": model,
            "frames": ", ".join(f"{number} {use}" for use, number in frames.items()),
            "noise": made.get("noise", ""),
            "floor": made.get("floor", ""),
            "pictures rendered": made.get("rendered", ""),
            "samples per pixel": made.get("samples", ""),
            "time": f"{made['seconds']:g} s" if "seconds" in made else "",
            "model as given": made["model"][:16] if made.get("model") else "",
            "seed": made.get("seed", ""),
        }
    )
