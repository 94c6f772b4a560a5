"""A small measurement of a made sensor, rendered by the simulator that is fitted to it."""

from dataclasses import replace

import numpy as np

from designlab.inference.diagnosis.emulator.rendering import moved
from designlab.inference.diagnosis.emulator.snapshots import Bank
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.measurement.shots import Shot, Use
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.effects import AppliedEffect, SensorModel
from designlab.simulation.simulator import Simulator
from geometries.probes import parse

DESIGN = preset("gelsight-2020-flat")
VIEW = DESIGN.view(40)
GAINS = np.array([1.07, 0.95, 1.02])
NOISE = 0.003  # of the camera, relative
SAMPLES, SEED = 64, 1
VALUES = {
    "led_position": {"radial_mm": 0.3, "height_mm": -0.3, "tangential_mm": 0.2},
    "translucency": {"transmittance": 0.12, "object": 0.5},
    "contact_kernel": {"length_ratio": 1.4},
    "depth_offset": {"offset_mm": -0.08},
    "vignetting": {"corner_loss": 0.5},
    "albedo_field": {"x": 0.03, "y": -0.02, "xx": 0.02, "xy": 0.01, "yy": -0.03},
}
PRESSES = [
    Press(probe=parse("sphere:4"), depth_mm=depth, centre_mm=centre)
    for centre, depth in (((1.5, -1.0), 0.6), ((-3.0, 2.0), 0.4), ((3.0, 2.5), 0.7), ((-2.0, -2.5), 0.5))
]
ERRORS = np.array(
    [[0.03, -0.02, 0.012, 0.0], [-0.04, 0.01, -0.015, 0.0], [0.02, 0.03, 0.0, 0.0], [0.0, -0.03, 0.01, 0.0]]
)


def applied(name: str) -> SensorModel:
    return SensorModel(design=DESIGN, effects=(AppliedEffect(name=name, values=VALUES[name]),))


def taken(model: SensorModel, press: Press | None, error: np.ndarray, use: Use, seed: int) -> Shot:
    """A picture of a model; its membrane is as fine as the bank's."""
    simulator = Simulator(model, view=VIEW, samples=SAMPLES, seed=SEED)
    frame = simulator.frame(None if press is None else moved(press, error))
    light = np.einsum("cg,grk->rkc", frame.weights * GAINS, frame.basis.astype(float))
    sigma = NOISE * light
    return Shot(
        files=(f"{seed}.exr",),
        use=use,
        press=press,
        pose_sigma=np.array([0.05, 0.05, 0.02, 0.0]) if press else np.zeros(4),
        lit=np.ones(3),
        view=VIEW,
        signal=light + sigma * np.random.default_rng(seed).standard_normal(light.shape),
        variance=sigma**2,
        valid=np.ones(light.shape, dtype=bool),
        dark_sigma=np.full(3, 1e-4),
    )


def shots(model: SensorModel) -> tuple[Shot, ...]:
    uses: tuple[Use, ...] = ("train", "train", "select", "final")
    pressed = [
        taken(model, p, e, u, 10 + k) for k, (p, e, u) in enumerate(zip(PRESSES, ERRORS, uses, strict=True))
    ]
    return (taken(model, None, np.zeros(4), "background", 1), *pressed)


def seeing(bank: Bank, model: SensorModel) -> Fitter:
    """A fitter that is shown another sensor."""
    return Fitter(replace(bank, shots=shots(model)[: len(bank.shots)]))
