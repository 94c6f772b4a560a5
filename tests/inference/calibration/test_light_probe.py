"""Parts of a calibration with a light probe: reflectances between two, weights, which numbers are told."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.inference.calibration.imaging import ALBEDO, KERNEL, SCALE, Rendered
from designlab.inference.calibration.problem import Problem
from designlab.measurement.light_probe.ball import LightProbe
from designlab.measurement.shots import Shot
from designlab.sensor.camera import View
from designlab.sensor.design import preset
from designlab.simulation.contact.press import Press
from geometries.probes import parse

DESIGN = preset("gelsight-2020-flat")
VIEW = View(1000.0, 700.0, 600.0, 600.0, 24, 24)
PRESS = Press(probe=parse("sphere:4"), depth_mm=0.5)


def shot(press: Press | None = None, ball: LightProbe | None = None, side: int = 24) -> Shot:
    shape = (side, side, 3)
    return Shot(
        ("a.exr",), "train", press, np.zeros(4), np.ones(3), VIEW._replace(columns=side, rows=side),
        np.ones(shape), np.full(shape, 1e-12), np.ones(shape, dtype=bool), np.zeros(3), ball,
    )  # fmt: skip


class TestRendered:
    def test_reflectance_is_free_where_a_light_probe_tells_it_and_has_an_entry_for_each_group(self):
        imaging = Rendered(DESIGN, 4)
        assert imaging.usual([shot(PRESS)]) == (KERNEL, SCALE)
        told = imaging.usual([shot(PRESS), shot(ball=LightProbe())])
        assert told == (KERNEL, SCALE, *(f"{ALBEDO}.{group}" for group in range(3)))
        shared = Rendered(DESIGN.replace({ALBEDO: [0.5]}), 4)
        assert ALBEDO not in "".join(shared.usual([shot(PRESS), shot(ball=LightProbe())]))

    def test_light_probes_know_nothing_of_the_gel(self):
        imaging = Rendered(DESIGN, 4)
        for path in (KERNEL, f"{ALBEDO}.0", "elastomer.thickness_mm"):
            assert not imaging.sees(path, shot(ball=LightProbe()))
            assert imaging.sees(path, shot(PRESS))
        assert imaging.sees("leds.height_mm", shot(ball=LightProbe()))
        assert imaging.alone(f"{ALBEDO}.2") == 2
        assert imaging.alone("leds.height_mm") is None

    @pytest.mark.renders
    @pytest.mark.llvm
    def test_a_reflectance_between_two_is_what_simulating_it_gives(self):
        """No further off than two simulations are from each other, whose random numbers differ."""
        albedo = (0.45, 0.44, 0.5)
        wanted = {f"{ALBEDO}.{group}": value for group, value in enumerate(albedo)}
        between = Rendered(DESIGN, 48).basis(wanted, PRESS, VIEW, seed=3)
        straight = Rendered(DESIGN.replace({ALBEDO: list(albedo)}), 48)
        once, again = (straight.basis({}, PRESS, VIEW, seed=seed) for seed in (3, 4))
        for ours, theirs, others in zip(between, once, again, strict=True):
            noise = np.sqrt(((theirs - others) ** 2).mean())
            assert np.sqrt(((ours - theirs) ** 2).mean()) < 1.5 * noise + 0.001 * theirs.mean()
            assert ours.mean() == pytest.approx(theirs.mean(), rel=0.003)


class TestWeights:
    def weighed(self, left: np.ndarray) -> tuple[np.ndarray, int]:
        """Standard deviations over the stated one, of each channel, and the blocks that errors take."""
        sigma = 0.01
        bare = shot(side=left.shape[0])
        own = replace(bare, signal=sigma * left, variance=np.full(left.shape, 1e-12))
        problem = Problem(Rendered(DESIGN, 4), (own,), (), seed=0)
        problem.stated = [np.full(left.shape, sigma)]
        problem.weigh(problem.start(), {0: np.zeros((3, *left.shape[:2]))})
        return problem.sigmas[0].mean(axis=(0, 1)) / sigma, problem.blocks_px[0]

    def test_independent_errors_keep_their_size(self):
        left = np.random.default_rng(0).standard_normal((160, 160, 3))
        found, block_px = self.weighed(left)
        # Of the blocks tried the largest count: 100 of them tell a standard deviation to 7 %.
        np.testing.assert_allclose(found, 1.0, atol=3 * (1 / (2 * 100)) ** 0.5)
        assert (found > 0.98).all()
        assert block_px == 8

    @pytest.mark.parametrize("reach_px", [4, 8, 16])
    def test_errors_that_a_block_shares_count_as_one(self, reach_px):
        blocks = np.random.default_rng(0).standard_normal((160 // reach_px, 160 // reach_px, 3))
        found, block_px = self.weighed(np.kron(blocks, np.ones((reach_px, reach_px, 1))))
        np.testing.assert_allclose(found, reach_px, rtol=3 * (1 / (2 * 100)) ** 0.5)
        assert block_px == max(reach_px, 8)

    def test_standard_deviations_settle(self):
        left = np.random.default_rng(0).standard_normal((32, 32, 3))
        own = replace(shot(side=32), signal=left, variance=np.full(left.shape, 1e-12))
        problem = Problem(Rendered(DESIGN, 4), (own,), (), seed=0)
        nothing = {0: np.zeros((3, 32, 32))}
        assert problem.weigh(problem.start(), nothing) > 1.0
        assert problem.weigh(problem.start(), nothing) == 0.0
