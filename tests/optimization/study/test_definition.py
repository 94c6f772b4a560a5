"""Studies as data: files, fields that cannot vary as asked, digests."""

import shutil
from pathlib import Path

import pytest

from designlab.core.fields import unit_of
from designlab.evaluation.illumination_scores import SCORES
from designlab.optimization.constraint import Bound
from designlab.optimization.study import Parameter, Plan, Study, StudyError, dumps_study, load_study
from designlab.optimization.study.defaults import default_parameters
from designlab.sensor import design as designs
from designlab.sensor.design import preset
from tests import ROOT
from tests.helpers.studies import OBJECTIVES, RANGES, make, write

HEAD = 'version = 1\nbase = "gelsight-2020-flat"\n'


def test_a_study_file_is_read_with_defaults_and_written_back(tmp_path):
    text = (
        HEAD
        + "[parameters.leds.tilt_deg]\nlow = 0\nhigh = 60\n[parameters.leds.height_mm]\nchoices = [6, 8]\n"
    )
    study = load_study(write(tmp_path, text))
    assert set(study.parameters) == {"leds.tilt_deg", "leds.height_mm"}
    assert study.parameters["leds.tilt_deg"].high == 60
    assert study.objectives == OBJECTIVES
    assert study.base == preset("gelsight-2020-flat")
    again = load_study(write(tmp_path, dumps_study(study)))
    assert again == study
    assert again.digest == study.digest


def test_a_design_file_is_found_beside_the_study_file(tmp_path):
    design = preset("gelsight-2020-flat").replace({"leds.tilt_deg": 7.0})
    (tmp_path / "mine.toml").write_text(designs.dumps(design), encoding="utf-8")
    text = 'version = 1\nbase = "mine.toml"\n[parameters.leds.tilt_deg]\nlow = 0\nhigh = 60\n'
    assert load_study(write(tmp_path, text)).base == design


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEAD.replace("1", "2"), r"field version: has format version 2, this designlab reads 1"),
        ('base = "default"\n', r"field version: has no format version, this designlab reads 1"),
        ("version = 1\nbase = ", r"study-file\.toml: not valid TOML"),
        (HEAD + "parameters = {}\n", r"study-file\.toml: field parameters: give at least one$"),
        ("version = 1\n", r"study-file\.toml: field base: Field required"),
        (
            HEAD + "trails = 3\n[parameters.leds.tilt_deg]\nlow = 0\nhigh = 1\n",
            r"field trails: unknown field",
        ),
        (
            HEAD + "[parameters.leds.tilt_deg]\nlow = 0\nhigh = 100\n",
            r"field parameters: leds\.tilt_deg: .*less than or equal to 90, got 100\.0",
        ),
        (HEAD + "[parameters.leds.tilt]\nlow = 0\nhigh = 1\n", r"no field 'leds\.tilt' in a design"),
        (
            HEAD + '[parameters.optics.gelcore_material]\nchoices = ["acrylic", "chalk"]\n',
            r"field parameters: optics\.gelcore_material: .*chalk",
        ),
        (
            HEAD + "[parameters.leds.groups.0.count]\nlow = 1\nhigh = 3.5\n",
            r"field parameters: leds\.groups\.0\.count: .*integer.*got 3\.5",
        ),
        (
            HEAD + "[parameters.leds.tilt_deg]\nlow = 9\nhigh = 3\n",
            r"field parameters\.leds\.tilt_deg: low must be below high, got low 9, high 3",
        ),
        (
            HEAD + "[parameters.leds.tilt_deg]\nlow = 0\nhigh = 3\nlog = true\n",
            r"logarithmic range needs low above 0, got low 0",
        ),
        (HEAD + "[parameters.leds.tilt_deg]\nlow = 0\n", r"give low and high, or choices"),
        (HEAD + "[parameters.leds.tilt_deg]\nlow = 0\nchoices = [1]\n", r"either choices, or low and high"),
        (
            'version = 1\nbase = "nonesuch"\n[parameters.leds.tilt_deg]\nlow = 0\nhigh = 1\n',
            r"base: nonesuch: no such file, and no preset of that name",
        ),
    ],
)
def test_a_bad_study_file_is_refused_by_file_field_and_rule(tmp_path, text, message):
    with pytest.raises(StudyError, match=message) as caught:
        load_study(write(tmp_path, text))
    assert "study-file.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_parameters_are_not_guessed_around_a_base_that_cannot_be_built(tmp_path):
    base = preset("gelsight-2020-flat").replace({"leds.height_mm": 60.0})
    (tmp_path / "high.toml").write_text(designs.dumps(base), encoding="utf-8")
    with pytest.raises(StudyError, match=r"parameters: give at least one; none .* breaks leds_below_plate"):
        load_study(write(tmp_path, 'version = 1\nbase = "high.toml"\n'))


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("gelsight-2020-flat", {"leds.radius_mm", "leds.tilt_deg", "leds.emitting_width_mm"}),
        (
            "gelsight-2020-flat-core",
            {"leds.emitting_width_mm", "gelcore.paint_reflectance", "gelcore.side_finish"},
        ),
        ("gelsight-2020-dome-core", {"leds.radius_mm", "leds.tilt_deg", "leds.emitting_width_mm"}),
        ("default", {"leds.radius_mm", "leds.tilt_deg", "leds.pitch_mm"}),
    ],
)
def test_a_study_that_says_no_more_than_its_base_varies_the_light_as_far_as_can_be_built(
    tmp_path, name, fields
):
    study = load_study(write(tmp_path, f'version = 1\nbase = "{name}"\n'))
    assert {"leds.height_mm", *fields} <= set(study.parameters)
    assert ("leds.tilt_deg" in study.parameters) == (study.base.leds.coupling == "air_gap")
    own = study.start()
    assert own is not None
    assert study.design(own) == study.base
    for path, parameter in study.parameters.items():
        for end in parameter.extremes:
            assert not study.design(own | {path: end}).broken(), (path, end)
    assert load_study(write(tmp_path, dumps_study(study))) == study


