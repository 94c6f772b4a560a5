"""Confounding of effects is the share of the signature of one that another can bring about."""

from collections.abc import Mapping, Sequence

import numpy as np

from designlab.inference.diagnosis.likelihood.normal_equations import System

Overlaps = Mapping[tuple[str, str], float]

FLAT_PRIOR = 1e-6  # of a signature: a direction that the other hardly has is none


def overlaps(found: System, names: Sequence[str]) -> Overlaps:
    """Share of each effect's signature that each other effect can bring about on the same shots.

    What gains, poses and the simulation's own errors can bring about is taken out before. 1 means that no
    fit tells them apart, whichever fits better.

    Parameters
    ----------
    found : System
        Normal equations of the effects and of all that is fitted along.
    names : sequence of str
        Effects to compare; the mean over all values of unit length.

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
        norm = float(np.trace(information[np.ix_(one, one)]))
        for b in own:
            if a == b or norm <= 0:
                continue
            other = [position[k] for k in places[b]]
            inner = information[np.ix_(other, other)]
            cross = information[np.ix_(other, one)]
            ridge = FLAT_PRIOR * np.trace(inner) / len(other) * np.eye(len(other))
            explained = cross.T @ np.linalg.solve(inner + ridge, cross)
            table[a, b] = float(np.clip(np.trace(explained) / norm, 0.0, 1.0))
    return table
