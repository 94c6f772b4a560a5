"""The generator of measurements against closed forms, and the sets it writes."""

import ast
import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.special import j1

import designlab.validation.synthetic
from designlab.core.images import read_image
from designlab.measurement import MeasurementError, load_measurement
from designlab.sensor.camera import View
from designlab.sensor.design import preset
from designlab.simulation.imaging import Capture, noise_sigma
from designlab.validation.synthetic import (
    answer_path,
    capture_plan,
    effects,
    light,
    plant,
    raycast,
    seal_path,
    shadow,
    surface,
    unseal,
)
from designlab.validation.synthetic.effects import colour
from designlab.validation.synthetic.generator_sensor import Cells, Rig, cells
from designlab.validation.synthetic.indenter import Indenter
from designlab.validation.synthetic.surface import HeightField
from geometries import probes
from geometries.elastomer import Elastomer

pytestmark = pytest.mark.physics

FLAT = preset("gelsight-2020-flat")
IN_AIR = [name for name in effects.names() if effects.parameters(name, Rig.of(FLAT))]
DOME = preset("gelsight-2020-dome")
BALL = {"probe": "sphere:4", "depth_mm": 0.8, "centre_mm": [1.0, 0.5], "yaw_deg": 0.0}


def lambert_polygon(point, normal, corners):
    """Irradiance at a point by a polygon of unit radiance (Lambert 1760), corners in order; exact."""
    to = corners - point
    to = to / np.linalg.norm(to, axis=1, keepdims=True)
    total = 0.0
    for a, b in zip(to, np.roll(to, -1, axis=0), strict=True):
        edge = np.cross(a, b)
        total += np.arccos(np.clip(a @ b, -1, 1)) * (edge / np.linalg.norm(edge)) @ normal
    return abs(total) / 2


def corners(rectangles, number):
    centre, across, down = (getattr(rectangles, name)[number] for name in ("centre", "across", "down"))
    half = rectangles.half[number]
    return np.array(
        [centre + s * half[0] * across + t * half[1] * down for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )


@pytest.mark.parametrize("place", [(0.0, 0.0), (7.5, 5.5), (-7.5, 5.5), (0.0, 6.0), (3.0, -9.0)])
def test_irradiance_by_a_panel_is_lamberts_closed_form(place):
    rig = Rig.of(FLAT)
    lighting = light.Lighting(rig)
    normal = np.array([0.1, -0.2, 1.0]) / np.sqrt(1.05)
    point = np.array([*place, 0.0])
    lit = cells(rig.emitters, spacing_mm=light.EMITTER_SPACING_MM)
    power = lighting.power(0)[:, : len(lit.area)]
    found = light.irradiance(point[None], normal[None], lit, power)[:, 0]
    for group in range(3):
        strips = np.nonzero(rig.emitters.group == group)[0]
        area = sum(4 * rig.emitters.half[n].prod() for n in strips)
        exact = sum(lambert_polygon(point, normal, corners(rig.emitters, n)) for n in strips) / (np.pi * area)
        assert found[group] == pytest.approx(exact, rel=5e-4)


def test_light_falls_with_the_square_of_the_distance_and_conserves_flux():
    # Seen along its normal from far away, a Lambertian source of 1 mW gives flux / (pi r^2).
    source = cells(Rig.of(FLAT).emitters, spacing_mm=1.0)
    one = Cells(*(part[source.group == 0] for part in source))
    power = (one.area / (np.pi * one.area.sum()))[None]
    middle, direction = one.centre.mean(axis=0), one.normal[0]
    for distance in (300.0, 600.0):
        point = middle + distance * direction
        found = light.irradiance(point[None], -direction[None], one, power)[0, 0]
        assert found == pytest.approx(1 / (np.pi * distance**2), rel=1e-3)


def lamp(*, azimuth_deg, slope, distance_mm=2000.0):
    """One tiny cell so far away that its light is parallel."""
    away = np.radians(azimuth_deg)
    centre = distance_mm * np.array([[np.cos(away), np.sin(away), slope]])
    normal = -centre / np.linalg.norm(centre)
    return Cells(
        np.array([0]), centre, normal, np.full((1, 3), 1e-6), np.ones(1), np.ones(1), np.zeros(1, int)
    )


@pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 137.0])
@pytest.mark.parametrize("slope", [0.12, 0.3, 0.8])
def test_step_casts_a_shadow_of_height_over_slope(azimuth_deg, slope):
    height, half, pitch = 0.4, 2.0, 0.02
    axis = np.arange(-half - 5 * pitch, half + 5 * pitch, pitch)
    box = np.where((abs(axis[:, None]) < half) & (abs(axis[None]) < half), height, 0.0)
    turned = HeightField(None, x0_mm=axis[0], y0_mm=axis[0], pitch_mm=pitch, height_mm=box)
    lit = lamp(azimuth_deg=azimuth_deg, slope=slope)
    horizon = shadow.Horizon(turned, lit)
    # Walk away from the box, from the middle of its border that lies opposite to the lamp.
    away = -np.array([np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))])
    border = half / np.abs(away).max()
    length = height / slope
    for distance, seen in ((0.05, 0), (length - 0.1, 0), (length + 0.1, 1), (length + 0.5, 1)):
        x, y = (border + distance) * away
        if not horizon.window.contains(x, y):
            assert seen == 1
            continue
        share = horizon.visible_share(
            np.array([x]), np.array([y]), turned.z(np.array([x]), np.array([y])), lit
        )
        assert share[0, 0] == pytest.approx(seen, abs=1e-6)
    x, y = np.zeros(1), np.zeros(1)
    assert horizon.visible_share(x, y, turned.z(x, y), lit)[0, 0] == 1.0


