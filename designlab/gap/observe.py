"""Which shots of a measurement a diagnosis needs, and which it uses."""

from designlab.design import Design
from designlab.measurement import Measurement, MeasurementError
from designlab.measurement.shots import Observations, Shot
from designlab.measurement.shots import observe as gathered

LEAST_PLACES = 3


def observe(measurement: Measurement, design: Design, *, columns: int) -> Observations:
    """Gather the shots of a measurement as `shots.observe` does, and check that a diagnosis can use them.

    Raises
    ------
    MeasurementError
        As there, or if a background or presses for training, selection and final numbers are missing.
    """
    seen = gathered(measurement, design, columns=columns)
    _require_enough(measurement, seen.shots)
    return seen


def _require_enough(measurement: Measurement, shots: tuple[Shot, ...]) -> None:
    if not any(shot.press is None for shot in shots):
        raise MeasurementError(f"{measurement.folder}: field frame: a background with LEDs on is needed")
    missing = [use for use in ("train", "select", "final") if not any(shot.use == use for shot in shots)]
    if missing:
        raise MeasurementError(
            f"{measurement.folder}: field frame: usable presses at {LEAST_PLACES} places or more are needed, "
            f"so that an effect fitted at one is judged at others; none is left for {', '.join(missing)}"
        )


def limited(shots: tuple[Shot, ...], most: int) -> tuple[Shot, ...]:
    """Keep at most `most` training presses, those of the most places and the deepest first."""
    train = [shot for shot in shots if shot.use == "train"]
    kept: list[Shot] = []
    rest = sorted(train, key=lambda shot: -(shot.press.depth_mm if shot.press else 0.0))
    while rest and len(kept) < most:
        places = {shot.press.centre_mm for shot in kept if shot.press}
        fresh = [shot for shot in rest if shot.press and shot.press.centre_mm not in places]
        chosen = (fresh or rest)[0]
        kept.append(chosen)
        rest = [shot for shot in rest if shot is not chosen]
    return tuple(shot for shot in shots if shot.use != "train" or any(shot is k for k in kept))
