"""The generator lights a sensor whose groups share packages as each group alone would."""

import numpy as np
import pytest

from designlab.sensor.design import InfeasibleDesign, preset
from designlab.validation.synthetic.backlight import _traced_at_once
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.light import Lighting
from designlab.validation.synthetic.tracing import Tracer
from tests.helpers.shared_packages import AIR, APART, CORE, alone, shared

pytestmark = pytest.mark.physics

PLACES = np.array([[-5.0, 0.0, 3.0], [2.0, -4.0, 0.5]])


@pytest.mark.parametrize("group", [0, 1, 2])
@pytest.mark.parametrize("changes", [{}, {"optics.board_reflectance": (0.6, 0.2, 0.4)}])
def test_light_in_air_is_that_of_the_group_alone(group, changes):
    design = shared(AIR, changes)
    together = Lighting(Rig.of(design)).untouched.irradiance(*PLACES)[group]
    one = Lighting(Rig.of(alone(design, group))).untouched.irradiance(*PLACES)[0]
    np.testing.assert_allclose(together, one, rtol=1e-9)


@pytest.mark.parametrize(
    ("design", "parts"),
    [
        (CORE, [(0, 1, 2)]),
        (shared(CORE), [(0,), (1,), (2,)]),
        (shared(CORE, {"leds.groups.2.azimuth_deg": (30.0,)}), [(0,), (1, 2)]),
    ],
)
def test_faces_on_one_board_are_traced_apart(design, parts):
    assert _traced_at_once(Rig.of(design)) == parts


@pytest.mark.renders
@pytest.mark.llvm
@pytest.mark.parametrize("changes", [{}, APART, {"leds.coupling": "bonded", "leds.radius_mm": 13.0}])
@pytest.mark.parametrize("group", [0, 2])
def test_light_behind_glass_is_that_of_the_group_alone(changes, group):
    design = shared(CORE, changes)
    nodes, cells = np.array([[0.0, 0.0, 1.0], [3.0, -2.0, 0.5]]), np.arange(2 * 512, dtype=np.uint32)
    together = Tracer(Rig.of(design), (group,)).clear(nodes, cells, paths=4, seed=1)
    one = Tracer(Rig.of(alone(design, group)), (0,)).clear(nodes, cells, paths=4, seed=1)
    assert together.max() > 0
    np.testing.assert_allclose(together, one, rtol=1e-5)


@pytest.mark.faults
def test_a_sensor_without_a_shape_is_refused_by_name():
    with pytest.raises(InfeasibleDesign, match="core_radius: "):
        Rig.of(preset("gelsight-2020-dome-core").replace({"gelcore.radius_mm": 15.0}))
