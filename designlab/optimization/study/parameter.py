"""A parameter is a field of the design with a range or choices, and with fields that move along."""

from typing import Any, Self

from pydantic import Field, model_validator

from geometries.spec import Spec

DIGITS = 9
"""After the point of fields that follow a parameter: so a base design is met again in spite of rounding."""


class Tied(Spec):
    """How a field follows a parameter: so many times its value, plus so much."""

    times: float = Field(1.0, description="Factor on the value.")
    plus: float = Field(0.0, description="What is added, in the unit of the field.")


class Parameter(Spec):
    """Values that one field of the design may take: a range, or a list of choices."""

    low: float | None = Field(None, description="Smallest value, in the unit of the field.")
    high: float | None = Field(None, description="Largest value, in the unit of the field.")
    step: float | None = Field(None, gt=0, description="Spacing of the values; continuous if absent.")
    log: bool = Field(False, description="Whether to search on a logarithmic scale.")
    choices: tuple[bool | int | float | str, ...] | None = Field(
        None, min_length=1, description="The values themselves, instead of a range."
    )
    variant: str | None = Field(
        None, description="Name of the only variant that it is for; all variants if absent."
    )
    also: dict[str, float | Tied] = Field(
        {},
        description="Further fields that move along, by dotted path: each takes the value plus this, for "
        "example the radius of a core under a gel that is 2 mm thick, or so many times the value plus this.",
    )

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if self.choices is not None:
            words = any(isinstance(choice, bool | str) for choice in self.choices)
            if words and any(tie != Tied() for tie in self.ties.values()):
                raise ValueError("also: only numbers can be moved by an offset; give 0")
            if self.low is not None or self.high is not None or self.step is not None or self.log:
                raise ValueError("give either choices, or low and high with step or log; not both")
            if len(set(self.choices)) != len(self.choices):
                raise ValueError(f"choices must differ, got {list(self.choices)}")
            return self
        if self.low is None or self.high is None:
            raise ValueError("give low and high, or choices")
        if not self.low < self.high:
            raise ValueError(f"low must be below high, got low {self.low:g}, high {self.high:g}")
        if self.log and self.low <= 0:
            raise ValueError(f"a logarithmic range needs low above 0, got low {self.low:g}")
        if self.log and self.step is not None:
            raise ValueError("give step or log, not both")
        return self

    @property
    def extremes(self) -> tuple[bool | int | float | str, ...]:
        """The values to check against the field: both ends, or every choice."""
        if self.choices is not None:
            return self.choices
        return tuple(value for value in (self.low, self.high) if value is not None)

    def fields(self, path: str, value: Any) -> dict[str, Any]:
        """Fields that a value of the parameter sets, and what each becomes."""
        moved = {
            other: value if tie == Tied() else round(tie.times * value + tie.plus, DIGITS)
            for other, tie in self.ties.items()
        }
        return {path: value, **moved}

    @property
    def ties(self) -> "dict[str, Tied]":
        """What each further field becomes."""
        return {other: tie if isinstance(tie, Tied) else Tied(plus=tie) for other, tie in self.also.items()}

    def holds(self, value: Any) -> bool:
        """Whether a value is one of those that the parameter may take."""
        if self.choices is not None or self.low is None or self.high is None:
            return value in (self.choices or ())
        if (
            isinstance(value, bool)
            or not isinstance(value, int | float)
            or not self.low <= value <= self.high
        ):
            return False
        steps = 0.0 if self.step is None else (value - self.low) / self.step
        return abs(steps - round(steps)) < 1e-9
