"""Studies as scripts: what they conclude follows from what was evaluated."""

import importlib.util
from types import ModuleType

import numpy as np
import pytest

from designlab.sensor.design import preset
from designlab.sensor.gel_materials import gel_material
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from geometries.probes import parse
from tests import ROOT
from tests.helpers.scores import Estimate, Score


@pytest.fixture(scope="module")
def study() -> ModuleType:
    specification = importlib.util.spec_from_file_location("gel_thickness", ROOT / "studies/gel_thickness.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def evaluated(calls, *, lateral=lambda h: 0.1 * h):
    """An evaluator of closed form, which notes what it is asked for."""

    def score(design, *, fidelity, seed):
        h, led = design.elastomer.thickness_mm, design.leds.height_mm
        calls.append((h, led, design.contact.gel))
        values = {
            "lateral_resolution_mm": lateral(h),
            "normal_error_median_deg": 1.0,
            "saturation_depth_mm": 0.6,
            "force_at_depth_n": 0.5 / h,
            "force_resolution_mn": 10.0,
            "uniformity_u0": 0.1 * led / h,
        }
        return Score({name: Estimate(value, se=0.01) for name, value in values.items()})

    return score


@pytest.mark.slow
def test_one_gel_is_simulated_and_the_others_follow_from_their_moduli(study, tmp_path):
    calls = []
    trade = study.run(tmp_path, thickness_mm=(1.0, 2.0), led_height_mm=(4.5, 6.0), evaluator=evaluated(calls))
    assert sorted(calls) == [(h, led, study.GELS[0]) for h in (1.0, 2.0) for led in (4.5, 6.0)]
    table = trade.table.set_index(["gel", *study.FIELDS])
    assert len(table) == 4 * len(study.GELS)
    # The force of the harder gel as its own contact gives it, and not only by the ratio.
    for h, depth_mm in ((1.0, 0.5), (2.0, 0.6)):
        base = preset(study.BASE).replace({"contact.gel": "solaris"})
        row = table.loc[("solaris", h, 6.0)]
        assert row["depth_range_mm"] == depth_mm  # half the thickness, and where slopes saturate
        assert row["force_range_n"] == pytest.approx(study.ball_force_n(base, h, depth_mm), rel=1e-6)
        ratio = gel_material("solaris").modulus_mpa / gel_material(study.GELS[0]).modulus_mpa
        assert row["force_resolution_mn"] == pytest.approx(10 * ratio)
        assert row["force_resolution_mn_se"] == pytest.approx(0.01 * ratio)
        assert row["lateral_resolution_mm"] == pytest.approx(0.1 * h)
    assert table.loc[("solaris", 1.0, 6.0)]["force_range_n_se"] == 0
    assert table.loc[("solaris", 2.0, 6.0)]["force_range_n_se"] > 0
    assert (tmp_path / "designs.csv").is_file()
    assert (tmp_path / "trade.png").stat().st_size > 20_000
    study.run(tmp_path, thickness_mm=(1.0, 2.0), led_height_mm=(4.5, 6.0), evaluator=evaluated(calls))
    assert len(calls) == 4  # the same call again goes on


@pytest.mark.parametrize("probe", ["sphere:4", "star:6"])
def test_gels_of_one_ratio_have_the_same_membrane(study, probe):
    soft, *harder = (
        indent(
            design.elastomer,
            design.contact,
            Press(probe=parse(probe), depth_mm=0.35),
            area_mm=(10, 8),
            pitch_mm=0.1,
        )
        for design in (preset(study.BASE).replace({"contact.gel": gel}) for gel in study.GELS)
    )
    for hard in harder:
        assert np.abs(hard.height_mm - soft.height_mm).max() < 1e-9
        assert hard.mechanics.force_n > 2 * soft.mechanics.force_n


def test_conclusions_are_those_of_the_table(study, tmp_path):
    thickness, leds, light, gels, chosen = study.run(
        tmp_path, thickness_mm=(1.0, 2.0), led_height_mm=(4.5, 6.0), evaluator=evaluated([])
    ).conclusions
    assert thickness.startswith("Thicker gel (1 to 2 mm): lateral resolution 0.1 to 0.2 mm; ")
    assert "normal error 1 to 1 deg, within its error" in thickness
    assert "lateral resolution 0.15 to 0.15 mm, within its error" in leds
    assert light == ("Evenest light by thickness: 1 mm: LEDs at 6 mm, U0 0.60; 2 mm: LEDs at 6 mm, U0 0.30.")
    assert "11 times the force range" in gels  # 0.55 over 0.050 MPa
    assert "1 mm of solaris" in chosen


def test_other_designs_give_other_conclusions(study, tmp_path):
    coarse = evaluated([], lateral=lambda h: 0.4 / h)
    arguments = {"thickness_mm": (1.0, 2.0), "led_height_mm": (6.0,), "evaluator": coarse}
    thickness, leds, *_, chosen = study.run(tmp_path, **arguments, force_n=0.3).conclusions
    assert "lateral resolution 0.4 to 0.2 mm;" in thickness
    assert leds == "Higher LEDs: one value alone, 6 mm."
    assert "2 mm of dragon-skin-10" in chosen  # of those that take 0.3 N the finest, then the softest
    *_, none = study.run(tmp_path, **arguments, force_n=50.0).conclusions
    assert none.startswith("None of these takes 50 N")


def test_gels_of_different_ratios_are_refused(study, tmp_path):
    with pytest.raises(ValueError, match=r"gels: must have one Poisson's ratio .* 'xp-565' has 0.485"):
        study.run(
            tmp_path,
            thickness_mm=(2.0,),
            led_height_mm=(6.0,),
            gels=("solaris", "xp-565"),
            evaluator=evaluated([]),
        )
