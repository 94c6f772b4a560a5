"""The generator of measurements behind glass, against closed forms and the product's own renderer."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.render.window import transmission
from designlab.simulation.simulator import Simulator
from designlab.validation.synthetic import backlight, effects, immersed
from designlab.validation.synthetic.backlight import ImmersedLightField, clear_trace, directions, spread_trace
from designlab.validation.synthetic.boundaries import gap_transmission, reflectance
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.glass import Disc, look
from designlab.validation.synthetic.immersed import ImmersedLighting
from designlab.validation.synthetic.indenter import Indenter
from designlab.validation.synthetic.light import Lighting
from designlab.validation.synthetic.meshes import JOINED_MM, joining_mm
from designlab.validation.synthetic.raycast import Caster, pixel_rays
from designlab.validation.synthetic.surface import indented
from designlab.validation.synthetic.tracing import Tracer
from geometries import probes

pytestmark = pytest.mark.physics

FLAT = preset("gelsight-2020-flat-core")
DOME = preset("gelsight-2020-dome-core")
BLACK = {
    "gelcore.side_finish": "painted",
    "gelcore.paint_reflectance": 0.0,
    "optics.board_reflectance": (0.0,),
}
MATCHED = {"optics.gelcore_index": 1.5, "optics.elastomer_index": 1.5}
NODE = np.array([2.0, 1.0, 3e-3])


def towards_face(rig, number, *, paths):
    """Rays from NODE to random points of an emitting face; their length and cosine to its normal."""
    faces, random = rig.emitters, np.random.default_rng(number)
    u, v = random.uniform(-0.95, 0.95, (2, paths, 1))
    points = faces.centre[number] + u * faces.half[number, 0] * faces.across[number]
    points = points + v * faces.half[number, 1] * faces.down[number]
    way = points - NODE
    length = np.linalg.norm(way, axis=1)
    direction = way / length[:, None]
    return np.broadcast_to(NODE, way.shape), direction, length, -direction @ faces.normal[number]


def lambertian(rig, group):
    """Radiance of a group's faces at unit flux."""
    mine = rig.emitters.group == group
    return 1.0 / (np.pi * 4.0 * rig.emitters.half[mine].prod(axis=1).sum())


def quick(monkeypatch, **settings):
    for name, value in settings.items():
        monkeypatch.setattr(backlight, name, value)


def test_fresnel_at_normal_brewsters_and_critical_angle():
    assert reflectance(np.array([1.0]), 1.0, 1.5)[0] == pytest.approx(0.04)
    brewster = np.arctan(1.5)
    s = (np.cos(brewster) - 1.5 * np.cos(np.pi / 2 - brewster)) / (
        np.cos(brewster) + 1.5 * np.cos(np.pi / 2 - brewster)
    )
    assert reflectance(np.cos([brewster]), 1.0, 1.5)[0] == pytest.approx(s**2 / 2)
    critical = np.arcsin(1 / 1.5)
    assert reflectance(np.cos([critical + 0.01]), 1.5, 1.0)[0] == 1.0
    assert reflectance(np.cos([critical - 0.01]), 1.5, 1.0)[0] < 1.0


def test_slab_of_air_passes_the_sum_over_its_reflections():
    once = 0.04
    assert gap_transmission(np.array([1.0]), 1.5, (1.5, 1.5))[0] == pytest.approx((1 - once) / (1 + once))
    assert gap_transmission(np.array([0.5]), 1.5, (1.5, 1.5))[0] == 0.0


