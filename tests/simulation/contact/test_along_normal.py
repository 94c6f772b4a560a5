"""Presses along the normal of a dome, against two spheres that overlap and the same press at the apex."""

import math

import numpy as np
import pytest

from designlab.app import cli
from designlab.sensor.contact import KernelContact, LayerContact
from designlab.sensor.design import dumps, preset
from designlab.simulation.contact.along_normal import turn_of
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from geometries.elastomer import Elastomer
from geometries.probes import parse

R = 12.5
DOME = Elastomer(shape="dome", outline="round", width_mm=24.8, thickness_mm=2.0, radius_mm=R)
SHARP, SMOOTH = KernelContact(kernel_length_mm=0.0), KernelContact()
ELASTIC = LayerContact(gel="custom", modulus_mpa=0.4, poisson=0.49, skin_length_mm=0.05, friction=0.5)
AREA = {"area_mm": (24.0, 24.0), "pitch_mm": 0.05}
TURNS = ((10.0, 0.5), (25.0, 2.4), (35.0, -1.8))


def at(colatitude_deg, azimuth):
    """Place on the dome by its angle from the apex and around the axis (rad)."""
    r = R * math.sin(math.radians(colatitude_deg))
    return r * math.cos(azimuth), r * math.sin(azimuth)


def pressed(probe, gel=DOME, contact=SHARP, **press):
    return indent(gel, contact, Press(probe=parse(probe), **press), **AREA)


def points(surface):
    x, y = np.meshgrid(surface.x_mm, surface.y_mm)
    return np.stack([x, y, surface.z_mm], axis=-1)


@pytest.mark.physics
@pytest.mark.parametrize(("colatitude_deg", "azimuth"), TURNS)
@pytest.mark.parametrize(("diameter_mm", "depth_mm"), [(4.0, 0.3), (6.0, 0.8), (9.0, 0.5)])
def test_a_ball_along_the_normal_meets_the_dome_in_the_lens_of_two_spheres(
    colatitude_deg, azimuth, diameter_mm, depth_mm
):
    """Closed form: the ball's centre lies on the normal, as deep as stated; both spheres meet in a circle."""
    x_mm, y_mm = at(colatitude_deg, azimuth)
    surface = pressed(f"sphere:{diameter_mm}", depth_mm=depth_mm, centre_mm=(x_mm, y_mm), direction="normal")
    r, centre = diameter_mm / 2, np.array([0.0, 0.0, R])
    place = np.array([x_mm, y_mm, R - R * math.cos(math.radians(colatitude_deg))])
    normal = (centre - place) / R
    ball = place - (r - depth_mm) * normal
    found = points(surface)
    away = np.hypot(found[..., 0] - ball[0], found[..., 1] - ball[1])
    top = np.where(away < r, ball[2] + np.sqrt(np.maximum(r**2 - away**2, 0.0)), -np.inf)
    there = np.isfinite(surface.base_mm)
    exact = np.maximum(top - surface.base_mm, 0.0)[there]
    # At the circle the surface has a kink, which cells of 0.05 mm round.
    assert np.abs(surface.height_mm[there] - exact).max() < 0.02
    assert np.sqrt(np.mean((surface.height_mm[there] - exact) ** 2)) < 1e-3
    touched = found[surface.contact]
    apart = R + r - depth_mm
    circle_mm = math.sqrt(r**2 - ((apart**2 + r**2 - R**2) / (2 * apart)) ** 2)
    assert np.linalg.norm(np.cross(touched - place, normal), axis=1).max() == pytest.approx(
        circle_mm, abs=0.06
    )
    deep = (touched - place) @ normal
    assert deep.max() == pytest.approx(depth_mm, abs=2e-3)
    assert touched[deep.argmax()] == pytest.approx(place + depth_mm * normal, abs=0.06)


@pytest.mark.physics
@pytest.mark.parametrize(
    "contact", [SMOOTH, pytest.param(ELASTIC, marks=pytest.mark.slow)], ids=["kernel", "layer"]
)
@pytest.mark.parametrize("probe", ["sphere:4", "cylinder:3", "triangle:4"])
def test_the_imprint_is_that_of_the_apex_turned(contact, probe):
    apex = pressed(probe, contact=contact, depth_mm=0.3, yaw_deg=20.0)
    for colatitude_deg, azimuth in TURNS:
        press = Press(
            probe=parse(probe), depth_mm=0.3, yaw_deg=20.0, centre_mm=at(colatitude_deg, azimuth),
            direction="normal",
        )  # fmt: skip
        surface = indent(DOME, contact, press, **AREA)
        local = turn_of(DOME, press).back(points(surface))
        near = np.hypot(local[..., 0], local[..., 1]) < 3.5
        apart = local[near][:, 2] - apex.sample(apex.z_mm, local[near][:, 0], local[near][:, 1])
        assert np.abs(apart).max() < 3e-3
        assert np.median(np.abs(apart)) < 3e-4
        assert surface.contact.any()
        if surface.mechanics is not None:
            # The free edge of the gel is nearer there.
            assert surface.mechanics.force_n == pytest.approx(apex.mechanics.force_n, rel=0.02)
            assert surface.mechanics.depth_mm == pytest.approx(0.3)


