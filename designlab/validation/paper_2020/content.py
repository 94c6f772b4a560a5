"""What the pages about a reproduction say, without regard to how they are written.

The running text lies in ``reproduction.txt``, where tables, pictures and what depends on results have names.
"""

from importlib.resources import files
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


Blocks = list[Text | Table | Illustration]


class Chapter(NamedTuple):
    """A heading and what stands below it."""

    title: str
    blocks: Blocks


TARGET_COLUMNS = [Column("count", "count"), Column("target", "target"), Column("met", "met")]
REDUCED = Text(
    "This is the reduced size: few presses and coarse pictures show that everything runs. Quote the figures "
    "of the full size.",
    note=True,
)


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
    covered = stages["recovery"]["covered"]
    fields = {**result, **stages, "covered": covered, "covered_share": percent(covered["share"])}
    inserts: dict[str, Blocks] = {
        "reduced": [] if result["size"] == "full" else [REDUCED],
        "headlines": [Text(tables.headline(*own)) for own in stages["accuracy"]["sensors"].items()],
        "constant": [Text(constant_text(stages["real"]))],
        "comparison": [_comparison(stages)],
        "accuracy": _accuracy(stages["accuracy"], out),
        "failures": _failures(stages["accuracy"]),
        "recovery": _recovery(stages["recovery"]),
        "probe": _probe(stages["probe"], out),
        "timing": [_timing(stages["timing"])],
        "real": _real(stages["real"], out),
    }
    text = files(__package__).joinpath("reproduction.txt").read_text(encoding="utf-8")
    chapters: list[Chapter] = []
    for paragraph in (" ".join(part.split()) for part in text.split("\n\n")):
        if paragraph.startswith("# "):
            chapters.append(Chapter(paragraph[2:], []))
        elif paragraph.startswith("["):
            chapters[-1].blocks.extend(inserts[paragraph[1:-1]])
        else:
            chapters[-1].blocks.append(Text(paragraph.format_map(fields)))
    return chapters


def _comparison(stages: dict[str, Any]) -> Table:
    rows = [row._asdict() for row in paper.comparison(stages)]
    columns = [
        Column("name", "figure"),
        Column("paper", "paper"),
        Column("ours", "ours"),
        Column("target", "our target"),
        Column("met", "met"),
        Column("why", "why they differ"),
    ]
    return Table(rows, columns, f"The paper's figures are from {paper.SOURCE}.")


def _picture(path: Path, caption: str) -> Blocks:
    """Picture, if it is there."""
    return [Illustration(path, caption)] if path.is_file() else []


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


def _accuracy(accuracy: dict[str, Any], out: Path) -> Blocks:
    blocks: Blocks = [
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
            caption = f"{short(sensor)} gel: {name} of the models on a press not fitted"
            blocks += _picture(out / "accuracy" / path, caption)
    blocks.append(
        Table(
            tables.accuracy(accuracy, channels=True),
            [*tables.MODEL_COLUMNS, Column("channel", "channel"), *tables.FIGURE_COLUMNS],
            "The same for each channel.",
        )
    )
    return blocks


def _failures(accuracy: dict[str, Any]) -> Blocks:
    blocks: Blocks = [Text(text) for text in tables.failures(accuracy)]
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
    for sensor, found in accuracy["sensors"].items():
        if found.get("interreflected_share"):
            shares = {channel: percent(share) for channel, share in found["interreflected_share"].items()}
            blocks.append(
                Text(
                    f"{short(sensor).capitalize()} gel: share of the untouched gel's light that met the "
                    "membrane or the parts around it more than once, which directional light has no place "
                    f"for: {each(shares, names=str)}."
                )
            )
    return blocks


def _recovery(recovery: dict[str, Any]) -> Blocks:
    return [
        Table(
            tables.recovery(recovery),
            [
                Column("number", "number"),
                Column("unit", "unit of errors"),
                Column("median", "median error"),
                Column("largest", "largest error"),
                *TARGET_COLUMNS,
            ],
            "Errors of the fit; a target is met where the largest error keeps it, or in the median alone.",
        ),
        Table(
            tables.coverage(recovery),
            [
                Column("number", "number"),
                Column("share", "intervals that hold the truth", "%"),
                *TARGET_COLUMNS,
            ],
            "Stated 95 % intervals. Those of one sensor are not independent of each other.",
        ),
    ]


def _probe(probe: dict[str, Any], out: Path) -> Blocks:
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
    caption = (
        "Angle between the centres of strip and lobe; solid angles, rendered over traced, of the directions "
        f"and as seen from the ball. Lobes without a strip: {probe['unmatched']}."
    )
    picture = _picture(out / "probe" / probe["picture"], "Light that arrives at the ball, by direction")
    return [Table(rows, columns, caption), *picture]


def _timing(timing: dict[str, Any]) -> Table:
    columns = [
        Column("picture", "picture"),
        Column("samples", "samples a pixel"),
        Column("ms", "ours", "ms"),
        Column("paper_ms", "paper", "ms"),
        Column("snr_db", "SNR", "dB"),
        Column("ssim", "SSIM"),
    ]
    caption = (
        f"Quality against {timing['reference_samples']} samples a pixel of the same view, whose own noise is "
        "in the figures. The fast estimator traces a light field once for a design, then shades every press "
        "from it."
    )
    return Table(tables.timing(timing), columns, caption)


def _real(real: dict[str, Any], out: Path) -> Blocks:
    if "left_out" in real:
        return [Text(real["left_out"][0].upper() + real["left_out"][1:] + ".")]
    blocks: Blocks = [
        Text(
            "The one public picture of the flat sensor, in full resolution: with the published values and "
            f"nothing fitted, and calibrated on that same picture at {real['columns']} columns (light, "
            "floor, pose, kernel length, field of view). No picture is left to judge the fit by, so this "
            "is no test of it."
        ),
        Table(tables.real(real), [*tables.REAL_COLUMNS, *tables.FIGURE_COLUMNS]),
    ]
    blocks += _picture(out / "real" / real["picture"], "Measured, calibrated, and what is left")
    return [*blocks, *(Text(note, note=True) for note in real["notes"])]
