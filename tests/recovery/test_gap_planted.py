"""Effects hidden by the generator are named and their gap is closed; it shares no code with the analysis."""

import json

import pytest

from designlab.design import preset
from designlab.effects.model import load_model
from designlab.gap import GapReport, diagnose
from designlab.measurement import load_measurement
from designlab.plant import plant, unseal

DESIGN = preset("gelsight-2020-flat")
REMOVED = 0.8
SEED = 20

MIXING = {"R_from_green": 0.15, "R_from_blue": 0.1, "G_from_red": 0.12, "G_from_blue": 0.2}
MIXING |= {"B_from_red": 0.1, "B_from_green": 0.14}
OFFSET = {"radial_mm": 0.6, "height_mm": -0.6, "tangential_mm": 0.5}
CASES = {
    "colour_mixing": (MIXING, 0.005),
    "led_position": (OFFSET, 0.1),
    "contact_kernel": ({"length_ratio": 2.0}, 0.08),
}

pytestmark = pytest.mark.slow


def diagnosed(folder, effects, **options) -> GapReport:
    measurement = folder / "measurement"
    if not measurement.exists():
        plant(DESIGN, effects=effects, out=measurement, seed=SEED, kit="small", columns=64)
    return diagnose(load_measurement(measurement), DESIGN, out=folder / "report", seed=SEED, **options)


@pytest.mark.parametrize("name", CASES)
def test_hidden_effect_is_named_and_its_gap_closed(tmp_path, name) -> None:
    values, tolerance = CASES[name]
    report = diagnosed(tmp_path, {name: values})
    assert unseal(tmp_path / "measurement")["effects"] == {name: values}
    assert report.verdict == "named"
    assert [effect.name for effect in report.effects] == [name]
    assert report.effects[0].coherence_set == (name,)
    final = report.gap["final"]
    assert final.before - final.after > REMOVED * (final.before - final.floor)
    for parameter, value in report.effects[0].parameters.items():
        assert value.value == pytest.approx(values[parameter], abs=tolerance), parameter
        assert value.low < value.value < value.high
    updated = load_model(report.model)
    assert updated.digest == report.updated.digest
    assert [applied.name for applied in updated.effects] == [name]
    written = json.loads((tmp_path / "report" / "report.json").read_text())
    assert written == json.loads(json.dumps(report.to_json()))
    assert sum(place.share for place in report.where) > 0.8
    assert all((tmp_path / "report" / picture).is_file() for picture in report.pictures)


def test_nothing_hidden_nothing_named(tmp_path) -> None:
    report = diagnosed(tmp_path, {})
    assert report.verdict == "at_floor"
    assert report.effects == ()
    assert report.updated.effects == ()
    for level in report.gap.values():
        assert level.after == level.before
        assert level.after < level.floor


def test_hidden_effect_that_is_not_in_the_catalogue_is_not_explained_away(tmp_path) -> None:
    known = ["contact_kernel", "colour_mixing"]
    report = diagnosed(tmp_path, {"led_position": OFFSET}, catalogue=known)
    assert report.verdict in ("unexplained", "partial")
    if report.verdict == "unexplained":
        assert report.effects == ()
    assert report.gap["final"].after > 2 * report.gap["final"].floor
    assert report.next_measurement


def test_an_interrupted_diagnosis_goes_on_where_it_stopped(tmp_path) -> None:
    class Stop(Exception):
        pass

    seen = []

    def interrupt(stage: str, done: int, total: int) -> None:
        assert 0 <= done <= total
        seen.append(stage)
        if stage == "match before":
            raise Stop

    with pytest.raises(Stop):
        diagnosed(tmp_path, {}, progress=interrupt)
    out = tmp_path / "report"
    assert "registering" in seen
    assert not (out / "report.json").exists()
    assert not (out / "model.toml").exists()
    kept = len(list((out / "renders").iterdir()))
    resumed = diagnosed(tmp_path, {})
    rendered = resumed.provenance["rendered"]
    assert kept > 10
    assert len(list((out / "renders").iterdir())) == kept + rendered
    fresh = diagnosed(tmp_path, {}, resume=False)
    assert fresh.provenance["rendered"] == kept + rendered
    assert fresh.to_json() | {"provenance": None} == resumed.to_json() | {"provenance": None}
