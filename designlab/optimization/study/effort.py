"""How long a study takes: its evaluations, those of its confirmation, and what each is likely to cost."""

import re
from dataclasses import dataclass

from designlab.optimization.study.definition import Study
from designlab.optimization.study.results import levels

SECONDS = {"fast": 7.5, "standard": 20.0, "reference": 390.0}
"""Time of one evaluation of a usual design on two cores; docs/validation.md has the commands."""
FEWEST = 2  # designs worth a search: the base and another
_BUDGET = re.compile(r"(?P<amount>\d+(?:\.\d+)?)\s*(?P<unit>s|min|h)")
_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


@dataclass(frozen=True)
class Effort:
    """What a study has to do.

    Attributes
    ----------
    search : int
        Designs that the search still evaluates.
    confirmation : mapping of str to int
        Evaluations of the confirmation by fidelity.
    fidelity : str
        That of the search.
    copies : int
        Copies of each design that are evaluated, 1 unless the study is robust.
    """

    search: int
    confirmation: dict[str, int]
    fidelity: str
    copies: int = 1

    @classmethod
    def of(cls, study: Study, *, trials: int, done: int = 0) -> "Effort":
        """Effort of a study of so many designs, some of which are done."""
        again: dict[str, int] = {}
        if study.plan.promoted:
            promoted = min(study.plan.promoted, trials)
            *first, last = levels(study)
            again = dict.fromkeys(first or [last], 1 + promoted)
            again[last] = again.get(last, 0) + (1 + min(study.plan.confirmed, promoted)) * study.plan.seeds
        copies = 1 if study.robust is None else study.robust.copies
        return cls(max(trials - done, 0), again, study.fidelity, copies)

    def seconds(self, *, each: float | None = None) -> tuple[float, float]:
        """Time of search and confirmation on two cores (s).

        Parameters
        ----------
        each : float, optional
            What an evaluation of the search takes on this machine; usual times otherwise.
        """
        scale = 1.0 if each is None else each / SECONDS[self.fidelity]
        scale *= self.copies
        search = self.search * SECONDS[self.fidelity] * scale
        return search, sum(count * SECONDS[name] * scale for name, count in self.confirmation.items())

    def text(self) -> str:
        """What a study has to do and how long that takes, in a sentence."""
        search, confirmation = self.seconds()
        copies = f", {self.copies} copies of each" if self.copies > 1 else ""
        said = (
            f"{self.search} designs to evaluate ({self.fidelity}{copies}), about {span(search)} on two cores"
        )
        if not self.confirmation:
            return f"{said}; the best are not confirmed"
        parts = ", ".join(f"{count} at {name}" for name, count in self.confirmation.items())
        return (
            f"{said}; then the best are confirmed with fresh random numbers ({parts}), about "
            f"{span(confirmation)}; in all {span(search + confirmation)}"
        )


def span(seconds: float) -> str:
    """A time for people.

    Examples
    --------
    >>> span(42.0), span(200.0), span(9000.0)
    ('42 s', '3 min', '2.5 h')
    """
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def budget_s(text: str) -> float:
    """Read a time such as 90s, 10min or 2h.

    Raises
    ------
    ValueError
        If it is none.
    """
    found = _BUDGET.fullmatch(text.strip())
    if found is None or not float(found["amount"]) > 0:
        raise ValueError(f"--budget: must be a time such as 90s, 10min or 2h, got {text!r}")
    return float(found["amount"]) * _UNITS[found["unit"]]


def within(study: Study, budget: float) -> tuple[Study, int]:
    """The study and a number of designs that fit into a time on two cores: at most half of it confirms.

    The confirmation is cut first to fewer designs and seeds, then left out.

    Parameters
    ----------
    budget : float
        Time (s).

    Raises
    ------
    ValueError
        If not even two designs fit.
    """
    plans = [study.plan]
    if study.plan.promoted:
        fewer = {"promoted": min(study.plan.promoted, 2), "confirmed": 1, "seeds": 1}
        plans += [study.plan.model_copy(update=fewer), study.plan.model_copy(update={"promoted": 0})]
    each = Effort.of(study, trials=1).seconds()[0]
    for plan in plans:
        planned = study.model_copy(update={"plan": plan})
        confirmation = Effort.of(planned, trials=study.trials).seconds()[1]
        trials = min(study.trials, int((budget - confirmation) / each))
        if confirmation <= budget / 2 and trials >= FEWEST:
            return planned, trials
    raise ValueError(
        f"--budget: {FEWEST} designs take {span(FEWEST * each)} at fidelity {study.fidelity}, got "
        f"{span(budget)}"
    )
