"""Inverse rendering of one real sensor: the design under which the simulator gives its pictures.

The order of the work: `imaging` (models of pictures), `fields` (what may be free), `linear` (what follows in
closed form), `problem` (shots and their simulation), `solve` (everything else, and how well it is known),
`run` (all of it), `pictures`.
"""

from designlab.inference.calibration.result import Calibration, FittedParameter, FrameResult
from designlab.inference.calibration.run import calibrate

__all__ = ["Calibration", "FittedParameter", "FrameResult", "calibrate"]
