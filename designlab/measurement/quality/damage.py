"""Pictures that are not whole pictures of a plain gel: cut off, copied, unlike their repeats, printed on."""

from collections.abc import Sequence

import numpy as np

from designlab.core.images import narrowed
from designlab.core.types import Array, Mask
from designlab.measurement.frames import FULL_SCALE, MeasuredFrame, Measurement, alike
from designlab.measurement.quality.suspicion import Suspicion

MOST_DEAD = 0.05  # of the rows of a picture that hold one value
COLUMNS = 16  # to which repeats are averaged before they are compared
MOST_UNLIKE = 0.1  # rms difference of a repeat from the others once their levels agree, over their mean
SPOT_WIDTH = 0.1  # of the picture: what is wider is no printed dot
SPOT_CONTRAST = 0.08  # by which a dot is darker than what is around it
SPOT_NOISE = 6.0  # the same in deviations of what is not a dot
LEAST_SPOTS = 9
LEAST_SPOT_PX = 2
ALIKE_SPOTS = 0.5  # share of the dots that lie in a regular grid


def damage(measurement: Measurement) -> list[Suspicion]:
    """Look for pictures that are damaged, copied, of something else than their repeats, or show markers."""
    lit = [frame for frame in measurement.frames if frame.lit and frame.kind in ("background", "press")]
    dead = _dead(measurement, lit)
    gone = {file for each in dead for file in each.files}
    whole = [frame for frame in lit if frame.file not in gone]
    return [*dead, *_copies(measurement, whole), *_repeats(measurement, whole), *_markers(measurement, whole)]


def _dead(measurement: Measurement, frames: Sequence[MeasuredFrame]) -> list[Suspicion]:
    """Rows of one value, and the same as their neighbour, where other pictures of the set have noise."""
    shares = {}
    for frame in frames:
        image = measurement.image(frame)
        blank = (image == image[:, :1]).all(axis=(1, 2)) & (image < FULL_SCALE).any(axis=(1, 2))
        shares[frame.file] = float((blank[1:] & (image[1:] == image[:-1]).all(axis=(1, 2))).mean())
    usual = float(np.median(list(shares.values()))) if shares else 0.0
    return [
        Suspicion(
            "damaged",
            (file,),
            f"{share:.0%} of its rows hold one value without any noise (other frames: {usual:.0%})",
            "the file was cut off while it was copied, holds a blank picture of the camera, or was cut at "
            "zero when a black level was taken away",
            "copy it again from the camera, take it again, or delete the frame from measurement.toml",
        )
        for file, share in shares.items()
        if share - usual > MOST_DEAD
    ]


def _copies(measurement: Measurement, frames: Sequence[MeasuredFrame]) -> list[Suspicion]:
    """Files with the same values: noise makes every picture another."""
    first: dict[bytes, str] = {}
    found = []
    for frame in frames:
        content = measurement.image(frame).tobytes()
        other = first.setdefault(content, frame.file)
        if other != frame.file:
            found.append(
                Suspicion(
                    "copied",
                    (other, frame.file),
                    "they hold the same values to the last digit, noise included",
                    "one file was saved or copied under two names",
                    "put the right picture in the place of the copy, or delete its frame from "
                    "measurement.toml: noise and drift are read off repeats",
                )
            )
    return found


def _repeats(measurement: Measurement, frames: Sequence[MeasuredFrame]) -> list[Suspicion]:
    """Repeats that differ by more than brightness, flicker and noise."""
    found = []
    for same in repeated(frames):
        if len(same) < 3:
            continue
        pictures = np.stack([_levelled(measurement, frame) for frame in same])
        middle = np.median(pictures, axis=0)
        unlike = np.sqrt(((pictures - middle) ** 2).mean(axis=(1, 2, 3)))
        odd = int(unlike.argmax())
        rest = float(np.median(np.delete(unlike, odd)))
        if unlike[odd] > max(MOST_UNLIKE, 3 * rest):
            found.append(
                Suspicion(
                    "odd",
                    (same[odd].file,),
                    f"differs from its repeats by {unlike[odd]:.0%} of the mean, those among each other by "
                    f"{rest:.1%}",
                    "it shows something else: another sensor, a touched gel, other LEDs",
                    "take it again, correct what measurement.toml says of it, or delete the frame",
                )
            )
    return found


def repeated(frames: Sequence[MeasuredFrame]) -> list[list[MeasuredFrame]]:
    """Groups of frames that are repeats of each other, where there are two or more."""
    return [group for group in alike(frames) if len(group) > 1]


def _levelled(measurement: Measurement, frame: MeasuredFrame) -> Array:
    """Picture at few columns over the mean of each channel."""
    small = narrowed(np.asarray(measurement.image(frame), dtype=float), COLUMNS)
    return np.asarray(small / np.maximum(small.mean(axis=(0, 1)), 1e-6))


def _markers(measurement: Measurement, frames: Sequence[MeasuredFrame]) -> list[Suspicion]:
    """Dark dots in a regular grid on the untouched gel."""
    plain = [f for f in frames if f.kind == "background" and f.leds is None and not f.gel_rotation_deg]
    for frame in sorted(plain, key=lambda f: -(f.exposure or 1.0))[:1]:
        places, contrast = dots(np.asarray(measurement.image(frame), dtype=float).mean(axis=2))
        if len(places) < LEAST_SPOTS or (regular := _in_grid(places)) < ALIKE_SPOTS:
            continue
        return [
            Suspicion(
                "markers",
                (frame.file,),
                f"{len(places)} dots, {contrast:.0%} darker than what is around them, {regular:.0%} of them "
                "at the same distance from their neighbours",
                "markers printed on the gel, which the simulation does not have",
                "measure a gel without markers; with them, what they hide and how they move is taken for "
                "something else",
            )
        ]
    return []


def dots(grey: Array) -> tuple[Array, float]:
    """Middles of dark dots (dots, 2) in pixels (row, column), and how much darker than around they are."""
    from scipy.ndimage import center_of_mass, label, median_filter

    width = max(5, round(SPOT_WIDTH * grey.shape[1]) | 1)
    around = median_filter(grey, size=width, mode="nearest")
    relative = grey / np.maximum(around, 1e-6) - 1
    noise = 1.4826 * float(np.median(np.abs(relative - np.median(relative))))
    dark: Mask = (relative < -max(SPOT_CONTRAST, SPOT_NOISE * noise)) & (around > 0.1 * around.max())
    labels, count = label(dark)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    chosen = np.flatnonzero((sizes >= LEAST_SPOT_PX) & (sizes <= width**2)) + 1
    if not len(chosen):
        return np.zeros((0, 2)), 0.0
    places = np.array(center_of_mass(-np.minimum(relative, 0.0), labels, chosen))
    return places, float(-relative[np.isin(labels, chosen)].mean())


def _in_grid(places: Array) -> float:
    """Share of the dots whose nearest neighbour is as far away as that of most (within a fifth)."""
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    nearest = apart.min(axis=1)
    return float((np.abs(nearest - np.median(nearest)) < 0.2 * np.median(nearest)).mean())
