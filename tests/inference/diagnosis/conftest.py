"""Fixtures that files of these tests share."""

import os

import pytest

from designlab.simulation.render_cache import Renders
from tests.helpers.small_sensor import SAMPLES, SEED


@pytest.fixture(scope="session")
def renders(tmp_path_factory: pytest.TempPathFactory) -> Renders:
    """Pictures of the small made sensor, rendered once for all files and test processes of a run."""
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    return Renders(folder / "renders-of-the-small-sensor", SAMPLES, SEED)
