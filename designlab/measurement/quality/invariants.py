"""What frames say of themselves and of each other, without any model: light that adds up, drift, fields."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from designlab.core.images import narrowed
from designlab.core.types import Array
from designlab.measurement.frames import FULL_SCALE, MeasuredFrame, Measurement, dark_level
from designlab.measurement.quality.additivity import LEAST_MISFIT, added_light_misfits
from designlab.measurement.quality.damage import repeated
from designlab.sensor.design import Design
from designlab.simulation.optics.viewing_rays import rays

COLUMNS = 24  # to which pictures are averaged: fields are smooth
MOST_DRIFT = 0.005  # spread of the levels of repeats; LEDs that are warm and fixed settings keep to it
MOST_CHANGE = 0.01  # rms difference in shape of repeats once their levels agree
MOST_TURNED = 0.02  # the same of the gel as it is and turned
MOST_FAR = 0.03  # the same of a press and the untouched gel, far from the press
FAR_MM = 4.0  # from the edge of the probe
MOST_SATURATED, MOST_CUT = 0.001, 0.02  # of the values of a lit frame
CORNER = 0.15  # of the width and height


@dataclass(frozen=True)
class FrameCheck:
    """A comparison of frames that needs no model.

    Attributes
    ----------
    name : str
        What is compared.
    passed : bool or None
        Whether it holds; None where the frames for it are missing.
    figure : str
        What was found, with its unit.
    files : tuple of str
        Frames that were compared.
    """

    name: str
    passed: bool | None
    figure: str
    files: tuple[str, ...] = ()


def invariants(measurement: Measurement, design: Design) -> tuple[FrameCheck, ...]:
    """Compare frames with each other: sums of LED groups, exposures, repeats, presses, gel turned, scale.

    Parameters
    ----------
    measurement : Measurement
        A loaded set of known response.
    design : Design
        The sensor, for the names of its LED groups and the place of a press in a picture.
    """
    return (
        *_light(measurement, design),
        _repeats(measurement),
        _dark(measurement),
        _far(measurement, design),
        _turned(measurement),
        _ends(measurement),
        *_flat_field(measurement),
    )


def _light(measurement: Measurement, design: Design) -> list[FrameCheck]:
    found = added_light_misfits(measurement, design)
    names = {
        "superposition": "no background for each LED group alone, beside one with all",
        "exposure ladder": "no frames that differ in their exposure only",
    }
    checks = []
    for name, missing in names.items():
        ours = [(files, misfit) for kind, files, misfit in found if kind == name]
        if not ours:
            checks.append(FrameCheck(name, None, missing))
        for files, misfit in ours:
            figure = f"misses by {misfit:.1%} of the mean (at most {LEAST_MISFIT:.0%})"
            checks.append(FrameCheck(name, misfit < LEAST_MISFIT, figure, tuple(files)))
    return checks


def _repeats(measurement: Measurement) -> FrameCheck:
    groups = repeated([frame for frame in measurement.frames if frame.lit])
    if not groups:
        return FrameCheck("repeats", None, "no frame was taken twice: drift and noise are not known")
    drift, change = 0.0, 0.0
    for group in groups:
        levels = np.stack([_small(measurement, frame).mean(axis=(0, 1)) for frame in group])
        drift = max(drift, float((levels / levels.mean(axis=0)).std(axis=0, ddof=1).max()))
        shapes = _shapes(measurement, group)
        change = max(change, float(np.sqrt(((shapes - shapes.mean(axis=0)) ** 2).mean(axis=(1, 2, 3)).max())))
    figure = (
        f"levels spread by {drift:.2%} (at most {MOST_DRIFT:.1%}), shapes differ by {change:.2%} "
        f"(at most {MOST_CHANGE:.0%})"
    )
    files = tuple(frame.file for group in groups for frame in group)
    return FrameCheck("repeats", drift <= MOST_DRIFT and change <= MOST_CHANGE, figure, files)


def _dark(measurement: Measurement) -> FrameCheck:
    frames = [frame for frame in measurement.frames if not frame.lit]
    if not frames:
        return FrameCheck("dark", None, "no frame with the LEDs off: nothing is said about an additive floor")
    levels = np.mean([measurement.linear(f).mean(axis=(0, 1), dtype=float) for f in frames], axis=0)
    shown = ", ".join(f"{level:.4f}" for level in levels)
    return FrameCheck("dark", True, f"level {shown} of full scale", tuple(frame.file for frame in frames))


def _far(measurement: Measurement, design: Design) -> FrameCheck:
    """Far from the contact a press must look like the untouched gel: fixed factors cancel in the ratio."""
    name = "press over background"
    plain = _plain(measurement)
    worst, files = -1.0, ("", "")
    for frame in measurement.frames:
        centre = measurement.centre_mm(frame)
        alike = [
            b for b in plain if (b.crop_px, b.exposure, b.leds) == (frame.crop_px, frame.exposure, frame.leds)
        ]
        if frame.kind != "press" or centre is None or not alike or frame.gel_rotation_deg:
            continue
        press, background = _small(measurement, frame), _small(measurement, alike[0])
        rows, columns = press.shape[:2]
        view = measurement.view(frame, design)._replace(columns=columns, rows=rows)
        seen = rays(design, view)
        away = np.hypot(seen.x_mm - centre[0], seen.y_mm - centre[1])
        far = away > FAR_MM + _half_mm(measurement, frame)
        if far.sum() < 20:
            continue
        level = background[far].mean(axis=0)
        used = level > 0.1 * level.max()
        ratio = (press[far] / np.maximum(background[far], 1e-6))[:, used]
        change = float(np.sqrt(((ratio / np.median(ratio, axis=0) - 1) ** 2).mean()))
        if change > worst:
            worst, files = change, (frame.file, alike[0].file)
    if worst < 0:
        return FrameCheck(name, None, "no press with a background of the same light and room around it")
    figure = (
        f"differs in shape by {worst:.1%} at most, more than {FAR_MM:g} mm beside a probe "
        f"(at most {MOST_FAR:.0%})"
    )
    return FrameCheck(name, worst <= MOST_FAR, figure, files)


def _half_mm(measurement: Measurement, frame: MeasuredFrame) -> float:
    """Half the size of a probe; none where it is not known."""
    size = (frame.probe or "").rpartition(":")[2]
    try:
        return float(size) / 2
    except ValueError:
        return 0.0


def _turned(measurement: Measurement) -> FrameCheck:
    """What moves with the gel shows in the difference, what is fixed to the camera does not."""
    name = "turned gel"
    plain = _plain(measurement)
    for frame in measurement.frames:
        alike = [b for b in plain if (b.crop_px, b.leds) == (frame.crop_px, frame.leds)]
        if frame.kind == "background" and frame.gel_rotation_deg and frame.lit and alike:
            one, other = _shapes(measurement, (frame, alike[0]))
            change = float(np.sqrt(((one - other) ** 2).mean()))
            figure = (
                f"differs in shape by {change:.2%} from the gel as it is (at most {MOST_TURNED:.0%}): "
                "that much is fixed to the gel"
            )
            return FrameCheck(name, change <= MOST_TURNED, figure, (frame.file, alike[0].file))
    return FrameCheck(name, None, "no background with the gel turned: fields of gel and lens look alike")


def _ends(measurement: Measurement) -> FrameCheck:
    """Values at the ends of the scale."""
    top, bottom, files = 0.0, 0.0, [measurement.frames[0].file] * 2
    for frame in measurement.frames:
        if frame.kind == "light_probe":  # mirrors LEDs, whose images may well be saturated
            continue
        image = measurement.image(frame)
        if frame.lit and (share := float((image >= FULL_SCALE).mean())) > top:
            top, files[0] = share, frame.file
        # With a single group some channels may rightly be dark.
        if frame.lit and frame.leds is None and (share := float((image <= 0).mean())) > bottom:
            bottom, files[1] = share, frame.file
    figure = f"{top:.2%} of the values of a frame saturated, {bottom:.2%} cut at zero, at most"
    return FrameCheck("ends of scale", top <= MOST_SATURATED and bottom <= MOST_CUT, figure, tuple(files))


def _flat_field(measurement: Measurement) -> list[FrameCheck]:
    """Fall-off of the lens by itself."""
    found = []
    for frame in measurement.frames:
        if frame.kind == "flat_field":
            figure = (
                f"corners at {corners(_small(measurement, frame)):.3f} of the middle: lens and camera alone"
            )
            found.append(FrameCheck("flat field", True, figure, (frame.file,)))
    return found


def corners(picture: Array) -> float:
    """Brightness of the corners over that of the middle."""
    rows, columns = picture.shape[:2]
    r, c = max(1, round(CORNER * rows)), max(1, round(CORNER * columns))
    grey = picture.mean(axis=2)
    four = [grey[:r, :c], grey[:r, -c:], grey[-r:, :c], grey[-r:, -c:]]
    middle = grey[rows // 2 - r // 2 : rows // 2 + r, columns // 2 - c // 2 : columns // 2 + c]
    return float(np.mean([part.mean() for part in four]) / max(float(middle.mean()), 1e-9))


def _plain(measurement: Measurement) -> Sequence[MeasuredFrame]:
    return [f for f in measurement.frames if f.kind == "background" and f.lit and not f.gel_rotation_deg]


def _small(measurement: Measurement, frame: MeasuredFrame) -> Array:
    """Linear picture at few columns, without the level of dark frames."""
    image = np.asarray(measurement.linear(frame), dtype=float)
    dark = dark_level(measurement, frame)
    return narrowed(image if dark is None else image - dark, COLUMNS)


def _shapes(measurement: Measurement, frames: Sequence[MeasuredFrame]) -> Array:
    """The same of some frames over the mean of each channel; channels that are dark in any are left out."""
    small = np.stack([_small(measurement, frame) for frame in frames])
    level = small.mean(axis=(1, 2))
    lit = (level > 0.1 * level.max(axis=1, keepdims=True)).all(axis=0)
    return np.asarray(small[..., lit] / level[:, None, None, lit])
