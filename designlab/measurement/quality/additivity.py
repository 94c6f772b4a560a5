"""Whether light adds up in pictures as the stated response says: sums of LED groups, exposure ladders."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from designlab.core.images import narrowed
from designlab.core.types import Array
from designlab.measurement.frames import FULL_SCALE, MeasuredFrame, Measurement, alike, dark_level
from designlab.measurement.quality.suspicion import Suspicion
from designlab.sensor.design import Design
from designlab.sensor.response_curve import Response

FEW_SATURATED = 0.005  # of the values of a picture that is compared
COLUMNS = 16  # to which pictures are averaged before sums are compared: light is smooth
LEAST_MISFIT = 0.05  # of the mean signal: less is explained by lamps that heat up, stray light, noise
MOST_MISFIT = 0.03  # that the curve named instead may leave
MOST_EXCESS = 0.2  # that pictures which no curve explains may leave before work stops for it
MOST_CUT = 0.1  # of a channel at zero, from which a colour matrix is suspected
BETTER = 3.0  # factor by which another curve must be better
STEP = 1e-4
SAG = 0.1  # share by which a group may be dimmer or brighter beside others


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


def added_light(measurement: Measurement, design: Design | None) -> list[Suspicion]:
    """Compare sums of lights and ladders of exposures as declared and with another response."""
    if measurement.response == "unknown":
        return []
    found = []
    for _, files, what, terms in (*_sums(measurement, design), *_ladders(measurement)):
        declared = _misfit(terms)
        if declared < LEAST_MISFIT:
            continue
        evidence = f"{what} misses by {declared:.1%} of the mean with response {measurement.response}"
        for curve in other_curves(measurement.response):
            other = _misfit([term.behind(curve) for term in terms])
            if other < MOST_MISFIT and BETTER * other < declared:
                said = f"{evidence}, by {other:.1%} with {curve.label}"
                return [nonlinear(files, curve, measurement.response, said)]
        found.append(_unexplained(measurement, files, evidence, strong=declared > MOST_EXCESS))
    return found


def added_light_misfits(
    measurement: Measurement, design: Design | None
) -> list[tuple[str, list[str], float]]:
    """Misfits over the mean of every sum and ladder that the frames allow: its kind, files, misfit."""
    if measurement.response == "unknown":
        return []
    compared = (*_sums(measurement, design), *_ladders(measurement))
    return [(kind, files, _misfit(terms)) for kind, files, _, terms in compared]


def _unexplained(measurement: Measurement, files: Sequence[str], evidence: str, *, strong: bool) -> Suspicion:
    """Light that adds up with no usual response."""
    frames = [frame for frame in measurement.frames if frame.file in files]
    cut = max(float((measurement.image(frame) <= 0).mean(axis=(0, 1)).max()) for frame in frames)
    evidence = f"{evidence}, and with no other usual one"
    if cut > MOST_CUT:
        # What is cut is lost, but what is left is still light: the fit knows no negative light either.
        return Suspicion(
            "not_additive",
            tuple(files),
            f"{evidence}; {cut:.0%} of a channel are cut at zero",
            "a colour matrix of the camera, whose negative values are cut",
            "switch colour correction off, or save raw files; a matrix that is known is undone by "
            "`designlab import --colour-matrix`",
            strong=False,
        )
    return Suspicion(
        "not_additive",
        tuple(files),
        evidence,
        "automatic exposure, gain or white balance, exposures other than stated, light from outside, or LEDs "
        "that dim each other",
        "fix the camera's settings and take these pictures again in the dark; state the exposures",
        strong=strong,
    )


class _Term(NamedTuple):
    """A picture, its level without light if known, the variance of its noise, and its factor in the sum."""

    values: Array
    dark: Array | None
    variance: Array
    weight: float

    def behind(self, curve: Curve) -> "_Term":
        """Return the same with another response."""
        level = self.values.mean(axis=(0, 1))
        slope = (curve(level + STEP) - curve(level)) / STEP
        dark = None if self.dark is None else curve(self.dark)
        return _Term(curve(self.values), dark, self.variance * slope**2, self.weight)


def _misfit(terms: Sequence[_Term]) -> float:
    """Root mean square of what is left of the first picture without the others, over its mean, without noise.

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
    noise = np.sum([t.variance * t.weight**2 for t in terms], axis=0)
    used = level > 0.1 * level.max()
    excess = ((left**2).mean(axis=(0, 1)) - noise) / level**2
    return float(np.sqrt(max(excess[used].mean(), 0.0)))


_Comparison = tuple[str, list[str], str, list[_Term]]


def _sums(measurement: Measurement, design: Design | None) -> list[_Comparison]:
    """The untouched gel with all LEDs on, and with each group alone."""
    if design is None:
        return []
    found: list[_Comparison] = []
    backgrounds = [f for f in measurement.frames if f.kind == "background" and _unsaturated(measurement, f)]
    for whole in backgrounds:
        if whole.leds is not None and set(whole.leds) != set(design.group_names):
            continue
        alike = [f for f in backgrounds if f.crop_px == whole.crop_px and f.exposure == whole.exposure]
        single = {f.leds[0]: f for f in alike if f.leds is not None and len(f.leds) == 1}
        if set(single) == set(design.group_names) and len(single) > 1:
            frames = [whole, *single.values()]
            what = "the sum of the untouched gel's pictures with one LED group each"
            terms = [_term(measurement, f, 1.0) for f in frames]
            found.append(("superposition", [f.file for f in frames], what, terms))
            break
    return found


def _ladders(measurement: Measurement) -> list[_Comparison]:
    """Pairs of frames that differ in their exposure only, the longest against the shortest."""
    timed = (f for f in measurement.frames if f.lit and f.exposure is not None)
    found: list[_Comparison] = []
    for frames in alike((f for f in timed if _unsaturated(measurement, f)), but=["exposure"]):
        frames.sort(key=lambda frame: frame.exposure or 0.0)
        short, long = frames[0], frames[-1]
        ratio = (long.exposure or 1.0) / (short.exposure or 1.0)
        if ratio > 1.2:
            terms = [_term(measurement, long, 1.0), _term(measurement, short, ratio)]
            what = f"an exposure ladder of {ratio:.3g}"
            found.append(("exposure ladder", [long.file, short.file], what, terms))
    return found


def _term(measurement: Measurement, frame: MeasuredFrame, weight: float) -> _Term:
    """Picture of a frame averaged to few columns, and the level without light."""
    image = np.asarray(measurement.linear(frame), dtype=float)
    values = narrowed(image, COLUMNS)
    # Neighbours differ by noise; what the scene adds to that only makes the comparison more lenient.
    noise = (np.diff(image, axis=1) ** 2).mean(axis=(0, 1)) / 2
    averaged = image.size / values.size
    return _Term(values, dark_level(measurement, frame), noise / averaged, weight)


def _unsaturated(measurement: Measurement, frame: MeasuredFrame) -> bool:
    return bool((measurement.image(frame) >= FULL_SCALE).mean() < FEW_SATURATED)
