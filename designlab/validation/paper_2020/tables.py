"""The tables of a reproduction are rows and columns of its results, and sentences that read them."""

from collections.abc import Iterator, Mapping
from typing import Any

from designlab.report.page import Column, rounded
from designlab.sensor.design import CHANNELS
from designlab.validation.paper_2020 import comparison as paper
from designlab.validation.paper_2020.accuracy import DIFFUSE, PHONG, TRANSPORT
from designlab.validation.paper_2020.comparison import percent, short, verdict

Rows = list[dict[str, Any]]
BASELINES = (DIFFUSE, PHONG)
BOTH = "both"
PARTS = {
    "smooth": "a smooth field: light that falls off otherwise than modelled",
    "edges": "the edges of contacts",
    "rest": "the rest: shadows, and light from wall to wall",
}
NUMBERS = {
    "product": ("light times reflectance", "%"),
    "product, crosstalk": ("light times reflectance, crosstalk", "%"),
    "transfer": ("light", "%"),
    "transfer, crosstalk": ("light, crosstalk", "%"),
    "reflectance": ("reflectance", "%"),
    "kernel": ("kernel length", "%"),
    "floor": ("floor", "full scale"),
    "x_mm": ("x of a press", "mm"),
    "y_mm": ("y of a press", "mm"),
    "depth_mm": ("depth of a press", "mm"),
    "yaw_deg": ("yaw of a press", "deg"),
}
MODEL_COLUMNS = [Column("sensor", "gel"), Column("dataset", "data set"), Column("model", "model")]
REAL_COLUMNS = [Column("channel", "channel"), Column("model", "picture")]
FIGURE_COLUMNS = [
    Column("mse", "MSE"),
    Column("snr_db", "SNR", "dB"),
    Column("smape", "SMAPE"),
    Column("ssim", "SSIM"),
    Column("structure_corr", "structure correlation"),
    Column("structure_snr_db", "structure SNR", "dB"),
]
FIGURES = tuple(column.key for column in FIGURE_COLUMNS)


def accuracy(found: Mapping[str, Any], *, channels: bool) -> Rows:
    """Means by sensor, data set and model; of all channels together, or of each."""
    rows = []
    for sensor, held in found["sensors"].items():
        for dataset in _datasets(held):
            for model, results in held["models"].items():
                means = _means(results, dataset)
                for channel in CHANNELS if channels else ("",):
                    place = {"sensor": short(sensor), "dataset": dataset, "model": model, "channel": channel}
                    rows.append({**place, **_of_channel(means, channel)})
    return rows


def margins(found: Mapping[str, Any]) -> Rows:
    """By how many dB light transport is better, by sensor, data set and channel."""
    rows = []
    for sensor, held in found["sensors"].items():
        for dataset in _datasets(held):
            for channel in ("all", *CHANNELS):
                row = {"sensor": short(sensor), "dataset": dataset, "channel": channel}
                for name, baseline, figure in _margin_keys(held):
                    ours, theirs = (
                        _of_channel(_means(held["models"][model], dataset), channel)[figure]
                        for model in (TRANSPORT, baseline)
                    )
                    row[name] = ours - theirs
                rows.append(row)
    return rows


def margin_columns(found: Mapping[str, Any]) -> list[Column]:
    """Columns of the table of margins, for the baselines there are."""
    names = {"snr_db": "SNR", "structure_snr_db": "structure SNR"}
    own = [key for held in found["sensors"].values() for key in _margin_keys(held)]
    columns = {
        name: Column(name, f"{names[figure]}, {kind(baseline)}", "dB") for name, baseline, figure in own
    }
    return [*MODEL_COLUMNS[:2], Column("channel", "channel"), *columns.values()]


def headline(sensor: str, held: Mapping[str, Any]) -> str:
    """One sentence on the accuracy of a sensor's models."""
    means = held["models"][TRANSPORT]["held_out"]
    worst = []
    for baseline in _baselines(held):
        other = held["models"][baseline]["held_out"]
        least = {
            channel: means["channels"][channel]["snr_db"] - other["channels"][channel]["snr_db"]
            for channel in CHANNELS
        }
        channel = min(least, key=lambda name: least[name])
        worst.append(
            f"{means['snr_db'] - other['snr_db']:+.1f} dB over {baseline} (least in channel {channel}, "
            f"{least[channel]:+.1f} dB; structure "
            f"{means['structure_snr_db'] - other['structure_snr_db']:+.1f} dB)"
        )
    return (
        f"{short(sensor).capitalize()} gel, {held['held_out_frames']} presses not fitted: light transport "
        f"has an SNR of {means['snr_db']:.1f} dB, an SSIM of {means['ssim']:.2f} and a structure "
        f"correlation of {means['structure_corr']:.3f}; in SNR that is {' and '.join(worst)}."
    )


