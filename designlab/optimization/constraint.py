"""What a score must be: the terms of a study's constraints, and of a specification that copies must meet."""

import math
from typing import Self

from pydantic import Field, model_validator

from geometries.spec import Spec


class Bound(Spec):
    """What a score must at least or at most be."""

    least: float | None = Field(None, description="Smallest value allowed.")
    most: float | None = Field(None, description="Largest value allowed.")

    @model_validator(mode="after")
    def _an_interval(self) -> Self:
        if self.least is None and self.most is None:
            raise ValueError("give least, most or both")
        if self.least is not None and self.most is not None and self.least > self.most:
            raise ValueError(f"least must not be above most, got least {self.least:g}, most {self.most:g}")
        return self

    def broken_by(self, value: float) -> float:
        """By how much a value breaks the bound, in the unit of the score; zero or less if it keeps it.

        A score without a value keeps none.
        """
        if math.isnan(value):
            return math.inf
        below = -math.inf if self.least is None else self.least - value
        above = -math.inf if self.most is None else value - self.most
        return max(below, above)

    def text(self) -> str:
        """Say the bound in words."""
        ends = (("at least", self.least), ("at most", self.most))
        return " and ".join(f"{word} {end:g}" for word, end in ends if end is not None)