@pytest.mark.parametrize("contact", [SMOOTH, ELASTIC], ids=["kernel", "layer"])
def test_at_the_apex_and_on_a_flat_gel_the_normal_is_the_axis(contact):
    flat = Elastomer(width_mm=26.0, thickness_mm=2.0)
    for gel, centre in ((DOME, (0.0, 0.0)), (flat, (1.0, -2.0)), (flat, (0.0, 3.0))):
        both = [
            pressed("sphere:4", gel, contact, depth_mm=0.4, centre_mm=centre, direction=direction)
            for direction in ("axis", "normal")
        ]
        np.testing.assert_array_equal(both[0].height_mm, both[1].height_mm)


def test_turned_about_the_axis_the_imprint_turns_along():
    first, other = (
        pressed("star:4", contact=SMOOTH, depth_mm=0.3, centre_mm=centre, yaw_deg=yaw, direction="normal")
        for centre, yaw in (((4.0, 0.0), 10.0), ((0.0, 4.0), 100.0))
    )
    np.testing.assert_allclose(np.nan_to_num(np.rot90(first.z_mm)), np.nan_to_num(other.z_mm), atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("force_n", [0.2, 0.5, 1.0])
def test_a_force_along_the_normal_is_met_and_skin_moves_towards_the_axis(force_n):
    at_side = pressed("sphere:4", contact=ELASTIC, force_n=force_n, centre_mm=(6.0, 0.0), direction="normal")
    at_apex = pressed("sphere:4", contact=ELASTIC, force_n=force_n)
    assert at_side.mechanics.force_n == pytest.approx(force_n, rel=1e-3)
    assert at_side.mechanics.depth_mm == pytest.approx(at_apex.mechanics.depth_mm, rel=0.01)
    moved_x, _ = at_side.sideways_mm
    sine = 6.0 / R
    assert moved_x[at_side.contact].min() == pytest.approx(-at_side.mechanics.depth_mm * sine, rel=0.05)


@pytest.mark.faults
@pytest.mark.parametrize(
    ("gel", "contact", "press", "said"),
    [
        (DOME, SHARP, {"centre_mm": at(60, 0.5), "depth_mm": 0.5}, "96.* deg steep .* 80 deg"),
        (DOME, ELASTIC, {"centre_mm": at(55, 1.0), "depth_mm": 0.8}, "press.centre_mm: .* deg steep against"),
        (DOME, SMOOTH, {"centre_mm": (12.45, 0.0), "depth_mm": 0.3}, "press.centre_mm: .* beside the gel"),
        (DOME, SMOOTH, {"centre_mm": (20.0, 0.0), "depth_mm": 0.3}, "press.centre_mm: .* beside the gel"),
        (DOME, SMOOTH, {"centre_mm": (5.0, 0.0), "depth_mm": 2.0}, "depth_mm: .* 2 mm along its normal"),
        (
            Elastomer(
                shape="freeform", outline="round", width_mm=20.0, thickness_mm=4.0,
                profile_mm=((0.0, 0.0), (6.0, 0.5), (11.0, 2.0)),
            ),
            SMOOTH,
            {"centre_mm": (5.0, 0.0), "depth_mm": 0.3},
            "press.direction: 'normal' is simulated on flat gels and domes, elastomer.shape is 'freeform'",
        ),
    ],
)  # fmt: skip
def test_what_heights_cannot_carry_is_refused_by_name(gel, contact, press, said):
    with pytest.raises(ValueError, match=said):
        pressed("sphere:4", gel, contact, direction="normal", **press)


@pytest.mark.faults
@pytest.mark.parametrize("command", ["render", "evaluate", "export"])
def test_an_area_that_reaches_too_far_down_a_flank_is_refused_alike(command, tmp_path, capfd):
    design = preset("gelsight-2020-dome-core").replace(
        {
            "elastomer.radius_mm": 15.5, "gelcore.radius_mm": 13.5, "gelcore.height_mm": 16.0,
            "sensing_area_mm": (30.8, 30.8), "sensing_area_shape": "ellipse",
        }
    )  # fmt: skip
    (tmp_path / "own.toml").write_text(dumps(design))
    more = {
        "render": ["-o", str(tmp_path / "a.png")],
        "evaluate": [],
        "export": ["--out", str(tmp_path / "out")],
    }
    assert cli.main([command, str(tmp_path / "own.toml"), *more[command]]) == 2
    said = capfd.readouterr().err
    assert (
        "sensing_area_on_membrane: the sensing area lies on the membrane, where that is at most 80 deg"
        in said
    )


@pytest.mark.faults
def test_the_command_line_says_what_is_wrong_with_a_press(tmp_path, capfd):
    words = ["render", "digit360-like", "--probe", "sphere:4", "--depth-mm", "0.8", "--direction", "normal"]
    assert cli.main([*words, "--at", "8,5", "-o", str(tmp_path / "a.png")]) == 2
    assert "press.centre_mm: the sphere at (8, 5) mm makes the membrane" in capfd.readouterr().err
    assert cli.main(["render", "default", "--direction", "normal", "-o", str(tmp_path / "a.png")]) == 2
    assert "--probe: needed with --direction" in capfd.readouterr().err
