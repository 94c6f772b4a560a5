"""Shape from the pictures of one's own sensor, by a calibration on balls, with what speaks against it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from designlab.core.images import resize_area
from designlab.core.types import Array, Mask
from designlab.mechanics.surface_pressure import SurfacePressure, pressure_under
from designlab.reconstruction.calibration_file import Kept, load_calibration
from designlab.reconstruction.height import normals
from designlab.reconstruction.lab import LabCalibration, ReconstructedShape

COARSE_PX = 140  # of the longer side, for the pressure
FULL = 0.995  # of full scale from which a pixel is clipped
MOST_CLIPPED = 0.05  # share of the pixels that change
MOST_STRANGE = 0.1  # likewise, of colours that the balls did not show
SEEN = 0.25  # change of colour, in spreads, from which a pixel counts as changed
LEAST_SEEN = 0.002  # share of the picture; below it nothing touches
MOVED_PX = 1.0  # of the untouched gel
DRIFTED = 0.03  # likewise, relative to its light, once brightness is allowed for
FLAT_SHARE = 0.25  # height beyond which the border of the picture is touched


@dataclass(frozen=True, eq=False)
class PressShape:
    """The shape that one picture shows.

    Attributes
    ----------
    height_mm : array, shape (rows, columns)
        How far the gel is pressed in; negative where it bulges.
    normals : array, shape (rows, columns, 3)
        Unit normals in the sensor frame: x right, y up, z towards the camera.
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
    """

    height_mm: Array
    normals: Array
    contact: Mask
    depth_mm: float
    contact_area_mm2: float
    pressure: SurfacePressure | None
    warnings: tuple[str, ...]

    def force_n(self, modulus_mpa: float) -> float:
        """Force on the gel, of a modulus in MPa; proportional to it."""
        return 0.0 if self.pressure is None else self.pressure.force_n(modulus_mpa)


@dataclass(frozen=True, eq=False)
class Reconstructor:
    """Turns pictures of one sensor into shapes.

    Parameters
    ----------
    kept : Kept
        Calibration, and what the balls taught.

    Examples
    --------
    >>> import designlab as dl
    >>> reconstructor = dl.Reconstructor.load("calibrated/calibration.npz")  # doctest: +SKIP
    >>> shape = reconstructor(image)  # doctest: +SKIP
    """

    kept: Kept

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read the calibration that ``designlab calibrate --balls`` wrote.

        Parameters
        ----------
        path : path
            The file ``calibration.npz``.

        Raises
        ------
        ValueError
            If it is no such file.
        """
        return cls(load_calibration(path))

    @property
    def calibration(self) -> LabCalibration:
        """The maps, on the untouched gel that is in use."""
        return self.kept.calibration

    def on(self, background: ArrayLike) -> Self:
        """Return the same for another picture of the untouched gel, such as today's.

        Raises
        ------
        ValueError
            If it has another size than the calibration.
        """
        given = np.asarray(background, dtype=float)
        if given.shape != self.calibration.background.shape:
            raise ValueError(f"background: {_sizes(given, self.calibration)}")
        return replace(self, kept=self.kept._replace(calibration=replace(self.calibration, background=given)))

    def drift(self, background: ArrayLike) -> tuple[str, ...]:
        """What has changed between the calibration's untouched gel and another picture of it."""
        before, now = self.calibration.background, np.asarray(background, dtype=float)
        found = []
        ratio = now.mean(axis=(0, 1)) / before.mean(axis=(0, 1))
        if np.abs(ratio - 1).max() > DRIFTED:
            told = ", ".join(f"{value - 1:+.0%}" for value in ratio)
            found.append(f"the untouched gel is brighter by {told} (R, G, B) than when it was calibrated")
        down, right = _shift(before.mean(axis=-1), now.mean(axis=-1))
        if np.hypot(down, right) >= MOVED_PX:
            found.append(
                f"the untouched gel has moved by {right:+.0f} px to the right and {-down:+.0f} px up since "
                "it was calibrated: calibrate again, or put gel and camera back"
            )
        rest = gaussian_filter(now / ratio - before, (3, 3, 0)) / before.mean(axis=(0, 1))
        if rest.std() > DRIFTED:
            found.append(
                f"the light on the untouched gel has changed by {rest.std():.0%} in places since the "
                "calibration: calibrate again"
            )
        return tuple(found)

    def __call__(self, image: ArrayLike, *, mask: Mask | None = None, pressure: bool = True) -> PressShape:
        """Reconstruct one picture.

        Parameters
        ----------
        image : array, shape (rows, columns, channels)
            Values as the calibration's pictures have them, 0 to 1.
        mask : bool array, shape (rows, columns), optional
            Pixels that show the bare membrane; markers left out.
        pressure : bool
            Whether to find pressure and contact (about a second); without, contact is where the gel is
            pressed in by more than half of the depth.

        Raises
        ------
        ValueError
            If the picture has another size than the calibration.
        """
        values = np.asarray(image, dtype=float)
        if values.shape != self.calibration.background.shape:
            raise ValueError(f"image: {_sizes(values, self.calibration)}")
        change = self.calibration.change(values, mask)
        seen = np.sqrt((change**2).sum(axis=-1)) > SEEN
        shape = self.calibration.reconstruct(values, mask=mask)
        warnings = self._doubts(values, change, seen)
        if seen.mean() < LEAST_SEEN:
            return _nothing(shape, warnings)
        if not shape.height_mm.max() > 0:
            return _nothing(shape, [*warnings, "colours change, but nothing is pressed in"])
        found = self._pressure(shape.height_mm) if pressure else None
        if found is None:
            contact = np.asarray(shape.height_mm > 0.5 * shape.height_mm.max())
        else:
            contact = _finer(found.contact, shape.height_mm.shape)
        warnings += self._at_border(shape.height_mm)
        pitch_mm = self.calibration.setup.mm_per_px
        return PressShape(
            shape.height_mm,
            normals(shape.p, shape.q),
            contact,
            float(shape.height_mm.max()),
            float(contact.sum() * pitch_mm**2),
            found,
            tuple(warnings),
        )

    def _pressure(self, height_mm: Array) -> SurfacePressure:
        setup = self.calibration.setup
        assert setup.thickness_mm is not None  # of every calibration
        rows, columns = height_mm.shape
        coarser = max(1.0, max(rows, columns) / COARSE_PX)
        small = resize_area(height_mm[..., None], round(rows / coarser), round(columns / coarser))[..., 0]
        return pressure_under(
            small,
            poisson=setup.poisson,
            thickness_mm=setup.thickness_mm,
            pitch_mm=setup.mm_per_px * columns / small.shape[1],
        )

    def _doubts(self, image: Array, change: Array, seen: Mask) -> list[str]:
        """What of a picture the calibration knows nothing of."""
        if seen.mean() < LEAST_SEEN:
            return ["nothing touches the gel: the picture is that of the untouched gel"]
        found = []
        clipped = float((image[seen] >= FULL).any(axis=-1).mean())
        if clipped > MOST_CLIPPED:
            found.append(
                f"{clipped:.0%} of the pixels that change are at full scale and say nothing: expose for less"
            )
        tree = cKDTree(self.kept.taught)
        far, _ = tree.query(change[seen][:: max(1, int(seen.sum()) // 4000)])
        strange = float((far > float(self.kept.about["strange_beyond"])).mean())
        if strange > MOST_STRANGE:
            found.append(
                f"{strange:.0%} of the pixels that change have colours that no ball showed, and heights "
                "there are guesses. Is it the same sensor and exposure? Are there markers, or slopes steeper "
                "than the balls have?"
            )
        return found

    def _at_border(self, height_mm: Array) -> list[str]:
        """A contact that the border of the picture cuts, where height is taken to be 0."""
        near = np.concatenate([height_mm[2], height_mm[-3], height_mm[:, 2], height_mm[:, -3]])
        if near.max() > FLAT_SHARE * height_mm.max():
            return [
                "the contact reaches the border of the picture, where height is taken to be 0: it is too low"
            ]
        return []


def _nothing(shape: ReconstructedShape, warnings: list[str]) -> PressShape:
    untouched = np.zeros(shape.height_mm.shape, dtype=bool)
    return PressShape(shape.height_mm, normals(shape.p, shape.q), untouched, 0.0, 0.0, None, tuple(warnings))


def _finer(contact: Mask, shape: tuple[int, ...]) -> Mask:
    """A mask on more pixels: each takes the value of the coarse one it lies in."""
    rows = np.arange(shape[0]) * contact.shape[0] // shape[0]
    columns = np.arange(shape[1]) * contact.shape[1] // shape[1]
    return np.asarray(contact[np.ix_(rows, columns)])


def _shift(before: Array, now: Array) -> tuple[int, int]:
    """Rows and columns by which fine structure has moved, by phase correlation; 0 where none stands out."""
    spectra = [np.fft.rfft2(image - gaussian_filter(image, 4.0)) for image in (before, now)]
    cross = spectra[1] * spectra[0].conj()
    peak = np.fft.irfft2(cross / np.maximum(np.abs(cross), 1e-12), s=before.shape)
    row, column = np.unravel_index(int(peak.argmax()), peak.shape)
    if peak.max() < 8 * peak.std():
        return 0, 0
    rows, columns = before.shape
    return int((row + rows // 2) % rows - rows // 2), int((column + columns // 2) % columns - columns // 2)


def _sizes(given: Array, calibration: LabCalibration) -> str:
    rows, columns, channels = calibration.background.shape
    got: Any = given.shape
    if given.ndim == 3:
        got = f"{given.shape[1]} x {given.shape[0]} pixels of {given.shape[2]} channels"
    return f"must be {columns} x {rows} pixels of {channels} channels, as the calibration is, got {got}"