def test_three_lines_constrain_and_confirm(tmp_path):
    study = load_study(write(tmp_path, 'version = 1\nbase = "gelsight-2020-flat"\ntrials = 8\n'))
    assert study.constraints == {"coverage": Bound(least=0.95), "saturation_share": Bound(most=0)}
    assert study.plan == Plan(promoted=8, confirmed=3, seeds=2)
    study.require_scores(SCORES)


def test_default_parameters_leave_alone_what_variants_set():
    variants = {"low": {"leds.height_mm": 6.0}, "high": {"leds": {"height_mm": 9.0, "tilt_deg": 5.0}}}
    study = Study(base=preset("gelsight-2020-flat"), variants=variants)
    assert study.parameters
    assert not {"leds.height_mm", "leds.tilt_deg"} & set(study.parameters)


def test_a_missing_study_file_is_named(tmp_path):
    with pytest.raises(StudyError, match=r"absent\.toml: cannot be read: No such file"):
        load_study(tmp_path / "absent.toml")


def test_elements_of_a_position_can_vary():
    study = make(parameters={"camera.position_mm.2": Parameter(low=35, high=45)})
    before = study.base.camera.position_mm
    assert study.design({"camera.position_mm.2": 40.0}).camera.position_mm == (before[0], before[1], 40.0)
    assert unit_of("camera.position_mm.2") == "mm"


def test_the_digest_ignores_names_and_effort_and_nothing_else():
    study = make()
    assert study.digest == make(name="other", trials=99).digest
    for change in (
        {"seed": 1},
        {"sampler": "random"},
        {"fidelity": "standard"},
        {"objectives": {"height_mae_um": "minimise"}},
        {"parameters": RANGES | {"leds.height_mm": Parameter(low=5, high=13)}},
        {"base": preset("gelsight-2020-flat").replace({"leds.radius_mm": 12.0})},
    ):
        assert make(**change).digest != study.digest
        assert study.differences(make(**change)) == list(change)


FILES = [*sorted((ROOT / "studies").glob("*.toml")), ROOT / "designlab" / "app" / "templates" / "study.toml"]


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_studies_that_come_with_it_start_from_their_base_and_seek_scores_there_are(path, tmp_path):
    """A change of a preset must not put it out of the ranges unnoticed: gains are over the base."""
    if path.parent.name == "templates":
        path = Path(shutil.copy(path, tmp_path))
        (tmp_path / "design.toml").write_text(designs.dumps(preset("default")), encoding="utf-8")
    study = load_study(path)
    start = study.start()
    assert start is not None
    assert study.design(start) == study.base
    study.require_scores(SCORES)


OWN = {
    "leds.groups.0.height_mm": 7.0,
    "leds.groups.1.radius_mm": 13.6,
    "leds.groups.1.tilt_deg": 3.0,
    "leds.groups.2.pitch_mm": 4.4,
}


@pytest.mark.parametrize(
    ("path", "value", "moved"),
    [
        ("leds.height_mm", 6.5, {"leds.groups.0.height_mm": 7.5}),
        ("leds.radius_mm", 13.5, {"leds.groups.1.radius_mm": 13.8}),
        ("leds.tilt_deg", 2.0, {"leds.groups.1.tilt_deg": 5.0}),
        ("leds.pitch_mm", 4.2, {"leds.groups.2.pitch_mm": 4.62}),
    ],
)
def test_default_parameters_move_groups_that_stand_elsewhere_along(path, value, moved):
    parameters = default_parameters(preset("default").replace(OWN))
    assert parameters[path].fields(path, value) == pytest.approx({path: value, **moved})


@pytest.mark.parametrize(("path", "value"), OWN.items())
def test_a_group_of_its_own_place_can_vary(path, value):
    study = make(base=preset("default"), parameters={path: Parameter(low=value - 0.5, high=value + 0.5)})
    group, field = path.split(".")[2:]
    assert getattr(study.design({path: value}).leds.groups[int(group)], field) == value
    assert unit_of(path) == ("deg" if field == "tilt_deg" else "mm")
