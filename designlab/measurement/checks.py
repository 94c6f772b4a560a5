"""What is suspicious about a set of frames as it is, before any model: by name, with cause and remedy."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.design import Design
from designlab.images import resize_area
from designlab.measurement.frames import Frame, Measurement, MeasurementError
from designlab.measurement.sizes import check_size
from designlab.response import Response

Array = NDArray[np.float64]

NAMES = ("no_pose", "saturated", "nonlinear", "channels", "mirrored")
FULL_SCALE = 0.999  # values above are saturated
MOST_SATURATED = 0.05  # of the pixels of a channel, above which a frame is refused
PLATEAU_SHARE = 0.01  # of the pixels at the one highest value of a channel that is cut below full scale
PLATEAU_LEVELS = 8  # next lower values that the highest is compared with
PLATEAU_FACTOR = 5.0  # how much more frequent than those it must be
PLATEAU_SPAN = 0.05  # of the highest value: its least distance from the median
COLUMNS = 32  # to which pictures are averaged before sums are compared
LEAST_MISFIT = 0.05  # of the mean signal: less is explained by lamps that heat up, stray light, noise
MOST_MISFIT = 0.03  # that the curve named instead may leave
BETTER = 3.0  # factor by which it must be better
SAG = 0.1  # share by which a group may be dimmer or brighter beside others
FILES_SHOWN = 3


@dataclass(frozen=True)
class Suspicion:
    """Something about frames that is probably not as stated.

    Attributes
    ----------
    name : str
        One of `NAMES`; what a caller trusts to go on nevertheless.
    files : tuple of str
        Frames that it is about.
    evidence : str
        What was seen, with numbers.
    cause : str
        What probably happened.
    remedy : str
        What to do.
    strong : bool
        Whether results would be wrong, so that work stops; else it is only noted.
    """

    name: str
    files: tuple[str, ...]
    evidence: str
    cause: str
    remedy: str
    strong: bool = True

    def __str__(self) -> str:
        shown = ", ".join(self.files[:FILES_SHOWN])
        more = len(self.files) - FILES_SHOWN
        where = f"{shown} and {more} more" if more > 0 else shown
        return f"{self.name}: {where}: {self.evidence}; suspected cause: {self.cause}; remedy: {self.remedy}"


def check(measurement: Measurement, design: Design | None = None) -> tuple[Suspicion, ...]:
    """Examine frames without simulation: poses, saturation, and whether light adds up as the response says.

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
    return (*_poses(measurement), *_saturation(measurement), *_response(measurement, design))


def refuse(
    measurement: Measurement, suspicions: Iterable[Suspicion], trust: Sequence[str] = ()
) -> tuple[str, ...]:
    """Stop for what is suspicious, unless it is trusted.

    Parameters
    ----------
    measurement : Measurement
        The set, for its name in the error.
    suspicions : iterable of Suspicion
        What was found.
    trust : sequence of str
        Names of suspicions that are known and right as they are.

    Returns
    -------
    tuple of str
        Notes: what was trusted, and what is too weak to stop for.

    Raises
    ------
    MeasurementError
        Naming files, evidence, cause, remedy and the way on.
    ValueError
        If `trust` has a name that is none.
    """
    unknown = [name for name in trust if name not in NAMES]
    if unknown:
        raise ValueError(f"trust: one of {', '.join(NAMES)}, got {unknown[0]!r}")
    found = list(suspicions)
    stops = [each for each in found if each.strong and each.name not in trust]
    if stops:
        names = " ".join(f"--trust {name}" for name in dict.fromkeys(each.name for each in stops))
        raise MeasurementError(
            f"{measurement.folder}: {'. '.join(map(str, stops))}. To go on nevertheless: {names}"
        )
    return tuple(f"trusted although {each}" if each.strong else str(each) for each in found)


def _poses(measurement: Measurement) -> list[Suspicion]:
    presses = [frame for frame in measurement.frames if frame.kind == "press"]
    lost: dict[tuple[str, ...], list[str]] = {}
    for frame in presses:
        unknown = [
            name
            for name, known in (
                ("probe size", frame.probe is None or ":" in frame.probe or "." in frame.probe),
                ("depth_mm", frame.depth_mm is not None),
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
            "give probe = kind:size_mm, depth_mm and centre_mm, as well as they are known, and in sigma how "
            "well; or delete these frames",
            strong=none_left,
        )
        for unknown, files in lost.items()
    ]


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
                    "exposure or gain too high, or automatic",
                    "take it again with less exposure, the same for all frames; gain and white balance fixed",
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


class Curve(NamedTuple):
    """A response that files may have: its name in measurement.toml, and the linear values that follow."""

    label: str
    declared: Response
    true: Response

    def __call__(self, linear: Array) -> Array:
        """Linear values that the files hold if this curve is theirs."""
        return self.true.decode(np.clip(self.declared.encode(np.clip(linear, 0.0, None)), 0.0, 1.0))


def other_curves(response: str) -> tuple[Curve, ...]:
    """Responses that files often have instead of the declared one."""
    if response == "linear":
        return (Curve("srgb", Response(), Response(curve="srgb")),)
    if response == "srgb":
        return (Curve("linear", Response(curve="srgb"), Response()),)
    if response.startswith("gamma:") and 0.2 <= (gamma := float(response.removeprefix("gamma:"))) <= 5:
        return (Curve("linear", Response(curve="gamma", gamma=gamma), Response()),)
    return ()


