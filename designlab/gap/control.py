"""The control of a diagnosis: what a wrong effect of the same size takes away of the gap."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from designlab.gap.fit import DRAWN_SD, Fitter
from designlab.gap.forward import State
from designlab.gap.judge import Judged, judge
from designlab.gap.result import Control, Level

NOT_COUNTED = (*DRAWN_SD, "fixed_pattern")
"""Effects with a number of their own for every picture or pixel: they have no size to compare."""


def control(
    fitter: Fitter,
    start: State,
    *,
    named: Collection[str],
    as_good: Collection[str],
    evidence: Mapping[str, float],
    train: Sequence[int],
    final: Sequence[int],
    before: Judged,
) -> Control | None:
    """Fit a wrong effect as the right one was fitted, and judge it on the presses that decide nothing.

    Of the effects tried that do not do as well as those named, it is the one whose number of parameters is
    nearest to theirs; of several, the one that looked best before anything was fitted.

    Parameters
    ----------
    start : State
        Of the model as given, fitted to the training shots.
    named, as_good : collection of str
        Effects that were named, and all that do as well.
    evidence : mapping of str to float
        Of every effect tried, by linear approximation.
    before : Judged
        The final presses with the model as given.

    Returns
    -------
    Control or None
        None where no effect is left to compare with.
    """
    sizes = {name: len(fitter.forward.parameters[name]) for name in evidence if name not in NOT_COUNTED}
    wanted = sum(len(fitter.forward.parameters[name]) for name in named)
    wrong = [name for name in sizes if name not in as_good and name not in named]
    if not wrong:
        return None
    name = min(wrong, key=lambda name: (abs(sizes[name] - wanted), -evidence[name]))
    found = fitter.fit(replace(start, poses={}), [name], train)
    after = judge(fitter, found.state, final)
    level = Level(before.mean, after.mean, float(before.floor.mean()))
    return None if level.removed is None else Control(name, level.removed, sizes[name])
