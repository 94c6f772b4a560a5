"""A flat mirror in the camera's path: the same as a camera behind it, at the image of its place."""

from typing import Annotated

import numpy as np
from pydantic import Field

from designlab.core.types import Array
from geometries.spec import Spec, quantity

Coordinate = Annotated[float, Field(ge=-4000.0, le=4000.0)]  # mm
Turn = Annotated[float, Field(ge=-180.0, le=180.0)]  # deg
ALONG = 1e-6  # by which axes of unit length may differ, and still count as parallel


class Mirror(Spec):
    """A flat front-surface mirror between the camera and the window."""

    centre_mm: tuple[Coordinate, Coordinate, Coordinate]
    """Middle of the mirror in the sensor frame (mm)."""
    tilt_deg: tuple[Turn, Turn]
    """Where its face looks: from straight down turned towards +y, then towards +x, as camera.tilt_deg."""
    width_mm: float = quantity(20.0, unit="mm", gt=0, le=400)
    """Size along the sensor's x, or across it where the mirror is turned towards x."""
    height_mm: float = quantity(20.0, unit="mm", gt=0, le=400)
    """Size across that."""
    reflectance: float = quantity(0.9, unit="1", gt=0, le=1)
    """Share of the light that it reflects; matters with camera.exposure_time_ms only (0.9: aluminium, an
    estimate)."""

    @property
    def axes(self) -> Array:
        """Unit vectors in the sensor frame, rows: along the width, along the height, where the face looks."""
        right, up, forward = turned(self.tilt_deg).T
        return np.stack([_in_frame(axis) for axis in (right, up, forward)])

    def reach_mm(self, start: Array, towards: Array) -> Array:
        """How far beside the mirror lines meet its plane, below zero where they meet it.

        Parameters
        ----------
        start : array, shape (3,)
            Where the lines start.
        towards : array, shape (n, 3)
            Where they go.
        """
        across, along, normal = self.axes
        way = towards - start
        met = start + way * (((np.asarray(self.centre_mm) - start) @ normal) / (way @ normal))[:, None]
        beside = met - np.asarray(self.centre_mm)
        over = np.abs(beside @ across) - self.width_mm / 2, np.abs(beside @ along) - self.height_mm / 2
        return np.asarray(np.maximum(*over))


def turned(tilt_deg: tuple[float, float]) -> Array:
    """Rotation from a camera's own right, up and axis to x, y and -z, by its two angles."""
    (sin_x, sin_y), (cos_x, cos_y) = np.sin(np.radians(tilt_deg)), np.cos(np.radians(tilt_deg))
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cos_x, sin_x], [0.0, -sin_x, cos_x]])
    about_y = np.array([[cos_y, 0.0, sin_y], [0.0, 1.0, 0.0], [-sin_y, 0.0, cos_y]])
    return np.asarray(about_y @ about_x)


def unfolded(
    position_mm: tuple[float, float, float], tilt_deg: tuple[float, float], mirror: Mirror
) -> tuple[tuple[float, float, float], tuple[float, float]]:
    """Place and tilt of the camera that sees without the mirror what the real one sees in it.

    Its picture is the real one's, turned back: a mirror swaps sides.

    Raises
    ------
    ValueError
        If the mirror does not face the camera, or turns its picture about the camera's axis.
    """
    normal, centre, place = mirror.axes[2], np.asarray(mirror.centre_mm), np.asarray(position_mm)
    ahead = float((place - centre) @ normal)
    if ahead <= 0:
        raise ValueError(
            f"mirror.tilt_deg: its face must look towards the camera, which stands {-ahead:.3g} mm behind it"
        )
    right, up, forward = (_in_frame(axis) for axis in turned(tilt_deg).T)
    if forward @ normal >= 0:
        raise ValueError(f"mirror.centre_mm: the camera looks away from the mirror (tilt_deg {tilt_deg})")
    seen = [axis - 2 * (axis @ normal) * normal for axis in (right, up, forward)]
    x, y, down = seen[2] * (1.0, 1.0, -1.0)
    tilt = float(np.degrees(np.arcsin(np.clip(y, -1, 1)))), float(np.degrees(np.arctan2(x, down)))
    own = [_in_frame(axis) for axis in turned(tilt).T]
    if any(abs(abs(float(axis @ mirrored)) - 1) > ALONG for axis, mirrored in zip(own, seen, strict=True)):
        raise ValueError(
            f"mirror.tilt_deg: turns the picture about the camera's axis; turn camera and mirror towards the "
            f"same direction, x or y, got {mirror.tilt_deg} with camera.tilt_deg {tilt_deg}"
        )
    behind = place - 2 * ahead * normal
    return (float(behind[0]), float(behind[1]), float(behind[2])), tilt


def _in_frame(axis: Array) -> Array:
    """Components along x, y and z of those along x, y and -z."""
    return np.asarray(axis * (1.0, 1.0, -1.0))
