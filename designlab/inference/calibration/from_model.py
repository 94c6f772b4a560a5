"""A map from pictures to shape taught on simulated presses of a model, for a sensor without ball presses.

The map is that of `calibrate --balls`. The measured untouched gel takes the place of the rendered one, since
the map reads changes of colour against it; where the two differ, the model is not the sensor, and the
errors on simulated presses say too little.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.ndimage import gaussian_filter

from designlab.core.images import resize_area
from designlab.core.metrics import normal_error_deg
from designlab.core.progress import silent
from designlab.core.types import Array, Progress
from designlab.evaluation.press_plan import PressPlan
from designlab.evaluation.protocol import EvaluationProtocol, error_region
from designlab.inference.calibration.balls import kept_of
from designlab.measurement.regions import regions
from designlab.reconstruction.balls import BallPress
from designlab.reconstruction.calibration_file import Kept
from designlab.reconstruction.height import normals
from designlab.reconstruction.lab import LabCalibration, calibrate_on_shapes
from designlab.reconstruction.markers import Markers, without
from designlab.reconstruction.membrane import Membrane
from designlab.reconstruction.methods import Method
from designlab.reconstruction.setup import Setup
from designlab.sensor.camera import View
from designlab.sensor.contact import LayerContact
from designlab.sensor.design import Design
from designlab.simulation.effects.model import SensorModel
from designlab.simulation.simulator import Frame, Simulator, exposure
from geometries.elastomer import base_gradient, base_mm, inside

COLUMNS = 160  # of the simulated pictures; the map knows places as shares of the picture
TESTS = 4  # simulated presses that do not teach
SMOOTHING_PX = 0.7, 2.0  # see `Setup`: of pictures of `COLUMNS` columns 1, in proportion between these
SMOOTH_SHARE = 0.02  # of the width: what is finer in an untouched gel is dirt and grain
DARKEST = 0.05  # of the brightest: darker places tell no ratio
STRUCTURE, COLOUR = (
    0.1,
    0.25,
)  # differences of the untouched gel from which the model is doubtful; gains cancel
UNEVEN_SCALE = 0.03  # difference of the size of a pixel over the picture that is worth a note
STEEPEST = math.tan(math.radians(70))  # slope of the membrane, beyond which a picture shows next to nothing
OTHER_SCALE = 0.15  # difference of a stated scale, from which it is another one
CHANNELS = ("R", "G", "B")


class ChannelDifference(NamedTuple):
    """How one channel of the measured untouched gel differs from that of the model.

    Attributes
    ----------
    channel : str
        R, G or B.
    gain : float
        Its brightness over that of the model, relative to the mean of the channels.
    structure : float
        Root mean square of the rest, relative: light that is spread otherwise over the gel.
    region : str
        Where it differs most.
    there : float
        Mean difference there, relative.
    """

    channel: str
    gain: float
    structure: float
    region: str
    there: float

    def text(self) -> str:
        """In words."""
        return (
            f"{self.channel}: brightness {self.gain - 1:+.0%} against the other channels, its spread over "
            f"the gel {self.structure:.0%}, most at {self.region} ({self.there:+.0%})"
        )


class Taught(NamedTuple):
    """A map taught on a model, for the pictures of one sensor.

    Attributes
    ----------
    kept : Kept
        What a calibration file holds.
    differences : tuple of ChannelDifference
        Of the measured untouched gel from that of the model.
    notes : tuple of str
        How the pictures were understood, and what the errors hold for.
    warnings : tuple of str
        What speaks against the result.
    """

    kept: Kept
    differences: tuple[ChannelDifference, ...]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


Crop = tuple[int, int, int, int]
"""Left, top, width and height of a part of the camera's sensor, in its pixels."""


def views_that_fit(design: Design, shape: tuple[int, ...], crop_px: Crop | None = None) -> dict[str, View]:
    """Parts of the camera's sensor that a picture may show: a stated one, else the whole or the sensing area.

    Parameters
    ----------
    design : Design
        The sensor.
    shape : tuple of int
        Rows, columns and channels of the picture.
    crop_px : tuple of int, optional
        The part that it shows, where that is known.

    Raises
    ------
    ValueError
        If the picture fits none of them.
    """
    rows, columns = shape[:2]
    camera, area = design.camera, design.view(columns)
    if crop_px is not None:
        x, y, width, height = crop_px
        if (
            min(x, y, width - 1, height - 1) < 0
            or x + width > camera.width_px
            or y + height > camera.height_px
        ):
            raise ValueError(
                f"crop_px: must lie on the camera's sensor of {camera.width_px} x {camera.height_px} px, got "
                f"{x}, {y}, {width}, {height}"
            )
        if abs(height * columns / width - rows) > 1.0:
            raise ValueError(
                f"background: must have the proportions of crop_px, {width} x {height} px, got {columns} x "
                f"{rows} px"
            )
        return {
            "the stated part of the sensor": View(
                float(x), float(y), float(width), float(height), columns, rows
            )
        }
    whole = View(0.0, 0.0, float(camera.width_px), float(camera.height_px), columns, rows)
    fits = {}
    if abs(camera.height_px * columns / camera.width_px - rows) <= 1.0:
        fits["the camera's whole picture"] = whole
    if abs(area.rows - rows) <= 1:
        fits["the sensing area"] = area._replace(rows=rows)
    if not fits:
        raise ValueError(
            f"background: must have the proportions of the camera's whole picture ({camera.width_px} x "
            f"{camera.height_px} px) or of its sensing area (at this width {columns} x {area.rows} px), "
            f"got {columns} x {rows} px: use uncropped pictures, or state the part of the sensor with "
            "--crop-px"
        )
    return fits