def test_ball_shades_itself_and_the_floor_as_tangents_tell():
    """Parallel light on a half-sunk ball: the terminator and the shadow's tip follow from its circle."""
    radius, depth, slope = 2.0, 1.0, 0.25
    field = surface.indented(
        Elastomer(width_mm=30),
        Indenter(probes.parse("sphere:4"), depth, (0.0, 0.0)),
        kernel_length_mm=0,
        kernel_m=200,
    )
    lit = lamp(azimuth_deg=0.0, slope=slope)
    horizon = shadow.Horizon(field, lit)
    elevation = np.arctan(slope)
    # The tangent ray touches the circle about (0, depth - radius) at the angle 90 deg + elevation from +x.
    touch_x, touch_z = -radius * np.sin(elevation), depth - radius + radius * np.cos(elevation)
    tip = touch_x - touch_z / slope
    x = np.array([touch_x + 0.06, touch_x - 0.06, tip + 0.08, tip - 0.08])
    share = horizon.visible_share(x, np.zeros(4), field.z(x, np.zeros(4)), lit)[:, 0]
    assert share[1] == share[2] == 0.0
    assert share[3] == 1.0
    assert share[0] == 1.0


@pytest.mark.slow
def test_patches_of_a_dome_see_each_other_where_nothing_rises_above_the_way_between_them():
    rig, random = Rig.of(DOME), np.random.default_rng(0)
    pressed = surface.indented(
        rig.elastomer,
        Indenter(probes.parse("triangle:4"), 0.6, (2.0, 1.0), 20.0),
        kernel_length_mm=rig.kernel_length_mm,
        kernel_m=rig.kernel_m,
    )
    lighting = light.Lighting(rig)
    box = pressed.bump.grown(light.FINE_MARGIN_MM)
    coarse = light.coarse_patches(rig, pressed, lighting.coarse, without=box)
    patches = light.Patches(
        *map(np.concatenate, zip(coarse, light.fine_patches(rig, pressed, box)[0], strict=True))
    )
    exchange = light.form_factors(patches, patches)
    seen = lighting.pressed(pressed)._past_the_bump(patches, exchange)
    # Pairs as often as light goes from one to the other; every way is walked in steps of some 20 um.
    pairs = random.choice(exchange.size, 300, p=(exchange / exchange.sum()).ravel())
    clear = []
    for a, b in zip(*np.unravel_index(pairs, exchange.shape), strict=True):
        way = patches.centre[a] + np.linspace(0, 1, 1000)[1:-1, None] * (
            patches.centre[b] - patches.centre[a]
        )
        clear.append((pressed.z(way[:, 0], way[:, 1]) - way[:, 2]).max() < light.GRAZING_MM)
    found = seen.ravel()[pairs]
    assert 0.02 < 1 - np.mean(clear) < 0.3
    assert np.abs(found - clear).mean() < 0.015


