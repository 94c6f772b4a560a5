"""The advice names the measurement that would help a diagnosis most."""

from collections.abc import Sequence

import numpy as np

from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.result import Advice, Found, Verdict
from designlab.inference.diagnosis.selection.forward_selection import ForwardSelection
from designlab.inference.diagnosis.verdict.data_checks import below_zero
from designlab.inference.diagnosis.verdict.experiment_design import separating
from designlab.measurement.frames_to_take import DARK
from designlab.measurement.shots import Observations

FEW_HELD_OUT = 4


def advise(
    fitter: Fitter, seen: Observations, search: ForwardSelection, verdict: Verdict, effects: Sequence[Found]
) -> Advice:
    """Name the measurement that would help most; without text where none is needed."""
    names = fitter.forward.design.group_names
    single = {int(np.argmax(s.lit)) for s in seen.shots if s.press is None and (s.lit > 0).sum() == 1}
    missing = [name for group, name in enumerate(names) if group not in single]
    alone = tuple({"kind": "background", "leds": [name]} for name in missing)
    below = bool(missing) and below_zero(effects, seen, fitter.forward.design)
    ambiguous = [winner.equals for winner in search.winners if len(winner.equals) > 1]
    if verdict == "ambiguous":
        return separating(fitter, ambiguous[-1])
    if not seen.repeats:
        return Advice("repeat the background twice: the noise floor is only assumed so far", minutes=1.0)
    if below:
        return Advice(
            ("" if seen.dark else "one frame with the LEDs off, and ")
            + "one background for each LED group alone: counts end at zero, so a frame with the LEDs off "
            "shows no black level below it",
            minutes=float(len(missing)) + (0.0 if seen.dark else 0.5),
            frames=alone if seen.dark else (DARK, *alone),
        )
    if not seen.dark:
        return Advice(
            "one frame with the LEDs off: without it an additive floor hides in other effects",
            minutes=0.5,
            frames=(DARK,),
        )
    if verdict in ("unexplained", "partial") and missing:
        return Advice(
            "one background for each LED group alone: it separates effects of light from those of the camera",
            minutes=float(len(missing)),
            frames=alone,
        )
    if verdict == "partial" and ambiguous:
        return separating(fitter, ambiguous[-1])
    if verdict == "unexplained":
        return Advice(
            "the same press at two more depths, and turned by 180 deg with the gel: the first tells effects "
            "of contact from effects of light, the second effects of the gel from effects of the sensor",
            minutes=15.0,
        )
    held_out = len(seen.of("select"))
    if verdict in ("named", "partial") and held_out < FEW_HELD_OUT:
        more = FEW_HELD_OUT - held_out
        return Advice(
            f"presses at more places: only {held_out} held-out presses bear the verdict", minutes=2.0 * more
        )
    return Advice("")
