"""From a measurement that does not match the simulation to named physical effects and an updated model.

The order of the work: `observe` (what was measured, how noisy), `floor` (what no model can explain), `fit`
(effects with gains and poses as nuisances), `judge` (held-out presses), `search` (the race), `diagnose` (all
of it, and the report).
"""

from designlab.gap.diagnose import diagnose
from designlab.gap.result import Candidate, Found, GapReport, Level, Value, Where

__all__ = ["Candidate", "Found", "GapReport", "Level", "Value", "Where", "diagnose"]
