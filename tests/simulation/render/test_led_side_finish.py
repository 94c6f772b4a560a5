"""Finish of the sides that LEDs face: limits, two independent ways of tracing, and what is refused."""

import numpy as np
import pytest

from designlab.sensor.design import DesignError, preset
from designlab.simulation.scene.materials import Dielectric, Diffuse
from designlab.simulation.scene.static_parts import core_and_gel
from designlab.simulation.simulator import Simulator

CORE = preset("default")
BONDED = CORE.replace({"leds.coupling": "bonded", "leds.radius_mm": 13.05, "gelcore.side_finish": "polished"})


def mean_light(design, *, estimator="fast", samples=64):
    """Mean of the untouched gel's picture for each LED group."""
    return (
        Simulator(design, columns=24, samples=samples, seed=3, estimator=estimator)
        .frame(None)
        .basis.mean((1, 2))
    )


def lit(design):
    """Materials of the sides, by number."""
    return {s.name: s.material for s in core_and_gel(design) if s.name.startswith("core-side")}


@pytest.mark.parametrize("finish", [None, "polished", "ground"])
def test_the_finish_is_that_of_the_sides_that_leds_face(finish):
    design = CORE.replace({"gelcore.led_side_finish": finish})
    rough = [m.roughness for m in lit(design).values() if isinstance(m, Dielectric)]
    assert rough == [CORE.gelcore.ground_roughness if finish == "ground" else 0.0] * 3
    assert sum(isinstance(m, Diffuse) for m in lit(design).values()) == 3


def test_paint_around_bonded_leds_covers_their_sides():
    design = BONDED.replace({"gelcore.led_side_finish": "painted"})
    assert sum(isinstance(m, Diffuse) for m in lit(design).values()) == 3


@pytest.mark.physics
@pytest.mark.renders
@pytest.mark.usefixtures("backend")
@pytest.mark.slow
def test_a_hardly_rough_side_lets_in_what_a_polished_one_does():
    polished = mean_light(CORE)
    hardly = mean_light(CORE.replace({"gelcore.led_side_finish": "ground", "gelcore.ground_roughness": 0.01}))
    np.testing.assert_allclose(hardly, polished, rtol=0.01)


@pytest.mark.physics
@pytest.mark.renders
@pytest.mark.usefixtures("backend")
@pytest.mark.slow
@pytest.mark.parametrize(
    "roughness", [0.5, *(pytest.param(value, marks=pytest.mark.full) for value in (0.2, 0.9))]
)
def test_photons_and_the_path_tracer_agree_on_ground_sides(roughness):
    design = CORE.replace({"gelcore.led_side_finish": "ground", "gelcore.ground_roughness": roughness})
    photons = mean_light(design)
    paths = mean_light(design, estimator="path", samples=1500)
    np.testing.assert_allclose(photons, paths, rtol=0.05)


@pytest.mark.physics
@pytest.mark.renders
@pytest.mark.usefixtures("backend")
@pytest.mark.slow
def test_black_paint_around_bonded_leds_takes_light_and_white_paint_gives_some_back():
    plain = mean_light(BONDED)
    black = mean_light(BONDED.replace({"gelcore.led_side_finish": "painted"}))
    white = mean_light(
        BONDED.replace({"gelcore.led_side_finish": "painted", "gelcore.paint_reflectance": 0.9})
    )
    assert (black < 0.98 * plain).all()
    assert (white > 1.02 * black).all()


@pytest.mark.faults
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"gelcore.led_side_finish": "painted"}, ["gelcore.led_side_finish", "painted", "bonded"]),
        (
            {"leds.coupling": "embedded", "leds.radius_mm": 11.5, "gelcore.led_side_finish": "ground"},
            ["gelcore.led_side_finish", "embedded", "side_finish"],
        ),
        ({"gelcore.led_side_finish": "sanded"}, ["gelcore.led_side_finish", "sanded"]),
    ],
)
def test_a_finish_that_cannot_be_meant_is_refused(changes, words):
    with pytest.raises(DesignError) as refused:
        CORE.replace(changes)
    for word in words:
        assert word in str(refused.value)
