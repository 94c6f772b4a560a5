"""Whether pictures have colour: without it, LED groups of different colours cannot be told apart."""

import numpy as np
from numpy.typing import NDArray

from designlab.core.images import narrowed
from designlab.measurement.frames import MeasuredFrame, Measurement
from designlab.measurement.quality.suspicion import Suspicion
from designlab.sensor.design import Design

COLUMNS = 16  # to which a picture is averaged: light is smooth, noise is not
# Root mean square difference of channels of equal mean. Pictures of two built sensors with coloured LEDs and
# of the presets have 0.2 to 0.6, white LEDs behind a diffuser 0.01 to 0.03.
PROPORTIONAL = 0.05
ALIKE = (
    0.35  # correlation of channels over the picture: of white light 0.57 and more, of colours that even light
)
# makes proportional 0.2 at most
DIM = 0.2  # of the brightest channel: below, the light itself is coloured
APART = 0.3  # of 2, between the sides that two channels are lit from: less need not show
SHOWING = ("background", "press")  # kinds of frames that show the gel under the sensor's own light


def missing_colour(picture: NDArray[np.floating]) -> str | None:
    """Say why a picture, (rows, columns, channels), has no colour; None where it has, or is dark.

    Parameters
    ----------
    picture : array
        Linear values without the level of darkness, as far as known.
    """
    if picture.shape[-1] == 1:
        return "one channel"
    if (picture == picture[..., :1]).all():
        return "its three channels are equal"
    values = narrowed(np.asarray(picture, dtype=float), COLUMNS)
    levels = values.mean(axis=(0, 1))
    if not levels.min() > DIM * levels.max() > 0:
        return None
    shares = values / levels
    with np.errstate(divide="ignore", invalid="ignore"):
        together = np.corrcoef(shares.reshape(-1, shares.shape[-1]).T)
    if not together.min() > ALIKE:
        return None
    apart = shares - shares.mean(axis=-1, keepdims=True)
    if np.sqrt((apart**2).sum(axis=-1).mean() / 2) > PROPORTIONAL:
        return None
    return f"its three channels are proportional within {PROPORTIONAL:.0%}"


def colourless(measurement: Measurement, design: Design | None) -> list[Suspicion]:
    """Find frames without colour where the lamps that were on light the channels from different sides."""
    if design is None:
        return []
    found: dict[str, list[str]] = {}
    for frame in measurement.frames:
        if frame.kind not in SHOWING or not frame.lit or not _lit_from_sides(frame, design):
            continue
        known = measurement.response != "unknown"
        why = missing_colour(measurement.linear(frame) if known else measurement.image(frame))
        if why is not None:
            found.setdefault(why, []).append(frame.file)
    return [
        Suspicion(
            "colourless",
            tuple(files),
            f"no colour: {why}",
            "a monochrome camera, a picture saved in grey, or white LEDs instead of the design's "
            f"{', '.join(design.group_names)}",
            "take pictures in colour; or give the sensor's own design, with its white LEDs in mixing",
        )
        for why, files in found.items()
    ]


def _lit_from_sides(frame: MeasuredFrame, design: Design) -> bool:
    """Whether channels are lit from different sides: lamps around the gel's axis, weighted by their light."""
    side = np.array(
        [np.exp(1j * np.radians(np.asarray(group.azimuth_deg))).mean() for group in design.leds.groups]
    )
    lit = [frame.leds is None or name in frame.leds for name in design.group_names]
    light = design.transfer_mw[:, lit]
    weight = light.sum(axis=1)
    sides = light[weight > 0] @ side[lit] / weight[weight > 0]
    return bool(np.abs(sides[:, None] - sides).max(initial=0.0) > APART)
