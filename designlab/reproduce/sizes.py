"""How much is run: the whole of the paper's layout, or a small part of it that shows that it works."""

from dataclasses import dataclass
from typing import Literal

SizeName = Literal["full", "reduced"]


@dataclass(frozen=True)
class Size:
    """Extent of the experiments.

    Attributes
    ----------
    crop_px : int
        Side of the square that is photographed around a contact.
    places : int
        Places of each shape in the first set; of the second set, its ball and triangle places.
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
    crop_px: int
    places: int
    balls: int
    triangles: int
    samples: int
    repeats: int
    timing_px: tuple[int, ...]
    timing_samples: tuple[int, ...]


SIZES: dict[str, Size] = {
    "full": Size("full", 600, 4, 10, 6, 36, 40, (128, 256, 512, 1024), (4, 8, 16)),
    "reduced": Size("reduced", 240, 1, 2, 2, 16, 2, (64, 128), (4, 8)),
}
