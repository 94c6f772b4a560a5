"""Bonded and embedded LEDs: their seat on or in the core, and where light finds them."""

import numpy as np
import pytest

from designlab.sensor.design import DesignError, InfeasibleDesign, preset
from designlab.sensor.feasibility import tangents
from designlab.sensor.led_mounting import front_corners, seated, sides
from designlab.simulation.contact.indentation import indent
from designlab.simulation.scene.scene import build
from geometries import gelcore
from geometries.leds import bodies

CORE = preset("default")  # hexagon, 26 mm over flats, z 2 to 10 mm; LEDs 2.5 x 2.4 mm at 6 mm
BONDED = CORE.replace({"leds.coupling": "bonded", "leds.radius_mm": 13.0})
EMBEDDED = CORE.replace({"leds.coupling": "embedded", "leds.radius_mm": 11.5})


def seat(design):
    return design.margins()["leds_clear_of_core"]


@pytest.mark.parametrize("design", [BONDED, EMBEDDED], ids=["bonded", "embedded"])
def test_leds_on_and_in_the_core_are_feasible(design):
    design.require_feasible()


@pytest.mark.parametrize(
    ("changes", "margin_mm"),
    [
        ({"leds.radius_mm": 13.05}, 0.05 - 0.1),  # half of the glue's thickness away
        ({"leds.radius_mm": 13.3}, 0.3 - 0.1),
        ({"leds.radius_mm": 13.3, "leds.glue_mm": 0.5}, 0.3 - 0.5),
        ({"leds.radius_mm": 12.8}, 0.2 - 0.001),  # the body cuts into the core
        ({"leds.height_mm": 3.0}, 2.0 - 1.8),  # the emitting face hangs below the core
        ({"leds.height_mm": 9.5}, 10.7 - 10.0),  # and stands above it
    ],
)
def test_a_bonded_face_lies_on_the_cores_side(changes, margin_mm):
    assert seat(BONDED.replace(changes)) == pytest.approx(margin_mm, abs=1e-6)


def test_a_row_longer_than_the_side_is_not_bonded():
    # the side of the hexagon is 15 mm long
    long = BONDED.replace({"leds.pitch_mm": 6.5, "housing.inner_radius_mm": 18.0})
    assert seat(long) > 0
    with pytest.raises(InfeasibleDesign, match=r"leds_clear_of_core: .*leds\.glue_mm"):
        long.require_feasible()


def test_a_tilted_led_is_flush_with_a_drafted_side():
    # the side recedes by tan 10 deg over the 4 mm from the core's lower edge to the LED's middle
    flush = {"leds.radius_mm": 13.0 - 4 * np.tan(np.radians(10.0)), "gelcore.draft_deg": 10.0}
    assert seat(BONDED.replace(flush | {"leds.tilt_deg": 10.0})) <= 0
    assert seat(BONDED.replace(flush | {"leds.tilt_deg": 0.0})) > 0.1


@pytest.mark.parametrize(
    ("changes", "margin_mm"),
    [
        ({"leds.radius_mm": 11.9}, 12.9 - 13.0),
        ({"leds.radius_mm": 12.2}, 13.2 - 13.0),
        ({"leds.height_mm": 3.2}, 2.0 - 1.8),  # reaches into the gel
        ({"leds.height_mm": 8.8}, 10.2 - 10.0),
        ({"leds.height_mm": 0.0}, 3.4),  # lies in the membrane
    ],
)
def test_an_embedded_led_lies_inside_the_core_and_outside_the_gel(changes, margin_mm):
    assert seat(EMBEDDED.replace(changes)) == pytest.approx(margin_mm, abs=1e-6)