def nonlinear(files: Sequence[str], curve: Curve, declared: str, evidence: str) -> Suspicion:
    """Name a response that is not the declared one."""
    cause = (
        "the files are sRGB-encoded (what cameras and image libraries write as JPEG and PNG)"
        if curve.label == "srgb"
        else "the files are linear already (raw or converted)"
    )
    return Suspicion(
        "nonlinear",
        tuple(files),
        evidence,
        f"{cause}, declared {declared}",
        f'write response = "{curve.label}" into measurement.toml',
    )


def _response(measurement: Measurement, design: Design | None) -> list[Suspicion]:
    """Compare sums of lights and ladders of exposures as declared and with another response."""
    if measurement.response == "unknown":
        return []
    curves = other_curves(measurement.response)
    for files, what, terms in (*_sums(measurement, design), *_ladders(measurement)):
        declared = _misfit(terms)
        if declared < LEAST_MISFIT:
            continue
        for curve in curves:
            other = _misfit([term.behind(curve) for term in terms])
            if other < MOST_MISFIT and BETTER * other < declared:
                evidence = (
                    f"{what} misses by {declared:.1%} of the mean with response {measurement.response}, by "
                    f"{other:.1%} with {curve.label}"
                )
                return [nonlinear(files, curve, measurement.response, evidence)]
    return []


class _Term(NamedTuple):
    """A picture, its level without light if known, and the factor with which it enters."""

    values: Array
    dark: Array | None
    weight: float

    def behind(self, curve: Curve) -> "_Term":
        """Return the same with another response."""
        return _Term(curve(self.values), None if self.dark is None else curve(self.dark), self.weight)


def _misfit(terms: Sequence[_Term]) -> float:
    """Root mean square of what is left of the first picture without the others, over its mean.

    Each of the others may be off by `SAG`: lamps dim each other, and exposure times are not exact. Without a
    dark frame a constant for each channel is free.
    """
    from scipy.optimize import lsq_linear

    pictures = [(t.values - (0.0 if t.dark is None else t.dark)) * t.weight for t in terms]
    whole, parts = pictures[0].ravel(), np.stack([p.ravel() for p in pictures[1:]], axis=1)
    low, high = np.full(len(terms) - 1, 1 - SAG), np.full(len(terms) - 1, 1 + SAG)
    if terms[0].dark is None:
        channels = pictures[0].shape[-1]
        constant = np.tile(np.eye(channels), (len(whole) // channels, 1))
        parts = np.hstack([parts, constant])
        low, high = np.append(low, np.full(channels, -np.inf)), np.append(high, np.full(channels, np.inf))
    factors = lsq_linear(parts, whole, (low, high)).x
    left = (whole - parts @ factors).reshape(pictures[0].shape)
    level = np.maximum(pictures[0].mean(axis=(0, 1)), 1e-6)
    used = level > 0.1 * level.max()
    return float(np.sqrt(np.mean((left / level)[..., used] ** 2)))


_Comparison = tuple[list[str], str, list[_Term]]


def _sums(measurement: Measurement, design: Design | None) -> list[_Comparison]:
    """The untouched gel with all LEDs on, and with each group alone."""
    if design is None:
        return []
    found = []
    backgrounds = [frame for frame in measurement.frames if frame.kind == "background"]
    for whole in backgrounds:
        if whole.leds is not None and set(whole.leds) != set(design.group_names):
            continue
        alike = [f for f in backgrounds if f.crop_px == whole.crop_px and f.exposure == whole.exposure]
        single = {f.leds[0]: f for f in alike if f.leds is not None and len(f.leds) == 1}
        if set(single) == set(design.group_names) and len(single) > 1:
            frames = [whole, *single.values()]
            what = "the sum of the untouched gel's pictures with one LED group each"
            found.append(([f.file for f in frames], what, [_term(measurement, f, 1.0) for f in frames]))
            break
    return found


def _ladders(measurement: Measurement) -> list[_Comparison]:
    """Pairs of frames that differ in their exposure only, the longest against the shortest."""
    groups: dict[str, list[Frame]] = {}
    for frame in measurement.frames:
        if frame.lit and frame.exposure is not None:
            key = frame.model_copy(update={"file": "-", "repeat": None, "exposure": None}).model_dump_json()
            groups.setdefault(key, []).append(frame)
    found = []
    for frames in groups.values():
        frames.sort(key=lambda frame: frame.exposure or 0.0)
        short, long = frames[0], frames[-1]
        ratio = (long.exposure or 1.0) / (short.exposure or 1.0)
        if ratio > 1.2:
            terms = [_term(measurement, long, 1.0), _term(measurement, short, ratio)]
            found.append(([long.file, short.file], f"an exposure ladder of {ratio:.3g}", terms))
    return found


def _term(measurement: Measurement, frame: Frame, weight: float) -> _Term:
    """Picture of a frame averaged to few columns, and the level without light."""
    image = np.asarray(measurement.linear(frame), dtype=float)
    darks = [f for f in measurement.frames if not f.lit and f.crop_px == frame.crop_px]
    dark = None
    if darks:
        dark = np.mean([measurement.linear(f).mean(axis=(0, 1), dtype=float) for f in darks], axis=0)
    columns = min(COLUMNS, image.shape[1])
    rows = max(1, round(image.shape[0] * columns / image.shape[1]))
    return _Term(np.asarray(resize_area(image, rows, columns), dtype=float), dark, weight)


def _letter(channel: int, image: NDArray[np.float32]) -> str:
    return ("red", "green", "blue")[channel] if image.shape[-1] == 3 else "the one channel"
