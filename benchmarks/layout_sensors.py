"""LED rows that stand elsewhere than drawn, found by a background and one press: six made sensors.

    python benchmarks/layout_sensors.py --out DIR [--only NAME ...] [--columns 48]

Each sensor is planted with `designlab gap plant` from a design whose rows are moved, turned and of other
heights and tilts; `designlab calibrate --layout` starts from the design as drawn. A value is `right` within
5 deg of azimuth, 1 mm of height or 5 deg of tilt; `untold` where its own 95 % interval is wider than that,
none is given, or the fit is not good; else it is `wrong`. No fit may be `good` whose structure
correlation fell.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

from designlab.app.cli import main as designlab
from designlab.sensor.design import Design, preset

LIMITS = {"azimuth_deg": 5.0, "height_mm": 1.0, "tilt_deg": 5.0}
KEPT = ("background-0", "press-01")
Moved = tuple[float, float, float]


class Sensor(NamedTuple):
    """A base design; for each group its true azimuth, and what height and tilt are above those drawn.

    The generator fits light that comes in through ground sides by polynomials, too smooth beside an LED:
    where LEDs shine through such sides, they are polished in what is planted and in what is drawn.
    """

    base: str
    groups: tuple[Moved, Moved, Moved]
    polished: bool = False

    @property
    def drawn(self) -> Design:
        """The design as drawn."""
        base = preset(self.base)
        return base.replace({"gelcore.side_finish": "polished"}) if self.polished else base


SENSORS = {
    "elastic": Sensor("gelsight-2020-flat-elastic", ((90, 2.0, 0), (210, -3.0, 0), (150, 0, 4))),
    "turned": Sensor("gelsight-2020-flat", ((30, 0, 4), (270, 1.5, 0), (150, -3.0, -4))),
    "opposite": Sensor("default", ((90, 2.0, 0), (210, -2.0, 0), (150, 0, 0))),
    "cycled": Sensor("default", ((330, -3.0, 0), (90, 0, 0), (210, 2.0, 0))),
    "digit": Sensor("digit-like", ((40, 1.0, 0), (140, -2.0, 0), (270, 3.0, 0)), polished=True),
    "mini": Sensor("gelsight-mini-like", ((0, -1.5, 0), (90, 2.0, 0), (180, 0, 0))),
}


def made(sensor: Sensor) -> Design:
    """The design as the sensor was made."""
    base = sensor.drawn
    changes: dict[str, Any] = {}
    for number, (azimuth, higher, more) in enumerate(sensor.groups):
        own = f"leds.groups.{number}"
        changes[f"{own}.azimuth_deg"] = [float(azimuth)]
        changes[f"{own}.height_mm"] = base.leds.height_mm + higher
        changes[f"{own}.tilt_deg"] = base.leds.tilt_deg + more
    return base.replace(changes)


def keep_few(measurement: Path) -> None:
    """Leave one background and one press in a measurement."""
    head, *frames = measurement.read_text(encoding="utf-8").split("[[frame]]")
    few = [frame for frame in frames if any(name in frame for name in KEPT)]
    measurement.write_text("[[frame]]".join([head, *few]), encoding="utf-8")


def judged(
    name: str, value: float, se: float | None, truth: float, *, good: bool = True
) -> tuple[float, str]:
    """Error of a fitted value, and whether it is right, untold or wrong."""
    error = value - truth
    if name == "azimuth_deg":
        error = (error + 180.0) % 360.0 - 180.0
    if abs(error) <= LIMITS[name]:
        return error, "right"
    return error, "untold" if not good or se is None or 1.96 * se > LIMITS[name] else "wrong"


def run(name: str, out: Path, *, columns: int, seed: int) -> dict[str, Any]:
    """Make a sensor, fit it, and compare: errors and their words, verdict, structure before and after."""
    sensor, folder = SENSORS[name], out / name
    folder.mkdir(parents=True, exist_ok=True)
    design = made(sensor)
    design.save(folder / "made.toml")
    sensor.drawn.save(folder / "drawn.toml")
    words = ["gap", "plant", "--kit", "small", "--design", str(folder / "made.toml"), "--seed", str(seed)]
    if not (folder / "set").is_dir():
        if designlab([*words, "--columns", str(columns), "--out", str(folder / "set")]):
            raise SystemExit(f"{name}: could not be made")
        keep_few(folder / "set" / "measurement.toml")
    started = time.perf_counter()
    fit = [
        "calibrate",
        str(folder / "set"),
        "--model",
        str(folder / "drawn.toml"),
        "--layout",
        "--columns",
        str(columns),
    ]
    status = designlab([*fit, "--seed", str(seed), "--out", str(folder / "fit")])
    seconds = time.perf_counter() - started
    result = folder / "fit" / "calibration.json"
    if not result.is_file():
        raise SystemExit(f"{name}: the fit ended with exit status {status}")
    found = json.loads(result.read_text(encoding="utf-8"))
    parameters = {entry["name"]: entry for entry in found["parameters"]}
    rows = []
    for number, group in enumerate(design.leds.groups):
        for what in LIMITS:
            path = f"leds.groups.{number}.{what}"
            entry = parameters[f"{path}.0" if what == "azimuth_deg" else path]
            truth = group.azimuth_deg[0] if what == "azimuth_deg" else float(getattr(group, what))
            good = found["fit_verdict"] == "good"
            error, word = judged(what, entry["value"], entry["se"], truth, good=good)
            rows.append((group.name, what, truth, entry["value"], entry["se"], error, word))
    press = [frame for frame in found["frames"] if frame["pose"] is not None]
    before, after = (
        sum(f[when]["structure_corr"] for f in press) / len(press) for when in ("before", "after")
    )
    return {"rows": rows, "verdict": found["fit_verdict"], "before": before, "after": after, "s": seconds}


def main() -> None:
    """Print a table for each sensor, and what all give."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", required=True, help="folder of the sets and fits")
    parser.add_argument("--only", nargs="+", choices=list(SENSORS), default=list(SENSORS))
    parser.add_argument("--columns", type=int, default=48)
    parser.add_argument("--seed", type=int, default=4)
    args = parser.parse_args()
    counts: dict[str, int] = {}
    praised = 0
    for name in args.only:
        found = run(name, Path(args.out), columns=args.columns, seed=args.seed)
        print(
            f"\n{name} ({SENSORS[name].base}): {found['verdict']}, structure correlation "
            f"{found['before']:.3f} -> {found['after']:.3f}, {found['s']:.0f} s"
        )
        for group, what, truth, value, se, error, word in found["rows"]:
            spread = "-" if se is None else f"{1.96 * se:.2f}"
            print(f"  {group:6} {what:12} {truth:8.2f} {value:8.2f} ± {spread:6} {error:+7.2f}  {word}")
            counts[word] = counts.get(word, 0) + 1
        praised += found["verdict"] == "good" and found["after"] < found["before"]
        sys.stdout.flush()
    print(f"\nall: {counts}; good though structure fell: {praised}")


if __name__ == "__main__":
    main()
