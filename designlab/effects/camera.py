"""Effects of the camera."""

from typing import ClassVar

import numpy as np

from designlab.design import CHANNELS, Design
from designlab.effects.base import Effect, Parameter, Signal, Stage, Values


class BlackLevel(Effect):
    """A constant in every picture: black level of the converter, ambient light at a fixed exposure."""

    name: ClassVar[str] = "black_level"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "a constant is added to every picture"
    transferable: ClassVar[bool] = False
    nuisance: ClassVar[bool] = True

    def parameters(self, design: Design) -> tuple[Parameter, ...]:
        """One level for each channel; 1024 of 65535 is the black level of a common small camera."""
        return tuple(
            Parameter(channel, "1", 0.0, 0.015, -1.0, 1.0, f"added to channel {channel}, share of full scale")
            for channel in CHANNELS
        )

    def on_signal(self, signal: Signal, values: Values) -> Signal:
        """Add the levels."""
        return np.asarray(signal + np.array([values[channel] for channel in CHANNELS]))


class ColourMixing(Effect):
    """A camera channel also sees LED groups of other colours (overlapping spectra, colour matrix)."""

    name: ClassVar[str] = "colour_mixing"
    stage: ClassVar[Stage] = "camera"
    summary: ClassVar[str] = "camera channels see LED groups of other colours"
    transferable: ClassVar[bool] = True

    def parameters(self, design: Design) -> tuple[Parameter, ...]:
        """One response for each pair of channel and foreign group; a colour matrix may make it negative."""
        return tuple(
            Parameter(
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
        matrix = design.mixing_matrix.copy()
        own = np.abs(matrix).max(axis=1)
        for channel, group in _foreign_pairs(design):
            row, column = CHANNELS.index(channel), design.group_names.index(group)
            matrix[row, column] += values[f"{channel}_from_{group}"] * own[row]
        return design.replace({"mixing": tuple(tuple(float(v) for v in row) for row in matrix)})


def _foreign_pairs(design: Design) -> list[tuple[str, str]]:
    own = np.abs(design.mixing_matrix).argmax(axis=0)
    return [
        (channel, group)
        for row, channel in enumerate(CHANNELS)
        for column, group in enumerate(design.group_names)
        if own[column] != row
    ]
