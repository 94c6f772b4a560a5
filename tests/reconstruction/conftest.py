"""One calibration on made balls, for all tests of what is done with it."""

import pytest

from designlab.core.images import write_image
from designlab.inference.calibration.balls import calibrate_balls, load_balls
from designlab.reconstruction.calibration_file import save_calibration
from tests.helpers.ball_pictures import QUICK, UNTOUCHED, exposed
from tests.reconstruction.test_lab import BALLS, PITCH_MM, RADIUS_MM, THICKNESS_MM


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("balls")
    write_image(out / "background.exr", UNTOUCHED)
    for number, ball in enumerate(BALLS):
        write_image(out / f"ball-{number}.exr", exposed(ball.image))
    return out


@pytest.fixture(scope="session")
def found(folder):
    balls = load_balls(folder, ball_mm=2 * RADIUS_MM, mm_per_px=PITCH_MM)
    return calibrate_balls(balls, thickness_mm=THICKNESS_MM, method=QUICK)


@pytest.fixture(scope="session")
def file(found, tmp_path_factory):
    return save_calibration(tmp_path_factory.mktemp("calibration") / "calibration.npz", found.kept)
