"""Where the LEDs stand: the published panels of the 2020 prototype by hand, and the rules of both layouts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geometries.leds import Emitter, LedArray, LedGroup, bodies, emitters, joined_groups

PANELS = LedArray(
    package="panel",
    groups=(
        LedGroup(name="red", azimuth_deg=(90.0,)),
        LedGroup(name="green", azimuth_deg=(210.0,)),
        LedGroup(name="blue", azimuth_deg=(330.0,)),
    ),
    radius_mm=12.59,
    height_mm=8.79,
    tilt_deg=19.0,
    emitting_width_mm=9.0,
    emitting_spans_mm=((-3.12, -0.89), (0.94, 3.17)),
    body_width_mm=9.0,
    body_height_mm=6.4,
    body_thickness_mm=1.5,
)


def array(layout: str, tilt_deg: float = 20.0, count: int = 4) -> LedArray:
    return LedArray.model_validate(
        {
            "layout": layout,
            "groups": [
                {"name": "red", "azimuth_deg": [10.0, 100.0], "count": count},
                {"name": "blue", "azimuth_deg": [250.0], "count": 3},
            ],
            "radius_mm": 14.0,
            "height_mm": 5.0,
            "tilt_deg": tilt_deg,
            "pitch_mm": 4.0,
        }
    )


def test_published_panels() -> None:
    """Strip centres lie at -2.005 and 2.055 mm down the panel; sin 19 deg = 0.325568, cos 19 deg = 0.945519.

    Red stands at +y: y = 12.59 + 0.325568 s, z = 8.79 - 0.945519 s. Blue stands at 330 deg:
    x = 0.866025 (12.59 + 0.325568 s), y = -0.5 (12.59 + 0.325568 s).
    """
    found = emitters(PANELS)
    assert [emitter.group for emitter in found] == [0, 0, 1, 1, 2, 2]
    assert found[0].centre_mm == pytest.approx((0.0, 11.937236, 10.685766), abs=2e-6)
    assert found[1].centre_mm == pytest.approx((0.0, 13.259042, 6.846958), abs=2e-6)
    assert found[0].normal == pytest.approx((0.0, -0.945519, -0.325568), abs=1e-6)
    assert found[0].across == pytest.approx((-1.0, 0.0, 0.0), abs=1e-12)
    assert found[0].down == pytest.approx((0.0, 0.325568, -0.945519), abs=1e-6)
    assert found[5].centre_mm == pytest.approx((11.482667, -6.629521, 6.846958), abs=2e-6)
    assert found[5].normal == pytest.approx((-0.818843, 0.472759, -0.325568), abs=1e-6)
    assert found[5].across == pytest.approx((0.5, 0.866025, 0.0), abs=1e-6)
    for emitter in found:
        assert emitter.area_mm2 == pytest.approx(9.0 * 2.23)


@pytest.mark.parametrize("layout", ["edge", "ring"])
@given(tilt_deg=st.floats(-90, 90), count=st.integers(1, 6))
def test_axes_are_right_handed_and_tilt_leans_to_the_membrane(
    layout: str, tilt_deg: float, count: int
) -> None:
    for emitter in emitters(array(layout, tilt_deg, count)):
        frame = np.array([emitter.across, emitter.down, emitter.normal])
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(np.cross(emitter.across, emitter.down), emitter.normal, atol=1e-12)
        assert emitter.normal[2] == pytest.approx(-np.sin(np.deg2rad(tilt_deg)), abs=1e-12)
        assert emitter.down[2] <= 1e-12
        assert emitter.across[2] == 0.0


def test_edge_row_is_straight_centred_and_looks_one_way() -> None:
    row = np.array([e.centre_mm for e in emitters(array("edge"))[:4]])
    radial = np.array([np.cos(np.deg2rad(10)), np.sin(np.deg2rad(10)), 0.0])
    along = np.array([-radial[1], radial[0], 0.0])
    np.testing.assert_allclose(row @ radial, 14.0)
    np.testing.assert_allclose(row @ along, [-6.0, -2.0, 2.0, 6.0], atol=1e-12)
    np.testing.assert_allclose(row[:, 2], 5.0)
    assert len({emitter.normal for emitter in emitters(array("edge"))[:4]}) == 1


def test_ring_leds_stand_on_the_circle_and_face_the_axis() -> None:
    found = emitters(array("ring"))
    assert len(found) == 2 * 4 + 3
    for emitter in found:
        x, y, _ = emitter.centre_mm
        assert np.hypot(x, y) == pytest.approx(14.0)
        assert np.array([x, y]) @ emitter.normal[:2] == pytest.approx(-14.0 * np.cos(np.deg2rad(20.0)))
    azimuth = np.rad2deg([np.arctan2(e.centre_mm[1], e.centre_mm[0]) for e in found[:4]])
    np.testing.assert_allclose(np.deg2rad(np.diff(azimuth)) * 14.0, 4.0)
    assert azimuth.mean() == pytest.approx(10.0)


def test_one_led_looks_the_same_on_an_edge_and_on_a_ring() -> None:
    assert emitters(array("edge", count=1))[:2] == emitters(array("ring", count=1))[:2]


def corners_in_body(emitter: Emitter, index: int, leds: LedArray) -> np.ndarray:
    """Corners of an emitter in its body's own axes."""
    body = bodies(leds)[index]
    axes = np.array([body.across, body.down, body.normal])
    corners = [
        np.array(emitter.centre_mm)
        + i * emitter.half_width_mm * np.array(emitter.across)
        + j * emitter.half_height_mm * np.array(emitter.down)
        for i in (-1, 1)
        for j in (-1, 1)
    ]
    return (np.array(corners) - body.centre_mm) @ axes.T


