"""Every effect of the generator against closed forms, sums and other methods; what its sets hold."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from designlab.measurement import load_measurement
from designlab.sensor.camera import View
from designlab.sensor.design import preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.effects.model import effect
from designlab.simulation.imaging import Capture, noise_sigma
from designlab.simulation.scene.scene import build
from designlab.validation.synthetic import (
    capture_plan,
    effects,
    generate,
    lens,
    light,
    plant,
    raycast,
    surface,
    tail,
    unmodelled,
    unseal,
)
from designlab.validation.synthetic.capture import CaptureSession
from designlab.validation.synthetic.coat import Coat
from designlab.validation.synthetic.electronics import Converter, flicker
from designlab.validation.synthetic.generator_sensor import Rig, Sensor, TrueLens, cells
from designlab.validation.synthetic.indenter import Indenter
from designlab.validation.synthetic.surface import HeightField
from geometries import probes
from geometries.elastomer import Elastomer
from tests.helpers.shared_packages import AIR, APART, CORE, shared

pytestmark = pytest.mark.physics

FLAT = preset("gelsight-2020-flat")
IN_AIR = [name for name in effects.names() if effects.parameters(name, Rig.of(FLAT))]
DOME = preset("gelsight-2020-dome")
PRESS = {"probe": "sphere:4", "depth_mm": 0.8, "centre_mm": [1.0, 0.5], "yaw_deg": 0.0}


def changed(name, design=FLAT, **values):
    return effects.apply(Rig.of(design), {name: values})[0]


def frames(rig, *, columns=24, design=FLAT, which="small", flat_field=False, only=None):
    """Pictures of one press and the frames around it, without noise or errors, by file."""
    _, view = generate.cropped_view(design, columns)
    taken = capture_plan.shots(rig, which, [PRESS], [exact(rig)], flat_field=flat_field)
    session = CaptureSession(rig, view, gain=np.ones(3), random=np.random.default_rng(5))
    wanted = [shot for shot in taken if only is None or shot.file in only]
    return {shot.file: session.take(shot, None, correlated=False) for shot in wanted}, session


def exact(rig, press=PRESS):
    class Sure:
        def standard_normal(self, count):
            return np.zeros(count)

    return capture_plan.true_press(rig, press, Sure())


def pixel_of(view, x_mm, y_mm):
    """Row and column of the pixel that sees a point of the membrane."""
    column, row = FLAT.project_px(x_mm, y_mm)
    return (
        int((row - view.y_px) / view.height_px * view.rows),
        int((column - view.x_px) / view.width_px * view.columns),
    )


def rms(found, plain, file="press-01.exr"):
    """Root mean square of a change over the median signal."""
    return np.sqrt(np.mean((found[file] - plain[file]) ** 2)) / np.median(plain[file])


@pytest.fixture(scope="module")
def plain():
    return frames(Rig.of(FLAT))[0]


@pytest.fixture(scope="module")
def finer():
    return frames(Rig.of(FLAT), columns=36, only=("press-01.exr",))[0]


@pytest.mark.parametrize("name", IN_AIR)
def test_an_effect_at_null_changes_no_picture(name, plain):
    found, _ = frames(changed(name), only=("background-0.exr", "press-01.exr"))
    for file in found:
        np.testing.assert_allclose(found[file], plain[file], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", [name for name in IN_AIR if name != "probe_edge"])  # a ball has none
def test_an_effect_of_one_spread_changes_pictures(name, plain):
    rig = Rig.of(FLAT)
    wrong, _ = effects.apply(rig, {name: effects.draw(name, rig, strength=1.0, seed=2)})
    found, _ = frames(wrong, only=("press-01.exr",))
    assert 3e-4 < rms(found, plain) < 0.5


class TestEmission:
    @pytest.mark.parametrize("exponent", [0.5, 1.0, 4.0, 15.0])
    def test_flux_is_kept_and_intensity_is_the_power_of_the_cosine(self, exponent):
        rig = changed("led_profile", red_exponent=exponent)
        source = cells(rig.emitters, spacing_mm=1.0, exponent=rig.exponent)
        one = type(source)(*(part[source.group == 0] for part in source))
        power = (one.area / (np.pi * one.area.sum()))[None]
        angle = np.radians(np.arange(0.25, 90, 0.5))
        middle, normal, side = one.centre.mean(axis=0), one.normal[0], rig.emitters.across[0]
        far = 1e4
        ways = np.cos(angle)[:, None] * normal + np.sin(angle)[:, None] * side
        found = light.irradiance(middle + far * ways, -ways, one, power)[0] * far**2
        assert found == pytest.approx((exponent + 1) / (2 * np.pi) * np.cos(angle) ** exponent, rel=2e-3)
        assert (found * 2 * np.pi * np.sin(angle)).sum() * np.radians(0.5) == pytest.approx(1.0, rel=3e-3)

    def test_faces_add_up_each_with_its_flux(self):
        rig = Rig.of(FLAT.replace({"optics.path_length": 2}))
        place = np.array([[1.0], [2.0]])
        whole = light.Lighting(rig).untouched.irradiance(*place)
        alone = [
            light.Lighting(effects.apply(rig, {"led_spread": {"red_1": excess}})[0]).untouched.irradiance(
                *place
            )[0]
            for excess in (1.0, -1.0, 0.3)
        ]
        assert 0.5 * (alone[0] + alone[1]) == pytest.approx(whole[0], rel=1e-12)
        assert alone[2] == pytest.approx(0.65 * alone[0] + 0.35 * alone[1], rel=1e-12)
        of_one = replace(rig, face_flux=np.array([1.0, 0.0, 1.0, 1.0, 1.0, 1.0]))
        assert light.Lighting(of_one).untouched.irradiance(*place)[0] == pytest.approx(0.5 * alone[0])

    @pytest.mark.parametrize(
        ("design", "name", "values"),
        [
            (design, name, values)
            for design in (shared(AIR), shared(CORE), shared(CORE, APART))
            for name, values in (
                ("led_tilt", {"red_green_blue_tilt_deg": 6.0, "red_green_blue_turn_deg": -4.0}),
                ("led_position", {"radial_mm": 0.4, "height_mm": -0.3, "tangential_mm": 0.2}),
            )
        ],
    )
    def test_shared_packages_move_as_in_the_simulation(self, design, name, values):
        rig = changed(name, design, **values)
        flat = indent(design.elastomer, design.contact, None, area_mm=(4.0, 4.0), pitch_mm=0.5)
        scene = effect(name).on_scene(build(design, flat, design.view(8)), values)
        assert rig.joined == [(0, 1, 2)]
        assert len(rig.boards.group) == sum(s.name.startswith("board") for s in scene.shapes)
        for number, face in enumerate(scene.lights):
            assert rig.emitters.group[number] == face.group
            assert f"board-{rig.carrier[number]}" == face.board
            np.testing.assert_allclose(rig.emitters.normal[number], face.normal, atol=1e-9)
            np.testing.assert_allclose(
                rig.emitters.centre[number],
                np.subtract(face.centre_mm, np.multiply(1e-3, face.normal)),
                atol=1e-9,
            )

    def test_tilt_is_that_of_the_design_turn_adds_to_the_azimuth_and_boards_go_with_it(self):
        level = FLAT.replace({"leds.tilt_deg": 0.0})
        tilted = changed("led_tilt", green_tilt_deg=7.0).emitters
        other = Rig.of(FLAT.replace({"leds.tilt_deg": 26.0})).emitters
        own = tilted.group == 1
        for axis in ("normal", "down", "across"):
            np.testing.assert_allclose(getattr(tilted, axis)[own], getattr(other, axis)[own], atol=1e-12)
            np.testing.assert_array_equal(
                getattr(tilted, axis)[~own], getattr(Rig.of(FLAT).emitters, axis)[~own]
            )
        whole = changed("led_tilt", green_tilt_deg=7.0, green_turn_deg=-4.0)
        plain = Rig.of(FLAT)
        np.testing.assert_array_equal(whole.boards.centre, plain.boards.centre)
        for board, number in zip(
            whole.emitters.group.tolist(), range(len(whole.emitters.group)), strict=True
        ):
            # Faces stay where they are on their board.
            away, before = (rig.emitters.centre[number] - rig.boards.centre[board] for rig in (whole, plain))
            for axis in ("normal", "down", "across"):
                now, then = (getattr(rig.boards, axis)[board] for rig in (whole, plain))
                assert away @ now == pytest.approx(before @ then, abs=1e-12)
                np.testing.assert_allclose(getattr(whole.emitters, axis)[number], now, atol=1e-12)
        turned = changed("led_tilt", level, red_turn_deg=5.0).emitters
        x, y, _ = turned.normal[turned.group == 0][0]
        # The red row stands at azimuth 90 deg and shines towards 270 deg.
        assert np.degrees(np.arctan2(y, x)) % 360 == pytest.approx(275.0, abs=1e-9)


class TestMaterial:
    def test_light_off_boards_grows_with_their_reflectance(self):
        place = np.array([[1.0], [2.0]])

        def lit(boards, path_length):
            design = FLAT.replace({"optics.path_length": path_length})
            return light.Lighting(changed("interreflection", design, boards=boards)).untouched.irradiance(
                *place
            )

        direct = lit(0.0, 2)
        indirect = [(lit(boards, 3) - direct)[0, 0] for boards in (0.0, 0.2, 5e-2)]
        assert indirect[1] / indirect[0] == pytest.approx(3.0)  # red boards reflect 0.1 by design
        assert indirect[2] / indirect[0] == pytest.approx(1.5)
        np.testing.assert_array_equal(lit(0.3, 2), direct)

    def test_albedo_ratio_leaves_direct_light_and_lifts_what_returns(self):
        direct, bounced = (FLAT.replace({"optics.path_length": n}) for n in (2, 4))
        plain, _ = frames(Rig.of(direct))
        found, _ = frames(changed("interreflection", direct, albedo_ratio=1.4), design=direct)
        np.testing.assert_allclose(found["background-0.exr"], plain["background-0.exr"], rtol=1e-9)
        plain, _ = frames(Rig.of(bounced))
        found, _ = frames(changed("interreflection", bounced, albedo_ratio=1.4), design=bounced)
        assert (found["background-0.exr"] > plain["background-0.exr"]).all()

    def test_albedo_field_is_the_polynomial_and_turns_with_the_gel(self):
        design = FLAT.replace({"optics.path_length": 2})
        values = {"x": 0.2, "y": -0.1, "xx": 0.3, "xy": 0.15, "yy": -0.2}
        plain, session = frames(Rig.of(design), which="hour")
        found, _ = frames(changed("albedo_field", design, **values), which="hour")
        column, row = session.view.centres()
        right, up, forward = design.camera.unproject(column, row)
        x_c, y_c, z_c = design.camera.position_mm
        u, v = (x_c + z_c * right / forward) / 8, (y_c + z_c * up / forward) / 6

        def field(u, v):
            return 1 + 0.2 * u - 0.1 * v + 0.3 * (u**2 - 1 / 3) + 0.15 * u * v - 0.2 * (v**2 - 1 / 3)

        for file, expected in (
            ("background-0.exr", field(u, v)),
            ("background-turned-180.exr", field(-u, -v)),
        ):
            ratio = found[file] / plain[file]
            np.testing.assert_allclose(ratio, np.repeat(expected[..., None], 3, axis=2), rtol=2e-3)

    def test_lobe_is_symmetric_bright_in_the_mirror_and_sends_no_more_than_it_gets(self):
        coat = Coat(half_mm=(8.0, 6.0), specular=0.1, roughness=0.3)
        up = np.array([[0.0, 0.0, 1.0]])
        point = np.zeros((1, 3))
        # Along the normal the lobe is D / 4 with D = 1 / (pi alpha^2); a diffuse coat sends 1 / pi.
        ahead = coat.lobe(point, up, np.array([[0.0, 0.0, 9.0]]), np.array([0.0, 0.0, 5.0]))
        assert ahead[0, 0] == pytest.approx(1 / (4 * 0.3**2), rel=1e-5)
        a, b = np.array([3.0, 1.0, 2.0]), np.array([-1.0, -1.0, 4.0])
        there, back = coat.lobe(point, up, a[None], b), coat.lobe(point, up, b[None], a)
        assert there[0, 0] == pytest.approx(back[0, 0], rel=1e-9)
        # Of light from the normal, facets tilted by more than 45 deg send their share 1 - 1 / (1 + alpha^2)
        # into the coat; what is sent up is masked besides, at each angle by G1.
        cosine = (np.arange(2000) + 0.5) / 2000
        ways = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine], axis=1)
        lobe = coat.lobe(point, up, ways, np.array([0.0, 0.0, 2.0]))[0]
        assert (2 * lobe * cosine / coat.seen(cosine)).mean() == pytest.approx(1 / 1.09, rel=1e-4)
        assert (2 * lobe * cosine).mean() < 1 / 1.09

    def test_what_touches_shines_through_by_kubelkas_formula(self, plain):
        found, session = frames(changed("translucency", transmittance=0.3, object=0.6))
        a = np.array(FLAT.per_group("membrane_albedo"))
        exact = 1 + 0.3**2 * 0.6 / (1 - 0.6 * a) / a
        np.testing.assert_allclose(found["background-0.exr"], plain["background-0.exr"], rtol=1e-12)
        ratio = found["press-01.exr"] / plain["press-01.exr"]
        here = pixel_of(session.view, 1.0, 0.5)
        # Red light alone reaches red, up to the 3 % of green that the design mixes in.
        np.testing.assert_allclose(ratio[here][1:], exact[1:], rtol=3e-3)
        assert ratio[0, 0] == pytest.approx(1.0, abs=2e-3)

    def test_what_touches_takes_the_light_that_air_sends_back(self, plain):
        found, session = frames(changed("wetting", transmittance=0.3))
        a = np.array(FLAT.per_group("membrane_albedo"))
        np.testing.assert_allclose(found["background-0.exr"], plain["background-0.exr"], rtol=1e-12)
        # the coat alone, by the quadratic that Kubelka's formula is for it
        alone = [np.roots([0.536, -(1 + 0.536 * v), v - 0.09 * 0.536]).min() for v in a]
        ratio = found["press-01.exr"] / plain["press-01.exr"]
        here = pixel_of(session.view, 1.0, 0.5)
        np.testing.assert_allclose(ratio[here][1:], (alone / a)[1:], rtol=3e-3)
        assert ratio[0, 0] == pytest.approx(1.0, abs=2e-3)


class TestContact:
    GEL = Elastomer(width_mm=30)

    def pressed(self, text, depth, share, length, elastomer=None, **more):
        return surface.indented(
            elastomer or self.GEL,
            Indenter(probes.parse(text), depth, (0.5, -0.3), **more),
            kernel_length_mm=0.0,
            kernel_m=200,
            tail_share=share,
            tail_mm=length,
        )

    def test_tail_of_a_ball_decays_with_the_distance_from_its_circle(self):
        field = self.pressed("sphere:4", 0.8, 0.25, 0.6)
        circle = np.sqrt(2.0**2 - 1.2**2)
        for away in (0.05, 0.4, 1.1):
            for turn in (0.0, 1.0, 4.0):
                x, y = (np.array([c + (circle + away) * f(turn)]) for c, f in ((0.5, np.cos), (-0.3, np.sin)))
                assert field.z(x, y)[0] == pytest.approx(0.25 * 0.8 * np.exp(-away / 0.6), abs=1.2e-3)
        assert field.peak_mm == pytest.approx(0.8, abs=1e-4)
        inside = circle - 0.02  # where the ball stands lower than the tail begins
        assert field.z(np.array([0.5 + inside]), np.array([-0.3]))[0] == pytest.approx(0.2, abs=2e-3)

    def test_tail_of_a_triangle_is_round_about_its_corners_and_parallel_to_its_sides(self):
        field = self.pressed("triangle:5", 0.5, 0.4, 0.7, yaw_deg=90.0)
        corner, side = 5 / np.sqrt(3), 5 / np.sqrt(12)
        # Turned by 90 deg a corner points to -x and a side lies opposite, at +x.
        for x, away in ((-corner - 0.5, 0.5), (side + 0.8, 0.8)):
            found = field.z(np.array([0.5 + x]), np.array([-0.3]))[0]
            assert found == pytest.approx(0.4 * 0.5 * np.exp(-away / 0.7), abs=1.2e-3)

    def test_distance_from_touched_cells_is_that_from_the_known_outline(self):
        axis = np.arange(-4, 4, 0.02)
        x, y = np.meshgrid(axis, axis)
        for text in ("sphere:4", "triangle:4"):
            press = Indenter(probes.parse(text), 0.6, (0.1, 0.2), 15.0)
            _, contact = surface.penetration(self.GEL, press, x, y, 0.02)
            known = tail.outside_mm(self.GEL, press, contact, x, y)
            found = tail.outside_cells_mm(contact, x, y)
            assert np.abs(found - known).max() < 0.02

    def test_distance_from_a_rounded_triangle_is_that_from_its_rounded_corners(self):
        axis = np.arange(-4, 4, 0.02)
        x, y = np.meshgrid(axis, axis)
        press = Indenter(probes.parse("triangle:4:r0.3"), 0.6, (0.0, 0.0))
        _, contact = surface.penetration(self.GEL, press, x, y, 0.02)
        found = tail.outside_mm(self.GEL, press, contact, x, y)
        # A corner of 60 deg loses as much as its radius.
        away = y[:, 200] - (4 / np.sqrt(3) - 0.3)
        np.testing.assert_allclose(found[away > 0, 200], away[away > 0], atol=0.03)

    def test_tail_on_a_dome_starts_at_the_contact(self):
        field = self.pressed("sphere:4", 0.5, 0.3, 0.5, elastomer=DOME.elastomer)
        height, contact = field.height_mm, field.contact
        rim = (contact > 0) & (contact < 1)
        assert height[rim].mean() == pytest.approx(0.3 * 0.5, rel=0.02)
        assert height[0].max() < 1e-3

    def test_presses_are_deeper_by_the_offset_and_by_nothing_else(self):
        assert exact(changed("depth_offset", offset_mm=0.07)).depth_mm == pytest.approx(0.87)
        assert exact(Rig.of(FLAT)) == Indenter(probes.parse("sphere:4"), 0.8, (1.0, 0.5))


class TestCamera:
    def test_a_moved_and_turned_camera_looks_where_it_should(self):
        x, y, z = FLAT.camera.position_mm
        column, row = FLAT.camera.centre_px
        view = View(column - 1, row - 1, 2.0, 2.0, 1, 1)

        def hit(**values):
            rig = changed("camera_pose", **values)
            rays = raycast.pixel_rays(rig.camera, view, split=1, bent=rig.lens, turn=rig.turn)
            return [float(v[0]) for v in rays.at(raycast.meet(rays, HeightField(None)))[:2]]

        assert hit(x_mm=0.4, y_mm=-0.2, z_mm=1.0) == pytest.approx([x + 0.4, y - 0.2])
        assert hit(tilt_x_deg=2.0) == pytest.approx([x, y + z * np.tan(np.radians(2.0))])
        assert hit(tilt_y_deg=2.0) == pytest.approx([x + z * np.tan(np.radians(2.0)), y])

    @pytest.mark.parametrize(("radial", "magnification"), [(0.0, 0.05), (-0.15, 0.0), (0.1, -0.08)])
    def test_points_appear_at_their_distorted_distance(self, radial, magnification):
        rig = changed("lens_distortion", radial=radial, magnification=magnification)
        camera = FLAT.camera
        view = camera.full_view()._replace(columns=12, rows=9)
        rays = raycast.pixel_rays(camera, view, split=1, bent=rig.lens, turn=rig.turn)
        column, row = (part.ravel() for part in view.centres())
        ideal = camera.project(rays.tan_x, rays.tan_y)
        x_c, y_c = camera.centre_px
        d = np.hypot(ideal[0] - x_c, ideal[1] - y_c)
        r = d / (np.hypot(camera.width_px, camera.height_px) / 2)
        shown = np.hypot(column - x_c, row - y_c)
        np.testing.assert_allclose(d * (1 + magnification + radial * r**2), shown, rtol=1e-9)

    def test_blur_keeps_light_and_widens_by_its_own_variance(self):
        spot = np.zeros((1, 81, 81))
        row, column = np.mgrid[:81, :81] - 40
        spot[0] = np.exp(-(row**2 + column**2) / (2 * 2.0**2))
        for radius in (0.6, 3.0, 9.0):
            found = lens.blurred(spot, radius=radius)[0]
            assert found.sum() == pytest.approx(spot.sum(), rel=1e-9)
            # A disc of radius R has the variance R^2 / 4 along each axis.
            variance = (found * column**2).sum() / found.sum()
            assert variance == pytest.approx(2.0**2 + radius**2 / 4, rel=1e-3)

    def test_a_blurred_edge_is_the_cut_of_a_disc(self):
        edge = np.zeros((1, 40, 121))
        edge[..., 61:], edge[..., 60] = 1.0, 0.5
        radius = 15.0
        found = lens.blurred(edge, radius=radius)[0, 20]
        u = np.clip((np.arange(121) - 60) / radius, -1, 1)
        exact = 0.5 + (u * np.sqrt(1 - u**2) + np.arcsin(u)) / np.pi
        np.testing.assert_allclose(found[20:100], exact[20:100], atol=5e-3)

    def test_blur_has_its_size_on_the_plane(self):
        # A disc of 2 x 80 um radius, seen from 41.05 mm by a focal length of 2592 / 2 / tan(26.65 deg) px.
        radius = lens.disc_px(FLAT.camera, TrueLens(blur_um=80.0))
        assert radius == pytest.approx(0.16 * 2592 / 2 / np.tan(np.radians(53.3 / 2)) / 41.05, rel=1e-9)

    def test_vignetting_loses_what_is_stated_and_is_nearly_a_parabola(self):
        camera = FLAT.camera
        for view in (camera.full_view()._replace(columns=40, rows=30), generate.cropped_view(FLAT, 40)[1]):
            factor = lens.falloff(camera, TrueLens(corner_loss=0.3), view)
            column, row = view.centres()
            x, y = camera.centre_px
            r2 = ((column - x) ** 2 + (row - y) ** 2) / ((camera.width_px**2 + camera.height_px**2) / 4)
            corner = np.unravel_index(r2.argmax(), r2.shape)
            assert factor[corner] == pytest.approx(1 - 0.3 * r2[corner], rel=1e-9)
            off = np.sqrt(np.mean((factor - (1 - 0.3 * r2)) ** 2))
            assert off < 0.2 * np.sqrt(np.mean((0.3 * r2) ** 2))

    def test_glare_is_a_wide_gaussian_of_a_mirrored_picture(self):
        random = np.random.default_rng(0)
        picture = random.uniform(0, 1, (30, 40, 3))
        found = lens.with_glare(picture, share=0.1)
        wide = gaussian_filter(picture, (12, 12, 0), mode="reflect", truncate=8)
        np.testing.assert_allclose(found, 0.9 * picture + 0.1 * wide, atol=2e-4)
        assert found.mean() == pytest.approx(picture.mean(), rel=1e-12)

    def test_banding_has_its_period_phase_and_the_loss_of_averaging(self):
        view = View(0.0, 200.0, 400.0, 1600.0, 25, 100)
        factor = flicker(view, amplitude=0.02, period_rows=160.0, phase=0.3)[:, 0, 0]
        rows = 200 + (np.arange(100) + 0.5) * 16
        exact = 1 + 0.02 * np.sinc(16 / 160) * np.sin(2 * np.pi * (rows / 160 + 0.3))
        np.testing.assert_allclose(factor, exact, atol=2e-6)
        assert np.abs(np.fft.rfft(factor - 1)).argmax() == 10

    def test_frames_drift_and_flicker_as_the_answer_says_and_the_pattern_stays(self, plain):
        rig = Rig.of(FLAT)
        asked = {
            "exposure_drift": {"rms": 0.05},
            "banding": {"amplitude": 0.1},
            "fixed_pattern": {"rms": 0.03},
        }
        found, session = frames(effects.apply(rig, asked)[0])
        hidden = json.loads(json.dumps(session.hidden()))
        pattern = np.array(hidden["fixed_pattern_map"])
        assert pattern.std() == pytest.approx(1.0, abs=2e-3)
        assert abs(np.corrcoef(pattern[:, 1:].ravel(), pattern[:, :-1].ravel())[0, 1]) < 0.1
        view = session.view
        rows = view.y_px + (np.arange(view.rows) + 0.5) * view.height_px / view.rows
        loss = np.sinc(view.height_px / view.rows / 400)
        seen = set()
        for file, drawn in hidden["frames"].items():
            wave = 1 + 0.1 * loss * np.sin(2 * np.pi * (rows / 400 + drawn["phase"]))
            factor = (1 + 0.05 * drawn["drift"]) * wave[:, None, None] * (1 + 0.03 * pattern)
            np.testing.assert_allclose(found[file], plain[file] * factor, rtol=2e-5)
            seen.add(drawn["phase"])
        assert len(seen) == len(found)

    def test_black_level_and_response_curve(self, plain):
        rig = Rig.of(FLAT)
        asked = {"black_level": {"R": 0.02, "G": 0.0, "B": -0.001}, "response_curve": {"exponent": 0.8}}
        found, _ = frames(effects.apply(rig, asked)[0])
        for file in ("dark.exr", "background-0.exr"):
            signal = np.maximum(plain[file] + np.array([0.02, 0.0, -0.001]), 0.0)
            np.testing.assert_allclose(found[file], signal**0.8, atol=2e-5)

    def test_noise_keeps_its_variance_and_neighbours_share_it(self):
        camera = FLAT.camera
        light = np.full((300, 300, 3), 0.3)
        found = Converter(camera, Sensor(), binned=16.0).report(
            light, np.random.default_rng(0), correlated=True
        )
        noise = found - 0.3
        stated = float(noise_sigma(np.array(0.3) - camera.black_level, Capture(camera, binned=16.0)))
        assert noise.std() == pytest.approx(stated, rel=0.01)
        scaled = noise / noise.std()
        for shift, expected in (((1, 0), 0.3), ((0, 1), 0.3), ((2, 0), 0.0), ((1, 1), 0.09)):
            other = np.roll(scaled, shift, (0, 1))
            assert (scaled * other).mean() == pytest.approx(expected, abs=0.01)
        single = Converter(camera, Sensor(), binned=16.0).report(
            light, np.random.default_rng(0), correlated=False
        )
        assert abs(np.corrcoef(single[1:].ravel(), single[:-1].ravel())[0, 1]) < 0.01

    def test_noise_behind_a_curve_is_that_of_single_pixels(self):
        """A steep curve bends the noise of every sensor pixel before they are averaged; drawn one by one."""
        camera, dark = FLAT.camera, 0.002
        steep = Converter(camera, Sensor(exponent=0.5), binned=16.0)
        found = steep.report(np.full((200, 200, 3), dark), np.random.default_rng(1), correlated=False)
        sigma = np.sqrt(dark / camera.full_well_e + (camera.read_noise_e / camera.full_well_e) ** 2)
        pixels = dark + sigma * np.random.default_rng(2).standard_normal((40_000, 16))
        mean = np.sqrt(np.clip(pixels, 0, 1)).mean(axis=1)
        assert found.mean() == pytest.approx(mean.mean(), rel=3e-3)
        assert found.std() == pytest.approx(mean.std(), rel=0.05)


class TestKit:
    def test_exposures_are_proportional_and_the_flat_field_shows_the_lens_only(self, plain):
        rig = effects.apply(Rig.of(FLAT), {"vignetting": {"corner_loss": 0.4}, "albedo_field": {"x": 0.3}})[0]
        found, session = frames(rig, which="hour", flat_field=True)
        for share in (0.25, 0.5):
            np.testing.assert_allclose(
                found[f"background-exposure-{share:g}.exr"], share * found["background-0.exr"], rtol=1e-12
            )
        factor = lens.falloff(FLAT.camera, rig.lens, session.view)
        np.testing.assert_allclose(
            found["flat-field.exr"], 0.5 * np.repeat(factor[..., None], 3, axis=2), rtol=1e-12
        )
        assert (np.abs(found["background-turned-180.exr"] / found["background-0.exr"] - 1) > 0.01).any()

    @pytest.mark.slow
    def test_sets_share_the_stated_places_of_a_kit_seed_and_nothing_hidden(self, tmp_path):
        stated, truth = [], []
        for seed, kit_seed in ((1, 9), (2, 9)):
            out = plant(
                FLAT,
                effects={},
                out=tmp_path / str(seed),
                seed=seed,
                kit_seed=kit_seed,
                kit="small",
                columns=8,
            )
            presses = [f for f in load_measurement(out).frames if f.kind == "press"]
            stated.append([f.centre_mm for f in presses])
            truth.append(unseal(out))
        own = capture_plan.stated_presses(FLAT, "small", generate.streams(9)[0])
        assert stated[0] == stated[1] == [tuple(press["centre_mm"]) for press in own]
        assert truth[0]["gain"] != truth[1]["gain"]
        off = [
            np.array([p["centre_mm"] for p in answer["presses"]]) - places
            for answer, places in zip(truth, stated, strict=True)
        ]
        assert (np.abs(off[0] - off[1]) > 1e-3).any(axis=1).all()


class TestBeyond:
    @pytest.mark.parametrize("kind", unmodelled.outside_kinds())
    def test_what_lies_outside_shows_clearly(self, kind, finer):
        rig = Rig.of(FLAT)
        wrong, truth = unmodelled.add_outside(rig, {kind: 1.0}, random=np.random.default_rng(3))
        assert truth[kind]["strength"] == 1.0
        assert rms(frames(wrong, columns=36, only=("press-01.exr",))[0], finer) > 0.02
        off, _ = unmodelled.add_outside(rig, {kind: 0.0}, random=np.random.default_rng(3))
        same, _ = frames(off, columns=36, only=("press-01.exr",))
        np.testing.assert_allclose(same["press-01.exr"], finer["press-01.exr"], rtol=1e-6, atol=1e-9)

    @pytest.mark.parametrize("kind", unmodelled.unlisted_kinds())
    def test_what_is_unlisted_is_small(self, kind, finer):
        rough, _ = unmodelled.add_unlisted(Rig.of(FLAT), {kind: 1.0}, random=np.random.default_rng(3))
        assert 2e-3 < rms(frames(rough, columns=36, only=("press-01.exr",))[0], finer) < 0.03

    def test_every_set_has_one_or_two_small_departures_unless_told_otherwise(self, tmp_path):
        rig, seen = Rig.of(FLAT), set()
        for seed in range(30):
            _, drawn = unmodelled.add_unlisted(rig, random=np.random.default_rng(seed))
            assert 1 <= len(drawn) <= 2
            assert all(0.1 <= values["strength"] <= 0.3 for values in drawn.values())
            seen |= set(drawn)
        assert seen == set(unmodelled.unlisted_kinds())
        asked = {"kit": "small", "columns": 8, "seed": 4, "presses": [PRESS]}
        with_, without = (tmp_path / name for name in ("with", "without"))
        plant(FLAT, effects={}, out=with_, outside={"moire": 0.5}, **asked)
        plant(FLAT, effects={}, out=without, unlisted=False, **asked)
        assert unseal(with_)["outside"] == {"moire": {"strength": 0.5}}
        assert unseal(with_)["unlisted"]
        assert unseal(without)["outside"] == unseal(without)["unlisted"] == {}

    def test_a_grain_is_dark_and_throws_a_shadow_away_from_each_lamp(self):
        rig = Rig.of(FLAT)
        _, view = generate.cropped_view(FLAT, 80)
        from dataclasses import replace

        speck = replace(rig, grain=(0.0, 0.0, 0.6, 0.5))
        share = raycast.Caster(speck, view).radiance(None) / raycast.Caster(rig, view).radiance(None)
        column, row = FLAT.project_px(0.0, 0.0)
        middle = np.array(
            [
                (row - view.y_px) / view.height_px * view.rows,
                (column - view.x_px) / view.width_px * view.columns,
            ]
        )
        for group, azimuth_deg in enumerate((90, 210, 330)):
            a = np.radians(azimuth_deg)
            towards = np.array([-np.sin(a), np.cos(a)]) * view.columns / 16  # rows go down; px of 1 mm
            behind, before = ((middle + sign * 1.1 * towards).astype(int) for sign in (-1, 1))
            assert share[(group, *behind)] < 0.9
            assert share[(group, *before)] == pytest.approx(1.0, abs=0.03)

    @pytest.mark.parametrize(
        ("asked", "words"),
        [({"fog": 1.0}, ["fog", "printed_markers"]), ({"moire": 9.0}, ["moire", "between 0 and 2", "9"])],
    )
    def test_unusable_departures_are_named(self, asked, words):
        with pytest.raises(ValueError) as caught:  # noqa: PT011 - the words are checked below
            unmodelled.add_outside(Rig.of(FLAT), asked, random=np.random.default_rng(0))
        assert all(word in str(caught.value) for word in words)
