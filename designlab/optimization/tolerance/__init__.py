"""Tolerances: copies of a design as they would be built, how many are good, and what to blame."""

from designlab.optimization.tolerance.distributions import Spread, default_spreads
from designlab.optimization.tolerance.result import Tolerance, load_tolerance
from designlab.optimization.tolerance.run import ToleranceInterrupted, tolerance
from designlab.optimization.tolerance.specification import Terms, load_terms

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