@pytest.mark.parametrize("leds", [PANELS, array("edge"), array("ring")], ids=["panels", "edge", "ring"])
def test_emitters_are_flush_with_the_front_of_their_body(leds: LedArray) -> None:
    strips = len(leds.emitting_spans_mm)
    assert len(bodies(leds)) * strips == len(emitters(leds))
    for index, emitter in enumerate(emitters(leds)):
        local = corners_in_body(emitter, index // strips, leds)
        np.testing.assert_allclose(local[:, 2], leds.body_thickness_mm / 2, atol=1e-12)
        assert (np.abs(local[:, 0]) <= leds.body_width_mm / 2 + 1e-9).all()
        assert (np.abs(local[:, 1]) <= leds.body_height_mm / 2 + 1e-9).all()
        assert bodies(leds)[index // strips].groups == (emitter.group,)
        assert emitter.body == index // strips


def rgb(**groups: dict[str, object]) -> LedArray:
    """Three colours in each of four packages, but for what groups have of their own."""
    return LedArray.model_validate(
        {
            "groups": [
                {"name": name, "azimuth_deg": [0.0, 180.0], "count": 2} | groups.get(name, {})
                for name in ("red", "green", "blue")
            ],
            "radius_mm": 14.0,
            "emitting_width_mm": 1.0,
            "emitting_spans_mm": ((-0.5, 0.5),),
        }
    )


@pytest.mark.parametrize("layout", ["edge", "ring"])
@pytest.mark.parametrize("tilt_deg", [0.0, 35.0, 90.0])
def test_groups_at_one_place_share_a_package(layout: str, tilt_deg: float) -> None:
    shared = rgb().model_copy(update={"layout": layout, "tilt_deg": tilt_deg})
    alone = shared.model_copy(update={"groups": shared.groups[:1]})
    boxes, faces = bodies(shared), emitters(shared)
    assert [box.groups for box in boxes] == [(0, 1, 2)] * 4
    assert [box._replace(groups=(0,)) for box in boxes] == list(bodies(alone))
    for group in range(3):
        own = [face._replace(group=0) for face in faces if face.group == group]
        assert own == list(emitters(alone))


def test_azimuths_that_differ_by_turns_are_one_place() -> None:
    found = bodies(rgb(green={"azimuth_deg": [360.0, -180.0]}, blue={"azimuth_deg": [180.0, 720.0]}))
    assert [box.groups for box in found] == [(0, 1, 2)] * 4


def test_some_packages_may_hold_fewer_colours() -> None:
    found = bodies(rgb(green={"azimuth_deg": [0.0]}, blue={"azimuth_deg": [180.0, 90.0]}))
    assert [box.groups for box in found] == [(0, 1), (0, 1), (0, 2), (0, 2), (2,), (2,)]
    assert joined_groups(box.groups for box in found) == [(0, 1, 2)]
    assert joined_groups([(0, 3), (1,), (2, 3), (4, 1)]) == [(0, 2, 3), (1, 4)]


def test_two_leds_of_one_group_share_nothing() -> None:
    assert [box.groups for box in bodies(rgb(red={"azimuth_deg": [0.0, 0.0]}))].count((0,)) == 2


@pytest.mark.parametrize(
    ("offset", "moved"), [((0.8, 0.0), (0.0, 0.8, 0.0)), ((-1.0, 0.5), (0.0, -1.0, -0.5)), (None, (0.0,) * 3)]
)
def test_chips_lie_apart_on_their_package(
    offset: tuple[float, float] | None, moved: tuple[float, float, float]
) -> None:
    """At azimuth 0 the row runs along +y, the package's height down along -z."""
    plain, shifted = rgb(), rgb(green={"offset_mm": offset})
    assert bodies(shifted) == bodies(plain)
    for before, after in zip(emitters(plain), emitters(shifted), strict=True):
        if before.group != 1:
            assert after == before
    before, after = (next(e for e in emitters(a) if e.group == 1) for a in (plain, shifted))
    np.testing.assert_allclose(np.subtract(after.centre_mm, before.centre_mm), moved, atol=1e-12)


@pytest.mark.parametrize("offset", [(1.3, 0.0), (0.0, -1.0), (-2.0, 0.2)])
def test_chips_stay_on_their_package(offset: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match=r"groups\.1\.offset_mm: the strips of group 'green' must stay on"):
        rgb(green={"offset_mm": offset})


@pytest.mark.parametrize(
    ("own", "place"),
    [
        ({"radius_mm": 11.0}, (11.0, 2.0, 4.0, 0.0)),
        ({"height_mm": 7.5}, (14.0, 2.0, 7.5, 0.0)),
        ({"pitch_mm": 6.0}, (14.0, 3.0, 4.0, 0.0)),
        ({"tilt_deg": 30.0}, (14.0, 2.0, 4.0, 30.0)),
        (
            {"radius_mm": 10.0, "height_mm": -3.0, "tilt_deg": -20.0, "pitch_mm": 5.0},
            (10.0, 2.5, -3.0, -20.0),
        ),
    ],
)
def test_a_group_may_stand_elsewhere(own: dict[str, object], place: tuple[float, ...]) -> None:
    """At azimuth 0: radius along x, half a pitch along y, height along z; tilt lowers the normal."""
    x, y, z, tilt_deg = place
    plain, changed = emitters(rgb()), emitters(rgb(blue=own))
    assert [e for e in changed if e.group != 2] == [e for e in plain if e.group != 2]
    last = [e for e in changed if e.group == 2][1]
    np.testing.assert_allclose(last.centre_mm, (x, y, z), atol=1e-12)
    assert last.normal[2] == pytest.approx(-np.sin(np.radians(tilt_deg)))
    whole = rgb().model_copy(update=own)
    assert [e[:7] for e in changed if e.group == 2] == [e[:7] for e in emitters(whole) if e.group == 2]


def test_the_pitch_of_a_ring_is_an_arc_of_the_groups_own_circle() -> None:
    ring = rgb(red={"radius_mm": 7.0}).model_copy(update={"layout": "ring"})
    first, second = (np.arctan2(*e.centre_mm[1::-1]) for e in emitters(ring)[:2])
    assert (second - first) * 7.0 == pytest.approx(4.0)
