"""All scores of all presets, as a table in Markdown.

    python benchmarks/preset_scores.py [--fidelity standard --seeds 3]

Every preset sees presses of its own size at its own places, by the same seeds. What is printed is the mean
over seeds and its standard error, or that of a single evaluation if that is larger.
"""

import argparse
import math
import statistics

from designlab.design import preset, preset_names
from designlab.evaluate import FIDELITIES, evaluate
from designlab.scores import Estimate


def over_seeds(found: list[Estimate]) -> Estimate:
    """Mean, with the error by the spread over seeds if that is larger than what each states."""
    values = [each.value for each in found]
    stated = math.hypot(*(each.se for each in found)) / len(found)
    spread = statistics.stdev(values) / math.sqrt(len(values)) if len(values) > 1 else 0.0
    return Estimate(statistics.fmean(values), max(stated, spread), found[0].unit)


def main() -> None:
    """Print a row for each score and a column for each preset."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--fidelity", choices=list(FIDELITIES), default="standard")
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    columns = {}
    for name in preset_names():
        runs = [
            evaluate(preset(name), fidelity=arguments.fidelity, seed=seed).scores
            for seed in range(arguments.seeds)
        ]
        columns[name] = {score: over_seeds([run[score] for run in runs]) for score in runs[0]}
    scores = list(dict.fromkeys(score for column in columns.values() for score in column))
    print(f"| score | {' | '.join(columns)} |")
    print(f"| --- |{' --- |' * len(columns)}")
    for score in scores:
        cells = [str(column[score]) if score in column else "" for column in columns.values()]
        print(f"| `{score}` | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
