"""What one picture of a press shows: heights, contact, forces, how markers have moved."""

from dataclasses import dataclass

import numpy as np

from designlab.core.types import Array, Mask
from designlab.mechanics.surface_pressure import ForceRange, SurfacePressure
from designlab.mechanics.surface_shear import SurfaceShear
from designlab.reconstruction.drift import Drift


@dataclass(frozen=True, eq=False)
class MarkerShift:
    """What the markers of a press show.

    Attributes
    ----------
    places_mm : array, shape (markers, 2)
        Places of those that were found again, right of and above the middle of the picture, untouched.
    moved_mm : array, shape (markers, 2)
        How far they have moved to the right and up.
    shear : SurfaceShear or None
        Shear that moves them so; None without a contact, or where it is not known how the camera looks on
        the gel, since a marker that is lifted seems to move.
    """

    places_mm: Array
    moved_mm: Array
    shear: SurfaceShear | None

    @property
    def mean_mm(self) -> float:
        """Mean length of the displacements."""
        return float(np.hypot(*self.moved_mm.T).mean()) if len(self.moved_mm) else 0.0


@dataclass(frozen=True, eq=False)
class PressShape:
    """The shape that one picture shows.

    Attributes
    ----------
    height_mm : array, shape (rows, columns)
        How far the gel is pressed in; negative where it bulges.
    normals : array, shape (rows, columns, 3)
        Unit normals in the sensor frame: x right, y up, z towards the camera; not quite those of the height,
        see `height.blended`.
    contact : bool array, shape (rows, columns)
        Where something touches the gel, see `mechanics.surface_pressure`.
    depth_mm : float
        Deepest point.
    contact_area_mm2 : float
        Area of the contact.
    pressure : SurfacePressure or None
        Pressure over the gel's modulus, on a coarser grid; None where nothing touches.
    warnings : tuple of str
        What speaks against the result, each with what to do.
    drift : Drift
        What has changed against the untouched gel beside the press.
    markers : MarkerShift or None
        How printed markers have moved; None on a gel without them.
    """

    height_mm: Array
    normals: Array
    contact: Mask
    depth_mm: float
    contact_area_mm2: float
    pressure: SurfacePressure | None
    warnings: tuple[str, ...]
    drift: Drift
    markers: MarkerShift | None = None

    def force_n(self, modulus_mpa: float) -> float:
        """Force on the gel, of a modulus in MPa, by an object that carries the skin along."""
        return 0.0 if self.pressure is None else self.pressure.force_n(modulus_mpa)

    def force_range(self, modulus_mpa: float, modulus_sd_mpa: float = 0.0) -> ForceRange:
        """Force on the gel with its 95 % interval, see `SurfacePressure.force_range`."""
        if self.pressure is None:
            return ForceRange(0.0, 0.0, 0.0)
        return self.pressure.force_range(modulus_mpa, modulus_sd_mpa)

    def shear_n(self, modulus_mpa: float) -> tuple[float, float] | None:
        """Shear force to the right and up on the gel, of a modulus in MPa; None where it is not known."""
        if self.markers is None or self.markers.shear is None:
            return None
        return self.markers.shear.force_n(modulus_mpa)
