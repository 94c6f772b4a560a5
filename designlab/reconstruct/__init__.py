"""From images to shape: calibrated photometric stereo, and integration of gradients to height."""

from designlab.reconstruct.height import gradients_of, integrate, normals, sharpen
from designlab.reconstruct.kernel import KernelCalibration, fit_kernel

__all__ = [
    "KernelCalibration",
    "fit_kernel",
    "gradients_of",
    "integrate",
    "normals",
    "sharpen",
]
