"""How much colours that are filled in over printed markers should count in the height.

    python benchmarks/reconstruct_predicted.py --out OUT --presets default+dots
    python benchmarks/filled_markers.py --out OUT --preset default+dots

Uses the pictures and the calibration that the first command wrote. Each weight is one line: the errors of the
24 test presses. With a weight of 0 the integration bridges covered pixels; normals are read off all the same.
"""

import argparse
from pathlib import Path
from unittest import mock

import numpy as np
from reconstruct_predicted import SCORES, Truth, errors, scores
from threadpoolctl import threadpool_limits

from designlab.core.images import read_picture
from designlab.reconstruction import lab
from designlab.reconstruction.reconstructor import Reconstructor

WEIGHTS = (0.0, 0.01, 0.1, 0.3, 1.0)


def main() -> None:
    """Reconstruct with each weight, compare."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--preset", default="default+dots")
    args = parser.parse_args()
    folder = args.out / args.preset
    with np.load(folder / "truth.npz") as file:
        truths = [Truth(*parts) for parts in zip(*(file[name] for name in Truth._fields), strict=True)]
    reconstructor = Reconstructor.load(folder / "calibration.npz")
    print("weight  " + "  ".join(SCORES))
    with threadpool_limits(1):
        for weight in WEIGHTS:
            with mock.patch.object(lab, "FILLED", weight):
                each = [
                    errors(reconstructor, read_picture(folder / "presses" / f"{number:02d}.png"), truth)
                    for number, truth in enumerate(truths)
                ]
            found = scores(np.array(each))
            print(f"{weight:6g}  " + "  ".join(f"{found[name].value:.3f}" for name in SCORES), flush=True)


if __name__ == "__main__":
    main()