def test_transfer_function_of_a_flat_kernel_is_that_of_a_disc():
    # With a large m the kernel is constant up to 6 lengths: 2 J1(k R) / (k R).
    k, radius = np.array([0.5, 3.0, 12.0, 40.0]), 6 * 0.05
    exact = 2 * j1(k * radius) / (k * radius)
    assert surface.transfer(k, kernel_length_mm=0.05, kernel_m=1e9) == pytest.approx(exact, abs=1e-5)


def test_smoothing_keeps_volume_and_halves_an_edge():
    indenter = Indenter(probes.parse("triangle:6"), 0.5, (0.1, -0.2), 30.0)
    elastomer = Elastomer(width_mm=30)
    sharp = surface.indented(elastomer, indenter, kernel_length_mm=0, kernel_m=200)
    soft = surface.indented(elastomer, indenter, kernel_length_mm=0.05, kernel_m=200)
    volume = [field.height_mm.sum() * field.pitch_mm**2 for field in (sharp, soft)]
    assert volume[0] == pytest.approx(np.sqrt(3) / 4 * 36 * 0.5, rel=2e-3)
    assert volume[1] == pytest.approx(volume[0], rel=2e-3)
    # Turned by 30 deg the corner from +y stands at azimuth 120 deg, and the side opposite lies at -60 deg.
    middle = np.array([0.1, -0.2]) + 6 / np.sqrt(12) * np.array([np.cos(-np.pi / 3), np.sin(-np.pi / 3)])
    assert soft.z(middle[:1], middle[1:])[0] == pytest.approx(0.25, abs=0.01)


def test_ball_indentation_is_a_cap_with_its_normals():
    field = surface.indented(
        Elastomer(width_mm=30),
        Indenter(probes.parse("sphere:4"), 0.8, (1.0, -0.5)),
        kernel_length_mm=0,
        kernel_m=200,
    )
    x, y = 1.0 + np.array([0.0, 0.5, -1.0, 0.3]), -0.5 + np.array([0.0, 0.2, 0.4, -1.1])
    centre = np.array([1.0, -0.5, 0.8 - 2.0])
    r2 = (x - 1.0) ** 2 + (y + 0.5) ** 2
    assert field.z(x, y) == pytest.approx(0.8 - 2 + np.sqrt(4 - r2), abs=1e-3)
    outward = (np.stack([x, y, field.z(x, y)], axis=1) - centre) / 2.0
    assert np.degrees(np.arccos((field.normals(x, y) * outward).sum(axis=1))) == pytest.approx(0, abs=0.5)


def test_rays_meet_sphere_and_plane_where_algebra_says():
    view = View(300.0, 200.0, 2000.0, 1500.0, 20, 15)
    rays = raycast.pixel_rays(DOME.camera, view)
    origin = np.array(DOME.camera.position_mm)
    direction = np.stack([rays.tan_x, rays.tan_y, -np.ones_like(rays.tan_x)], axis=1)
    radius = DOME.elastomer.radius_mm
    # The membrane is the far side of a sphere about (0, 0, radius), seen from inside.
    from_centre = origin - np.array([0.0, 0.0, radius])
    a, b, c = (direction**2).sum(1), direction @ from_centre, from_centre @ from_centre - radius**2
    exact = (-b + np.sqrt(b**2 - a * c)) / a
    assert raycast.meet(rays, HeightField(radius)) == pytest.approx(exact, abs=1e-9)
    assert raycast.meet(rays, HeightField(None)) == pytest.approx(origin[2], abs=1e-12)


