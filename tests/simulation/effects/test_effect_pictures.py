"""Effects in pictures: combined from a bank against full renders, and the generator against both.

What is compared are signals of the untouched gel and of a press, see `effect_pictures`. The generator shares
neither light transport nor effects with the simulator.
"""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from designlab.core.images import write_image
from designlab.sensor.camera import Vignetting
from designlab.sensor.optical_properties import AlbedoImage
from designlab.simulation.effects import CATALOGUE, Sight, effect
from designlab.simulation.effects.material import albedo_field
from designlab.simulation.simulator import Simulator
from designlab.validation.synthetic import effects
from tests.helpers.effect_pictures import Sensor, rms, values_at

pytestmark = [pytest.mark.physics, pytest.mark.renders]

FLAT = "gelsight-2020-flat"
DOME = "gelsight-2020-dome"
ELASTIC = "gelsight-2020-flat-elastic"
CORE = "gelsight-2020-flat-core"
OF_ONE_PICTURE = ("fixed_pattern", "exposure_drift", "banding")
OF_CORE = {"gelcore_index", "absorption", "core_scatter", "delamination"}
OF_LAYER = ("gel_thickness", "friction", "skin_length")
BETWEEN = 0.6  # prior standard deviations; pictures are rendered at 0 and 1, or 1 and 2 where one-sided
CHEAP = 0.01  # of the signal's rms
GENERATOR = 0.2  # of the rms of the change
POST = [e.name for e in CATALOGUE if not e.rendered and e.name not in OF_ONE_PICTURE]
QUICK = ["contact_kernel", "depth_offset", "lens_distortion", "camera_pose"]
SLOW = [
    e.name
    for e in CATALOGUE
    if e.name not in (*OF_ONE_PICTURE, *OF_CORE, *OF_LAYER, *QUICK, "probe_edge")  # a ball has no edge
    and (e.rendered or e.name == "colour_mixing")
]
# Effects by little change need less noise of the light field than the others.
SAMPLES = {"interreflection": 256, "led_tilt": 64}


@pytest.fixture(scope="module")
def flat():
    return Sensor(FLAT, 32)


@pytest.fixture(scope="module")
def behind_glass():
    return Sensor(CORE, 32, samples=512)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("renders")


def assert_combines(sensor, name, folder):
    values = values_at(name, sensor.design, BETWEEN)
    plain, full = sensor.simulated(), sensor.simulated(name, values)
    combined = sensor.combined(name, values, folder=folder)
    change, error = rms(full - plain), rms(combined - full)
    assert error <= CHEAP * rms(plain)
    assert error <= 0.5 * change


@pytest.mark.llvm
@pytest.mark.parametrize("name", QUICK)
def test_a_picture_between_rendered_ones_is_that_of_a_full_render(name, flat, folder):
    assert_combines(flat, name, folder)


@pytest.mark.full
@pytest.mark.llvm
@pytest.mark.parametrize("name", SLOW)
def test_every_picture_between_rendered_ones_is_that_of_a_full_render(name, tmp_path):
    assert_combines(Sensor(FLAT, 32, samples=SAMPLES.get(name, 32)), name, tmp_path)


@pytest.mark.full
@pytest.mark.llvm
def test_a_moved_camera_sees_a_dome_by_resampling(tmp_path):
    assert_combines(Sensor(DOME, 48), "camera_pose", tmp_path)
    assert_combines(Sensor(DOME, 48), "lens_distortion", tmp_path)


@pytest.mark.llvm
def test_effects_of_the_camera_need_no_render(flat, folder):
    plain = flat.simulated()
    for name in POST:
        if name in QUICK or not effect(name).parameters(flat.design):
            continue
        values = values_at(name, flat.design, BETWEEN)
        full = flat.simulated(name, values)
        assert rms(flat.combined(name, values, folder=folder) - full) <= 1e-4 * rms(plain), name
        assert rms(full - plain) > 1e-4 * rms(plain), name


