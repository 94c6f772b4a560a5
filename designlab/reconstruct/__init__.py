"""From images to shape: calibrated photometric stereo, and integration of gradients to height."""

from designlab.reconstruct.height import gradients_of, integrate, normals, sharpen
from designlab.reconstruct.kernel import KernelCalibration, fit_kernel
from designlab.reconstruct.nearfield import NearField, near_field
from designlab.reconstruct.polynomial import POSITION_DEGREES, RIDGES, Calibration, Terms, fit_calibration

__all__ = [
    "POSITION_DEGREES",
    "RIDGES",
    "Calibration",
    "KernelCalibration",
    "NearField",
    "Terms",
    "fit_calibration",
    "fit_kernel",
    "gradients_of",
    "integrate",
    "near_field",
    "normals",
    "sharpen",
]
