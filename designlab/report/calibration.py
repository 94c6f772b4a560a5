"""The page about a calibration: does the model now give the sensor's pictures, and what was found."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from designlab.core.store import write_atomic
from designlab.inference.calibration.result import Calibration, FrameResult
from designlab.inference.calibration.verdict import FitVerdict
from designlab.report.page import (
    Column,
    Html,
    Lead,
    Section,
    counted,
    listed,
    page,
    paragraph,
    picture,
    table,
)

FIGURES = {
    "snr_db": ("SNR", "dB"),
    "structure_corr": ("structure correlation", ""),
    "structure_snr_db": ("structure SNR", "dB"),
}
KINDS = {"good": "good", "doubtful": "fair", "failed": "poor"}


def calibration_report(
    found: Calibration, verdict: FitVerdict, target: Path, *, design: str, residual: Path
) -> Path:
    """Write the page about a calibration.

    Parameters
    ----------
    found : Calibration
        What was fitted.
    verdict : FitVerdict
        Whether it is worth using.
    target : Path
        HTML file to write.
    design : str
        File of the calibrated design, for the next command.
    residual : Path
        Picture of measured, simulated, and what is left.
    """
    sections = [
        Section("Why", (listed(map(sentence, verdict.reasons)),) if verdict.reasons else ()),
        Section("What was fitted", (_parameters(found),)),
        Section("Picture by picture", (_frames(found),)),
        Section("Notes", (listed(found.notes),) if found.notes else (), folded=True),
    ]
    return write_atomic(target, page("Calibration", sections, lead=_lead(found, verdict, design, residual)))


def _lead(found: Calibration, verdict: FitVerdict, design: str, residual: Path) -> Lead:
    shown, what = _judges(found.frames)
    before, after = (_mean(shown, when, "structure_corr") for when in ("before", "after"))
    ratios = [_mean(shown, when, "snr_db") for when in ("before", "after")]
    answer = (
        f"On {what} the structure correlation goes from {before:.2f} to {after:.2f} and the SNR from "
        f"{ratios[0]:.1f} to {ratios[1]:.1f} dB.",
        sentence(verdict.reasons[0]) if verdict.reasons else "Nothing speaks against the fit.",
    )
    good = verdict.word == "good"
    return Lead(
        question="Does the model now give this sensor's pictures?",
        answer=tuple(map(paragraph, answer)),
        picture=picture(residual, "Measured, calibrated, and what is left between them"),
        next_words="Ask what the model still lacks:" if good else "Look at the reasons, then fit again:",
        next_command=f"designlab gap diagnose MEASUREMENT --model {design} --out diagnosis"
        if good
        else "designlab calibrate MEASUREMENT --model DESIGN --out calibrated",
        word=verdict.word,
        kind=KINDS[verdict.word],
    )


def sentence(reason: str) -> str:
    """A reason as a sentence."""
    return reason[:1].upper() + reason[1:] + ("" if reason.endswith("?") else ".")


def _judges(frames: tuple[FrameResult, ...]) -> tuple[list[FrameResult], str]:
    """Pictures that say most about a fit: held-out presses, else presses, else all; and how many they are."""
    presses = [frame for frame in frames if frame.pose is not None]
    held_out = [frame for frame in presses if frame.held_out]
    if held_out:
        return held_out, counted(len(held_out), "held-out frame")
    if presses:
        return presses, counted(len(presses), "fitted press frame")
    return list(frames), counted(len(frames), "fitted frame")


def _mean(frames: list[FrameResult], when: str, name: str) -> float:
    return float(np.mean([getattr(frame, when)[name] for frame in frames]))


def _parameters(found: Calibration) -> Html:
    rows = [vars(parameter) for parameter in found.parameters]
    columns = [Column("name", "parameter"), Column("value", "value", se="se"), Column("unit", "unit")]
    return table(
        [row | {"unit": "" if row["unit"] == "1" else row["unit"]} for row in rows],
        columns,
        caption="Standard errors after ±; none where a value stands at zero or nothing shows it.",
    )


def _frames(found: Calibration) -> Html:
    rows: list[Mapping[str, Any]] = [
        {"file": frame.file, "use": "held out" if frame.held_out else "fitted"}
        | {f"{name}-{when}": getattr(frame, when)[name] for name in FIGURES for when in ("before", "after")}
        for frame in found.frames
    ]
    columns = [Column("file", "picture"), Column("use", "use")]
    columns += [
        Column(f"{name}-{when}", f"{title}, {when}", unit)
        for name, (title, unit) in FIGURES.items()
        for when in ("before", "after")
    ]
    return table(rows, columns, caption="Of held-out pictures the pose alone was fitted.")
