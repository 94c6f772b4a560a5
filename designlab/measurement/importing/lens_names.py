"""Names of fields and models of lens calibrations, as OpenCV, ROS, Kalibr, COLMAP and scripts write them."""

import re
from typing import Any

# Names in small letters and digits alone, the usual one first.
MATRICES = (
    "cameramatrix",
    "cameramatrix1",
    "k",
    "mtx",
    "intrinsicmatrix",
    "intrinsics",
    "intrinsic",
    "matrix",
)
VECTORS = ("intrinsics", "intrinsic")  # may be fx fy cx cy alone, as Kalibr writes them
SECOND = ("cameramatrix2", "m2", "k2")  # of a pair of cameras, where it is a matrix
FOCAL_X, FOCAL_Y = ("fx", "flx"), ("fy", "fly")
FOCAL = ("f", "focal", "focallength", "focallengthpx")
CENTRE_X, CENTRE_Y = ("cx", "ppx", "u0"), ("cy", "ppy", "v0")
CENTRE = ("principalpoint", "center", "centre")
LISTS = (
    "distortioncoefficients",
    "distortioncoeffs",
    "distcoeffs",
    "distcoeff",
    "dist",
    "d",
    "distcoeffs1",
    "distortioncoefficients1",
    "distortion",
    "coeffs",
    "coefficients",
)
WIDTHS, HEIGHTS = ("imagewidth", "width", "w"), ("imageheight", "height", "h")
SIZES = ("imagesize", "resolution", "dim", "dims", "size", "imgsize", "imageresolution", "imagedimensions")
SHAPES = ("imageshape", "imgshape", "shape")  # rows first, as NumPy has them
MODELS = ("distortionmodel", "cameramodel", "lensmodel", "distortiontype", "model", "modeltype")
LABELS = "name", "id", "topic", "file", "note"  # ends of the names of fields that say nothing of the lens
FLAGS = ("fisheyemodel", "fisheye", "isfisheye")
GROUPS = (*MATRICES, *LISTS, *SIZES, "distortionparameters", "projectionparameters")
"""Names whose value may be a table of the values themselves."""

PINHOLE_ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "taux", "tauy")
FISHEYE_ORDER = ("k1", "k2", "k3", "k4")
PINHOLE_COUNTS = (0, 2, 4, 5, 8, 12, 14)  # those of OpenCV, and k1 k2
EITHER = ("pinhole", "perspective")  # with what distortion, they do not say
PINHOLES = (
    "plumbbob",
    "rationalpolynomial",
    "radtan",
    "pinholeradtan",
    "radialtangential",
    "brownconrady",
    "opencv",
    "fullopencv",
    "simplepinhole",
    "simpleradial",
    "radial",
    "none",
)
FISHEYES = (
    "equidistant",
    "fisheye",
    "kannalabrandt",
    "kannalabrandt4",
    "kb4",
    "equi",
    "pinholeequi",
    "opencvfisheye",
    "simpleradialfisheye",
    "radialfisheye",
)
KNOWN_MODELS = (
    "plumb_bob, radtan, brown_conrady and rational_polynomial (pinhole), equidistant, fisheye and "
    "kannala_brandt (fisheye)"
)


def plain(name: Any) -> str:
    """A name in small letters and digits alone."""
    return re.sub(r"[^a-z0-9]", "", str(name).lower())
