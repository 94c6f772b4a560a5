"""How well a few hundred copies tell which spread is to blame: shares of linear scores, known beforehand.

python benchmarks/blame.py
"""

from pathlib import Path

import numpy as np
import pandas as pd

from designlab.optimization.tolerance import Tolerance
from designlab.optimization.tolerance.distributions import deviates

INPUTS, CASES = 25, 12
COPIES = (200, 800)


def main() -> None:
    """Print the error of shares, and how often the worst offender is the right one, by number of copies."""
    names = tuple(f"input_{k}" for k in range(INPUTS))
    print("copies  rms error of a share  right worst offender")
    for copies in COPIES:
        squares, right = [], 0
        for case in range(CASES):
            weights = np.random.default_rng(case).exponential(size=INPUTS)
            shares = weights**2 / (weights**2).sum()
            drawn = deviates(copies, names, seed=case)
            frame = pd.DataFrame(drawn, columns=list(names))
            frame = frame.assign(copy=np.arange(copies), built=True, score=drawn @ weights)
            found = Tolerance(Path(), "linear", {}, frame, names, {"score": "1"}).offenders("score")
            assert found is not None
            told = found.set_index("input")["share"].reindex(names).to_numpy()
            squares.append(float(((told - shares) ** 2).mean()))
            right += found["input"].iloc[0] == names[int(shares.argmax())]
        print(f"{copies:6d}  {np.sqrt(np.mean(squares)):20.3f}  {right} of {CASES}")


if __name__ == "__main__":
    main()
