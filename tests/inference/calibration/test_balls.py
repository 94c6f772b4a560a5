"""Which maps a calibration on balls chooses, and what printed markers do to it."""

from dataclasses import replace

import numpy as np
import pytest

from designlab.core.images import write_image
from designlab.core.metrics import normal_error_deg
from designlab.inference.calibration import balls as calibration_of_balls
from designlab.inference.calibration.ball_set import load_balls
from designlab.reconstruction.calibration_file import save_calibration
from designlab.reconstruction.height import normals
from designlab.reconstruction.lab import calibrate
from designlab.reconstruction.left_out import LeftOut
from designlab.reconstruction.reconstructor import Reconstructor
from tests.helpers.ball_pictures import QUICK, UNTOUCHED, exposed
from tests.reconstruction.test_lab import (
    BACKGROUND,
    BALLS,
    COLUMNS,
    PITCH_MM,
    RADIUS_MM,
    ROWS,
    SETUP,
    THICKNESS_MM,
    picture,
    slopes,
)


def test_balls_left_out_choose_whether_rims_have_a_map_of_their_own(ball_folder, monkeypatch):
    balls = load_balls(ball_folder, ball_mm=2 * RADIUS_MM, mm_per_px=PITCH_MM)
    given = [LeftOut(1.0, 2.0, 0.01)] * len(balls.balls)
    for name, value in (
        ("refine_centres", balls.balls),
        ("known_gel", (balls.balls, SETUP._replace(detail=0.5), None)),
    ):
        monkeypatch.setattr(calibration_of_balls, name, lambda *_, value=value, **__: value)
    monkeypatch.setattr(calibration_of_balls, "smoothing_by", lambda *_: 2.0)
    monkeypatch.setattr(calibration_of_balls, "suited", lambda *a, **_: (a[2], QUICK))
    for best in (0.0, 0.5):
        tried = []

        def left_out_of_each(_balls, _background, setup, *, best=best, tried=tried, **_):
            tried.append(setup.detail)
            return [error._replace(contact_deg=1.0 + abs(setup.detail - best)) for error in given]

        monkeypatch.setattr(calibration_of_balls, "left_out_of_each", left_out_of_each)
        found = calibration_of_balls.calibrate_balls(balls, thickness_mm=THICKNESS_MM)
        assert set(tried) == {0.0, 0.5}
        assert found.kept.calibration.setup.detail == best


def dotted(image):
    """With dark dots of 7 px, 20 px apart."""
    away = np.hypot(COLUMNS % 20 - 10, ROWS % 20 - 10)
    return image * (1 - 0.9 * np.clip(4.0 - away, 0, 1))[..., None]


@pytest.mark.slow
def test_balls_and_presses_with_printed_dots_become_shapes(tmp_path):
    write_image(tmp_path / "background.exr", dotted(UNTOUCHED))
    for number, ball in enumerate(BALLS):
        write_image(tmp_path / f"ball-{number}.exr", dotted(exposed(ball.image)))
    balls = load_balls(tmp_path, ball_mm=2 * RADIUS_MM, mm_per_px=PITCH_MM)
    assert balls.markers is not None
    # 42 dots and two pixels around each
    assert all(0.1 < ball.covered.mean() < 0.35 for ball in balls.balls)
    found = calibration_of_balls.calibrate_balls(balls, thickness_mm=THICKNESS_MM, method=QUICK)
    assert found.mean.contact_deg < 2.0
    p, q, r_px = slopes((64, 52), 13.0)
    inside = r_px < 13.0
    for mode in ("accurate", "video"):
        reconstructor = Reconstructor.load(save_calibration(tmp_path / "made.npz", found.kept), mode=mode)
        shape = reconstructor(dotted(exposed(picture(p, q))))
        assert normal_error_deg(shape.normals, normals(p, q))[inside].mean() < 4.0, mode


def test_a_ball_under_markers_alone_is_refused_by_name():
    hidden = replace(BALLS[4], covered=np.ones(BACKGROUND.shape[:2], dtype=bool))
    with pytest.raises(ValueError, match=r"balls\[4\].centre_px: printed markers cover the whole contact"):
        calibrate([*BALLS[:4], hidden, *BALLS[5:]], BACKGROUND, SETUP)
