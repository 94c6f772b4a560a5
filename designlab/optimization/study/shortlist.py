"""The shortlist names the few designs of a front to look at first, and what each trades."""

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.types import Array
from designlab.optimization.study.front import losses, pareto

if TYPE_CHECKING:
    import pandas as pd

NORMAL = 1.96  # standard errors to either side that hold 95 %
CLOSE = 0.1  # share of what was tried of a parameter, within which two designs count as alike
NAMED = 3  # parameters that are named where designs are compared


def picks(
    frame: "pd.DataFrame",
    objectives: Mapping[str, str],
    *,
    most: int = 5,
    parameters: Sequence[str] = (),
) -> "pd.DataFrame":
    """Shortlist of the Pareto front: the best in each objective, the knee, then the most different ones.

    Where there is not room for these, the knee comes first.

    The knee is the design nearest to the point that is best in every objective, with each objective scaled to
    its range over the front. A front of thousands helps nobody choose; these are the ones to compare first.

    Parameters
    ----------
    frame : DataFrame
        Table as of `load_results`.
    objectives : mapping
        Score to ``"maximise"`` or ``"minimise"``.
    most : int
        How many at most.
    parameters : sequence of str, optional
        Columns in which designs may differ too. Of designs whose objectives agree within 95 % of their errors
        and whose parameters are close, the first is enough.

    Returns
    -------
    DataFrame
        Rows of the front with a column ``pick`` that says why each was chosen.
    """
    front = pareto(frame, objectives)
    if front.empty:
        return front.assign(pick=[])
    loss = losses(front, objectives)
    span = np.ptp(loss, axis=0)
    scaled = (loss - loss.min(axis=0)) / np.where(span > 0, span, 1.0)
    steps = differences(frame, front, parameters)
    alike = _alike(front, loss, objectives, steps)
    reasons: dict[int, list[str]] = {}

    named = [(int(loss[:, column].argmin()), f"best {name}") for column, name in enumerate(objectives)]
    if len(front) > 1 and len(objectives) > 1:
        knee = int(np.linalg.norm(scaled, axis=1).argmin()), "knee"
        # Where not all are asked for, the one that gives up least of anything comes first.
        named.insert(0 if most <= len(objectives) else len(named), knee)
    for row, reason in named:
        same = next((other for other in reasons if alike[row, other]), row)
        reasons.setdefault(same, []).append(reason)
    apart = np.linalg.norm(scaled[:, None] - scaled[None], axis=-1)
    if parameters:
        apart = np.hypot(apart, np.sqrt((steps**2).mean(axis=-1)))
    while len(reasons) < most:
        chosen = list(reasons)
        distance = np.where(alike[:, chosen].any(axis=1), 0.0, apart[:, chosen].min(axis=1))
        if not distance.max() > 0:
            break  # the rest are like one of those chosen
        reasons[int(distance.argmax())] = ["different"]
    rows = front.iloc[list(reasons)]
    return rows.assign(pick=[", ".join(texts) for texts in reasons.values()]).iloc[:most]


def differences(frame: "pd.DataFrame", rows: "pd.DataFrame", parameters: Sequence[str]) -> Array:
    """By how much some designs differ in each parameter, as a share of what was tried of it.

    Returns
    -------
    array, shape (rows, rows, parameters)
        0 where they agree; 1 where one lacks the parameter, or they differ in words.
    """
    found = np.zeros((len(rows), len(rows), len(parameters)))
    for column, name in enumerate(parameters):
        own = rows[name]
        if all(isinstance(value, int | float | np.number) for value in own.dropna()):
            values = own.to_numpy(dtype=float)
            tried = frame[name].dropna().to_numpy(dtype=float)
            span = float(np.ptp(tried)) if len(tried) else 0.0
            step = np.abs(values[:, None] - values[None]) / (span or 1.0)
            lacking = np.isnan(values)
            step[lacking[:, None] ^ lacking[None]] = 1.0
            found[..., column] = np.nan_to_num(step)
        else:
            words = np.array([str(value) for value in own])
            found[..., column] = words[:, None] != words[None]
    return found


def _alike(
    front: "pd.DataFrame", loss: Array, objectives: Mapping[str, str], steps: Array
) -> NDArray[np.bool_]:
    """Which designs cannot be told apart, shape (designs, designs)."""
    if not steps.shape[-1]:
        return np.eye(len(front), dtype=bool)
    errors = np.stack(
        [np.asarray(front.get(f"{name}_se", np.zeros(len(front))), dtype=float) for name in objectives],
        axis=1,
    )
    joint = NORMAL * np.hypot(errors[:, None], errors[None])
    same_scores = (np.abs(loss[:, None] - loss[None]) <= np.nan_to_num(joint)).all(axis=-1)
    return np.asarray(same_scores & (steps <= CLOSE).all(axis=-1))


def trades(
    chosen: "pd.DataFrame",
    reference: "pd.Series[Any]",
    frame: "pd.DataFrame",
    objectives: Mapping[str, str],
    parameters: Sequence[str],
    units: Mapping[str, str],
    called: Callable[[str], str] = str,
) -> dict[int, str]:
    """What each design of a shortlist gains and gives up against another, and what it changes most, in words.

    Parameters
    ----------
    chosen : DataFrame
        The shortlist.
    reference : Series
        Row of the design to compare with.
    frame, objectives, parameters
        As of `picks`.
    units : mapping
        Units of objectives and parameters; "1" or none for a bare number.
    called : callable, optional
        Name of an objective or parameter for people.

    Returns
    -------
    dict
        Number of the trial to words; that of the reference is left out.
    """
    import pandas as pd

    found: dict[int, str] = {}
    for _, row in chosen.iterrows():
        if row["trial"] == reference["trial"]:
            continue
        sides: dict[str, list[str]] = {"better": [], "worse": [], "not told apart": []}
        for name, way in objectives.items():
            gain = float(row[name] - reference[name]) * (1 if way == "maximise" else -1)
            mine, theirs = (float(one.get(f"{name}_se", 0.0)) for one in (row, reference))
            told = abs(gain) > NORMAL * float(np.nan_to_num(np.hypot(mine, theirs)))
            side = "not told apart" if not told else "better" if gain > 0 else "worse"
            both_values = (_said(float(one[name]), units.get(name, "")) for one in (row, reference))
            sides[side].append(f"{called(name)} ({', not '.join(both_values)})")
        both = pd.concat([row.to_frame().T, reference.to_frame().T])
        steps = differences(frame, both, parameters)[0, 1]
        largest = [int(k) for k in np.argsort(-steps, kind="stable")[:NAMED] if steps[k] > 0]
        own = [name for name in (parameters[k] for k in largest) if not _absent(row[name])]
        changed = [
            f"{called(name)} {_said(row[name], units.get(name, ''))}"
            + ("" if _absent(reference[name]) else f", not {_said(reference[name], units.get(name, ''))}")
            for name in own
        ]
        scores = "; ".join(f"{side} in {', '.join(names)}" for side, names in sides.items() if names)
        found[int(row["trial"])] = scores + (f"; changed most: {'; '.join(changed)}" if changed else "")
    return found


def _absent(value: Any) -> bool:
    return value is None or value != value


def _said(value: Any, unit: str) -> str:
    """A value with its unit, as people write it."""
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text if unit in ("", "1") else f"{text} {unit.replace('um', 'µm')}"