def error_shares(found: Mapping[str, Any]) -> Rows:
    """Where the squared error of each model lies, in percent."""
    return [
        {
            "sensor": short(sensor),
            "model": model,
            "mse": results["held_out"]["mse"],
            **{part: 100 * share for part, share in results["held_out"]["error_shares"].items()},
        }
        for sensor, held in found["sensors"].items()
        for model, results in held["models"].items()
    ]


def failures(found: Mapping[str, Any]) -> list[str]:
    """One sentence for each baseline: where most of its error lies, and how much more it has."""
    texts = []
    for sensor, held in found["sensors"].items():
        ours = held["models"][TRANSPORT]["held_out"]
        for baseline in _baselines(held):
            theirs = held["models"][baseline]["held_out"]
            shares = theirs["error_shares"]
            most = max(shares, key=lambda part: shares[part])
            ratio = theirs["mse"] / ours["mse"] if ours["mse"] else float("inf")
            texts.append(
                f"{short(sensor).capitalize()} gel, {baseline}: {rounded(ratio)} times the squared error of "
                f"light transport, most of it ({percent(shares[most])}) in {PARTS[most]}."
            )
    return texts


def recovery(found: Mapping[str, Any]) -> Rows:
    """Errors of what was fitted, with targets where there are some."""
    targets = {"product": paper.PRODUCT, "yaw_deg": paper.YAW_DEG}
    targets |= dict.fromkeys(paper.POSES_MM, paper.POSE_MM)
    rows = []
    for kind, (name, unit) in NUMBERS.items():
        if kind not in found["errors"]:
            continue
        error, target = found["errors"][kind], targets.get(kind)
        scale = 100 if unit == "%" else 1
        row: dict[str, Any] = {"number": name, "unit": unit, "count": error["count"]}
        row |= {"median": scale * error["median"], "largest": scale * error["largest"]}
        if target is not None:
            row["target"] = scale * target
            row["met"] = verdict(error["largest"] <= target)
            if error["median"] <= target < error["largest"]:
                row["met"] = "in the median"
        rows.append(row)
    return rows


def coverage(found: Mapping[str, Any]) -> Rows:
    """How many stated intervals hold the truth: all, and by kind."""
    low, high = paper.COVERED
    kinds = {"all": found["covered"], **found["covered"]["by_kind"]}
    return [
        {
            "number": NUMBERS.get(kind, (kind, ""))[0],
            "share": 100 * covered["share"],
            "count": covered["count"],
            "target": f"{100 * low:g} to {100 * high:g} %",
            "met": verdict(low <= covered["share"] <= high),
        }
        for kind, covered in kinds.items()
    ]


def timing(found: Mapping[str, Any]) -> Rows:
    """Path-traced pictures, then those of the fast estimator."""
    rows = [{**row, "picture": f"path-traced, {_side(row)}"} for row in found["path"]]
    for row in found["fast"]:
        quality = {"snr_db": row["snr_db"], "ssim": row["ssim"]}
        rows.append(
            {"picture": f"fast, {_side(row)}, with the light field", "ms": row["first_ms"], **quality}
        )
        rows.append({"picture": f"fast, {_side(row)}, each next press", "ms": row["next_ms"], **quality})
    return rows


def real(found: Mapping[str, Any]) -> Rows:
    """Figures of the first real frame: of a constant, of the published values, and calibrated."""
    frame = found["frames"][0]
    names = {"constant": "one constant colour", "before": "published values", "after": "calibrated"}
    return [
        {"channel": channel, "model": name, **_of_channel(frame[key], channel)}
        for channel in ("all", *CHANNELS)
        for key, name in names.items()
    ]


def _datasets(held: Mapping[str, Any]) -> list[str]:
    """Data sets that have frames which were not fitted, and both together where there are two."""
    own = list(held["models"][TRANSPORT]["held_out"]["datasets"])
    return [*own, BOTH] if len(own) > 1 else own


def _baselines(held: Mapping[str, Any]) -> list[str]:
    return [baseline for baseline in BASELINES if baseline in held["models"]]


def _means(results: Mapping[str, Any], dataset: str) -> Mapping[str, Any]:
    held: Mapping[str, Any] = results["held_out"]
    return held if dataset == BOTH else held["datasets"][dataset]


def _of_channel(means: Mapping[str, Any], channel: str) -> Mapping[str, Any]:
    own: Mapping[str, Any] = means["channels"].get(channel, means)
    return {name: own[name] for name in FIGURES}


def _margin_keys(held: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    for figure in ("snr_db", "structure_snr_db"):
        for baseline in _baselines(held):
            yield f"{figure} {baseline}", baseline, figure


def kind(baseline: str) -> str:
    """Last word of a baseline's name: diffuse or Phong."""
    return baseline.rpartition(" ")[2]


def _side(row: Mapping[str, Any]) -> str:
    return f"{row['px']} x {row['px']}"
