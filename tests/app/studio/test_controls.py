"""Controls come from the fields' own metadata."""

import math

import pytest

from designlab.app.studio.controls import Control, control_at, numbers_text, parts, read_numbers, slider_range
from designlab.app.studio.rule_fields import RULE_FIELDS
from designlab.sensor.design import preset, preset_names
from designlab.sensor.design_fields import fields
from designlab.sensor.feasibility import RULES


def by_path(design):
    return {control.path: control for part in parts(design) for control in part.controls}


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_has_controls_that_give_its_own_values_back(name):
    design = preset(name)
    for path, control in by_path(design).items():
        if control.kind == "number" and control.value is not None:
            where, value = control.edit(control.value)
            assert design.replace({where: value}).digest == design.digest, path


@pytest.mark.parametrize("name", preset_names())
def test_one_control_is_found_as_it_is_among_all(name):
    design = preset(name)
    for path, control in by_path(design).items():
        assert control_at(design, path) == control
    for path in ("leds", "leds.groups.9.flux_mw", "leds.tilt", "name", "parts", ""):
        assert control_at(design, path) is None


@pytest.mark.parametrize(
    ("path", "unit", "low", "high", "kind"),
    [
        ("leds.tilt_deg", "deg", -90, 90, "number"),
        ("elastomer.thickness_mm", "mm", 0.1, 20, "number"),
        ("leds.groups.1.flux_mw", "mW", 0, 1e6, "number"),
        ("camera.bit_depth", "", 1, 16, "number"),
        ("leds.coupling", "", -math.inf, math.inf, "choice"),
        ("leds.relative_flux", "", -math.inf, math.inf, "switch"),
        ("camera.position_mm", "mm", -math.inf, math.inf, "numbers"),
    ],
)
def test_unit_bounds_and_kind_are_those_of_the_field(path, unit, low, high, kind):
    control = by_path(preset("default"))[path]
    assert (control.unit, control.kind) == (unit, kind)
    assert control.low == pytest.approx(low, abs=1e-5)
    assert control.high == pytest.approx(high, abs=1e-5)
    assert control.meaning


def test_meanings_are_those_of_the_reference():
    known: dict[str, set[str]] = {}
    for line in fields(type(preset("default"))):
        known.setdefault(line.path, set()).add(line.meaning)
    told = 0
    for path, control in by_path(preset("default")).items():
        bare = ".".join(part for part in path.split(".") if not part.isdigit())
        if bare in known:  # spectra and filters are picked by name here, and are tables there
            assert control.meaning in known[bare]
            told += 1
    assert told > 100


@pytest.mark.parametrize(
    ("path", "word"),
    [
        ("optics.gelcore_material", "acrylic"),
        ("contact.gel", "gelsight-mini"),
        ("contact.model", "kernel"),
        ("elastomer.shape", "dome"),
        ("camera.lens", "fisheye"),
    ],
)
def test_what_is_picked_comes_from_the_catalogue_or_the_field(path, word):
    control = by_path(preset("default"))[path]
    assert control.kind == "choice"
    assert word in control.choices


def test_no_field_that_names_a_file_can_be_changed():
    for name in preset_names():
        ends = {path.rpartition(".")[2] for path in by_path(preset(name))}
        assert not ends & {"file", "ies", "ldt", "pixels", "content", "parts"}


@pytest.mark.parametrize("name", preset_names())
def test_sliders_stay_within_the_bounds_and_hold_the_value(name):
    for control in by_path(preset(name)).values():
        ends = slider_range(control, control.value if isinstance(control.value, int | float) else None)
        if ends is not None and control.kind == "number":
            low, high, step = ends
            assert control.low <= low + 1e-9
            assert high <= control.high + 1e-9
            assert low - step <= control.value <= high + step
            assert step > 0


@pytest.mark.parametrize(
    ("value", "ends"),
    [(0.0, (-90.0, 90.0)), (20.0, (-90.0, 90.0)), (-45.0, (-90.0, 90.0))],
)
def test_a_slider_of_an_angle_has_the_bounds_of_the_field(value, ends):
    control = Control("a.tilt_deg", "tilt", "deg", "", "number", value, -90.0, 90.0)
    found = slider_range(control, value)
    assert found is not None
    assert found[:2] == ends


@pytest.mark.parametrize("value", [None, (0.0, 120.0), ((-1.0, 1.0), (2.0, 3.0)), (1e-3, 12345.678)])
def test_numbers_are_read_as_they_are_written(value):
    found = read_numbers(numbers_text(value))
    assert (found if found is None else tuple(found)) == value


@pytest.mark.faults
@pytest.mark.parametrize("text", ["1, two", "__import__('os')", "(1, [2", "True, 1", "1; 2", "[" * 3000])
def test_other_texts_are_no_numbers(text):
    with pytest.raises(ValueError, match="must be numbers"):
        read_numbers(text)


def test_each_rule_names_fields_that_there_are():
    assert set(RULE_FIELDS) == set(RULES)
    known = {line.path for line in fields(type(preset("default")))}
    for rule, paths in RULE_FIELDS.items():
        assert paths, rule
        assert set(paths) <= known, rule
