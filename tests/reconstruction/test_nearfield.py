"""Near-field photometric stereo against closed-form shading of distant lights."""

import numpy as np
import pytest

from designlab.core.metrics import normal_error_deg
from designlab.evaluation.noise_limit import AZIMUTHS, RINGS, pressed_limit_deg
from designlab.evaluation.protocol import EvaluationProtocol, sub_seed
from designlab.reconstruction import NearField, near_field, normals
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Simulator, exposure
from geometries.probes import parse

SLANT = np.radians(55.0)
AZIMUTH = np.radians([90.0, 210.0, 330.0])
LIGHTS = np.stack(
    [np.sin(SLANT) * np.cos(AZIMUTH), np.sin(SLANT) * np.sin(AZIMUTH), np.full(3, np.cos(SLANT))], axis=1
)
MIX = np.array([[0.5, 0.05, 0.0], [0.02, 0.6, 0.03], [0.0, 0.04, 0.4]])
SHAPE = (40, 60)


def shading(p, q, lights=LIGHTS):
    """Cosine law of distant lights, attached shadow included, shape (groups, rows, columns)."""
    normal = np.stack([-p, -q, np.ones_like(p)]) / np.sqrt(1 + p**2 + q**2)
    return np.maximum(np.tensordot(lights, normal, axes=1), 0.0)


def response(p, q, step=1e-5):
    """Derivative of the shading by central differences."""
    return np.stack(
        [
            (shading(p + step, q) - shading(p - step, q)) / (2 * step),
            (shading(p, q + step) - shading(p, q - step)) / (2 * step),
        ],
        axis=-1,
    )


def signal(light, mix=MIX):
    return np.einsum("cg,grk->rkc", mix, light)


def even(values):
    return np.full_like(values, 0.004)


def slopes(steepest_deg, seed=0):
    """Random slopes, evenly spread over directions."""
    random = np.random.default_rng(seed)
    tangent = np.tan(np.radians(random.uniform(0, steepest_deg, SHAPE)))
    azimuth = random.uniform(0, 2 * np.pi, SHAPE)
    return tangent * np.cos(azimuth), tangent * np.sin(azimuth)


FLAT = np.zeros(SHAPE)


@pytest.mark.parametrize("base", [(0.0, 0.0), (0.2, -0.1)])
def test_slopes_of_lit_pixels_come_back_exactly(base):
    a, b = FLAT + base[0], FLAT + base[1]
    p, q = slopes(20.0)
    assert (shading(a + p, b + q) > 0).all()
    found = near_field(
        signal(shading(a + p, b + q)) + 0.03,
        shading(a, b),
        response(a, b),
        MIX,
        noise_sigma=even,
        offset=0.03,
        base=(a, b),
    )
    np.testing.assert_allclose(found.p, p, atol=1e-6)
    np.testing.assert_allclose(found.q, q, atol=1e-6)


def test_light_from_the_gel_around_is_that_of_a_tilted_plane_over_a_lit_one():
    p, q = slopes(30.0)
    albedo = np.array([0.5, 0.4, 0.6])
    # form factor of a plane seen by a facet that is tilted against it
    sky_lost = (1 - 1 / np.sqrt(1 + p**2 + q**2)) / 2
    light = shading(p, q) + albedo[:, None, None] * shading(FLAT, FLAT) * sky_lost
    known = NearField.of(shading(FLAT, FLAT), response(FLAT, FLAT), MIX, noise_sigma=even, reflectance=albedo)
    found = known.estimate(signal(light))
    np.testing.assert_allclose(found.p, p, atol=1e-6)
    np.testing.assert_allclose(found.q, q, atol=1e-6)


