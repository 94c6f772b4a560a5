"""Time of one evaluation after start-up, part by part, on all cores and on one.

    python benchmarks/evaluation.py
    python benchmarks/evaluation.py --design gelsight-2020-dome-core --fidelity standard

A process first evaluates the design once, which loads libraries and compiles kernels, then with other seeds;
their median is printed. Nothing is taken from the cache of light fields. The same is done in a process that
may use one core only.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile

REPEATS = 3


def measure(design: str, fidelity: str) -> dict[str, float]:
    """Median seconds of each part, over seeds, after one evaluation that warms up."""
    from designlab.core.store import CACHE_VARIABLE
    from designlab.evaluation.evaluate import evaluate
    from designlab.sensor.design import load

    parts = []
    for seed in range(REPEATS + 1):
        with tempfile.TemporaryDirectory() as folder:
            os.environ[CACHE_VARIABLE] = folder
            parts.append(evaluate(load(design), fidelity=fidelity, seed=seed).score.seconds)
    return {name: statistics.median(part[name] for part in parts[1:]) for name in parts[0]}


def main() -> None:
    """Print both tables and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--design", default="default", help="preset or TOML file (default: default)")
    parser.add_argument("--fidelity", default="fast", help="as of designlab evaluate (default: fast)")
    parser.add_argument("--json", action="store_true", help="measure here and print plain data")
    args = parser.parse_args()
    if args.json:
        print(json.dumps(measure(args.design, args.fidelity)))
        return
    cores = sorted(os.sched_getaffinity(0))
    found = []
    for allowed in (cores, cores[:1]):
        command = [sys.executable, __file__, "--design", args.design, "--fidelity", args.fidelity, "--json"]
        limit = ["taskset", "--cpu-list", ",".join(map(str, allowed))]
        output = subprocess.run([*limit, *command], check=True, capture_output=True, text=True).stdout
        found.append(json.loads(output.splitlines()[-1]))
    print(f"{args.design}, {args.fidelity}: seconds after start-up")
    print(f"{'part':<22}{f'{len(cores)} cores':>10}{'1 core':>10}{'ratio':>8}")
    totals = [sum(parts.values()) for parts in found]
    rows = [(name, *(parts[name] for parts in found)) for name in found[0]] + [("all", *totals)]
    for name, several, one in rows:
        print(f"{name:<22}{several:>10.2f}{one:>10.2f}{one / several:>8.2f}")


if __name__ == "__main__":
    main()
