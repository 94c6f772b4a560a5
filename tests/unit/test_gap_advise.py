"""What to measure next: what frames are predicted to tell, and which are asked for."""

from dataclasses import replace

import numpy as np
import pytest
from toy_gap import DESIGN, VALUES, shots

from designlab.effects import SensorModel
from designlab.gap.advise import Action, _doubt
from designlab.gap.bank import Bank, fill
from designlab.gap.fit import Fitter
from designlab.gap.forward import State
from designlab.gap.search import Attempt

NAMES = ("albedo_field", "vignetting", "colour_mixing")
TRAIN = [0, 1, 2]


@pytest.fixture(scope="module")
def bank(renders) -> Bank:
    """Frames as a model with darker corners has them, without noise."""
    found = fill(renders, SensorModel.of(DESIGN), shots(SensorModel.of(DESIGN)), NAMES)
    truth = State(np.ones(3)).with_values("albedo_field", VALUES["albedo_field"])
    fitter = Fitter(found)
    seen = tuple(
        replace(s, signal=fitter.forward.predict(truth, n), pose_sigma=np.zeros(4))
        for n, s in enumerate(found.shots)
    )
    return replace(found, shots=seen)


def attempts(bank: Bank) -> tuple[Attempt, Attempt]:
    """The effect that is there, and a wrong one."""
    fitter = Fitter(bank)
    start = fitter.fit(fitter.start(TRAIN), (), TRAIN).state
    fitter.measure(start)
    made = []
    for name, evidence in (("albedo_field", 60.0), ("vignetting", 57.0)):
        fit = fitter.fit(start, [name], TRAIN)
        made.append(Attempt(name, 0.0, fitter, fit, None, None, evidence))  # type: ignore[arg-type]
    return made[0], made[1]


def lit_alone(bank: Bank, like: int, group: int) -> Action:
    return Action("", replace(bank.shots[like], lit=np.eye(3)[group]), like, 1.0, {})


def with_frames(bank: Bank, actions: list[Action], truth: State) -> Bank:
    """The bank once frames have been taken."""
    place = (*bank.place, *(bank.place[action.like] for action in actions))
    taken = replace(bank, shots=(*bank.shots, *(a.shot for a in actions)), place=place)
    forward = Fitter(taken).forward
    first = len(bank.shots)
    seen = [replace(a.shot, signal=forward.predict(truth, first + n)) for n, a in enumerate(actions)]
    return replace(taken, shots=(*bank.shots, *seen))


def test_frames_tell_what_they_were_predicted_to(bank) -> None:
    """Against a fit to the old and the new frames together."""
    true, wrong = attempts(bank)
    actions = [lit_alone(bank, 0, 0), lit_alone(bank, 0, 2), lit_alone(bank, 1, 1)]
    doubt = _doubt(true, wrong, actions)
    for chosen in ([0], [0, 1], [0, 1, 2]):
        then = Fitter(with_frames(bank, [actions[n] for n in chosen], true.fit.state))
        then.noises = [*true.fitter.noises]
        more = Fitter(then.bank)
        more.measure(true.fit.state)
        then.noises += more.noises[len(bank.shots) :]
        everything = [*TRAIN, *range(len(bank.shots), len(then.bank.shots))]
        ahead = [
            0.5 * (then.fit(a.fit.state, [a.name], everything).objective - a.fit.objective)
            for a in (true, wrong)
        ]
        print(chosen, doubt.lead(chosen), ahead)
