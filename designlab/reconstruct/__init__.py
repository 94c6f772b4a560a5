"""From images to shape: calibrated photometric stereo, and integration of gradients to height."""

from designlab.reconstruct.height import gradients_of, integrate, normals, sharpen
from designlab.reconstruct.polynomial import POSITION_DEGREES, RIDGES, Calibration, Terms, fit_calibration

__all__ = [
    "POSITION_DEGREES",
    "RIDGES",
    "Calibration",
    "Terms",
    "fit_calibration",
    "gradients_of",
    "integrate",
    "normals",
    "sharpen",
]
