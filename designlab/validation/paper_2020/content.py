"""What the pages about a reproduction say, without regard to how they are written."""

from pathlib import Path
from typing import Any, NamedTuple

from designlab.report.page import Column
from designlab.validation.paper_2020 import comparison as paper
from designlab.validation.paper_2020 import tables
from designlab.validation.paper_2020.comparison import each, percent, short


class Text(NamedTuple):
    """A paragraph; text between backquotes is code."""

    text: str
    note: bool = False


class Table(NamedTuple):
    """Rows by key, and the columns to show."""

    rows: list[dict[str, Any]]
    columns: list[Column]
    caption: str = ""


class Illustration(NamedTuple):
    """A picture file and what it shows."""

    path: Path
    caption: str


class Chapter(NamedTuple):
    """A heading and what stands below it."""

    title: str
    blocks: list[Text | Table | Illustration]


def sections(result: dict[str, Any], out: Path) -> list[Chapter]:
    """Everything there is to say about a result.

    Parameters
    ----------
    result : dict
        ``size``, ``seed`` and ``stages``, as `reproduce` writes them.
    out : Path
        Folder of the reproduction, in which the pictures lie.
    """
    stages = result["stages"]
    return [
        Chapter("In short", _short(result)),
        Chapter("The paper's figures beside ours", _beside(stages)),
        Chapter("Accuracy on presses that were not fitted", _accuracy(stages["accuracy"], out)),
        Chapter("Where directional light fails", _failures(stages["accuracy"])),
        Chapter("How well hidden sensors are found", _recovery(stages["recovery"])),
        Chapter("The light probe", _probe(stages["probe"], out)),
        Chapter("Time", _timing(stages["timing"])),
        Chapter("The real picture", _real(stages["real"], out)),
        Chapter("To run it again", _again(result)),
    ]


def _short(result: dict[str, Any]) -> list[Text | Table | Illustration]:
    accuracy, covered = result["stages"]["accuracy"], result["stages"]["recovery"]["covered"]
    blocks: list[Text | Table | Illustration] = [
        Text(
            "A. Agarwal, T. Man and W. Yuan (arXiv 2012.13184) simulate a GelSight sensor by tracing "
            "light, fit its light and reflectance to photographs, and compare with two models of "
            "directional light. Here the same experiments run on made sensors, whose truth is known: light "
            "powers, reflectances, colour mixing, contact and floor of a hidden sensor differ from the "
            "stated design, its pictures have camera noise, and its presses are off by their stated doubt. "
            "Each model is fitted to the same two presses and background, and judged on all others."
        )
    ]
    if result["size"] != "full":
        blocks.append(
            Text(
                "This is the reduced size: few presses and coarse pictures show that everything runs. "
                "Quote the figures of the full size.",
                note=True,
            )
        )
    for sensor, found in accuracy["sensors"].items():
        blocks.append(Text(tables.headline(sensor, found)))
    blocks.append(
        Text(
            f"Of {covered['count']} stated 95 % intervals, {percent(covered['share'])} hold the truth "
            f"(hidden sensors: {result['stages']['recovery']['repeats']})."
        )
    )
    return blocks


def _beside(stages: dict[str, Any]) -> list[Text | Table | Illustration]:
    rows = [row._asdict() for row in paper.comparison(stages)]
    columns = [
        Column("name", "figure"),
        Column("paper", "paper"),
        Column("ours", "ours"),
        Column("target", "our target"),
        Column("met", "met"),
        Column("why", "why they differ"),
    ]
    return [
        Text(
            "Ours are made pictures with stated noise; the paper's are photographs, with everything that "
            "no model knows of. Where a figure of ours is better, that is in part for this reason. What "
            "can be compared is how models differ on the same pictures, and whether stated errors are "
            "right."
        ),
        Text(constant_text(stages["real"])),
        Table(rows, columns, f"The paper's figures are from {paper.SOURCE}."),
    ]


