"""Chance in the difference of two pictures of nearly the same sensor behind glass, by effect.

Printed for each LED group is what of the ratio of both pictures, in percent, is finer than a Gaussian blur of
3 pixels: with starts of photons chosen for each sensor by itself, and for both alike.

    python benchmarks/shared_numbers.py gelsight-2020-flat-core
"""

import argparse

import numpy as np
from scipy.ndimage import gaussian_filter

from designlab.sensor.design import preset
from designlab.simulation.effects import AppliedEffect, SensorModel, effect
from designlab.simulation.simulator import Simulator

COLUMNS, BLUR_PX = 96, 3.0
EFFECTS = ("absorption", "interreflection", "led_spread", "core_scatter", "gelcore_index", "led_position")


def changed(model: SensorModel, name: str) -> SensorModel:
    """Sensor with the first parameter of an effect, all of an absorption, one usual size off."""
    parameters = effect(name).parameters(model.design)
    moved = parameters if name == "absorption" else parameters[:1]
    values = {p.name: p.null + (p.sd if p in moved else 0.0) for p in parameters}
    return model.with_effect(AppliedEffect(name=name, values=values))


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("preset", nargs="?", default="gelsight-2020-flat-core")
    parser.add_argument("--samples", type=int, default=256, help="of the fast estimator (default: 256)")
    arguments = parser.parse_args()
    model = SensorModel.of(preset(arguments.preset))

    def picture(one: SensorModel, like: SensorModel | None) -> np.ndarray:
        simulator = Simulator(one, columns=COLUMNS, samples=arguments.samples, seed=1, like=like)
        return np.asarray(simulator.frame(None).basis, dtype=float)

    plain = picture(model, None)
    for name in EFFECTS:
        rows = []
        for like in (None, model):
            ratio = 100 * (picture(changed(model, name), like) / plain - 1)
            fine = ratio - gaussian_filter(ratio, (0, BLUR_PX, BLUR_PX))
            rows.append(", ".join(f"{value:.2f}" for value in fine.std(axis=(1, 2))))
        print(f"{name:16} by itself {rows[0]} %   alike {rows[1]} %")


if __name__ == "__main__":
    main()
