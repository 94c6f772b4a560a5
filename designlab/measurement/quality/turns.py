"""How pictures, or places noted in them, may lie against the sensor frame (x right, y up)."""

from typing import Any, NamedTuple


class Turn(NamedTuple):
    """A turn or mirroring: what stands at (x, y) is taken to ``matrix @ (x, y)``.

    Attributes
    ----------
    text : str
        What became of pictures, in words.
    matrix : tuple of tuple of int
        Each row has one entry of 1 or -1 and one of 0.
    """

    text: str
    matrix: tuple[tuple[int, int], tuple[int, int]]

    def placed(self, x: float, y: float) -> tuple[float, float]:
        """Where what stands at (x, y) is taken."""
        (a, b), (c, d) = self.matrix
        return a * x + b * y, c * x + d * y

    @property
    def place(self) -> str:
        """The same written down, such as ``[x, -y]``."""
        x, y = (("-" if a + b < 0 else "") + ("x" if a else "y") for a, b in self.matrix)
        return f"[{x}, {y}]"

    def undone(self, image: Any) -> Any:
        """Return a picture, (rows, columns, ...), as it was before; a view of it."""
        (a, b), (c, d) = self.matrix
        return image[::d, ::a] if a else image.swapaxes(0, 1)[::-b, ::-c]


TURNS = {
    "": Turn("as they are", ((1, 0), (0, 1))),
    "left-right": Turn("mirrored left to right", ((-1, 0), (0, 1))),
    "up-down": Turn("mirrored top to bottom", ((1, 0), (0, -1))),
    "half": Turn("turned by 180 deg", ((-1, 0), (0, -1))),
    # Of square pictures also:
    "left": Turn("turned by 90 deg", ((0, -1), (1, 0))),
    "right": Turn("turned by 270 deg", ((0, 1), (-1, 0))),
    "diagonal": Turn("mirrored along a diagonal", ((0, -1), (-1, 0))),
    "other diagonal": Turn("mirrored along the other diagonal", ((0, 1), (1, 0))),
}
UPRIGHT = tuple(TURNS)[:4]  # that leave the size of a picture as it is