@pytest.mark.parametrize("design", [FLAT, DOME], ids=["plane", "dome"])
def test_viewing_rays_take_the_shortest_optical_path(design):
    rig = Rig.of(design)
    glass = rig.glass
    rays = pixel_rays(rig.camera, design.view(6), split=1)
    sight, _ = look(glass, rays)
    crossing = np.stack(sight.origin_mm, axis=1)
    camera = np.array(rig.camera.position_mm)
    fall = camera[2] - glass.window_mm
    window = camera + fall * np.stack([rays.tan_x, rays.tan_y, -np.ones_like(rays.tan_x)], axis=1)
    end = crossing + 1.5 * np.stack([sight.tan_x, sight.tan_y, -np.ones_like(sight.tan_x)], axis=1)

    def on_interface(x, y):
        if glass.interface_radius_mm is None:
            return np.stack([x, y, np.full_like(x, glass.thickness_mm)], axis=1)
        radius = glass.interface_radius_mm
        return np.stack([x, y, radius + glass.thickness_mm - np.sqrt(radius**2 - x**2 - y**2)], axis=1)

    def optical_mm(first, second):
        return (
            np.linalg.norm(first - camera, axis=1)
            + glass.core_index * np.linalg.norm(second - first, axis=1)
            + glass.gel_index * np.linalg.norm(end - second, axis=1)
        )

    assert on_interface(crossing[:, 0], crossing[:, 1]) == pytest.approx(crossing, abs=1e-9)
    best, step = optical_mm(window, crossing), 0.02
    for dx, dy in ((step, 0.0), (-step, 0.0), (0.0, step), (0.0, -step)):
        shifted = window + np.array([dx, dy, 0.0])
        assert (optical_mm(shifted, crossing) > best).all()
        assert (optical_mm(window, on_interface(crossing[:, 0] + dx, crossing[:, 1] + dy)) > best).all()


@pytest.mark.renders
@pytest.mark.llvm
def test_radiance_of_bonded_leds_crosses_a_matched_core_undimmed():
    rig = Rig.of(FLAT.replace(BLACK | MATCHED))
    tracer = Tracer(rig, (0, 1, 2))
    for number, group in enumerate(rig.emitters.group):
        origin, direction, _, _ = towards_face(rig, number, paths=50)
        found = tracer.radiance(origin, direction, seed=1)
        assert found[group] == pytest.approx(lambertian(rig, group), rel=1e-4)
        assert np.delete(found, group, axis=0) == pytest.approx(0.0)


@pytest.mark.renders
@pytest.mark.llvm
def test_refraction_into_the_gel_widens_the_beam():
    rig = Rig.of(FLAT.replace(BLACK))
    glass = rig.glass
    tracer = Tracer(rig, (0, 1, 2))
    # Backwards from the middle of a face: Snell's law turns the ray at the interface, so aim by bisection.
    face = rig.emitters.centre[0]
    flat = face[:2] / np.linalg.norm(face[:2])
    low, high = 0.0, np.pi / 2
    for _ in range(60):
        angle = (low + high) / 2
        inner = np.arcsin(np.sin(angle) * glass.gel_index / glass.core_index)
        reached = glass.thickness_mm * np.tan(angle) + (face[2] - glass.thickness_mm) * np.tan(inner)
        low, high = (angle, high) if reached < np.linalg.norm(face[:2]) else (low, angle)
    direction = np.array([*(np.sin(angle) * flat), np.cos(angle)])
    count = 20_000
    found = tracer.radiance(np.tile([0.0, 0.0, 1e-4], (count, 1)), np.tile(direction, (count, 1)), seed=2)[
        0
    ].mean()
    passed = 1 - reflectance(np.cos([angle]), glass.gel_index, glass.core_index)[0]
    ratio = (glass.gel_index / glass.core_index) ** 2
    assert found == pytest.approx(lambertian(rig, 0) * ratio * passed, rel=5e-3)


@pytest.mark.renders
@pytest.mark.llvm
def test_light_fades_along_its_way_by_beer_and_lambert():
    rig = Rig.of(FLAT.replace(BLACK | MATCHED))
    rig, _ = effects.apply(rig, {"absorption": {"red_per_mm": 0.05, "blue_per_mm": 0.02}})
    tracer = Tracer(rig, (0, 1, 2))
    for number, per_mm in ((0, 0.05), (2, 0.0), (4, 0.02)):
        group = rig.emitters.group[number]
        origin, direction, length, _ = towards_face(rig, number, paths=1)
        count = 40_000
        rays = np.repeat(origin, count, axis=0), np.repeat(direction, count, axis=0)
        within_core = 1 - rig.glass.thickness_mm / (length * direction[:, 2])
        expected = lambertian(rig, group) * np.exp(-per_mm * length * within_core)[0]
        assert tracer.radiance(*rays, seed=3)[group].mean() == pytest.approx(expected, rel=0.02)


