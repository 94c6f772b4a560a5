"""Sweeps over full grids, and the optimisation as a notebook would call it."""

import contextlib
import itertools
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import ValidationError

from designlab.core.interrupts import Interrupts
from designlab.core.progress import bar
from designlab.core.run_folder import claim
from designlab.core.store import digest, read_json, write_json
from designlab.core.workers import finished
from designlab.evaluation.press_plan import PressPlan
from designlab.optimization.constraint import Bound
from designlab.optimization.outcome import Evaluator, Simulated, evaluate_design, prepared, told
from designlab.optimization.study.definition import AREA, Plan, Sampler, Study, StudyError, carried
from designlab.optimization.study.parameter import Parameter
from designlab.optimization.study.results import Results
from designlab.optimization.study.robust import Robust
from designlab.optimization.study.runner import run_study
from designlab.sensor.design import Design, DesignError
from designlab.sensor.field_errors import explain

if TYPE_CHECKING:
    import pandas as pd

    from designlab.simulation.effects.model import SensorModel

SWEEP_FILE = "sweep.json"
ROWS_FOLDER = "rows"
Fidelity = Literal["fast", "standard", "reference"]


class SweepInterrupted(KeyboardInterrupt):
    """A sweep was stopped by the user; the text says how far it came and how to go on."""


def sweep(
    design: "Design | SensorModel",
    values: Mapping[str, Iterable[Any]],
    *,
    fidelity: Fidelity = "fast",
    seed: int = 0,
    depth_mm: float | None = None,
    force_n: float | None = None,
    workers: int = 1,
    dask: str | None = None,
    progress: bool = True,
    evaluator: Evaluator | None = None,
    out: str | Path | None = None,
    also: Mapping[str, Sequence[str]] | None = None,
) -> "pd.DataFrame":
    """Evaluate every combination of the given values.

    Parameters
    ----------
    design : Design or SensorModel
        The design to start from; of a model, the effects that hold for other designs too go with it.
    values : mapping
        Field by dotted path to the values it takes, for example ``{"leds.tilt_deg": range(0, 60, 10)}``.
    fidelity : {"fast", "standard", "reference"}
        Effort of an evaluation.
    seed : int
        Seed of every evaluation: designs are compared under the same random numbers.
    depth_mm : float, optional
        Depth of the deepest press in mm, the same for every design, see `PressPlan`; that of the design to
        start from when absent. Presses lie within the sensing area of every design of the grid.
    force_n : float, optional
        Force of the strongest press in N instead, for elastic gels.
    workers : int
        Processes of this machine that evaluate at the same time. With more than one, a script needs the usual
        ``if __name__ == "__main__":`` guard, and `evaluator` must be a function of a module.
    dask : str, optional
        Address of a Dask scheduler, ``tcp://host:8786``, whose workers evaluate instead.
    progress : bool
        Whether to show a bar with the time left on stderr.
    evaluator : callable, optional
        Called as ``evaluator(design, fidelity=..., seed=...)``; simulation when absent.
    out : str or Path, optional
        Folder that keeps each row as soon as it is finished: the same call goes on there, also with more
        values. Without it nothing is kept.
    also : mapping, optional
        Fields that take the value of a swept one too, for example
        ``{"gelcore.width_mm": ["elastomer.width_mm"]}``.

    Returns
    -------
    DataFrame
        One row a design: a column for each field, ``feasible``, ``reason`` (why a design was not evaluated:
        rules it breaks, by how many mm, and what they demand; else empty), and for each score its value and
        ``<score>_se``. Infeasible designs are not evaluated. ``warnings``, where a model is used beyond what
        it was fitted to.

    Raises
    ------
    DesignError
        If a path names no field of a design.
    ValueError
        If the folder holds another sweep.
    SweepInterrupted
        If the user pressed Ctrl-C.
    RuntimeError
        If worker processes die over and over.
    """
    import pandas as pd

    grid = {path: list(chosen) for path, chosen in values.items()}
    if not grid or not all(grid.values()):
        raise ValueError("values: give at least one field, and at least one value for each")
    with_it = {path: list(others) for path, others in (also or {}).items()}
    if unswept := sorted(set(with_it) - set(grid)):
        raise ValueError(f"also: {unswept[0]} is not swept; swept are {', '.join(grid)}")
    combinations = []
    for chosen in itertools.product(*grid.values()):
        one = dict(zip(grid, chosen, strict=True))
        combinations.append(one | {o: one[path] for path, others in with_it.items() for o in others})
    presses = PressPlan.of(*_corners(design, combinations), depth_mm=depth_mm, force_n=force_n)
    scored = evaluator or Simulated(presses=presses)
    paths: list[Path | None] = [None] * len(combinations)
    if out is not None:
        run = {
            "digest": digest(design.digest, fidelity, seed, presses.to_json()),
            "design": design.name if isinstance(design, Design) else design.design.name,
            "fidelity": fidelity,
            "seed": seed,
            "press_plan": presses.to_json(),
        }
        differing = {"digest": "of another design, fidelity, seed or other presses"}
        claim(Path(out), SWEEP_FILE, run, kind="a sweep", decided_by=differing, alone=False)
        paths = [Path(out) / ROWS_FOLDER / f"{digest(_plain(one))[:24]}.json" for one in combinations]
    rows = [_kept(path) for path in paths]
    missing = [place for place, row in enumerate(rows) if row is None]
    calls = [(_sweep_row, design, combinations[place], scored, fidelity, seed) for place in missing]
    goes_on = "give `out` a folder that keeps what is finished"
    if out is not None:
        goes_on = f"what is finished is kept: the same call with out {str(out)!r} goes on"
    done = len(rows) - len(missing)
    try:
        with Interrupts() as interrupts, bar("design", begun=done, keep=True, shown=progress) as tell:
            tell("sweep", done, len(rows))
            outcomes = finished(calls, workers=workers, interrupts=interrupts, dask=dask, goes_on=goes_on)
            with contextlib.closing(outcomes):
                for number, row in outcomes:
                    rows[missing[number]] = row
                    path = paths[missing[number]]
                    if path is not None:
                        write_json(path, row)
                    done += 1
                    tell("sweep", done, len(rows))
    except KeyboardInterrupt:
        text = f"sweep interrupted after {done} of {len(rows)} designs; {goes_on}"
        raise SweepInterrupted(text) from None
    return pd.DataFrame([values | (row or {}) for values, row in zip(combinations, rows, strict=True)])


