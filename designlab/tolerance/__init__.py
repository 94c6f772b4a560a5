"""Tolerances: copies of a design as they would be built, how many are good, and what to blame."""

from designlab.tolerance.result import Tolerance, load_tolerance
from designlab.tolerance.run import ToleranceInterrupted, tolerance
from designlab.tolerance.spreads import Spread, default_spreads

__all__ = [
    "Spread",
    "Tolerance",
    "ToleranceInterrupted",
    "default_spreads",
    "load_tolerance",
    "tolerance",
]
