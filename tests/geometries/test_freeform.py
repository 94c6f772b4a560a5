"""Freeform gels: their profile, their solid, and everything that has to work on them."""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import quad

from designlab.fabrication import export
from designlab.sensor.contact import KernelContact
from designlab.sensor.design import DesignError, dumps, loads, preset
from designlab.simulation.contact.indentation import indent
from designlab.simulation.contact.press import Press
from designlab.simulation.optics.viewing_rays import rays
from designlab.simulation.scene.scene import build
from geometries import elastomer
from geometries.elastomer import Elastomer
from geometries.probes import parse

RADIUS = 30.0
WAVE = ((0.0, 0.0), (3.0, 0.1), (6.0, 1.0), (9.0, 1.2), (12.5, 2.0))


def sphere(points):
    r = np.linspace(0.0, 12.0, points)
    return tuple((float(a), float(RADIUS - np.sqrt(RADIUS**2 - a**2))) for a in r)


def freeform(profile=WAVE, **fields):
    settings = {"width_mm": 24.0, "thickness_mm": 5.0, "outline": "round", **fields}
    return Elastomer(shape="freeform", profile_mm=profile, **settings)


# A gel of varying thickness on the hexagonal core of the built-in sensor.
DESIGN = preset("default").replace(
    {
        "elastomer": freeform(WAVE).model_dump(),
        "camera.position_mm": (0.0, 0.0, 29.0),
        "housing.top_mm": 27.0,
        "leds.height_mm": 9.0,
    }
)


@pytest.mark.parametrize(("points", "height_mm", "slope"), [(13, 1.5e-3, 8e-3), (49, 1e-4, 1e-3)])
def test_a_profile_through_a_spheres_points_is_nearly_the_sphere(points, height_mm, slope):
    gel = freeform(sphere(points))
    x, y = np.meshgrid(np.linspace(-8, 8, 41), np.linspace(-8, 8, 41))
    depth = np.sqrt(RADIUS**2 - x**2 - y**2)
    np.testing.assert_allclose(elastomer.base_mm(gel, x, y), RADIUS - depth, atol=height_mm)
    p, q = elastomer.base_gradient(gel, x, y)
    np.testing.assert_allclose(p, x / depth, atol=slope)
    np.testing.assert_allclose(q, y / depth, atol=slope)


def test_a_profile_runs_through_its_points_level_on_the_axis_and_between_them():
    gel = freeform()
    r, z = np.array(WAVE).T
    np.testing.assert_allclose(elastomer.base_mm(gel, r, 0 * r), z, atol=1e-12)
    fine = elastomer.base_mm(gel, np.linspace(0, 12.5, 2000), 0.0)
    assert (np.diff(fine) >= 0).all()
    assert elastomer.base_gradient(gel, 0.0, 0.0) == (0.0, 0.0)
    near = elastomer.base_gradient(gel, 1e-6, 0.0)[0]
    assert abs(near) < 1e-6
    # straight on beyond the last point
    beyond = elastomer.base_mm(gel, np.array([12.5, 13.5, 14.5]), 0.0)
    assert beyond[2] - beyond[1] == pytest.approx(beyond[1] - beyond[0])


def test_the_gradient_is_the_derivative_of_the_height():
    gel = freeform()
    x, y = np.random.default_rng(1).uniform(-8, 8, (2, 200))
    step = 1e-6
    p, q = elastomer.base_gradient(gel, x, y)
    dx = (elastomer.base_mm(gel, x + step, y) - elastomer.base_mm(gel, x - step, y)) / (2 * step)
    dy = (elastomer.base_mm(gel, x, y + step) - elastomer.base_mm(gel, x, y - step)) / (2 * step)
    np.testing.assert_allclose(p, dx, atol=1e-6)
    np.testing.assert_allclose(q, dy, atol=1e-6)


@pytest.mark.parametrize("profile", [WAVE, sphere(20)], ids=["wave", "sphere"])
def test_the_solid_has_the_volume_of_the_profile(profile):
    gel = freeform(profile)
    solid = elastomer.solid(gel).val()
    assert solid.isValid()
    knots = [r for r, _ in profile if 0 < r < 12]
    volume, _ = quad(
        lambda r: 2 * np.pi * r * (5.0 - float(elastomer.base_mm(gel, r, 0.0))),
        0,
        12,
        points=knots,
        limit=200,
    )
    assert solid.Volume() == pytest.approx(volume, rel=1e-7)
    box = solid.BoundingBox()
    assert (box.xmin, box.xmax, box.zmin, box.zmax) == pytest.approx((-12, 12, 0, 5), abs=1e-5)


def test_its_core_side_is_a_plane():
    assert (elastomer.interface_mm(freeform(), [0.0, 5.0, 12.0], 0.0) == 5.0).all()
    dome = Elastomer(shape="dome", outline="round", width_mm=24.0, thickness_mm=2.0, radius_mm=30.0)
    assert elastomer.interface_mm(dome, 3.0, 4.0) == pytest.approx(30 - np.sqrt(28**2 - 25))


