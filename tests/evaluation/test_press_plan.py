"""Which presses an evaluation makes: the same for all designs that are compared."""

import math

import numpy as np
import pytest

from designlab.app import cli
from designlab.evaluation.evaluate import evaluate
from designlab.evaluation.paired_comparison import same_presses
from designlab.evaluation.press_plan import DEPTH_MM, PressPlan
from designlab.report.yardsticks import row
from designlab.sensor.design import InfeasibleDesign, preset, preset_names
from designlab.simulation.contact.indentation import indent
from designlab.simulation.effects.model import AppliedEffect, SensorModel
from designlab.simulation.simulator import Simulator

FLAT = preset("gelsight-2020-flat")
ELASTIC = preset("gelsight-2020-flat-elastic")
PLAN, THIN = PressPlan.of(FLAT), FLAT.replace({"elastomer.thickness_mm": 1.0})


@pytest.mark.parametrize("area_mm", [(16.0, 12.0), (8.0, 6.0), (24.0, 10.0)])
def test_every_press_touches_within_the_sensing_area(area_mm):
    design = FLAT.replace({"sensing_area_mm": area_mm})
    presses = PressPlan.of(design).presses(rounds=2, seed=3)
    assert len(presses.calibration) == 9
    assert len(presses.test) == 12
    for press in [*presses.calibration, *presses.test]:
        surface = indent(design.elastomer, design.contact, press, area_mm=(40.0, 40.0), pitch_mm=0.2)
        rows, columns = np.nonzero(surface.contact)
        assert np.abs(surface.x_mm[columns]).max() < area_mm[0] / 2
        assert np.abs(surface.y_mm[rows]).max() < area_mm[1] / 2


def test_the_seed_decides_the_places_and_more_rounds_keep_the_first():
    once, twice = PLAN.presses(rounds=1, seed=5), PLAN.presses(rounds=2, seed=5)
    assert twice.calibration == once.calibration
    assert twice.test[:6] == once.test
    assert twice.test[6:] != once.test
    assert PLAN.presses(rounds=1, seed=6) != once


def test_presses_do_not_depend_on_the_gel():
    """Thin gels would win every comparison if they were pressed less."""
    thick = FLAT.replace({"elastomer.thickness_mm": 3.0})
    assert PressPlan.of(THIN) == PressPlan.of(FLAT) == PressPlan.of(thick)


@pytest.mark.parametrize("name", preset_names())
def test_presets_are_pressed_by_a_stated_depth(name):
    design = preset(name)
    assert PressPlan.of(design).depth_mm == pytest.approx(DEPTH_MM * min(1, min(design.sensing_area_mm) / 12))


def test_designs_share_the_smallest_area():
    wide, long = (FLAT.replace({"sensing_area_mm": area}) for area in ((20.0, 9.0), (8.0, 12.0)))
    plan = PressPlan.of(wide, long)
    assert plan.area_mm == (8.0, 9.0)
    assert plan.depth_mm == pytest.approx(DEPTH_MM * 8 / 12)
    assert not plan.broken(wide)
    assert not plan.broken(long)
    assert plan.broken(FLAT.replace({"sensing_area_mm": (8.0, 8.5)})) == {"press_area": 0.5}


def test_a_design_that_cannot_take_the_presses_says_so():
    plan = PressPlan.of(FLAT, depth_mm=1.2)
    assert plan.broken(THIN) == {"press_depth": pytest.approx(0.21)}
    assert not plan.broken(FLAT)
    said = "press_depth: the gel is thicker .* presses are up to 1.2 mm deep, elastomer.thickness_mm is 1"
    with pytest.raises(InfeasibleDesign, match=said) as caught:
        evaluate(THIN, presses=plan)
    assert caught.value.broken == plan.broken(THIN)


