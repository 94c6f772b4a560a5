"""How much is run: the whole of the paper's layout, or a small part of it that shows that it works."""

from dataclasses import dataclass
from typing import Literal

CROP_PX = 600  # side of the square of sensor pixels around a contact that the paper compares
SizeName = Literal["full", "reduced"]


@dataclass(frozen=True)
class Size:
    """Extent of the experiments.

    Attributes
    ----------
    binned : int
        Side of the squares of sensor pixels that are averaged in pictures for accuracy; timed are as small.
    places, balls, triangles : int
        Places of each shape in the first set, and of ball and triangle in the second.
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
    binned: int
    places: int
    balls: int
    triangles: int
    samples: int
    repeats: int
    timing_px: tuple[int, ...]
    timing_samples: tuple[int, ...]

    @property
    def crop_px(self) -> int:
        """Side of a picture."""
        return CROP_PX // self.binned


SIZES: dict[str, Size] = {
    "full": Size("full", 1, 4, 10, 6, 36, 40, (128, 256, 512, 1024), (4, 8, 16)),
    "reduced": Size("reduced", 5, 1, 2, 2, 16, 2, (64, 128), (4, 8)),
}