@pytest.mark.llvm
def test_a_factor_on_the_albedo_is_a_texture_but_for_what_goes_round(flat, tmp_path):
    """The factor leaves light alone that comes off the membrane and returns to it: up to a percent."""
    values = {"x": 0.04, "y": -0.03, "xx": 0.05, "xy": -0.05, "yy": 0.02}
    width, height = flat.design.sensing_area_mm
    # A texture only takes away; the brightest place is as bright as without it.
    x, y = (np.linspace(-1, 1, count) * 1.25 * size / 2 for count, size in ((160, width), (120, height)))
    place = np.meshgrid(x, y[::-1])
    field = 1 + albedo_field(values, Sight(flat.design, flat.view, (place[0], place[1]), (0.1, 0.1)))
    peak = float(field.max())
    write_image(
        tmp_path / "field.png", (field / peak)[..., None].repeat(3, axis=2).astype(np.float32), bits=16
    )
    albedo = [a * peak for a in flat.design.per_group("membrane_albedo")]
    textured = flat.design.replace({"optics.membrane_albedo": tuple(albedo)})
    # Pixels are centred in cells, so that the picture reaches half a cell beyond the first and last.
    size = [float(axis[-1] - axis[0]) * len(axis) / (len(axis) - 1) for axis in (x, y)]
    image = AlbedoImage.model_validate(
        {"file": str(tmp_path / "field.png"), "width_mm": size[0], "height_mm": size[1]}
    )
    textured = textured.replace({"optics.albedo_image": image.model_dump()})
    plain, factor = flat.simulated(), flat.simulated("albedo_field", values)
    other = Sensor(FLAT, 32)
    other.__dict__["design"] = textured
    found = other.simulated()
    assert rms(factor - found) <= 0.01 * rms(plain)
    assert rms(factor - found) <= 0.25 * rms(factor - plain)


@pytest.mark.llvm
def test_vignetting_is_that_of_a_camera_which_states_it(flat):
    lossy = flat.design.replace({"camera.vignetting": Vignetting(a1=-0.25).model_dump()})
    other = Sensor(FLAT, 32)
    other.__dict__["design"] = lossy
    found, stated = flat.simulated("vignetting", {"corner_loss": 0.25}), other.simulated()
    np.testing.assert_allclose(found, stated, rtol=2e-5)


@pytest.mark.llvm
def test_blur_is_that_of_a_lens_out_of_focus_on_the_plane():
    """Of equal rms a disc and a Gaussian differ in shape alone: on the edges of a press by little.

    A lens of radius R focused on f blurs a plane at distance D by a disc of R |D - f| / f, whose rms for each
    axis is half of that.
    """
    sensor = Sensor(FLAT, 96)
    distance = sensor.design.camera.position_mm[2]
    focus, sigma_mm = 39.0, 0.15
    aperture = 2 * 2 * sigma_mm * focus / abs(distance - focus)
    plain, blurred = sensor.simulated(), sensor.simulated("point_spread", {"sigma_um": 150.0})
    lens = Sensor(FLAT, 96)
    lens.__dict__["design"] = sensor.design.replace(
        {"camera.focus_mm": focus, "camera.aperture_mm": aperture}
    )
    out_of_focus = lens.simulated()
    away = out_of_focus - blurred
    assert rms(away) <= 0.01 * rms(plain)
    assert rms(away) <= 0.25 * rms(blurred - plain)


@pytest.mark.llvm
def test_colours_recombine_to_a_design_with_that_mixing(flat):
    values = values_at("colour_mixing", flat.design, 1.0, seed=2)
    mixed = effect("colour_mixing").on_design(flat.design, values)
    frame = Simulator(mixed, view=flat.view, samples=flat.samples, seed=flat.seed).frame(flat.presses[1])
    found = flat.simulated("colour_mixing", values)[1]
    np.testing.assert_allclose(found, frame.mixed * mixed.camera.exposure, rtol=1e-5, atol=1e-6)


