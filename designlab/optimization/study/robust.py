"""A robust score counts a design as its built copies would score, not as its drawing does."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from designlab.evaluation.illumination_scores import Estimate
from designlab.optimization.outcome import Evaluator, prepared
from designlab.optimization.tolerance.distributions import (
    Spread,
    applicable,
    copy,
    default_spreads,
    deviates,
    inputs,
)
from designlab.sensor.design import InfeasibleDesign
from designlab.simulation.effects import SensorModel
from geometries.spec import Spec

if TYPE_CHECKING:
    from designlab.sensor.design import Design


class Robust(Spec):
    """How a design is scored by copies of it as they would be built."""

    copies: int = Field(8, ge=3, le=1000)
    """Copies of every design."""
    aim: Literal["mean_minus_sigma", "worst"] = "mean_minus_sigma"
    """mean_minus_sigma: the mean of the copies, on the worse side by `sigmas` of their standard deviations;
    worst: the worst copy."""
    sigmas: float = Field(1.0, ge=0, le=6)
    """Standard deviations taken from the mean."""
    spread: tuple[Spread, ...] | None = Field(None, min_length=1)
    """What differs between copies, each for the designs that have it; the usual spreads of each design when
    absent."""


@dataclass(frozen=True)
class RobustScore:
    """Scores over the copies of a design."""

    scores: Mapping[str, Estimate]
    seconds: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class RobustEvaluator:
    """Evaluates the copies of a design, each of which must be buildable; see `Robust`.

    Objectives are turned to their worse side, all other scores are means. The seed is that of the draws too:
    designs of one search are built with the same luck, and another seed draws other copies.
    """

    evaluator: Evaluator
    robust: Robust
    objectives: Mapping[str, Literal["maximise", "minimise"]]

    def __call__(self, subject: "Design | SensorModel", /, *, fidelity: str, seed: int) -> RobustScore:
        """Return the scores over the copies.

        Raises
        ------
        InfeasibleDesign
            If one of the copies cannot be built.
        """
        nominal = SensorModel.of(subject)
        stated = self.robust.spread
        spreads = default_spreads(nominal.design) if stated is None else applicable(nominal.design, stated)
        drawn = inputs(nominal.design, spreads)
        values = deviates(self.robust.copies, [each.name for each in drawn], seed)
        built = []
        for number, row in enumerate(values):
            model, reason, _ = prepared(partial(copy, nominal, drawn, row), as_built=True)
            if model is None:
                raise InfeasibleDesign(f"copy {number} cannot be built: {reason}")
            built.append(model)
        if not drawn:  # nothing of this design differs
            built = [nominal]
        found = [self.evaluator(model, fidelity=fidelity, seed=seed) for model in built]
        found *= self.robust.copies // len(found)
        names = [name for name in found[0].scores if all(name in one.scores for one in found)]
        warnings = dict.fromkeys(text for one in found for text in getattr(one, "warnings", ()))
        return RobustScore(
            {name: self._over_copies(name, [one.scores[name] for one in found]) for name in names},
            warnings=tuple(warnings),
        )

    def _over_copies(self, name: str, found: list[Any]) -> Estimate:
        """One score of all copies.

        Its error has two parts: that of a mean over presses, which are the same for all copies, and that of
        having drawn these copies and no others, from leaving out one at a time (jackknife).
        """
        values, errors = (np.array([getattr(one, key) for one in found]) for key in ("value", "se"))
        bounds = [one.bias_bound for one in found if one.bias_bound is not None]
        way = self.objectives.get(name)
        without = [self._statistic(np.delete(values, k), way) for k in range(len(values))]
        drawn = math.sqrt(len(values) - 1) * float(np.std(without))
        se = math.hypot(drawn, float(errors.mean()))
        return Estimate(self._statistic(values, way), se, found[0].unit, max(bounds, default=None))

    def _statistic(self, values: NDArray[np.float64], way: str | None) -> float:
        """What counts of the scores of copies: of an objective the worse side, else the mean."""
        if way is None:
            return float(values.mean())
        if self.robust.aim == "worst":
            return float(values.min() if way == "maximise" else values.max())
        worse = -1.0 if way == "maximise" else 1.0
        return float(values.mean() + worse * self.robust.sigmas * values.std(ddof=1))
