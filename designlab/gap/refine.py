"""Last fit of the effects that a search has found, which need no longer be told from others."""

from collections.abc import Sequence
from dataclasses import replace

from designlab.effects import effect
from designlab.gap.bank import Bank
from designlab.gap.basis import Renders
from designlab.gap.exact import exact
from designlab.gap.fit import DRAWN_SD, Fit, Fitter, with_strength
from designlab.gap.judge import judge
from designlab.gap.noise import Noise
from designlab.gap.repeats import shot_error

RECENTRINGS = 3  # times that pictures are rendered anew where a fit stands
FAR_SD = 0.5  # prior standard deviations from null that pictures rendered about it are exact enough for
SETTLED_SD = 0.02  # likewise, that values may still move by then


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
    names = [name for name in found.state.values if name != "fixed_pattern"]
    near = _fitter(fitter.bank, noises, fitter)
    now = near.fit(found.state, names, train)
    rendered = [name for name in names if effect(name).rendered]
    for _ in range(RECENTRINGS if _far(near, now) else 0):
        near = _fitter(exact(source, near.forward, now.state, rendered, train), noises, fitter)
        before, now = now, near.fit(now.state, names, train)
        if _moved(near, before, now, rendered) < SETTLED_SD:
            break
    if near.bank is not fitter.bank:
        others = [number for number in range(len(fitter.bank.shots)) if number not in train]
        standing = judge(near, now.state, others).state
        near = _fitter(exact(source, near.forward, standing, rendered, others), noises, fitter)
    for name in DRAWN_SD.keys() & now.state.values.keys():
        now = replace(now, state=with_strength(now.state, name))
    return near, now


def _fitter(bank: Bank, noises: list[Noise], like: Fitter) -> Fitter:
    """Fitter that counts values as another does, of other pictures and noise."""
    new = Fitter(bank)
    new.noises, new.alike, new.smooth_alike = noises, like.alike, like.smooth_alike
    return new


def _far(fitter: Fitter, now: Fit) -> bool:
    """Whether pictures rendered about null are too far from what was found."""
    return any(
        abs(values[p.name] - p.null) > FAR_SD * p.sd
        for name, values in now.state.values.items()
        if effect(name).rendered
        for p in fitter.forward.parameters[name]
        if not p.shape  # what only shapes an effect is known least, and cannot be far alone
    )


def _moved(fitter: Fitter, before: Fit, after: Fit, names: Sequence[str]) -> float:
    """Furthest way of a parameter from one fit to another, in prior standard deviations."""
    return max(
        abs(after.state.values[name][p.name] - before.state.values[name][p.name]) / p.sd
        for name in names
        for p in fitter.forward.parameters[name]
        if not p.shape
    )