def test_rays_meet_a_pressed_ball_where_algebra_says():
    field = surface.indented(
        Elastomer(width_mm=30),
        Indenter(probes.parse("sphere:4"), 1.0, (5.0, 3.0)),
        kernel_length_mm=0,
        kernel_m=200,
    )
    camera = FLAT.camera
    px = np.array(FLAT.project_px(5.0, 3.0)) - 60
    rays = raycast.pixel_rays(camera, View(*px, 120.0, 120.0, 12, 12))
    direction = np.stack([rays.tan_x, rays.tan_y, -np.ones_like(rays.tan_x)], axis=1)
    from_centre = np.array(camera.position_mm) - np.array([5.0, 3.0, 1.0 - 2.0])
    a, b, c = (direction**2).sum(1), direction @ from_centre, from_centre @ from_centre - 4.0
    exact = (-b - np.sqrt(b**2 - a * c)) / a
    assert (camera.position_mm[2] - exact > 0.05).all()  # all rays meet the ball, not the floor
    assert raycast.meet(rays, field) == pytest.approx(exact, abs=1e-3)


def test_form_factors_within_a_sphere_depend_on_area_alone():
    rig = Rig.of(DOME)
    patches = light.coarse_patches(
        rig, HeightField(rig.elastomer.radius_mm), light.coarse_grid(rig), without=None
    )
    exchange = light.form_factors(patches, patches)
    exact = np.broadcast_to(patches.area / (4 * np.pi * rig.elastomer.radius_mm**2), exchange.shape)
    distance = np.linalg.norm(patches.centre[:, None] - patches.centre[None], axis=-1)
    far = distance > 6
    np.testing.assert_allclose(exchange[far], exact[far], rtol=0.02)
    cap = 2 * np.pi * 35.0 * (35.0 - np.sqrt(35.0**2 - 15.5**2))
    assert patches.area.sum() == pytest.approx(cap, rel=2e-3)


def test_light_off_the_boards_agrees_with_random_walks():
    """Path lengths 2 and 3 on a flat membrane: emitter, board, membrane point, by plain Monte Carlo."""
    design = FLAT.replace({"optics.path_length": 3})
    place = np.array([2.0, 1.0, 0.0])
    both = light.Lighting(Rig.of(design)).untouched.irradiance(place[:1], place[1:2])
    direct = light.Lighting(Rig.of(FLAT.replace({"optics.path_length": 2}))).untouched.irradiance(
        place[:1], place[1:2]
    )
    rig, random, count = Rig.of(design), np.random.default_rng(0), 200_000

    def points(rectangles, picks):
        u = random.uniform(-1, 1, (len(picks), 2)) * rectangles.half[picks]
        return (
            rectangles.centre[picks] + u[:, :1] * rectangles.across[picks] + u[:, 1:] * rectangles.down[picks]
        )

    def geometry(p, n, q, m):
        d = q - p
        square = (d**2).sum(axis=1) + 1e-12
        return np.maximum((n * d).sum(1), 0) * np.maximum(-(m * d).sum(1), 0) / square**2

    for group in range(3):
        strips = np.nonzero(rig.emitters.group == group)[0]  # of equal size, so drawn alike
        start, board = random.choice(strips, count), random.integers(len(rig.boards.group), size=count)
        p, q = points(rig.emitters, start), points(rig.boards, board)
        board_area = 4 * rig.boards.half[0].prod() * len(rig.boards.group)
        on_board = geometry(q, rig.boards.normal[board], p, rig.emitters.normal[start]) / np.pi
        up = np.broadcast_to([0.0, 0.0, 1.0], q.shape)
        to_point = geometry(np.broadcast_to(place, q.shape), up, q, rig.boards.normal[board]) * board_area
        walks = rig.board_reflectance[group] / np.pi * on_board * to_point
        expected, error = walks.mean(), walks.std() / np.sqrt(count)
        assert error < 0.01 * expected
        assert both[group, 0] - direct[group, 0] == pytest.approx(expected, abs=4 * error + 0.01 * expected)


def test_effects_at_null_change_nothing():
    rig = Rig.of(FLAT)
    for name in effects.names():
        changed, truth = effects.apply(rig, {name: {}})
        for field in ("mixing", "kernel_length_mm", "flux_mw", "face_flux", "exponent", "albedo", "turn"):
            np.testing.assert_allclose(getattr(changed, field), getattr(rig, field), rtol=0, atol=1e-12)
        for field in ("lens", "sensor", "contact", "coat", "camera"):
            assert getattr(changed, field) == getattr(rig, field)
        for part in ("emitters", "boards"):
            np.testing.assert_array_equal(getattr(changed, part).centre, getattr(rig, part).centre)
        assert {p: v.null for p, v in effects.parameters(name, rig).items()} == truth[name]


