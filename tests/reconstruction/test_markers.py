"""Printed markers in made pictures: found, followed, filled in; plain gels have none."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from designlab.reconstruction.markers import Markers, without

ROWS, COLUMNS = 180, 240


def light():
    """Uneven light of three colours."""
    rows, columns = np.indices((ROWS, COLUMNS)) / COLUMNS
    return np.stack([0.3 + 0.3 * columns, 0.6 - 0.3 * columns, 0.4 + 0.3 * rows], axis=-1)


def dotted(centres, radius_px=4.0, left=0.1):
    rows, columns = np.indices((ROWS, COLUMNS))
    dark = np.zeros((ROWS, COLUMNS))
    for column, row in centres:
        distance = np.hypot(columns - column, rows - row)
        dark = np.maximum(dark, np.clip(radius_px + 0.5 - distance, 0, 1))
    return light() * (1 - (1 - left) * dark)[..., None]


def grid(spacing, jitter=0.0, seed=0):
    along = (
        np.arange(spacing, COLUMNS - spacing / 2, spacing),
        np.arange(spacing, ROWS - spacing / 2, spacing),
    )
    centres = np.stack(np.meshgrid(*along), axis=-1).reshape(-1, 2).astype(float)
    return centres + np.random.default_rng(seed).normal(0, jitter, centres.shape)


@pytest.mark.parametrize(
    ("spacing", "radius", "left", "noise"), [(24, 4.0, 0.1, 0.0), (40, 6.0, 0.4, 0.01), (18, 3.0, 0.2, 0.02)]
)
def test_markers_are_found_and_followed(spacing, radius, left, noise):
    random = np.random.default_rng(2)
    before = grid(spacing, jitter=0.5)
    shift = 0.15 * spacing * np.stack([np.cos(before[:, 1] / 40), np.sin(before[:, 0] / 50)], axis=1)
    untouched, press = dotted(before, radius, left), dotted(before + shift, radius, left)
    markers = Markers.found_in(untouched + random.normal(0, noise, untouched.shape))
    assert markers is not None
    assert len(markers.places_px) == len(before)
    moved = markers.followed(press + random.normal(0, noise, press.shape))
    assert len(moved.places_px) >= 0.95 * len(before)
    nearest = np.array([np.hypot(*(before - place).T).argmin() for place in moved.places_px])
    assert np.sqrt(np.mean((moved.moved_px - shift[nearest]) ** 2)) < 0.15


@pytest.mark.parametrize("kind", ["plain", "noisy", "one dark spot", "stripes", "few dots"])
def test_a_gel_without_markers_has_none(kind):
    random = np.random.default_rng(3)
    picture = {
        "plain": light(),
        "noisy": light() + gaussian_filter(random.normal(0, 0.05, (ROWS, COLUMNS, 3)), (1, 1, 0)),
        "one dark spot": dotted([(100, 80)], 12),
        "stripes": light() * (1 - 0.6 * (np.arange(COLUMNS) % 20 < 6))[None, :, None],
        "few dots": dotted(grid(24)[:6]),
    }[kind]
    assert Markers.found_in(picture) is None


@pytest.mark.parametrize(("spacing", "radius"), [(24, 4.0), (40, 7.0), (18, 3.0)])
def test_a_filled_picture_looks_like_the_gel(spacing, radius):
    picture = dotted(grid(spacing), radius)
    markers = Markers.found_in(picture)
    filled = without(picture, markers.covered)
    assert np.abs(filled / light() - 1).max() < 0.03
    assert (filled[~markers.covered] == picture[~markers.covered]).all()


def test_markers_survive_a_file():
    markers = Markers.found_in(dotted(grid(24)))
    again = Markers.from_plain(markers.plain(), (ROWS, COLUMNS, 3))
    assert (again.covered == markers.covered).all()
    assert again.places_px == pytest.approx(markers.places_px, abs=1e-3)


@pytest.mark.parametrize(("spacing", "radius"), [(24, 5.0), (40, 7.0), (30, 6.0)])
def test_markers_on_cells_are_those_of_the_pixels(spacing, radius):
    """Mode video looks for them on cells of 2 x 2 pixels."""
    before = grid(spacing, jitter=0.5)
    shift = 0.1 * spacing * np.stack([np.cos(before[:, 1] / 40), np.sin(before[:, 0] / 50)], axis=1)
    markers = Markers.found_in(dotted(before, radius))
    press = dotted(before + shift, radius).astype(np.float32)
    fine, coarse = markers.followed(press), markers.followed(press, cell_px=2)
    assert coarse.covered.shape == (ROWS // 2, COLUMNS // 2)
    assert coarse.places_px == pytest.approx(fine.places_px)
    assert np.abs(coarse.moved_px - fine.moved_px).max() < 0.2
    of_pixels = coarse.covered.repeat(2, axis=0).repeat(2, axis=1)
    dark = (press < 0.7 * light()).all(axis=-1)
    assert of_pixels[dark].all()
    assert of_pixels.mean() < 1.6 * fine.covered.mean()


def test_small_dots_are_looked_for_on_pixels():
    before = grid(16)
    markers = Markers.found_in(dotted(before, 2.0))
    moved = markers.followed(dotted(before + np.array([1.5, 0.0]), 2.0), cell_px=2)
    assert len(moved.places_px) > 0.9 * len(before)
    assert moved.moved_px == pytest.approx(np.tile([1.5, 0.0], (len(moved.places_px), 1)), abs=0.3)
