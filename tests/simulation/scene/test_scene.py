"""The scene as plain data: where things are, which way they face, and what the digest covers."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.sensor.design import preset
from designlab.sensor.seating import inside
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.scene.scene import Dielectric, Diffuse, Medium, build
from geometries import elastomer
from geometries.probes import parse
from tests.helpers.shared_packages import AIR as SHARED_AIR
from tests.helpers.shared_packages import APART, shared
from tests.helpers.shared_packages import CORE as SHARED_CORE

FLAT, CORE, DOME = preset("gelsight-2020-flat"), preset("default"), preset("gelsight-2020-dome")
DOMED_CORE = DOME.replace(
    {
        "optics.light_path": "core",
        "leds.radius_mm": 17.0,
        "leds.tilt_deg": 0.0,
        "gelcore.side_finish": "painted",
    }
)
WHITE = {"optics.housing_reflectance": (0.8,)}
BALL = Press(probe=parse("sphere:4"), depth_mm=0.6, centre_mm=(2.0, 1.0))


def scene_of(design, press=None, *, columns=32):
    surface = indent(design.elastomer, design.contact, press, area_mm=(18.0, 14.0), pitch_mm=0.1)
    return build(design, surface, design.view(columns))


def normals(shape):
    """Unit normals and areas of a mesh's triangles."""
    a, b, c = (shape.vertices[shape.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / length[:, None], length / 2


def test_the_membrane_has_the_surfaces_heights_and_normals():
    surface = indent(FLAT.elastomer, FLAT.contact, BALL, area_mm=(18.0, 14.0), pitch_mm=0.1)
    membrane = build(FLAT, surface, FLAT.view(32)).membrane
    top = membrane.vertices[membrane.vertices[:, 2].argmax()]
    assert top == pytest.approx((2.0, 1.0, surface.height_mm.max()), abs=0.06)
    at = surface.sample(surface.z_mm, membrane.vertices[:, 0], membrane.vertices[:, 1])
    inside = (np.abs(membrane.vertices[:, 0]) < 9) & (np.abs(membrane.vertices[:, 1]) < 7)
    np.testing.assert_allclose(membrane.vertices[inside, 2], at[inside], atol=1e-9)
    # vertex normals lean away from the ball's top: at +x of it they point to +x
    side = inside & (np.hypot(membrane.vertices[:, 0] - 3.2, membrane.vertices[:, 1] - 1.0) < 0.15)
    assert (membrane.normals[side, 0] > 0.1).all()


@pytest.mark.parametrize("design", [FLAT, CORE, DOME], ids=lambda d: d.name)
def test_the_membrane_faces_the_camera_and_fills_the_gels_outline(design):
    membrane = scene_of(design).membrane
    direction, area = normals(membrane)
    assert (direction[:, 2] > 0.5).all()
    width = design.elastomer.width_mm
    flat_area = {"hexagon": np.sqrt(3) / 2 * width**2, "round": np.pi / 4 * width**2}
    projected = (area * direction[:, 2]).sum()
    # cells that the outline cuts are left out or kept as a whole, in equal parts
    assert projected == pytest.approx(flat_area[design.elastomer.outline], rel=0.005)


@pytest.mark.parametrize("design", [FLAT, CORE, DOME], ids=lambda d: d.name)
def test_each_group_emits_one_milliwatt_towards_the_axis(design):
    scene = scene_of(design)
    for group in range(scene.groups):
        lights = [light for light in scene.lights if light.group == group]
        flux = sum(np.pi * 4 * s.half_width_mm * s.half_height_mm * s.radiance for s in lights)
        assert flux == pytest.approx(1.0)
        for light in lights:
            assert np.dot(light.centre_mm[:2], light.normal[:2]) < 0


def test_strips_shine_just_above_their_board():
    scene = scene_of(FLAT)
    boards = [shape for shape in scene.shapes if shape.name.startswith("board")]
    assert len(boards) == 3
    for light in scene.lights:
        distances = []
        for board in boards:
            direction, _ = normals(board)
            if direction[0] @ light.normal > 0.999:
                distances.append((np.array(light.centre_mm) - board.vertices[0]) @ direction[0])
        assert distances == [pytest.approx(1e-3)]
    assert all(isinstance(board.material, Diffuse) for board in boards)
    assert boards[0].material.reflectance == (0.1, 0.8, 0.1)


def test_in_air_there_is_no_glass():
    assert not scene_of(FLAT).refracts
    assert not any(isinstance(shape.material, Dielectric) for shape in scene_of(DOME).shapes)


@pytest.mark.parametrize("design", [CORE, DOMED_CORE], ids=["flat", "dome"])
def test_glass_faces_from_the_inside_medium_out(design):
    scene = scene_of(design)
    assert scene.refracts
    glass = {s.name: s for s in scene.shapes if isinstance(s.material, Dielectric)}
    direction, _ = normals(glass["interface"])
    assert (direction[:, 2] > 0).all()
    n_core = {"acrylic": 1.49, "resin-2020": 1.5403}[design.optics.gelcore_material]
    gel, core, air = (Medium(index, (0.0, 0.0, 0.0)) for index in (1.41, n_core, 1.0))
    assert glass["interface"].material == Dielectric(gel, core)
    assert glass["window"].material == Dielectric(core, air)
    direction, _ = normals(glass["window"])
    assert (direction[:, 2] > 0.999).all()
    sides = [shape for name, shape in glass.items() if name.startswith("core-side")]
    assert sides
    for side in sides:
        direction, _ = normals(side)
        middle = side.vertices.mean(axis=0)
        assert (direction[:, :2] @ middle[:2] > 0).all()


def test_only_lit_sides_are_clear_when_the_others_are_painted():
    sides = [s for s in scene_of(CORE).shapes if s.name.startswith("core-side")]
    clear = [s for s in sides if isinstance(s.material, Dielectric)]
    azimuths = sorted(float(np.degrees(np.arctan2(*s.vertices.mean(axis=0)[1::-1]))) % 360 for s in clear)
    assert azimuths == pytest.approx([90.0, 210.0, 330.0], abs=1e-6)
    assert all(s.material == Diffuse((0.0, 0.0, 0.0)) for s in sides if s not in clear)
    polished = CORE.replace({"gelcore.side_finish": "polished"})
    assert all(
        isinstance(s.material, Dielectric)
        for s in scene_of(polished).shapes
        if s.name.startswith("core-side")
    )


def test_ground_sides_are_rough():
    sides = [
        s
        for s in scene_of(CORE.replace({"gelcore.side_finish": "ground"})).shapes
        if s.name.startswith("core-side")
    ]
    roughness = sorted(s.material.roughness for s in sides)
    assert roughness == [0.0, 0.0, 0.0, 0.3, 0.3, 0.3]


def test_paint_reflects_what_it_is_said_to_towards_the_core():
    white = CORE.replace({"gelcore.paint_reflectance": 0.9})
    painted = [
        s
        for s in scene_of(white).shapes
        if s.name.startswith("core-side") and isinstance(s.material, Diffuse)
    ]
    assert len(painted) == 3
    for side in painted:
        assert side.material == Diffuse((0.9, 0.9, 0.9))
        direction, _ = normals(side)
        assert (direction[:, :2] @ side.vertices.mean(axis=0)[:2] < 0).all()
    rough = CORE.replace({"gelcore.side_finish": "ground", "gelcore.ground_roughness": 0.15})
    sides = [s for s in scene_of(rough).shapes if s.name.startswith("core-side")]
    assert {s.material.roughness for s in sides} == {0.0, 0.15}


@pytest.mark.parametrize("design", [FLAT, CORE, DOME], ids=lambda d: d.name)
def test_the_housing_stands_around_with_a_hole_and_a_floor(design):
    assert not any(s.name.startswith("housing") for s in scene_of(design).shapes)
    white = design.replace({"optics.housing_reflectance": (0.8,), "housing.seats": None})
    walls = {s.name: s for s in scene_of(white).shapes if s.name.startswith("housing")}
    assert set(walls) == {"housing-tube", "housing-plate", "housing-floor"}
    assert all(wall.material == Diffuse((0.8, 0.8, 0.8)) for wall in walls.values())
    housing = design.housing
    tube, plate, floor = (walls[f"housing-{name}"] for name in ("tube", "plate", "floor"))
    direction, area = normals(tube)
    middle = tube.vertices[tube.faces].mean(axis=1)
    assert ((direction * middle)[:, :2].sum(axis=1) < 0).all()
    height = housing.top_mm - tube.vertices[:, 2].min()
    assert area.sum() == pytest.approx(2 * np.pi * housing.inner_radius_mm * height, rel=1e-3)
    direction, area = normals(plate)
    assert (direction[:, 2] < -0.999).all()
    hole = housing.camera_hole_mm / 2
    assert area.sum() == pytest.approx(np.pi * (housing.inner_radius_mm**2 - hole**2), rel=1e-3)
    assert np.hypot(*plate.vertices[:, :2].T).min() == pytest.approx(hole)
    direction, area = normals(floor)
    assert (direction[:, 2] > 0.999).all()
    part = design.gelcore if design.optics.light_path == "core" else design.elastomer
    inner = {"gelsight-2020-dome": np.pi / 4}.get(design.name, np.sqrt(3) / 2) * part.width_mm**2
    assert area.sum() == pytest.approx(np.pi * housing.inner_radius_mm**2 - inner, rel=2e-3)
    boards = [s for s in scene_of(white).shapes if s.name.startswith("board")]
    assert floor.vertices[0, 2] <= min(1.0, min(b.vertices[:, 2].min() for b in boards))


@pytest.mark.parametrize("name", ["default", "gelsight-mini-like", "pbr-fingertip-like"])
def test_seats_stand_in_the_scene_even_when_they_are_black(name):
    design = preset(name)
    found = {s.name: s for s in scene_of(design).shapes if s.name.startswith("seat")}
    within = inside(design)
    assert all(s.material == Diffuse((0.0, 0.0, 0.0)) for s in found.values())
    assert not [s for s in scene_of(design.replace({"housing.seats": None})).shapes if s.name in found]
    collar = found["seat-collar-outside"]
    direction, area = normals(collar)
    middle = collar.vertices[collar.faces].mean(axis=1)
    assert ((direction * middle)[:, :2].sum(axis=1) > 0).all()
    height = within.collar.high_mm - within.collar.low_mm
    assert area.sum() == pytest.approx(2 * np.pi * within.collar.outer_mm * height, rel=2e-3)
    assert len(found) == 3 + 2 * (len(within.tabs) + len(within.feet))
    white = scene_of(
        design.replace({"gelcore.cavity_radius_mm": None, "gelcore.cavity_depth_mm": None} | WHITE)
    )
    names = {s.name for s in white.shapes}
    assert {name.replace("seat", "housing") for name in found} <= names


@pytest.mark.parametrize("stop", ["collar", "tabs"])
def test_light_depends_on_seats_and_on_no_other_field_of_the_housing(stop):
    seated = CORE.replace({"housing.seats": {"stop": stop}})
    assert scene_of(seated).light_digest != scene_of(CORE.replace({"housing.seats": None})).light_digest
    for field, value in (("fastening", "self_tapping"), ("camera", "raspberry-pi-camera-1")):
        same = seated.replace({f"housing.seats.{field}": value})
        assert scene_of(same).light_digest == scene_of(seated).light_digest


def test_media_carry_index_absorption_and_haze_of_the_design():
    changed = CORE.replace(
        {
            "optics.gelcore_index": 1.6,
            "optics.gelcore_absorption_per_mm": (0.01, 0.02, 0.03),
            "optics.gelcore_scattering_per_mm": 0.05,
            "optics.gelcore_anisotropy": 0.7,
            "optics.elastomer_absorption_per_mm": (0.002,),
        }
    )
    shapes = {s.name: s for s in scene_of(changed).shapes}
    core = Medium(1.6, (0.01, 0.02, 0.03), 0.05, 0.7)
    assert shapes["interface"].material == Dielectric(Medium(1.41, (0.002,) * 3), core)
    assert shapes["window"].material == Dielectric(core, Medium(1.0, (0.0,) * 3))


def closed_volume(shapes):
    """Volume enclosed by outward triangles, by the divergence theorem."""
    total = 0.0
    for shape, sign in shapes:
        a, b, c = (shape.vertices[shape.faces[:, k]] for k in range(3))
        total += sign * np.einsum("ij,ij->", a, np.cross(b, c)) / 6
    return total


@pytest.mark.parametrize(
    ("design", "volume"),
    [
        (CORE.replace({"gelcore.side_finish": "polished"}), np.sqrt(3) / 2 * 26**2 * 8),
        (
            # frustum of a pyramid: hexagon of 26 mm below, 26 - 2 * 8 tan 10 deg above
            CORE.replace({"gelcore.side_finish": "polished", "gelcore.draft_deg": 10.0}),
            np.sqrt(3) / 2 * 8 / 3 * sum(a * b for a, b in ((26, 26), (26, 26 - 16 * np.tan(np.pi / 18)),
                                                           (26 - 16 * np.tan(np.pi / 18),) * 2)),
        ),
    ],
    ids=["upright", "drafted"],
)  # fmt: skip
def test_the_core_is_closed_and_holds_its_volume(design, volume):
    shapes = {s.name: s for s in scene_of(design).shapes}
    shell = [(s, 1.0) for name, s in shapes.items() if name.startswith("core-side") or name == "window"]
    assert closed_volume([*shell, (shapes["interface"], -1.0)]) == pytest.approx(volume, rel=1e-6)


def test_a_domed_core_is_closed_and_holds_its_volume():
    polished = DOMED_CORE.replace({"gelcore.side_finish": "polished"})
    shapes = {s.name: s for s in scene_of(polished).shapes}
    shell = [(s, 1.0) for name, s in shapes.items() if name.startswith("core-side") or name == "window"]
    # disc of 31.4 mm down to z = 2, without the bowl between the sphere of 33 mm and the plane z = 2 (apex)
    a = 15.7
    rise = 33 - np.sqrt(33**2 - a**2)
    cap = np.pi * rise**2 * (3 * 33 - rise) / 3
    volume = np.pi * a**2 * 11.5 - (np.pi * a**2 * rise - cap)
    # polygons of 72 corners and 48 rings stand for circle and sphere
    assert closed_volume([*shell, (shapes["interface"], -1.0)]) == pytest.approx(volume, rel=2.5e-3)


def test_the_digest_covers_everything_and_nothing_else():
    scene = scene_of(CORE)
    assert scene.digest == scene_of(CORE).digest
    assert scene.digest == scene_of(CORE.replace({"name": "x", "leds.groups.0.flux_mw": 99.0})).digest
    others = [
        scene_of(CORE, BALL),
        scene_of(CORE, columns=33),
        scene_of(CORE.replace({"leds.tilt_deg": 1.0})),
        scene_of(CORE.replace({"optics.membrane_albedo": (0.51,)})),
        scene_of(CORE.replace({"optics.elastomer_material": "glass"})),
        scene_of(CORE.replace({"optics.path_length": 15})),
        scene_of(CORE.replace({"camera.position_mm": (0.1, 0.0, 24.0)})),
        scene_of(CORE.replace({"camera.horizontal_fov_deg": 62.0})),
        replace(scene, groups=4),
    ]
    assert len({other.digest for other in others} | {scene.digest}) == len(others) + 1


def test_the_camera_does_not_belong_to_what_light_depends_on():
    scene = scene_of(CORE)
    camera = {"camera.position_mm": (0.1, 0.0, 24.0), "camera.horizontal_fov_deg": 61.0}
    assert scene_of(CORE.replace(camera), columns=20).light_digest == scene.light_digest
    assert scene_of(CORE.replace({"leds.tilt_deg": 1.0})).light_digest != scene.light_digest
    assert scene_of(CORE, BALL).light_digest != scene.light_digest


def test_round_sides_and_a_domes_interface_have_the_normals_of_their_curve():
    design = preset("gelsight-2020-dome-core")
    scene = scene_of(design)
    sides = [s for s in scene.shapes if s.name.startswith("core-side")]
    for side in sides:
        across = side.vertices[:, :2] / np.hypot(*side.vertices[:, :2].T)[:, None]
        np.testing.assert_allclose(side.normals[:, :2], across, atol=1e-12)
        np.testing.assert_allclose(side.normals[:, 2], 0.0, atol=1e-12)
    interface = next(s for s in scene.shapes if s.name == "interface")
    inside = interface.vertices[np.hypot(*interface.vertices[:, :2].T) < 10.0]
    step, slopes = 1e-5, []
    for shift in np.eye(2) * step:
        ends = [elastomer.interface_mm(design.elastomer, *(inside[:, :2] + s * shift).T) for s in (1, -1)]
        slopes.append((ends[0] - ends[1]) / (2 * step))
    expected = np.column_stack([-slopes[0], -slopes[1], np.ones(len(inside))])
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    found = interface.normals[np.hypot(*interface.vertices[:, :2].T) < 10.0]
    np.testing.assert_allclose(found, expected, atol=1e-7)
    assert sides
    assert all(s.normals is None for s in scene_of(CORE).shapes if s.name.startswith("core-side"))


@pytest.mark.parametrize("base", [SHARED_AIR, SHARED_CORE], ids=["air", "core"])
@pytest.mark.parametrize("chips", [False, True])
def test_a_shared_package_stands_there_once_and_carries_all_its_groups(base, chips):
    scene = scene_of(shared(base, APART if chips and base is SHARED_CORE else None))
    boards = [shape for shape in scene.shapes if shape.name.startswith("board")]
    assert len(boards) == len(scene.lights) // len(base.leds.emitting_spans_mm) // 3
    carried = {shape.name: shape for shape in boards}
    for group in range(3):
        assert sum(s.flux_mw for s in scene.lights if s.group == group) == pytest.approx(1.0)
    for light in scene.lights:
        direction, _ = normals(carried[light.board])
        np.testing.assert_allclose(direction[0], light.normal, atol=1e-12)
        height = (np.array(light.centre_mm) - carried[light.board].vertices) @ direction[0]
        np.testing.assert_allclose(height, 1e-3, atol=1e-9)


def test_lights_carry_the_figures_of_their_own_group():
    own = {
        "leds.groups.1.radius_mm": 14.5,
        "leds.groups.1.height_mm": 7.0,
        "leds.groups.2.tilt_deg": 12.0,
        "leds.groups.2.height_mm": 6.5,
    }
    plain, changed = (scene_of(CORE.replace(c)).lights for c in ({}, own))
    assert [a for a in changed if a.group == 0] == [b for b in plain if b.group == 0]
    green, blue = ([light for light in changed if light.group == g] for g in (1, 2))
    np.testing.assert_allclose([light.centre_mm[2] for light in green], 7.0)
    np.testing.assert_allclose(np.hypot(*np.array(green[1].centre_mm)[:2]), 14.5 - 1e-3)
    np.testing.assert_allclose([light.normal[2] for light in blue], -np.sin(np.radians(12.0)))