def test_leds_move_in_their_own_cylindrical_frame():
    rig = Rig.of(FLAT)
    moved, _ = effects.apply(
        rig, {"led_position": {"radial_mm": 0.5, "height_mm": 0.3, "tangential_mm": 0.2}}
    )
    for group, azimuth_deg in enumerate((90, 210, 330)):
        shift = (moved.boards.centre - rig.boards.centre)[rig.boards.group == group][0]
        a = np.radians(azimuth_deg)
        expected = 0.5 * np.array([np.cos(a), np.sin(a), 0]) + 0.2 * np.array([-np.sin(a), np.cos(a), 0])
        assert shift == pytest.approx(expected + np.array([0, 0, 0.3]), abs=1e-12)
        both = (moved.emitters.centre - rig.emitters.centre)[rig.emitters.group == group]
        assert both == pytest.approx(np.tile(shift, (2, 1)), abs=1e-12)


def test_colour_mixing_is_the_overlap_of_spectra_and_filters():
    rig = Rig.of(FLAT)
    # Gaussians of variances s^2 and t^2 at a distance d overlap by exp(-d^2 / 2 (s^2 + t^2)) of their most.
    _, truth = effects.apply(rig, {"colour_mixing": {"filter_width_nm": 40.0}})
    for name, distance in (("G_from_blue", 60.0), ("R_from_green", 100.0), ("B_from_red", 160.0)):
        exact = np.exp(-(distance**2) / 2 / (40.0**2 + colour.LED_SIGMA_NM**2))
        assert truth["colour_mixing"][name] == pytest.approx(exact, rel=1e-6)
    _, leaky = effects.apply(rig, {"colour_mixing": {"filter_width_nm": 5.0, "leak": 0.1}})
    peak = 0.1 + 0.9 * 5 / np.hypot(5, colour.LED_SIGMA_NM)
    assert leaky["colour_mixing"]["B_from_red"] == pytest.approx(0.1 / peak, rel=1e-6)


def test_colour_mixing_adds_exactly_what_was_asked_to_the_design():
    rig = Rig.of(FLAT)
    mixed, truth = effects.apply(rig, {"colour_mixing": {"R_from_green": -0.2, "G_from_blue": 0.35}})
    expected = np.array(FLAT.mixing) + np.array([[0, -0.2, 0], [0, 0, 0.35], [0, 0, 0]])
    assert mixed.mixing == pytest.approx(expected, abs=1e-9)
    assert set(truth["colour_mixing"]) == {
        "R_from_green", "R_from_blue", "G_from_red", "G_from_blue", "B_from_red", "B_from_green"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"ghosts": {}}, ["ghosts", "colour_mixing"]),
        ({"led_position": {"sideways_mm": 1.0}}, ["led_position", "sideways_mm", "radial_mm"]),
        ({"led_position": {"height_mm": 30.0}}, ["height_mm", "-3 and 3 mm", "30"]),
        ({"contact_kernel": {"length_ratio": float("nan")}}, ["length_ratio", "nan"]),
        ({"colour_mixing": {"filter_width_nm": 0.0}}, ["filter_width_nm"]),
    ],
)
def test_unusable_effects_are_named(asked, words):
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the words are checked below
        effects.apply(Rig.of(FLAT), asked)
    assert all(word in str(caught.value) for word in words)


@pytest.mark.parametrize("name", IN_AIR)
def test_draws_have_the_strength_asked_for_and_follow_the_seed(name):
    rig = Rig.of(FLAT)
    known = effects.parameters(name, rig)
    drawn = effects.draw(name, rig, strength=1.5, seed=4)
    steps = [(drawn[p] - v.null) / v.spread for p, v in known.items() if not v.shape]
    assert np.linalg.norm(steps) == pytest.approx(1.5)
    assert all(drawn[p] > v.null for p, v in known.items() if v.one_sided and not v.shape)
    assert effects.draw(name, rig, strength=1.5, seed=4) == drawn
    others = [effects.draw(name, rig, strength=1.5, seed=seed) for seed in range(5, 15)]
    one_sided = len(steps) == 1 and all(v.one_sided for v in known.values())
    assert one_sided or any(other != drawn for other in others)


