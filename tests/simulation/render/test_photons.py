"""Photons and light field against closed forms, energy balance and Mitsuba's path tracer."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from designlab.core import store
from designlab.sensor.camera import Camera
from designlab.sensor.contact import KernelContact
from designlab.sensor.design import preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.optics.viewing_rays import rays
from designlab.simulation.render import baking, bridge, gather, path, photons
from designlab.simulation.render.session import SESSION
from designlab.simulation.render.window import transmission
from designlab.simulation.scene.scene import Dielectric, Diffuse, Light, Medium, Scene, build
from designlab.simulation.simulator import Simulator
from geometries.probes import parse
from tests.helpers.closed_forms import block_means, direct_radiance
from tests.helpers.scenes import box

pytestmark = [pytest.mark.physics, pytest.mark.llvm, pytest.mark.usefixtures("backend"), pytest.mark.renders]

AIR = preset("gelsight-2020-flat").replace(
    {"optics.board_reflectance": (0.0,), "optics.path_length": 2, "mixing": None, "elastomer.width_mm": 31.0}
)
# The built-in sensor with one wide LED a side, which the path tracer finds often enough.
CORE = preset("default").replace(
    {
        "leds.emitting_width_mm": 12.0,
        "leds.emitting_spans_mm": ((-3.5, 3.5),),
        "leds.body_width_mm": 12.0,
        "leds.body_height_mm": 7.0,
        **{f"leds.groups.{k}.count": 1 for k in range(3)},
        "contact": KernelContact(),  # steeper walls; gel that bulges has tests of its own
    }
)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """Light fields of tests belong to the test alone."""
    monkeypatch.setenv(store.CACHE_VARIABLE, str(tmp_path))
    forget(monkeypatch)


def forget(monkeypatch):
    """Empty the memory of recent light fields."""
    for kept in ("_fields", "_shaders"):
        monkeypatch.setattr(SESSION, kept, {})


def view_of(design, columns, rows):
    whole = design.view(columns)
    return whole._replace(rows=rows, height_px=whole.width_px * rows / columns)


def arrivals(scene, *, count, seed=1, group=0):
    """Total power that arrives at the membrane (mW)."""
    import drjit as dr
    import mitsuba as mi

    # In many cells by place: one sum of so many small numbers would be rounded, the more the fewer threads.
    cells = 4096
    total = dr.zeros(mi.Float, cells)

    def record(arrival, active):
        place = mi.UInt32(mi.Int32(1e3 * dr.abs(arrival.at.p.x + 7.0 * arrival.at.p.y))) % cells
        dr.scatter_add(total, arrival.power, place, active)

    photons.trace(scene, group=group, photons=count, seed=seed, record=record)
    return float(np.asarray(total, dtype=float).sum())


def closed_box(reflectance, *inside, path_length):
    # tiny, for it casts a shadow
    half_mm = 0.01
    frame = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    light = Light(0, (-4.0, 0.3, 0.2), *frame, half_mm, half_mm, 1 / (np.pi * 4 * half_mm**2))
    return Scene(
        shapes=(box("membrane", 10.0, Diffuse((reflectance,)), inward=True), *inside),
        lights=(light,),
        groups=1,
        camera=Camera(position_mm=(0.0, 0.0, 4.0), width_px=16, height_px=16),
        view=view_of(AIR, 4, 3),
        path_length=path_length,
    )


@pytest.mark.parametrize(("reflectance", "path_length"), [(0.0, 4), (0.5, 4), (0.8, 11)])
def test_a_closed_box_receives_the_geometric_series_of_its_reflections(reflectance, path_length):
    # every photon meets the walls at each of path_length - 1 segments
    scene = closed_box(reflectance, path_length=path_length)
    expected = sum(reflectance**k for k in range(path_length - 1))
    assert arrivals(scene, count=200_000) == pytest.approx(expected, rel=2e-4)


def test_glass_between_passes_light_on_and_loses_none():
    glass = box("glass", 3.0, Dielectric(Medium(1.49, (0.0,)), Medium(1.0, (0.0,))), inward=False)
    scene = closed_box(0.0, glass, path_length=64)
    assert arrivals(scene, count=200_000) == pytest.approx(1.0, abs=2e-4)


def test_photons_of_a_panel_land_as_its_view_factor_says():
    design = AIR.replace({"elastomer.outline": "rectangle", "elastomer.length_mm": 31.0})
    surface = indent(design.elastomer, design.contact, None, area_mm=(4.0, 4.0), pitch_mm=1.0)
    scene = build(design, surface, design.view(8))
    # irradiance in closed form, summed over cells of 0.5 mm
    axis = (np.arange(62) + 0.5) / 2 - 15.5
    radiance = direct_radiance(design, *np.meshgrid(axis, axis))
    albedo = np.array(design.per_group("membrane_albedo"))
    expected = radiance.sum(axis=(1, 2)) * 0.5**2 * np.pi / albedo
    found = [arrivals(scene, count=1_000_000, group=group) for group in range(3)]
    np.testing.assert_allclose(found, expected, rtol=4e-3)


def test_direct_light_on_the_flat_gel_is_lamberts_closed_form():
    view = view_of(AIR, 24, 18)
    image = Simulator(AIR, view=view, samples=4, seed=1).frame(None).basis
    seen = rays(AIR, view)
    exact = direct_radiance(AIR, seen.x_mm, seen.y_mm)
    # where a panel's own board shades part of another one, the closed form does not hold: nowhere in view
    np.testing.assert_allclose(image, exact, rtol=5e-3)


@pytest.mark.parametrize("probe", ["sphere:6", "triangle:5", "cylinder:4"])
@pytest.mark.parametrize("path_length", [2, 4])
def test_a_press_shaded_from_the_field_is_what_the_path_tracer_renders(probe, path_length):
    design = AIR.replace({"optics.path_length": path_length})
    view = view_of(design, 64, 48)
    press = Press(probe=parse(probe), depth_mm=0.6, centre_mm=(1.0, -0.5), yaw_deg=20.0)
    shaded = Simulator(design, view=view, samples=16, seed=1).frame(press).basis
    traced = Simulator(design, view=view, samples=256, seed=1, estimator="path").frame(press).basis
    level = traced.mean(axis=(1, 2), keepdims=True)
    difference = (shaded - traced) / level
    assert np.abs(difference.mean(axis=(1, 2))).max() < 0.005
    assert np.abs(block_means(difference, 8)).max() < 0.05
    assert np.sqrt((difference**2).mean(axis=(1, 2))).max() < 0.03


HOLLOW = preset("pbr-fingertip-like")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("design", "samples"),
    [
        pytest.param(CORE, 1024, id="core"),
        # Paths seldom find its small LEDs.
        pytest.param(HOLLOW, 4096, id="hollow", marks=pytest.mark.full),
    ],
)
def test_behind_glass_both_estimators_agree_with_the_path_tracer(design, samples):
    view = view_of(design, 24, 18)
    press = Press(probe=parse("sphere:8"), depth_mm=0.8, centre_mm=(1.0, 0.5))
    sim = Simulator(design, view=view, samples=32, seed=1)
    scene = sim.scene(sim.surface(press))
    runs = np.array([path.radiance(scene, samples=samples, seed=s).mean(axis=(1, 2)) for s in range(3)])
    mean, error = runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(len(runs))
    assert (error < 0.01 * mean).all()
    for estimator in ("fast", "reference"):
        simulator = Simulator(design, view=view, samples=32, seed=1, estimator=estimator)
        found = simulator.frame(press).basis.mean(axis=(1, 2))
        assert (np.abs(found - mean) < 0.007 * mean + 3 * error).all()


def test_the_way_to_the_camera_costs_fresnels_share():
    import mitsuba as mi

    design = CORE
    seen = rays(design, view_of(design, 24, 18))
    surface = indent(design.elastomer, design.contact, None, area_mm=(20, 16), pitch_mm=0.5)
    scene = build(design, surface, design.view(4))
    passed = transmission(scene, surface, seen)[0]
    # normal incidence: 1 - ((n1 - n2) / (n1 + n2))^2 at each boundary, radiance falls with n^2
    normal = (1 - ((1.41 - 1.49) / 2.9) ** 2) * (1 - ((1.49 - 1) / 2.49) ** 2) / 1.41**2
    middle = np.unravel_index(np.hypot(seen.slope_x, seen.slope_y).argmin(), passed.shape)
    assert passed[middle] == pytest.approx(normal, rel=1e-4)
    # oblique: Mitsuba's Fresnel term, on the angle in each medium
    in_gel = np.arctan(np.hypot(seen.slope_x, seen.slope_y))
    in_core = np.arcsin(1.41 / 1.49 * np.sin(in_gel))
    expected = 1 / 1.41**2
    for cosine, ratio in ((np.cos(in_gel), 1.49 / 1.41), (np.cos(in_core), 1 / 1.49)):
        reflected = mi.fresnel(mi.Float(cosine.ravel().astype(np.float32)), ratio)[0]
        expected = expected * (1 - np.asarray(reflected).reshape(cosine.shape))
    np.testing.assert_allclose(passed, expected, rtol=2e-5)


def test_no_ray_of_a_camera_on_the_axis_slips_between_the_facets_of_a_round_core():
    # on the axes its rays run along edges of the mesh
    seen = rays(HOLLOW, view_of(HOLLOW, 640, 480))
    surface = indent(HOLLOW.elastomer, HOLLOW.contact, None, area_mm=(20, 16), pitch_mm=0.1)
    passed = transmission(build(HOLLOW, surface, HOLLOW.view(4)), surface, seen)
    assert passed.min() > 0.9 * np.median(passed)


def seen_through_mitsuba(design, view, *, opening=(0.5, 0.5)):
    """Where rays through pixel centres meet the membrane, refracted by Mitsuba at every boundary it finds.

    They pass a point of the lens opening, given in the unit square.
    """
    import drjit as dr
    import mitsuba as mi

    surface = indent(design.elastomer, design.contact, None, area_mm=(20, 16), pitch_mm=0.1)
    # LED boards do not matter for what the camera sees of the membrane
    scene = replace(build(design, surface, view), lights=build(design, surface, view).lights[:1])
    loaded = bridge.load(scene, group=0, integrator={"type": "path"}, samples=4)
    columns, rows = np.meshgrid(
        (np.arange(view.columns) + 0.5) / view.columns, (np.arange(view.rows) + 0.5) / view.rows
    )
    place = mi.Point2f(columns.ravel().astype(np.float32), rows.ravel().astype(np.float32))
    ray, _ = loaded.sensors()[0].sample_ray(0.0, 0.5, place, mi.Point2f(*opening))
    for _ in range(6):
        si = loaded.ray_intersect(ray)
        smooth = mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.DeltaTransmission)
        # a sample close to 1 chooses refraction rather than reflection
        sample, _ = si.bsdf().sample(mi.BSDFContext(), si, mi.Float(1 - 1e-6), mi.Point2f(0.5))
        following = si.spawn_ray(si.to_world(sample.wo))
        ray.o = dr.select(smooth, following.o, ray.o)
        ray.d = dr.select(smooth, following.d, ray.d)
    si = loaded.ray_intersect(ray)
    assert dr.all(mi.Bool(si.shape == next(s for s in loaded.shapes() if s.id() == "membrane")))
    shape = (view.rows, view.columns)
    return np.asarray(si.p.x).reshape(shape), np.asarray(si.p.y).reshape(shape)


def test_pixels_see_what_mitsubas_rays_see_through_the_glass():
    view = view_of(CORE, 24, 18)
    x, y = seen_through_mitsuba(CORE, view)
    seen = rays(CORE, view)
    # Mitsuba starts a refracted ray 1 um beyond the boundary
    np.testing.assert_allclose(x, seen.x_mm, atol=1e-3)
    np.testing.assert_allclose(y, seen.y_mm, atol=1e-3)


@pytest.mark.parametrize("opening", [(0.5, 0.5), (0.9, 0.3), (0.1, 0.65)])
@pytest.mark.parametrize(
    "lens",
    [
        {"camera.lens": "fisheye", "camera.horizontal_fov_deg": 110.0, "camera.distortion.k1": -0.03},
        {"camera.distortion": {"k1": -0.3, "k2": 0.1, "p1": 0.004}, "camera.principal_point_px": (850, 600)},
    ],
    ids=["fisheye", "barrel"],
)
def test_pixels_of_an_open_lens_see_what_mitsubas_rays_see(lens, opening):
    import mitsuba as mi

    design = CORE.replace({**lens, "camera.focus_mm": 15.0, "camera.aperture_mm": 2.0})
    view = view_of(design, 24, 18)
    x, y = seen_through_mitsuba(design, view, opening=opening)
    point = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(*opening))
    u, v = (float(np.asarray(c).ravel()[0]) for c in (point.x, point.y))
    seen = rays(design, view, lens_point=(u, v))
    np.testing.assert_allclose(x, seen.x_mm, atol=1e-3)
    np.testing.assert_allclose(y, seen.y_mm, atol=1e-3)


def test_pixels_see_what_mitsubas_rays_see_through_a_dome():
    dome = preset("gelsight-2020-dome").replace(
        {"optics.light_path": "core", "leds.radius_mm": 17.0, "leds.tilt_deg": 0.0}
    )
    view = view_of(dome, 24, 18)
    x, y = seen_through_mitsuba(dome, view)
    surface = indent(dome.elastomer, dome.contact, None, area_mm=(20, 16), pitch_mm=0.05)
    found_x, found_y = rays(dome, view).hit(surface)
    # Mitsuba's dome is made of plane facets some 0.3 by 1 mm large
    pixel_mm = 16.0 / 24
    miss = np.hypot(found_x - x, found_y - y)
    assert miss.max() < 0.05 * pixel_mm
    assert abs((found_x - x).mean()) < 2e-3
    assert abs((found_y - y).mean()) < 2e-3


def picture(design, *, seed=1, half=None, **settings):
    simulator = Simulator(design, view=view_of(design, 16, 12), samples=16, seed=seed, **settings)
    return simulator.frame(None, half=half).basis


def test_photons_seen_by_the_camera_are_the_shaded_picture():
    # neither shares with the other how the camera sees a point, nor what a press does to light
    press = Press(probe=parse("triangle:5"), depth_mm=0.6, centre_mm=(1.0, -0.5), yaw_deg=20.0)
    view = view_of(CORE, 32, 24)
    shaded = Simulator(CORE, view=view, samples=32, seed=1).frame(press).basis
    traced = Simulator(CORE, view=view, samples=32, seed=2, estimator="reference").frame(press).basis
    difference = (shaded - traced) / traced.mean(axis=(1, 2), keepdims=True)
    assert np.abs(difference.mean(axis=(1, 2))).max() < 0.01
    assert np.abs(block_means(difference, 4)).max() < 0.05


def test_the_correction_takes_a_wrong_light_field_back_to_the_unbiased_picture(monkeypatch):
    # a light field that holds a fifth too much light stands for whatever bias fast has
    from designlab.simulation.render.shading import Shader

    shaded = Shader.radiance
    monkeypatch.setattr(Shader, "radiance", lambda self, *a, **k: np.float32(1.2) * shaded(self, *a, **k))
    view = view_of(AIR, 32, 24)
    found = Simulator(AIR, view=view, samples=4, seed=1, estimator="corrected").frame(None).basis
    traced = Simulator(AIR, view=view, samples=256, seed=2, estimator="reference").frame(None).basis
    np.testing.assert_allclose(found.mean(axis=(1, 2)), traced.mean(axis=(1, 2)), rtol=2e-3)
    wrong = Simulator(AIR, view=view, samples=4, seed=1).frame(None).basis
    np.testing.assert_allclose(wrong.mean(axis=(1, 2)), 1.2 * traced.mean(axis=(1, 2)), rtol=5e-3)


@pytest.mark.slow
def test_haze_veils_the_picture_as_the_path_tracer_says():
    hazy = CORE.replace(
        {
            "optics.gelcore_scattering_per_mm": 0.02,
            "optics.gelcore_anisotropy": 0.9,
            "optics.path_length": 20,
        }
    )
    view = view_of(hazy, 24, 18)
    paths = [
        Simulator(hazy, view=view, samples=512, seed=s, estimator="path").frame(None).basis for s in range(3)
    ]
    means = np.array([p.mean(axis=(1, 2)) for p in paths])
    error, mean = means.std(axis=0, ddof=1) / np.sqrt(3), means.mean(axis=0)
    assert (error < 0.01 * mean).all()
    for estimator in ("fast", "reference"):
        simulator = Simulator(hazy, view=view, samples=64, seed=1, estimator=estimator)
        found = simulator.frame(None).basis.mean(axis=(1, 2))
        assert (np.abs(found - mean) < 0.01 * mean + 3 * error).all()
    clear = Simulator(CORE, view=view, samples=16, seed=1).frame(None).basis.mean(axis=(1, 2))
    assert (np.abs(mean / clear - 1) > 0.01).any()  # else there is nothing to see


@pytest.mark.parametrize(
    ("field", "value", "least"),
    [("optics.gelcore_absorption_per_mm", (0.005,) * 3, 8.0), ("optics.board_reflectance", (0.3,) * 3, 3.0)],
)
def test_sensors_that_differ_little_share_their_random_numbers(field, value, least):
    view, other = view_of(CORE, 48, 36), CORE.replace({field: value})

    def basis(design, like=None):
        return Simulator(design, view=view, samples=16, seed=1, like=like).frame(None).basis

    def grain(ratio):
        return (ratio / gaussian_filter(ratio, (0, 2, 2))).std(axis=(1, 2))

    plain = basis(CORE)
    alone, alike = grain(basis(other) / plain), grain(basis(other, CORE) / plain)
    assert (alike < alone / least).all()
    # What they share rules the noise, not the mean.
    np.testing.assert_allclose(
        basis(other, CORE).mean(axis=(1, 2)), basis(other).mean(axis=(1, 2)), rtol=0.01
    )


def test_sensors_with_other_numbers_of_leds_share_nothing():
    simulator = Simulator(CORE, view=view_of(CORE, 16, 12), samples=4, seed=1, like=preset("default"))
    with pytest.raises(ValueError, match="like: must have as many LEDs"):
        simulator.frame(None)


def test_halves_are_independent_and_average_to_the_whole():
    short = CORE.replace({"optics.path_length": 8})
    whole, first, second = picture(short), picture(short, half=0), picture(short, half=1)
    # what little is left comes from which bins were bright enough to be kept apart
    spread = np.abs(first - second).mean()
    assert spread > 1e-4 * whole.mean()
    assert np.abs((first + second) / 2 - whole).mean() < 0.1 * spread


def test_a_seed_gives_the_same_field_again_and_another_another(monkeypatch):
    short = CORE.replace({"optics.path_length": 8})
    first = picture(short)
    # from the cache on disk, and traced anew
    forget(monkeypatch)
    np.testing.assert_array_equal(picture(short), first)
    monkeypatch.setattr("designlab.core.store.read_cache", lambda key: None)
    forget(monkeypatch)
    np.testing.assert_allclose(picture(short), first, rtol=1e-4)
    assert np.abs(picture(short, seed=2) - first).mean() > 1e-4 * first.mean()


def test_one_field_serves_every_view(monkeypatch):
    baked = []
    original = baking.bake
    monkeypatch.setattr(baking, "bake", lambda *a, **k: baked.append(k["seeds"]) or original(*a, **k))
    short = CORE.replace({"optics.path_length": 6})
    press = Press(probe=parse("sphere:4"), depth_mm=0.4)
    for view in (view_of(short, 16, 12), view_of(short, 24, 18)._replace(width_px=200.0, height_px=150.0)):
        Simulator(short, view=view, samples=2, seed=1).frame(press)
    assert baked == [(2, 3)]  # its two halves


def test_a_point_beside_the_membrane_gathers_no_number():
    design = preset("gelsight-2020-flat")
    surface = indent(design.elastomer, design.contact, None, area_mm=(4.0, 4.0), pitch_mm=1.0)
    scene = build(design, surface, design.view(8))
    loaded = photons.load(scene, 0)
    settings = {"group": 0, "photons_traced": 1000, "seed": 1, "loaded": loaded, "guide": None}
    found = gather.irradiance(scene, np.array([0.3, 99.0]), np.array([0.4, 0.0]), **settings)
    assert found[0] > 0
    assert np.isnan(found[1])


@pytest.mark.parametrize("specular", [0.0, 0.4])
def test_light_reflected_on_its_way_through_air_is_that_of_path_tracing(specular):
    # 2 to 7 % of a dome's light, found at all points at once; what a lobe sent on lands photon by photon
    dome = preset("gelsight-2020-dome").replace(
        {"optics.coating_specular": specular, "optics.coating_roughness": 0.5}
    )
    view = view_of(dome, 16, 12)
    fast, traced = (
        Simulator(dome, view=view, samples=samples, seed=1, estimator=estimator).frame(None).basis
        for samples, estimator in ((256, "fast"), (4096, "path"))
    )
    blocks = block_means(fast / traced, 4)
    # the path tracer's own noise is 0.06 % of a block
    assert np.abs(blocks - 1).max() < (0.006 if specular else 0.003)
    assert (blocks / blocks.mean(axis=(1, 2), keepdims=True)).std() < (0.0015 if specular else 0.001)
