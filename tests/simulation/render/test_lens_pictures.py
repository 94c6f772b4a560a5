"""Pictures through distorting, wide and defocused lenses, against closed forms and Mitsuba's own lens."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from designlab.sensor.design import dumps, preset
from designlab.sensor.refraction import apparent_distance_mm
from designlab.simulation.contact.press import Press
from designlab.simulation.optics.defocus import blur, radius_px
from designlab.simulation.optics.viewing_rays import rays
from designlab.simulation.render import bridge, path, sensors
from designlab.simulation.simulator import Simulator
from geometries.elastomer import inside
from geometries.probes import parse
from tests.helpers.closed_forms import block_means, direct_radiance

pytestmark = [pytest.mark.physics, pytest.mark.usefixtures("backend"), pytest.mark.renders]

CORE, FLAT, DOME = preset("default"), preset("gelsight-2020-flat"), preset("gelsight-2020-dome")
# Black boards and light that meets the membrane once: direct light in closed form.
DIRECT = FLAT.replace({"optics.board_reflectance": (0.0,), "optics.path_length": 2, "mixing": None})
# So close that lenses differ much over the sensing area.
CLOSE = DIRECT.replace({"camera.position_mm": (0.6, 0.4, 18.0), "camera.horizontal_fov_deg": 75.0})
BARREL = {"k1": -0.32, "k2": 0.11, "k3": -0.012, "p1": 0.003, "p2": -0.004}
LENSES = {
    "barrel": {"camera.distortion": BARREL},
    "fisheye": {"camera.lens": "fisheye", "camera.horizontal_fov_deg": 120.0, "camera.distortion.k1": -0.03},
    "off centre": {"camera.principal_point_px": (1100.0, 1075.0), "camera.distortion.k1": -0.1},
    "wide pixels": {"camera.pixel_aspect": 1.2},
    "plain off centre": {"camera.principal_point_px": (1100.0, 1075.0)},
}
BALL = Press(probe=parse("sphere:5"), depth_mm=0.8, centre_mm=(2.0, 1.0))


def simulator(design, *, columns=24, rows=18, samples=256, seed=1, estimator="path"):
    whole = design.view(columns)
    view = whole._replace(rows=rows, height_px=whole.width_px * rows / columns)
    return Simulator(design, view=view, samples=samples, seed=seed, estimator=estimator)


@pytest.mark.llvm
@pytest.mark.parametrize("changes", LENSES.values(), ids=LENSES)
@pytest.mark.parametrize("estimator", ["fast", "path"])
def test_direct_light_through_a_lens_is_lamberts(changes, estimator):
    sim = simulator(CLOSE.replace(changes), estimator=estimator)
    found = block_means(sim.frame(None).basis, 6)
    exact = block_means(direct_radiance(sim.design, sim.rays.x_mm, sim.rays.y_mm), 6)
    np.testing.assert_allclose(found, exact, rtol=5e-3)


@pytest.mark.parametrize("changes", LENSES.values(), ids=LENSES)
@pytest.mark.parametrize("columns", [24, 500])
def test_the_table_of_directions_is_fine_enough(changes, columns):
    camera = FLAT.replace(changes).camera
    view = camera.full_view()._replace(columns=columns, rows=columns * 3 // 4)
    table = sensors.directions(camera, view)
    u, v = np.random.default_rng(1).uniform(0, 1, (2, 5000))
    places = [v * (table.shape[0] - 1), u * (table.shape[1] - 1)]
    direction = [map_coordinates(table[..., k], places, order=1) for k in range(3)]
    column, row = camera.project(*direction)
    off = np.hypot(column - u * view.width_px, row - v * view.height_px)
    assert off.max() < 0.01  # pixels of the full sensor


@pytest.mark.llvm
@pytest.mark.parametrize("changes", LENSES.values(), ids=LENSES)
def test_a_pressed_ball_is_where_a_resampled_perspective_shows_it(changes):
    sim = simulator(CLOSE.replace(changes), columns=64, rows=48, samples=256)
    scene = sim.scene(sim.surface(BALL))
    found = path.radiance(scene, samples=256, seed=1)
    flat = sensors.perspective_of(scene)
    expected = sensors.resampled(path.radiance(flat, samples=64, seed=2), flat, scene)
    plain = path.radiance(replace(scene, camera=CLOSE.camera), samples=64, seed=2)
    error, apart = np.abs(found / expected - 1), np.abs(plain / expected - 1)
    assert np.median(error) < 0.004
    assert error.mean() < 0.01
    assert apart.mean() > 5 * error.mean()  # without the lens the picture is another one


SCALAR_PROGRAM = """
import sys
import numpy as np
from designlab.sensor.design import loads
from designlab.core.backend import activate
from designlab.simulation.simulator import Simulator
design = loads(sys.stdin.read())
view = design.view(12)._replace(rows=9)
np.save(sys.argv[1], Simulator(design, view=view, samples=256, seed=1).frame(None).basis)
print(activate().variant)
"""


def on_scalar(design, file):
    return subprocess.run(
        [sys.executable, "-c", SCALAR_PROGRAM, str(file)],
        input=dumps(design),
        env=os.environ | {"DESIGNLAB_VARIANT": "scalar_rgb"},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_scalar_back_end_resamples_a_perspective(tmp_path):
    design = CLOSE.replace(LENSES["fisheye"])
    answer = on_scalar(design, tmp_path / "basis.npy")
    assert answer.stdout.strip() == "scalar_rgb", answer.stderr
    seen = rays(design, design.view(12)._replace(rows=9))
    exact = direct_radiance(design, seen.x_mm, seen.y_mm)
    found = np.load(tmp_path / "basis.npy")
    np.testing.assert_allclose(found.mean(axis=(1, 2)), exact.mean(axis=(1, 2)), rtol=0.01)
    np.testing.assert_allclose(found[:, 1:-1, 1:-1], exact[:, 1:-1, 1:-1], rtol=0.06)


def test_what_a_perspective_cannot_stand_in_for_is_refused():
    wide = DIRECT.replace({"camera.lens": "fisheye", "camera.horizontal_fov_deg": 170.0})
    sim = simulator(DIRECT)
    scene = replace(sim.scene(sim.surface(None)), camera=wide.camera, view=wide.camera.full_view())
    with pytest.raises(ValueError, match=r"camera\.lens.*scalar_rgb.*within 80 deg"):
        sensors.perspective_of(scene)


@pytest.mark.llvm
def test_a_defocused_picture_is_that_of_mitsubas_thin_lens():
    import mitsuba as mi

    design = DIRECT.replace({"camera.position_mm": (0.0, 0.0, 41.0)})
    design = design.replace({"camera.focus_mm": 28.0, "camera.aperture_mm": 2.4})
    camera = design.camera
    # Mitsuba's lens looks along the axis only: the whole sensor is rendered
    view = camera.full_view()._replace(columns=96, rows=72)
    sim = Simulator(design, view=view, samples=1024, seed=1)
    surface = sim.surface(BALL)
    scene = sim.scene(surface)
    found = path.radiance(scene, samples=1024, seed=1)[0]
    loaded = bridge.load(scene, group=0, integrator={"type": "path", "max_depth": 2}, samples=1024)
    lens = mi.load_dict(
        {
            "type": "thinlens",
            "to_world": mi.ScalarTransform4f().look_at(
                origin=[0.0, 0.0, 41.0], target=[0.0, 0.0, 0.0], up=[0.0, 1.0, 0.0]
            ),
            "fov": camera.horizontal_fov_deg,
            "fov_axis": "x",
            "aperture_radius": 1.2,
            "focus_distance": 28.0,
            "near_clip": 0.05,
            "sampler": {"type": "ldsampler", "sample_count": 1024},
            "film": {
                "type": "hdrfilm",
                "width": 96,
                "height": 72,
                "pixel_format": "luminance",
                "rfilter": {"type": "box"},
            },
        }
    )
    theirs = np.asarray(mi.render(loaded, sensor=lens, spp=1024, seed=5)).reshape(found.shape)
    sharp = path.radiance(
        replace(scene, camera=camera.model_copy(update={"focus_mm": None})), samples=256, seed=1
    )[0]
    x, y = sim.rays.x_mm, sim.rays.y_mm
    near = (np.abs(x) < 9) & (np.abs(y) < 7)
    noise = np.abs(found[near] / theirs[near] - 1)
    assert np.median(noise) < 0.01
    assert (found[near].sum() / theirs[near].sum()) == pytest.approx(1.0, abs=2e-3)
    # the sharp picture is another one, the fast blur is the same one
    fast = blur(sharp[None].astype(np.float32), radius_px(design, view, surface))[0]
    contact = np.hypot(x - 2.0, y - 1.0) < 3.0
    rms = {
        name: float(np.std(image[contact] / theirs[contact]))
        for name, image in (("traced", found), ("fast", fast), ("sharp", sharp))
    }
    assert rms["traced"] < 0.02
    assert rms["fast"] < 0.03
    assert rms["sharp"] > 3 * rms["fast"]


@pytest.mark.llvm
@pytest.mark.parametrize(("design", "estimator"), [(DIRECT, "path"), (CORE, "fast")])
def test_vignetting_darkens_the_finished_picture(design, estimator):
    plain, darkened = (
        simulator(
            design.replace({"camera.vignetting": vignetting}),
            columns=16,
            rows=12,
            samples=4,
            estimator=estimator,
        )
        for vignetting in ({}, {"cosine_power": 4.0})
    )
    camera = design.camera
    column, row = plain.view.centres()
    tangent = np.hypot(column - camera.width_px / 2, row - camera.height_px / 2) / camera.focal_px
    ratio = darkened.frame(None).basis / plain.frame(None).basis
    np.testing.assert_allclose(ratio, np.broadcast_to((1 + tangent**2) ** -2, ratio.shape), rtol=1e-5)
    assert ratio.min() < 0.95


@pytest.mark.llvm
def test_a_defocused_light_field_is_the_average_over_the_opening():
    # the same field shaded along the rays of many points of the opening
    from designlab.simulation.render.session import SESSION

    distance = apparent_distance_mm(CORE.layers_to_camera(0.0))
    design = CORE.replace({"camera.focus_mm": 0.6 * distance, "camera.aperture_mm": 1.5})
    sim = Simulator(design, columns=80, samples=16, seed=1)
    surface = sim.surface(BALL)
    scene = sim.scene(surface)
    area_mm = CORE.sensing_area_mm
    shade = SESSION.shader(sim.undeformed, sim.surface(None), area_mm=area_mm, samples=16, seed=1).radiance
    # rings of equal area, whose mean square radius is that of the disc
    radius, turn = np.meshgrid(np.sqrt((np.arange(2) + 0.5) / 2), np.arange(8) * np.pi / 4)
    points = np.column_stack([(radius * np.cos(turn)).ravel(), (radius * np.sin(turn)).ravel()])
    exact = np.mean(
        [shade(surface, scene, rays(design, sim.view, lens_point=(u, v))) for u, v in points],
        axis=0,
    )
    sharp = shade(surface, scene, sim.rays)
    fast = blur(sharp, radius_px(design, sim.view, surface))
    middle = np.s_[:, 8:-8, 8:-8]
    error = (fast / exact - 1)[middle]
    assert error.std() < 0.01
    assert abs(error.mean()) < 1e-3
    assert (sharp / exact - 1)[middle].std() > 4 * error.std()


@pytest.mark.llvm
@pytest.mark.parametrize("changes", LENSES.values(), ids=LENSES)
def test_the_generator_of_measurements_sees_the_same_through_a_lens(changes):
    from designlab.validation.synthetic.generator_sensor import Rig
    from designlab.validation.synthetic.raycast import Caster

    design = CLOSE.replace({**changes, "camera.vignetting": {"cosine_power": 2.0, "a1": -0.1}})
    sim = simulator(design, columns=32, rows=24, samples=256)
    cast = Caster(Rig.of(design), sim.view).radiance(None)
    found = sim.frame(None).basis
    np.testing.assert_allclose(block_means(found, 8), block_means(cast, 8), rtol=5e-3)
    np.testing.assert_allclose(found, cast, rtol=0.05)


@pytest.mark.llvm
def test_beside_the_gel_a_wide_lens_sees_its_black_rim():
    design = CORE.replace({"camera.lens": "fisheye", "camera.horizontal_fov_deg": 150.0})
    view = design.camera.full_view()._replace(columns=80, rows=60)
    sim = Simulator(design, view=view, samples=2, seed=1)
    picture = sim.frame(None).basis
    # the mesh of the membrane follows the outline to half a millimetre
    within, beside = (
        inside(design.elastomer, share * sim.rays.x_mm, share * sim.rays.y_mm) for share in (1.06, 0.94)
    )
    assert within.mean() > 0.1
    assert beside.mean() < 0.5
    assert not picture[:, ~beside].any()
    assert (picture[:, within] > 0).mean() > 0.99
