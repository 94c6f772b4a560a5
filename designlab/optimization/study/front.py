"""The Pareto front of a table of trials holds the best designs; its history tells how it came about."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd


def losses(frame: "pd.DataFrame", objectives: Mapping[str, str]) -> NDArray[np.float64]:
    """Objectives of the rows of a table, turned so that smaller is better; shape (rows, objectives)."""
    columns = [
        np.asarray(frame[name], dtype=float) * (-1.0 if way == "maximise" else 1.0)
        for name, way in objectives.items()
    ]
    return np.stack(columns, axis=1)


def valid(frame: "pd.DataFrame") -> "pd.DataFrame":
    """Rows of evaluated designs that keep the constraints."""
    done = frame[frame["state"] == "complete"]
    return done[done["violated"].isna()] if "violated" in done else done


def pareto(frame: "pd.DataFrame", objectives: Mapping[str, str]) -> "pd.DataFrame":
    """Rows that no other complete row beats or equals in all objectives while beating it in one.

    Parameters
    ----------
    frame : DataFrame
        Table as of `load_results`.
    objectives : mapping
        Score to ``"maximise"`` or ``"minimise"``.

    Returns
    -------
    DataFrame
        The rows of the front, best first in the first objective; of equal designs the first one.
    """
    done = valid(frame)
    done = done[done["reuse_of"].isna()]
    if done.empty:  # then the table may lack the scores
        return done
    done = done.iloc[np.flatnonzero(np.isfinite(losses(done, objectives)).all(axis=1))]
    loss = losses(done, objectives)
    no_worse = (loss[:, None] <= loss[None]).all(axis=-1)
    better = (loss[:, None] < loss[None]).any(axis=-1)
    front = done.iloc[np.flatnonzero(~(no_worse & better).any(axis=0))]
    first = losses(front, objectives)[:, 0]
    return front.iloc[np.argsort(first, kind="stable")]


def hypervolume(loss: NDArray[np.float64], reference: NDArray[np.float64]) -> float:
    """Area dominated by points of two losses, up to a reference point; shape (n, 2) and (2,)."""
    inside = loss[(loss < reference).all(axis=1)]
    area, ceiling = 0.0, float(reference[1])
    for first, second in inside[np.lexsort((inside[:, 1], inside[:, 0]))]:
        if second < ceiling:
            area += (reference[0] - first) * (ceiling - second)
            ceiling = float(second)
    return float(area)


def history(frame: "pd.DataFrame", objectives: Mapping[str, str]) -> "pd.DataFrame":
    """Progress of a study: best value of each objective, and with two objectives the hypervolume.

    Returns
    -------
    DataFrame
        One row a complete trial: ``trial``, each objective's best value so far, and ``hypervolume`` as a
        share of its last value, with the worst value of each objective as the reference. Designs that break
        a constraint do not count.
    """
    import pandas as pd

    done = valid(frame)
    table: dict[str, Any] = {"trial": done["trial"].to_numpy()}
    if done.empty:
        return pd.DataFrame(table | {name: [] for name in objectives})
    loss = losses(done, objectives)
    best = np.minimum.accumulate(loss, axis=0)
    for column, (name, way) in enumerate(objectives.items()):
        table[name] = -best[:, column] if way == "maximise" else best[:, column]
    if len(objectives) == 2:
        reference = loss.max(axis=0)
        areas = np.array([hypervolume(loss[: count + 1], reference) for count in range(len(loss))])
        table["hypervolume"] = areas / areas[-1] if areas[-1] > 0 else areas
    return pd.DataFrame(table)
