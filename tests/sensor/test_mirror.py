"""A camera that looks into a flat mirror: against reflected rays, Mitsuba's own mirror, and its rules."""

import numpy as np
import pytest

from designlab.core.backend import activate
from designlab.sensor.camera import View
from designlab.sensor.design import DesignError, dumps, loads, preset
from designlab.simulation.optics.viewing_rays import rays
from designlab.simulation.simulator import Simulator

CORE = preset("default")
HEIGHT_MM = CORE.camera.position_mm[2]


def folded(design, *, side_mm=6.0, turn_deg=45.0, along="y", **mirror):
    """The design with its camera at the side of a mirror that hangs below its place; seen from the same eye.

    The mirror stands `side_mm` below the eye on its axis, turned by `turn_deg`.
    """
    x, y, z = design.camera.position_mm
    spin = np.radians(2 * turn_deg)
    away = -side_mm * np.sin(spin), z - side_mm - side_mm * np.cos(spin)
    place = (x, y + away[0], away[1]) if along == "y" else (x + away[0], y, away[1])
    turn, tilt = (-turn_deg, 0.0), (180.0 - 2 * turn_deg, 0.0)
    own = {"width_mm": 12.0, "height_mm": 12.0} | mirror
    return design.replace(
        {
            "camera.position_mm": place,
            "housing.seats": None,  # they hold a camera that looks straight down
            "camera.tilt_deg": tilt if along == "y" else tilt[::-1],
            "camera.mirror": {
                "centre_mm": (x, y, z - side_mm),
                "tilt_deg": turn if along == "y" else turn[::-1],
                **own,
            },
        }
    )


@pytest.mark.parametrize("along", ["x", "y"])
@pytest.mark.parametrize("turn_deg", [30.0, 45.0, 55.0])
def test_the_camera_behind_the_mirror_is_its_mirror_image(turn_deg, along):
    camera = folded(CORE, turn_deg=turn_deg, along=along).camera
    np.testing.assert_allclose(camera.eye_mm, CORE.camera.position_mm, atol=1e-9)
    np.testing.assert_allclose(camera.eye_tilt_deg, (0.0, 0.0), atol=1e-9)


@pytest.mark.physics
@pytest.mark.parametrize("along", ["x", "y"])
@pytest.mark.parametrize("turn_deg", [35.0, 45.0, 50.0])
def test_rays_reflected_at_the_mirror_meet_the_membrane_where_the_unfolded_ones_do(turn_deg, along):
    design = folded(CORE, turn_deg=turn_deg, along=along)
    view = View(200.0, 150.0, 1200.0, 900.0, 8, 6)
    seen = rays(design, view)
    # By hand: the real camera's own directions, reflected at the plane, then through the glass.
    camera, mirror = design.camera, design.camera.mirror
    column, row = view.centres()
    right, down = (
        (column - camera.centre_px[0]) / camera.focal_px,
        (row - camera.centre_px[1]) / camera.focal_px,
    )
    angle = np.radians(max(camera.tilt_deg))
    axis, up = np.array([0, np.sin(angle), -np.cos(angle)]), np.array([0, np.cos(angle), np.sin(angle)])
    side, normal = np.array([1.0, 0, 0]), mirror.axes[2]
    if along == "x":
        axis, up, side = axis[[1, 0, 2]], np.array([0.0, 1, 0]), np.array([np.cos(angle), 0, np.sin(angle)])
    # a mirror swaps the side along which it is turned; the picture is turned back there
    swapped = (right, down) if along == "y" else (-right, -down)
    way = axis[:, None, None] + side[:, None, None] * swapped[0] + up[:, None, None] * swapped[1]
    way = way / np.linalg.norm(way, axis=0)
    start = np.array(camera.position_mm)[:, None, None]
    far = ((np.array(mirror.centre_mm)[:, None, None] - start) * normal[:, None, None]).sum(0) / np.einsum(
        "a,a...->...", normal, way
    )
    at = start + far * way
    way = way - 2 * np.einsum("a,a...->...", normal, way) * normal[:, None, None]
    point, bent, met = design.glass.follow(at, way)
    assert met.all()
    np.testing.assert_allclose(point[0] - bent[0] / bent[2] * point[2], seen.x_mm, atol=1e-6)
    np.testing.assert_allclose(point[1] - bent[1] / bent[2] * point[2], seen.y_mm, atol=1e-6)


