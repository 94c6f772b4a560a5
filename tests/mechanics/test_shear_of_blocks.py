"""Shear found from markers, against finite elements in three dimensions, and these against closed forms."""

import numpy as np
import pytest
from finite_blocks import Block, LoadedBlock
from shear_from_blocks import found_in, gap_of, pressed

from designlab.validation.synthetic.elastic_contact import ElasticBase, press_flat_punch

pytestmark = pytest.mark.physics


@pytest.fixture(scope="module")
def small_block():
    return LoadedBlock(Block(1.5, 13.0, 11.0, 0.49), centre_mm=(0.5, 0.0), reach_mm=1.5, fine_mm=0.375)


@pytest.mark.parametrize("poisson", [0.3, 0.49, 0.4999])
@pytest.mark.parametrize("direction", [0, 1])
def test_a_top_that_is_moved_as_a_whole_is_sheared_simply(poisson, direction):
    """A thin block between two plates: force is shear modulus times area times strain, less at the sides."""
    block = Block(1.0, 20.0, 16.0, poisson)
    loaded = LoadedBlock(block, centre_mm=(0.0, 0.0), reach_mm=30.0, fine_mm=4.0)
    size = 3 * len(loaded.near)
    wanted = np.zeros((len(loaded.near), 3))
    wanted[:, direction] = 0.1
    force = np.linalg.solve(loaded.response[loaded.near].reshape(size, size), wanted.ravel()).reshape(-1, 3)
    simple = 20.0 * 16.0 * 0.1 / (2 * (1 + poisson))
    assert 0.95 * simple < force.sum(axis=0)[direction] < simple


@pytest.mark.slow
def test_small_disc_on_a_thick_block_is_that_of_a_half_space():
    """A disc of 1 mm on 6 mm of gel, by Mindlin (1949) and exact contact."""
    block = Block(6.0, 24.0, 24.0, 0.4999)
    loaded = LoadedBlock(block, centre_mm=(0.0, 0.0), reach_mm=1.2, fine_mm=0.4)
    gap = gap_of("disc", 1.0, loaded.places_mm, 0.0)
    # five nodes from the middle of the disc to its edge
    base = ElasticBase(1.0, block.poisson, block.thickness_mm)
    exact = press_flat_punch(base, punch_radius_mm=1.0, depth_mm=0.1).force_n
    assert loaded.drag(gap, 0.1, (1.0, 0.0), friction=0.0).force_n[2] == pytest.approx(exact, rel=0.1)
    half_space = 8 * 1.0 * 0.01 / (2 - block.poisson) / (2 * (1 + block.poisson))
    assert loaded.drag(gap, 0.1, (0.01, 0.0)).force_n[0] == pytest.approx(half_space, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("probe", "size_mm", "depth_mm", "shear_mm", "friction"),
    [
        ("ball", 3.0, 0.4, (0.15, 0.1), None),
        ("disc", 0.9, 0.25, (-0.05, 0.1), None),
        ("ball", 2.0, 0.4, (0.0, -0.2), 0.5),
    ],
)
def test_shear_by_finite_elements_is_found(small_block, probe, size_mm, depth_mm, shear_mm, friction):
    random = np.random.default_rng(2)
    press = pressed(small_block, probe, size_mm, depth_mm, shear_mm, friction, random, covered=False)
    off = np.array(found_in(press, random).force_n(1.0)) - press.shear_n
    assert np.hypot(*off) < 0.15 * np.hypot(*press.shear_n)


@pytest.mark.faults
@pytest.mark.parametrize("shear_mm", [(0.0, 0.0), (0.1, 0.0), (-0.1, 0.2)])
def test_a_probe_that_does_not_touch_loads_nothing(shear_mm):
    loaded = LoadedBlock(Block(1.0, 6.0, 6.0), centre_mm=(0.0, 0.0), reach_mm=1.0, fine_mm=1.0)
    gap = np.full(len(loaded.near), 0.1)
    assert not loaded.drag(gap, 0.1, shear_mm).force_n.any()
