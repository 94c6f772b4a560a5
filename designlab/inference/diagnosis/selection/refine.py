"""The last fit refines the effects that forward selection has found."""

from collections.abc import Sequence
from dataclasses import replace

from designlab.inference.diagnosis.likelihood.fit import Fit, Fitter, with_strength
from designlab.inference.diagnosis.likelihood.repeats import shot_error
from designlab.inference.diagnosis.selection.held_out import judge
from designlab.inference.diagnosis.selection.recentring import (
    beyond,
    exact_fitter,
    is_far,
    looks_elsewhere,
    standing,
)
from designlab.simulation.render_cache import Renders

RECENTRINGS = 3  # times that pictures are rendered anew where a fit stands
SETTLED_SD = 0.02  # prior standard deviations that values may still move by then


def refined(source: Renders, fitter: Fitter, found: Fit, train: Sequence[int]) -> tuple[Fitter, Fit]:
    """Fit the effects found again, as exactly as the frames allow.

    Frames count as repeats show them to agree: a search grants them more, so that nothing small passes for an
    effect. Pictures of light and presses are rendered anew about values far from null.

    Parameters
    ----------
    source : Renders
        Where pictures come from.
    fitter, found : Fitter, Fit
        Where the search ended.
    train : sequence of int
        Shots to fit to.
    """
    error = shot_error(fitter, found.state, train)
    noises = [replace(noise, shot=error) for noise in fitter.noises]
    names = list(found.state.values)
    near = fitter.of(fitter.bank, noises)
    now = near.fit(found.state, names, train)
    for _ in range(RECENTRINGS):
        if not (is_far(near, now.state, SETTLED_SD) or looks_elsewhere(near, now.state, train)):
            break
        near = exact_fitter(source, near, now.state, train)
        now = near.fit(now.state, names, train)
    others = [number for number in range(len(fitter.bank.shots)) if number not in train]
    registered = judge(near, now, others).state
    if near.bank.stands or looks_elsewhere(near, registered, others):
        near = exact_fitter(source, near, registered, others)
    elif far := beyond(near, registered, others):
        near = standing(source, near, registered, far)
    for name in names:
        now = replace(now, state=with_strength(now.state, name))
    return near, now