@pytest.mark.physics
@pytest.mark.renders
@pytest.mark.usefixtures("backend")
def test_a_mirror_of_mitsuba_shows_what_the_unfolded_camera_does():
    flat = preset("gelsight-2020-flat").replace({"optics.path_length": 2, "optics.board_reflectance": (0.0,)})
    design = folded(flat, side_mm=5.0)
    view = design.view(12)
    simulator = Simulator(design, view=view, samples=256, seed=1, estimator="path")
    unfolded = simulator.frame(None).basis[0]
    scene = simulator.scene(simulator.surface(None))
    activate()
    import mitsuba as mi

    from designlab.simulation.render import bridge, sensors
    from designlab.simulation.render.emitters import emitter

    to_world = mi.ScalarTransform4f
    camera, mirror = design.camera, design.camera.mirror
    assert camera.tilt_deg == (90.0, 0.0)
    look = sensors._perspective(scene, 1024)
    look["to_world"] = to_world().look_at(
        origin=list(camera.position_mm),
        target=list(np.add(camera.position_mm, (0, 1, 0))),
        up=[0, 0, 1],
    )
    look["principal_point_offset_y"] = -look["principal_point_offset_y"]
    content = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3},
        "sensor": look,
        "mirror": {
            "type": "rectangle",
            "bsdf": {"type": "conductor", "material": "none"},
            "to_world": to_world().look_at(
                origin=list(mirror.centre_mm),
                target=list(np.asarray(mirror.centre_mm) + mirror.axes[2]),
                up=[1, 0, 0],
            )
            @ to_world().scale([6, 6, 1]),
        },
    }
    content |= {shape.name: bridge._mesh(shape, 0) for shape in scene.shapes}
    lights = [light for light in scene.lights if light.group == 0]
    content |= {f"light-{n}": emitter(light, scene, 0) for n, light in enumerate(lights)}
    picture = np.asarray(mi.render(mi.load_dict(content), spp=1024, seed=5))[..., 0][::-1]
    assert picture.mean() == pytest.approx(unfolded.mean(), rel=0.01)
    blocks = [image.reshape(3, -1, 3, 4).mean((1, 3)) for image in (picture[:9], unfolded[:9])]
    np.testing.assert_allclose(*blocks, rtol=0.01)


def test_a_mirror_is_written_read_and_kept_apart_in_digests():
    design = folded(CORE)
    assert loads(dumps(design)) == design
    assert design.digest != CORE.digest
    assert "mirror" not in repr(CORE.camera)
    assert design.camera.unfolded.mirror is None


@pytest.mark.parametrize(
    ("mirror", "rule"),
    [
        ({"width_mm": 2.0}, "mirror_fills_view"),
        ({"height_mm": 2.0}, "mirror_fills_view"),
        ({"side_mm": HEIGHT_MM - 9.0}, "mirror_above_core"),
    ],
)
def test_a_mirror_in_the_wrong_place_breaks_its_rule(mirror, rule):
    assert folded(CORE).margins()[rule] < 0
    assert folded(CORE, **mirror).margins()[rule] > 0
    assert rule not in CORE.margins()


@pytest.mark.faults
@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"camera.mirror": None}, ["camera: tilt_deg", "45 deg", "90"]),
        ({"camera.mirror.tilt_deg": (135.0, 0.0)}, ["mirror.tilt_deg", "behind"]),
        ({"camera.mirror.tilt_deg": (-45.0, 20.0)}, ["tilt_deg"]),
        ({"camera.tilt_deg": (-90.0, 0.0)}, ["mirror", "looks away"]),
        ({"camera.mirror.tilt_deg": (-80.0, 0.0)}, ["tilt_deg", "in the mirror", "45 deg"]),
        ({"camera.mirror.reflectance": 1.2}, ["camera.mirror.reflectance", "1.2"]),
    ],
)
def test_a_mirror_that_cannot_be_meant_is_refused(changes, words):
    with pytest.raises(DesignError) as refused:
        folded(CORE).replace(changes)
    for word in words:
        assert word in str(refused.value)
