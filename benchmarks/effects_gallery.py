"""Every effect in pictures: off, on and their difference, and how well three ways to compute it agree.

    python benchmarks/effects_gallery.py --preset gelsight-2020-flat --out gallery

One sheet for each stage shows, for every effect at one prior standard deviation of all its parameters, a
press without it, with it, and the difference, on one scale a row: by the simulator and by the generator of
measurements. Printed is the table: change of the signal; error of the picture that a diagnosis combines, at
0.6 standard deviations; and the generator's change less the simulator's, over that change.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from designlab.core.images import to_srgb
from designlab.core.store import write_json
from designlab.simulation.effects import CATALOGUE, Effect

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "physics"))

from effect_pictures import Sensor, rms, values_at

OF_ONE_PICTURE = ("fixed_pattern", "exposure_drift", "banding")
BETWEEN = 0.6
PRESS = 1  # number of the picture that is shown


def measured(
    sensor: Any, shown: Effect, *, seed: int, folder: Path, cheap: bool
) -> tuple[dict[str, float], Any]:
    """Row of the table and pictures of one effect."""
    plain, base = sensor.simulated(), sensor.generated()[0]
    values = values_at(shown.name, sensor.design, 1.0, seed=seed)
    found, own = sensor.generated(shown.name, values)
    changed = sensor.simulated(shown.name, values, own=own if shown.name in OF_ONE_PICTURE else None)
    change, other, size = changed - plain, found - base, rms(plain)
    row = {"change_percent": 100 * rms(change) / size}
    row["generator_percent"] = 100 * rms(other - change) / max(rms(change), 1e-12)
    if cheap and shown.name not in OF_ONE_PICTURE:
        values = values_at(shown.name, sensor.design, BETWEEN)
        full = sensor.simulated(shown.name, values)
        combined = sensor.combined(shown.name, values, folder=folder)
        row["cheap_percent"] = 100 * rms(combined - full) / size
    return row, (plain[PRESS], changed[PRESS], change[PRESS], other[PRESS])


def draw(rows: dict[str, Any], path: Path) -> None:
    """One row an effect: off, on, difference by the simulator and by the generator, with its scale."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 1.95 * len(rows) + 0.3), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(rows), 4, squeeze=False)
    for line, (name, (off, on, change, other)) in zip(grid, rows.items(), strict=True):
        white = float(np.percentile(off, 99.5))
        scale = max(float(np.percentile(np.abs(change), 99.5)), 1e-9)
        shown = [
            to_srgb(off / white),
            to_srgb(on / white),
            0.5 + change / (2 * scale),
            0.5 + other / (2 * scale),
        ]
        titles = ["off", "on", f"difference, full scale {100 * scale / white:.2g} %", "the generator's"]
        for axes, picture, title in zip(line, shown, titles, strict=True):
            axes.imshow(np.clip(picture, 0, 1), interpolation="nearest")
            axes.set_title(title, fontsize=8)
            axes.set_xticks([])
            axes.set_yticks([])
        line[0].set_ylabel(name, fontsize=9)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Draw the sheets and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--preset", default="gelsight-2020-flat", help="which sensor")
    parser.add_argument("--columns", type=int, default=64, help="width of the pictures (px)")
    parser.add_argument("--samples", type=int, default=64, help="samples per pixel and LED group")
    parser.add_argument("--seed", type=int, default=1, help="seed of the signs of the parameters")
    parser.add_argument("--effects", nargs="*", help="these alone")
    parser.add_argument("--no-cheap", action="store_true", help="leave the combined pictures out")
    parser.add_argument("--out", type=Path, default=Path("effects-gallery"), help="folder of the results")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    sensor = Sensor(arguments.preset, arguments.columns, samples=arguments.samples)
    table: dict[str, dict[str, float]] = {}
    sheets: dict[str, dict[str, Any]] = {}
    print(f"{'effect':16s} {'change %':>9s} {'cheap/full %':>13s} {'generator %':>12s}")
    with tempfile.TemporaryDirectory() as folder:
        for shown in CATALOGUE:
            if not shown.parameters(sensor.design) or shown.name not in (arguments.effects or [shown.name]):
                continue
            row, pictures = measured(
                sensor, shown, seed=arguments.seed, folder=Path(folder), cheap=not arguments.no_cheap
            )
            table[shown.name] = row
            sheets.setdefault(shown.stage, {})[shown.name] = pictures
            cheap = f"{row['cheap_percent']:13.3f}" if "cheap_percent" in row else f"{'-':>13s}"
            print(
                f"{shown.name:16s} {row['change_percent']:9.2f} {cheap} {row['generator_percent']:12.1f}",
                flush=True,
            )
            draw(sheets[shown.stage], arguments.out / f"{shown.stage}.png")
    write_json(arguments.out / "table.json", table)


if __name__ == "__main__":
    main()
