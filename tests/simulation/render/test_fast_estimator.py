"""The fast estimator against Mitsuba's path tracer on random sensors in air, where that has little noise."""

import numpy as np
import pytest
from random_designs import random_design

from designlab.sensor.contact import KernelContact
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Simulator
from geometries.probes import parse

pytestmark = [pytest.mark.physics, pytest.mark.usefixtures("backend"), pytest.mark.llvm, pytest.mark.renders]
BLOCK = 4


def blocks(images):
    groups, rows, columns = images.shape
    cut = images[:, : rows // BLOCK * BLOCK, : columns // BLOCK * BLOCK].astype(float)
    return cut.reshape(groups, rows // BLOCK, BLOCK, columns // BLOCK, BLOCK).mean(axis=(2, 4))


def difference(design, press):
    """Relative to the mean of each group; its noise, from the path tracer's two runs; and their mean."""
    fast = Simulator(design, columns=48, samples=16, seed=1)
    paths = Simulator(design, columns=48, samples=256, seed=1, estimator="path")
    first, second = (paths.frame(press, seed=seed).basis for seed in (1, 2))
    truth = blocks((first + second) / 2)
    mean = truth.mean(axis=(1, 2), keepdims=True)
    return (blocks(fast.frame(press).basis) - truth) / mean, np.std(blocks(first - second) / mean) / 2, truth


def test_a_dome_does_not_shadow_itself():
    # The mesh of a dome lies above its curve: LEDs 10 mm from the axis light all of it all the same.
    design = random_design(7)
    assert design.elastomer.shape == "dome"
    assert design.optics.light_path == "air"
    error, noise, _ = difference(design, None)
    assert noise < 0.005
    assert np.abs(error.mean(axis=(1, 2))).max() < 0.01
    assert np.abs(error).max() < 0.05 + 4 * noise


def test_grazing_light_casts_long_shadows():
    # A panel 2.3 mm above the gel: 0.8 mm high walls cast shadows of up to 9 mm.
    design = random_design(5)
    assert design.leds.height_mm < 2.5
    press = Press(probe=parse("star:6"), depth_mm=0.8, centre_mm=(-3.0, 0.0))
    error, noise, truth = difference(design, press)
    untouched = Simulator(design, columns=48, samples=16, seed=1).frame(None).basis
    shadow = truth[0] < 0.7 * blocks(untouched)[0]
    assert shadow.sum() >= 10
    assert np.abs(error[0][shadow]).max() < 0.05 + 4 * noise


def test_a_wall_is_lit_by_the_bright_gel_far_in_front_of_it():
    # The gel beneath the same panel, beyond the picture, lights the wall that faces it from more than 5 mm.
    design = random_design(5).replace({"optics.path_length": 3, "contact": KernelContact()})
    press = Press(probe=parse("cylinder:4"), depth_mm=0.6, centre_mm=(0.0, 2.0))
    error, noise, truth = difference(design, press)
    direct = Simulator(design.replace({"optics.path_length": 2}), columns=48, samples=16, seed=1).frame(press)
    bounced = (truth - blocks(direct.basis)) / truth.mean(axis=(1, 2), keepdims=True)
    wall = bounced[0] > 0.1
    assert wall.sum() >= 3
    assert abs(error[0][wall].mean()) < 0.02 + 4 * noise / np.sqrt(wall.sum())
