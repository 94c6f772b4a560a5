"""How much faster two single-threaded workers finish a study than one.

    OMP_NUM_THREADS=1 python benchmarks/workers.py [--designs 12]

Alternates between one and two workers, so that what else the machine does weighs on both. Each worker has one
core, and each run a process of its own, whose start counts.
"""

import argparse
import multiprocessing
import os
import tempfile
import time
from pathlib import Path

from designlab.core import backend
from designlab.optimization.study import Parameter, Plan, Study, run_study


def search(study: Study, folder: Path, workers: int) -> None:
    """Run a study on as many cores as workers."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:workers])
    run_study(study, out=folder, workers=workers, progress=False)


def main() -> None:
    """Print the time of each run and the ratio of the sums."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--designs", type=int, default=12)
    parser.add_argument("--rounds", type=int, default=2)
    arguments = parser.parse_args()
    study = Study(
        base="gelsight-2020-flat",
        parameters={"leds.tilt_deg": Parameter(low=0, high=40)},
        trials=arguments.designs,
        sampler="qmc",
        plan=Plan(promoted=0),
    )
    seconds = {1: 0.0, 2: 0.0}
    context = multiprocessing.get_context("spawn")
    for _ in range(arguments.rounds):
        for workers in seconds:
            with tempfile.TemporaryDirectory() as folder:
                begun = time.perf_counter()
                run = context.Process(target=search, args=(study, Path(folder), workers))
                run.start()
                run.join()
                took = time.perf_counter() - begun
                if run.exitcode:
                    raise SystemExit(f"the study ended with {run.exitcode}")
            seconds[workers] += took
            print(f"{workers} worker(s): {arguments.designs} designs in {took:.1f} s", flush=True)
    print(f"two workers take {seconds[2] / seconds[1]:.2f} of the time of one ({backend.choose().reason})")


if __name__ == "__main__":
    main()
