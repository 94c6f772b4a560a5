"""The size of a reproduction is the whole of the paper's layout, or a small part that shows that it works."""

from dataclasses import dataclass
from typing import Literal

CROP_PX = 600  # side of the square of sensor pixels around a contact that the paper compares
SENSORS = {"flat": "gelsight-2020-flat", "dome": "gelsight-2020-dome"}
"""Presets of the paper's sensors, by the shape of their gel."""
SizeName = Literal["full", "reduced"]


@dataclass(frozen=True)
class Size:
    """Extent of the experiments.

    Attributes
    ----------
    shapes_of_gel : tuple of str
        "flat" and "dome": which sensors are photographed.
    binned : int
        Side of the squares of sensor pixels that are averaged in pictures for accuracy; timed are as small.
    shapes, places : int
        Shapes of the first set, and places of each.
    balls, triangles : int
        Places of ball and triangle in the second set.
    columns : int
        Of the pictures that are fitted to.
    samples : int
        Samples per pixel and LED group of the true pictures.
    repeats : int
        Hidden sensors that are fitted.
    timing_px : tuple of int
        Sides of the pictures that are timed.
    timing_samples : tuple of int
        Samples per pixel that are timed.
    """

    name: SizeName
    shapes_of_gel: tuple[str, ...]
    binned: int
    shapes: int
    places: int
    balls: int
    triangles: int
    columns: int
    samples: int
    repeats: int
    timing_px: tuple[int, ...]
    timing_samples: tuple[int, ...]

    @property
    def crop_px(self) -> int:
        """Side of a picture."""
        return CROP_PX // self.binned


SIZES: dict[str, Size] = {
    "full": Size("full", ("flat", "dome"), 1, 3, 4, 10, 6, 150, 36, 40, (128, 256, 512, 1024), (4, 8, 16)),
    "reduced": Size("reduced", ("dome",), 8, 1, 1, 1, 1, 50, 16, 1, (64, 128), (4, 8)),
}
