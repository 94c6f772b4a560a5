"""Values of effects with several parameters, drawn towards null along what the frames leave open.

A camera that stands aside and one that is turned make nearly the same picture. What no catalogue lists then
decides between them, and may put both far off while they cancel. How large an effect is, though, shows in
what the frames do tell of it, and all its parameters are of one size in prior standard deviations: so that
is what values can be held to where the frames say nothing (empirical Bayes; Efron and Morris 1973).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from designlab.gap.coordinates import coordinate, value_at
from designlab.gap.fit import DRAWN_SD, Fit, Fitter
from designlab.gap.learnt import unlisted_sd

Array = NDArray[np.float64]

SIZES = np.geomspace(1e-3, 10.0, 200)  # of an effect's parameters, in prior standard deviations


def shrunk(fitter: Fitter, fit: Fit, train: Sequence[int]) -> Fit:
    """Fit with values drawn towards null, gains and poses fitted anew.

    Parameters
    ----------
    fitter, fit : Fitter, Fit
        Where the search ended.
    train : sequence of int
        Shots that were fitted to.
    """
    state = fit.state
    for name in fit.state.values:
        moved = _values(fitter, fit, name)
        if moved:
            state = state.with_values(name, {**state.values[name], **moved})
    if state is fit.state:
        return fit
    own = [name for name in state.values if name in DRAWN_SD]
    settled = fitter.fit(state, (), train, held=own)
    return replace(settled, system=fitter.system(settled.state, train, fit.system.unknowns))


def _values(fitter: Fitter, fit: Fit, name: str) -> dict[str, float]:
    """Values of an effect's parameters of one kind; empty if it has less than two."""
    known = {p.name: p for p in fitter.forward.parameters[name] if not (p.shape or p.squared)}
    unknowns = fit.system.unknowns
    places = [k for k, u in enumerate(unknowns) if u.effect == name and u.shot < 0 and u.name in known]
    if len(places) < 2:
        return {}
    parameters = [known[unknowns[k].name] for k in places]
    values = fit.state.values[name]
    information, _ = fit.system.reduced(places)
    covariance = np.asarray(np.linalg.inv(information + np.eye(len(places))))
    unlisted = unlisted_sd(name, parameters[0].name, shape=False) ** 2
    # What no catalogue lists pulls most along what the frames tell least.
    wider = 1 + unlisted / float(np.diag(covariance).mean())
    estimates = np.array([coordinate(p, values[p.name]) for p in parameters])
    found = drawn_to_null(estimates, wider * covariance)
    return {p.name: value_at(p, float(t)) for p, t in zip(parameters, found, strict=True)}


def drawn_to_null(values: Array, covariance: Array) -> Array:
    """Posterior mean of values that come from a normal distribution of unknown width about null.

    Parameters
    ----------
    values : array, shape (n,)
        Estimates.
    covariance : array, shape (n, n)
        Of their errors, in the units of the widths `SIZES`, over which the mean goes with even weights of
        their logarithms.

    Examples
    --------
    >>> drawn_to_null(np.array([1.0, 1.0]), 1e-6 * np.eye(2)).round(2).tolist()
    [1.0, 1.0]
    """
    variances, axes = np.linalg.eigh(covariance)
    along = axes.T @ values
    wide = SIZES[:, None] ** 2 + variances
    logarithm = -0.5 * (along**2 / wide + np.log(wide)).sum(axis=1)
    weight = np.exp(logarithm - logarithm.max())
    kept = (weight[:, None] * SIZES[:, None] ** 2 / wide).sum(axis=0) / weight.sum()
    return np.asarray(axes @ (kept * along))
