"""The page that a demo ends with."""

from collections.abc import Mapping
from operator import attrgetter
from pathlib import Path
from typing import Any

from designlab.report.page import (
    Column,
    Html,
    Lead,
    Section,
    counted,
    facts,
    page,
    paragraph,
    picture,
    rounded,
    table,
)
from designlab.report.yardsticks import score_label
from designlab.sensor.design import Design


def index_page(out: Path, design: Design, seed: int, found: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the page about all stages of a demo.

    Parameters
    ----------
    out : Path
        Folder of the demo; links are relative to it.
    design : Design
        The sensor.
    seed : int
        Seed of the demo.
    found : mapping
        What each stage has found.
    """

    def link(path: Path) -> Html:
        relative = path.relative_to(out).as_posix()
        return Html(f'<a href="{relative}">{relative}</a>')

    score, parts, study, gap, real = (found[name] for name in ("evaluation", "parts", "study", "gap", "real"))
    scores = [{"score": score_label(name, e["unit"]), **e} for name, e in score["scores"].items()]
    start: dict[str, Any] = {"trial": None, "pick": "the design as it is"}
    for path in ("leds.height_mm", "leds.pitch_mm"):
        start[path] = attrgetter(path)(design)
    for name in ("uniformity_u0", "normal_error_median_deg"):
        start |= {name: score["scores"][name]["value"], f"{name}_se": score["scores"][name]["se"]}
    chosen = [
        Column("trial", "trial"),
        Column("pick", "why"),
        Column("leds.height_mm", "LED height", "mm"),
        Column("leds.pitch_mm", "LED spacing", "mm"),
        Column("uniformity_u0", "uniformity U0", se="uniformity_u0_se"),
        Column("normal_error_median_deg", "normal error", "deg", se="normal_error_median_deg_se"),
    ]
    compared = [
        {"figure": figure, "value": real.get(figure)}
        for figure in ("mse", "snr_db", "ssim", "structure_corr")
    ]
    sections = [
        Section(
            "The sensor and its scores",
            (
                table(scores, [Column("score", "score"), Column("value", "value", se="se")]),
                *(picture(path, caption) for path, caption in _examples(out / "evaluation").items()),
                facts({"more": link(out / "evaluation" / "report.html")}),
            ),
        ),
        Section(
            "Files to make it",
            (
                paragraph(
                    f"{len(parts['files'])} files for {', '.join(parts['parts'])}; {parts['checks']} checks."
                ),
                *(paragraph(warning, note=True) for warning in parts["warnings"]),
                facts(
                    {
                        "what each is for": link(out / "parts" / "README.txt"),
                        "assembly": link(out / "parts" / "assembly.step"),
                    }
                ),
            ),
        ),
        Section(
            "Better places for the LEDs",
            (
                paragraph(f"{study['trials']['complete']} designs were evaluated. The shortlist:"),
                table([start, *study["picks"]], chosen),
                facts({"more": link(out / "study" / "report.html")}),
            ),
        ),
        Section(
            "An effect that the model did not know",
            (*_hidden(gap), facts({"more": link(out / "diagnosis" / "report.html")})),
        ),
        Section(
            "Against a real picture",
            (paragraph(real["left_out"]),)
            if "left_out" in real
            else (
                paragraph("Published values, nothing fitted: simulated left, measured right."),
                *(picture(p, p.stem) for p in sorted((out / "real").glob("*.png"))),
                table(compared, [Column("figure", "figure"), Column("value", "value")]),
            ),
        ),
    ]
    picked = parts["picture"] or next(iter(_examples(out / "evaluation")), None)
    lead = Lead(
        question="What does designlab tell of a sensor before and after it is built?",
        answer=tuple(map(paragraph, _answers(score, study, gap))),
        picture=picture(picked, f"The sensor {design.name}") if picked else None,
        next_words="Begin a sensor of your own:",
        next_command="designlab init my-sensor",
    )
    return page("designlab demo", sections, subtitle=f"{design.name}, seed {seed}", lead=lead)


def _answers(score: Mapping[str, Any], study: Mapping[str, Any], gap: Mapping[str, Any]) -> list[str]:
    """What the stages found, a sentence each."""
    normals, heights = (score["scores"][name] for name in ("normal_error_mean_deg", "height_rmse_um"))
    named = ", ".join(effect["name"] for effect in gap["effects"]) or "no effect"
    hidden = ", ".join(gap["hidden"])
    return [
        f"Before: normals are off by {rounded(normals['value'], normals['se'])} deg in the mean, heights by "
        f"{rounded(heights['value'], heights['se'])} µm RMS, on presses that the calibration has not seen.",
        f"Better: a search evaluated {counted(study['trials']['complete'], 'design')}. Files to make the "
        "sensor are written and checked.",
        f"After: {hidden} was hidden in a generated measurement; the diagnosis named {named}.",
    ]


def _examples(folder: Path) -> dict[Path, str]:
    """Pictures of an evaluation that show most, and what they show."""
    captions = {
        "uniformity.png": "Light of each LED group on the untouched gel, relative to its mean",
        "press-03-star.png": "A press the calibration has not seen: picture, normals, height, and the truth",
    }
    return {folder / name: text for name, text in captions.items() if (folder / name).is_file()}


def _hidden(gap: Mapping[str, Any]) -> tuple[Any, ...]:
    """What was hidden in the generated measurement, and what the diagnosis says."""
    found = {effect["name"]: effect["parameters"] for effect in gap["effects"]}
    rows = []
    for effect, values in gap["hidden"].items():
        for name, value in values.items():
            estimate = found.get(effect, {}).get(name, {})
            rows.append({"parameter": f"{effect}.{name}", "hidden": value, **estimate})
    columns = [
        Column("parameter", "parameter"),
        Column("hidden", "hidden"),
        Column("value", "found"),
        Column("low", "95 % from"),
        Column("high", "to"),
        Column("unit", "unit"),
    ]
    final = gap["gap"]["final"]
    text = (
        "A measurement was generated by an independent program whose camera channels see LEDs of other "
        "colours too. Verdict of the "
        f"diagnosis: {gap['verdict']}. It tried six effects here and tries its whole catalogue otherwise. On "
        "presses that decided nothing, the squared residual falls from "
        f"{final['before']:.3g} to {final['after']:.3g} times the noise (floor {final['floor']:.3g}). "
        "Values without a unit are shares of light."
    )
    return paragraph(text), table(rows, columns)
