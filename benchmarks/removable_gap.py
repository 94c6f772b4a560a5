"""How much of the removable gap diagnoses of a pool remove.

    python benchmarks/removable_gap.py FOLDER [--only REGEX]

FOLDER is that of a `designlab gap benchmark`, with its sets. Removable is what the hidden effects, at
the size that they were hidden with, take off the squared residual of the final presses. The model as given,
the one that the diagnosis wrote and the one with the truth in it are compared with the frames in the same
way: light and poses are registered, nothing else is fitted. Effects that act by what single frames or pixels
have cannot be compared so, and sets in which the truth removes less than a tenth tell nothing; both are left
out. Printed are a line for each set and the median.
"""

import argparse
import re
from pathlib import Path

import numpy as np

from designlab.core.store import read_json
from designlab.inference.diagnosis.diagnose import SAMPLES
from designlab.measurement import load_measurement
from designlab.sensor.design import preset
from designlab.simulation.effects import AppliedEffect, SensorModel, effect, load_model
from designlab.simulation.render_cache import Renders
from designlab.validation.blind.runner import SEED
from designlab.validation.blind.transfer import predicted

LEAST = 0.1  # of the squared residual that the truth must remove
RESAMPLES = 10_000


def main() -> None:
    """Print a line for each set, and the median with its 95 % interval (bootstrap over sets)."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path, help="folder of a benchmark")
    parser.add_argument("--only", type=re.compile, default=re.compile(""), help="sets whose name matches")
    args = parser.parse_args()
    shares = []
    for path in sorted((args.folder / "outcomes").glob("*.json")):
        outcome = read_json(path)
        trial = outcome["trial"]
        other = trial["without"] or trial["kit"] != "hour" or not _comparable(outcome["truth"])
        if other or not args.only.search(trial["name"]):
            continue
        before, after, true = _residuals(args.folder, path.stem, trial["design"], outcome["truth"]["effects"])
        if before - true < LEAST * before:
            continue
        shares.append((before - after) / (before - true))
        print(
            f"{trial['name']}: {', '.join(trial['effects'])}: given {before:.3g}, found {after:.3g}, "
            f"truth {true:.3g}: {shares[-1]:.0%} of the removable gap removed",
            flush=True,
        )
    if shares:
        drawn = np.random.default_rng(0).choice(shares, (RESAMPLES, len(shares)))
        low, high = np.quantile(np.median(drawn, axis=1), (0.025, 0.975))
        print(f"median of {len(shares)} sets: {np.median(shares):.1%} ({low:.1%} to {high:.1%})")


def _comparable(truth: dict[str, dict[str, float]]) -> bool:
    return bool(truth["effects"]) and not any(effect(name).drawn for name in truth["effects"])


def _residuals(
    folder: Path, label: str, name: str, effects: dict[str, dict[str, float]]
) -> tuple[float, float, float]:
    """Mean squared residuals of the final presses: model as given, found, and true."""
    design = preset(name)
    hidden = tuple(AppliedEffect(name=each, values=values) for each, values in effects.items())
    written = folder / "reports" / label / "model.toml"
    given, true = SensorModel.of(design), SensorModel(design=design, effects=hidden)
    found = load_model(written) if written.is_file() else given
    measurement = load_measurement(folder / "sets" / label)
    renders = Renders(folder / "renders" / f"{name}-removable", SAMPLES, SEED)
    before, after, best = (judged.mean for judged in predicted(measurement, [given, found, true], renders))
    return before, after, best


if __name__ == "__main__":
    main()
