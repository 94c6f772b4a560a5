"""The response to slope, from the light field, against path-traced pictures of a tilted membrane."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.sensor.design import preset
from designlab.simulation.simulator import Simulator

# scalar_rgb has no light field
pytestmark = [pytest.mark.physics, pytest.mark.llvm, pytest.mark.usefixtures("backend"), pytest.mark.renders]
SLOPE, MIDDLE_MM, FADES_MM = 0.03, 1.5, 4.0


def tilted(surface, axis, slope):
    """Undeformed surface with one slope around its middle, which fades to nothing outwards."""
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    fading = np.exp(-((np.hypot(x, y) / FADES_MM) ** 6))
    return replace(surface, height_mm=slope * (x, y)[axis] * fading)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("gelsight-2020-flat", {}),
        ("gelsight-2020-flat", {"optics.coating_specular": 0.5, "optics.coating_roughness": 0.4}),
        ("gelsight-2020-dome", {}),
    ],
)
def test_a_tilted_membrane_answers_as_its_light_field_says(name, changes, axis):
    design = preset(name).replace(changes)
    response = Simulator(design, columns=80, samples=64, seed=0).slope_response()[..., axis]
    traced = Simulator(design, columns=80, samples=128, seed=1, estimator="path")
    flat = traced.surface(None)
    up, down = (traced.frame(None, surface=tilted(flat, axis, s)).basis for s in (SLOPE, -SLOPE))
    found = (up - down) / (2 * SLOPE)
    x, y = traced.rays.x_mm, traced.rays.y_mm
    middle = np.hypot(x, y) < MIDDLE_MM
    for group in range(len(found)):
        # The tilt also lifts one side towards the lights and lowers the other: no change on average.
        miss = (found - response)[group][middle] / up[group][middle].mean()
        random = miss.std() / np.sqrt(middle.sum())
        assert abs(miss.mean()) < 0.01 + 3 * random, group  # the largest responses are 1.2 to 2.6
