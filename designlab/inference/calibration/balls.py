"""A sensor calibrated on pictures of ball presses, with its errors on balls left out."""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from designlab.core.images import ImageError, read_picture
from designlab.core.progress import Work, silent
from designlab.core.types import Array, Progress
from designlab.inference.calibration.verdict import FitVerdict
from designlab.measurement import MeasurementError, load_measurement
from designlab.reconstruction.ball_samples import Setup, known_gel, smoothing_for
from designlab.reconstruction.balls import BallPress, find_contact_circle
from designlab.reconstruction.calibration_file import Kept
from designlab.reconstruction.drift import Untouched, drift_between
from designlab.reconstruction.gel_fit import GelFit
from designlab.reconstruction.lab import (
    LabCalibration,
    LeftOut,
    calibrate,
    left_out_of_each,
    refine_centres,
    suited,
)
from designlab.reconstruction.markers import Markers, without
from designlab.reconstruction.membrane import Membrane
from designlab.reconstruction.methods import Kernel, Method

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".npy", ".bmp", ".webp")
COARSE = Kernel(ridge=3e-3, colour_scale=1.5, features=300)  # moves centres once more
FEWEST, ENOUGH = 4, 8  # balls
NORMAL_DEG = (5.0, 10.0)  # error on balls left out: doubtful, failed
ROUNDS_RIMS_PX = 1.5  # smoothing from which a map of its own for the rims of contacts is worth while
MOST_SEEN = 0.85  # of the ball's radius, that a circle which was found is taken to have
SPREAD_PX = 1.3  # contact radii around a ball whose colours it taught
TAUGHT = 4000  # samples of colour that are kept
STRANGE_QUANTILE, STRANGE_MARGIN = 0.995, 1.25
"""A colour is strange further from those taught than nearly all of a ball left out are, and this much."""
WORST_TIMES = 1.5  # error of a ball over the median from which it is called out


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


@dataclass(frozen=True, eq=False)
class BallCalibration:
    """A calibration on balls.

    Attributes
    ----------
    kept : Kept
        What the calibration file holds.
    balls : BallSet
        What it was made from, centres refined.
    errors : tuple of LeftOut
        Errors on each ball of a calibration on the others.
    gel : GelFit or None
        Fit of thickness and bias of the circles.
    """

    kept: Kept
    balls: BallSet
    errors: tuple[LeftOut, ...]
    gel: GelFit | None

    @property
    def mean(self) -> LeftOut:
        """Means over the balls."""
        return LeftOut(*(float(np.mean(values)) for values in zip(*self.errors, strict=True)))

    def verdict(self) -> FitVerdict:
        """Whether it is worth using, and why not."""
        reasons: list[tuple[bool, str]] = []
        if len(self.errors) < ENOUGH:
            reasons.append(
                (False, f"{len(self.errors)} balls teach little: press one at {ENOUGH} places or more")
            )
        error = self.mean.contact_deg
        if error > NORMAL_DEG[0]:
            reasons.append(
                (
                    error > NORMAL_DEG[1],
                    f"normals on balls left out are off by {error:.1f} deg: are the ball's diameter "
                    "(--ball-mm), the scale (--mm-per-px) and the circles right?",
                )
            )
        failed = [text for fails, text in reasons if fails]
        others = [text for fails, text in reasons if not fails]
        return FitVerdict("failed" if failed else "doubtful" if others else "good", (*failed, *others))

    def odd(self) -> list[tuple[str, LeftOut, str]]:
        """Balls that fit worst: file, errors, and the likely reason."""
        usual = float(np.median([one.contact_deg for one in self.errors]))
        found = []
        for file, ball, one in zip(self.balls.files, self.balls.balls, self.errors, strict=True):
            if one.contact_deg > WORST_TIMES * usual:
                found.append((file, one, _reason(ball)))
        return sorted(found, key=lambda row: -row[1].contact_deg)


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
        image = _plain(self._laid_out(image), self.markers)
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
        found = replace(found, radius_mm=diameter_mm / 2)
        if self.membrane is None:
            return found
        radius_px = diameter_mm / 2 / self.membrane.mm_per_px
        return found.moved(self.membrane.axis_of(found.centre_px, radius_px))

    def _laid_out(self, image: Array) -> Array:
        return image if self.membrane is None else np.asarray(self.membrane.laid_out(image))


def _on_grid(
    membrane: Membrane, centre_px: tuple[float, float], radius_px: float
) -> tuple[tuple[float, float], float]:
    """A circle of the picture on the grid of a membrane: its middle, and the radius of its area."""
    away = np.hypot(membrane.columns - centre_px[0], membrane.rows - centre_px[1])
    rows, columns = np.nonzero(membrane.seen & (away < radius_px))
    if not rows.size:
        return (-1.0, -1.0), radius_px  # beside the gel, which `lab.calibrate` refuses by name
    return (float(columns.mean()), float(rows.mean())), float(np.sqrt(rows.size / np.pi))


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