def assert_generator_agrees(sensor, name, *, grain_px=0.0, **fixed):
    """Compare the changes, where asked without the random grain of the simulator's light field."""
    values = values_at(name, sensor.design, 1.0, seed=1) | fixed
    plain, (base, _) = sensor.simulated(), sensor.generated()
    found, own = sensor.generated(name, values)
    changed = sensor.simulated(name, values, own=own if name in OF_ONE_PICTURE else None)
    change, other = (
        gaussian_filter(d, (0, grain_px, grain_px, 0), mode="nearest")
        for d in (changed - plain, found - base)
    )
    assert rms(change) > 1e-4 * rms(plain)
    assert rms(other - change) <= GENERATOR * rms(change)


CAMERA = [e.name for e in CATALOGUE if e.stage == "camera" and e.name != "point_spread"]
BEFORE = [
    e.name
    for e in CATALOGUE
    if e.name in effects.names()
    and e.name not in (*OF_CORE, *OF_LAYER, *CAMERA, "point_spread", "probe_edge")
]


@pytest.mark.llvm
@pytest.mark.parametrize("name", [*CAMERA, "camera_pose", "depth_offset", "contact_kernel", "albedo_field"])
def test_the_generators_own_formulation_makes_the_same_change(name, flat):
    assert_generator_agrees(flat, name)


@pytest.mark.full
@pytest.mark.llvm
@pytest.mark.parametrize("name", BEFORE)
def test_the_generator_makes_the_same_change_to_light_and_gel(name):
    assert_generator_agrees(Sensor(FLAT, 32, samples=SAMPLES.get(name, 64)), name)


@pytest.mark.full
@pytest.mark.llvm
@pytest.mark.parametrize(
    "name", ["led_position", "led_tilt", "specular_coat", "contact_profile", "camera_pose"]
)
def test_the_generator_makes_the_same_change_to_a_dome(name):
    assert_generator_agrees(Sensor(DOME, 32, samples=256), name)


@pytest.mark.full
@pytest.mark.llvm
def test_the_generator_shows_an_elastic_gel_as_the_simulator_does():
    """The press changes a picture out to its border, since the gel bulges; both solve for it on their own."""
    sensor = Sensor(ELASTIC, 32, samples=64)
    untouched, press = sensor.simulated()
    (ours_untouched, ours), _ = sensor.generated()
    change, other = press - untouched, ours - ours_untouched
    assert rms(other - change) <= 0.05 * rms(change)


@pytest.mark.full
@pytest.mark.llvm
@pytest.mark.parametrize("name", ["gel_thickness", "probe_size", "depth_offset", "wetting"])
def test_the_generator_makes_the_same_change_to_an_elastic_gel(name):
    # Not of the skin, which the ball that is pressed here does not show. The coating is tight: the simulator
    # knows the rim of a contact to a cell of its coating, and the rim moves by less here.
    changes = {"optics.coating_transmittance": 0.0}
    assert_generator_agrees(Sensor(ELASTIC, 32, samples=64, changes=changes), name)


@pytest.mark.llvm
def test_the_generators_disc_and_the_gaussian_blur_alike_where_pixels_resolve_them():
    sensor = Sensor(FLAT, 96, samples=64)
    plain, (base, _) = sensor.simulated(), sensor.generated()
    change = sensor.simulated("point_spread", {"sigma_um": 150.0}) - plain
    other = sensor.generated("point_spread", {"sigma_um": 150.0})[0] - base
    assert rms(other - change) <= GENERATOR * rms(change)


@pytest.mark.full
@pytest.mark.llvm
@pytest.mark.parametrize("name", [*sorted(OF_CORE - {"core_scatter"}), "led_position", "camera_pose"])
def test_the_generator_makes_the_same_change_behind_glass(name, behind_glass):
    fixed = {"x_mm": 2.0, "y_mm": 1.0} if name == "delamination" else {}
    assert_generator_agrees(behind_glass, name, grain_px=2.0, **fixed)


@pytest.mark.full
@pytest.mark.llvm
@pytest.mark.xfail(
    reason="the pattern of what haze throws into the camera differs by a tenth, its level by 2 %"
)
def test_the_generator_makes_the_same_haze(behind_glass):
    assert_generator_agrees(behind_glass, "core_scatter", grain_px=2.0)
