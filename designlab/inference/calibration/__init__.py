"""Inverse rendering of one real sensor: the design under which the simulator gives its pictures.

The order of the work: `imaging` (models of pictures), `fields` (what may be free), `problem` (shots and their
simulation), `solve` (poses and fields, and how well they are known), `run` (all of it).
"""

from designlab.inference.calibration.result import Calibration, FittedParameter, FrameResult
from designlab.inference.calibration.run import calibrate

__all__ = ["Calibration", "FittedParameter", "FrameResult", "calibrate"]
