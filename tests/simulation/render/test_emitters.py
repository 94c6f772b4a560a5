"""Profiled and bonded LEDs: photons and path tracer against closed forms and the Fresnel integral."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2

from designlab.core import store
from designlab.sensor.camera import Camera, View
from designlab.sensor.design import preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.render import path, photons
from designlab.simulation.scene.scene import Diffuse, Light, Scene, Shape, build
from designlab.simulation.simulator import Simulator
from geometries.emission import AngularProfile
from tests.helpers.scenes import box

pytestmark = [pytest.mark.physics, pytest.mark.llvm, pytest.mark.usefixtures("backend"), pytest.mark.renders]

DISTANCE_MM, HALF_MM = 10.0, 0.02
FOV_DEG = 2 * np.degrees(np.arctan(16.0 / 60.0))  # focal length of 60 px
NARROW = AngularProfile(exponent=20.0)
WIDE = AngularProfile(exponent=0.5)
# two mirror planes, wide along the row and narrow towards the membrane
OVAL = AngularProfile(
    polar_deg=(0, 20, 40, 60, 90),
    azimuth_deg=(0, 45, 90),
    intensity=((10, 9, 7, 3, 0), (10, 8, 4, 1, 0), (10, 5, 1, 0.2, 0)),
)
LOPSIDED = AngularProfile(
    polar_deg=(0, 30, 60, 90),
    azimuth_deg=(0, 90, 180, 270, 360),
    intensity=((8, 9, 4, 0), (8, 6, 2, 0), (8, 3, 1, 0), (8, 6, 0.5, 0), (8, 9, 4, 0)),
)


def axes(tilt_deg=25.0, turn_deg=35.0):
    """Across, down and normal of a small LED above the plane that looks down at a slant."""
    t, a = np.radians(tilt_deg), np.radians(turn_deg)
    across = np.array([-np.sin(a), np.cos(a), 0.0])
    normal = np.array([-np.cos(a) * np.sin(t), -np.sin(a) * np.sin(t), -np.cos(t)])
    return across, np.cross(normal, across), normal


def over_a_plane(profile, *, half_mm=40.0, albedo=1.0):
    across, down, normal = (tuple(v.tolist()) for v in axes())
    light = Light(
        0, (0.0, 0.0, DISTANCE_MM), normal, across, down, HALF_MM, HALF_MM, 1 / (np.pi * 4 * HALF_MM**2),
        profile,
    )  # fmt: skip
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) * half_mm
    plane = Shape("membrane", corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32), Diffuse((albedo,)))
    return Scene(
        shapes=(plane,),
        lights=(light,),
        groups=1,
        camera=Camera(position_mm=(0.0, 0.0, 30.0), width_px=32, height_px=32, horizontal_fov_deg=FOV_DEG),
        view=View(0.0, 0.0, 32.0, 32.0, 32, 32),
        path_length=2,
    )


def irradiance(profile, x, y):
    """Of a point source of 1 mW at the LED: share of its flux by solid angle times cosine over distance^2."""
    across, down, normal = axes()
    to = np.stack([x, y, np.full_like(x, -DISTANCE_MM)], axis=-1)
    distance = np.linalg.norm(to, axis=-1)
    to = to / distance[..., None]
    polar = np.degrees(np.arccos(np.clip(to @ normal, -1, 1)))
    share = profile.share_per_sr(polar, np.degrees(np.arctan2(to @ down, to @ across)))
    return share * -to[..., 2] / distance**2


@pytest.mark.parametrize(
    "profile", [NARROW, WIDE, OVAL, LOPSIDED], ids=["narrow", "wide", "oval", "lopsided"]
)
def test_the_path_tracer_lights_a_plane_as_the_profile_says(profile):
    scene = over_a_plane(profile)
    found = path.radiance(scene, samples=64, seed=1)[0] * np.pi
    fine = (np.arange(32 * 4) + 0.5) / 4 - 16.0
    column, row = np.meshgrid(fine, fine)
    x, y = column / 60.0 * 30.0, -row / 60.0 * 30.0
    exact = irradiance(profile, x, y).reshape(32, 4, 32, 4).mean(axis=(1, 3))
    blocks = [image.reshape(8, 4, 8, 4).mean(axis=(1, 3)) for image in (found, exact)]
    np.testing.assert_allclose(blocks[0], blocks[1], rtol=5e-3, atol=5e-4 * exact.max())


@pytest.mark.parametrize(
    "profile", [NARROW, WIDE, OVAL, LOPSIDED], ids=["narrow", "wide", "oval", "lopsided"]
)
def test_photons_land_on_a_plane_as_the_profile_says(profile):
    import drjit as dr
    import mitsuba as mi

    count, cells, half_mm = 1_000_000, 10, 10.0
    table = dr.zeros(mi.Float, cells * cells)

    def record(arrival, active):
        position = arrival.at.p
        column = mi.Int32(dr.floor((position.x + half_mm) / (2 * half_mm) * cells))
        row = mi.Int32(dr.floor((position.y + half_mm) / (2 * half_mm) * cells))
        inside = (column >= 0) & (column < cells) & (row >= 0) & (row < cells)
        dr.scatter_add(table, 1.0, mi.UInt32(row * cells + column), active & inside)

    photons.trace(over_a_plane(profile), group=0, photons=count, seed=5, record=record)
    found = np.asarray(table).reshape(cells, cells)
    fine = (np.arange(cells * 40) + 0.5) / 40 * (2 * half_mm / cells) - half_mm
    x, y = np.meshgrid(fine, fine)
    density = irradiance(profile, x, y).reshape(cells, 40, cells, 40).mean(axis=(1, 3))
    expected = density * (2 * half_mm / cells) ** 2 * count
    likely = expected > 20
    statistic = ((found - expected)[likely] ** 2 / expected[likely]).sum()
    assert statistic < chi2.ppf(1 - 1e-4, likely.sum())


def caught(scene, *, count, below_y_mm=1e9):
    """Power of group 0 that arrives at the membrane (mW), summed in 4096 parts to keep float32 exact."""
    import drjit as dr
    import mitsuba as mi

    table = dr.zeros(mi.Float, 4096)

    def record(arrival, active):
        position, power = arrival.at.p, arrival.power
        part = mi.UInt32(dr.abs(position.z * 7919.0 + position.x * 104729.0)) % 4096
        dr.scatter_add(table, power, part, active & (position.y < below_y_mm))

    photons.trace(scene, group=0, photons=count, seed=3, record=record)
    return float(np.asarray(table, dtype=float).sum())


@pytest.mark.parametrize("profile", [AngularProfile(), NARROW, WIDE, OVAL, LOPSIDED])
def test_every_profile_emits_one_milliwatt(profile):
    # behind the face there is nothing, so the plane and its far surroundings take every photon
    scene = over_a_plane(profile)
    around = box("membrane", 60.0, Diffuse((0.0,)), inward=True)
    assert caught(replace(scene, shapes=(around,)), count=200_000) == pytest.approx(1.0, abs=1e-5)


SMALL = preset("default").replace(
    {
        "leds.emitting_width_mm": 0.2,
        "leds.emitting_spans_mm": ((-0.1, 0.1),),
        "leds.body_width_mm": 0.3,
        "leds.body_height_mm": 0.3,
        **{f"leds.groups.{k}.count": 1 for k in range(3)},
        "optics.board_reflectance": (0.0,),
        "optics.path_length": 8,
    }
)
BONDED = SMALL.replace({"leds.coupling": "bonded", "leds.radius_mm": 13.0})
GAP = SMALL.replace({"leds.radius_mm": 13.01})
INDEX = 1.49


def scene_of(design):
    return build(
        design, indent(design.elastomer, design.contact, None, area_mm=(4, 4), pitch_mm=0.5), design.view(4)
    )


def caught_inside(design):
    """Share of group 0's light (LED at +y) that a black box about its LED catches inside the core."""
    scene = scene_of(design)
    centre = np.array([0.0, 13.0, 6.0])
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * (6.0, 6.0, 3.5)
    faces = np.array([(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
                      (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)])  # fmt: skip
    a, b, c = (corners[faces[:, k]] for k in range(3))
    outward = (np.cross(b - a, c - a) * a).sum(axis=1) > 0
    faces[outward] = faces[outward][:, ::-1]
    box = Shape("membrane", corners + centre, faces.astype(np.uint32), Diffuse((0.0,) * 3))
    kept = tuple(s for s in scene.shapes if s.name.startswith(("board", "core-side")))
    return caught(replace(scene, shapes=(box, *kept)), count=1_000_000, below_y_mm=13.0)


def test_glue_lets_all_light_into_the_core():
    assert caught_inside(BONDED) == pytest.approx(1.0, abs=1e-5)


def test_an_air_gap_lets_in_the_fresnel_integral():
    def passed(angle):
        inner = np.arcsin(np.sin(angle) / INDEX)
        s = (np.cos(angle) - INDEX * np.cos(inner)) / (np.cos(angle) + INDEX * np.cos(inner))
        p = (INDEX * np.cos(angle) - np.cos(inner)) / (INDEX * np.cos(angle) + np.cos(inner))
        return (1 - (s**2 + p**2) / 2) * 2 * np.sin(angle) * np.cos(angle)

    expected = quad(passed, 0, np.pi / 2)[0]
    assert expected == pytest.approx(0.910, abs=1e-3)  # about 9 % of diffuse light is lost at acrylic
    # standard error of a share of a million photons: 0.0003
    assert caught_inside(GAP) == pytest.approx(expected, abs=0.0015)


def slants(design):
    """Power at the membrane by sine of the angle in the core to the normal of the LED's side, 50 bins."""
    import drjit as dr
    import mitsuba as mi

    table = dr.zeros(mi.Float, 50)

    def record(arrival, active):
        towards, power = arrival.towards, arrival.power
        # the component along the level interface keeps n times the direction cosine
        along = dr.abs(towards.y) * 1.41 / INDEX
        sine = dr.sqrt(dr.maximum(1 - along * along, 0.0))
        dr.scatter_add(table, power, dr.minimum(mi.UInt32(sine * 50), 49), active)

    # few segments: no detour over another side, which would turn the light
    short = design.replace({"optics.path_length": 6 if design.leds.coupling == "air_gap" else 5})
    photons.trace(scene_of(short), group=0, photons=1_000_000, seed=4, record=record)
    return np.asarray(table)


def test_only_glued_light_is_steeper_in_the_core_than_the_critical_angle():
    limit = int(np.ceil(50 / INDEX))  # sin = 1 / n
    gap, glued = slants(GAP), slants(BONDED)
    assert gap.sum() > 0.05
    assert gap[limit:].sum() == 0.0
    # a Lambertian face sends 1 - 1/n^2 = 55 % of its light beyond asin(1/n)
    assert glued[limit:].sum() > 0.4 * glued.sum()


def test_a_bonded_light_lies_just_inside_the_side_with_its_board_behind_it():
    scene = scene_of(BONDED)
    light = next(light for light in scene.lights if light.group == 0)
    board = next(shape for shape in scene.shapes if shape.name == "board-0")
    assert light.inside
    assert 12.99 < light.centre_mm[1] < board.vertices[:, 1].min() < 13.0
    assert not any(light.inside for light in scene_of(GAP).lights)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"leds.coupling": "bonded", "leds.radius_mm": 13.0},
        {"leds.coupling": "embedded", "leds.radius_mm": 11.9},
        {"leds.profile": {"beam_deg": 60.0}},
    ],
    ids=["bonded", "embedded", "narrow"],
)
def test_field_and_path_tracer_agree(changes, tmp_path, monkeypatch):
    monkeypatch.setenv(store.CACHE_VARIABLE, str(tmp_path))
    # one wide LED a side, which the path tracer finds often enough
    wide = {
        "leds.emitting_width_mm": 12.0,
        "leds.emitting_spans_mm": ((-3.5, 3.5),),
        "leds.body_width_mm": 12.0,
        "leds.body_height_mm": 7.0,
        **{f"leds.groups.{k}.count": 1 for k in range(3)},
    }
    design = preset("default").replace(wide | changes)
    view = design.view(24)._replace(rows=18)
    sim = Simulator(design, view=view, samples=8, seed=1)
    found = sim.frame(None).basis.mean(axis=(1, 2))
    scene = sim.scene(sim.surface(None))
    runs = np.array([path.radiance(scene, samples=512, seed=s).mean(axis=(1, 2)) for s in range(4)])
    error = runs.std(axis=0, ddof=1) / np.sqrt(len(runs))
    assert (error < 0.01 * found).all()
    assert (np.abs(found - runs.mean(axis=0)) < 0.015 * found + 3 * error).all()


