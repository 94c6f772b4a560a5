"""A gel that is thinner than drawn is found on a set that another solver of contact has made."""

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