def test_a_depth_out_of_bounds_is_refused_in_one_line(capfd):
    assert cli.main(["evaluate", "gelsight-2020-flat", "--depth-mm", "-1"]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert "presses: field depth_mm: Input should be greater than 0, got -1.0" in line


def test_equal_force_goes_deeper_into_a_thick_gel_and_heights_are_told_with_depths():
    plan = PressPlan.of(ELASTIC, force_n=1.0)
    balls = {press.force_n for press in plan.presses(rounds=1, seed=0).calibration}
    tests = {press.force_n for press in plan.presses(rounds=1, seed=0).test}
    assert (balls, tests) == ({1.0, 0.6}, {0.7})
    press, depths = plan.presses(rounds=1, seed=0).test[0], []
    for thickness_mm in (1.5, 3.0):
        gel = ELASTIC.elastomer.model_copy(update={"thickness_mm": thickness_mm})
        surface = indent(gel, ELASTIC.contact, press, area_mm=(16.0, 12.0), pitch_mm=0.1)
        assert surface.mechanics.force_n == pytest.approx(0.7, rel=2e-4)
        depths.append(surface.mechanics.depth_mm)
    assert depths[1] > 1.1 * depths[0]
    told = row("height_mae_um", {"value": 20.0, "se": 1.0, "unit": "um"}, depths)
    assert told["title"].endswith(f", presses {depths[0]:.2g} to {depths[1]:.2g} mm deep")
    assert (
        "deep" not in row("normal_error_mean_deg", {"value": 5.0, "se": 1.0, "unit": "deg"}, depths)["title"]
    )


@pytest.mark.renders
@pytest.mark.parametrize(
    ("design", "stated", "said"),
    [
        (FLAT, {"force_n": 1.0}, "force_n: needs an elastic gel, contact.model is 'kernel'"),
        (ELASTIC, {"force_n": 900.0}, "force_n: 900 N is not reached; the deepest press"),
    ],
)
def test_a_force_that_a_design_does_not_give_makes_it_infeasible(design, stated, said):
    with pytest.raises(InfeasibleDesign, match=said):
        _ = evaluate(design, presses=PressPlan.of(design, **stated))


def test_a_plan_states_depth_or_force():
    with pytest.raises(ValueError, match=r"^presses: field depth_mm, force_n: state one of them"):
        PressPlan.of(FLAT, depth_mm=0.5, force_n=1.0)
    assert PressPlan.of(FLAT, force_n=1.0).to_json() == {"area_mm": [16.0, 12.0], "force_n": 1.0}


def test_presses_that_an_effect_changes_are_not_called_the_same():
    model = SensorModel(design=FLAT)
    deeper = model.with_effect(AppliedEffect(name="depth_offset", values={"offset_mm": 0.05}))
    assert same_presses(model, SensorModel(design=THIN), PLAN)
    assert not same_presses(model, deeper, PLAN)


@pytest.mark.parametrize("name", [pytest.param("default", marks=pytest.mark.slow), "gelsight-2020-dome"])
def test_what_a_test_press_lifts_ends_within_the_picture(name):
    simulator = Simulator(preset(name), columns=80, samples=1, seed=0)
    for press in PressPlan.of(simulator.design).presses(rounds=4, seed=0).test:
        surface = simulator.surface(press)
        x, y = np.meshgrid(surface.x_mm, surface.y_mm)
        lifted = surface.height_mm > 0.02 * press.depth_mm
        width, height = simulator.design.sensing_area_mm
        assert np.abs(x[lifted]).max() < width / 2, press
        assert np.abs(y[lifted]).max() < height / 2, press


ROUND_AREAS = ((16.0, 12.0), (10.0, 10.0), (8.0, 14.0))


@pytest.mark.parametrize("area_mm", ROUND_AREAS)
def test_every_press_touches_within_a_round_sensing_area(area_mm):
    design = FLAT.replace({"sensing_area_mm": area_mm, "sensing_area_shape": "ellipse"})
    plan = PressPlan.of(design)
    assert not plan.broken(design)
    presses = plan.presses(rounds=3, seed=3)
    places = np.array([press.centre_mm for press in presses.calibration])
    assert np.linalg.norm(places[:, None] - places[None], axis=-1)[np.triu_indices(9, 1)].min() > 0.5
    for press in [*presses.calibration, *presses.test]:
        surface = indent(design.elastomer, design.contact, press, area_mm=(40.0, 40.0), pitch_mm=0.1)
        rows, columns = np.nonzero(surface.contact)
        assert design.sensing_area.holds(surface.x_mm[columns], surface.y_mm[rows]).all()


@pytest.mark.parametrize("size", ROUND_AREAS)
def test_designs_of_both_shapes_share_an_ellipse_and_plans_of_rectangles_stay_as_on_record(size):
    rectangle = FLAT.replace({"sensing_area_mm": size})
    ellipse = rectangle.replace({"sensing_area_shape": "ellipse"})
    assert "area_shape" not in PressPlan.of(rectangle).to_json()
    plan = PressPlan.of(rectangle, ellipse)
    assert plan.to_json()["area_shape"] == "ellipse"
    assert PressPlan.model_validate(plan.to_json()) == plan
    assert not plan.broken(rectangle)
    corner = (math.sqrt(2) - 1) * min(size)  # by which the ellipse cuts the rectangle's corners
    assert PressPlan.of(rectangle).broken(ellipse) == {"press_area": pytest.approx(corner)}
    inner = PressPlan.on((0.7 * size[0], 0.7 * size[1]))
    assert not inner.broken(ellipse)


@pytest.mark.faults
def test_a_plan_of_a_rectangle_is_refused_on_an_ellipse_with_both_sizes():
    ellipse = FLAT.replace({"sensing_area_shape": "ellipse"})
    said = "press_area: .* presses take 16 x 12 mm, the sensing area is ellipse of 16 x 12 mm"
    with pytest.raises(InfeasibleDesign, match=said):
        PLAN.require_possible(ellipse)


def test_a_plan_says_along_what_it_presses_and_plans_on_record_stay_as_they_are():
    assert "direction" not in PLAN.to_json()
    plan = PressPlan.of(FLAT, direction="normal")
    assert {press.direction for kind in plan.presses(rounds=1, seed=0) for press in kind} == {"normal"}
    assert PressPlan.model_validate(plan.to_json()) == plan
    assert plan.text() == f"{PLAN.text()}, along the normal"
    with pytest.raises(ValueError, match="presses: field direction: Input should be 'axis' or 'normal'"):
        PressPlan.of(FLAT, direction="z")