def calibrate_balls(
    balls: BallSet,
    *,
    thickness_mm: float | None = None,
    poisson: float | None = None,
    method: Method | None = None,
    progress: Progress = silent,
) -> BallCalibration:
    """Calibrate on balls, and measure the error on each by a calibration on the others.

    Parameters
    ----------
    balls : BallSet
        What `load_balls` read.
    thickness_mm, poisson : float, optional
        Of the gel, where they are known; the thickness is fitted, Poisson's ratio usual when absent.
    method : Method, optional
        See `reconstruction.methods`. When absent, what errs least on the balls left out: smoothing by the
        pictures' noise with the kernel that suits it, or what serves most sensors.
    progress : callable, optional
        Called with what is being done, and how much of everything is done in thousandths.
    """
    parts = {"centres of the balls": 14, "gel": 4, "balls left out": 6, "calibration": 2}
    work = Work(progress, parts)
    setup = Setup(balls.radius_mm, balls.mm_per_px, thickness_mm=thickness_mm)
    if poisson is not None:
        setup = setup._replace(poisson=poisson)
    work.begin("centres of the balls")
    membrane = balls.membrane
    refined = refine_centres(balls.balls, balls.background, setup, membrane=membrane)
    refined = refine_centres(refined, balls.background, setup, method=COARSE, rounds=2, membrane=membrane)
    work.step(parts["centres of the balls"])
    work.begin("gel")
    known, setup, gel = known_gel(refined, balls.background, setup, membrane)
    work.step(parts["gel"])
    work.begin("balls left out")
    ways: list[tuple[Setup, Method]] = []
    if method is None:
        smoothing_px = smoothing_for(known, balls.background)
        detail = setup.detail if smoothing_px >= ROUNDS_RIMS_PX else 0.0
        by_noise = setup._replace(smoothing_px=smoothing_px, detail=detail)
        ways += [(setup, Kernel()), suited(known, balls.background, by_noise, membrane=membrane)]
    else:
        ways.append((setup, method))
    tried = []
    for each in ways:
        left_out = left_out_of_each(known, balls.background, each[0], method=each[1], membrane=membrane)
        tried.append((float(np.mean([error.contact_deg for error in left_out])), left_out, each))
        work.step(parts["balls left out"] / len(ways))
    _, errors, (setup, method) = min(tried, key=lambda one: one[0])
    work.begin("calibration")
    calibration = calibrate(known, balls.background, setup, method=method, membrane=membrane)
    work.end()
    mean = LeftOut(*(float(np.mean(values)) for values in zip(*errors, strict=True)))
    about = {
        "balls": len(known),
        "ball_mm": 2 * balls.radius_mm,
        "normal_error_deg": mean.contact_deg,
        "height_error_um": 1000 * mean.height_mm,
        **({} if balls.markers is None else {"markers": balls.markers.plain()}),
    }
    kept = kept_of(calibration, known, about)._replace(membrane=membrane)
    return BallCalibration(kept, balls._replace(balls=known), tuple(errors), gel)


def kept_of(calibration: LabCalibration, balls: Sequence[BallPress], about: Mapping[str, Any]) -> Kept:
    """What a file holds of a calibration on balls: also their colours, and how their pictures differ from it.

    Parameters
    ----------
    calibration : LabCalibration
        Made from the balls.
    balls : sequence of BallPress
        At least two.
    about : mapping
        Plain data about it.
    """
    taught = [_taught(calibration, ball) for ball in balls]
    told = {
        **about,
        "strange_beyond": _strange_beyond(taught),
        "usual_gain": _usual_gain(balls, calibration.background),
    }
    return Kept(calibration, np.concatenate(taught), told)


def _taught(calibration: LabCalibration, ball: BallPress) -> Array:
    """Changes of colour on and around a ball, thinned."""
    rows, columns = np.indices(calibration.background.shape[:2])
    near = np.hypot(columns - ball.centre_px[0], rows - ball.centre_px[1])
    change = calibration.change(ball.image)[near < SPREAD_PX * ball.contact_radius_px]
    return np.asarray(change[:: max(1, len(change) * 16 // TAUGHT)])


def _strange_beyond(taught: Sequence[Array]) -> float:
    """Distance from all colours taught beyond which a colour is strange, by balls left out in turn."""
    far = []
    for number, own in enumerate(taught):
        others = np.concatenate([*taught[:number], *taught[number + 1 :]])
        far.append(cKDTree(others).query(own)[0])
    return STRANGE_MARGIN * float(np.quantile(np.concatenate(far), STRANGE_QUANTILE))


def _usual_gain(balls: Sequence[BallPress], background: Array) -> list[float]:
    """Brightness of the gel beside the balls over that of the untouched gel, which the maps have learned."""
    untouched = Untouched.of(background)
    found = [drift_between(untouched, np.asarray(ball.image, dtype=float), place=False) for ball in balls]
    known = [each.gain for each in found if each.known]
    return [float(value) for value in np.median(known, axis=0)] if known else [1.0] * background.shape[-1]


def _reason(ball: BallPress) -> str:
    """Why a ball may fit badly, as far as its picture tells."""
    rows, columns = ball.image.shape[:2]
    column, row = ball.centre_px
    reach = 2 * ball.contact_radius_px
    if min(column, row, columns - 1 - column, rows - 1 - row) < reach:
        return "it lies at the edge of the picture"
    if (ball.image >= 1.0).any(axis=-1).mean() > 0.001:
        return "parts of the picture are at full scale"
    return "its circle may be off, or light there differs from that of the other balls"


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


def _plain(image: Array, markers: Markers | None) -> Array:
    """A press without the markers."""
    return image if markers is None else without(image, markers.followed(image).covered)


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