def test_an_embedded_led_is_seen_through_the_window():
    # LEDs that look down from 9.5 mm, 1.4 mm half wide: the camera at 24 mm sees them bent at the window
    lying = EMBEDDED.replace(
        {
            "leds.tilt_deg": 90.0, "leds.height_mm": 5.0, "leds.radius_mm": 9.0, "leds.layout": "ring",
            **{f"leds.groups.{k}.count": 1 for k in range(3)},
        }
    )  # fmt: skip
    closer = [
        lying.replace({"leds.radius_mm": r}).margins()["leds_outside_view"] for r in (9.0, 8.0, 7.0, 6.0, 5.0)
    ]
    assert np.all(np.diff(closer) > 0)
    assert closer[-1] > 0
    # Snell forwards, from the camera at 24 mm through the window at 10 mm
    points = np.array([(9.0, 0.0, 5.0), (0.0, -4.0, 3.0), (15.0, 0.0, 12.0)])
    tangent = np.linalg.norm(tangents(lying, points), axis=1)
    in_core = np.tan(np.arcsin(np.sin(np.arctan(tangent[:2])) / 1.49))
    np.testing.assert_allclose(14.0 * tangent[:2] + (10.0 - points[:2, 2]) * in_core, [9.0, 4.0])
    assert tangent[2] == pytest.approx(15.0 / 12.0)  # above the window


@pytest.mark.parametrize("coupling", ["bonded", "embedded"])
def test_coupling_needs_a_core_that_light_sees(coupling):
    with pytest.raises(DesignError, match=r"leds\.coupling: .* needs optics\.light_path = 'core'"):
        preset("gelsight-2020-flat").replace({"leds.coupling": coupling})


def test_side_planes_are_those_of_the_solid():
    for design in (CORE, CORE.replace({"gelcore.draft_deg": 8.0}), CORE.replace({"gelcore.shape": "slab"})):
        vertices = np.array([v.toTuple() for v in gelcore.solid(design.gelcore).val().Vertices()])
        vertices[:, 2] += design.elastomer.thickness_mm
        planes = sides(design)
        # every corner of the solid lies on two of its sides and outside none
        distance = ((vertices[:, None] - planes.points) * planes.normals).sum(axis=-1)
        assert distance.max() < 1e-6
        assert ((np.abs(distance) < 1e-6).sum(axis=1) == 2).all()


def test_an_embedded_led_keeps_clear_of_a_dome_of_gel():
    # the gel's inner sphere, radius 33 mm about z = 35 mm, stands at 35 - sqrt(33^2 - 13^2) at 13 mm
    dome = preset("gelsight-2020-dome").replace(
        {
            "optics.light_path": "core", "leds.coupling": "embedded", "leds.tilt_deg": 0.0,
            "leds.radius_mm": 12.0, "leds.body_width_mm": 1e-3, "leds.emitting_width_mm": 1e-3,
            "leds.body_height_mm": 2.0, "leds.emitting_spans_mm": ((-1.0, 1.0),),
            "leds.body_thickness_mm": 1.0,
        }
    )  # fmt: skip
    above = 35.0 - np.sqrt(33.0**2 - 13.0**2)
    for height in (5.0, 6.0, 7.0):
        margin = seat(dome.replace({"leds.height_mm": height}))
        assert margin == pytest.approx(max(above - (height - 1.0), 13.0 - 15.7), abs=1e-3)


def test_only_bonded_leds_are_moved():
    assert seated(CORE)[0] == list(bodies(CORE.leds))
    assert seated(EMBEDDED)[0] == list(bodies(EMBEDDED.leds))
    for radius in (13.0, 13.08):
        moved, strips = seated(BONDED.replace({"leds.radius_mm": radius}))
        depth = sides(BONDED).distance_mm(np.concatenate([front_corners(body) for body in moved]))
        np.testing.assert_allclose(depth, -2e-3, atol=1e-9)
        assert len(strips) == len(moved)


def test_an_embedded_package_is_a_closed_box_that_faces_outwards():
    surface = indent(EMBEDDED.elastomer, EMBEDDED.contact, None, area_mm=(4, 4), pitch_mm=0.5)
    scene = build(EMBEDDED, surface, EMBEDDED.view(8))
    boards = [shape for shape in scene.shapes if shape.name.startswith("board")]
    assert len(boards) == 9
    for board, body in zip(boards, bodies(EMBEDDED.leds), strict=True):
        a, b, c = (board.vertices[board.faces[:, k]] for k in range(3))
        cross = np.cross(b - a, c - a)
        # divergence theorem: volume of a closed surface
        assert (a * cross).sum() / 6 == pytest.approx(3.0 * 2.8 * 1.0)
        np.testing.assert_allclose(cross[0] / np.linalg.norm(cross[0]), body.normal, atol=1e-9)
    assert all(light.inside for light in scene.lights)
