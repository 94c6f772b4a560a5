"""What render noise adds to the scores of presses, and how much of it is left once it is taken off.

    python benchmarks/render_noise.py --designs 8

Presets and random designs are evaluated with the samples of fidelity "fast" and with sixteen times as many,
the same presses and seed. Printed are the score with its noise in it, the score as stated, and the difference
of the latter between both efforts as a share of what had been taken off at the lower one: of all designs
together its root mean square, which `designlab.evaluation.press_scores.NOISE_LEFT` must cover. Finished
evaluations are kept in the results folder.
"""

import argparse
import json
from pathlib import Path

import numpy as np
from random_designs import random_design

from designlab.core.store import write_json
from designlab.evaluation.evaluate import FIDELITIES, evaluate
from designlab.evaluation.press_scores import NOISE_LEFT, PRESS_FIGURES, pooled
from designlab.sensor.design import Design, load

PRESETS = ("default", "gelsight-2020-flat-core", "gelsight-2020-dome-core", "digit-like")
SCORES = ("normal_error_median_deg", "height_mae_um", "normals_within_5deg")
MORE = 16  # times the samples of "fast"


def scored(name: str, design: Design, times: int, seed: int, folder: Path) -> dict[str, tuple[float, float]]:
    """Score with render noise in it and as stated, from the results folder where it is there."""
    file = folder / f"{name}-{times}.json"
    if not file.is_file():
        fast = FIDELITIES["fast"]
        FIDELITIES["more"] = fast._replace(samples=times * fast.samples)
        folder.mkdir(parents=True, exist_ok=True)
        write_json(file, evaluate(design, fidelity="more", seed=seed).score.to_json())
    found = json.loads(file.read_text())
    presses = np.array([found["presses"][figure] for figure in PRESS_FIGURES], dtype=float).T
    raw = pooled(presses)
    return {score: (raw[score], found["scores"][score]["value"]) for score in SCORES}


def main() -> None:
    """Evaluate what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--designs", type=int, default=8, help="random ones beside presets (default: 8)")
    parser.add_argument("--seed", type=int, default=1, help="seed (default: 1)")
    parser.add_argument("--out", type=Path, default=Path("results/render_noise"), help="results folder")
    args = parser.parse_args()
    designs = {name: load(name) for name in PRESETS}
    designs |= {f"random-{k}": random_design(k) for k in range(args.designs)}
    print(f"{'design':<26}{'score':<26}{'fast':>9}{'stated':>9}{'more':>9}{'stated':>9}{'left':>7}")
    left: dict[str, list[tuple[float, float]]] = {score: [] for score in SCORES}
    for name, design in designs.items():
        few, many = (scored(name, design, times, args.seed, args.out) for times in (1, MORE))
        for score in SCORES:
            (raw, stated), (raw_many, true) = few[score], many[score]
            left[score].append((stated - true, raw - stated))
            share = (stated - true) / (raw - stated) if raw != stated else float("nan")
            print(
                f"{name:<26}{score:<26}{raw:>9.4g}{stated:>9.4g}{raw_many:>9.4g}{true:>9.4g}{share:>7.2f}",
                flush=True,
            )
    for score, pairs in left.items():
        rest, taken = np.sqrt(np.mean(np.square(pairs), axis=0))
        mean = np.mean([rest for rest, _ in pairs])
        print(
            f"{score}: taken off {taken:.3g}, left {rest:.3g} (mean {mean:+.2g}), "
            f"a share of {rest / taken:.2f}; {NOISE_LEFT} is stated"
        )


if __name__ == "__main__":
    main()
