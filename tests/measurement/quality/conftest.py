"""Fixtures that files of these tests share."""

import functools

import pytest

from designlab.validation.synthetic.effects import draw
from designlab.validation.synthetic.generator_sensor import Rig
from tests.helpers.spoilt_sets import DESIGN, PRESSES, planted

LIFTED = {"R": -0.006, "G": -0.009, "B": 0.011}


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """A set without a fault and without a hidden effect."""
    return planted(tmp_path_factory.mktemp("whole") / "m")


@pytest.fixture(scope="session")
def hour(tmp_path_factory):
    """Sets with exposures, repeats and a turned gel that hide an effect of three usual sizes."""

    @functools.cache
    def make(effect):
        values = LIFTED if effect == "black_level" else draw(effect, Rig.of(DESIGN), strength=3.0, seed=1)
        return planted(
            tmp_path_factory.mktemp(effect) / "m", {effect: values}, kit="hour", presses=PRESSES[:1]
        )

    return make
