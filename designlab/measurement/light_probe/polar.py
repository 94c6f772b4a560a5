"""Light around the ball as a map over polar angle and azimuth."""

import json
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates

from designlab.core.types import Array
from designlab.measurement.light_probe.unwrap import Unwrapped

SPLIT = 3  # directions along each side of a cell of the map


@dataclass(frozen=True, eq=False)
class PolarMap:
    """Incident radiance by direction.

    Attributes
    ----------
    names : tuple of str
        Channels.
    polar_deg : array, shape (n,)
        Angle from +z, the direction of the camera: 0 above, 90 along the plane of the gel.
    azimuth_deg : array, shape (m,)
        Counter-clockwise from +x.
    radiance : array, shape (channels, n, m)
        NaN where the ball shows nothing.
    """

    names: tuple[str, ...]
    polar_deg: Array
    azimuth_deg: Array
    radiance: Array

    @property
    def solid_angle_sr(self) -> Array:
        """Solid angle of every cell, shape (n, 1)."""
        half = np.radians(self.polar_deg[1] - self.polar_deg[0]) / 2
        polar = np.radians(self.polar_deg)
        bands = np.cos(np.maximum(polar - half, 0.0)) - np.cos(polar + half)
        return np.asarray(bands[:, None] * 2 * np.pi / len(self.azimuth_deg))

    def to_json(self) -> str:
        """Content as JSON; what the ball does not show is null."""
        shown = self.radiance.astype(object)
        shown[np.isnan(self.radiance)] = None
        return json.dumps(
            {
                "names": list(self.names),
                "polar_deg": self.polar_deg.tolist(),
                "azimuth_deg": self.azimuth_deg.tolist(),
                "radiance": shown.tolist(),
            }
        )


def polar_map(found: Unwrapped, *, step_deg: float = 1.0, furthest_deg: float = 150.0) -> PolarMap:
    """Resample unwrapped light evenly over polar angle and azimuth.

    Parameters
    ----------
    found : Unwrapped
        The light, pixel by pixel.
    step_deg : float
        Size of a cell; the nearest that divides 360 is taken.
    furthest_deg : float
        Polar angle at which the map ends.

    Raises
    ------
    ValueError
        If a parameter is out of its range.
    """
    if not 0.05 <= step_deg <= 30:
        raise ValueError(f"step_deg: must lie between 0.05 and 30 deg, got {step_deg:g} deg")
    if not step_deg < furthest_deg <= 180:
        raise ValueError(f"furthest_deg: must lie between step_deg and 180 deg, got {furthest_deg:g} deg")
    count = round(360 / step_deg)
    step = 360 / count
    polar = np.arange(step / 2, furthest_deg, step)
    azimuth = np.asarray((np.arange(count) + 0.5) * step, dtype=float)
    # The mean of a few directions: narrow lobes would fall between the middles of cells.
    inner = ((np.arange(SPLIT) + 0.5) / SPLIT - 0.5) * step
    finer = unit_vectors((polar[:, None] + inner).ravel()[:, None], (azimuth[:, None] + inner).ravel()[None])
    row, column = found.pixel_of(finer)
    hidden = np.isnan(row)
    places = [np.where(hidden, 0.0, row), np.where(hidden, 0.0, column)]
    weight = (~hidden).astype(float)
    shown = _cells(weight, len(polar), count)
    radiance = [
        _cells(map_coordinates(image, places, order=1, mode="nearest") * weight, len(polar), count)
        for image in _filled(found)
    ]
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.asarray(np.stack(radiance) / shown, dtype=float)
    return PolarMap(found.names, polar, azimuth, mean)


def _cells(values: Array, rows: int, columns: int) -> Array:
    """Sums over the finer directions of each cell."""
    return np.asarray(values.reshape(rows, SPLIT, columns, SPLIT).sum(axis=(1, 3)))


def unit_vectors(polar_deg: Array, azimuth_deg: Array) -> Array:
    """Unit vectors of directions, shape (..., 3)."""
    polar, azimuth = np.radians(polar_deg), np.radians(azimuth_deg)
    polar, azimuth = np.broadcast_arrays(polar, azimuth)
    sine = np.sin(polar)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), np.cos(polar)], axis=-1)


def angles_deg(direction: Array) -> tuple[float, float]:
    """Polar angle and azimuth (0 to 360) of one direction."""
    x, y, z = direction / np.linalg.norm(direction)
    return float(np.degrees(np.arctan2(np.hypot(x, y), z))), float(np.degrees(np.arctan2(y, x)) % 360)


def _filled(found: Unwrapped) -> Array:
    """Radiance with the nearest pixel on the ball beside it: there is nothing else to interpolate with."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~found.on_ball, return_distances=False, return_indices=True)
    return np.asarray(found.radiance[:, nearest[0], nearest[1]])
