"""Confounding of effects is the share of the signature of one that another can bring about."""

from collections.abc import Mapping, Sequence

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.likelihood.normal_equations import System

Overlaps = Mapping[tuple[str, str], float]

FLAT_PRIOR = 1e-6  # of a signature: a direction that the other hardly has is none


def overlaps(found: System, names: Sequence[str], steps: Mapping[str, Array] | None = None) -> Overlaps:
    """Share of each effect's signature that each other effect can bring about on the same shots.

    What gains, poses and the simulation's own errors can bring about is taken out before. 1 means that no
    fit tells them apart, whichever fits better.

    Parameters
    ----------
    found : System
        Normal equations of the effects and of all that is fitted along.
    names : sequence of str
        Effects to compare.
    steps : mapping of str to array, optional
        How large an effect's parameters are, in prior standard deviations; the mean over all of unit length
        when absent.

    Returns
    -------
    mapping of (str, str) to float
        Share of the first that the second can bring about.
    """
    places = {n: [k for k, u in enumerate(found.unknowns) if u.effect == n and u.shot < 0] for n in names}
    own = [name for name in names if places[name]]
    kept = [k for name in own for k in places[name]]
    information, _ = found.reduced(kept)
    position = {k: place for place, k in enumerate(kept)}
    table = {}
    for a in own:
        one = [position[k] for k in places[a]]
        whole = information[np.ix_(one, one)]
        step = None if steps is None else steps.get(a)
        weight = np.eye(len(one)) if step is None else np.outer(step, step)
        norm = float(np.sum(whole * weight))
        for b in own:
            if a == b or norm <= 0:
                continue
            other = [position[k] for k in places[b]]
            inner = information[np.ix_(other, other)]
            cross = information[np.ix_(other, one)]
            ridge = FLAT_PRIOR * np.trace(inner) / len(other) * np.eye(len(other))
            explained = cross.T @ np.linalg.solve(inner + ridge, cross)
            table[a, b] = float(np.clip(np.sum(explained * weight) / norm, 0.0, 1.0))
    return table
