"""Noise told from the difference of two renders."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from designlab.evaluation import protocol
from designlab.evaluation.illumination_scores import uniformity, worst_evenness
from designlab.evaluation.response_maps import sensing_area
from designlab.reconstruction.kernel import GradientEstimate
from designlab.reconstruction.pictures import NOISE_LEFT
from designlab.sensor.design import preset

FLAT, CORE = preset("gelsight-2020-flat"), preset("default")


def frames(random, *, sigma, correlation_px, shape=(3, 90, 120)):
    """Two renders of an uneven light with noise of known size, smooth over some pixels."""
    x, y = np.meshgrid(np.linspace(-8, 8, shape[2]), np.linspace(6, -6, shape[1]))
    light = 1.0 + 0.4 * np.sin(0.2 * x)[None] * np.array([0.5, 1.0, 0.8])[:, None, None] + 0.02 * y

    def noise():
        white = random.standard_normal(shape)
        if correlation_px:
            white = gaussian_filter(white, (0, correlation_px, correlation_px))
            white /= white.std()
        return sigma * white

    rays = SimpleNamespace(x_mm=x, y_mm=y, pitch_mm=(16 / 119, 12 / 89))
    grain_mm = 1.0 if correlation_px else 0.0
    return [SimpleNamespace(basis=light * (1 + noise()), rays=rays, grain_mm=grain_mm) for _ in range(2)]


@pytest.mark.slow
@pytest.mark.parametrize(("design", "sigma", "correlation_px"), [(FLAT, 0.1, 0.0), (CORE, 0.03, 4.0)])
def test_evenness_is_unbiased_and_scatters_as_stated(design, sigma, correlation_px):
    random = np.random.default_rng(8)
    values, stated = [], []
    for number in range(30):
        a, b = frames(random, sigma=sigma, correlation_px=correlation_px)
        found = uniformity(design, a, b, seed=number)
        values.append([found[name].value for name in ("uniformity_u0", "uniformity_cv")])
        stated.append([found[name].se for name in ("uniformity_u0", "uniformity_cv")])
    scatter = np.std(values, axis=0, ddof=1)
    # the scatter of 30 values is itself known to 13 % (one standard deviation)
    ratio = np.mean(stated, axis=0) / scatter
    assert (ratio > 0.65).all()
    assert (ratio < 1.5).all()
    clean = frames(random, sigma=0.0, correlation_px=0.0)[0]
    truth = worst_evenness(clean.basis, sensing_area(design, clean))
    deviation = (np.mean(values, axis=0) - truth) / (scatter / np.sqrt(len(values)))
    assert (np.abs(deviation) < 4).all(), deviation


def test_a_bulge_at_the_border_is_no_error_of_height_and_counts_as_moved():
    x, y = np.meshgrid(np.linspace(-4, 4, 81), np.linspace(3, -3, 61))
    height = 0.5 * np.exp(-(x**2 + y**2) / 0.5) - 0.03
    q, p = np.gradient(height, -0.1, 0.1)
    for bulge, lowered in ((True, height), (False, height + 0.03)):
        surface = SimpleNamespace(height_mm=lowered, bulges=bulge)
        frame = SimpleNamespace(height_mm=lowered, surface=surface, rays=SimpleNamespace(pitch_mm=(0.1, 0.1)))
        found = protocol._height_mm(GradientEstimate(p, q, np.ones_like(p)), frame)
        assert np.abs(found - lowered).max() < 0.01
        moved = protocol.Reconstruction(frame, *[None] * 6).moved
        assert moved[0, 0] == bulge
        assert moved[30, 40]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("full_well_e", "smoothed_px"), [(800_000, (0.0, 0.0)), (60_000, (0.71, 1.99)), (500, (2.0, 2.0))]
)
def test_pictures_are_smoothed_where_noise_of_the_camera_demands_it(full_well_e, smoothed_px):
    rows, columns = np.indices((60, 80))
    x, y = (columns - 39.5) * 0.1, (29.5 - rows) * 0.1
    rays = SimpleNamespace(x_mm=x, y_mm=y, binned=1.0)
    design = FLAT.replace({"camera.full_well_e": full_well_e, "camera.read_noise_e": 0.0})
    taken = protocol.EvaluationProtocol(design, 1.0, seed=3)
    toward = np.array([[0.7, -0.4, -0.3], [0.0, 0.6, -0.6]])

    def frame(at):
        apart = np.stack([x - at[0], y - at[1]])
        inside = np.hypot(*apart) < 1.2
        slopes = np.where(inside, -apart / 3.0, 0.0)
        light = 0.4 * (1.0 - np.einsum("kij,kc->ijc", slopes, toward))
        return SimpleNamespace(mixed=light, rays=rays, gradient=tuple(slopes), contact=inside)

    untouched = SimpleNamespace(mixed=np.full((60, 80, 3), 0.4), rays=rays)
    balls = [frame((a, b)) for a in (-1.5, 1.5) for b in (-1.0, 1.0)]
    found = taken.calibrate(untouched, untouched, balls).smoothing_px
    low, high = smoothed_px
    assert low <= found <= high
    # Poisson noise of the light, as a share of the change of colour on slopes of at most 0.4
    change = 1.0 - frame((0.0, 0.0)).mixed[frame((0.0, 0.0)).contact] / 0.4
    share = np.sqrt(0.4 / full_well_e) / 0.4 / np.sqrt((change**2).mean(axis=0))
    needed = np.sqrt((share**2).mean()) / (2 * np.sqrt(np.pi) * NOISE_LEFT)
    assert found == pytest.approx(0.0 if needed < 0.7 else min(needed, 2.0), rel=0.1)