def test_scatter_is_that_of_the_noise_limit():
    sigma, steepest_deg, pixels = 0.002, 25.0, 4000
    logarithms = []
    for ring in range(RINGS):
        tangent = np.tan(np.radians(steepest_deg) * np.sqrt((ring + 0.5) / RINGS))
        for number in range(AZIMUTHS):
            azimuth = (number + 0.5 * (ring % 2)) * 2 * np.pi / AZIMUTHS
            p, q = np.full((2, 1, pixels), [[[tangent * np.cos(azimuth)]], [[tangent * np.sin(azimuth)]]])
            random = np.random.default_rng([ring, number])
            image = signal(shading(p, q)) + sigma * random.standard_normal((1, pixels, 3))
            known = NearField.of(
                shading(0 * p, 0 * q),
                response(0 * p, 0 * q),
                MIX,
                noise_sigma=lambda s: np.full_like(s, sigma),
                full_scale=2.0,
            )
            found = known.estimate(image)
            error_deg = normal_error_deg(normals(found.p, found.q), normals(p, q))
            logarithms.append(np.log(np.sqrt((error_deg**2).mean())))
    one = np.zeros((1, 1))
    limit = pressed_limit_deg(
        shading(one, one)[:, 0].T,
        response(one, one)[:, 0].transpose(1, 0, 2),
        MIX,
        lambda s: np.full_like(s, sigma),
        steepest_deg=steepest_deg,
    )
    np.testing.assert_allclose(np.exp(np.mean(logarithms)), limit[0], rtol=0.1)


def test_a_group_in_attached_shadow_leaves_two_channels_that_tell_the_slope():
    # turned away from the first light, 5 to 15 deg beyond its terminator
    tangent = np.tan(np.radians(np.linspace(40.0, 50.0, SHAPE[0] * SHAPE[1]).reshape(SHAPE)))
    p, q = 0.1 * tangent, tangent
    assert (shading(p, q)[0] == 0).all()
    assert (shading(p, q)[1:] > 0).all()
    mix = np.diag([0.5, 0.6, 0.4])
    # Where that light is barely lit instead, the others look almost alike: a sharp camera tells them apart.
    found = near_field(
        signal(shading(p, q), mix),
        shading(FLAT, FLAT),
        response(FLAT, FLAT),
        mix,
        noise_sigma=lambda s: np.full_like(s, 1e-6),
    )
    np.testing.assert_allclose(found.p, p, atol=1e-6)
    np.testing.assert_allclose(found.q, q, atol=1e-6)


def test_a_saturated_channel_does_not_count():
    # where the clipped channel's light grows, two are left
    p, q = slopes(15.0)
    mix = np.diag([1.2, 0.6, 0.4])
    image = np.minimum(signal(shading(p, q), mix), 0.7)
    clipped = image[..., 0] >= 0.7
    assert 0.2 < clipped.mean() < 0.8
    known = NearField.of(
        shading(FLAT, FLAT),
        response(FLAT, FLAT),
        mix,
        noise_sigma=even,
        full_scale=0.7,
        expected_slope=1e3,
    )
    found = known.estimate(image)
    # two channels leave two slopes; the gentler one is taken, which here is the true one
    np.testing.assert_allclose(found.p, p, atol=1e-6)
    np.testing.assert_allclose(found.q, q, atol=1e-6)
    assert found.weights[clipped].mean() < 0.9 * found.weights[~clipped].mean()
    assert (known.estimate(np.full((*SHAPE, 3), 0.7)).weights == 0).all()


