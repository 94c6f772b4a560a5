"""Measured frames of a real sensor: the folder format, its checks, and the split of presses by place."""

from designlab.measurement.checks import Suspicion, check, refuse
from designlab.measurement.folder import load_measurement, write_measurement
from designlab.measurement.frames import Frame, Measurement, MeasurementError, PoseSigma, Split
from designlab.measurement.light import ball_of, light_of

__all__ = [
    "Frame",
    "Measurement",
    "MeasurementError",
    "PoseSigma",
    "Split",
    "Suspicion",
    "ball_of",
    "check",
    "light_of",
    "load_measurement",
    "refuse",
    "write_measurement",
]
