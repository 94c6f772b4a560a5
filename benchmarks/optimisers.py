"""Which search finds the best front for a number of rendered designs: all samplers, several seeds each.

    OMP_NUM_THREADS=1 python benchmarks/optimisers.py --out DIR [--trials 32 --seeds 5 --workers 2]

The problem is that of a usual study: uniformity and normal error of the flat sensor of 2020 over eight
fields. A single-objective search (cmaes) gets the mean of the logarithms of what both scores lack. The
hypervolume is that of both logarithms, over what the base design lacks. An interrupted run goes on in its
folder.
"""

import argparse
import importlib.util
import os
from pathlib import Path
from typing import Any, get_args

import matplotlib
import numpy as np
import pandas as pd

from designlab.core.interrupts import Interrupts
from designlab.core.workers import completed, submitter
from designlab.evaluation.evaluate import evaluate
from designlab.evaluation.illumination_scores import Estimate
from designlab.optimization.study import Parameter, Plan, Study, run_study
from designlab.optimization.study.definition import Sampler
from designlab.optimization.study.front import hypervolume
from designlab.optimization.study.robust import RobustScore

BASE = "gelsight-2020-flat"
PARAMETERS = {
    "leds.tilt_deg": Parameter(low=-10, high=60),
    "leds.height_mm": Parameter(low=4, high=14),
    "leds.radius_mm": Parameter(low=11, high=16),
    "leds.emitting_width_mm": Parameter(low=3, high=9),
    "elastomer.thickness_mm": Parameter(low=1, high=4),
    "optics.membrane_albedo.0": Parameter(low=0.1, high=0.7),
    "optics.membrane_albedo.1": Parameter(low=0.1, high=0.7),
    "optics.membrane_albedo.2": Parameter(low=0.1, high=0.7),
}
OBJECTIVES = {"uniformity_u0": "maximise", "normal_error_median_deg": "minimise"}
SCALAR = "lacking"


def lacking(scores: Any) -> np.ndarray:
    """Logarithms of what both scores lack, (..., 2)."""
    return np.log(np.stack([1 - scores["uniformity_u0"], scores["normal_error_median_deg"]], axis=-1))


def scalarised(design: Any, /, *, fidelity: str, seed: int) -> RobustScore:
    """Scores of a design, with the mean of what both lack as one more."""
    found = evaluate(design, fidelity=fidelity, seed=seed).score.scores
    values = {name: found[name].value for name in OBJECTIVES}
    return RobustScore({**found, SCALAR: Estimate(float(lacking(values).mean()), 0.0, "1")})


def search(sampler: str, seed: int, trials: int, out: Path) -> list[list[float]]:
    """What the designs of one search lack, in the order of their evaluation."""
    study = Study.model_validate(
        {
            "name": f"{sampler} {seed}",
            "base": BASE,
            "parameters": PARAMETERS,
            "objectives": {SCALAR: "minimise"} if sampler == "cmaes" else OBJECTIVES,
            "constraints": {},
            "plan": Plan(promoted=0),
            "sampler": sampler,
            "trials": trials,
            "seed": seed,
        }
    )
    results = run_study(study, out=out / f"{sampler}-{seed}", progress=False, evaluator=scalarised)
    frame = results.frame
    done = frame[(frame["state"] == "complete") & frame["reuse_of"].isna()]  # an equal design costs nothing
    return [[float(x) for x in row] for row in lacking({name: done[name] for name in OBJECTIVES})]


def volumes(lost: np.ndarray) -> list[float]:
    """Hypervolume below what the base lacks after each design; the base comes first."""
    return [hypervolume(lost[: n + 1], lost[0]) for n in range(len(lost))]


def plot(found: pd.DataFrame, path: Path) -> None:
    """Median over seeds and range, by number of designs."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7.2, 4.2), layout="constrained")
    last = found[found["designs"] == found["designs"].max()].groupby("sampler")["volume"].median()
    for sampler in last.sort_values(ascending=False).index:
        own = found[found["sampler"] == sampler].groupby("designs")["volume"]
        line = axes.plot(own.median(), label=sampler, color="0.4" if sampler == "random" else None)
        axes.fill_between(own.median().index, own.min(), own.max(), alpha=0.12, color=line[0].get_color())
    axes.set(xlabel="designs evaluated", ylabel="hypervolume (nats$^2$)")
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Print the hypervolume of each sampler, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--trials", type=int, default=32)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--samplers", nargs="+", default=sorted(set(get_args(Sampler)) - {"auto"}))
    arguments = parser.parse_args()
    if "gp" in arguments.samplers and importlib.util.find_spec("torch") is None:
        arguments.samplers.remove("gp")
        print("gp is left out: it needs PyTorch (pip install torch)", flush=True)
    jobs = [(sampler, seed) for seed in range(arguments.seeds) for sampler in arguments.samplers]
    calls = [(search, *job, arguments.trials, arguments.out) for job in jobs]
    rows = []
    with Interrupts() as interrupts, submitter(arguments.workers, interrupts) as submit:
        for place, lost in completed(submit, calls, at_once=arguments.workers, interrupts=interrupts):
            sampler, seed = jobs[place]
            for number, volume in enumerate(volumes(np.array(lost))):
                rows.append({"sampler": sampler, "seed": seed, "designs": number + 1, "volume": volume})
            print(f"{sampler} {seed}: {rows[-1]['volume']:.3f}", flush=True)
    found = pd.DataFrame(rows)
    found.to_csv(arguments.out / "volumes.csv", index=False)
    plot(found, arguments.out / "optimisers.png")
    last = found[found["designs"] == found["designs"].max()].groupby("sampler")["volume"]
    table = pd.DataFrame({"median": last.median(), "least": last.min(), "most": last.max()})
    print(table.sort_values("median", ascending=False).round(3).to_string())


if __name__ == "__main__":
    main()
