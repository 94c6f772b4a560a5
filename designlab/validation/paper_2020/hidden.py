"""A hidden sensor departs from its design in light, reflectance, colours, kernel and floor."""

import numpy as np

from designlab.sensor.contact import KernelContact, require
from designlab.sensor.design import CHANNELS, Design
from designlab.simulation.effects.model import AppliedEffect, SensorModel
from designlab.simulation.simulator import Simulator, automatic_exposure

POWER, REFLECTANCE, KERNEL = 0.2, 0.15, 0.15  # relative standard deviations
OVERLAP = 0.12  # most that a channel sees of a foreign group, of what its own gives
FLOOR = (0.005, 0.02)
BRIGHTEST = 0.8  # reflectance


def hidden(nominal: Design, *, seed: int) -> SensorModel:
    """Draw a sensor that was built after a design.

    Powers, reflectances and the kernel differ by 20, 15 and 15 % (standard deviations of their logarithm),
    each channel sees up to 12 % of the foreign LED groups, a floor of 0.5 to 2 % of full scale lies under
    every picture, and the exposure suits the true sensor.
    """
    random = np.random.default_rng([seed, 0])
    groups = len(nominal.leds.groups)
    power = np.exp(POWER * random.standard_normal(groups))
    reflectance = np.exp(REFLECTANCE * random.standard_normal(groups))
    albedo = np.minimum(np.array(nominal.per_group("membrane_albedo")) * reflectance, BRIGHTEST)
    mixing = np.maximum(nominal.mixing_matrix, random.uniform(0.0, OVERLAP, (3, groups)))
    changes: dict[str, object] = {
        f"leds.groups.{g}.flux_mw": group.flux_mw * float(power[g])
        for g, group in enumerate(nominal.leds.groups)
    }
    changes |= {
        "optics.membrane_albedo": [float(a) for a in albedo],
        "mixing": [[float(v) for v in row] for row in mixing],
        "contact.kernel_length_mm": require(nominal.contact, KernelContact).kernel_length_mm
        * float(np.exp(KERNEL * random.standard_normal())),
    }
    design = nominal.replace(changes)
    untouched = Simulator(design, columns=80, samples=16, seed=seed).frame(None).mixed
    design = design.replace({"camera.exposure": automatic_exposure(untouched)})
    floor = {channel: float(random.uniform(*FLOOR)) for channel in CHANNELS}
    return SensorModel.of(design).with_effect(AppliedEffect(name="black_level", values=floor))
