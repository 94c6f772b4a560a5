"""How much faster two single-threaded workers finish a study, or a sweep on a Dask cluster, than one.

    OMP_NUM_THREADS=1 python benchmarks/workers.py [--designs 12 --dask]

Alternates between one and two workers, so that what else the machine does weighs on both. Each worker has one
core, and each run a process of its own, whose start counts, with that of the cluster.
"""

import argparse
import multiprocessing
import os
import tempfile
import time
from pathlib import Path

from designlab.design import preset
from designlab.render import backend
from designlab.study import Parameter, Plan, Study, run_study, sweep

BASE, FIELD, HIGH = "gelsight-2020-flat", "leds.tilt_deg", 40


def search(designs: int, folder: Path, workers: int) -> None:
    """Run a study on as many cores as workers."""
    hold(workers)
    study = Study(
        base=preset(BASE),
        parameters={FIELD: Parameter(low=0, high=HIGH)},
        trials=designs,
        sampler="qmc",
        plan=Plan(promoted=0),
    )
    run_study(study, out=folder, workers=workers, progress=False)


def spread(designs: int, folder: Path, workers: int) -> None:
    """Sweep on a Dask cluster of as many cores as workers."""
    from distributed import LocalCluster

    hold(workers)
    values = [HIGH * number / designs for number in range(designs)]
    with LocalCluster(
        n_workers=workers, threads_per_worker=1, dashboard_address=None, local_directory=str(folder)
    ) as cluster:
        sweep(preset(BASE), {FIELD: values}, dask=cluster.scheduler_address, progress=False)


def hold(cores: int) -> None:
    """Keep this process and its children to some cores."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])


def main() -> None:
    """Print the time of each run and the ratio of the sums."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--designs", type=int, default=12)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--dask", action="store_true", help="a sweep on a Dask cluster instead of a study")
    arguments = parser.parse_args()
    work, what = (spread, "sweep") if arguments.dask else (search, "study")
    seconds = {1: 0.0, 2: 0.0}
    context = multiprocessing.get_context("spawn")
    for _ in range(arguments.rounds):
        for workers in seconds:
            with tempfile.TemporaryDirectory() as folder:
                begun = time.perf_counter()
                run = context.Process(target=work, args=(arguments.designs, Path(folder), workers))
                run.start()
                run.join()
                took = time.perf_counter() - begun
                if run.exitcode:
                    raise SystemExit(f"the {what} ended with {run.exitcode}")
            seconds[workers] += took
            print(f"{workers} worker(s): {arguments.designs} designs in {took:.1f} s", flush=True)
    print(f"two workers take {seconds[2] / seconds[1]:.2f} of the time of one ({backend.choose().reason})")


if __name__ == "__main__":
    main()
