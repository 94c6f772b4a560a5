"""Media, boundaries and interreflection in the path tracer against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.sensor.design import preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.render import path
from designlab.simulation.scene.scene import Coating, Dielectric, Diffuse, Medium, Scene, Texture, build
from designlab.simulation.scene.static_parts import core_and_gel
from designlab.simulation.simulator import Simulator
from tests.helpers.scenes import box, far_camera, rectangle_light, sheet_at, view_of

pytestmark = [pytest.mark.physics, pytest.mark.usefixtures("backend"), pytest.mark.renders]

AIR = Medium(1.0, (0.0,))


def fresnel(cos_in, ratio):
    """Reflectance of unpolarised light; `ratio` is the index behind over the one before the boundary."""
    cos_out = np.sqrt(np.maximum(1 - (1 - cos_in**2) / ratio**2, 0.0))
    senkrecht = (cos_in - ratio * cos_out) / (cos_in + ratio * cos_out)
    parallel = (cos_out - ratio * cos_in) / (cos_out + ratio * cos_in)
    return (senkrecht**2 + parallel**2) / 2


def slab(medium, *, thickness_mm, reach_mm=4000.0):
    """Wide plate of a medium in air."""
    return (
        sheet_at("lower", 10.0, reach_mm, Dielectric(AIR, medium)),
        sheet_at("upper", 10.0 + thickness_mm, reach_mm, Dielectric(medium, AIR)),
    )


def seen_through(shapes, *, view, camera, samples=64, path_length=40):
    """Radiance over that of a wide black-body-like panel below, seen through what lies between."""
    light = rectangle_light(half_mm=4000.0, z_mm=0.0)
    membrane = sheet_at("membrane", -1.0, 1.0, Diffuse((0.0,)))
    scene = Scene((membrane, *shapes), (light,), 1, camera, view, path_length)
    return path.radiance(scene, samples=samples, seed=1)[0] / light.radiance


@pytest.mark.parametrize("absorption_per_mm", [0.0, 0.1, 0.5])
def test_a_plate_passes_what_fresnel_and_beer_lambert_say(absorption_per_mm):
    # All orders of reflection within the plate: T = (1 - R)^2 a / (1 - R^2 a^2), a = exp(-k d / cos).
    camera = far_camera(height_mm=100.0, fov_deg=110.0)
    view = view_of(camera, 32, 24)
    found = seen_through(
        slab(Medium(1.5, (absorption_per_mm,)), thickness_mm=4.0), view=view, camera=camera, samples=1024
    )
    columns = view.x_px + (np.arange(32) + 0.5) * view.width_px / 32
    rows = view.y_px + (np.arange(24) + 0.5) * view.height_px / 24
    x, y = np.meshgrid((columns - camera.width_px / 2), (rows - camera.height_px / 2))
    tangent = np.hypot(x, y) / camera.focal_px
    cos_out = 1 / np.sqrt(1 + tangent**2)
    cos_in = np.sqrt(1 - (1 - cos_out**2) / 1.5**2)
    r, a = fresnel(cos_out, 1.5), np.exp(-absorption_per_mm * 4.0 / cos_in)
    expected = (1 - r) ** 2 * a / (1 - r**2 * a**2)
    assert tangent.max() > 1.4  # up to 55 deg
    inner = tangent < 0.7
    for part in (inner, ~inner):
        assert found[part].mean() == pytest.approx(expected[part].mean(), rel=5e-3)


def test_the_plates_absorption_is_each_groups_own():
    camera = far_camera(height_mm=100.0, fov_deg=10.0)
    view = view_of(camera, 16, 12)
    both = Medium(1.5, (0.0, 0.2))
    light = rectangle_light(half_mm=4000.0, z_mm=0.0)
    membrane = sheet_at("membrane", -1.0, 1.0, Diffuse((0.0, 0.0)))
    air = Medium(1.0, (0.0, 0.0))
    plate = (
        sheet_at("lower", 10.0, 4000.0, Dielectric(air, both)),
        sheet_at("upper", 14.0, 4000.0, Dielectric(both, air)),
    )
    scene = Scene((membrane, *plate), (light, replace(light, group=1)), 2, camera, view, 40)
    found = path.radiance(scene, samples=1024, seed=1).mean(axis=(1, 2)) / light.radiance
    r, a = 0.04, np.exp(-0.2 * 4.0)
    assert found[0] == pytest.approx((1 - r) / (1 + r), rel=5e-3)
    assert found[1] == pytest.approx((1 - r) ** 2 * a / (1 - (r * a) ** 2), rel=5e-3)


def test_light_is_reflected_as_fresnel_says_and_all_of_it_beyond_the_critical_angle():
    import drjit as dr
    import mitsuba as mi

    from designlab.simulation.render.surfaces import bsdf

    boundary = mi.load_dict(bsdf(Dielectric(Medium(1.49, (0.0,)), AIR), 0))
    cosine = np.linspace(0.02, 1.0, 99)
    for sign, ratio in ((1.0, 1.49), (-1.0, 1 / 1.49)):  # normals point out into the air
        found = []
        for z in cosine:
            at = dr.zeros(mi.SurfaceInteraction3f)
            at.wi = mi.Vector3f(float(np.sqrt(1 - z**2)), 0.0, float(sign * z))
            # the first of the choices is reflection, taken with Fresnel's probability
            sample, _ = boundary.sample(mi.BSDFContext(), at, 0.0, mi.Point2f(0.5))
            found.append(float(np.ravel(sample.pdf)[0]))
        expected = fresnel(cosine, ratio)
        expected[1 - cosine**2 > ratio**2] = 1.0
        np.testing.assert_allclose(found, expected, atol=2e-5)
    assert (expected == 1.0).any()


@pytest.mark.parametrize(
    "inside",
    [Medium(1.49, (0.0,)), Medium(1.49, (0.0,), 0.3, 0.8), Medium(1.0, (0.0,), 0.5, 0.0)],
    ids=["clear", "haze forward", "haze without boundary"],
)
def test_in_a_glowing_cavity_a_core_without_loss_cannot_be_seen(inside):
    # All walls shine alike: radiance is the same everywhere, whatever refracts and scatters without loss.
    camera = far_camera(height_mm=9.0, fov_deg=60.0)
    view = view_of(camera, 32, 24)
    core = box("core", 6.0, Dielectric(inside, AIR), inward=False)
    membrane = sheet_at("membrane", -9.95, 0.01, Diffuse((0.0,)))
    lights = tuple(rectangle_light(half_mm=10.0, face=face) for face in range(6))
    scene = Scene((membrane, core), lights, 1, camera, view, 400)
    found = path.radiance(scene, samples=64, seed=1)[0] / lights[0].radiance
    assert found.mean() == pytest.approx(1.0, abs=2e-3)
    assert np.abs(found.mean(axis=0) - 1).max() < 0.01


@pytest.mark.parametrize("inside", [None, Medium(1.49, (0.0,)), Medium(1.49, (0.0,), 0.3, 0.8)])
def test_in_a_white_cavity_every_milliwatt_is_accounted_for(inside):
    # Walls of reflectance 0.5 shine with 1 mW in all: at every wall the radiance is Le / (1 - 0.5), and what
    # the walls absorb, 0.5 pi L over their area, is the milliwatt that they emit.
    camera = far_camera(height_mm=9.0, fov_deg=60.0)
    view = view_of(camera, 32, 24)
    shapes = [
        sheet_at("board", -9.95, 0.01, Diffuse((0.5,))),
        sheet_at("membrane", -9.95, 0.01, Diffuse((0.5,))),
    ]
    if inside is not None:
        shapes.append(box("core", 6.0, Dielectric(inside, AIR), inward=False))
    area = 6 * 20.0**2
    lights = tuple(
        replace(rectangle_light(half_mm=10.0, face=face), radiance=1 / (np.pi * area)) for face in range(6)
    )
    scene = Scene(tuple(shapes), lights, 1, camera, view, 100)
    radiance = path.radiance(scene, samples=64, seed=1)[0].mean()
    absorbed_mw = (1 - 0.5) * np.pi * radiance * area
    assert absorbed_mw == pytest.approx(1.0, abs=2e-3)


DOME = preset("gelsight-2020-dome").replace(
    {
        "optics.board_reflectance": (0.0,),
        "mixing": None,
        "elastomer.radius_mm": 20.0,
        "elastomer.width_mm": 2 * 20.0 * np.sin(np.radians(60.0)),
        "gelcore.radius_mm": 18.0,
        "gelcore.width_mm": 36.0,
    }
)


@pytest.mark.parametrize("albedo", [0.3, 0.8])
def test_a_dome_lights_itself_as_an_integrating_sphere(albedo):
    # Between any two points of a sphere the view factor is dA / (4 pi R^2): light from the dome falls on it
    # evenly, E = rho Phi / (4 pi R^2) / (1 - rho f), f the cap's share of the sphere. A small Lambertian
    # source of 1 mW in the centre puts E0 = cos / (pi R^2) on it, Phi = sin^2(60 deg) in all.
    radius, share = 20.0, (1 - np.cos(np.radians(60.0))) / 2
    surface = indent(DOME.elastomer, DOME.contact, None, area_mm=(34.0, 34.0), pitch_mm=0.05)
    camera = far_camera(height_mm=19.0, fov_deg=60.0)
    view = view_of(camera, 24, 18)
    built = build(DOME, surface, view)
    membrane = replace(built.membrane, material=Coating((albedo,)))
    light = rectangle_light(half_mm=0.05, z_mm=radius, down=True)
    scene = Scene((membrane,), (light,), 1, camera, view, 40)
    found = path.radiance(scene, samples=1024, seed=1)[0]
    direct = path.radiance(replace(scene, path_length=2), samples=1024, seed=1)[0]
    evenly = albedo * np.sin(np.radians(60.0)) ** 2 / (4 * np.pi * radius**2) / (1 - albedo * share)
    again = found - direct
    assert again.mean() == pytest.approx(albedo / np.pi * evenly, rel=5e-3)
    blocks = again.reshape(3, 6, 4, 6).mean(axis=(1, 3))
    np.testing.assert_allclose(blocks, again.mean(), rtol=0.02)
    middle = direct[8:10, 11:13].mean()
    assert middle == pytest.approx(albedo / np.pi / (np.pi * radius**2), rel=5e-3)


@pytest.mark.parametrize("light_path", ["air", "core"])
def test_a_dome_of_huge_radius_is_a_flat_gel(light_path):
    flat = preset("default").replace(
        {
            "optics.light_path": light_path,
            "optics.path_length": 8,
            "elastomer.outline": "round",
            "elastomer.width_mm": 25.0,
            "leds.emitting_width_mm": 10.0,
            "leds.body_width_mm": 10.0,
            "leds.groups.0.count": 1,
            "leds.tilt_deg": 20.0,
        }
    )
    dome = flat.replace({"elastomer.shape": "dome", "elastomer.radius_mm": 1e6})
    images = []
    for design in (flat, dome):
        view = flat.view(12)._replace(rows=9)
        surface = indent(design.elastomer, design.contact, None, area_mm=(18, 14), pitch_mm=0.1)
        images.append(path.radiance(build(design, surface, view), samples=64, seed=1))
    level = images[0].mean(axis=(1, 2))
    np.testing.assert_allclose(images[1].mean(axis=(1, 2)), level, rtol=5e-3)


def test_groups_superpose_and_light_is_linear_in_power_in_an_absorbing_core():
    camera = far_camera(height_mm=60.0, fov_deg=20.0)
    view = view_of(camera, 12, 9)
    medium, air = Medium(1.49, (0.02, 0.02, 0.02), 0.02, 0.5), Medium(1.0, (0.0, 0.0, 0.0))
    core = box("core", 12.0, Dielectric(medium, air), inward=False)
    membrane = sheet_at("membrane", -8.0, 30.0, Diffuse((0.5, 0.5, 0.5)))
    first = rectangle_light(half_mm=4.0, z_mm=14.0, down=True, x_mm=20.0)
    second = rectangle_light(half_mm=4.0, z_mm=14.0, down=True, x_mm=-20.0)
    lights = (
        first,
        replace(second, group=1),
        replace(first, group=2, radiance=3 * first.radiance),
        replace(second, group=2, radiance=2 * second.radiance),
    )
    scene = Scene((membrane, core), lights, 3, camera, view, 12)
    runs = np.array([path.radiance(scene, samples=1024, seed=seed).mean(axis=(1, 2)) for seed in range(16)])
    one, two, both = runs.T
    excess = both / (3 * one + 2 * two).mean() - (3 * one + 2 * two) / (3 * one + 2 * two).mean()
    error = excess.std(ddof=1) / np.sqrt(len(runs))
    assert error < 5e-3
    assert abs(excess.mean()) < 4 * error


def test_a_coatings_brdf_is_the_one_mitsuba_evaluates():
    import drjit as dr
    import mitsuba as mi

    from designlab.simulation.render.surfaces import bsdf
    from designlab.simulation.scene.coating import coating_brdf

    rng = np.random.default_rng(1)
    cosine, turn = rng.uniform(0.02, 1, (2, 100)), rng.uniform(0, 2 * np.pi, (2, 100))
    sine = np.sqrt(1 - cosine**2)
    a, b = (np.stack([sine[k] * np.cos(turn[k]), sine[k] * np.sin(turn[k]), cosine[k]]) for k in (0, 1))
    half = (a + b)[2] / np.linalg.norm(a + b, axis=0)
    for specular, roughness in ((0.0, 0.3), (0.4, 0.25), (1.0, 0.1)):
        surface = mi.load_dict(bsdf(Coating((0.7,), specular, roughness), 0))
        found = []
        for towards, back in zip(a.T, b.T, strict=True):
            at = dr.zeros(mi.SurfaceInteraction3f)
            at.wi = mi.Vector3f(*towards.tolist())
            value = surface.eval(mi.BSDFContext(), at, mi.Vector3f(*back.tolist()))[0]
            found.append(float(np.ravel(value)[0]))
        expected = coating_brdf(
            cosine[1], cosine[0], half, reflectance=0.7, specular=specular, roughness=roughness
        )
        np.testing.assert_allclose(found, expected * cosine[1], rtol=1e-4)


def test_the_path_tracer_sees_a_texture_where_it_lies():
    values = np.zeros((1, 2, 2), dtype=np.float32)
    values[0] = [[1.0, 0.5], [0.25, 0.75]]
    material = Coating((0.8,), texture=Texture(values, 20.0, 16.0))
    membrane = sheet_at("membrane", 0.0, 12.0, material)
    camera = far_camera(height_mm=40.0, fov_deg=25.0)
    view = view_of(camera, 32, 24)
    light = rectangle_light(half_mm=0.5, z_mm=60.0, down=True)
    found = path.radiance(Scene((membrane,), (light,), 1, camera, view, 2), samples=64, seed=1)[0]
    direct = 0.8 / np.pi / (np.pi * 60.0**2)
    # beyond the centres of its cells the edge goes on: (x, y) = (-6.6, 5.0) and so on
    corners = found[[2, 2, -3, -3], [2, -3, 2, -3]] / direct
    np.testing.assert_allclose(corners, [1.0, 0.5, 0.25, 0.75], rtol=0.05)
    assert corners[0] == pytest.approx(np.cos(np.arctan(np.hypot(6.9, 5.1) / 60)) ** 4, rel=0.01)


def test_black_walls_of_a_housing_need_no_shape_and_white_ones_light_up_the_gel():
    dark = preset("gelsight-2020-flat").replace({"optics.path_length": 6, "mixing": None})
    images = []
    for reflectance in (0.0, 1e-9, 0.8):
        design = dark.replace({"optics.housing_reflectance": (reflectance,)})
        view = design.view(16)._replace(rows=12)
        surface = indent(design.elastomer, design.contact, None, area_mm=(18, 14), pitch_mm=0.1)
        images.append(path.radiance(build(design, surface, view), samples=256, seed=1))
    level = images[0].mean(axis=(1, 2))
    # the camera looks through the hole of the plate: walls that reflect nothing change nothing
    np.testing.assert_allclose(images[1].mean(axis=(1, 2)), level, rtol=5e-3)
    assert (images[2].mean(axis=(1, 2)) > 1.1 * level).all()


@pytest.mark.parametrize(
    "changes",
    [
        {"optics.gelcore_absorption_per_mm": (0.05,)},
        {"optics.marker_pitch_mm": 1.5, "optics.marker_diameter_mm": 1.2},
        {"optics.coating_specular": 0.5},
    ],
    ids=["absorption", "markers", "gloss"],
)
def test_absorption_markers_and_gloss_come_out_alike_however_a_picture_is_made(changes):
    design = preset("default").replace(
        {
            "optics.path_length": 10,
            "leds.emitting_width_mm": 12.0,
            "leds.emitting_spans_mm": ((-3.5, 3.5),),
            "leds.body_width_mm": 12.0,
            "leds.body_height_mm": 7.0,
            **{f"leds.groups.{k}.count": 1 for k in range(3)},
            **changes,
        }
    )
    sim = Simulator(design, view=design.view(48)._replace(rows=36), samples=64, seed=1)
    scene = sim.scene(sim.surface(None))
    runs = np.array([path.radiance(scene, samples=64, seed=seed).mean() for seed in range(2, 8)])
    found = sim.frame(None).basis.mean()
    spread = runs.std(ddof=1)
    assert spread < 0.02 * runs.mean()
    # the fast way has a bias of its own of up to a percent
    assert abs(found - runs.mean()) < 2 * spread + 0.01 * runs.mean()


def test_a_round_side_focuses_like_the_curve_it_is_turned_to():
    """Level light near the axis meets n R / (n - 1) behind the side; behind a flat facet it would not."""
    import mitsuba as mi

    from designlab.simulation.render import bridge

    design = preset("gelsight-2020-dome-core")
    sides = [s for s in core_and_gel(design) if s.name.startswith("core-side")]
    radius, index = design.gelcore.width_mm / 2, design.optics.core_index
    aside, far = np.array([0.2, 0.35, 0.5], dtype=np.float32), np.full(3, 30.0, dtype=np.float32)
    level = np.full(3, max(s.vertices[:, 2].max() for s in sides) - 3.0, dtype=np.float32)
    hit = bridge.load_shapes(sides).ray_intersect(
        mi.Ray3f(mi.Point3f(aside, far, level), mi.Vector3f(0.0, -1.0, 0.0))
    )
    assert np.array(hit.is_valid()).all()
    place, normal = np.array(hit.p).T, np.array(hit.sh_frame.n).T
    cosine = normal[:, 1]
    beyond = np.sqrt(1 - (1 - cosine**2) / index**2)
    bent = np.array([0.0, -1.0, 0.0]) / index + (cosine / index - beyond)[:, None] * normal
    crosses = -place[:, 0] / bent[:, 0] * -bent[:, 1]
    np.testing.assert_allclose(crosses, index * radius / (index - 1), rtol=0.02)
