"""Which maps a calibration on balls chooses."""

from designlab.inference.calibration import balls as calibration_of_balls
from designlab.inference.calibration.ball_set import load_balls
from designlab.reconstruction.left_out import LeftOut
from tests.helpers.ball_pictures import QUICK
from tests.reconstruction.test_lab import PITCH_MM, RADIUS_MM, SETUP, THICKNESS_MM


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