def membrane_of(
    design: Design, shape: tuple[int, ...], *, crop_px: Crop | None = None, mm_per_px: float | None = None
) -> Membrane:
    """The undeformed membrane of a design as pictures of a shape show it, without rendering any.

    Parameters
    ----------
    design : Design
        Gel, core and camera of the sensor; its light does not matter.
    shape : tuple of int
        Rows, columns and channels of the pictures.
    crop_px : tuple of int, optional
        See `views_that_fit`.
    mm_per_px : float, optional
        Size of a pixel at the gel, which tells whether pictures show the camera's whole picture or the
        sensing area; the whole picture when absent.

    Raises
    ------
    ValueError
        If the pictures fit the camera in no way, or their scale is another.
    """
    found = {}
    for name, view in views_that_fit(design, shape, crop_px).items():
        simulator = Simulator(design, view=view, seed=0)
        x, y = simulator.rays.hit(simulator.surface(None))
        p, q = base_gradient(design.elastomer, x, y)
        gel = inside(design.elastomer, x, y) & (np.hypot(p, q) < STEEPEST)
        sight = simulator.rays.slope_x, simulator.rays.slope_y
        found[name] = Membrane.of((x, y), base_mm(design.elastomer, x, y), (p, q), sight, gel)
    if mm_per_px is None:
        return next(iter(found.values()))
    name = min(found, key=lambda name: abs(math.log(found[name].mm_per_px / mm_per_px)))
    if abs(found[name].mm_per_px / mm_per_px - 1) > OTHER_SCALE:
        raise ValueError(
            f"mm_per_px: pictures of {name} have {found[name].mm_per_px:.4g} mm a pixel by the design, "
            f"and {mm_per_px:.4g} is stated; correct the design or the scale, or state with --crop-px which "
            "part of the camera's sensor the pictures show"
        )
    return found[name]


class Gel(NamedTuple):
    """What a design says of its gel.

    Attributes
    ----------
    thickness_mm : float
        Thickness.
    poisson : float or None
        Poisson's ratio; None where the design's contact knows none.
    skin_mm : float
        How far the coating rounds what the gel is pressed to (standard deviation of a Gaussian).
    """

    thickness_mm: float
    poisson: float | None = None
    skin_mm: float = 0.0

    @classmethod
    def of(cls, design: Design) -> Self:
        """Read it from a design."""
        thickness_mm, contact = design.elastomer.thickness_mm, design.contact
        if not isinstance(contact, LayerContact):
            return cls(thickness_mm)
        return cls(thickness_mm, contact.layer(thickness_mm=thickness_mm).poisson, contact.skin_length_mm)


