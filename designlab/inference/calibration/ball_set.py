"""Pictures of ball presses, from a folder or a measurement, on the membrane of a design if one is given."""

import csv
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from designlab.core.images import ImageError, read_picture
from designlab.core.types import Array, Mask
from designlab.measurement import MeasurementError, load_measurement
from designlab.reconstruction.balls import BallPress, find_contact_circle
from designlab.reconstruction.markers import Markers, without
from designlab.reconstruction.membrane import Membrane

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".npy", ".bmp", ".webp")
FEWEST, ENOUGH = 4, 8  # balls
_FEWEST_POINTS = 10  # of a circle on the gel
MOST_SEEN = 0.85  # of the ball's radius, that a circle which was found is taken to have


class BallSet(NamedTuple):
    """Pictures of ball presses.

    Attributes
    ----------
    files : tuple of str
        Their files.
    balls : list of BallPress
        Pictures, centres and circles.
    background : array, shape (rows, columns, channels)
        The untouched gel.
    radius_mm, mm_per_px : float
        Radius of the ball, that in the middle where balls differ, and size of a pixel at the gel.
    notes : tuple of str
        How files were understood.
    markers : Markers or None
        Printed markers of the gel, which the pictures are without.
    membrane : Membrane or None
        The membrane on whose grid the pictures are laid out; None where they are as they were taken.
    """

    files: tuple[str, ...]
    balls: list[BallPress]
    background: Array
    radius_mm: float
    mm_per_px: float
    notes: tuple[str, ...] = ()
    markers: Markers | None = None
    membrane: Membrane | None = None


