"""Monte Carlo of built copies: each is drawn, evaluated and kept; an interrupted run goes on."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from designlab.core.interrupts import Interrupts
from designlab.core.progress import bar
from designlab.core.run_folder import claim
from designlab.core.store import digest, write_json
from designlab.core.types import Array
from designlab.core.workers import finished
from designlab.evaluation.illumination_scores import SCORES
from designlab.evaluation.press_plan import PressPlan
from designlab.optimization.constraint import Bound
from designlab.optimization.outcome import (
    Evaluator,
    Simulated,
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
DECIDED_BY = {"digest": "of another design, spreads, fidelity, seed, presses or calibration"}


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

    All copies see the same presses, those of the drawing, and random numbers: they differ by how they are
    built alone.

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
        As in `designlab.optimization.study.sweep`.

    Returns
    -------
    Tolerance
        Scores and yield of the copies, and how much each spread is to blame.

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
    built = _Copies(Path(out), nominal, drawn, deviates(copies, [each.name for each in drawn], seed))
    presses = PressPlan.of(nominal.effective_design())
    stated = [spread.model_dump(mode="json") for spread in chosen]
    run = {
        "digest": digest(
            nominal.digest,
            stated,
            fidelity,
            seed,
            calibrate,
            presses.to_json(),
        ),
        "design": nominal.design.name,
        "copies": copies,
        "fidelity": fidelity,
        "seed": seed,
        "press_plan": presses.to_json(),
        "calibrate": calibrate,
        "spreads": stated,
        "spec": {name: bound.model_dump(exclude_none=True) for name, bound in (spec or {}).items()},
    }
    claim(built.folder, RUN_FILE, run, kind="a tolerance run", decided_by=DECIDED_BY, alone=False)
    missing = [k for k in range(NOMINAL, copies) if not is_finished(built.folder, k) and built.possible(k)]
    scored = evaluator or Simulated(presses=presses, as_built=True)
    if calibrate == "once" and missing:
        from designlab.evaluation.evaluate import calibration_of

        calibration = calibration_of(nominal, fidelity=fidelity, seed=seed, presses=presses)
        scored = Simulated(presses=presses, as_built=True, calibration=calibration)
    calls = [(evaluate_design, scored, built.model(k), fidelity, seed) for k in missing]
    done, total = copies + 1 - len(missing), copies + 1
    try:
        with Interrupts() as interrupts, bar("copy", begun=done, keep=True, shown=progress) as tell:
            tell("copies", done, total)
            outcomes = finished(calls, workers=workers, interrupts=interrupts, dask=dask)
            with contextlib.closing(outcomes):
                for place, found in outcomes:
                    require_scores(spec or {}, found.get("scores", spec or {}))
                    built.keep(missing[place], found)
                    done += 1
                    tell("copies", done, total)
    except KeyboardInterrupt:
        raise ToleranceInterrupted(
            f"tolerance run interrupted after {done} of {total} evaluations; run it again with the "
            f"same folder, {out}, to resume"
        ) from None
    return load_tolerance(out)


@dataclass(frozen=True, eq=False)
class _Copies:
    """The drawing and its copies, by number, and what is kept of each.

    Attributes
    ----------
    values : Array
        What is drawn for each copy, in standard deviations, shape (copies, inputs).
    """

    folder: Path
    nominal: SensorModel
    drawn: Sequence[Input]
    values: Array

    def model(self, number: int) -> SensorModel:
        """Copy of a number, or the drawing itself."""
        return self.nominal if number == NOMINAL else copy(self.nominal, self.drawn, self.values[number])

    def possible(self, number: int) -> bool:
        """Whether a copy can be built; that it cannot is kept."""
        _, reason, _ = prepared(partial(self.model, number), as_built=True)
        if reason:
            self.keep(number, {"unbuilt": reason})
        return not reason

    def keep(self, number: int, found: Mapping[str, Any]) -> None:
        """Write what was found of a copy."""
        own: dict[str, float] = {}
        if number != NOMINAL:
            own = {each.name: float(v) for each, v in zip(self.drawn, self.values[number], strict=True)}
        write_json(copy_path(self.folder, number), {"copy": number, "deviates": own, **found})