def teach_on_model(
    model: SensorModel,
    background: Array,
    *,
    crop_px: Crop | None = None,
    markers: bool = True,
    seed: int = 0,
    samples: int = 64,
    method: Method | None = None,
    progress: Progress = silent,
) -> Taught:
    """Teach a map on simulated presses, and measure its error on others of them.

    Parameters
    ----------
    model : SensorModel
        The sensor as it is believed to be.
    background : array, shape (rows, columns, 3)
        Linear picture of the sensor's untouched gel.
    crop_px : tuple of int, optional
        See `views_that_fit`; of the whole picture and the sensing area the one that fits better when absent.
    markers : bool
        Whether to look for printed markers in the untouched gel. The map is taught on a plain membrane.
    seed : int
        Seed of simulated light and noise.
    samples : int
        Samples per pixel and LED group.
    method : Method, optional
        See `reconstruction.methods`; `Kernel()` when absent.
    progress : callable, optional
        Called with what is being done, the number done and the number of all.

    Raises
    ------
    ValueError
        If the picture does not fit the model's camera, or presses do not fit its gel.
    """
    printed = model.design.optics.marker_pitch_mm > 0
    if printed:
        model = model.replace({"optics.marker_pitch_mm": 0.0})
    design = model.effective_design()
    if background.ndim != 3 or background.shape[-1] != len(CHANNELS):
        raise ValueError(f"background: must have 3 channels, R, G and B, got shape {background.shape}")
    fits = views_that_fit(design, background.shape, crop_px)
    dots = Markers.found_in(background) if markers else None
    if dots is not None:
        background = without(background, dots.covered)
    plan = PressPlan.of(design)
    plan.require_possible(design)
    presses = plan.presses(rounds=1, seed=seed)
    tests = presses.test[:TESTS]
    total = len(fits) + len(presses.calibration) + len(tests) + 2
    seen = []
    for number, view in enumerate(fits.values()):
        progress("untouched gel", number, total)
        simulator = Simulator(model, view=_coarse(view), samples=samples, seed=seed)
        untouched = simulator.frame(None)
        protocol = EvaluationProtocol(design, exposure(design, untouched), seed, model)
        again = simulator.frame(None, seed=seed + 1)
        rendered = np.asarray(protocol.background(untouched, again), dtype=float)
        found = differences_of(background, rendered, untouched, design)
        seen.append((found, simulator, untouched, protocol, rendered))
    chosen = min(range(len(seen)), key=lambda at: sum(each.structure for each in seen[at][0]))
    differences, simulator, untouched, protocol, rendered = seen[chosen]
    frames = []
    for number, press in enumerate((*presses.calibration, *tests), start=len(fits)):
        progress(f"simulated press of {press.probe.text}", number, total)
        frames.append(simulator.frame(press))
    pictures = [protocol.picture(frame, 10 + at).astype(float) for at, frame in enumerate(frames)]
    count = len(presses.calibration)
    progress("map", total - 2, total)
    pitch, scale = untouched.rays.pitch_mm[0], background.shape[1] / simulator.view.columns
    smoothing_px = float(np.clip(scale, *SMOOTHING_PX))
    balls = [_circled(*pair) for pair in zip(pictures[:count], frames[:count], strict=True)]
    contact = design.contact
    setup = Setup(
        ball_radius_mm=float(np.mean([press.probe.size_mm for press in presses.calibration])) / 2,
        mm_per_px=pitch,
        detail=0.0,
        smoothing_px=max(smoothing_px / scale, SMOOTHING_PX[0]),
        thickness_mm=design.elastomer.thickness_mm,
        label_bias=0.0,
    )
    about: dict[str, Any] = {
        "model": design.name,
        "simulated": True,
        "balls": count,
        "sight": _sight(untouched),
    }
    if dots is not None:
        about["markers"] = dots.plain()
    if isinstance(contact, LayerContact):
        layer = contact.layer(thickness_mm=design.elastomer.thickness_mm)
        setup = setup._replace(poisson=layer.poisson)
        about["modulus_mpa"] = layer.modulus_mpa
    calibration = calibrate_on_shapes(
        pictures[:count],
        rendered,
        [frame.gradient for frame in frames[:count]],
        [error_region(frame) for frame in frames[:count]],
        setup,
        method=method,
    )
    progress("errors", total - 1, total)
    normal_deg, height_um = _errors(calibration, frames[count:], pictures[count:])
    about |= {"normal_error_deg": normal_deg, "height_error_um": height_um}
    kept = kept_of(calibration, balls, about)
    used = replace(
        calibration,
        background=background,
        setup=setup._replace(mm_per_px=pitch / scale, smoothing_px=smoothing_px),
    )
    notes = (
        f"pictures are taken to show {list(fits)[chosen]}",
        f"on simulated presses that did not teach the map, normals are off by {normal_deg:.1f} deg and "
        f"heights by {height_um:.0f} um. That holds for the model {design.name}, not for your sensor: "
        "`designlab calibrate --balls` measures it",
        *_fit_words(differences, design),
        *([] if dots is None else [f"{len(dots.places_px)} markers found in the background"]),
    )
    warnings = (*_doubts(differences, untouched), *model.warnings(presses.calibration))
    if printed and markers and dots is None:
        warnings += ("the model has printed markers, and the background shows none",)
    progress("errors", total, total)
    told = {
        "notes": notes,
        "warnings": warnings,
        "differences": [each._asdict() for each in differences],
    }
    return Taught(Kept(used, kept.taught, {**kept.about, **told}), differences, notes, warnings)