def load_balls(
    folder: str | Path,
    *,
    ball_mm: float | None = None,
    mm_per_px: float | None = None,
    membrane_of: Callable[[tuple[int, ...]], Membrane] | None = None,
) -> BallSet:
    """Read ball presses: a measurement folder, or a folder of pictures with a background among them.

    In a folder of pictures the background's name begins with ``background``; of several the mean is taken.
    ``balls.csv`` may hold the circles (file, centre_column_px, centre_row_px, contact_radius_px) and, where
    balls differ, their diameters (ball_mm); circles that it does not hold are found.

    Parameters
    ----------
    folder : path
        The folder.
    ball_mm : float, optional
        Diameter of the ball; that of the measurement file when absent.
    mm_per_px : float, optional
        Size of a pixel at the gel; that of the measurement file, or of the membrane, when absent.
    membrane_of : callable, optional
        Gives the membrane, from the shape of the pictures, on whose grid they are laid: for domes, and for
        lenses that bend. See `from_model.membrane_of`.

    Raises
    ------
    MeasurementError
        If something is missing; the text says what, and how to give it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MeasurementError(f"{folder}: no such folder")
    if (folder / "measurement.toml").is_file():
        return _of_measurement(folder, ball_mm, mm_per_px, membrane_of)
    return _of_pictures(folder, ball_mm, mm_per_px, membrane_of)


class _Stage:
    """Makes ball presses of pictures: lays them on the membrane, leaves markers out, finds circles."""

    def __init__(
        self,
        background: Array,
        mm_per_px: float | None,
        membrane_of: Callable[[tuple[int, ...]], Membrane] | None,
    ) -> None:
        self.membrane = None if membrane_of is None else membrane_of(background.shape)
        self.mm_per_px = mm_per_px if self.membrane is None else self.membrane.mm_per_px
        self.looked_for = 0
        self.background, self.markers = _unmarked(self._laid_out(background))

    def press(
        self,
        path: Path,
        image: Array,
        circle: tuple[tuple[float, float], float] | None,
        diameter_mm: float,
    ) -> BallPress:
        """A press with its circle, as stated in pixels of the picture, or as found."""
        image, covered = _plain(self._laid_out(image), self.markers)
        if circle is None:
            self.looked_for += 1
            found = _found(path, image, self.background)
            if self.mm_per_px is not None:
                # the circle one sees is larger than the contact, whose size is fitted
                most = MOST_SEEN * diameter_mm / 2 / self.mm_per_px
                found = replace(found, contact_radius_px=min(found.contact_radius_px, most))
        elif self.membrane is None:
            found = BallPress(image, *circle)
        else:
            found = BallPress(image, *_on_grid(self.membrane, *circle))
        found = replace(found, radius_mm=diameter_mm / 2, file=str(path), covered=covered)
        if self.membrane is None:
            return found
        radius_px = diameter_mm / 2 / self.membrane.mm_per_px
        return found.moved(self.membrane.axis_of(found.centre_px, radius_px))

    def _laid_out(self, image: Array) -> Array:
        return image if self.membrane is None else np.asarray(self.membrane.laid_out(image))


def _on_grid(
    membrane: Membrane, centre_px: tuple[float, float], radius_px: float
) -> tuple[tuple[float, float], float]:
    """A circle of the picture on the grid of a membrane: its middle, and the radius of its area.

    Within the circle the picture is taken for an even one, shifted, turned and stretched; so a circle that
    the border cuts keeps its middle and its size.
    """
    away = np.hypot(membrane.columns - centre_px[0], membrane.rows - centre_px[1])
    inside = membrane.seen & (away < radius_px)
    rows, columns = np.nonzero(inside)
    if rows.size < _FEWEST_POINTS or min(np.ptp(rows), np.ptp(columns)) == 0:
        return (-1.0, -1.0), radius_px  # beside the gel, which `lab.calibrate` refuses by name
    seen = np.column_stack([membrane.columns[inside], membrane.rows[inside]]) - centre_px
    places = np.column_stack([np.ones(rows.size), columns, rows])
    shift, *stretch = np.linalg.lstsq(places, seen)[0]
    middle = np.linalg.solve(np.transpose(stretch), -shift)
    radius = radius_px / math.sqrt(abs(np.linalg.det(stretch)))
    return (float(middle[0]), float(middle[1])), radius


def _of_measurement(
    folder: Path,
    ball_mm: float | None,
    mm_per_px: float | None,
    membrane_of: Callable[[tuple[int, ...]], Membrane] | None,
) -> BallSet:
    measurement = load_measurement(folder)
    stated_scale = measurement.mm_per_px if mm_per_px is None else mm_per_px
    if membrane_of is None:
        _needed(folder, "mm_per_px", "--mm-per-px", stated_scale)
    untouched = [frame for frame in measurement.frames if frame.kind == "background" and frame.leds is None]
    if not untouched:
        raise MeasurementError(f"{folder}: needs a frame of kind background, with all LEDs on")
    # Presses of a stated depth judge a calibration, and do not teach it.
    frames = [
        frame
        for frame in measurement.frames
        if frame.kind == "press" and (frame.probe or "").startswith("sphere") and frame.depth_mm is None
    ]
    sizes = [
        float((frame.probe or "").partition(":")[2] or 4)
        if ball_mm is None
        else _needed(folder, "diameter of the ball", "--ball-mm", ball_mm)
        for frame in frames
    ]
    pictures = [np.asarray(measurement.image(frame), dtype=float) for frame in untouched]
    stage = _Stage(np.asarray(np.mean(pictures, axis=0)), stated_scale, membrane_of)
    balls = []
    for frame, size in zip(frames, sizes, strict=True):
        circle = None
        if frame.centre_px is not None and frame.contact_radius_px is not None:
            circle = frame.centre_px, frame.contact_radius_px
        image = np.asarray(measurement.image(frame), dtype=float)
        balls.append(stage.press(folder / frame.file, image, circle, size))
    notes = (
        f"{len(balls)} balls of {_range(sizes)} mm; {stage.looked_for} circles found in the pictures",
        *_marked(stage.markers),
    )
    files = tuple(frame.file for frame in frames)
    return _checked(folder, _set(files, balls, stage, notes))


def _of_pictures(
    folder: Path,
    ball_mm: float | None,
    mm_per_px: float | None,
    membrane_of: Callable[[tuple[int, ...]], Membrane] | None,
) -> BallSet:
    pictures = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURES)
    untouched = [path for path in pictures if path.stem.lower().startswith("background")]
    if not untouched:
        raise MeasurementError(
            f"{folder}: needs a picture of the untouched gel whose name begins with 'background'"
        )
    stated = _stated(folder / "balls.csv")
    names = [path for path in pictures if path not in untouched and (not stated or path.name in stated)]
    nothing = Stated(None, None)
    sizes = [
        _needed(
            folder, "diameter of the ball", "--ball-mm", stated.get(path.name, nothing).ball_mm or ball_mm
        )
        for path in names
    ] or [_needed(folder, "diameter of the ball", "--ball-mm", ball_mm)]
    if membrane_of is None:
        _needed(folder, "size of a pixel at the gel", "--mm-per-px", mm_per_px)
    background = _mean_of(untouched)
    stage, balls = _Stage(background, mm_per_px, membrane_of), []
    for path, size in zip(names, sizes, strict=False):
        image = _of_size(path, _read(path), untouched[0].name, background.shape)
        balls.append(stage.press(path, image, stated.get(path.name, nothing).circle, size))
    notes = (
        f"{len(balls)} balls of {_range(sizes)} mm; "
        f"{len(balls) - stage.looked_for} circles from balls.csv, {stage.looked_for} found in the pictures",
        *([f"the background is the mean of {len(untouched)} pictures"] if len(untouched) > 1 else []),
        *_marked(stage.markers),
    )
    return _checked(folder, _set(tuple(path.name for path in names), balls, stage, notes))


def _set(
    files: tuple[str, ...],
    balls: list[BallPress],
    stage: _Stage,
    notes: tuple[str, ...],
) -> BallSet:
    """All of a folder, at the scale that was stated, or at that of the membrane."""
    scale = stage.mm_per_px
    assert scale is not None  # was asked for
    radius_mm = float(np.median([ball.radius_mm for ball in balls])) if balls else 0.0
    return BallSet(files, balls, stage.background, radius_mm, scale, notes, stage.markers, stage.membrane)


def _found(path: Path, image: Array, background: Array) -> BallPress:
    try:
        circle = find_contact_circle(image, background)
    except ValueError as error:
        raise MeasurementError(
            f"{path}: no ball found: {error}; leave the picture out or give its circle"
        ) from None
    return BallPress(image, circle.centre_px, circle.radius_px)


def _unmarked(background: Array) -> tuple[Array, Markers | None]:
    """The untouched gel without its printed markers, and those."""
    markers = Markers.found_in(background)
    return (background, None) if markers is None else (without(background, markers.covered), markers)


def _plain(image: Array, markers: Markers | None) -> tuple[Array, Mask | None]:
    """A press without the markers, and where it showed them."""
    if markers is None:
        return image, None
    covered = markers.followed(image).covered
    return without(image, covered), covered


def _marked(markers: Markers | None) -> tuple[str, ...]:
    return () if markers is None else (f"{len(markers.places_px)} printed markers found and left out",)


class Stated(NamedTuple):
    """What ``balls.csv`` says of a picture: its circle, and the diameter of its ball (mm)."""

    circle: tuple[tuple[float, float], float] | None
    ball_mm: float | None


def _stated(path: Path) -> dict[str, Stated]:
    """What a ``balls.csv`` says, by file; nothing where there is no such file."""
    if not path.is_file():
        return {}
    found = {}
    with path.open(encoding="utf-8-sig", newline="") as file:
        for number, row in enumerate(csv.DictReader(file), start=2):
            try:
                circle = None
                if "contact_radius_px" in row or "ball_mm" not in row:
                    centre = float(row["centre_column_px"]), float(row["centre_row_px"])
                    circle = centre, float(row["contact_radius_px"])
                found[row["file"]] = Stated(circle, float(row["ball_mm"]) if row.get("ball_mm") else None)
            except (KeyError, TypeError, ValueError):
                raise MeasurementError(
                    f"{path}: line {number}: needs file, centre_column_px, centre_row_px and "
                    f"contact_radius_px as numbers, or file and ball_mm, got {dict(row)}"
                ) from None
    return found


def _range(sizes: Sequence[float]) -> str:
    """One size, or the smallest and the largest."""
    low, high = (f"{size:g}" for size in (min(sizes, default=0.0), max(sizes, default=0.0)))
    return low if low == high else f"{low} to {high}"


def _mean_of(paths: Sequence[Path]) -> Array:
    """Mean of pictures of the untouched gel: one picture's noise would be in the change of every press."""
    total = _read(paths[0])
    for path in paths[1:]:
        total = total + _of_size(path, _read(path), paths[0].name, total.shape)
    return total / len(paths)


def _of_size(path: Path, image: Array, like: str, shape: tuple[int, ...]) -> Array:
    """The picture, if it has the shape that one of its folder has."""
    if image.shape != shape:
        raise MeasurementError(
            f"{path}: must have the size of {like}, {shape[1]} x {shape[0]} pixels, got "
            f"{image.shape[1]} x {image.shape[0]}"
        )
    return image


def _read(path: Path) -> Array:
    try:
        return np.asarray(read_picture(path), dtype=float)
    except ImageError as error:
        raise MeasurementError(str(error)) from None


def _needed(folder: Path, what: str, option: str, value: float | None) -> float:
    if value is None:
        raise MeasurementError(f"{folder}: {what} is unknown; give it with {option}")
    if not 0 < value < 1000:
        raise MeasurementError(f"{option}: must be above 0 and below 1000, got {value:g}")
    return value


def _checked(folder: Path, found: BallSet) -> BallSet:
    if len(found.balls) < FEWEST:
        raise MeasurementError(
            f"{folder}: needs {FEWEST} ball presses or more, {ENOUGH} are better, got {len(found.balls)}"
        )
    return found