def constant_text(real: dict[str, Any]) -> str:
    """Why SNR and SSIM alone say little, with the figures of the real picture where there are any."""
    text = (
        "A picture that is one constant colour already scores high on SNR and SSIM, because most of a "
        "tactile picture is smooth background. "
    )
    if "frames" in real:
        frame = real["frames"][0]
        constant, after = frame["constant"], frame["after"]
        text += (
            f"On the one public real picture a constant has an SNR of {constant['snr_db']:.1f} dB and an "
            f"SSIM of {constant['ssim']:.2f}; the paper's means over its 64 pictures are {paper.SNR_DB} dB "
            f"and {paper.SSIM:.2f}; the calibrated design has {after['snr_db']:.1f} dB and "
            f"{after['ssim']:.2f} there. "
        )
    return text + (
        "So the structure measures stand beside them: the same comparison after a quadratic field of each "
        "channel is removed from both pictures, which leaves what a press does."
    )


def _accuracy(accuracy: dict[str, Any], out: Path) -> list[Text | Table | Illustration]:
    blocks: list[Text | Table | Illustration] = [
        Text(
            "Data set 1 has ball, triangle and star at several places and two depths; data set 2 has balls "
            "and triangles at places and depths of their own. All models are fitted to one ball and one "
            "triangle. Of every other press nothing but its pose is fitted, by light transport; the others "
            "are compared at that pose, since directional light would bend poses to make up for light that "
            "falls off."
        ),
        Table(
            tables.accuracy(accuracy, channels=False),
            [*tables.MODEL_COLUMNS, *tables.FIGURE_COLUMNS],
            "Means over frames that were not fitted, all channels together.",
        ),
        Table(
            tables.margins(accuracy),
            tables.margin_columns(accuracy),
            "Light transport over directional light, in dB; positive: light transport is better. "
            "SNR, and SNR of the structure.",
        ),
    ]
    for sensor, found in accuracy["sensors"].items():
        for name, path in found.get("pictures", {}).items():
            place = out / "accuracy" / path
            if place.is_file():
                blocks.append(
                    Illustration(place, f"{short(sensor)} gel: {name} of the models on a press not fitted")
                )
    blocks.append(
        Table(
            tables.accuracy(accuracy, channels=True),
            [*tables.MODEL_COLUMNS, Column("channel", "channel"), *tables.FIGURE_COLUMNS],
            "The same for each channel.",
        )
    )
    return blocks


def _failures(accuracy: dict[str, Any]) -> list[Text | Table | Illustration]:
    blocks: list[Text | Table | Illustration] = [
        Text(
            "The squared error of every picture is split: a smooth (quadratic) field, which is light that "
            "falls off from the LEDs otherwise than modelled; what is left on steep parts of the membrane, "
            "the edges of contacts; and the rest, mostly cast shadows and light from wall to wall."
        )
    ]
    blocks += [Text(text) for text in tables.failures(accuracy)]
    blocks.append(
        Table(
            tables.error_shares(accuracy),
            [
                *tables.MODEL_COLUMNS[::2],
                Column("mse", "MSE"),
                Column("smooth", "smooth", "%"),
                Column("edges", "edges", "%"),
                Column("rest", "rest", "%"),
            ],
            "Shares of the squared error, means over frames that were not fitted.",
        )
    )
    shares = {
        sensor: each(
            {c: percent(v) for c, v in found["interreflected_share"].items()}, names=lambda name: name
        )
        for sensor, found in accuracy["sensors"].items()
        if found.get("interreflected_share")
    }
    for sensor, text in shares.items():
        blocks.append(
            Text(
                f"{short(sensor).capitalize()} gel: share of the untouched gel's light that met the "
                "membrane or the parts around it more than once, which directional light has no place for: "
                f"{text}."
            )
        )
    return blocks


def _recovery(recovery: dict[str, Any]) -> list[Text | Table | Illustration]:
    return [
        Text(
            f"Hidden sensors ({recovery['repeats']}; two with a flat gel and two with a dome in turn) are "
            "each fitted to one press, backgrounds, dark frames and a light probe. Strong products are "
            "those above a quarter of the group's strongest response; weaker ones are crosstalk, as a "
            "share of the strongest."
        ),
        Table(
            tables.recovery(recovery),
            [
                Column("number", "number"),
                Column("unit", "unit of errors"),
                Column("median", "median error"),
                Column("largest", "largest error"),
                Column("count", "count"),
                Column("target", "target"),
                Column("met", "met"),
            ],
            "Errors of the fit; a target is met where the largest error keeps it, or in the median alone.",
        ),
        Table(
            tables.coverage(recovery),
            [
                Column("number", "number"),
                Column("share", "intervals that hold the truth", "%"),
                Column("count", "count"),
                Column("target", "target"),
                Column("met", "met"),
            ],
            "Stated 95 % intervals. Those of one sensor are not independent of each other.",
        ),
    ]