@pytest.mark.renders
@pytest.mark.llvm
def test_haze_keeps_unscattered_light_to_its_law():
    rig, _ = effects.apply(Rig.of(FLAT.replace(BLACK | MATCHED)), {"core_scatter": {"per_mm": 0.05}})
    tracer = Tracer(rig, (0, 1, 2), spreading=False)
    origin, direction, length, _ = towards_face(rig, 0, paths=1)
    rays = np.repeat(origin, 40_000, axis=0), np.repeat(direction, 40_000, axis=0)
    within_core = length * (1 - rig.glass.thickness_mm / (length * direction[:, 2]))
    expected = lambertian(rig, 0) * np.exp(-0.05 * within_core)[0]
    assert tracer.radiance(*rays, seed=4)[0].mean() == pytest.approx(expected, rel=0.02)


@pytest.mark.renders
@pytest.mark.llvm
def test_light_across_an_air_gap_comes_no_flatter_than_total_reflection_lets_it():
    """In a core with upright sides, light from outside keeps within the critical angle of their normals."""
    design = FLAT.replace(
        BLACK | MATCHED | {"leds.coupling": "air_gap", "gelcore.draft_deg": 0.0, "leds.radius_mm": 17.5}
    )
    rig = Rig.of(design)
    tracer = Tracer(rig, (0, 1, 2))
    towards, _ = directions()
    found = tracer.radiance(np.tile(NODE, (len(towards), 1)), towards, seed=5)[0]
    # The window mirrors light without changing its slope to the sides; red stands at +y.
    lit = np.abs(towards[:, 1]) >= np.sqrt(1 - 1 / 1.5**2)
    assert found[lit].any()
    assert not found[~lit].any()


@pytest.mark.renders
@pytest.mark.parametrize("exponent", [0.7, 4.0])
@pytest.mark.llvm
def test_narrow_and_tilted_beams_have_their_intensity(exponent):
    rig = Rig.of(FLAT.replace(BLACK | MATCHED))
    rig, _ = effects.apply(rig, {"led_profile": {"red_exponent": exponent}})
    faces = rig.emitters
    # A bonded board stays on its side; its beam alone is tilted here.
    tilted = np.cos(np.radians(8.0)) * faces.normal + np.sin(np.radians(8.0)) * faces.down
    rig = replace(rig, emitters=faces._replace(normal=tilted))
    untilted = Rig.of(FLAT)
    origin, direction, _, _ = towards_face(untilted, 1, paths=50)
    seen = -direction @ untilted.emitters.normal[1]
    cosine = -direction @ rig.emitters.normal[1]
    found = Tracer(rig, (0, 1, 2)).radiance(origin, direction, seed=6)[0]
    expected = lambertian(rig, 0) * (exponent + 1) / 2 * cosine**exponent / seen
    assert found == pytest.approx(expected, rel=1e-3)


@pytest.mark.renders
@pytest.mark.parametrize(
    ("design", "effect", "tolerance"),
    [
        (FLAT, {}, 0.015),
        (DOME, {}, 0.05),
        (FLAT, {"absorption": {"red_per_mm": 0.02}}, 0.015),
        (FLAT, {"core_scatter": {"per_mm": 0.01}}, 0.03),
        (FLAT, {"delamination": {"x_mm": 3.0, "y_mm": 2.0, "radius_mm": 4.0}}, 0.015),
    ],
    ids=["plane", "dome", "absorbing", "hazy", "gap"],
)
@pytest.mark.llvm
def test_clear_and_spread_light_are_all_that_the_engine_finds_by_chance(design, effect, tolerance):
    rig, _ = effects.apply(Rig.of(design), effect)
    tracer, nodes = Tracer(rig, (0, 1, 2)), np.array([[2.0, 1.0, 0.1], [-5.0, 3.0, 0.5]])
    towards, _ = directions()
    index = np.arange(len(nodes) * len(towards), dtype=np.uint32)

    def received(trace, paths):
        found = trace(nodes, index, paths=paths, seed=1).reshape(3, len(nodes), -1)
        return (found * towards[:, 2]).sum(axis=(1, 2))

    parts = received(spread_trace(rig, (0, 1, 2), tracer), 64) + received(clear_trace(rig, (0, 1, 2)), 64)
    assert parts == pytest.approx(received(tracer.cells, 1024), rel=tolerance)


