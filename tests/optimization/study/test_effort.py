"""What a study announces before it starts: its evaluations, and how long they take."""

import pytest

from designlab.optimization.study import Plan, Study
from designlab.optimization.study.effort import SECONDS, Effort, budget_s, span, within
from designlab.optimization.study.results import levels
from designlab.sensor.design import preset
from tests.helpers.studies import BARE


def study(**changes):
    content = {
        "base": preset("default"),
        "parameters": {"leds.height_mm": {"low": 2, "high": 7}},
        **BARE,
        "trials": 20,
        "plan": {"promoted": 4, "confirmed": 2, "seeds": 3},
    }
    return Study.model_validate(content | changes)


def test_evaluations_are_those_that_the_plan_makes():
    whole = Effort.of(study(), trials=20, done=5)
    assert whole.search == 15
    # the base beside the best: once at the search's fidelity and above, with all seeds at the highest
    assert whole.confirmation == {"fast": 5, "standard": 5, "reference": 9}
    short = Effort.of(study(plan=Plan(promoted=4, confirmed=2, seeds=3, highest="standard")), trials=20)
    assert short.confirmation == {"fast": 5, "standard": 9}
    assert Effort.of(study(plan=Plan(promoted=0)), trials=20).confirmation == {}
    assert levels(study(fidelity="reference", plan=Plan(highest="standard"))) == ("reference",)


def test_time_is_announced_with_what_it_is_for():
    text = Effort.of(study(), trials=20).text()
    search, confirmation = 20 * SECONDS["fast"], 5 * SECONDS["fast"] + 5 * SECONDS["standard"]
    confirmation += 9 * SECONDS["reference"]
    assert "20 designs to evaluate (fast), about 2 min" in text
    assert "5 at fast, 5 at standard, 9 at reference" in text
    assert text.endswith(f"in all {span(search + confirmation)}")
    assert Effort.of(study(plan=Plan(promoted=0)), trials=20).text().endswith("the best are not confirmed")


@pytest.mark.parametrize("seconds", [60.0, 240.0, 900.0, 7200.0])
def test_what_fits_into_a_budget_takes_no_longer(seconds):
    planned, trials = within(study(), seconds)
    assert 2 <= trials <= 20
    search, confirmation = Effort.of(planned, trials=trials).seconds()
    assert search + confirmation <= seconds
    assert confirmation <= seconds / 2
    assert planned.digest == study().digest  # what was found before still counts


def test_a_budget_too_short_for_two_designs_is_refused_with_what_they_take():
    with pytest.raises(ValueError, match=r"--budget: 2 designs take 15 s at fidelity fast, got 10 s"):
        within(study(), 10.0)


@pytest.mark.parametrize(("text", "seconds"), [("90s", 90.0), ("10min", 600.0), ("1.5 h", 5400.0)])
def test_a_budget_is_a_time(text, seconds):
    assert budget_s(text) == seconds


@pytest.mark.parametrize("text", ["10", "ten min", "-3min", "0s", "3 days"])
def test_what_is_no_time_is_refused(text):
    with pytest.raises(ValueError, match=r"--budget: must be a time such as 90s, 10min or 2h"):
        budget_s(text)
