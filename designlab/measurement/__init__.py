"""Measured frames of a real sensor: the folder format, its checks, and the split of presses by place."""

from designlab.measurement.folder import load_measurement, write_measurement
from designlab.measurement.frames import MeasuredFrame, Measurement, MeasurementError, PoseSigma, Split
from designlab.measurement.importing.conversion import Conversion
from designlab.measurement.importing.import_frames import Imported, import_frames
from designlab.measurement.light import ball_of, light_of
from designlab.measurement.quality.checks import check
from designlab.measurement.quality.suspicion import Suspicion, refuse

__all__ = [
    "Conversion",
    "Imported",
    "MeasuredFrame",
    "Measurement",
    "MeasurementError",
    "PoseSigma",
    "Split",
    "Suspicion",
    "ball_of",
    "check",
    "import_frames",
    "light_of",
    "load_measurement",
    "refuse",
    "write_measurement",
]
