"""Shape from the pictures of one's own sensor, by a calibration on balls, with what speaks against it."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from designlab.core.types import Array, Mask
from designlab.mechanics.surface_pressure import SurfacePressure
from designlab.mechanics.surface_shear import FEWEST, SurfaceShear, shear_under
from designlab.reconstruction.calibration_file import Kept, load_calibration
from designlab.reconstruction.contact_pressure import EFFORT, Mode, PressureSolver, at_pixels, contact_of
from designlab.reconstruction.drift import (
    LEAST_UNTOUCHED,
    Drift,
    Untouched,
    changed_since,
    drift_between,
    levelled,
)
from designlab.reconstruction.height import border_surface
from designlab.reconstruction.lab import LabCalibration
from designlab.reconstruction.markers import Markers, MovedMarkers, on_cells, without
from designlab.reconstruction.press_shape import MarkerShift, PressShape

if TYPE_CHECKING:
    from designlab.reconstruction.video import VideoMaps

ASKED: dict[Mode, int] = {"accurate": 4000, "video": 500}  # pixels whose colours are compared
FULL = 0.995  # of full scale from which a pixel is clipped
MOST_CLIPPED = 0.05  # share of the pixels that change
MOST_STRANGE = 0.1  # likewise, of colours that the balls did not show
SEEN = 0.25  # change of colour, in spreads, from which a pixel counts as changed
LEAST_SEEN = 0.002  # share of the picture; below it nothing touches
OTHER_STRANGE = 0.5  # of the pixels that change, above which a picture is none of the sensor's
# Standard error over the shear, above which it is rough, and below which there is any.
ROUGH, CLEAR = 0.12, 0.5
LOST_MARKERS = 0.3  # share of the markers, that a press may hide
FLAT_SHARE = 0.25  # height beyond which the border of the picture is touched


@dataclass(frozen=True, eq=False)
class Reconstructor:
    """Turns pictures of one sensor into shapes.

    Parameters
    ----------
    kept : Kept
        Calibration, and what the balls taught.
    mode : str
        ``accurate``, or ``video``: some hundredths of a second a picture, by a table of the maps, with
        heights found on cells as large as the smoothing of the colours; arrays have single precision.

    Examples
    --------
    >>> import designlab as dl
    >>> reconstructor = dl.Reconstructor.load("calibrated/calibration.npz")  # doctest: +SKIP
    >>> shape = reconstructor(image)  # doctest: +SKIP
    """

    kept: Kept
    mode: Mode = "accurate"

    def __post_init__(self) -> None:
        if self.mode not in EFFORT:
            raise ValueError(f"mode: must be {' or '.join(EFFORT)}, got {self.mode!r}")

    @classmethod
    def load(cls, path: str | Path, *, mode: Mode = "accurate") -> Self:
        """Read the calibration that ``designlab calibrate --balls`` wrote.

        Parameters
        ----------
        path : path
            The file ``calibration.npz``.
        mode : str
            ``accurate`` or ``video``, see the class. The table of ``video`` takes some seconds to make.

        Raises
        ------
        ValueError
            If it is no such file, there is no such mode, or ``video`` finds other than three colours.
        """
        made = cls(load_calibration(path), mode)
        if mode == "video":
            made.video.warm_up()
        return made

    @cached_property
    def video(self) -> "VideoMaps":
        """The maps as a table, which mode ``video`` reads."""
        from designlab.reconstruction.video import VideoMaps

        return VideoMaps(self.calibration, self.kept.taught)

    @cached_property
    def _untouched(self) -> Untouched:
        return Untouched.of(self.calibration.background)

    @cached_property
    def _taught(self) -> cKDTree:
        return cKDTree(self.kept.taught)

    @cached_property
    def markers(self) -> Markers | None:
        """Printed markers of the untouched gel; None of a gel without them."""
        plain = self.kept.about.get("markers")
        return None if plain is None else Markers.from_plain(plain, self.calibration.background.shape)

    @cached_property
    def _unseen(self) -> Mask | None:
        """Cells of mode ``video`` that no picture shows; None where pictures are taken as they are."""
        if self.kept.membrane is None:
            return None
        return on_cells(~self.kept.membrane.seen, self.video.cell_px)

    @property
    def calibration(self) -> LabCalibration:
        """The maps, on the untouched gel that is in use."""
        return self.kept.calibration

    @cached_property
    def _solver(self) -> PressureSolver:
        rows, columns = self.calibration.background.shape[:2]
        return PressureSolver(self.calibration.setup, (rows, columns))

    def on(self, background: ArrayLike) -> Self:
        """Return the same for another picture of the untouched gel, such as today's.

        Raises
        ------
        ValueError
            If it has another size than the calibration, or lacks its markers.
        """
        given = np.asarray(self._taken(background, "background"), dtype=float)
        about = self.kept.about
        if self.markers is not None:
            found = Markers.found_in(given)
            if found is None:
                raise ValueError("background: shows no markers, and the calibration's gel has them")
            given, about = without(given, found.covered), {**about, "markers": found.plain()}
        calibration = replace(self.calibration, background=given)
        made = replace(self, kept=self.kept._replace(calibration=calibration, about=about))
        if "video" in vars(self):
            vars(made)["video"] = self.video.on(calibration)
        return made

    def laid_out(self, image: ArrayLike) -> NDArray[Any]:
        """A picture as heights are laid out: on the grid of the membrane, where the calibration has one."""
        image = np.asarray(image)
        return image if self.kept.membrane is None else self.kept.membrane.laid_out(image)

    def _taken(self, image: ArrayLike, name: str) -> NDArray[Any]:
        """A picture of the right size, laid out."""
        image, membrane = np.asarray(image), self.kept.membrane
        size = self.calibration.background.shape if membrane is None else membrane.picture_px
        channels = self.calibration.background.shape[-1]
        if image.shape != (*size[:2], channels):
            raise ValueError(f"{name}: {_sizes(image, (size[0], size[1], channels))}")
        return self.laid_out(image)

    def drift_of(self, image: ArrayLike) -> Drift:
        """Brightness and place of a picture against the untouched gel in use, beside a press."""
        return drift_between(self._untouched, np.asarray(self.laid_out(image), dtype=float))

    def drift(self, background: ArrayLike) -> tuple[str, ...]:
        """What has changed between the calibration's untouched gel and another picture of it."""
        before, now = (each.calibration.background for each in (self, self.on(background)))
        return changed_since(before, now)

    def __call__(self, image: ArrayLike, *, mask: Mask | None = None, pressure: bool = True) -> PressShape:
        """Reconstruct one picture.

        Parameters
        ----------
        image : array, shape (rows, columns, channels)
            Values as the calibration's pictures have them, 0 to 1.
        mask : bool array, shape (rows, columns), optional
            Pixels, as `laid_out`, that show the bare membrane; markers left out. Mode ``video`` takes none.
        pressure : bool
            Whether to find pressure and contact (about a second; in mode ``video`` some 20 ms); without,
            contact is where the gel is pressed in by more than half of the depth.

        Raises
        ------
        ValueError
            If the picture has another size than the calibration, or shows another sensor.
        """
        video = self.mode == "video"
        values: NDArray[Any] = np.asarray(self._taken(image, "image"), dtype=np.float32 if video else float)
        if video and mask is not None:
            raise ValueError("mask: mode video takes none, and finds printed markers itself")
        cell_px = self.video.cell_px if video else 1
        moved, free, filled = None, None, None
        covered = self._unseen if video else None
        unseen = None
        if not video and self.kept.membrane is not None:
            unseen = ~self.kept.membrane.seen
            mask = ~unseen if mask is None else mask & ~unseen
        if self.markers is not None:
            moved = self.markers.followed(values, cell_px=cell_px)
            filled = moved.covered
            if video:
                free = _of_pixels(~moved.covered, cell_px, values.shape)
                covered = moved.covered if covered is None else covered | moved.covered
            else:
                # nothing is filled in from pixels that are not to be used
                values = without(values, filled if mask is None else filled | ~mask)
        drift = drift_between(self._untouched, values, place=not video, free=free)
        used, warnings = levelled(values, drift, self.kept.about.get("usual_gain"))
        change = self.video.change(used, covered) if video else self.calibration.change(used, mask)
        seen = np.einsum("rcd,rcd->rc", change, change) > SEEN**2
        warnings += self._doubts(values[::cell_px, ::cell_px], change, seen, drift)
        shape = (
            self.video.shape(change, filled)
            if video
            else self.calibration.reconstruct(used, mask=mask, unseen=unseen, filled=filled)
        )
        height = shape.height_mm
        pressed_in = bool(height.max() > 0)
        if not pressed_in and seen.mean() >= LEAST_SEEN:
            warnings.append("colours change, but nothing is pressed in")
        if not pressed_in or seen.mean() < LEAST_SEEN:
            nowhere = np.zeros(height.shape, dtype=bool)
            shift = None if moved is None else self._shift(moved, height, None)
            return PressShape(height, shape.normals(), nowhere, 0.0, 0.0, None, tuple(warnings), drift, shift)
        # The integration holds the border at 0; the gel under this pressure has another height there. What
        # touches near the border is worth a second look.
        efforts: tuple[Mode, ...] = ("video",) if video else ("video", "accurate" if pressure else "video")
        for effort in efforts:
            pressed = self._solver.under(height, effort)
            beyond = at_pixels(border_surface(pressed.surface_mm), height.shape).astype(height.dtype)
            height = shape.height_mm + beyond
        found = pressed if pressure else None
        if found is None:
            contact = np.asarray(height > 0.5 * height.max())
        else:
            smoothing_px = max(self.calibration.setup.smoothing_px, cell_px / 2)
            contact = contact_of(found, height.shape, EFFORT[self.mode].touched, smoothing_px)
        shift = None if moved is None else self._shift(moved, height, found)
        if moved is not None and self.markers is not None:
            warnings += _lost(moved, self.markers)
        if shift is not None and shift.shear is not None:
            warnings += _rough(shift.shear)
        return PressShape(
            height,
            shape.raised(beyond).normals(),
            contact,
            float(height.max()),
            float(contact.sum() * self.calibration.setup.mm_per_px**2),
            found,
            (*warnings, *self._at_border(height)),
            drift,
            shift,
        )

    def _shift(self, moved: MovedMarkers, height_mm: Array, pressure: SurfacePressure | None) -> MarkerShift:
        """Displacements in mm, without what the camera sees of markers being lifted, and their shear."""
        rows, columns = height_mm.shape
        pitch, up = self.calibration.setup.mm_per_px, np.array([1.0, -1.0])
        middle = np.array([(columns - 1) / 2, (rows - 1) / 2])
        places = (moved.places_px - middle) * up * pitch
        shifts = moved.moved_px * up * pitch
        sight = self.kept.about.get("sight")
        if sight is None or not len(places):
            return MarkerShift(places, shifts, None)
        now = np.rint(moved.places_px + moved.moved_px).astype(int)
        lifted = height_mm[np.clip(now[:, 1], 0, rows - 1), np.clip(now[:, 0], 0, columns - 1)]
        slope, offset = np.array(sight["slope_per_mm"]), np.array(sight["slope"])
        shifts = shifts + (slope * (places + shifts) + offset) * lifted[:, None]
        shear = None
        if pressure is not None and len(places) >= FEWEST:
            shear = shear_under(places, shifts, pressure)
        return MarkerShift(places, shifts, shear)

    def _doubts(self, image: Array, change: Array, seen: Mask, drift: Drift) -> list[str]:
        """What of a picture the calibration knows nothing of; a picture of another sensor is refused."""
        if seen.mean() < LEAST_SEEN:
            return ["nothing touches the gel: the picture is that of the untouched gel"]
        found = []
        clipped = float((image[seen] >= FULL).any(axis=-1).mean())
        if clipped > MOST_CLIPPED:
            found.append(
                f"{clipped:.0%} of the pixels that change are at full scale and say nothing: expose for less"
            )
        some = change[seen][:: max(1, int(seen.sum()) // ASKED[self.mode])]
        far, _ = self._taught.query(some)
        strange = float((far > float(self.kept.about["strange_beyond"])).mean())
        if strange > OTHER_STRANGE and drift.untouched < LEAST_UNTOUCHED:
            raise ValueError(
                f"image: shows another sensor or another light: no ball showed {strange:.0%} of its colours, "
                f"and only {drift.untouched:.0%} of it looks like the untouched gel. Use the calibration of "
                "this sensor, or make one with `designlab calibrate --balls`"
            )
        if strange > MOST_STRANGE:
            found.append(
                f"{strange:.0%} of the pixels that change have colours that no ball showed, and heights "
                "there are guesses. Is it the same sensor and exposure? Are there markers, or slopes steeper "
                "than the balls have?"
            )
        return found

    def _at_border(self, height_mm: Array) -> list[str]:
        """A contact that the border of the picture cuts."""
        near = np.concatenate([height_mm[2], height_mm[-3], height_mm[:, 2], height_mm[:, -3]])
        if near.max() > FLAT_SHARE * height_mm.max():
            return [
                "the contact reaches the border of the picture: it is too low, since nobody sees what "
                "presses beyond"
            ]
        return []


def _of_pixels(cells: Mask, cell_px: int, shape: tuple[int, ...]) -> Mask:
    """A mask of cells as one of pixels."""
    return cells.repeat(cell_px, axis=0).repeat(cell_px, axis=1)[: shape[0], : shape[1]]


def _lost(moved: MovedMarkers, markers: Markers) -> list[str]:
    """Say that many markers were not found again."""
    lost = 1 - len(moved.places_px) / len(markers.places_px)
    if lost <= LOST_MARKERS:
        return []
    return [
        f"{lost:.0%} of the markers were not found again, and the shear follows from the others: have they "
        "moved by more than half of their distance, or is the picture blurred?"
    ]


def _rough(shear: SurfaceShear) -> list[str]:
    """Say that there is shear, and how much is not known well."""
    if not ROUGH < shear.relative_error < CLEAR:
        return []
    return [
        f"the shear is known to {shear.relative_error:.0%} only (standard error): it is small beside the "
        "pressing force, or few markers near the contact were found again"
    ]


def _sizes(given: Array, shape: tuple[int, int, int]) -> str:
    rows, columns, channels = shape
    got: Any = given.shape
    if given.ndim == 3:
        got = f"{given.shape[1]} x {given.shape[0]} pixels of {given.shape[2]} channels"
    return f"must be {columns} x {rows} pixels of {channels} channels, as the calibration is, got {got}"