def _corners(base: "Design | SensorModel", combinations: Sequence[Mapping[str, Any]]) -> list[Design]:
    """Designs of a sweep that decide where all of them can be pressed."""
    start = base if isinstance(base, Design) else base.design
    designs = [start]
    for values in combinations:
        area = {path: value for path, value in values.items() if path.startswith(AREA)}
        with contextlib.suppress(DesignError):  # of one that is not to be had, the sweep tells
            designs += [start.replace(area)] if area else []
    return designs


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values as Python's own, so that 5.0 of an array is 5.0 of a list."""
    return {path: value.item() if hasattr(value, "item") else value for path, value in values.items()}


def _kept(path: Path | None) -> dict[str, Any] | None:
    """Row that is finished; one whose picture failed is not."""
    row = read_json(path) if path is not None and path.is_file() else None
    return None if row is None or (row["feasible"] and row["reason"]) else row


def _sweep_row(
    base: "Design | SensorModel",
    values: Mapping[str, Any],
    evaluator: Evaluator,
    fidelity: str,
    seed: int,
) -> dict[str, Any]:
    start = base if isinstance(base, Design) else base.transferable()
    subject, reason, broken = prepared(lambda: start.replace(values))
    if reason.startswith("no field"):
        raise DesignError(reason)
    if subject is None:
        return {"feasible": False, "reason": told(broken) or reason}
    outcome = evaluate_design(evaluator, subject, fidelity, seed)
    if "scores" not in outcome:
        reason = outcome.get("infeasible") or outcome["failed"]
        return {"feasible": "failed" in outcome, "reason": reason}
    row: dict[str, Any] = {"feasible": True, "reason": ""}
    for name, estimate in outcome["scores"].items():
        row |= {name: estimate["value"], f"{name}_se": estimate["se"]}
    if outcome.get("warnings"):
        row["warnings"] = "; ".join(outcome["warnings"])
    return row