def test_a_bump_casts_shadow_away_from_the_light():
    rows, columns = np.indices(SHAPE)
    height = np.where(np.hypot(rows - 20, columns - 30) < 5, 0.4, 0.0)
    known = NearField.of(shading(FLAT, FLAT), response(FLAT, FLAT), MIX, noise_sigma=even)
    visible = known.shadowed(height, pitch_mm=(0.1, 0.1)).visible
    # the first light stands at +y, up in the picture: its shadow, 0.4 tan 55 deg = 0.57 mm long, falls down
    assert visible[27, 30, 0] < 0.2
    assert visible[13, 30, 0] == pytest.approx(1.0)
    assert visible[39, 30, 0] == pytest.approx(1.0)
    np.testing.assert_allclose(known.shadowed(FLAT, pitch_mm=(0.1, 0.1)).visible, 1.0)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"light": np.ones((2, 3))}, r"light: must have shape \(groups, rows, columns\), got \(2, 3\)"),
        ({"response": np.ones((3, 2))}, r"response: must have shape .*got \(3, 2\)"),
        ({"mix": np.ones((1, 3))}, r"mix: must have shape .*at least 2 channels and 3 groups.*\(1, 3\)"),
        ({"mix": -MIX}, "mix: must not be negative, the least is -0.6"),
        ({"light": np.full((3, *SHAPE), np.nan)}, "light: must be finite, 7200 of 7200 values are not"),
        ({"offset": np.ones(5)}, r"offset: must broadcast to shape \(40, 60, 3\), got \(5,\)"),
        ({"reflectance": 1.5}, "reflectance: must lie between 0 and 1, got .1.5"),
        ({"full_scale": 0.0}, "full_scale: must be positive, got 0"),
        ({"expected_slope": -1.0}, "expected_slope: must be positive, got -1"),
        ({"model_error": -0.1}, "model_error: must not be negative, the least is -0.1"),
    ],
)
def test_bad_input_is_refused_by_field_and_value(changed, message):
    given = {"light": shading(FLAT, FLAT), "response": response(FLAT, FLAT), "mix": MIX} | changed
    with pytest.raises(ValueError, match=message):
        NearField.of(**given, noise_sigma=even)


def test_a_bad_picture_is_refused():
    known = NearField.of(shading(FLAT, FLAT), response(FLAT, FLAT), MIX, noise_sigma=even)
    with pytest.raises(ValueError, match=r"image: must have shape .*got \(2, 2, 3\)"):
        known.estimate(np.ones((2, 2, 3)))
    with pytest.raises(ValueError, match="mask: must be bool"):
        known.estimate(np.ones((*SHAPE, 3)), mask=np.ones(SHAPE))
    with pytest.raises(ValueError, match="height_mm: must have shape"):
        known.shadowed(np.ones((2, 2)), pitch_mm=(0.1, 0.1))


@pytest.mark.renders
def test_a_ball_is_reconstructed_without_calibration():
    design = preset("gelsight-2020-flat")
    simulator = Simulator(design, columns=160, seed=0)
    untouched = simulator.frame(None)
    press = Press(probe=parse("sphere:4"), depth_mm=0.6, centre_mm=(0.0, 0.0))
    frame = simulator.frame(press, seed=sub_seed(0, 2, 0))
    bench = EvaluationProtocol(design, exposure(design, untouched), 0)
    known = bench.near_field(untouched, simulator.slope_response())
    image = bench.picture(frame, 100)
    pitch_mm = frame.rays.pitch_mm
    first = known.estimate(image)
    second = known.shadowed(first.height_mm(pitch_mm=pitch_mm), pitch_mm=pitch_mm).estimate(image)
    truth = normals(*frame.gradient)
    errors = [np.median(normal_error_deg(normals(e.p, e.q), truth)[frame.contact]) for e in (first, second)]
    height_um = 1000 * np.abs(second.height_mm(pitch_mm=pitch_mm) - frame.height_mm)[frame.contact].mean()
    print(f"median normal error {errors[0]:.2f} and {errors[1]:.2f} deg, height MAE {height_um:.1f} um")
    # Pictures of this design's balls differ from the model by 4 % (root mean square, docs/validation.md);
    # with camera noise, three lights 120 deg apart turn that into this much tilt.
    share = np.hypot(0.04, np.median(known.noise_sigma(known.background) / known.background))
    steepness = np.median(np.linalg.norm(known.response, axis=-1) / known.light)
    bound_deg = np.degrees(share * np.sqrt(4 / 3) / steepness)
    assert bound_deg < 0.2 * np.median(
        normal_error_deg(normals(0 * image[..., 0], 0 * image[..., 0]), truth)[frame.contact]
    )
    assert max(errors) < bound_deg
