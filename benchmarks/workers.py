"""How much faster two single-threaded workers finish a study than one.

    OMP_NUM_THREADS=1 python benchmarks/workers.py [--designs 12]

Alternates between one and two workers, so that what else the machine does weighs on both. The mean time of
designs that are evaluated side by side tells what is lost to shared memory and caches.
"""

import argparse
import tempfile
import time
from pathlib import Path

from designlab.render import backend
from designlab.study import Parameter, Study, load_results, run_study


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
    )
    seconds = {1: 0.0, 2: 0.0}
    for _ in range(arguments.rounds):
        for workers in seconds:
            with tempfile.TemporaryDirectory() as folder:
                begun = time.perf_counter()
                run_study(study, out=Path(folder), workers=workers, progress=False)
                took = time.perf_counter() - begun
                done = load_results(folder).counts()["complete"]
            seconds[workers] += took
            print(f"{workers} worker(s): {done} designs in {took:.1f} s", flush=True)
    print(f"two workers take {seconds[2] / seconds[1]:.2f} of the time of one ({backend.choose().reason})")


if __name__ == "__main__":
    main()
