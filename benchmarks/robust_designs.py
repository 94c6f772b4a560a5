"""What a search for designs that survive being built gives up, and for what: flat sensor, core in its light.

    OMP_NUM_THREADS=1 python benchmarks/robust_designs.py --out DIR [--trials 16 --copies 60 --workers 2]

Two searches of the same ranges: one for the best drawing, one for the best mean of six copies less two
standard deviations of theirs, where panels are set into the housing by hand. Then fresh copies of both
winners are built. An interrupted run goes on in its folder.
"""

import argparse
import os
from pathlib import Path

from designlab.bounds import Bound
from designlab.design import load
from designlab.study import Robust, optimise
from designlab.tolerance import Spread, tolerance

BEST = Path(__file__).parent.parent / "docs/records/study-flat-core-best.toml"
SCORE = "uniformity_u0"
PARAMETERS = {"leds.height_mm": (8.6, 10.0), "leds.profile.beam_deg": (60.0, 90.0)}
BY_HAND = (
    Spread(field="leds.height_mm", sd=0.4, source="panels pushed into a slot by hand (estimate)"),
    Spread(field="leds.profile.beam_deg", sd=3.0, source="LEDs of several reels (estimate)"),
)
SEED, FRESH = 1, 7  # of the searches, and of the copies that had no part in them


def main() -> None:
    """Print both winners, as drawn and as built."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--trials", type=int, default=16)
    parser.add_argument("--copies", type=int, default=60)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--least", type=float, default=0.74, help="what a good copy must reach")
    arguments = parser.parse_args()
    aims = {"drawing": None, "robust": Robust(copies=6, sigmas=2.0, spread=BY_HAND)}
    head = ("search for", *PARAMETERS, "as drawn", "mean of copies", "sd", "cannot be built", "good")
    print(f"| {' | '.join(head)} |\n|{' --- |' * len(head)}")
    for aim, robust in aims.items():
        found = optimise(
            load(BEST),
            PARAMETERS,
            out=arguments.out / aim,
            objectives={SCORE: "maximise"},
            constraints={},
            plan={"promoted": 0},
            robust=robust,
            trials=arguments.trials,
            seed=SEED,
            workers=arguments.workers,
        )
        design = found.design(int(found.picks.iloc[0]["trial"]))
        copies = tolerance(
            design,
            out=arguments.out / f"{aim}-copies",
            copies=arguments.copies,
            spreads=BY_HAND,
            spec={SCORE: Bound(least=arguments.least)},
            seed=FRESH,
            workers=arguments.workers,
        )
        built = copies.built()[SCORE]
        where = [design.leds.height_mm, design.leds.profile.beam_deg]
        figures = [copies.nominal[SCORE], built.mean(), built.std()]
        cells = [*(f"{x:.2f}" for x in where), *(f"{x:.3f}" for x in figures), str(len(copies.unbuilt))]
        print(f"| {' | '.join((aim, *cells, f'{copies.good().mean():.0%}'))} |", flush=True)


if __name__ == "__main__":
    main()