def made(folder, asked, *, seed=1, design=FLAT, presses=(BALL,), **more):
    return plant(
        design,
        effects=asked,
        out=folder,
        seed=seed,
        presses=presses,
        **{"columns": 40, "noise": False, "unlisted": False, "kit": "small"} | more,
    )


@pytest.fixture(scope="module")
def null(tmp_path_factory):
    return load_measurement(made(tmp_path_factory.mktemp("null") / "set", {}))


def picture(measurement, file):
    return measurement.image(next(frame for frame in measurement.frames if frame.file == file))


def test_red_comes_from_the_top_blue_from_lower_right_green_from_lower_left(null):
    red, green, blue = (
        picture(null, f"background-{name}.exr")[..., c] for c, name in enumerate(("red", "green", "blue"))
    )
    assert red[0].mean() > 2 * red[-1].mean()
    for one, azimuth_deg in ((red, 90), (green, 210), (blue, 330)):
        row, column = np.unravel_index(one.argmax(), one.shape)
        brightest = (
            np.degrees(np.arctan2(one.shape[0] / 2 - row - 0.5, column + 0.5 - one.shape[1] / 2)) % 360
        )
        assert brightest == pytest.approx(azimuth_deg, abs=12)
    assert green[-1, 0] > 3 * green[0, -1]
    assert blue[-1, -1] > 3 * blue[0, 0]


def test_walls_of_a_bump_face_their_leds(null):
    ratio = picture(null, "press-01.exr") / picture(null, "background-0.exr")
    design, frame = null.design(), next(f for f in null.frames if f.kind == "press")
    view = null.view(frame, design)

    def at(x, y):
        column, row = design.project_px(x, y)
        return ratio[
            int((row - view.y_px) / view.height_px * view.rows),
            int((column - view.x_px) / view.width_px * view.columns),
        ]

    for channel, azimuth_deg in enumerate((90, 210, 330)):
        toward = 1.1 * np.array([np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))])
        facing, averted = (at(1.0 + s * toward[0], 0.5 + s * toward[1])[channel] for s in (1, -1))
        assert facing > 1.3 > 0.8 > averted


def test_single_groups_add_up_to_all_and_dark_is_dark(null):
    single = sum(picture(null, f"background-{name}.exr") for name in ("red", "green", "blue"))
    np.testing.assert_allclose(single, picture(null, "background-1.exr"), rtol=1e-5)
    assert not picture(null, "dark.exr").any()


def test_further_frames_leave_those_of_the_kit_as_they_are(null, tmp_path):
    frames = [
        {"kind": "background", "leds": ["green"], "exposure": 0.5},
        {"kind": "press", **BALL, "leds": ["red"]},
        {"kind": "dark", "leds": []},
        {"kind": "background", "gel_rotation_deg": 180.0},
    ]
    found = load_measurement(made(tmp_path / "set", {}, further=frames))
    kit = [frame.file for frame in null.frames]
    assert [frame.file for frame in found.frames][: len(kit)] == kit
    for file in kit:
        np.testing.assert_array_equal(picture(found, file), picture(null, file))
    green, press, dark, _ = (picture(found, f"further-{n:02d}.exr") for n in range(1, 5))
    np.testing.assert_allclose(green, 0.5 * picture(null, "background-green.exr"), rtol=1e-5)
    assert not dark.any()
    assert press[..., 0].max() > 5 * press[..., 1:].max()
    assert found.frames[-1].gel_rotation_deg == 180.0
    for wrong, words in (({"kind": "light_probe"}, "kind"), ({"kind": "dark", "leds": ["white"]}, "white")):
        with pytest.raises(ValueError, match=words):
            made(tmp_path / "other", {}, further=[wrong])


def test_colour_mixing_shows_in_single_group_frames(null, tmp_path):
    found = load_measurement(made(tmp_path / "set", {"colour_mixing": {"G_from_red": 0.25}}))
    red = picture(found, "background-red.exr")
    np.testing.assert_allclose(red[..., 1], 0.25 * red[..., 0], rtol=1e-5)
    np.testing.assert_allclose(red[..., 0], picture(null, "background-red.exr")[..., 0], rtol=1e-5)


