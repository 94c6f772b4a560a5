"""What a camera that effects have turned or moved sees, resampled from what the nominal one sees."""

from designlab.core.memory import remembered
from designlab.inference.diagnosis.emulator.state import Key, Values, key
from designlab.sensor.camera import View
from designlab.sensor.design import Design
from designlab.simulation.effects import CATALOGUE, effect
from designlab.simulation.optics.resampling import SeenPoints, Warp

KEPT = 64


class Warps:
    """Resamplings of what a design's camera sees into what effects turn it to; many are asked for again.

    Parameters
    ----------
    design : Design
        The design without these effects.
    """

    def __init__(self, design: Design) -> None:
        self.design = design
        self._kept: dict[tuple[Key, Key, View], Warp | None] = {}
        self._seen: dict[tuple[Key, View], SeenPoints] = {}

    def between(self, nominal: Key, changed: Key, view: View) -> Warp | None:
        """Resampling of what a camera sees into what another does; None where they are the same."""

        def warp() -> Warp | None:
            before, after = self._looks(nominal, view), self._looks(changed, view)
            return None if before.design is after.design else Warp(before, after)

        if nominal == changed:
            return None
        return remembered(self._kept, (nominal, changed, view), warp, most=KEPT)

    def _looks(self, values: Key, view: View) -> SeenPoints:
        """What pixels see where effects turn them."""

        def seen() -> SeenPoints:
            design = self.design
            for name, own in values:
                design = effect(name).on_design(design, dict(own))
            return SeenPoints(design, view)

        return remembered(self._seen, (values, view), seen, most=KEPT)


def turning(values: Values) -> Key:
    """Values of the effects that turn where pixels look."""
    return key(values, [e.name for e in CATALOGUE if e.warps])
