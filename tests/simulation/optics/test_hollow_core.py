"""A hollow core: what the camera sees through it, by closed forms and by rays followed through its mesh."""

import numpy as np
import pytest

from designlab.sensor.design import DesignError, InfeasibleDesign, preset
from designlab.sensor.refraction import Glass
from designlab.simulation.contact.indentation import indent
from designlab.simulation.optics.viewing_rays import rays
from geometries.gelcore import Gelcore, solid

TIP = preset("pbr-fingertip-like").replace(
    {"gelcore.cavity_radius_mm": None, "gelcore.cavity_depth_mm": None}
)
WINDOW_MM = TIP.elastomer.thickness_mm + TIP.gelcore.height_mm
HOLLOW = TIP.replace({"gelcore.cavity_radius_mm": 8.0})


def surface_of(design):
    return indent(design.elastomer, design.contact, None, area_mm=(18.0, 14.0), pitch_mm=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("depth", [None, 5.0, 11.0])
def test_a_hollow_takes_half_a_spheroid_out_of_the_core(depth):
    hollow = HOLLOW.replace({"gelcore.cavity_depth_mm": depth}).gelcore
    whole = solid(TIP.gelcore).val().Volume()
    shell = solid(hollow).val()
    assert shell.isValid()
    assert whole - shell.Volume() == pytest.approx(2 / 3 * np.pi * 64.0 * (depth or 8.0), rel=5e-4)


def test_from_the_centre_of_all_spheres_rays_are_straight():
    """Every boundary is met along its normal there."""
    glass = Glass(10.0, 2.0, 1.55, 1.42, dome_mm=8.0, reach_mm=8.0, cavity=(4.0, 4.0))
    tangents = np.array([[0.0, 0.0], [0.3, -0.2], [-0.5, 0.4]])
    way = np.stack([*tangents.T, -np.ones(3)])
    way = way / np.linalg.norm(way, axis=0)
    start = np.zeros((3, 3))
    start[2] = 10.0
    point, bent, met = glass.follow(start, way)
    assert met.all()
    np.testing.assert_allclose(bent, way, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(point - start, axis=0), 8.0)
    seen = glass.toward(np.array([0.0, 0.0, 10.0]), (start + 9.0 * way).T)
    np.testing.assert_allclose(seen, tangents, atol=1e-9)


def test_a_shallow_wide_hollow_is_a_weak_lens():
    """Gaussian optics: a surface of radius R between indices n and 1 has the power (1 - n) / R."""
    index, radius, depth = 1.5, 50.0, 0.5
    curvature = depth / radius**2  # of the spheroid's pole
    glass = Glass(10.0, 0.0, index, index, cavity=(radius, depth))
    height, camera = 1e-3, 30.0
    start = np.array([[0.0], [0.0], [camera]])
    pole = 10.0 - depth
    way = np.array([[height], [0.0], [-(camera - pole)]])
    way = way / np.linalg.norm(way)
    _, bent, _ = glass.follow(start, way)
    # The normal leans by height times curvature: n u' = u + (n - 1) h c, angles from the axis, outwards.
    outward = height / (camera - pole)
    expected = (outward + (index - 1) * height * curvature) / index
    assert bent[0, 0] / -bent[2, 0] == pytest.approx(expected, rel=1e-4)


@pytest.mark.renders
@pytest.mark.parametrize(
    ("shape", "depth"), [("dome", None), ("dome", 6.0), ("hexagonal", 3.0), ("slab", 3.0)]
)
def test_rays_followed_back_through_the_mesh_meet_the_camera(backend, shape, depth):
    """The mesh that photons meet and the formulas that the camera uses are of the same core."""
    import mitsuba as mi

    from designlab.simulation.render import bridge
    from designlab.simulation.scene.static_parts import core_and_gel

    design = HOLLOW.replace({"gelcore.cavity_depth_mm": depth})
    if shape != "dome":
        changes = {"gelcore.shape": shape, "gelcore.cavity_radius_mm": 9.0, "gelcore.cavity_depth_mm": depth}
        design = preset("gelsight-2020-flat-core").replace(changes | {"gelcore.length_mm": 31.4})
    glass = design.optics
    view = design.view(24)
    seen = rays(design, view)
    x, _ = seen.hit(surface_of(design))
    z = (x - seen.x_mm) / np.where(seen.slope_x == 0, 1, seen.slope_x)
    shapes = {s.name: s for s in core_and_gel(design) if s.name in ("interface", "window", "window-rim")}
    loaded = bridge.load_shapes(shapes.values())
    way = np.stack([seen.slope_x, seen.slope_y, np.ones_like(x)])
    way = way / np.linalg.norm(way, axis=0)
    point = np.stack([seen.x_mm + seen.slope_x * z, seen.y_mm + seen.slope_y * z, z])
    for before, behind in ((glass.gel_index, glass.core_index), (glass.core_index, 1.0)):
        ray = mi.Ray3f(*(mi.Vector3f(*(np.ravel(a).astype(np.float32) for a in v)) for v in (point, way)))
        met = loaded.ray_intersect(ray)
        normal = np.asarray(met.sh_frame.n).reshape(3, *x.shape)
        normal = normal * np.sign((normal * way).sum(axis=0))
        point = np.asarray(met.p).reshape(3, *x.shape) + 1e-4 * way
        cosine, ratio = (normal * way).sum(axis=0), before / behind
        way = ratio * way + (np.sqrt(1 - ratio**2 * (1 - cosine**2)) - ratio * cosine) * normal
    camera = np.array(design.camera.position_mm)[:, None, None]
    along = camera[2] - point[2]
    missed = np.hypot(*(point + along / way[2] * way - camera)[:2])
    assert np.median(missed) < 0.02
    assert missed.max() < 0.2  # facets of the mesh


def test_the_sensing_area_fills_the_picture_also_through_a_hollow():
    """Exactly, since the directions in which its corners are seen are found by the same refraction."""
    view = HOLLOW.view(160)
    seen = rays(HOLLOW, view)
    x, _ = seen.hit(surface_of(HOLLOW))
    middle = x[x.shape[0] // 2]
    assert middle[0] < -HOLLOW.sensing_area_mm[0] / 2 * 0.93
    column, row = HOLLOW.project_px(3.0, -2.0)
    at = (column - view.x_px) / view.width_px * view.columns, (row - view.y_px) / view.height_px * view.rows
    found_x, found_y = seen.hit(surface_of(HOLLOW))
    nearest = round(at[1] - 0.5), round(at[0] - 0.5)
    assert np.hypot(found_x[nearest] - 3.0, found_y[nearest] + 2.0) < 0.12


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"gelcore.cavity_radius_mm": None, "gelcore.cavity_depth_mm": 4.0}, "goes with cavity_radius_mm"),
        ({"optics.gelcore_scattering_per_mm": 0.01}, "haze is simulated in solid cores only"),
        ({"optics.housing_reflectance": (0.5,)}, "plane windows only"),
    ],
)
def test_what_a_hollow_core_cannot_have_is_refused(changes, rule):
    with pytest.raises(DesignError, match=rule):
        HOLLOW.replace(changes)


@pytest.mark.parametrize("change", [{"gelcore.cavity_radius_mm": 12.3}, {"gelcore.cavity_depth_mm": 12.0}])
def test_a_hollow_leaves_a_wall(change):
    HOLLOW.require_feasible()
    with pytest.raises(InfeasibleDesign, match="cavity_in_core"):
        HOLLOW.replace(change).require_feasible()


def test_a_solid_core_has_no_hollow():
    assert Gelcore().cavity is None
    assert Gelcore(cavity_radius_mm=3.0).cavity == (3.0, 3.0)
