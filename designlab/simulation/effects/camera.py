"""Effects between the light on the camera's sensor and its counts."""

from typing import ClassVar, Literal

import numpy as np

from designlab.core.types import Array
from designlab.sensor.camera import View
from designlab.sensor.design import CHANNELS, Design
from designlab.simulation.effects.base import (
    Draws,
    Effect,
    EffectParameter,
    Light,
    Part,
    Scan,
    Sight,
    Signal,
    Stage,
    Values,
)


class FixedPattern(Effect):
    """Pixels differ: a pattern of the sensor, dust on it, dirt that never moves."""

    name: ClassVar[str] = "fixed_pattern"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "every picture carries the same fine pattern"
    changes: ClassVar[tuple[Part, ...]] = ("light",)
    transferable: ClassVar[bool] = False  # another sensor chip, other dust
    per_pixel: ClassVar[str] = "rms"
    unseen_alone: ClassVar[str] = "one picture: explains any picture by itself"

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Pixels of small sensors differ by about 1 % (estimate)."""
        return (EffectParameter("rms", "1", 0.0, 0.01, 0.0, 0.1, "standard deviation of the pattern"),)

    def on_light(self, light: Light, values: Values, sight: Sight) -> Light:
        """Multiply by 1 + rms times the unit's own pattern, (rows, columns); a unit not known has none."""
        pattern = sight.own.get(self.name)
        if pattern is None or not values["rms"]:
            return light
        return np.asarray(light * (1.0 + values["rms"] * pattern), dtype=light.dtype)


class ExposureDrift(Effect):
    """Brightness changes from picture to picture: warm LEDs, automatic exposure."""

    name: ClassVar[str] = "exposure_drift"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "brightness changes from picture to picture"
    changes: ClassVar[tuple[Part, ...]] = ("light",)
    transferable: ClassVar[bool] = False  # every run has its own
    draws: ClassVar[Draws] = Draws("rms", sd=0.02)
    unseen_alone: ClassVar[str] = "one picture: the same as the light of the LEDs"

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """LEDs lose 4 to 7 % by 25 K (MPM 18, 2013, 143); 2 % is common between pictures."""
        return (
            EffectParameter("rms", "1", 0.0, 0.02, 0.0, 0.3, "standard deviation of the pictures' gains"),
        )

    def on_light(self, light: Light, values: Values, sight: Sight) -> Light:
        """Multiply by 1 + rms times the picture's own draw; a new picture has none."""
        drawn = sight.own.get(self.name)
        if drawn is None or not values["rms"]:
            return light
        return np.asarray(light * (1.0 + values["rms"] * float(drawn)), dtype=light.dtype)

    def waves(self, view: View, values: Values) -> Array:
        """All light alike."""
        return np.ones((1, 1, 1))


class Banding(Effect):
    """Bright and dark bands run across the rows: LEDs that flicker while rows are read."""

    name: ClassVar[str] = "banding"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "bands run across the picture, elsewhere in every one"
    changes: ClassVar[tuple[Part, ...]] = ("light",)
    transferable: ClassVar[bool] = False  # every picture has its own
    draws: ClassVar[Draws] = Draws(
        "amplitude",
        sd=0.015,
        count=2,
        steady=True,
        # A wave longer than a picture is a slope there, which much else may bring about.
        scan=Scan("period_rows", tuple(np.geomspace(40.0, 2000.0, 120).tolist()), most_heights=1.05),
    )
    unseen_alone: ClassVar[str] = "one picture: the same as a pattern of the coating"

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """Up to 3 % where LEDs are dimmed by pulses (estimate)."""
        rows = float(design.camera.height_px)
        return (
            EffectParameter("amplitude", "1", 0.0, 0.015, 0.0, 0.3, "amplitude over the mean"),
            EffectParameter(
                "period_rows",
                "1",
                400.0,
                100.0,
                40.0,
                max(2000.0, rows),
                "rows of the full sensor",
                shape=True,
            ),
        )

    def on_light(self, light: Light, values: Values, sight: Sight) -> Light:
        """Multiply by 1 + amplitude sin(2 pi (row / period + phase)), phase the picture's own (turns)."""
        phase = sight.own.get(self.name)
        if phase is None or not values["amplitude"]:
            return light
        _, row = sight.view.centres()
        wave = np.sin(2 * np.pi * (row / values["period_rows"] + float(phase)))
        return np.asarray(light * (1.0 + values["amplitude"] * wave), dtype=light.dtype)

    def waves(self, view: View, values: Values) -> Array:
        """Sine and cosine across the rows of the full sensor."""
        _, row = view.centres()
        turn = 2 * np.pi * row[:, :1] / values["period_rows"]
        return np.stack([np.sin(turn), np.cos(turn)])


