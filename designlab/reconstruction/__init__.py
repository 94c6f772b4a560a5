"""From images to shape: calibrated photometric stereo, and integration of gradients to height."""

from designlab.reconstruction.height import gradients_of, integrate, normals, settled
from designlab.reconstruction.kernel import KernelCalibration, fit_kernel
from designlab.reconstruction.nearfield import NearField, near_field

__all__ = [
    "KernelCalibration",
    "NearField",
    "fit_kernel",
    "gradients_of",
    "integrate",
    "near_field",
    "normals",
    "settled",
]