@pytest.mark.renders
@pytest.mark.llvm
def test_clear_light_leaves_nothing_to_chance_but_directions():
    tracer, towards = Tracer(Rig.of(FLAT), (0, 1, 2)), directions()[0]
    index = np.arange(len(towards), dtype=np.uint32)
    found = [
        (tracer.clear(NODE[None], index, paths=256, seed=seed) * towards[:, 2]).sum(axis=1) for seed in (1, 2)
    ]
    assert found[0] == pytest.approx(found[1], rel=4e-3)


def test_moved_bonded_leds_stay_joined_to_the_core():
    rig, _ = effects.apply(Rig.of(FLAT), {"led_position": {"height_mm": 0.7, "tangential_mm": 0.3}})
    boards = rig.boards
    sides = [wall for wall in rig.glass.walls if wall.name.startswith("core-side")]
    for number, normal in enumerate(boards.normal):
        front = boards.centre[number] + joining_mm(boards, number, rig.glass) * normal
        out = []
        for side in sides:
            a, b, c = side.vertices[side.faces[0]]
            outward = np.cross(b - a, c - a)
            outward *= np.sign(outward[:2] @ a[:2]) / np.linalg.norm(outward)
            out.append(outward @ (front - a))
        assert max(out) == pytest.approx(-JOINED_MM, abs=1e-9)


@pytest.mark.renders
@pytest.mark.llvm
def test_gap_between_gel_and_core_reflects_flat_light_totally():
    rig = Rig.of(FLAT.replace(BLACK | MATCHED))
    origin, direction, _, _ = towards_face(rig, 0, paths=200)
    assert (direction[:, 2] < np.sqrt(1 - 1 / 1.5**2)).all()
    crossing = NODE + direction * ((rig.glass.thickness_mm - NODE[2]) / direction[:, 2])[:, None]
    middle = crossing.mean(axis=0)
    gap = Disc(float(middle[0]), float(middle[1]), 2.5)
    apart = replace(rig, glass=replace(rig.glass, gap=gap))
    assert Tracer(rig, (0, 1, 2)).radiance(origin, direction, seed=7)[0].all()
    assert not Tracer(apart, (0, 1, 2)).radiance(origin, direction, seed=7)[0].any()


@pytest.mark.renders
@pytest.mark.llvm
def test_indices_of_one_are_light_in_air(monkeypatch):
    quick(monkeypatch, CLEAR_PATHS=12, SPREAD_PATHS=1, GLOW_PATHS=1, PITCH_MM=2.0, LEVELS=(0.0, 0.5))
    design = FLAT.replace(
        BLACK | {"optics.gelcore_index": 1.0, "optics.elastomer_index": 1.0, "sensing_area_mm": (6.0, 4.0)}
    )
    rig = Rig.of(design)
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-3, 3, 5), np.linspace(-2, 2, 3)))
    expected = Lighting(replace(rig, glass=None)).untouched.irradiance(x, y)
    found = ImmersedLighting(rig).untouched.irradiance(x, y)
    assert (found / expected - 1).std(axis=1) == pytest.approx(0.0, abs=0.012)
    assert (found / expected).mean(axis=1) == pytest.approx(1.0, abs=0.004)


@pytest.mark.slow
def test_even_sky_lights_a_flank_by_its_slope(monkeypatch):
    """Under a sky of unit radiance a convex flank of slope b receives pi (1 + cos b) / 2."""
    rig = Rig.of(FLAT)
    cells = len(directions()[0])
    axis = np.linspace(-9.0, 9.0, 7)
    even = ImmersedLightField(
        axis, axis, np.array([0.0, 1.0]), np.ones((3, 2, 7, 7, cells), np.float32), axis
    )
    monkeypatch.setattr(immersed, "light_field", lambda rig, seed: even)
    light = ImmersedLighting(rig)
    ball = Indenter(probes.parse("sphere:6"), 0.8, (0.0, 0.0))
    surface = indented(rig.elastomer, ball, kernel_length_mm=0.0, kernel_m=200.0)
    x = np.linspace(-1.5, 1.5, 13)
    y = np.zeros_like(x)
    slope = surface.normals(x, y)[:, 2]
    found = light.pressed(surface).arriving(x, y)
    assert found == pytest.approx(np.tile(np.pi * (1 + slope) / 2, (3, 1)), rel=4e-3)
    assert light.untouched.arriving(x, y) == pytest.approx(np.pi, rel=1e-3)


