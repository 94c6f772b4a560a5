"""Random error of light behind glass on the untouched gel: generator and fast estimator, two seeds each.

Printed for each LED group is the scatter over the picture of the ratio of two pictures, in percent, pixel by
pixel and after a Gaussian blur of 3 pixels; and the processor time of each picture, if none is in the cache.

    python benchmarks/behind_glass.py gelsight-2020-flat-core
"""

import argparse
import time

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from designlab.sensor.design import Design, preset
from designlab.simulation.simulator import Simulator
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.immersed import ImmersedLighting

COLUMNS, BLUR_PX = 96, 3.0
SEEDS = (1, 2)


def generated(design: Design, seed: int) -> NDArray[np.float64]:
    """Radiance of a matte membrane by the generator, (groups, rows, columns)."""
    rig, simulator = Rig.of(design), Simulator(design, columns=COLUMNS, samples=1, seed=1)
    x_mm, y_mm = simulator.rays.hit(simulator.surface(None))
    light = ImmersedLighting(rig, seed=seed)
    arriving = light.arriving(light.untouched.surface, x_mm.ravel(), y_mm.ravel())
    return np.asarray((np.reshape(rig.albedo, (-1, 1)) * arriving / np.pi).reshape(-1, *x_mm.shape))


def shaded(design: Design, samples: int, seed: int) -> NDArray[np.float64]:
    """Radiance by the fast estimator, (groups, rows, columns)."""
    simulator = Simulator(design, columns=COLUMNS, samples=samples, seed=seed)
    return np.asarray(simulator.frame(None).basis, dtype=float)


def row(one: NDArray[np.float64], other: NDArray[np.float64]) -> str:
    """Scatter of the ratio of two pictures by group."""
    ratio = one / other
    ratio = 100 * (ratio / ratio.mean(axis=(1, 2), keepdims=True) - 1)
    return "   ".join(f"{part.std():.2f} ({gaussian_filter(part, BLUR_PX).std():.2f})" for part in ratio)


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("preset", nargs="?", default="gelsight-2020-flat-core")
    parser.add_argument("--samples", type=int, default=256, help="of the fast estimator (default: 256)")
    arguments = parser.parse_args()
    design = preset(arguments.preset)
    generator, fast = [], []
    begun = time.process_time()
    for seed in SEEDS:
        generator.append(generated(design, seed))
    between = time.process_time()
    for seed in SEEDS:
        fast.append(shaded(design, arguments.samples, seed))
    seconds = (between - begun) / len(SEEDS), (time.process_time() - between) / len(SEEDS)
    print(f"generator, two seeds         {row(*generator)}   {seconds[0]:.0f} s each")
    print(f"fast estimator, two seeds    {row(*fast)}   {seconds[1]:.0f} s each")
    print(f"fast estimator by generator  {row(fast[0], generator[0])}")


if __name__ == "__main__":
    main()