def optimise(
    design: "Design | SensorModel",
    parameters: Mapping[str, Parameter | tuple[float, float] | Sequence[Any] | Mapping[str, Any]]
    | None = None,
    *,
    out: str | Path,
    objectives: Mapping[str, Literal["maximise", "minimise"]] | None = None,
    constraints: Mapping[str, Bound | Mapping[str, float]] | None = None,
    variants: Mapping[str, Mapping[str, Any]] | None = None,
    plan: Plan | Mapping[str, Any] | None = None,
    robust: Robust | Mapping[str, Any] | None = None,
    trials: int = 40,
    fidelity: Fidelity = "fast",
    seed: int = 0,
    depth_mm: float | None = None,
    force_n: float | None = None,
    sampler: Sampler = "auto",
    workers: int = 1,
    progress: bool = True,
    evaluator: Evaluator | None = None,
    storage: str | None = None,
) -> Results:
    """Search for better designs; the same call again goes on where it was, see `run_study`.

    Parameters
    ----------
    design : Design or SensorModel
        The design to start from; of a model, the effects that hold for other designs too go with it.
    parameters : mapping, optional
        Field by dotted path to a range as a tuple ``(low, high)``, a list of choices, or a `Parameter`, also
        as a mapping of its fields; those of `default_parameters` when absent.
    out : str or Path
        Folder of the study.
    objectives : mapping, optional
        Score to ``"maximise"`` or ``"minimise"``; best uniformity and least normal error when absent.
    constraints : mapping, optional
        Score to a `Bound`, for example ``{"coverage": {"least": 0.9}}``; designs that break one are not
        recommended. A coverage of at least 0.95 and no saturation when absent.
    variants : mapping, optional
        Name to fields and values: every design is one of these alternatives.
    plan : Plan, optional
        How the best are confirmed after the search, for example ``{"promoted": 4}``; with 0 they are not.
    robust : Robust, optional
        How copies as they would be built decide, for example ``{"copies": 8}``.
    depth_mm : float, optional
        Depth of the deepest press in mm, the same for every design, see `PressPlan`; 0.8 when absent, less on
        small sensing areas.
    force_n : float, optional
        Force of the strongest press in N instead, for elastic gels.
    trials, fidelity, seed, sampler, workers, progress, evaluator, storage
        As in `Study` and `run_study`.

    Returns
    -------
    Results
        All trials so far, those of earlier runs in the folder included.

    Raises
    ------
    StudyError
        If a parameter does not fit its field (the line names field, value and rule), or the folder holds
        another study.
    StudyInterrupted
        If the user pressed Ctrl-C; nothing that was finished is lost.
    """
    base = design if isinstance(design, Design) else design.design
    varied = None if parameters is None else {p: _parameter(p, its) for p, its in parameters.items()}
    stated = {"parameters": varied, "objectives": objectives, "constraints": constraints, "plan": plan}
    content = {
        "name": f"{base.name} search",
        "base": base,
        **({} if isinstance(design, Design) else carried(design)),
        **{name: given for name, given in stated.items() if given is not None},
        "variants": dict(variants or {}),
        "presses": {n: v for n, v in (("depth_mm", depth_mm), ("force_n", force_n)) if v is not None},
        "robust": robust,
        "trials": trials,
        "fidelity": fidelity,
        "seed": seed,
        "sampler": sampler,
    }
    try:
        study = Study.model_validate(content)
    except ValidationError as error:
        raise StudyError(f"optimise(): {explain(error)}") from None
    return run_study(study, out=out, workers=workers, progress=progress, evaluator=evaluator, storage=storage)


def _parameter(path: str, given: Any) -> Parameter | dict[str, Any]:
    """What a study states of a parameter; the study checks it."""
    if isinstance(given, Parameter):
        return given
    if isinstance(given, Mapping):
        return dict(given)
    if isinstance(given, tuple) and len(given) == 2:
        return {"low": given[0], "high": given[1]}
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise StudyError(
            f"optimise(): field parameters.{path}: must be a range (low, high), a list of choices or a "
            f"Parameter, got {given!r}"
        )
    return {"choices": tuple(given)}
