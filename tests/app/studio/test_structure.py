"""LED groups and a mirror are added and taken away, with undo, and an address keeps them."""

import pytest

from designlab.app.studio.controls import parts
from designlab.app.studio.session import NotAllowed, Session
from designlab.app.studio.snippets import python_lines
from designlab.app.studio.structure import MOST_GROUPS, widest_gap_deg
from designlab.app.studio.url_state import Address, address_of, query_of
from designlab.sensor.design import DesignError, preset, preset_names


def session(name="default"):
    return Session(name, preset(name))


def reloaded(tab):
    """The session that the address of another one states."""
    found = session(tab.source)
    found.restore(address_of(query_of(Address(tab.source, tab.edits))).edits)
    return found


@pytest.mark.parametrize("name", preset_names())
def test_a_group_that_is_added_is_like_another_and_undo_takes_it_away(name):
    tab = session(name)
    count = len(tab.design.leds.groups)
    tab.change("leds.groups.1.flux_mw", 3.0)
    tab.add_group(1)
    old, new = tab.design.leds.groups[1], tab.design.leds.groups[-1]
    assert len(tab.design.leds.groups) == count + 1
    assert new.name not in tab.design.group_names[:-1]
    assert (new.flux_mw, new.wavelength_nm) == (3.0, old.wavelength_nm)
    assert (tab.design.mixing_matrix[:, 1] == tab.design.mixing_matrix[:, -1]).all()
    assert {part.key for part in parts(tab.design)} >= {f"leds.groups.{n}" for n in range(count + 1)}
    assert reloaded(tab).design.digest == tab.design.digest
    tab.undo()
    assert len(tab.design.leds.groups) == count


@pytest.mark.parametrize(("name", "index"), [("default", 0), ("pbr-fingertip-like", 1), ("digit-like", 2)])
def test_a_group_that_is_taken_away_leaves_the_others_as_they_were(name, index):
    tab = session(name)
    for group in range(3):
        tab.change(f"leds.groups.{group}.flux_mw", 2.0 + group)
    kept = [group for number, group in enumerate(tab.design.leds.groups) if number != index]
    columns = [number for number in range(3) if number != index]
    mixing = tab.design.mixing_matrix[:, columns]
    before = tab.design.digest
    tab.remove_group(index)
    assert list(tab.design.leds.groups) == kept
    assert (tab.design.mixing_matrix == mixing).all()
    assert reloaded(tab).design.digest == tab.design.digest
    tab.undo()
    assert tab.design.digest == before


def test_fields_of_a_group_that_was_added_can_be_turned_and_a_removal_keeps_them():
    tab = session()
    tab.add_group(2)
    tab.change("leds.groups.3.wavelength_nm", 620.0)
    tab.remove_group(0)
    assert [group.name for group in tab.design.leds.groups] == ["green", "blue", "blue2"]
    assert tab.design.leds.groups[2].wavelength_nm == 620.0
    assert reloaded(tab).design.digest == tab.design.digest
    scope = {}
    exec(python_lines("default", tab.changes, None).split("frame =")[0], scope)
    assert scope["design"].digest == tab.design.digest


@pytest.mark.parametrize("name", ["gelsight-2020-flat", "digit-like", "gelslim-3-like"])
def test_a_mirror_folds_the_way_of_the_light_and_the_picture_stays(name):
    tab = session(name)
    before = tab.design.camera
    broken = set(tab.design.broken())
    tab.fold()
    assert tab.design.camera.eye_mm == pytest.approx(before.position_mm)
    assert tab.design.camera.eye_tilt_deg == pytest.approx((0.0, 0.0), abs=1e-9)
    assert set(tab.design.broken()) <= broken
    tab.change("camera.mirror.reflectance", 0.8)
    assert reloaded(tab).design.digest == tab.design.digest
    tab.fold()
    assert tab.design.camera.mirror is None
    assert tab.design.camera.position_mm == pytest.approx(before.position_mm)


@pytest.mark.parametrize(
    ("rows", "middle"), [([0.0], 180.0), ([90, 210, 330], 150.0), ([350, 10], 180.0), ([0, 0, 200], 100.0)]
)
def test_a_new_row_stands_where_most_room_is(rows, middle):
    assert widest_gap_deg(rows) == middle


@pytest.mark.faults
def test_what_cannot_be_added_or_taken_away_leaves_the_design():
    tab = session("default")  # whose housing has seats
    with pytest.raises(DesignError, match="seats"):
        tab.fold()
    tab = session("gelsight-wedge-like")
    with pytest.raises(DesignError, match="tilt_deg"):
        tab.fold()
    for _ in range(2):
        tab.remove_group(0)
    with pytest.raises(DesignError, match="at least one"):
        tab.remove_group(0)
    for _ in range(MOST_GROUPS - 1):
        tab.add_group(0)
    with pytest.raises(DesignError, match="at most"):
        tab.add_group(0)


@pytest.mark.faults
@pytest.mark.parametrize(
    "edits",
    [
        {"leds.groups": []},
        {"leds.groups": [["red", 7]]},
        {"leds.groups": [["red", -1]]},
        {"leds.groups": [{"name": "red", "profile": {"ies": "/etc/passwd"}}]},
        {"leds.groups": [["<script>", 0], ["green", 1], ["blue", 2]]},
        {"leds.groups": "red"},
        {"leds.groups": [["red", 0]] * 400},
        {"camera.mirror": {"centre_mm": "/etc/passwd"}},
        {"camera.mirror": 3},
    ],
)
def test_an_address_that_states_parts_which_there_are_not_changes_nothing(edits):
    tab = session()
    with pytest.raises((DesignError, NotAllowed)):
        tab.restore(edits)
    assert tab.design == preset("default")