def test_led_position_changes_the_untouched_gel_as_the_closed_form_says(null, tmp_path):
    found = load_measurement(made(tmp_path / "set", {"led_position": {"height_mm": 1.0}}))
    ratio = picture(found, "background-red.exr")[..., 0] / picture(null, "background-red.exr")[..., 0]
    strips, raised = (Rig.of(FLAT.replace({"leds.height_mm": h})).emitters for h in (8.79, 9.79))
    rows, columns = ratio.shape
    point, up = np.array([0.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])
    exact = [sum(lambert_polygon(point, up, corners(s, n)) for n in (0, 1)) for s in (strips, raised)]
    column, row = FLAT.project_px(0.0, 0.0)
    view = null.view(null.frames[0], null.design())
    here = ratio[
        int((row - view.y_px) / view.height_px * rows), int((column - view.x_px) / view.width_px * columns)
    ]
    # Red boards reflect a tenth, so light off them leaves the ratio within a per cent.
    assert here == pytest.approx(exact[1] / exact[0], rel=0.01)


def test_contact_kernel_changes_presses_only_and_blurs_them(null, tmp_path):
    found = load_measurement(made(tmp_path / "set", {"contact_kernel": {"length_ratio": 3.0}}))
    np.testing.assert_array_equal(picture(found, "background-0.exr"), picture(null, "background-0.exr"))
    change = picture(found, "press-01.exr") / picture(null, "press-01.exr") - 1
    assert np.abs(change).max() > 0.1
    contrast = [np.ptp(picture(m, "press-01.exr") / picture(m, "background-0.exr")) for m in (found, null)]
    assert contrast[0] < contrast[1]


@pytest.mark.slow
def test_equal_seeds_give_equal_sets_and_others_differ(tmp_path):
    first, again, other = (
        made(tmp_path / name, {}, seed=seed, noise=True, columns=16, presses=None, kit="small")
        for name, seed in (("a", 7), ("b", 7), ("c", 8))
    )
    assert (first / "measurement.toml").read_bytes() == (again / "measurement.toml").read_bytes()
    for file in sorted(path.name for path in first.glob("*.exr")):
        np.testing.assert_array_equal(read_image(first / file), read_image(again / file))
        assert (read_image(first / file) != read_image(other / file)).any()
    assert (read_image(first / "background-0.exr") != read_image(first / "background-1.exr")).any()
    one, two = unseal(first), unseal(again)
    assert one.pop("salt") != two.pop("salt")
    assert one == two


def test_noise_has_the_spread_that_the_camera_states(tmp_path):
    design = FLAT.replace({"camera.full_well_e": 500.0})
    found = load_measurement(made(tmp_path / "a", {}, noise=True, design=design))
    frame = next(frame for frame in found.frames if frame.file == "background-0.exr")
    difference = picture(found, "background-0.exr") - picture(found, "background-1.exr")
    binned = frame.crop_px[2] / difference.shape[1] * frame.crop_px[3] / difference.shape[0]
    sigma = np.sqrt(2) * noise_sigma(
        picture(found, "background-2.exr") - design.camera.black_level, Capture(design.camera, binned=binned)
    )
    assert np.std(difference / sigma) == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_hour_kit_holds_what_a_bench_hour_gives_and_the_metadata_are_a_little_wrong(tmp_path):
    out = plant(FLAT, effects={}, out=tmp_path / "set", seed=3, columns=8, noise=False, unlisted=False)
    found = load_measurement(out)
    kinds = [frame.kind for frame in found.frames]
    assert (kinds.count("background"), kinds.count("dark"), kinds.count("press")) == (11, 1, 19)
    every = [frame for frame in found.frames if frame.kind == "press"]
    again = [frame for frame in every if frame.repeat]
    presses = [frame for frame in every if frame not in again]
    same = [f for f in presses if (f.centre_mm, f.depth_mm) == (again[0].centre_mm, again[0].depth_mm)]
    assert len(again) == len(same) == 1
    np.testing.assert_array_equal(found.image(again[0]), found.image(same[0]))
    assert sorted({frame.exposure for frame in found.frames}) == [0.25, 0.5, 1.0]
    assert [frame.file for frame in found.frames if frame.gel_rotation_deg] == ["background-turned-180.exr"]
    assert len({frame.centre_mm for frame in presses}) == 10
    assert all(found.split().values())
    truth = unseal(out)
    depth_error = [t["depth_mm"] - f.depth_mm for t, f in zip(truth["presses"], presses, strict=True)]
    centre_error = [
        np.subtract(t["centre_mm"], f.centre_mm) for t, f in zip(truth["presses"], presses, strict=True)
    ]
    assert 0.01 < np.std(depth_error) < 0.03
    assert 0.035 < np.std(centre_error) < 0.065
    assert presses[0].sigma.model_dump() == capture_plan.SIGMA
    assert all(0.9 <= gain <= 1.1 for gain in truth["gain"].values())
    assert len(set(truth["gain"].values())) == 3


