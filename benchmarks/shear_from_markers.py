"""Shear from markers: sheared presses of a marker gel are rendered, and read by the model of the sensor.

    python benchmarks/shear_from_markers.py --presses 24 --columns 320

Prints the true shear, the one found with its standard error, and how many lie within 20 %.
"""

import argparse

import numpy as np

from designlab.evaluation.protocol import EvaluationProtocol
from designlab.inference.calibration.from_model import teach_on_model
from designlab.reconstruction.reconstructor import Reconstructor
from designlab.sensor.design import Design, preset
from designlab.simulation.contact.press import Press
from designlab.simulation.effects.model import SensorModel
from designlab.simulation.simulator import Simulator, exposure

PROBES = ("sphere:4", "sphere:6", "cylinder:4", "star:6", "triangle:5")
WITHIN = 0.2


def sensor(name: str, friction: float) -> Design:
    """A preset with printed markers and a gel on which probes stick."""
    return preset(name).replace(
        {"contact.friction": friction, "optics.marker_pitch_mm": 1.2, "optics.marker_diameter_mm": 0.4}
    )


def presses(count: int, seed: int, area_mm: tuple[float, float]) -> list[Press]:
    """Presses of several probes, depths and places, sheared by 0.05 to 0.25 mm into any direction."""
    random = np.random.default_rng(seed)
    made = []
    for number in range(count):
        angle, size = random.uniform(0, 2 * np.pi), random.uniform(0.05, 0.25)
        made.append(
            Press(
                probe=PROBES[number % len(PROBES)],
                depth_mm=float(random.uniform(0.3, 0.7)),
                centre_mm=(
                    float(random.uniform(-0.2, 0.2) * area_mm[0]),
                    float(random.uniform(-0.2, 0.2) * area_mm[1]),
                ),
                yaw_deg=float(random.uniform(-180, 180)),
                shear_mm=(float(size * np.cos(angle)), float(size * np.sin(angle))),
            )
        )
    return made


def main() -> None:
    """Render, reconstruct, compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--design", default="default")
    parser.add_argument("--friction", type=float, default=0.8)
    parser.add_argument("--presses", type=int, default=24)
    parser.add_argument("--columns", type=int, default=320)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    design = sensor(args.design, args.friction)
    simulator = Simulator(design, columns=args.columns, seed=args.seed)
    untouched = simulator.frame(None)
    protocol = EvaluationProtocol(design, exposure(design, untouched), args.seed)
    background = np.asarray(protocol.picture(untouched, 0), dtype=float)
    taught = teach_on_model(SensorModel.of(design), background, seed=args.seed + 1)
    print("\n".join((*taught.notes, *taught.warnings)))
    reconstructor, errors, scores = Reconstructor(taught.kept), [], []
    modulus = taught.kept.about["modulus_mpa"]
    for number, press in enumerate(presses(args.presses, args.seed, design.sensing_area_mm)):
        frame = simulator.frame(press)
        assert frame.mechanics is not None
        shape = reconstructor(np.asarray(protocol.picture(frame, 1 + number), dtype=float))
        true = np.array(frame.mechanics.shear_force_n)
        if shape.markers is None or shape.markers.shear is None:
            print(f"{press.probe.text}: no shear found: {shape.warnings}", flush=True)
            errors.append(1.0)
            continue
        shear = shape.markers.shear
        found, error = np.array(shear.force_n(modulus)), np.array(shear.error_n(modulus))
        errors.append(float(np.hypot(*(found - true)) / np.hypot(*true)))
        scores.append((found - true) / error)
        print(
            f"{press.probe.text:12} {press.depth_mm:.2f} mm  true {true[0]:+.3f} {true[1]:+.3f} N  found "
            f"{found[0]:+.3f} {found[1]:+.3f} +- {error[0]:.3f} N  off {errors[-1]:.0%}  force "
            f"{frame.mechanics.force_n:.2f} {shape.force_n(modulus):.2f} N",
            flush=True,
        )
    within = np.mean(np.array(errors) <= WITHIN)
    print(f"{within:.0%} of {len(errors)} within {WITHIN:.0%}; median {np.median(errors):.1%}")
    print(f"errors over their stated standard errors: {np.sqrt(np.mean(np.square(scores))):.1f}")


if __name__ == "__main__":
    main()