def _probe(probe: dict[str, Any], out: Path) -> list[Text | Table | Illustration]:
    rows = [{**strip, "number": n} for n, strip in enumerate(probe["strips"], start=1)]
    columns = [
        Column("number", "strip"),
        Column("channel", "LED group"),
        Column("polar_deg", "angle from the axis", "deg"),
        Column("azimuth_deg", "azimuth", "deg"),
        Column("apart_deg", "between the centres", "deg"),
        Column("solid_angle_ratio", "solid angle"),
        Column("seen_ratio", "seen from the ball"),
    ]
    blocks: list[Text | Table | Illustration] = [
        Text(
            f"A chrome ball of 4 mm in `{probe['sensor']}` without its gel is rendered and unwrapped to "
            "directions; beside it every LED strip is traced from the points of the ball that mirror it, in "
            "closed form and without the renderer. Flat gel and dome have the same LEDs."
        ),
        Table(
            rows,
            columns,
            "Angle between the centres of strip and lobe; solid angles, rendered over traced, of the "
            f"directions and as seen from the ball. Lobes without a strip: {probe['unmatched']}.",
        ),
    ]
    if (out / "probe" / probe["picture"]).is_file():
        blocks.append(
            Illustration(out / "probe" / probe["picture"], "Light that arrives at the ball, by direction")
        )
    return blocks


def _timing(timing: dict[str, Any]) -> list[Text | Table | Illustration]:
    return [
        Text(
            f"Ours on {timing['device']} ({timing['backend']}), the paper's on an RTX 2080 Ti. Path-traced "
            "pictures hold each of the three LED groups on its own, so that colours and powers can be "
            "changed without rendering again: three times the samples of one colour picture, the loading "
            f"of the scene included. Each time is the median of {timing['repeats']} pictures after one that "
            "compiles."
        ),
        Table(
            tables.timing(timing),
            [
                Column("picture", "picture"),
                Column("samples", "samples a pixel"),
                Column("ms", "ours", "ms"),
                Column("paper_ms", "paper", "ms"),
                Column("snr_db", "SNR", "dB"),
                Column("ssim", "SSIM"),
            ],
            f"Quality against {timing['reference_samples']} samples a pixel of the same view, whose own "
            "noise is in the figures. The fast estimator traces a light field once for a design, then "
            "shades every press from it.",
        ),
    ]


def _real(real: dict[str, Any], out: Path) -> list[Text | Table | Illustration]:
    if "left_out" in real:
        return [Text(real["left_out"][0].upper() + real["left_out"][1:] + ".")]
    blocks: list[Text | Table | Illustration] = [
        Text(
            "The one public picture of the flat sensor, in full resolution: with the published values and "
            f"nothing fitted, and calibrated on that same picture at {real['columns']} columns (light, "
            "floor, pose, kernel length, field of view). No picture is left to judge the fit by, so this "
            "is no test of it."
        ),
        Table(tables.real(real), [*tables.REAL_COLUMNS, *tables.FIGURE_COLUMNS]),
    ]
    if (out / "real" / real["picture"]).is_file():
        blocks.append(Illustration(out / "real" / real["picture"], "Measured, calibrated, and what is left"))
    blocks += [Text(note, note=True) for note in real["notes"]]
    return blocks


def _again(result: dict[str, Any]) -> list[Text | Table | Illustration]:
    return [
        Text(
            f"`designlab reproduce --out DIR --size {result['size']} --seed {result['seed']}`. It can be "
            "interrupted; the same command goes on. The environment variable `DESIGNLAB_MEASURED` names the "
            "folder of real pictures, without which that part is left out."
        )
    ]
