"""Elastic gels are found on sets that another solver of contact has made."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from designlab.inference.diagnosis import diagnose
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.selection.recentring import is_far
from designlab.measurement import load_measurement
from designlab.sensor.design import preset
from designlab.simulation.effects import effect
from designlab.validation.synthetic import plant

KERNEL = preset("gelsight-2020-flat")
LAYER = effect("contact_layer")
PLACES = ((-3, -2), (3, -2), (0, 2.5), (-3, 2), (3, 2), (0, 0), (-1.5, -2.5), (1.5, 1))
DEPTHS = (0.5, 0.7, 0.6, 0.8, 0.5, 0.7, 0.6, 0.8)


def fitter_of(stands: dict[str, dict[str, float]]) -> Fitter:
    """Knows the parameters of the elastic layer and where its pictures were rendered, and no more."""
    bank = SimpleNamespace(stands=stands)
    forward = SimpleNamespace(parameters={LAYER.name: LAYER.parameters(KERNEL)})
    return cast(Fitter, SimpleNamespace(bank=bank, forward=forward))


def test_the_whole_share_of_a_layer_is_no_bound_to_doubt() -> None:
    state = State(np.ones(3), {LAYER.name: LAYER.null(KERNEL) | {"share": 1.0}})
    fitter = fitter_of({})
    assert Fitter.at_bound(fitter, state, LAYER.name) == ()
    fitter.forward.parameters[LAYER.name] = (replace(LAYER.parameters(KERNEL)[0], whole=False),)
    assert Fitter.at_bound(fitter, state, LAYER.name) == ("share",)


def test_shapes_have_to_settle_where_pictures_were_rendered() -> None:
    there = LAYER.null(KERNEL) | {"share": 0.4}
    thicker = there | {"thickness_mm": there["thickness_mm"] + 0.5}
    state = State(np.ones(3), {LAYER.name: thicker})
    # About null a shape tells nothing; once pictures stand somewhere, half a millimetre off is far.
    assert not is_far(fitter_of({}), replace(state, values={LAYER.name: thicker | {"share": 0.1}}))
    assert is_far(fitter_of({LAYER.name: there}), state)
    assert not is_far(fitter_of({LAYER.name: thicker}), state)


@pytest.mark.full
@pytest.mark.llvm
@pytest.mark.renders
def test_a_thin_gel_is_named_and_measured(tmp_path):
    design = preset("gelsight-2020-flat-elastic")
    presses = [
        {"probe": "sphere:4", "depth_mm": depth, "centre_mm": place}
        for depth, place in zip(DEPTHS, PLACES, strict=True)
    ]
    made = plant(
        design,
        effects={"gel_thickness": {"thickness_ratio": 0.75}},
        out=tmp_path / "set",
        seed=3,
        kit="small",
        columns=40,
        unlisted=False,
        presses=presses,
    )
    report = diagnose(
        load_measurement(made),
        design,
        out=tmp_path / "out",
        seed=1,
        columns=40,
        samples=16,
        catalogue=["gel_thickness", "vignetting"],
    )
    assert report.verdict == "named"
    (found,) = report.effects
    assert found.name == "gel_thickness"
    ratio = found.parameters["thickness_ratio"]
    assert ratio.low <= 0.75 <= ratio.high
    assert ratio.value == pytest.approx(0.75, abs=0.03)
    assert any("contact.poisson would do much the same" in note for note in report.notes)


@pytest.mark.full
@pytest.mark.llvm
@pytest.mark.renders
@pytest.mark.parametrize("thickness_mm", [4.0, 2.5])
def test_a_model_with_a_kernel_is_told_that_its_gel_is_elastic(tmp_path, thickness_mm):
    elastic = preset("gelsight-2020-flat-elastic").replace(
        {
            "elastomer.thickness_mm": thickness_mm,
            "optics.coating_transmittance": 0.0,
            "optics.backing_reflectance": None,
        }
    )
    made = plant(elastic, effects={}, out=tmp_path / "set", seed=11, kit="hour", columns=48, unlisted=False)
    report = diagnose(
        load_measurement(made),
        preset("gelsight-2020-flat"),
        out=tmp_path / "out",
        seed=1,
        columns=48,
        samples=32,
        catalogue=["contact_layer", "contact_kernel", "contact_profile", "point_spread"],
    )
    assert [found.name for found in report.effects] == ["contact_layer"]
    (found,) = report.effects
    for name, true in (
        ("share", 1.0),
        ("thickness_mm", thickness_mm),
        ("skin_length_mm", elastic.contact.skin_length_mm),
    ):
        assert found.parameters[name].value == pytest.approx(true, rel=0.1), name
    assert report.gap["final"].removed > 0.9