@pytest.mark.parametrize(
    ("fields", "parts"),
    [
        ({"profile_mm": None}, ("profile_mm", "needs the profile")),
        ({"profile_mm": ((0, 0), (12, 1))}, ("profile_mm", "three points")),
        ({"profile_mm": ((0, 0.1), (6, 0.5), (12, 1))}, ("profile_mm", "from (0, 0) mm")),
        ({"profile_mm": ((0, 0), (6, 0.5), (6, 0.6), (12, 1))}, ("profile_mm", "ascend")),
        ({"profile_mm": ((0, 0), (6, -0.5), (12, 1))}, ("profile_mm", "heights start at 0", "-0.5")),
        ({"profile_mm": ((0, 0), (6, 0.5), (11, 1))}, ("profile_mm", "12 mm from the axis", "11 mm")),
        ({"profile_mm": ((0, 0), (6, 2.5), (12, 6))}, ("profile_mm", "below thickness_mm (5 mm)")),
        ({"profile_mm": ((0, 0), (6, 0.5), (6.2, 4.5), (12, 4.6))}, ("profile_mm", "80 deg")),
        ({"outline": "hexagon"}, ("outline", "round")),
        ({"shape": "flat"}, ("profile_mm", "only a freeform gel")),
        ({"radius_mm": 30.0}, ("radius_mm", "only a dome")),
    ],
)
def test_a_profile_that_cannot_be_is_refused_by_name(fields, parts):
    settings = freeform().model_dump() | fields
    with pytest.raises(ValidationError) as caught:
        Elastomer(**settings)
    for part in parts:
        assert part in str(caught.value)


def test_a_dome_core_does_not_carry_it():
    with pytest.raises(DesignError, match="dome gelcore carries a dome"):
        DESIGN.replace({"gelcore.shape": "dome", "gelcore.radius_mm": 30.0})


def test_a_design_with_it_is_feasible_and_reads_back():
    DESIGN.require_feasible()
    assert loads(dumps(DESIGN)) == DESIGN
    # thinnest at the rim of the gel
    rim = float(elastomer.base_mm(DESIGN.elastomer, 12.0, 0.0))
    assert DESIGN.margins()["minimum_gel"] == pytest.approx(0.5 - (5.0 - rim))


def test_a_press_counts_its_depth_from_where_it_first_touches():
    press = Press(probe=parse("cylinder:4"), depth_mm=0.5, centre_mm=(6.0, 0.0))
    surface = indent(DESIGN.elastomer, KernelContact(), press, area_mm=(20.0, 12.0), pitch_mm=0.05)
    # the flat end first meets the membrane's lowest point below it, 4 mm from the axis
    lowest = float(elastomer.base_mm(DESIGN.elastomer, 4.0, 0.0))
    inside = np.hypot(*np.meshgrid(surface.x_mm - 6.0, surface.y_mm)) < 1.5
    deep = surface.height_mm > 0.05
    np.testing.assert_allclose(surface.z_mm[inside & deep], lowest + 0.5, atol=0.01)


def test_a_profile_of_nothing_is_a_flat_gel():
    flat = DESIGN.replace({"elastomer": {"outline": "round", "width_mm": 24.0, "thickness_mm": 5.0}})
    level = DESIGN.replace({"elastomer.profile_mm": ((0.0, 0.0), (6.0, 0.0), (12.0, 0.0))})
    view = flat.view(24)
    scenes = []
    for design in (flat, level):
        surface = indent(design.elastomer, design.contact, None, area_mm=(18.0, 14.0), pitch_mm=0.1)
        scenes.append(build(design, surface, view))
    for one, other in zip(scenes[0].shapes, scenes[1].shapes, strict=True):
        assert (one.name, one.material) == (other.name, other.material)
        np.testing.assert_array_equal(one.vertices, other.vertices)
        np.testing.assert_array_equal(one.faces, other.faces)
        if one.normals is not None:
            np.testing.assert_array_equal(one.normals, other.normals)
    a, b = rays(flat, view), rays(level, view)
    np.testing.assert_array_equal(a.x_mm, b.x_mm)
    assert level.margins() == flat.margins()


def test_pixels_see_the_membrane_where_a_straight_ray_through_plane_layers_meets_it():
    view = DESIGN.view(32)
    surface = indent(DESIGN.elastomer, DESIGN.contact, None, area_mm=(20.0, 16.0), pitch_mm=0.05)
    x, y = rays(DESIGN, view).hit(surface)
    for row, column in ((0, 0), (10, 3), (-1, -1)):
        place = view.x_px + (column % 32 + 0.5) * view.width_px / 32
        line = view.y_px + (row % view.rows + 0.5) * view.height_px / view.rows
        # `project_px` solves Snell's law for the point itself, with the gel's thickness there
        assert DESIGN.project_px(x[row, column], y[row, column]) == pytest.approx((place, line), abs=0.15)


def test_the_scene_closes_between_membrane_and_core():
    surface = indent(DESIGN.elastomer, DESIGN.contact, None, area_mm=(18.0, 14.0), pitch_mm=0.1)
    shapes = {s.name: s for s in build(DESIGN, surface, DESIGN.view(24)).shapes}
    membrane = shapes["membrane"]
    at = elastomer.base_mm(DESIGN.elastomer, membrane.vertices[:, 0], membrane.vertices[:, 1])
    used = np.unique(membrane.faces)
    np.testing.assert_allclose(membrane.vertices[used, 2], at[used], atol=1e-9)
    assert (shapes["interface"].vertices[:, 2] == 5.0).all()
    rim = shapes["gel-rim"].vertices
    assert rim[:, 2].min() == pytest.approx(float(elastomer.base_mm(DESIGN.elastomer, 12.0, 0.0)), abs=1e-4)
    assert rim[:, 2].max() == 5.0


@pytest.mark.slow
@pytest.mark.full
def test_it_can_be_exported(tmp_path):
    manifest = export(DESIGN, tmp_path / "parts")
    assert all(check["ok"] for check in manifest["checks"])
    assert {check["part"] for check in manifest["checks"]} >= {"elastomer", "mould_cavity", "mould_lid"}