class ColourMixing(Effect):
    """A camera channel also sees LED groups of other colours (overlapping spectra, colour matrix)."""

    name: ClassVar[str] = "colour_mixing"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "camera channels see LED groups of other colours"
    changes: ClassVar[tuple[Part, ...]] = ("design",)
    transferable: ClassVar[bool] = True  # filters of the camera's kind over the LEDs' spectra
    recombines: ClassVar[bool] = True
    told_by: ClassVar[Literal["single_group"]] = "single_group"

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """One response for each pair of channel and foreign group; a colour matrix may make it negative."""
        return tuple(
            EffectParameter(
                f"{channel}_from_{group}",
                "1",
                0.0,
                0.1,
                -0.7,
                0.7,
                f"added response of channel {channel} to group {group}, relative to that to its own group",
            )
            for channel, group in _foreign_pairs(design)
        )

    def on_design(self, design: Design, values: Values) -> Design:
        """Add to the mixing matrix; a row is scaled by the channel's response to its own group."""
        if not any(values.values()):
            return design
        matrix = self.on_mixing(design.mixing_matrix, design, values)
        return design.replace({"mixing": tuple(tuple(float(v) for v in row) for row in matrix)})

    def on_mixing(self, mixing: Array, design: Design, values: Values) -> Array:
        """Add the responses."""
        matrix = mixing.copy()
        own = np.abs(mixing).max(axis=1)
        for channel, group in _foreign_pairs(design):
            row, column = CHANNELS.index(channel), design.group_names.index(group)
            matrix[row, column] += values[f"{channel}_from_{group}"] * own[row]
        return matrix


def _foreign_pairs(design: Design) -> list[tuple[str, str]]:
    own = np.abs(design.mixing_matrix).argmax(axis=0)
    return [
        (channel, group)
        for row, channel in enumerate(CHANNELS)
        for column, group in enumerate(design.group_names)
        if own[column] != row
    ]


class BlackLevel(Effect):
    """A constant in every picture: black level of the converter, ambient light at a fixed exposure."""

    name: ClassVar[str] = "black_level"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "a constant is added to every picture"
    changes: ClassVar[tuple[Part, ...]] = ("signal",)
    transferable: ClassVar[bool] = True  # set in the camera's converter
    constant: ClassVar[bool] = True
    told_by: ClassVar[Literal["dark"]] = "dark"

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """One level for each channel; 1024 of 65535 is the black level of a common small camera."""
        return tuple(
            EffectParameter(
                channel, "1", 0.0, 0.015, -1.0, 1.0, f"added to channel {channel}, share of full scale"
            )
            for channel in CHANNELS
        )

    def on_signal(self, signal: Signal, values: Values) -> Signal:
        """Add the levels."""
        return np.asarray(signal + np.array([values[channel] for channel in CHANNELS]))


class ResponseCurve(Effect):
    """The camera answers by a curve that its description lacks."""

    name: ClassVar[str] = "response_curve"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "the camera's answer to light is curved"
    changes: ClassVar[tuple[Part, ...]] = ("signal",)
    transferable: ClassVar[bool] = True  # set in the camera's processing
    curved: ClassVar[bool] = True

    def parameters(self, design: Design) -> tuple[EffectParameter, ...]:
        """An exponent: 1 +- 0.08 for raw data, 0.4 to 0.5 for pictures meant for eyes."""
        return (EffectParameter("exponent", "1", 1.0, 0.08, 0.4, 2.5, "reported value = signal ^ exponent"),)

    def on_signal(self, signal: Signal, values: Values) -> Signal:
        """Raise to the exponent, mirrored about zero for values that noise leaves below."""
        return np.asarray(np.sign(signal) * np.abs(signal) ** values["exponent"])


EFFECTS: tuple[Effect, ...] = (
    Banding(),
    ExposureDrift(),
    FixedPattern(),
    ColourMixing(),
    BlackLevel(),
    ResponseCurve(),
)
"""In the order in which they act."""
