"""RGB2Normal and our own scores of a fingertip's shells under three kinds of light.

    OMP_NUM_THREADS=1 python benchmarks/fingertip_shells.py [--fidelity standard --seeds 3 --workers 2]

Agarwal et al. 2025 (doi 10.1038/s44172-025-00350-4) rank an optimised shell before an expert's and that
before a flat one, and an area light before point and measured ones. Here the preset's hollow takes the three
shapes, and its LEDs the three far fields. Every cell has the same seeds: the same presses, and noise of the
same kind.
"""

import argparse
import itertools
import os

import numpy as np
import pandas as pd

from designlab.core.interrupts import Interrupts
from designlab.core.workers import finished
from designlab.evaluation.evaluate import FIDELITIES, evaluate
from designlab.evaluation.press_plan import TEST_PROBES
from designlab.sensor.design import preset

BASE = "pbr-fingertip-like"
SHELLS: dict[str, dict[str, float | None]] = {
    "optimised": {"gelcore.cavity_radius_mm": 7.1, "gelcore.cavity_depth_mm": 6.02},
    "expert": {"gelcore.cavity_radius_mm": 8.0, "gelcore.cavity_depth_mm": 8.0},
    "flat": {"gelcore.cavity_radius_mm": None, "gelcore.cavity_depth_mm": None},
}
# Far field of OSRAM's TOPLED LCB TTSD relative to its axis, means over the planes of 0 to 80 deg, which
# are alike, of the ray file that the paper's first author renders with (arpit15/custom_mit_plugin,
# rayfile_LCB_TTSD_20200817_IES.ies).
MEASURED = {
    "polar_deg": tuple(range(0, 91, 10)),
    "intensity": ((1.0, 0.967, 0.913, 0.828, 0.714, 0.576, 0.417, 0.250, 0.084, 0.003),),
}
LIGHTS = {"area": {"exponent": 1.0}, "measured": MEASURED, "spot": {"beam_deg": 30.0}}
NAMES = ("rgb2normal", "uniformity_u0", "normal_error_median_deg", "normal_error_mean_deg")
BALLS = "rgb2normal of balls"
BALL = next(place for place, probe in enumerate(TEST_PROBES) if probe.startswith("sphere:"))


def scores(shell: str, light: str, fidelity: str, seed: int) -> dict[str, float]:
    """Scores of one sensor; RGB2Normal also of balls alone, which the paper presses."""
    base = preset(BASE)
    design = base.replace({**SHELLS[shell], "leds.profile": LIGHTS[light]})
    found = evaluate(design, fidelity=fidelity, seed=seed).score
    balls = np.array(found.presses["rgb2normal"])[BALL :: len(TEST_PROBES)]
    return {**{name: found.scores[name].value for name in NAMES}, BALLS: float(np.nanmean(balls))}


def main() -> None:
    """Print mean and standard deviation over seeds of every shell and light."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--fidelity", choices=list(FIDELITIES), default="standard")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    cells = list(itertools.product(SHELLS, LIGHTS, range(arguments.seeds)))
    calls = [(scores, shell, light, arguments.fidelity, seed) for shell, light, seed in cells]
    rows = {}
    with Interrupts() as interrupts:
        for place, found in finished(calls, workers=arguments.workers, interrupts=interrupts):
            shell, light, seed = cells[place]
            rows[place] = {"shell": shell, "light": light, **found}
            print(f"{shell}, {light}, seed {seed}: done, {len(cells) - len(rows)} left", flush=True)
    table = pd.DataFrame([rows[place] for place in sorted(rows)])
    grouped = table.groupby(["shell", "light"], sort=False)
    for name in (BALLS, *NAMES):
        text = grouped[name].agg(lambda x: f"{x.mean():.3f} +- {x.std():.3f}")
        print(f"\n{name}\n{text.unstack().to_string()}")


if __name__ == "__main__":
    main()
