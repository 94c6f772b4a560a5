"""Inverse rendering of one real sensor: the design under which the simulator gives its pictures.

The order of the work: `imaging` (models of pictures), `fields` (what may be free), `linear` (what follows in
closed form), `problem` (shots and their simulation), `solve` (everything else, and how well it is known),
`run` (all of it), `pictures`.
"""

from designlab.calibrate.result import Calibration, FrameResult, Parameter
from designlab.calibrate.run import calibrate

__all__ = ["Calibration", "FrameResult", "Parameter", "calibrate"]
