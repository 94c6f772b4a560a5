"""The negative control is the share of the gap that a wrong effect of the same size takes away."""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.result import Control
from designlab.inference.diagnosis.selection.held_out import Judged, judge, level
from designlab.simulation.effects import effect


def control(
    fitter: Fitter,
    start: State,
    *,
    named: Collection[str],
    as_good: Collection[str],
    tried: Collection[str],
    seed: int,
    train: Sequence[int],
    final: Sequence[int],
    before: Judged,
    corrected: Judged,
) -> Control | None:
    """Fit a wrong effect as the right one was fitted, and judge it on the presses that decide nothing.

    Of the effects tried that do not do as well as those named, it is the one whose number of parameters is
    nearest to theirs; of several, one by chance.

    Parameters
    ----------
    start : State
        Of the model as given, fitted to the training shots.
    named, as_good : collection of str
        Effects that were named, and all that do as well.
    tried : collection of str
        All effects that were tried.
    seed : int
        Of the choice among several; another for every measurement.
    before, corrected : Judged
        The final presses with the model as given, and with the effects named.

    Returns
    -------
    Control or None
        None where no effect is left to compare with.
    """
    # With a number of its own for every picture or pixel, an effect has no size to compare.
    sizes = {n: len(effect(n).null(fitter.forward.design)) for n in tried if not effect(n).drawn}
    wanted = sum(len(effect(n).null(fitter.forward.design)) for n in named)
    wrong = [name for name in sizes if name not in as_good and name not in named]
    if not wrong:
        return None
    nearest = min(abs(sizes[name] - wanted) for name in wrong)
    close = sorted(name for name in wrong if abs(sizes[name] - wanted) == nearest)
    name = close[int(np.random.default_rng([seed, wanted]).integers(len(close)))]
    found = fitter.fit(replace(start, poses={}), [name], train)
    after = judge(fitter, found, final)
    removed = level(before, after, corrected=corrected).removed
    return None if removed is None else Control(name, removed, sizes[name])
