"""Monte Carlo of built copies: each is drawn, evaluated and kept; an interrupted run goes on."""

import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

from designlab.core.interrupts import Interrupts
from designlab.core.store import digest, read_json, write_json
from designlab.core.types import Array
from designlab.core.workers import finished
from designlab.evaluation.illumination_scores import SCORES
from designlab.optimization.constraint import Bound
from designlab.optimization.outcome import (
    CalibratedOnce,
    Evaluator,
    built_evaluator,
    evaluate_design,
    prepared,
)
from designlab.optimization.tolerance.distributions import (
    Input,
    Spread,
    copy,
    default_spreads,
    deviates,
    inputs,
)
from designlab.optimization.tolerance.result import (
    NOMINAL,
    RUN_FILE,
    Tolerance,
    copy_path,
    is_finished,
    load_tolerance,
    require_scores,
)
from designlab.sensor.design import Design
from designlab.simulation.effects import SensorModel

Calibrate = Literal["each", "once"]
COPIES = 200


class ToleranceInterrupted(KeyboardInterrupt):
    """A run was stopped by the user; the text says how far it came."""


def tolerance(
    design: "Design | SensorModel",
    *,
    out: str | Path,
    copies: int = COPIES,
    spreads: Sequence[Spread] | None = None,
    spec: Mapping[str, Bound] | None = None,
    fidelity: str = "fast",
    seed: int = 0,
    calibrate: Calibrate = "each",
    workers: int = 1,
    dask: str | None = None,
    progress: bool = True,
    evaluator: Evaluator | None = None,
) -> Tolerance:
    """Evaluate copies of a design as they would be built.

    All copies see the same presses and random numbers: they differ by how they are built alone.

    Parameters
    ----------
    design : Design or SensorModel
        The drawing.
    out : str or Path
        Folder of the run: ``tolerance.json`` and the scores of each copy; the same call again goes on there,
        also with more copies.
    copies : int
        How many to build.
    spreads : sequence of Spread, optional
        What differs between copies; `default_spreads` of the design when absent.
    spec : mapping of str to Bound, optional
        What scores a copy must reach to be good.
    fidelity : {"fast", "standard", "reference"}
        Effort of an evaluation.
    seed : int
        Seed of the draws and of every evaluation.
    calibrate : {"each", "once"}
        Whether each copy is calibrated on its own, as a laboratory does with a sensor that it has built, or
        the drawing is once: copies are then reconstructed with its calibration and their own untouched gel.
    workers, dask, progress, evaluator
        As in `designlab.optimization.study.run_study`.

    Raises
    ------
    InfeasibleDesign
        If the drawing itself cannot be built.
    ValueError
        If a spread does not fit the design, the specification names no score, or the folder holds another
        run.
    ToleranceInterrupted
        If the user pressed Ctrl-C; nothing that was finished is lost.
    """
    if calibrate == "once" and evaluator is not None:
        raise ValueError("calibrate: once is for the usual evaluator; one of yours calibrates as it likes")
    if copies < 2 or workers < 1:
        raise ValueError(f"copies and workers must be at least 2 and 1, got {copies} and {workers}")
    if evaluator is None:
        require_scores(spec or {}, SCORES)
    nominal = SensorModel.of(design)
    nominal.effective_design().require_feasible()
    chosen = default_spreads(nominal.design) if spreads is None else tuple(spreads)
    drawn = inputs(nominal.design, chosen)
    if not drawn:
        raise ValueError("spreads: nothing differs between copies; give one or more")
    folder = Path(out)
    _claim(
        folder, nominal, chosen, spec or {}, copies=copies, fidelity=fidelity, seed=seed, calibrate=calibrate
    )
    values = deviates(copies, [each.name for each in drawn], seed)
    missing = [k for k in range(NOMINAL, copies) if not is_finished(folder, k)]
    for k in list(missing):
        _, reason, _ = prepared(partial(_built, nominal, drawn, values, k), as_built=True)
        if reason:
            write_json(copy_path(folder, k), _record(k, drawn, values, {"unbuilt": reason}))
            missing.remove(k)
    scored = evaluator or built_evaluator
    if calibrate == "once" and missing:
        from designlab.evaluation.evaluate import calibration_of

        scored = CalibratedOnce(calibration_of(nominal, fidelity=fidelity, seed=seed))
    calls = [(evaluate_design, scored, _built(nominal, drawn, values, k), fidelity, seed) for k in missing]
    with Interrupts() as interrupts, _bar(copies + 1, len(missing), shown=progress) as step:
        try:
            outcomes = finished(calls, workers=workers, interrupts=interrupts, dask=dask)
            with contextlib.closing(outcomes):
                for place, found in outcomes:
                    require_scores(spec or {}, found.get("scores", spec or {}))
                    k = missing[place]
                    write_json(copy_path(folder, k), _record(k, drawn, values, found))
                    step()
        except KeyboardInterrupt:
            done = sum(is_finished(folder, k) for k in range(NOMINAL, copies))
            raise ToleranceInterrupted(
                f"tolerance run interrupted after {done} of {copies + 1} evaluations; run it again with the "
                f"same folder, {folder}, to resume"
            ) from None
    return load_tolerance(folder)


def _built(nominal: SensorModel, drawn: Sequence[Input], values: Array, number: int) -> SensorModel:
    """Copy of a number, or the drawing itself."""
    return nominal if number == NOMINAL else copy(nominal, drawn, values[number])


def _record(number: int, drawn: Sequence[Input], values: Array, found: Mapping[str, Any]) -> dict[str, Any]:
    own = (
        {}
        if number == NOMINAL
        else {each.name: float(v) for each, v in zip(drawn, values[number], strict=True)}
    )
    return {"copy": number, "deviates": own, **found}


def _claim(
    folder: Path,
    nominal: SensorModel,
    spreads: Sequence[Spread],
    spec: Mapping[str, Bound],
    *,
    copies: int,
    fidelity: str,
    seed: int,
    calibrate: Calibrate,
) -> None:
    """Write what is run into a new folder; refuse the folder of another run."""
    path = folder / RUN_FILE
    stated = [spread.model_dump(mode="json") for spread in spreads]
    ours = digest(nominal.digest, stated, fidelity, seed, calibrate)
    if path.is_file():
        before = read_json(path)
        if before.get("digest") != ours:
            raise ValueError(
                f"{folder}: holds another run, of {before.get('design')!r}: design, spreads, fidelity, "
                "seed or calibration differ; choose another folder"
            )
    content = {
        "digest": ours,
        "design": nominal.design.name,
        "copies": copies,
        "fidelity": fidelity,
        "seed": seed,
        "calibrate": calibrate,
        "spreads": stated,
        "spec": {name: bound.model_dump(exclude_none=True) for name, bound in spec.items()},
    }
    write_json(path, content)


@contextlib.contextmanager
def _bar(total: int, missing: int, *, shown: bool) -> Iterator[Callable[[], None]]:
    """Show done, total and time left on stderr."""
    from tqdm import tqdm

    with tqdm(
        total=total, initial=total - missing, unit="copy", file=sys.stderr, disable=not shown, leave=True
    ) as bar:
        yield lambda: bar.update() and None
