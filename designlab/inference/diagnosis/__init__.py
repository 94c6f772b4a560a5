"""From a measurement that does not match the simulation to named physical effects and an updated model.

From the bottom up: `result` (what is found: data, which `report` words and draws), `emulator` (pictures of
the model and how they change), `likelihood` (noise, and effects, gains and poses fitted together),
`selection` (the search, judged by held-out presses), `verdict` (values, confidence, regions, the updated
model), `single_image` (one picture alone), `diagnose` (all of it).
"""

from designlab.inference.diagnosis.diagnose import diagnose
from designlab.inference.diagnosis.result import Candidate, Found, GapReport, Level, Value, Where

__all__ = ["Candidate", "Found", "GapReport", "Level", "Value", "Where", "diagnose"]
