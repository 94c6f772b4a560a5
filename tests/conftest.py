"""Fixtures shared by all tests."""

import os
from collections.abc import Generator, Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from threadpoolctl import threadpool_limits

from designlab.core.backend import Backend, activate, choose, usable_cores
from designlab.core.workers import keep_to_share
from tests.helpers.processes import Processes

# examples render and solve, so their time says nothing; the same ones are drawn at every run
settings.register_profile("designlab", deadline=None, derandomize=True)
settings.load_profile("designlab")

MEASURED_VARIABLE = "DESIGNLAB_MEASURED"
CALLS_BEFORE = pytest.StashKey[int]()
NO_MEASURED = f"{MEASURED_VARIABLE} does not name a folder of real images"


def pytest_configure(config: pytest.Config) -> None:
    """Give each of several test processes its share of the cores: their threads get in each other's way."""
    if worker := getattr(config, "workerinput", None):
        keep_to_share(int(worker["workerid"].removeprefix("gw")), worker["workercount"])
        threadpool_limits(usable_cores())


def calls_of_the_renderer() -> int:
    """How often this process has asked for the renderer: `activate` is the only door to Mitsuba."""
    return sum(activate.cache_info()[:2])


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip what this machine cannot run, with the reason."""
    item.stash[CALLS_BEFORE] = calls_of_the_renderer()
    if item.get_closest_marker("llvm") and not choose().is_jit:
        pytest.skip(f"needs a just-in-time back end: {choose().reason}")
    if item.get_closest_marker("measured") and not os.environ.get(MEASURED_VARIABLE):
        pytest.skip(NO_MEASURED)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None, None, None]:
    """Fail a test that renders and is not marked so: `make check` leaves those out by their marker."""
    yield
    if not item.get_closest_marker("renders") and calls_of_the_renderer() > item.stash[CALLS_BEFORE]:
        pytest.fail("renders: mark it with pytest.mark.renders")


@pytest.fixture(scope="session")
def measured_dir() -> Path:
    """Folder of real images; where the variable is set, the folder must exist."""
    named = os.environ.get(MEASURED_VARIABLE)
    if not named:
        pytest.skip(NO_MEASURED)
    folder = Path(named)
    assert folder.is_dir(), f"{MEASURED_VARIABLE} = {named} is not a folder"
    return folder


@pytest.fixture(scope="session")
def backend() -> Backend:
    """The back end, with Mitsuba loaded and its variant set."""
    return activate()


@pytest.fixture
def processes(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Processes]:
    """Processes of the test module's PROGRAM, which may be killed; all are at the end."""
    program = tmp_path / "program.py"
    program.write_text(request.module.PROGRAM)
    found = Processes(program)
    yield found
    for process in found.started:
        process.kill()
        process.communicate()


@pytest.fixture(scope="session")
def ball_folder(tmp_path_factory):
    """Pictures of made balls, and of the untouched gel."""
    from designlab.core.images import write_image
    from tests.helpers.ball_pictures import UNTOUCHED, exposed
    from tests.reconstruction.test_lab import BALLS

    out = tmp_path_factory.mktemp("balls")
    write_image(out / "background.exr", UNTOUCHED)
    for number, ball in enumerate(BALLS):
        write_image(out / f"ball-{number}.exr", exposed(ball.image))
    return out


@pytest.fixture(scope="session")
def ball_calibration(ball_folder):
    """One calibration on them, for all tests of what is done with it."""
    from designlab.inference.calibration.ball_set import load_balls
    from designlab.inference.calibration.balls import calibrate_balls
    from tests.helpers.ball_pictures import QUICK
    from tests.reconstruction.test_lab import PITCH_MM, RADIUS_MM, THICKNESS_MM

    balls = load_balls(ball_folder, ball_mm=2 * RADIUS_MM, mm_per_px=PITCH_MM)
    return calibrate_balls(balls, thickness_mm=THICKNESS_MM, method=QUICK)


@pytest.fixture(scope="session")
def calibration_file(ball_calibration, tmp_path_factory):
    """Its file."""
    from designlab.reconstruction.calibration_file import save_calibration

    return save_calibration(tmp_path_factory.mktemp("calibration") / "calibration.npz", ball_calibration.kept)
