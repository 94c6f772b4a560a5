"""Light that is reflected on its way: fast estimator, path tracer and generator on the untouched gel in air.

Three programs that share no light transport look at the same sensor. Printed for each LED group are mean and
scatter over the picture of the ratio of each estimator to the generator, in percent.

    python benchmarks/reflected_light.py gelsight-2020-dome
"""

import argparse

import numpy as np
from numpy.typing import NDArray

from designlab.sensor.design import Design, preset
from designlab.simulation.simulator import Simulator
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.light import Lighting

COLUMNS, TRACED, BLOCK = 40, 6000, 5
SEEDS = (3, 7, 8)


def generated(design: Design, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Radiance of a matte membrane by the generator, (groups, rows, columns)."""
    rig = Rig.of(design)
    light = Lighting(rig).untouched.irradiance(x_mm.ravel(), y_mm.ravel())
    return np.asarray((np.reshape(rig.albedo, (-1, 1)) * light / np.pi).reshape(-1, *x_mm.shape))


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("preset", nargs="?", default="gelsight-2020-dome")
    parser.add_argument("--samples", type=int, default=256)
    arguments = parser.parse_args()
    design = preset(arguments.preset)
    runs = [("fast", arguments.samples, seed) for seed in SEEDS] + [("path", TRACED, SEEDS[0])]
    print(f"{'estimator':10}{'seed':>5}   mean and scatter of the ratio - 1, %, by LED group")
    for estimator, samples, seed in runs:
        simulator = Simulator(design, columns=COLUMNS, samples=samples, seed=seed, estimator=estimator)
        frame = simulator.frame(None)
        ratio = 100 * (frame.basis / generated(design, *frame.seen_mm) - 1)
        rows, columns = (length // BLOCK * BLOCK for length in ratio.shape[1:])
        blocks = ratio[:, :rows, :columns].reshape(len(ratio), rows // BLOCK, BLOCK, columns // BLOCK, BLOCK)
        means = blocks.mean(axis=(2, 4))
        figures = "   ".join(f"{part.mean():+.3f} {part.std():.3f}" for part in means)
        print(f"{estimator:10}{seed:5}   {figures}   (squares of {BLOCK} pixels)")


if __name__ == "__main__":
    main()
