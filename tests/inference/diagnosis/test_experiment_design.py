"""What to measure next: what frames are predicted to tell, and which are asked for."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from designlab.inference.diagnosis.emulator.rendering import fill
from designlab.inference.diagnosis.emulator.snapshots import Bank
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.result import Found, Value
from designlab.inference.diagnosis.selection.criterion import Evidence, JudgedCandidate, lead
from designlab.inference.diagnosis.selection.held_out import Stand, gain, judge
from designlab.inference.diagnosis.verdict.experiment_design import (
    doubt_of,
    separating,
)
from designlab.inference.diagnosis.verdict.next_measurement import advise
from designlab.measurement.frames_to_take import DARK, Action
from designlab.measurement.shots import Observations
from designlab.simulation.effects import SensorModel
from tests.helpers.small_sensor import DESIGN, VALUES, shots

pytestmark = pytest.mark.renders

NAMES = ("albedo_field", "vignetting")
TRAIN = [0, 1, 2]


@pytest.fixture(scope="module")
def bank(renders) -> Bank:
    """Frames of a coat of uneven reflectance, without noise."""
    found = fill(renders, SensorModel.of(DESIGN), shots(SensorModel.of(DESIGN)), NAMES)
    truth = State(np.ones(3)).with_values("albedo_field", VALUES["albedo_field"])
    predict = Fitter(found).forward.predict
    seen = (replace(s, signal=predict(truth, n), pose_sigma=np.zeros(4)) for n, s in enumerate(found.shots))
    return replace(found, shots=tuple(seen))


@pytest.fixture(scope="module", params=[0.003, 0.0], ids=["grain", "no grain"])
def fitted(request, bank) -> tuple[JudgedCandidate, JudgedCandidate]:
    """The effect that is there, and a wrong one, as if they did as well."""
    fitter = Fitter(bank)
    fitter.grain = request.param
    start = fitter.fit(fitter.start(TRAIN), (), TRAIN).state
    fitter.measure(start)
    made = []
    for name in NAMES:
        fit = fitter.fit(start, [name], TRAIN)
        stand = Stand(fitter, fit, TRAIN, judge(fitter, fit, [3]))
        share = gain(stand.judged, stand.judged, 1.0)
        made.append(JudgedCandidate(name, stand, share, Evidence(60.0, 0.0), 0.0, 1.0))
    return ahead(made[0], made[1], 3.0)


def ahead(
    true: JudgedCandidate, wrong: JudgedCandidate, by: float
) -> tuple[JudgedCandidate, JudgedCandidate]:
    """The two with prices by which the truth leads as much as asked."""
    return replace(true, price=true.price + lead(true, wrong).value - by), wrong


def action(bank: Bank, like: int, lit: np.ndarray) -> Action:
    return Action("", replace(bank.shots[like], lit=lit), like, 1.0, {})


def risen(bank: Bank, actions: list[Action], true: JudgedCandidate, wrong: JudgedCandidate) -> float:
    """How much further the truth leads once frames have been taken and all are fitted together."""
    place = (*bank.place, *(bank.place[a.like] for a in actions))
    taken = replace(bank, shots=(*bank.shots, *(a.shot for a in actions)), place=place)
    further = range(len(bank.shots), len(taken.shots))
    predict = Fitter(taken).forward.predict
    new = [
        replace(a.shot, signal=predict(true.stand.state, n)) for n, a in zip(further, actions, strict=True)
    ]
    fitter = true.stand.fitter.of(replace(taken, shots=(*bank.shots, *new)), [])
    fitter.measure(true.stand.state)
    fitter.noises[: len(bank.shots)] = true.stand.fitter.noises
    right, other = (
        fitter.fit(a.stand.state, [a.name], [*TRAIN, *further]).objective - a.stand.fit.objective
        for a in (true, wrong)
    )
    return 0.5 * (other - right)


def test_frames_tell_what_was_predicted(bank, fitted) -> None:
    """What frames there are have shown of smooth errors that all share is known of further ones."""
    actions = [action(bank, 0, np.eye(3)[0]), action(bank, 0, np.eye(3)[2]), action(bank, 1, np.eye(3)[1])]
    doubt = doubt_of(*fitted, actions)
    before = 0.0
    for count in (1, 2, 3):
        predicted = doubt.lead(range(count))
        assert predicted > before + 2.0
        assert predicted == pytest.approx(risen(bank, actions[:count], *fitted), rel=0.02)
        before = predicted
    assert doubt.needed == pytest.approx(6.0 - 3.0)  # of which it has some


def test_what_shows_neither_effect_tells_nothing(bank, fitted) -> None:
    doubt = doubt_of(*fitted, [action(bank, 0, np.zeros(3))])
    assert doubt.lead([0]) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("level", "clips", "tells"), [(0.03, True, True), (-0.03, True, False), (-0.03, False, True)]
)
def test_a_frame_without_light_tells_no_black_level_below_zero(bank, fitted, level, clips, tells) -> None:
    """Counts end at zero: what lies below is seen only in values from which something was subtracted."""
    right, wrong = fitted
    levels = {"R": level, "G": 0.0, "B": 0.0}
    state = wrong.stand.state.without("vignetting").with_values("black_level", levels)
    fit = replace(right.stand.fit, state=state)
    true = replace(right, name="black_level", stand=replace(right.stand, fit=fit))
    dark = action(bank, 0, np.zeros(3))
    dark = replace(dark, shot=replace(dark.shot, clips=(clips,) * 3))
    told = doubt_of(true, wrong, [dark]).lead([0])
    assert told > 5.0 if tells else told == pytest.approx(0.0, abs=1e-3)


def test_frames_are_asked_for_until_they_suffice(fitted) -> None:
    """More where the doubt is greater, each once, and the words say where they may not do."""
    true, wrong = fitted
    asked = separating(true.stand.fitter, [true, wrong])
    assert asked.separation_sd is not None
    assert 0.5 * asked.separation_sd**2 >= 3.0  # the wrong one, which is behind, needs 9
    assert "may not" not in asked.text
    far = ahead(true, wrong, -40.0)
    more = separating(true.stand.fitter, far)
    # Only turning the gel tells much of what goes with it: the coat, not the lens.
    assert {"kind": "background", "gel_rotation_deg": 180.0} in more.frames
    assert more.separation_sd is not None
    assert more.separation_sd > asked.separation_sd
    assert more.minutes > asked.minutes
    endless = separating(true.stand.fitter, ahead(true, wrong, -1e5))
    assert len({str(frame) for frame in endless.frames}) == len(endless.frames) > len(asked.frames)
    assert endless.text.endswith("; even that may not tell them apart")


def test_all_that_there_is_may_be_asked_for(fitted, monkeypatch) -> None:
    true, wrong = fitted
    monkeypatch.setattr("designlab.inference.diagnosis.verdict.experiment_design.MOST_FRAMES", 1000)
    endless = ahead(true, wrong, -1e5)
    frames = separating(true.stand.fitter, endless).frames
    # Backgrounds alone, short and turned, two places of presses with each group; dark shows neither effect.
    assert len(frames) == 11
    assert {"kind": "dark", "leds": []} not in frames


def test_where_no_frame_tells_anything_that_is_said(fitted) -> None:
    true, _ = fitted
    asked = separating(true.stand.fitter, [true, replace(true)])
    assert not asked.frames
    assert asked.text.startswith("no frame is known")


def test_frames_that_differ_by_their_light_are_said_at_once(fitted) -> None:
    far = ahead(*fitted, -1e5)
    text = separating(far[0].stand.fitter, far).text
    pressed = [part for part in text.split("; ") if part.startswith("sphere:4 pressed 0.6 mm deep")]
    assert len(pressed) == 1
    assert pressed[0].endswith(" LEDs, each alone")
    assert " and " in pressed[0]


@pytest.mark.parametrize("dark", [True, False])
@pytest.mark.parametrize("level", [-0.01, 0.01])
def test_a_black_level_below_zero_is_looked_for_in_light_of_single_groups(fitted, level, dark) -> None:
    fitter = fitted[0].stand.fitter
    off = replace(fitter.bank.shots[0], lit=np.zeros(3), clips=(True, True, True))
    taken = (*fitter.bank.shots, *([off] if dark else []))
    seen = Observations(taken, np.zeros(3), "repeated frames", True, dark, ())
    levels = {c: Value(level, level - 0.001, level + 0.001, "1", 0.0, 0.015, (-1.0, 1.0)) for c in "RGB"}
    found = Found("black_level", levels, 0.9, ("black_level",))
    asked = advise(fitter, seen, SimpleNamespace(winners=[]), "named", [found])
    alone = [{"kind": "background", "leds": [name]} for name in DESIGN.group_names]
    assert list(asked.frames) == ([] if dark else [DARK]) + (alone if level < 0 else [])


def test_the_freedom_of_smooth_errors_is_no_lead_of_either_effect(bank, fitted) -> None:
    true, _ = fitted
    fit = true.stand.fit
    loose = replace(fit, state=replace(fit.state, smooth_rms=0.02))
    both = replace(true, stand=replace(true.stand, fit=loose))
    for lit in (np.ones(3), np.eye(3)[1]):
        assert doubt_of(both, both, [action(bank, 0, lit)]).lead([0]) == pytest.approx(0.0, abs=0.05)
