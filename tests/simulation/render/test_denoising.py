"""Chance taken from pictures of light counted in photons, against pictures whose truth is known."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from designlab.simulation.render.denoising import (
    bands,
    by_band,
    coefficients,
    denoised_change,
    fit_denoiser,
)

SHAPE, REPEATS, CHANCE = (60, 80), 8, 0.03
Y, X = np.meshgrid(np.linspace(-1, 1, SHAPE[0]), np.linspace(-1, 1, SHAPE[1]), indexing="ij")
BROAD = np.exp(1.2 * X - 0.7 * Y + 0.4 * X * Y)  # falls by ten over the picture, steep at its borders
BEAM = 0.04 * (np.hypot(X - 0.3, Y) < 0.4)  # a sharp edge


def repeated(light: np.ndarray, seed: int = 1) -> np.ndarray:
    """Pictures with chance of its own each, alike within a pixel or so as splatted photons are."""
    random = np.random.default_rng(seed)
    noise = gaussian_filter(random.standard_normal((REPEATS, *SHAPE)), (0, 0.7, 0.7))
    return (light * (1 + CHANCE * noise / noise.std()))[:, None].astype(np.float32)


def relative_error(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(((found / truth - 1) ** 2).mean()))


def test_smooth_light_is_told_from_chance_up_to_the_border() -> None:
    pictures = repeated(BROAD)
    found = fit_denoiser(pictures).factor[0] * pictures.mean(axis=0)[0]
    plain = relative_error(pictures.mean(axis=0)[0], BROAD)
    assert plain == pytest.approx(CHANCE / np.sqrt(REPEATS), rel=0.05)
    assert relative_error(found, BROAD) < 0.35 * plain
    rim = np.ones(SHAPE, dtype=bool)
    rim[2:-2, 2:-2] = False
    assert relative_error(found[rim], BROAD[rim]) < plain


def test_an_edge_is_kept() -> None:
    light = BROAD * (1 + BEAM)
    pictures = repeated(light)
    found = fit_denoiser(pictures).factor[0] * pictures.mean(axis=0)[0]
    assert relative_error(found, light) < 0.7 * relative_error(pictures.mean(axis=0)[0], light)
    inside, outside = np.hypot(X - 0.3, Y) < 0.35, np.hypot(X - 0.3, Y) > 0.45
    step = (found / BROAD)[inside].mean() - (found / BROAD)[outside].mean()
    assert step == pytest.approx(0.04, rel=0.05)


@pytest.mark.parametrize("beam", [0.0, 1.0])
def test_what_is_left_of_chance_is_as_large_as_said(beam) -> None:
    light = BROAD * (1 + beam * BEAM)
    pictures = repeated(light)
    mean, still = pictures.mean(axis=0), fit_denoiser(pictures)
    left = pictures - mean - mean * still.removed
    said = np.sqrt(((left / mean) ** 2).sum(axis=0).mean() / (REPEATS * (REPEATS - 1)))
    assert said == pytest.approx(relative_error(still.factor[0] * mean[0], light), rel=0.25)


def freed(change: np.ndarray, drawn: np.ndarray, light: np.ndarray) -> np.ndarray:
    pictures = repeated(light)
    spread = pictures - pictures.mean(axis=0)
    return denoised_change(change, drawn, light[None].astype(np.float32), spread)


def test_a_change_is_freed_from_the_chance_of_two_pictures() -> None:
    truth = 0.05 * np.sin(3 * X) * np.cos(2 * Y)
    before, after = repeated(BROAD, 2)[0], repeated(BROAD * (1 + truth), 3)[0]
    found = freed(after - before, before, BROAD)[0] / BROAD
    error = np.sqrt(((found - truth) ** 2).mean())
    assert error < 0.3 * np.sqrt((((after - before)[0] / BROAD - truth) ** 2).mean())
    assert np.corrcoef(found.ravel(), truth.ravel())[0, 1] > 0.9


def test_chance_that_a_change_shares_with_its_picture_cancels() -> None:
    before = repeated(BROAD, 2)[0]
    weakened = -0.1 * (1 + 0.3 * X)
    found = freed((weakened * before).astype(np.float32), before, BROAD)[0] / BROAD
    assert np.sqrt(((found - weakened) ** 2).mean()) < 0.1 * 0.1 * CHANCE + 0.01 * CHANCE / np.sqrt(REPEATS)


@pytest.mark.parametrize("shape", [(6, 8), (24, 32), SHAPE])
def test_no_band_is_empty(shape) -> None:
    assert set(bands(shape).ravel()) == set(range(bands(shape).max() + 1))


def test_dark_places_stay_finite() -> None:
    light = BROAD * (X < 0.6)  # beyond is no membrane
    pictures = repeated(light)
    found = fit_denoiser(pictures)
    assert np.isfinite(found.factor).all()
    assert np.isfinite(found.removed).all()
    mean = pictures.mean(axis=0)
    assert np.isfinite(denoised_change(mean, mean, found.factor * mean, pictures - mean)).all()


def test_bands_share_out_all_coefficients() -> None:
    squares = coefficients(np.random.default_rng(0).standard_normal(SHAPE)) ** 2
    band = bands(SHAPE)
    assert by_band(squares)[band].sum() == pytest.approx(squares.sum())
    np.testing.assert_allclose(by_band(squares)[4:12], 1.0, atol=0.25)


def test_a_change_keeps_the_contact_that_the_light_has() -> None:
    contact = 1 + 0.6 * X * (np.hypot(X + 0.2, Y - 0.1) < 0.3)
    before = repeated(BROAD * contact, 2)[0]
    weakened = -0.1 * (1 + 0.3 * X)
    found = freed((weakened * before).astype(np.float32), before, BROAD * contact)[0] / (BROAD * contact)
    assert np.sqrt(((found - weakened) ** 2).mean()) < 0.2 * CHANCE * 0.1
