"""Pictures of the studio: coarse ones first, and what is linear only mixed again."""

import io

import numpy as np
import pytest
from PIL import Image

from designlab.app.studio import pictures
from designlab.app.studio.messages import Picture, PictureJob, Relief, Rest
from designlab.app.studio.newest import Superseded
from designlab.app.studio.pictures import Bench, steps
from designlab.app.studio.session import Session
from designlab.sensor.design import preset
from designlab.simulation.render.session import SESSION
from designlab.simulation.simulator import Simulator, exposure

pytestmark = [pytest.mark.renders, pytest.mark.slow, pytest.mark.llvm]
NAME = "gelsight-2020-flat"


@pytest.fixture(scope="module")
def bench():
    before = SESSION.least_written
    found = Bench()
    found.effort = found.effort._replace(samples=(2, 8))  # quick ones
    yield found
    SESSION.least_written = before


def shown(bench, session, press="its own"):
    job = PictureJob(session.design, session.press if press == "its own" else press)
    return list(steps(bench, job))


def pixels(picture):
    return np.asarray(Image.open(io.BytesIO(picture.file)), dtype=float)


def test_pictures_become_finer_and_less_grainy_and_a_press_is_read(bench):
    session = Session(NAME, preset(NAME))
    found = [step for step in shown(bench, session) if not isinstance(step, Rest)]
    kinds = [type(step) for step in found]
    assert kinds == [Picture, Picture, Relief, Picture, Relief]
    coarse, first, _, last, relief = found
    assert coarse.step.startswith("coarse")
    assert pixels(coarse).shape[1] < pixels(first).shape[1]
    assert last.grain < first.grain
    assert last.pressed
    assert relief.high_mm == pytest.approx(session.press.depth_mm, rel=0.1)
    # The first picture of a press that is moved is near the full one.
    session.move_press(centre_mm=(1.0, -1.0))
    coarse, _, full, *_ = shown(bench, session)
    small = np.asarray(Image.open(io.BytesIO(full.file)).resize(pixels(coarse).shape[1::-1]), dtype=float)
    assert np.sqrt(np.mean((small - pixels(coarse)) ** 2)) < 0.03 * small.mean()


@pytest.mark.parametrize(
    ("path", "value"),
    [("leds.groups.0.flux_mw", 0.5), ("leds.groups.2.drive", 0.5), ("camera.bit_depth", 4)],
)
def test_what_is_only_mixed_is_not_rendered_again(bench, monkeypatch, path, value):
    session = Session(NAME, preset(NAME))
    before = next(step for step in reversed(shown(bench, session)) if isinstance(step, Picture))
    monkeypatch.setattr(Simulator, "frame", lambda *_, **__: pytest.fail("rendered"))
    session.change(path, value)
    first = next(steps(bench, PictureJob(session.design, session.press)))
    assert first.step == "full light"
    assert (pixels(first) != pixels(before)).any()


@pytest.mark.parametrize(
    ("path", "value"), [("leds.groups.0.flux_mw", 40.0), ("camera.gain_db", 6.0), ("camera.exposure", 0.7)]
)
def test_the_exposure_of_what_is_mixed_again_is_the_camera_s_own(bench, monkeypatch, path, value):
    session = Session("default", preset("default"))  # whose exposure is automatic
    shown(bench, session)
    monkeypatch.setattr(pictures, "gaussian_filter", lambda *_, **__: pytest.fail("smoothed again"))
    before = bench.protocol(session.design, bench.effort.full, 8).exposure
    session.change(path, value)
    untouched = bench.frame(session.design, bench.effort.full, 8, None)
    found = bench.protocol(session.design, bench.effort.full, 8).exposure
    assert found == pytest.approx(exposure(session.design, untouched), rel=1e-6)
    assert path == "camera.gain_db" or found != pytest.approx(before, rel=1e-3)


def test_better_light_is_given_up_for_what_comes_first_and_made_later(bench):
    session = Session("mine", preset("default").replace({"leds.height_mm": 6.5}))
    job, asked = PictureJob(session.design, session.press), []

    def waits():
        asked.append(True)
        return len(asked) > 6  # the relief asks four times; in the midst of the light that is baked better

    coming = steps(bench, job, waits)
    first = [step for step in (next(coming) for _ in range(4)) if isinstance(step, Picture)]
    assert [step.step for step in first] == ["coarse, light 1 of 2", "light 1 of 2"]
    assert asked == []  # first pictures are made whatever comes
    assert isinstance(next(coming), Relief)
    with pytest.raises(Superseded):
        list(coming)
    assert len(asked) == 7
    again = [step.step for step in steps(bench, job) if isinstance(step, Picture)]
    assert again == ["light 1 of 2", "full light"]
    assert SESSION.between() is None


def test_a_relief_is_given_up_for_what_comes_first(bench):
    session = Session(NAME, preset(NAME))
    shown(bench, session)
    session.move_press(centre_mm=(0.7, -0.3))
    coming = steps(bench, PictureJob(session.design, session.press), lambda: True)
    found = [next(coming) for _ in range(4)]
    assert [type(step) for step in found] == [Picture, Rest, Picture, Rest]
    assert found[2].step == "full light"
    with pytest.raises(Superseded):
        next(coming)


@pytest.mark.parametrize("centre", [(60.0, 0.0), (0.0, -80.0), (45.0, 45.0)])
def test_where_nothing_can_be_pressed_the_untouched_gel_is_shown_and_why(bench, centre):
    session = Session(NAME, preset(NAME))
    session.move_press(centre_mm=centre)
    found = [step for step in shown(bench, session) if isinstance(step, Picture)]
    assert not found[-1].pressed
    assert "centre_mm" in found[-1].note
    rest = [step for step in shown(bench, session, None) if isinstance(step, Picture)]
    assert (pixels(found[-1]) == pixels(rest[-1])).all()
