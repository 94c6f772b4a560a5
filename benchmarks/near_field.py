"""Near-field photometric stereo without calibration presses against the kernel calibrated on balls.

    python benchmarks/near_field.py --fidelity standard

Both see the same frames, noise and test presses as `designlab evaluate`; the kernel also its calibration
balls. The near field is given the simulated light of the untouched gel: once as it is, and once more with the
shadows of the height of the first pass.
"""

import argparse

import numpy as np
from numpy.typing import NDArray

from designlab.core.metrics import normal_error_deg
from designlab.evaluation.evaluate import FIDELITIES
from designlab.evaluation.press_plan import PressPlan
from designlab.evaluation.protocol import EvaluationProtocol, sub_seed
from designlab.reconstruction import blended, normals
from designlab.sensor.design import preset
from designlab.simulation.simulator import Simulator, exposure
from geometries.elastomer import base_gradient

DESIGNS = ("default", "gelsight-2020-flat", "gelsight-2020-dome")


def row(errors_deg: list[NDArray[np.float64]], errors_um: list[NDArray[np.float64]]) -> str:
    """Figures over the regions that count of all test presses, as of an evaluation."""
    tilt, height = np.concatenate(errors_deg), np.abs(np.concatenate(errors_um))
    return f"{np.median(tilt):10.2f} {tilt.mean():10.2f} {height.mean():10.1f}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("designs", nargs="*", default=DESIGNS, help=f"default: {' '.join(DESIGNS)}")
    parser.add_argument("--fidelity", choices=FIDELITIES, default="fast", help="default: fast")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    effort, seed = FIDELITIES[args.fidelity], args.seed
    print(f"{'design':20} {'method':12} {'median deg':>10} {'mean deg':>10} {'height um':>10}")
    for name in args.designs:
        simulator = Simulator(
            preset(name),
            columns=effort.columns,
            samples=effort.samples,
            seed=seed,
            estimator=effort.estimator,
        )
        plan = PressPlan.of(simulator.design)
        presses = plan.presses(rounds=effort.rounds, seed=seed, grids=effort.grids)
        untouched, again = (simulator.frame(None, seed=sub_seed(seed, 3, half), half=half) for half in (0, 1))
        balls, tests = (
            [simulator.frame(press, seed=sub_seed(seed, stage, k)) for k, press in enumerate(chosen)]
            for stage, chosen in ((1, presses.calibration), (2, presses.test))
        )
        protocol = EvaluationProtocol(simulator.design, exposure(simulator.design, untouched), seed)
        results = protocol.reconstruct(protocol.calibrate(untouched, again, balls), tests)
        found = [([r.error_deg[r.region] for r in results], [r.height_error_um for r in results])]
        known = protocol.near_field(untouched, simulator.slope_response())
        passes = ([], []), ([], [])
        for result in results:
            frame, pitch_mm = result.frame, result.frame.rays.pitch_mm
            base_p, base_q = base_gradient(simulator.design.elastomer, *frame.seen_mm)
            light = known
            for tilts, heights in passes:
                estimate = light.estimate(result.image)
                height_mm = estimate.height_mm(pitch_mm=pitch_mm)
                p, q = blended(estimate.p, estimate.q, height_mm, pitch_mm=pitch_mm)
                seen = normals(p + base_p, q + base_q)
                tilts.append(normal_error_deg(seen, result.true_normals)[result.region])
                heights.append(1000 * (height_mm - frame.height_mm)[result.region])
                light = known.shadowed(height_mm, pitch_mm=pitch_mm)
        found += passes
        for method, figures in zip(("kernel", "near field", "... shadowed"), found, strict=True):
            print(f"{name:20} {method:12} {row(*figures)}", flush=True)


if __name__ == "__main__":
    main()
