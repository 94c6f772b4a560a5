"""Grain of single frames is no effect, but every fit has to know its size."""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import maximum_filter

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.noise import DARK_LIGHT
from designlab.measurement.grain import grain_variances

TOUCHED = 0.02  # relative change of light from which a press is seen, whose errors are no grain
MARGIN_PX = 3  # about that
LEAST = 0.002  # relative: less is granted to every simulation


def grain(fitter: Fitter, state: State, shots: Sequence[int]) -> float:
    """Size of the grain of single frames, relative to their light; 0 where it is less than is granted anyway.

    Sampling noise of a simulation, dust and compression look so. Repeats of a frame count as one.
    """
    states: dict[tuple[object, ...], list[tuple[Array, Array]]] = {}
    for number in shots:
        shot, black = fitter.bank.shots[number], fitter.forward.black
        if shot.lit.any():
            light = fitter.forward.predict(state, number) - black
            bare = fitter.forward.untouched(state, number) - black
            pressed = np.abs(light - bare) > TOUCHED * np.abs(bare)
            near = maximum_filter(pressed, size=(2 * MARGIN_PX + 1, 2 * MARGIN_PX + 1, 1))
            light = np.where(shot.valid & ~near & (light > DARK_LIGHT), light, np.nan)
            key = (shot.signal.shape, shot.press, tuple(shot.lit.tolist()), shot.gel_rotation_deg, shot.view)
            states.setdefault(key, []).append(((shot.signal - black) / light - 1, shot.variance / light**2))
    found: list[float] = []
    for shape in {fitter.bank.shots[number].signal.shape for number in shots}:
        alike = [np.array(own) for key, own in states.items() if key[0] == shape]
        left = [own[:, 0].mean(axis=0) for own in alike]
        found += grain_variances(left, [own[:, 1].mean(axis=0) / len(own) for own in alike])
    size = float(np.sqrt(max(np.median(found), 0.0))) if found else 0.0
    return size if size > LEAST else 0.0