def test_a_back_end_without_python_code_names_the_field(monkeypatch):
    from dataclasses import dataclass

    from designlab.simulation.render import emitters

    @dataclass
    class Scalar:
        variant: str = "scalar_rgb"
        is_jit: bool = False

    monkeypatch.setattr(emitters, "activate", Scalar)
    scene = over_a_plane(NARROW)
    with pytest.raises(RuntimeError, match=r"leds\.profile: the back end scalar_rgb renders Lambertian"):
        emitters.emitter(scene.lights[0], scene, 0)


@pytest.mark.parametrize(
    "profile",
    [
        AngularProfile(
            polar_deg=(0, 45, 90), azimuth_deg=(0, 45, 90), intensity=((1, 1, 0), (0, 0, 0), (0, 0, 0))
        ),
        AngularProfile(polar_deg=(0, 3, 4), intensity=(1, 1, 0)),
        AngularProfile(polar_deg=(0, 40, 50, 60), intensity=(0, 0, 1, 0)),
        AngularProfile(beam_deg=2.0),
        AngularProfile(exponent=0.0),
    ],
    ids=["dark-planes", "pencil", "ring", "narrowest", "isotropic"],
)
def test_drawn_angles_follow_odd_profiles(profile):
    import mitsuba as mi

    from designlab.simulation.render.emitters import Directions

    sampler = mi.load_dict({"type": "independent"})
    count = 200_000
    sampler.seed(2, count)
    drawn = Directions(profile).sample(sampler.next_2d())
    polar = np.degrees(np.arctan2(np.hypot(drawn.x, drawn.y), drawn.z))
    edge = 90.0 * np.linspace(0, 1, 6001) ** 2
    middle = (edge[1:] + edge[:-1]) / 2
    turns = np.arange(1.5, 360, 3.0)
    share = profile.share_per_sr(middle[:, None], turns).mean(axis=1) * np.sin(np.radians(middle))
    cumulative = np.concatenate([[0.0], np.cumsum(share * np.radians(np.diff(edge))) * 2 * np.pi])
    assert cumulative[-1] == pytest.approx(1.0, rel=1e-4)
    rank = np.interp(np.sort(polar), edge, cumulative)
    # Kolmogorov's bound of one in ten thousand is 2.23 / sqrt(n); the grid of a table adds its own 0.1 %
    distance = np.abs(rank - (np.arange(count) + 0.5) / count).max()
    assert distance < 2.23 / np.sqrt(count) + 1e-3
