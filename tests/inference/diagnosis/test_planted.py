"""Effects hidden by the generator are named and their gap is closed; it shares no code with the analysis."""

import json
from pathlib import Path

import pytest

from designlab.inference.diagnosis import GapReport, diagnose
from designlab.measurement import load_measurement
from designlab.report.diagnosis_folder import write_diagnosis
from designlab.sensor.design import preset
from designlab.simulation.effects.model import load_model
from designlab.validation.synthetic import plant, unseal

DESIGN = preset("gelsight-2020-flat")
REMOVED = 0.8
SEED = 20
# Effects of the camera cost no pictures; of those that do, one is tried unless another is hidden.
TRIED = ("contact_kernel", "vignetting", "point_spread", "veiling_glare")
TRIED += ("banding", "exposure_drift", "fixed_pattern", "colour_mixing", "black_level", "response_curve")

MIXING = {"R_from_green": 0.15, "R_from_blue": 0.1, "G_from_red": 0.12, "G_from_blue": 0.2}
MIXING |= {"B_from_red": 0.1, "B_from_green": 0.14}
OFFSET = {"radial_mm": 0.6, "height_mm": -0.6, "tangential_mm": 0.5}
CASES = {
    "colour_mixing": (MIXING, 0.01),
    "led_position": (OFFSET, 0.05),
    "contact_kernel": ({"length_ratio": 1.4}, 0.08),
    "response_curve": ({"exponent": 1.1}, 0.02),
}

pytestmark = [pytest.mark.recovery, pytest.mark.slow, pytest.mark.renders]


@pytest.fixture(scope="module")
def renders(tmp_path_factory) -> Path:
    """Pictures of the model that all sets of one plan of presses share."""
    return tmp_path_factory.mktemp("renders")


def diagnosed(folder: Path, effects, *, columns: int = 64, **options) -> GapReport:
    measurement = folder / "measurement"
    if not measurement.exists():
        plant(
            DESIGN,
            effects=effects,
            out=measurement,
            seed=SEED,
            kit_seed=1,
            kit="small",
            columns=columns,
            unlisted=False,
        )
    options = {"catalogue": TRIED, "columns": columns, "samples": columns} | options
    return diagnose(load_measurement(measurement), DESIGN, out=folder / "report", seed=SEED, **options)


@pytest.mark.full  # tests/validation/blind/test_benchmark.py has cheaper ones
@pytest.mark.parametrize("name", CASES)
def test_hidden_effect_is_named_and_its_gap_closed(tmp_path, renders, name) -> None:
    values, tolerance = CASES[name]
    tried = TRIED if name in TRIED else (name, *TRIED)
    report = diagnosed(tmp_path, {name: values}, renders=renders, catalogue=tried)
    assert unseal(tmp_path / "measurement")["effects"] == {name: values}
    assert report.verdict == "named"
    assert [effect.name for effect in report.effects] == [name]
    final = report.gap["final"]
    assert final.before - final.after > REMOVED * (final.before - final.floor)
    for parameter, value in report.effects[0].parameters.items():
        assert value.value == pytest.approx(values[parameter], abs=tolerance), parameter
    assert sum(place.share for place in report.where) > 0.8


@pytest.mark.full  # test_kill.py kills one that is cheaper
def test_an_interrupted_diagnosis_goes_on_where_it_stopped(tmp_path) -> None:
    class Stop(Exception):
        pass

    told: list[tuple[str, int]] = []

    def interrupt(stage: str, done: int, total: int) -> None:
        assert 0 <= done <= total
        told.append((stage, done))
        if len(told) > 12:
            raise Stop

    few = {"catalogue": ("contact_kernel", "black_level"), "columns": 32}
    with pytest.raises(Stop):
        diagnosed(tmp_path, {"black_level": {"G": 0.02}}, progress=interrupt, **few)
    out = tmp_path / "report"
    assert not (out / "report.json").exists()
    assert not (out / "model.toml").exists()
    kept = len(list((out / "renders").iterdir()))
    assert kept >= 10
    resumed = diagnosed(tmp_path, {}, **few)
    rendered = resumed.provenance["rendered"]
    assert len(list((out / "renders").iterdir())) == kept + rendered
    assert [effect.name for effect in resumed.effects] == ["black_level"]
    written = write_diagnosis(resumed)
    assert json.loads((out / "report.json").read_text()) == json.loads(json.dumps(written))
    updated = load_model(resumed.model)
    assert updated.digest == resumed.updated.digest
    assert [applied.name for applied in updated.effects] == ["black_level"]
    assert written["pictures"]
    assert all((out / picture).is_file() for picture in written["pictures"])
