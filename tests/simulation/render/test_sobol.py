"""Sobol' points against SciPy's, and against what makes them even."""

import numpy as np
import pytest
from scipy.stats import qmc

from designlab.simulation.render import sobol

pytestmark = [pytest.mark.physics, pytest.mark.llvm, pytest.mark.usefixtures("backend"), pytest.mark.renders]


def drawn(count, *, seed, first=0):
    seeds = np.random.default_rng(seed).integers(0, 2**32, size=sobol.DIMENSIONS)
    return np.array([np.asarray(c) for c in sobol.points(first, count, seeds)]).T


def test_direction_numbers_are_joe_and_kuos():
    # SciPy draws in Gray code order: its first 2**12 points are ours in another order
    count = 2**12
    index = np.arange(count, dtype=np.uint32)
    found = np.zeros((count, sobol.DIMENSIONS), dtype=np.uint32)
    for bit in range(12):
        found ^= np.where((index[:, None] >> bit) & 1, sobol.directions()[:, bit], np.uint32(0))
    expected = qmc.Sobol(sobol.DIMENSIONS, scramble=False, bits=32).random(count)
    order, other = np.lexsort(found.T / 2.0**32), np.lexsort(expected.T)
    np.testing.assert_array_equal(found[order] / 2.0**32, expected[other])


@pytest.mark.parametrize("seed", [1, 2])
def test_scrambled_points_fill_every_strip_alike(seed):
    # Owen's scrambling keeps each coordinate stratified: one of 2**14 points in each of as many strips
    points = drawn(2**14, seed=seed)
    assert (points >= 0).all()
    assert (points < 1).all()
    for coordinate in points.T:
        assert (np.bincount((coordinate * 2**14).astype(int), minlength=2**14) == 1).all()
    # the first two dimensions are a (0, 2)-sequence: 128 x 128 cells hold one point each
    cells = (points[:, 0] * 128).astype(int) * 128 + (points[:, 1] * 128).astype(int)
    assert (np.bincount(cells, minlength=2**14) == 1).all()


def test_seeds_shift_the_points_at_random():
    # the mean of 64 scrambled integrals of a product is as close as independent scrambles make it
    errors = np.array([np.prod(2 * drawn(1024, seed=s), axis=1).mean() - 1 for s in range(64)])
    independent = np.sqrt(((4 / 3) ** sobol.DIMENSIONS - 1) / 1024)
    assert np.abs(errors).max() < independent
    assert abs(errors.mean()) < 4 * errors.std(ddof=1) / 8


def test_later_points_continue_the_sequence():
    np.testing.assert_array_equal(drawn(300, seed=3)[100:], drawn(200, seed=3, first=100))
