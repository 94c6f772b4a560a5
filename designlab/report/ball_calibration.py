"""The page about a calibration on balls: how good shapes will be, and which balls fit worst."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from designlab.core.images import tone_map
from designlab.core.store import write_atomic
from designlab.inference.calibration.balls import BallCalibration
from designlab.reconstruction.ball_view import touched_px
from designlab.report.calibration import KINDS, sentence
from designlab.report.figures import new_figure, write_figure
from designlab.report.page import Column, Html, Lead, Section, facts, listed, page, paragraph, picture, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURE = "balls.png"
MOST_SHOWN = 4  # balls that fit worst


def ball_calibration_report(found: BallCalibration, folder: Path, target: Path, *, calibration: str) -> Path:
    """Write the page about a calibration on balls.

    Parameters
    ----------
    found : BallCalibration
        The calibration.
    folder : Path
        Where its picture is written.
    target : Path
        HTML file to write.
    calibration : str
        File of the calibration, for the next command.
    """
    shown = write_figure(balls_picture(found), folder / PICTURE)
    verdict, odd = found.verdict(), found.odd()
    rows = [
        {
            "file": file,
            "normal": one.contact_deg,
            "height": 1000 * one.height_mm,
            "radius": ball.contact_radius_px,
            "why": next((why for name, _, why in odd if name == file), ""),
        }
        for file, ball, one in zip(found.balls.files, found.balls.balls, found.errors, strict=True)
    ]
    rows.sort(key=lambda row: -float(str(row["normal"])))
    columns = [
        Column("file", "ball left out"),
        Column("normal", "normal error", "deg"),
        Column("height", "height error", "µm"),
        Column("radius", "circle", "px"),
        Column("why", "fits badly: likely reason"),
    ]
    sections = [
        Section("Why", (listed(map(sentence, verdict.reasons)),) if verdict.reasons else ()),
        Section("Ball by ball", (table(rows, columns, caption="Each by a calibration on the others."),)),
        Section("What was fitted", (_fitted(found),)),
    ]
    mean = found.mean
    lead = Lead(
        question="How well will this sensor's pictures become shapes?",
        answer=tuple(
            map(
                paragraph,
                (
                    f"On balls left out in turn, normals are off by {mean.contact_deg:.1f} deg and "
                    f"heights by {1000 * mean.height_mm:.0f} µm, in the mean of {len(found.errors)} balls.",
                    sentence(verdict.reasons[0])
                    if verdict.reasons
                    else "Nothing speaks against the calibration.",
                ),
            )
        ),
        picture=picture(shown, "The balls that fit worst: picture, and the circle that was used"),
        next_words="Turn pictures into shapes:",
        next_command=f"designlab reconstruct PICTURES --calibration {calibration} --out shapes",
        word=verdict.word,
        kind=KINDS[verdict.word],
    )
    return write_atomic(target, page("Calibration on balls", sections, lead=lead))


def balls_picture(found: BallCalibration) -> "Figure":
    """Draw the balls that fit worst, with their circles."""
    order = np.argsort([-one.contact_deg for one in found.errors])[:MOST_SHOWN]
    figure = new_figure(7.4, 6.4)
    panels = figure.subplots(2, 2).ravel()
    for axes in panels[len(order) :]:
        axes.set_visible(False)
    turn = np.linspace(0, 2 * np.pi, 181)
    for axes, number in zip(panels, order, strict=False):
        ball, one = found.balls.balls[number], found.errors[number]
        axes.imshow(tone_map(np.asarray(ball.image)[..., :3]))
        column, row = touched_px(ball, found.kept.calibration.setup, found.balls.membrane)
        axes.plot(
            column + ball.contact_radius_px * np.cos(turn),
            row + ball.contact_radius_px * np.sin(turn),
            color="w",
            linewidth=1.2,
        )
        axes.set_title(f"{found.balls.files[number]}: {one.contact_deg:.1f} deg", fontsize=9)
        axes.set_xticks([])
        axes.set_yticks([])
    return figure


def _fitted(found: BallCalibration) -> Html:
    told = {
        "balls": found.balls.notes[0] if found.balls.notes else str(len(found.errors)),
        "size of a pixel": f"{found.balls.mm_per_px:g} mm",
    }
    if found.gel is not None:
        for name, unit, scale, fitted in (
            ("thickness of the gel", "mm", 1, found.gel.thickness_mm),
            ("circles are larger than the contact by", "%", 100, found.gel.label_bias),
        ):
            value, low, high = (scale * number for number in (fitted.value, fitted.low, fitted.high))
            known = "as stated" if low == high else f"95 % interval {low:.3g} to {high:.3g} {unit}"
            told[name] = f"{value:.3g} {unit}, {known}"
    return facts(told)
