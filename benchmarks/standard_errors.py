"""Honesty of the stated standard errors: how often a score lies within two of them.

    python benchmarks/standard_errors.py --repeats 20

Designs are evaluated again and again with other seeds: other places of all presses, other light, other camera
noise. A score's true value is taken to be the mean of its repeats, whose own error is allowed for. Honest
normal errors hold 95 % of repeats within two of them; 90 to 99 % is asked for. Finished repeats are kept in
the results folder.
"""

import argparse
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from designlab.core.store import write_json
from designlab.evaluation.evaluate import FIDELITIES, evaluate
from designlab.sensor.design import load

FROM, TO = 0.90, 0.99


def repeat(design: str, fidelity: str, seed: int, folder: Path) -> dict[str, tuple[float, float]]:
    """Value and standard error of every score, from the results folder where it is there."""
    file = folder / f"{Path(design).stem}-{fidelity}-{seed}.json"
    if not file.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        write_json(file, evaluate(load(design), fidelity=fidelity, seed=seed).score.to_json())
        print(f"{design}: seed {seed} done", flush=True)
    else:
        print(f"{design}: seed {seed} taken from {file}", flush=True)
    scores = json.loads(file.read_text())["scores"]
    return {name: (score["value"], score["se"]) for name, score in scores.items()}


def within_two(values: Sequence[float], errors: Sequence[float]) -> tuple[int, int, float]:
    """Repeats within two errors, repeats that state one, and scatter over the stated error."""
    value, error = np.array(values), np.array(errors)
    stated = error > 0
    # Deviations from a mean of n are smaller than from the truth by the root of (n - 1) / n.
    deviation = np.abs(value - value.mean()) * np.sqrt(len(value) / (len(value) - 1))
    ratio = float(value.std(ddof=1) / np.sqrt(np.mean(error**2))) if stated.any() else float("nan")
    return int((deviation[stated] <= 2 * error[stated]).sum()), int(stated.sum()), ratio


def main() -> None:
    """Evaluate what is missing and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("designs", nargs="*", default=["default"], help="presets or files (default: default)")
    parser.add_argument("--repeats", type=int, default=20, help="seeds (default: 20)")
    parser.add_argument("--fidelity", choices=FIDELITIES, default="fast", help="default: fast")
    parser.add_argument("--out", type=Path, default=Path("results/standard_errors"), help="results folder")
    args = parser.parse_args()
    inside = total = 0
    print(f"{'design':<28}{'score':<28}{'mean':>10}{'scatter':>10}{'stated':>10}{'ratio':>7}{'within 2':>10}")
    for design in args.designs:
        found = [repeat(design, args.fidelity, seed, args.out) for seed in range(args.repeats)]
        for name in found[0]:
            values, errors = zip(*(scores[name] for scores in found if name in scores), strict=True)
            held, stated, ratio = within_two(values, errors)
            if not stated:
                continue  # exact: the camera's coverage of the gel
            inside, total = inside + held, total + stated
            print(
                f"{Path(design).stem:<28}{name:<28}{np.mean(values):>10.4g}{np.std(values, ddof=1):>10.2g}"
                f"{np.sqrt(np.mean(np.square(errors))):>10.2g}{ratio:>7.2f}{held / stated:>10.0%}"
            )
    share = inside / total
    verdict = "honest" if FROM <= share <= TO else "NOT honest"
    print(
        f"pooled: {share:.1%} of {total} within two standard errors, {FROM:.0%} to {TO:.0%} asked: {verdict}"
    )


if __name__ == "__main__":
    main()