def test_transport_effects_have_no_parameters_in_air():
    rig = Rig.of(preset("gelsight-2020-flat"))
    for name in ("gelcore_index", "delamination", "absorption", "core_scatter"):
        assert effects.parameters(name, rig) == {}
        assert effects.parameters(name, Rig.of(FLAT))


@pytest.mark.renders
@pytest.mark.full
@pytest.mark.llvm
def test_untouched_and_pressed_gel_look_as_the_renderer_shows_them():
    """Independent transport: backward paths here, photons from the LEDs there; no gain is fitted."""
    simulator = Simulator(FLAT, columns=96, samples=1024, seed=3, estimator="fast")
    press = Press(probe=probes.parse("sphere:4"), depth_mm=0.8, centre_mm=(1.0, 0.5))
    shown = simulator.frame(None).basis, simulator.frame(press).basis
    caster = Caster(Rig.of(FLAT), FLAT.view(96))
    mine = caster.radiance(None), caster.radiance(Indenter(press.probe, press.depth_mm, press.centre_mm))
    for group in range(3):

        def blocks(picture):
            return picture.reshape(9, 8, 12, 8).mean(axis=(1, 3))

        ratio = blocks(mine[0][group]) / blocks(shown[0][group])
        assert ratio.mean() == pytest.approx(1.0, abs=0.01)
        assert ratio.std() < 0.01
        change, expected = (pair[1][group] - pair[0][group] for pair in (mine, shown))
        assert (change * expected).sum() / (expected**2).sum() == pytest.approx(1.0, abs=0.05)
        assert np.sqrt(((change - expected) ** 2).sum() / (expected**2).sum()) < 0.15


def test_a_design_that_states_a_gap_has_it():
    stated = FLAT.replace({"optics.gap_centre_mm": (1.0, -2.0), "optics.gap_radius_mm": 1.5})
    found = Rig.of(stated).glass
    assert found.gap == Disc(1.0, -2.0, 1.5)
    planted, _ = effects.apply(Rig.of(FLAT), {"delamination": {"x_mm": 1.0, "y_mm": -2.0, "radius_mm": 1.5}})
    assert planted.glass.gap == found.gap
    assert [wall.name for wall in found.walls] == [wall.name for wall in Rig.of(FLAT).glass.walls]
    assert Rig.of(FLAT).glass.gap is None


@pytest.mark.renders
@pytest.mark.llvm
def test_what_lies_behind_a_gap_is_seen_through_a_slab_of_air():
    """Share that passes gel, air and core over that through gel and core, by the closed form of a slab."""
    apart = FLAT.replace({"optics.gap_centre_mm": (1.5, 1.0), "optics.gap_radius_mm": 2.0})
    shares = []
    for design in (FLAT, apart):
        simulator = Simulator(design, columns=24, seed=1)
        untouched = simulator.surface(None)
        shares.append(transmission(simulator.scene(untouched), untouched, simulator.rays)[0])
    rays, thickness = simulator.rays, FLAT.elastomer.thickness_mm
    x, y = rays.x_mm + thickness * rays.slope_x, rays.y_mm + thickness * rays.slope_y
    cosine = 1 / np.sqrt(1 + rays.slope_x**2 + rays.slope_y**2)
    gel, core = FLAT.optics.gel_index, FLAT.optics.core_index
    expected = gap_transmission(cosine, gel, (gel, core)) / (1 - reflectance(cosine, gel, core))
    away = np.hypot(x - 1.5, y - 1.0)
    found = shares[1] / shares[0]
    np.testing.assert_allclose(found[away < 1.95], expected[away < 1.95], rtol=1e-3)
    np.testing.assert_allclose(found[away > 2.05], 1.0, rtol=1e-5)
    assert expected.max() < 0.97
