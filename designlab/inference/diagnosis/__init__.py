"""From a measurement that does not match the simulation to named physical effects and an updated model.

The order of the work: `observe` (what was measured), `bank` (pictures of the model and how they change),
`forward` (what a state predicts), `noise` (how far a perfect model may miss), `evidence` and `fit` (effects,
gains and poses together), `judge` (held-out presses), `search` (the race), `diagnose` (all of it), `update`
(the better model), `words` and `pictures` (what people see). `single_press` diagnoses one picture alone.
"""

from designlab.inference.diagnosis.diagnose import diagnose
from designlab.inference.diagnosis.result import Candidate, Found, GapReport, Level, Value, Where

__all__ = ["Candidate", "Found", "GapReport", "Level", "Value", "Where", "diagnose"]
