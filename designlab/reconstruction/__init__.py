"""From images to shape: calibrated photometric stereo, and integration of gradients to height."""

from designlab.reconstruction.height import blended, gradients_of, integrate, normals
from designlab.reconstruction.kernel import KernelCalibration, fit_kernel
from designlab.reconstruction.nearfield import NearField, near_field

__all__ = [
    "KernelCalibration",
    "NearField",
    "blended",
    "fit_kernel",
    "gradients_of",
    "integrate",
    "near_field",
    "normals",
]
