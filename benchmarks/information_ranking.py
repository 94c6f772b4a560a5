"""Rank correlation of the information score with the errors of the full reconstruction.

    python benchmarks/information_ranking.py --designs 30 --plot docs/images/information_ranking.png

Every design of `benchmarks/random_designs.py` is evaluated. The information score needs one untouched
gel, the median normal error the calibration presses, test presses and their reconstruction. Finished designs
are kept in the results folder.
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from random_designs import random_design
from scipy.stats import spearmanr

from designlab.core.store import write_json
from designlab.evaluation.evaluate import FIDELITIES, evaluate
from designlab.evaluation.press_plan import TEST_PROBES
from designlab.evaluation.press_scores import PRESS_FIGURES

AGAINST = {
    "normal_error_median_deg": "median normal error (deg)",
    "normal_error_mean_deg": "mean normal error (deg)",
    "height_mae_um": "height MAE (um)",
}
DRAWS = 2000
FALLING = ("normals_within_5deg", "rgb2normal")  # the less, the worse
LEAST = 0.02  # of the mean: a probe may have no error of a kind at all


def interval(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float]:
    """95 % interval of the rank correlation over the choice of designs, by bootstrap."""
    random = np.random.default_rng(0)
    draws = [random.integers(0, len(x), len(x)) for _ in range(DRAWS)]
    low, high = np.nanquantile([spearmanr(x[d], y[d]).statistic for d in draws], (0.025, 0.975))
    return float(low), float(high)


def difficulty(results: list[dict[str, Any]]) -> str:
    """How hard each test probe is: geometric means over designs, relative to the mean of the probes."""
    lines = [f"{'probe':<10}" + "".join(f"{name[:24]:>25}" for name in PRESS_FIGURES)]
    columns = []
    for name in PRESS_FIGURES:
        each = np.array([r["presses"][name] for r in results], dtype=float)[:, : len(TEST_PROBES)]
        if name in FALLING:
            each = 1 - each
        each = each[np.nanmean(each, axis=1) > 0]
        share = np.maximum(each, LEAST * np.nanmean(each, axis=1, keepdims=True))
        typical = np.exp(np.nanmean(np.log(share / np.nanmean(share, axis=1, keepdims=True)), axis=0))
        columns.append(typical / typical.mean())
    for probe, row in zip(TEST_PROBES, np.transpose(columns), strict=True):
        lines.append(f"{probe:<10}" + "".join(f"{value:>25.2f}" for value in row))
    return "\n".join(lines)


def plot(path: Path, results: list[dict[str, Any]], rank: float) -> None:
    """Scatter of the two scores with their standard errors."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    figure = Figure(figsize=(6.4, 4.8), layout="constrained")
    axes = figure.subplots()
    for light, marker, colour in (("air", "o", "tab:blue"), ("core", "s", "tab:orange")):
        chosen = [r["scores"] for r in results if r["light_path"] == light]
        x, y = (
            np.array([[s[name][part] for part in ("value", "se")] for s in chosen]).T
            for name in ("information_deg", "normal_error_median_deg")
        )
        axes.errorbar(
            x[0],
            y[0],
            xerr=x[1],
            yerr=y[1],
            fmt=marker,
            color=colour,
            capsize=2,
            label=f"light path: {light}",
        )
    axes.set(xscale="log", yscale="log", title=f"{len(results)} random designs, Spearman {rank:.2f}")
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    axes.set(xlabel="information: noise limit of the normal (deg)", ylabel=AGAINST["normal_error_median_deg"])
    axes.legend()
    axes.grid(which="both", alpha=0.3)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Evaluate what is missing, print the correlations, draw the plot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--designs", type=int, default=30, help="number of designs (default: 30)")
    parser.add_argument("--fidelity", choices=FIDELITIES, default="fast", help="default: fast")
    parser.add_argument(
        "--out", type=Path, default=Path("results/information_ranking"), help="results folder"
    )
    parser.add_argument("--plot", type=Path, help="picture to draw")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    begun, results = time.perf_counter(), []
    for seed in range(args.designs):
        file = args.out / f"design-{seed}-{args.fidelity}.json"
        if not file.is_file():
            design = random_design(seed)
            score = evaluate(design, fidelity=args.fidelity, seed=0).score.to_json()
            write_json(
                file, score | {"light_path": design.optics.light_path, "shape": design.elastomer.shape}
            )
            left = (time.perf_counter() - begun) / (seed + 1) * (args.designs - seed - 1)
            print(f"design {seed} done, {left / 60:.0f} min left", flush=True)
        else:
            print(f"design {seed} taken from {file}", flush=True)
        results.append(json.loads(file.read_text()))
    values = {
        name: np.array([r["scores"][name]["value"] for r in results])
        for name in ("information_deg", *AGAINST)
    }
    for name, words in AGAINST.items():
        rank = spearmanr(values["information_deg"], values[name]).statistic
        low, high = interval(values["information_deg"], values[name])
        print(f"information against {words}: Spearman {rank:.2f} (95 % {low:.2f} to {high:.2f})")
    print("difficulty of the test probes:")
    print(difficulty(results))
    if args.plot is not None:
        median = "normal_error_median_deg"
        plot(args.plot, results, spearmanr(values["information_deg"], values[median]).statistic)


if __name__ == "__main__":
    main()
