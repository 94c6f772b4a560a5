"""The state of a tab: changes, undo, what an address keeps of it, and what does the same."""

import pytest

from designlab.app import cli
from designlab.app.studio.opened import opened
from designlab.app.studio.pictures import light_key
from designlab.app.studio.session import NotAllowed, Session, pinned, read_press, usual_press
from designlab.app.studio.snippets import command_lines, python_lines
from designlab.app.studio.url_state import Address, address_of, press_texts, query_of
from designlab.app.studio.views.dialogs import named
from designlab.app.studio.views.stage import membrane_mm, place_of
from designlab.sensor.design import DesignError, load, preset, preset_names

EDITS = [
    {"leds.height_mm": 5.5},
    {"leds.groups.0.azimuth_deg": [80.0, 100.0], "camera.lens": "pinhole"},
    {"contact": {"model": "kernel"}, "contact.kernel_length_mm": 0.1},
    {"leds.tilt_deg": 20.0, "optics.gelcore_index": None, "optics.membrane_albedo": [0.4]},
]


def session(name="default"):
    return Session(name, preset(name))


def turned(tab, edits):
    """Make edits as knobs do; gives the digest after each."""
    for path, value in edits.items():
        if path == "contact":
            path, value = "contact.model", value["model"]
        tab.change(path, value)
        yield tab.design.digest


@pytest.mark.parametrize("edits", EDITS)
def test_undo_and_redo_lead_through_the_same_designs(edits):
    tab = session()
    seen = [tab.design.digest]
    for path, value in edits.items():
        tab.change(
            "contact.model" if path == "contact" else path, value["model"] if path == "contact" else value
        )
        seen.append(tab.design.digest)
    for digest in seen[-2::-1]:
        tab.undo()
        assert tab.design.digest == digest
    assert not tab.can_undo
    for digest in seen[1:]:
        tab.redo()
        assert tab.design.digest == digest
    assert not tab.can_redo


def test_a_knob_that_is_turned_is_one_step_of_undo():
    tab = session()
    for value in (5.0, 5.1, 5.2):
        tab.change("leds.height_mm", value, going_on=True)
    tab.rest()
    tab.change("leds.height_mm", 5.4, going_on=True)
    tab.undo()
    assert tab.design.leds.height_mm == 5.2
    tab.undo()
    assert tab.design == preset("default")


@pytest.mark.faults
@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("leds.tilt_deg", 120.0),
        ("elastomer.thickness_mm", -1.0),
        ("sensing_area_mm", [0.1, 5.0]),
        ("camera.bit_depth", "many"),
    ],
)
def test_a_value_that_breaks_its_field_leaves_the_design(path, value):
    tab = session()
    with pytest.raises(DesignError, match=path.rpartition(".")[2]):
        tab.change(path, value)
    assert tab.design == preset("default")
    assert not tab.can_undo


@pytest.mark.faults
@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("parts", "/etc/passwd"),
        ("optics.albedo_image", {"file": "/etc/passwd"}),
        ("leds.profile.ies", "/etc/passwd"),
        ("name", "<script>"),
        ("optics.gelcore_material", "butter"),
    ],
)
def test_what_is_no_control_cannot_be_changed(path, value):
    with pytest.raises(NotAllowed):
        session().change(path, value)


@pytest.mark.parametrize("edits", EDITS)
def test_an_address_keeps_the_state(edits):
    tab = session()
    press = read_press({"probe": "star:5", "depth_mm": "0.3", "at": "1,-2", "yaw_deg": "20"}, tab.press)
    for path, value in edits.items():
        tab.change(
            "contact.model" if path == "contact" else path, value["model"] if path == "contact" else value
        )
    tab.press = press
    stated = Address("default", tab.edits, press_texts(tab.press), {"leds.tilt_deg": 5}, "gap", "a/b c&d=e")
    found = address_of(query_of(stated))
    assert found.folder == "a/b c&d=e"
    assert found.view == "gap"
    again = session(found.design)
    again.restore(found.edits, read_press(found.press, again.press))
    assert again.design.digest == tab.design.digest
    assert again.press == press
    assert pinned(again, found.pin).design.leds.tilt_deg == 5


def test_addresses_without_and_with_an_unchanged_pin_differ():
    assert address_of(query_of(Address("default"))).pin is None
    assert address_of(query_of(Address("default", pin={}))).pin == {}


@pytest.mark.faults
@pytest.mark.parametrize(
    "query", ["set=", "set=a=b=c", "set=leds.tilt_deg=[", "view=../x", "%00=%ff", "a" * 50000]
)
def test_what_no_address_states_is_left_out(query):
    found = address_of(query)
    assert found.edits == {}
    assert found.view == "design"


