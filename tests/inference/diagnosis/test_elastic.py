"""Elastic gels are found on sets that another solver of contact has made."""

import pytest

from designlab.inference.diagnosis import diagnose
from designlab.measurement import load_measurement
from designlab.sensor.design import preset
from designlab.validation.synthetic import plant

PLACES = ((-3, -2), (3, -2), (0, 2.5), (-3, 2), (3, 2), (0, 0), (-1.5, -2.5), (1.5, 1))
DEPTHS = (0.5, 0.7, 0.6, 0.8, 0.5, 0.7, 0.6, 0.8)


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
