"""A sensor calibrated on pictures of ball presses, with its errors on balls left out."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from designlab.core.images import ImageError, read_picture
from designlab.core.progress import Work, silent
from designlab.core.types import Array, Progress
from designlab.inference.calibration.verdict import FitVerdict
from designlab.measurement import MeasurementError, load_measurement
from designlab.reconstruction.ball_samples import Setup, known_gel
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
)
from designlab.reconstruction.markers import Markers, without
from designlab.reconstruction.methods import Kernel, Method

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".npy", ".bmp", ".webp")
COARSE = Kernel(ridge=3e-3, colour_scale=1.5, features=300)  # moves centres once more
FEWEST, ENOUGH = 4, 8  # balls
NORMAL_DEG = (5.0, 10.0)  # error on balls left out: doubtful, failed
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
        Radius of the ball, and size of a pixel at the gel.
    notes : tuple of str
        How files were understood.
    markers : Markers or None
        Printed markers of the gel, which the pictures are without.
    """

    files: tuple[str, ...]
    balls: list[BallPress]
    background: Array
    radius_mm: float
    mm_per_px: float
    notes: tuple[str, ...] = ()
    markers: Markers | None = None


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
    folder: str | Path, *, ball_mm: float | None = None, mm_per_px: float | None = None
) -> BallSet:
    """Read ball presses: a measurement folder, or a folder of pictures with a background among them.

    In a folder of pictures the background's name begins with ``background``, and ``balls.csv`` may hold the
    circles (file, centre_column_px, centre_row_px, contact_radius_px); where it does not, they are found.

    Parameters
    ----------
    folder : path
        The folder.
    ball_mm : float, optional
        Diameter of the ball; that of the measurement file when absent.
    mm_per_px : float, optional
        Size of a pixel at the gel; that of the measurement file when absent.

    Raises
    ------
    MeasurementError
        If something is missing; the text says what, and how to give it.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise MeasurementError(f"{folder}: no such folder")
    if (folder / "measurement.toml").is_file():
        return _of_measurement(folder, ball_mm, mm_per_px)
    return _of_pictures(folder, ball_mm, mm_per_px)


def _of_measurement(folder: Path, ball_mm: float | None, mm_per_px: float | None) -> BallSet:
    measurement = load_measurement(folder)
    scale = _needed(
        folder, "mm_per_px", "--mm-per-px", measurement.mm_per_px if mm_per_px is None else mm_per_px
    )
    untouched = [frame for frame in measurement.frames if frame.kind == "background" and frame.leds is None]
    if not untouched:
        raise MeasurementError(f"{folder}: needs a frame of kind background, with all LEDs on")
    background, markers = _unmarked(
        np.mean([np.asarray(measurement.image(frame), dtype=float) for frame in untouched], axis=0)
    )
    # Presses of a stated depth judge a calibration, and do not teach it.
    frames = [
        frame
        for frame in measurement.frames
        if frame.kind == "press" and (frame.probe or "").startswith("sphere") and frame.depth_mm is None
    ]
    sizes = {float(frame.probe.partition(":")[2] or 4) for frame in frames if frame.probe}
    if ball_mm is None and len(sizes) != 1:
        raise MeasurementError(f"{folder}: balls of one diameter are needed, got {sorted(sizes)} mm")
    stated = sizes.pop() if ball_mm is None else ball_mm
    diameter = _needed(folder, "diameter of the ball", "--ball-mm", stated)
    balls, files, looked_for = [], [], 0
    for frame in frames:
        image = _plain(np.asarray(measurement.image(frame), dtype=float), markers)
        if frame.centre_px is not None and frame.contact_radius_px is not None:
            balls.append(BallPress(image, frame.centre_px, frame.contact_radius_px))
        else:
            balls.append(_found(folder / frame.file, image, background))
            looked_for += 1
        files.append(frame.file)
    notes = (
        f"{len(balls)} balls of {diameter:g} mm; {looked_for} circles found in the pictures",
        *_marked(markers),
    )
    return _checked(folder, BallSet(tuple(files), balls, background, diameter / 2, scale, notes, markers))


def _of_pictures(folder: Path, ball_mm: float | None, mm_per_px: float | None) -> BallSet:
    pictures = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURES)
    untouched = [path for path in pictures if path.stem.lower().startswith("background")]
    if not untouched:
        raise MeasurementError(
            f"{folder}: needs a picture of the untouched gel whose name begins with 'background'"
        )
    diameter = _needed(folder, "diameter of the ball", "--ball-mm", ball_mm)
    scale = _needed(folder, "size of a pixel at the gel", "--mm-per-px", mm_per_px)
    background, markers = _unmarked(_mean_of(untouched))
    circles = _circles(folder / "balls.csv")
    names = [path for path in pictures if path not in untouched and (not circles or path.name in circles)]
    balls = []
    for path in names:
        image = _plain(_of_size(path, _read(path), untouched[0].name, background.shape), markers)
        known = circles.get(path.name)
        balls.append(BallPress(image, *known) if known else _found(path, image, background))
    notes = (
        f"{len(balls)} balls of {diameter:g} mm; "
        f"{len(circles)} circles from balls.csv, {len(balls) - len(circles)} found in the pictures",
        *_marked(markers),
    )
    files = tuple(path.name for path in names)
    return _checked(folder, BallSet(files, balls, background, diameter / 2, scale, notes, markers))


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
        See `reconstruction.methods`; `Kernel()` when absent.
    progress : callable, optional
        Called with what is being done, and how much of everything is done in thousandths.
    """
    parts = {"centres of the balls": 14, "gel": 4, "balls left out": 3, "calibration": 2}
    work = Work(progress, parts)
    setup = Setup(balls.radius_mm, balls.mm_per_px, thickness_mm=thickness_mm)
    if poisson is not None:
        setup = setup._replace(poisson=poisson)
    work.begin("centres of the balls")
    refined = refine_centres(balls.balls, balls.background, setup)
    refined = refine_centres(refined, balls.background, setup, method=COARSE, rounds=2)
    work.step(parts["centres of the balls"])
    work.begin("gel")
    known, setup, gel = known_gel(refined, balls.background, setup)
    work.step(parts["gel"])
    work.begin("balls left out")
    errors = left_out_of_each(known, balls.background, setup, method=method)
    work.step(parts["balls left out"])
    work.begin("calibration")
    calibration = calibrate(known, balls.background, setup, method=method)
    work.end()
    mean = LeftOut(*(float(np.mean(values)) for values in zip(*errors, strict=True)))
    about = {
        "balls": len(known),
        "ball_mm": 2 * balls.radius_mm,
        "normal_error_deg": mean.contact_deg,
        "height_error_um": 1000 * mean.height_mm,
        **({} if balls.markers is None else {"markers": balls.markers.plain()}),
    }
    kept = kept_of(calibration, known, about)
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


def _circles(path: Path) -> dict[str, tuple[tuple[float, float], float]]:
    """Circles of a ``balls.csv`` by file; none where there is no such file."""
    if not path.is_file():
        return {}
    found = {}
    with path.open(encoding="utf-8-sig", newline="") as file:
        for number, row in enumerate(csv.DictReader(file), start=2):
            try:
                centre = float(row["centre_column_px"]), float(row["centre_row_px"])
                found[row["file"]] = centre, float(row["contact_radius_px"])
            except (KeyError, TypeError, ValueError):
                raise MeasurementError(
                    f"{path}: line {number}: needs file, centre_column_px, centre_row_px and "
                    f"contact_radius_px as numbers, got {dict(row)}"
                ) from None
    return found


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