def differences_of(
    measured: Array, rendered: Array, untouched: Frame, design: Design
) -> tuple[ChannelDifference, ...]:
    """Compare a measured picture of the untouched gel with that of a model, channel by channel.

    Parameters
    ----------
    measured : array, shape (rows, columns, 3)
        Linear picture of the sensor.
    rendered : array, shape (rows, columns, 3)
        That of the model, which may be coarser; the unit is free.
    untouched : Frame
        Of the model.
    design : Design
        Of the model.
    """
    rows, columns = rendered.shape[:2]
    spread = SMOOTH_SHARE * columns
    coarse = np.asarray(resize_area(measured, rows, columns), dtype=float)
    ours, theirs = (gaussian_filter(each, (spread, spread, 0)) for each in (coarse, rendered))
    means = ours.mean(axis=(0, 1)) / np.maximum(theirs.mean(axis=(0, 1)), 1e-12)
    found = []
    for channel, name in enumerate(CHANNELS):
        model = theirs[..., channel]
        lit = model > DARKEST * model.max()
        ratio = ours[..., channel] / np.maximum(model, 1e-12)
        level = float(ratio[lit].mean())
        off = np.where(lit, ratio / max(level, 1e-12) - 1, 0.0)
        parts = {
            region: float(off[place & lit].mean())
            for region, place in regions(untouched, design, channel).items()
            if (place & lit).any()
        }
        worst = max(parts, key=lambda region: abs(parts[region]))
        found.append(
            ChannelDifference(
                name,
                float(means[channel] / max(means.mean(), 1e-12)),
                float(np.sqrt((off[lit] ** 2).mean())),
                worst,
                parts[worst],
            )
        )
    return tuple(found)


def _disagree(differences: Sequence[ChannelDifference]) -> bool:
    return any(each.structure > STRUCTURE or abs(each.gain - 1) > COLOUR for each in differences)


def _fit_words(differences: Sequence[ChannelDifference], design: Design) -> list[str]:
    """How well the untouched gel agrees, where it does, and what the heights of a curved gel are."""
    words = []
    if not _disagree(differences):
        most = max(max(each.structure, abs(each.gain - 1)) for each in differences)
        told = "; ".join(each.text() for each in differences)
        words.append(f"background and model agree within {math.ceil(100 * most)} %: {told}")
    if design.elastomer.shape != "flat":
        words.append("heights and normals are those of the indentation, against the untouched curved gel")
    return words


def _doubts(differences: Sequence[ChannelDifference], untouched: Frame) -> list[str]:
    """What speaks against the model, and against one size of a pixel."""
    found = []
    if _disagree(differences):
        told = "; ".join(each.text() for each in differences)
        found.append(
            f"background and model disagree: {told}. Slopes may be wrong by about as much. Calibrate the "
            "model (`designlab calibrate`), find what it lacks (`designlab gap diagnose`), or use balls"
        )
    across = np.diff(untouched.rays.x_mm, axis=1)
    uneven = float(np.quantile(across, 0.95) / np.quantile(across, 0.05) - 1)
    if uneven > UNEVEN_SCALE:
        found.append(
            f"the size of a pixel at the gel differs by {uneven:.0%} over the picture, and the map takes one "
            "size: heights and forces are off by as much"
        )
    return found


def _sight(untouched: Frame) -> dict[str, list[float]]:
    """How the camera looks on the gel: slopes of viewing rays, by the place from the picture's middle."""
    rays = untouched.rays
    fits = []
    for place, slope in ((rays.x_mm, rays.slope_x), (rays.y_mm, rays.slope_y)):
        fits.append(np.polyfit((place - place.mean()).ravel(), slope.ravel(), 1))
    return {
        "slope_per_mm": [float(fit[0]) for fit in fits],
        "slope": [float(fit[1]) for fit in fits],
    }


def _coarse(view: View) -> View:
    return view._replace(columns=COLUMNS, rows=max(1, round(view.rows * COLUMNS / view.columns)))


def _circled(image: Array, frame: Frame) -> BallPress:
    """A simulated press of a ball with the circle of its contact."""
    rows, columns = np.nonzero(frame.contact)
    if not rows.size:
        raise ValueError("model: a simulated ball touches the gel nowhere in the picture")
    return BallPress(image, (float(columns.mean()), float(rows.mean())), math.sqrt(rows.size / math.pi))


def _errors(
    calibration: LabCalibration, frames: Sequence[Frame], pictures: Sequence[Array]
) -> tuple[float, float]:
    """Mean error of normals (deg) and root mean square error of heights (um) on and around contacts."""
    normal, height = [], []
    for frame, image in zip(frames, pictures, strict=True):
        shape, region = calibration.reconstruct(image), error_region(frame)
        error = normal_error_deg(shape.normals(), normals(*frame.gradient))
        normal.append(error[region].mean())
        height.append(((shape.height_mm - frame.height_mm)[region] ** 2).mean())
    return float(np.mean(normal)), 1000 * math.sqrt(float(np.mean(height)))
