"""Light in air by the path tracer against Lambert's closed forms, and where things are in the image."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from designlab.sensor.camera import View
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Simulator
from geometries.probes import parse
from tests.helpers.closed_forms import block_means, direct_radiance

pytestmark = [pytest.mark.physics, pytest.mark.usefixtures("backend"), pytest.mark.renders]

# One panel alone, black boards, light that meets the membrane once: direct light in closed form.
DIRECT = preset("gelsight-2020-flat").replace(
    {"optics.board_reflectance": (0.0,), "optics.path_length": 2, "mixing": None}
)
ALBEDO = np.array(DIRECT.per_group("membrane_albedo"))


def simulator(design, *, columns=24, rows=18, samples=256, seed=1, view=None):
    if view is None:
        whole = design.view(columns)
        view = whole._replace(rows=rows, height_px=whole.width_px * rows / columns)
    return Simulator(design, view=view, samples=samples, seed=seed, estimator="path")


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"leds.tilt_deg": 0.0},
        {"leds.tilt_deg": 60.0},
        {"leds.tilt_deg": 90.0, "leds.height_mm": 20.0, "leds.emitting_spans_mm": ((-2.0, 2.0),)},
    ],
    ids=["tilted-19", "perpendicular", "tilted-60", "parallel"],
)
def test_direct_light_of_a_panel_is_lamberts_direct_radiance(changes):
    design = DIRECT.replace(changes)
    sim = simulator(design)
    found = block_means(sim.frame(None).basis, 6)
    exact = block_means(direct_radiance(design, sim.rays.x_mm, sim.rays.y_mm), 6)
    np.testing.assert_allclose(found, exact, rtol=5e-3)


def test_light_falls_with_the_square_of_the_distance():
    # Far below a panel that faces the membrane, radiance is albedo / pi times flux / (pi h^2).
    radiances = []
    for height in (100.0, 200.0):
        design = DIRECT.replace(
            {
                "leds.tilt_deg": 90.0,
                "leds.height_mm": height,
                "leds.radius_mm": 2.0,
                "sensing_area_mm": (2.0, 1.5),
                "camera.position_mm": (0.0, 0.0, 40.0),
            }
        )
        image = simulator(design, columns=12, rows=9, samples=64).frame(None).basis
        radiances.append(image.mean(axis=(1, 2)))
        np.testing.assert_allclose(radiances[-1], ALBEDO / np.pi / (np.pi * height**2), rtol=4e-3)
    np.testing.assert_allclose(radiances[0] / radiances[1], 4.0, rtol=4e-3)


def test_all_flux_of_a_downward_panel_lands_on_a_wide_membrane():
    # Radiance times pi / albedo is irradiance, which a small Lambertian source of 1 mW at height h spreads as
    # h^2 / (pi d^4), d the distance.
    design = DIRECT.replace(
        {
            "leds.tilt_deg": 90.0,
            "leds.height_mm": 4.0,
            "leds.radius_mm": 1.0,
            "leds.emitting_width_mm": 1.0,
            "leds.emitting_spans_mm": ((-0.5, 0.5),),
            "leds.body_width_mm": 1.0,
            "leds.body_height_mm": 1.0,
            "leds.body_thickness_mm": 0.1,
            "elastomer.outline": "rectangle",
            "elastomer.width_mm": 60.0,
            "elastomer.length_mm": 60.0,
            "sensing_area_mm": (48.0, 48.0),
            "camera.position_mm": (0.0, 0.0, 400.0),
        }
    )
    sim = simulator(design, columns=64, rows=64, samples=16)
    image = sim.frame(None).basis
    pitch_x, pitch_y = sim.rays.pitch_mm
    x, y = sim.rays.x_mm, sim.rays.y_mm
    # the camera far above sees the small bodies themselves, which stand before the middle
    hidden = np.hypot(x, y) < 3.0
    for group, azimuth in enumerate((90.0, 210.0, 330.0)):
        centre = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
        d2 = (x - centre[0]) ** 2 + (y - centre[1]) ** 2 + 16.0
        expected = (16.0 / (np.pi * d2**2))[~hidden].sum()
        found = image[group][~hidden].sum() * np.pi / ALBEDO[group]
        assert found == pytest.approx(expected, rel=0.01)
        assert 0.3 < expected * pitch_x * pitch_y < 1.0  # most of the flux takes part in the test


def test_groups_add_up_and_do_not_know_each_other():
    design = DIRECT.replace({"optics.board_reflectance": (0.5,), "optics.path_length": 4})
    together = simulator(design, columns=16, rows=12, samples=64).frame(None)
    # one group alone, with the same seed: only its own light sources emit
    dimmed = design.replace({"leds.groups.0.flux_mw": 1e-6})
    other = simulator(dimmed, columns=16, rows=12, samples=64).frame(None)
    np.testing.assert_allclose(together.basis, other.basis, rtol=1e-6)
    np.testing.assert_allclose(other.mixed[..., 1:], together.mixed[..., 1:], rtol=1e-6)
    flux = np.array([group.flux_mw for group in design.leds.groups])
    np.testing.assert_allclose(together.mixed, np.moveaxis(together.basis, 0, -1) * flux, rtol=1e-6)


def test_mixing_turns_groups_into_channels():
    mixing = ((1.0, 0.2, 0.0), (0.0, 1.0, 0.1), (0.05, 0.0, 1.0))
    plain = simulator(DIRECT, columns=16, rows=12, samples=16).frame(None)
    mixed = simulator(DIRECT.replace({"mixing": mixing}), columns=16, rows=12, samples=16).frame(None)
    np.testing.assert_allclose(mixed.mixed, plain.mixed @ np.array(mixing).T, rtol=1e-5)


def test_more_bounces_add_light_between_boards_and_membrane():
    bright = {"optics.board_reflectance": (0.8,), "optics.membrane_albedo": (0.8,)}
    means = [
        simulator(DIRECT.replace({**bright, "optics.path_length": n}), columns=16, rows=12, samples=64)
        .frame(None)
        .basis.mean()
        for n in (2, 4, 8)
    ]
    # board and membrane see each other: LED, membrane, board, membrane, camera has 4 segments
    assert means[0] * 1.001 < means[1] < means[2] * 1.0005
    assert means[2] < means[0] * 1.5


def test_each_group_is_brightest_on_its_own_side():
    image = simulator(DIRECT, samples=64).frame(None).basis
    red, green, blue = image
    # red from +y, the top row; green from lower left, blue from lower right
    assert red[0].mean() > 2 * red[-1].mean()
    assert green[:, 0].mean() > 2 * green[:, -1].mean()
    assert blue[:, -1].mean() > 2 * blue[:, 0].mean()
    assert green[-1].mean() > green[0].mean()


def test_a_ball_appears_where_the_viewing_geometry_says():
    place = (3.0, 2.0)
    sim = simulator(DIRECT, columns=96, rows=72, samples=16)
    frame = sim.frame(Press(probe=parse("sphere:4"), depth_mm=0.5, centre_mm=place))
    untouched = sim.frame(None, seed=2)
    change = np.abs(frame.mixed - untouched.mixed).sum(axis=-1) / untouched.mixed.sum(axis=-1)
    weight = np.where(gaussian_filter(change, 1) > 0.15, change, 0)
    rows, columns = np.indices(change.shape)
    row, column = (float((weight * index).sum() / weight.sum()) for index in (rows, columns))
    view, pixel = sim.view, sim.view.width_px / sim.view.columns
    expected = sim.design.project_px(*place)
    assert column > 48
    assert row < 36
    # shadows on the far sides move the centre of the change a little
    assert view.x_px + (column + 0.5) * pixel == pytest.approx(expected[0], abs=3 * pixel)
    assert view.y_px + (row + 0.5) * pixel == pytest.approx(expected[1], abs=3 * pixel)


def test_the_lit_flank_is_the_one_towards_the_light():
    sim = simulator(DIRECT, columns=48, rows=36, samples=64)
    frame = sim.frame(Press(probe=parse("sphere:5"), depth_mm=0.6))
    change = frame.basis / sim.frame(None).basis
    x, y = frame.seen_mm
    for group, azimuth in enumerate((90.0, 210.0, 330.0)):
        along = x * np.cos(np.radians(azimuth)) + y * np.sin(np.radians(azimuth))
        ring = np.abs(np.hypot(x, y) - 1.1) < 0.3
        assert change[group][ring & (along > 0.7)].mean() > 1.2
        assert change[group][ring & (along < -0.7)].mean() < 0.8


def test_a_crop_shows_what_the_full_view_shows_there():
    camera = DIRECT.camera
    wide = View(0.0, 0.0, camera.width_px, camera.height_px, camera.width_px // 24, camera.height_px // 24)
    crop = View(24.0 * 40, 24.0 * 30, 24.0 * 20, 24.0 * 15, 40, 30)
    press = Press(probe=parse("sphere:6"), depth_mm=0.8, centre_mm=(-1.0, 1.0))
    whole = simulator(DIRECT, view=wide, samples=64).frame(press).basis[:, 30:45, 40:60]
    part = simulator(DIRECT, view=crop, samples=256, seed=5).frame(press).basis
    binned = part.reshape(3, 15, 2, 20, 2).mean(axis=(2, 4))
    # Where the grids of the membrane differ, so do edges; the bulk agrees to the noise.
    ratio = binned / whole
    assert np.median(np.abs(ratio - 1)) < 0.01
    assert ratio.mean() == pytest.approx(1.0, abs=2e-3)


def test_the_same_seed_gives_the_same_picture():
    first = simulator(DIRECT, columns=16, rows=12, samples=16, seed=3).frame(None).basis
    np.testing.assert_allclose(
        simulator(DIRECT, columns=16, rows=12, samples=16, seed=3).frame(None).basis, first, rtol=1e-5
    )
    assert (simulator(DIRECT, columns=16, rows=12, samples=16, seed=4).frame(None).basis != first).any()


SCALAR_PROGRAM = """
import sys
import numpy as np
from designlab.sensor.design import loads
from designlab.core.backend import activate
from designlab.simulation.simulator import Simulator
design = loads(sys.stdin.read())
view = design.view(8)._replace(rows=6)
np.save(sys.argv[1], Simulator(design, view=view, samples=256, seed=1).frame(None).basis)
print(activate().variant)
"""


def test_the_scalar_back_end_renders_the_same(tmp_path):
    from designlab.sensor.design import dumps

    file = tmp_path / "basis.npy"
    answer = subprocess.run(
        [sys.executable, "-c", SCALAR_PROGRAM, str(file)],
        input=dumps(DIRECT),
        env=os.environ | {"DESIGNLAB_VARIANT": "scalar_rgb"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert answer.stdout.strip() == "scalar_rgb"
    view = DIRECT.view(8)._replace(rows=6)
    sim = Simulator(DIRECT, view=view, samples=256, seed=1)
    exact = direct_radiance(DIRECT, sim.rays.x_mm, sim.rays.y_mm)
    # pixels of 2 mm: the light at their centre stands for their mean to second order
    np.testing.assert_allclose(np.load(file).mean(axis=(1, 2)), exact.mean(axis=(1, 2)), rtol=0.01)
    np.testing.assert_allclose(np.load(file), sim.frame(None).basis, rtol=0.05)
