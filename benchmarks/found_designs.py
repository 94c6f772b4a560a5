"""What each change of the designs that the studies of the cores found is worth: one at a time is undone.

    OMP_NUM_THREADS=1 python benchmarks/found_designs.py [--fidelity fast --seeds 2 --workers 2]

All rows of a sensor have the same seeds: the same presses, and noise of the same kind.
"""

import argparse
import itertools
import os
from pathlib import Path
from typing import Any

import pandas as pd

from designlab.core.interrupts import Interrupts
from designlab.core.workers import finished
from designlab.evaluation.evaluate import FIDELITIES, evaluate
from designlab.sensor.design import load

RECORDS = Path(__file__).parents[1] / "docs" / "records"
ONE_PANEL = {f"leds.groups.{k}.azimuth_deg": (azimuth,) for k, azimuth in enumerate((90.0, 210.0, 330.0))}
UNDONE: dict[str, dict[str, dict[str, Any]]] = {
    "flat": {
        "as found": {},
        "one panel a group": ONE_PANEL,
        "boards of the prototype": {"optics.board_reflectance": (0.1, 0.8, 0.1)},
        "albedo of the prototype": {"optics.membrane_albedo": (0.506, 0.397, 0.453)},
        "matt coating": {"optics.coating_specular": 0.0},
        "beam of the prototype": {"leds.profile.beam_deg": None},
        "panels 9 mm wide": {
            "leds.emitting_width_mm": 9.0,
            "leds.body_width_mm": 9.0,
            "leds.pitch_mm": 9.0,
        },
        "panels at 8.79 mm": {"leds.height_mm": 8.79},
    },
    "dome": {
        "as found": {},
        "one panel a group": ONE_PANEL,
        "panels at 8.79 mm": {"leds.height_mm": 8.79},
        "panels at 10.5 mm": {"leds.height_mm": 10.5},
        "ground sides": {"gelcore.side_finish": "ground"},
        "boards of the prototype": {"optics.board_reflectance": (0.1, 0.8, 0.1)},
        "albedo of the prototype": {"optics.membrane_albedo": (0.51, 0.28, 0.22)},
    },
}
NAMES = ("uniformity_u0", "normal_error_median_deg", "information_deg")


def scores(sensor: str, undone: str, fidelity: str, seed: int) -> dict[str, float]:
    """Scores of the design found for a sensor, with one change undone."""
    design = load(RECORDS / f"study-{sensor}-core-best.toml").replace(UNDONE[sensor][undone])
    found = evaluate(design, fidelity=fidelity, seed=seed).score.scores
    return {name: found[name].value for name in NAMES}


def main() -> None:
    """Print the means over seeds."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--fidelity", choices=list(FIDELITIES), default="fast")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    rows = [(sensor, undone) for sensor, changes in UNDONE.items() for undone in changes]
    cells = list(itertools.product(rows, range(arguments.seeds)))
    calls = [(scores, *row, arguments.fidelity, seed) for row, seed in cells]
    found: list[dict[str, Any]] = [{} for _ in cells]
    with Interrupts() as interrupts:
        for place, score in finished(calls, workers=arguments.workers, interrupts=interrupts):
            (sensor, undone), seed = cells[place]
            found[place] = {"sensor": sensor, "undone": undone, **score}
            print(f"{sensor}, {undone}, seed {seed}: done", flush=True)
    means = pd.DataFrame(found).groupby(["sensor", "undone"], sort=False).mean()
    print(means.round(3).to_string())


if __name__ == "__main__":
    main()