def test_exposure_is_set_by_the_untouched_gel_when_the_camera_leaves_it_open(tmp_path):
    found = load_measurement(made(tmp_path / "set", {}, design=FLAT.replace({"camera.exposure": None})))
    assert np.percentile(picture(found, "background-0.exr"), 99.5) == pytest.approx(0.7, rel=1e-3)
    assert found.sensor == "design.toml"
    assert found.design().camera.exposure is None


def test_answer_lies_outside_and_sealed(tmp_path):
    out = made(tmp_path / "set", {"contact_kernel": {"length_ratio": 1.7}}, columns=16)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["set", "set.answer.json", "set.seal"]
    assert json.loads(answer_path(out).read_text())["effects"] == {"contact_kernel": {"length_ratio": 1.7}}
    for path in out.rglob("*"):
        content = path.read_bytes()
        assert not any(
            word in content for word in (b"contact_kernel", b"length_ratio", b"salt", b"seed", b"gain")
        )
    assert set(tomllib.loads((out / "measurement.toml").read_text())) == {
        "name",
        "sensor",
        "response",
        "source",
        "frame",
    }
    assert unseal(out)["effects"]
    answer_path(out).write_text(answer_path(out).read_text().replace("1.7", "1.6"))
    with pytest.raises(ValueError, match="not the answer that was sealed"):
        unseal(out)
    assert len(seal_path(out).read_text().strip()) == 64


def test_a_set_is_never_overwritten_and_bad_input_leaves_nothing(tmp_path):
    with pytest.raises(ValueError, match="for plain membranes"):
        made(tmp_path / "set", {}, design=FLAT.replace({"optics.marker_pitch_mm": 2.0}))
    with pytest.raises(ValueError, match=r"centre_mm \(40, 0\) lies on the gel"):
        made(tmp_path / "set", {}, presses=[BALL | {"centre_mm": [40.0, 0.0]}])
    with pytest.raises(ValueError, match="depth_mm is needed"):
        made(tmp_path / "set", {}, presses=[{"probe": "sphere:4", "centre_mm": [0, 0]}])
    assert not list(tmp_path.iterdir())
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "notes.txt").write_text("mine")
    with pytest.raises(FileExistsError):
        made(tmp_path / "set", {}, columns=8)
    assert [path.name for path in tmp_path.iterdir()] == ["set"]
    with pytest.raises(MeasurementError):
        load_measurement(tmp_path / "set")


def test_generator_shares_no_physics_with_the_analysis():
    # Files, what a design says, and the shapes it is made of: no light transport, no effects, no contact.
    allowed = ("core", "sensor", "simulation.scene.materials", "simulation.scene.static_parts")
    allowed = tuple(f"designlab.{name}" for name in (*allowed, "validation.synthetic"))
    # Light behind glass: the engine's own integrators and rays, not the renderer's.
    engine = {"tracing.py", "beams.py", "clear.py", "spreading.py"}
    for file in Path(designlab.validation.synthetic.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            modules = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for module in modules:
                top = module.partition(".")[0]
                assert top not in ("mitsuba", "drjit") or file.name in engine
                assert top != "designlab" or module.startswith(allowed), f"{file.name} imports {module}"
