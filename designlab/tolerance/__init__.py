"""Tolerances: copies of a design as they would be built, how many are good, and what to blame."""

from designlab.tolerance.result import Tolerance, load_tolerance
from designlab.tolerance.run import ToleranceInterrupted, tolerance
from designlab.tolerance.spreads import Spread, default_spreads
from designlab.tolerance.terms import Terms, load_terms

__all__ = [
    "Spread",
    "Terms",
    "Tolerance",
    "ToleranceInterrupted",
    "default_spreads",
    "load_terms",
    "load_tolerance",
    "tolerance",
]
