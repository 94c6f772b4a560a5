"""What is suspicious about a set of frames as it is, before any model."""

import numpy as np
from numpy.typing import NDArray

from designlab.measurement.frames import FULL_SCALE, MeasuredFrame, Measurement
from designlab.measurement.quality.additivity import added_light
from designlab.measurement.quality.colour import colourless
from designlab.measurement.quality.damage import damage
from designlab.measurement.quality.suspicion import Suspicion
from designlab.measurement.sizes import check_size
from designlab.sensor.design import Design

BEYOND_SCALE = 1.01  # what only files of floating-point numbers hold
MOST_SATURATED = 0.05  # of the pixels of a channel, above which a frame is refused
PLATEAU_SHARE = 0.01  # of the pixels at the one highest value of a channel that is cut below full scale
PLATEAU_LEVELS = 8  # next lower values that the highest is compared with
PLATEAU_FACTOR = 5.0  # how much more frequent than those it must be
PLATEAU_SPAN = 0.05  # of the highest value: its least distance from the median


def check(measurement: Measurement, design: Design | None = None) -> tuple[Suspicion, ...]:
    """Examine frames without simulation: poses, damage, saturation, colour, markers, sums of light.

    Parameters
    ----------
    measurement : Measurement
        A loaded set.
    design : Design, optional
        The sensor it will be compared with; the one it names when absent.

    Raises
    ------
    MeasurementError
        If the size of a picture does not fit the design's camera.
    """
    design = design or measurement.design()
    for frame in measurement.frames:
        check_size(measurement, frame, design)
    light = added_light(measurement, design)
    colour = colourless(measurement, design)
    return (*_poses(measurement), *damage(measurement), *_saturation(measurement), *colour, *light)


def _poses(measurement: Measurement) -> list[Suspicion]:
    presses = [frame for frame in measurement.frames if frame.kind == "press"]
    lost: dict[tuple[str, ...], list[str]] = {}
    for frame in presses:
        unknown = [
            name
            for name, known in (
                ("probe size", frame.probe is None or ":" in frame.probe or "." in frame.probe),
                ("depth_mm", _depth_is_known(measurement, frame)),
                ("centre_mm", measurement.centre_mm(frame) is not None),
            )
            if not known
        ]
        if unknown:
            lost.setdefault(tuple(unknown), []).append(frame.file)
    none_left = sum(map(len, lost.values())) == len(presses)
    return [
        Suspicion(
            "no_pose",
            tuple(files),
            f"{' and '.join(unknown)} unknown, so nothing can be compared with the picture",
            "where or how deep the probe was pressed was not noted, or measurement.toml is half filled in",
            "give probe = kind:size_mm, depth_mm or force_n, and centre_mm, as well as they are known, and "
            "in sigma how well; of a ball contact_diameter_mm will do for the depth; or add a background in "
            "the same light, by which places are read off the pictures; or delete these frames",
            strong=none_left,
        )
        for unknown, files in lost.items()
    ]


def _depth_is_known(measurement: Measurement, frame: MeasuredFrame) -> bool:
    circle = measurement.contact_radius_mm(frame) is not None and (frame.probe or "").startswith("sphere")
    return frame.depth_mm is not None or frame.force_n is not None or circle


def _saturation(measurement: Measurement) -> list[Suspicion]:
    found = []
    for frame in measurement.frames:
        image = measurement.image(frame)
        share = (image >= FULL_SCALE).mean(axis=(0, 1))
        channel = int(np.argmax(share))
        if share[channel] > MOST_SATURATED:
            found.append(
                Suspicion(
                    "saturated",
                    (frame.file,),
                    f"{share[channel]:.1%} of the pixels of {_letter(channel, image)} stand at full scale "
                    f"(more than {MOST_SATURATED:.0%} are refused)",
                    *_too_bright(float(image.max())),
                )
            )
            continue
        for channel in range(image.shape[-1]):
            level = _plateau(image[..., channel])
            if level is not None:
                top, pixels = level
                found.append(
                    Suspicion(
                        "saturated",
                        (frame.file,),
                        f"{pixels:.1%} of the pixels of {_letter(channel, image)} share one highest value, "
                        f"{top:.4g} of full scale",
                        "the camera was saturated, and the values were scaled afterwards (black level, white "
                        "balance, 10 or 12 bits in a file of 16)",
                        "take it again with less exposure; or import the camera's own files with "
                        "`designlab import --white`, so that full scale is known",
                    )
                )
                break
    return found


def _too_bright(highest: float) -> tuple[str, str]:
    """Suspected cause of values at full scale, and remedy."""
    if highest > BEYOND_SCALE:
        return (
            f"the file holds numbers up to {highest:.3g}, in a unit of its own",
            "divide all files by one number, so that the camera's full scale is 1",
        )
    return (
        "exposure or gain too high, or automatic",
        "take it again with less exposure, the same for all frames; gain and white balance fixed",
    )


def _plateau(values: NDArray[np.float32]) -> tuple[float, float] | None:
    """Highest value and share of pixels there, if the channel is cut at it; else None."""
    levels, counts = np.unique(values, return_counts=True)
    share = counts[-1] / values.size
    # Dark frames and noise-free pictures have few levels, none of them cut.
    if len(levels) <= PLATEAU_LEVELS or share < PLATEAU_SHARE or levels[-1] >= FULL_SCALE:
        return None
    usual = counts[-1 - PLATEAU_LEVELS : -1].mean()
    if counts[-1] < PLATEAU_FACTOR * usual or levels[-1] - np.median(values) < PLATEAU_SPAN * levels[-1]:
        return None
    return float(levels[-1]), float(share)


def _letter(channel: int, image: NDArray[np.float32]) -> str:
    return ("red", "green", "blue")[channel] if image.shape[-1] == 3 else "the one channel"