@pytest.mark.faults
@pytest.mark.parametrize(
    "texts",
    [{"probe": "egg:4"}, {"probe": "/etc/passwd.stl"}, {"depth_mm": "deep"}, {"at": "1"}, {"depth_mm": "-1"}],
)
def test_presses_that_there_are_not_are_refused(texts):
    with pytest.raises(NotAllowed):
        read_press(texts, usual_press(preset("default")))


@pytest.mark.parametrize("name", preset_names())
def test_the_usual_press_suits_every_preset(name):
    press = usual_press(preset(name))
    assert 0 < press.depth_mm < preset(name).elastomer.thickness_mm


def test_force_is_for_elastic_gels():
    tab = session()
    tab.move_press(depth_mm=None, force_n=1.0)
    tab.push(2.0)
    assert tab.press.force_n == pytest.approx(2.0)
    tab.change("contact.model", "kernel")
    assert tab.press.depth_mm is not None
    with pytest.raises(NotAllowed, match="force"):
        tab.move_press(depth_mm=None, force_n=1.0)


@pytest.mark.parametrize(
    "path",
    [
        "leds.groups.0.flux_mw",
        "leds.groups.1.drive",
        "camera.gain_db",
        "camera.bit_depth",
        "camera.black_level",
    ],
)
def test_what_is_only_mixed_has_the_same_light(path):
    tab = session()
    before = light_key(tab.design)
    tab.change(path, {"camera.bit_depth": 8}.get(path, 0.5))
    assert light_key(tab.design) == before


@pytest.mark.parametrize(
    ("path", "value"),
    [("leds.height_mm", 5.0), ("housing.inner_radius_mm", 18.0), ("elastomer.thickness_mm", 2.5),
     ("camera.position_mm", [0, 0, 25]), ("leds.groups.0.wavelength_nm", 640.0)],
)  # fmt: skip
def test_what_changes_light_has_another_light(path, value):
    tab = session()
    before = light_key(tab.design)
    tab.change(path, value)
    assert light_key(tab.design) != before


@pytest.mark.parametrize("edits", EDITS)
def test_the_python_lines_make_the_same_design(edits):
    tab = session()
    _ = list(turned(tab, edits))
    lines = python_lines("default", tab.edits, tab.press).split("frame =")[0]
    scope = {}
    exec(lines, scope)
    assert scope["design"].digest == tab.design.digest


def test_the_command_line_states_the_press():
    text = command_lines("a b.toml", read_press({"at": "1,2"}, usual_press(preset("default"))))
    assert "render 'a b.toml' --probe sphere:4 --depth-mm 0.5 --at 1,2 -o picture.png" in text


def test_a_saved_design_keeps_its_parent_and_comment(tmp_path):
    tab = session()
    tab.change("leds.height_mm", 5.5)
    path = named(tab.design, "lower", "LEDs 0.5 mm lower").save(tmp_path / "lower.toml")
    found = load(path)
    assert (found.name, found.parent, found.description) == ("lower", "default", "LEDs 0.5 mm lower")
    assert found.digest == tab.design.digest


def test_places_of_the_picture_and_points_of_the_membrane_agree():
    import numpy as np

    x, y = np.meshgrid(np.linspace(-7, 7, 9), np.linspace(5, -5, 9))
    for point in ((0.0, 0.0), (3.3, -2.1), (-7.0, 5.0)):
        assert membrane_mm(place_of(point, x, y), x, y) == pytest.approx(point, abs=1e-6)


def test_what_is_opened_is_told_from_what_lies_there(tmp_path):
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "study.toml").touch()
    (tmp_path / "gap").mkdir()
    (tmp_path / "gap" / "report.json").touch()
    preset("default").save(tmp_path / "mine.toml")
    assert opened("digit-like", tmp_path).address == Address(design="digit-like")
    assert opened("mine.toml", tmp_path).address == Address(design="mine.toml")
    assert opened("study", tmp_path).address == Address(view="study", folder="study")
    assert opened(str(tmp_path / "gap"), tmp_path).address == Address(view="gap", folder="gap")


@pytest.mark.faults
@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["absent.toml"], "absent.toml: no such file"),
        (["/"], "outside the folder that the studio was started in"),
        (["empty"], "holds neither a study"),
        (["--port", "http"], "--port"),
        (["--host", "no such host", "--port", "0"], "--host: must be an address of this machine"),
    ],
)
def test_a_mistake_on_the_command_line_is_told_in_a_line(tmp_path, monkeypatch, capsys, arguments, told):
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    assert cli.main(["studio", *arguments]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert len(said.strip().splitlines()) == 1


@pytest.mark.faults
@pytest.mark.parametrize("thing", ["absent.toml", "empty", "../x.toml"])
def test_what_cannot_be_opened_is_said(tmp_path, thing):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"empty|absent|outside"):
        opened(thing, tmp_path)
