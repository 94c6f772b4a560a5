"""Fields of a specification are looked up by their dotted paths."""

import math

import pytest

from designlab.core.fields import field_at
from geometries.spec import Spec, quantity


class Part(Spec):
    length_mm: float = quantity(2.0, unit="mm", gt=0, le=10)
    shares: tuple[float, ...] = (0.25, 0.75)

    @property
    def half_mm(self) -> float:
        return self.length_mm / 2


class Whole(Spec):
    parts: tuple[Part, ...] = (Part(), Part(length_mm=3.0))
    name: str = "whole"


def test_value_unit_and_bounds_of_a_field_within_a_tuple():
    value, unit, low, high = field_at(Whole(), "parts.1.length_mm")
    assert (value, unit, high) == (3.0, "mm", 10.0)
    assert 0 < low < 1e-5  # an open end belongs to no range
    Part(length_mm=low)


def test_a_value_among_several_and_one_without_unit_or_bounds():
    assert field_at(Whole(), "parts.0.shares.1") == (0.75, "1", -math.inf, math.inf)
    assert field_at(Whole(), "name").value == "whole"


@pytest.mark.parametrize(
    "path", ["length", "parts.2.length_mm", "parts.-1.length_mm", "parts.0.half_mm", "name.0", ""]
)
def test_what_is_no_field_is_named(path):
    with pytest.raises(LookupError, match=f"no field '{path}'"):
        field_at(Whole(), path)
