"""What evaluators of closed form return in place of a simulation."""

from dataclasses import dataclass


@dataclass
class Estimate:
    """A score: value, standard error, bound of its bias, unit."""

    value: float
    se: float = 0.01
    bias_bound: float = 0.0
    unit: str = "1"


@dataclass
class Score:
    """Scores of a design by name."""

    scores: dict[str, Estimate]
    seconds: float = 0.0
