"""Transfer trials see whether a model corrected on one sensor predicts another design."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from designlab.core.progress import silent
from designlab.core.types import Progress
from designlab.inference.diagnosis.diagnose import COLUMNS, SAMPLES
from designlab.inference.diagnosis.emulator.rendering import fill
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.noise import Noise
from designlab.inference.diagnosis.result import Level
from designlab.inference.diagnosis.selection.held_out import Judged, judge, level
from designlab.measurement import Measurement, load_measurement
from designlab.measurement.usable_frames import observe_apart
from designlab.sensor.design import Design, preset
from designlab.simulation.effects import SensorModel, effect, load_model
from designlab.simulation.render_cache import Renders
from designlab.validation.blind.pool import AIR, Trial
from designlab.validation.blind.runner import ALONE, SEED, Crew, kept, model_path, run, set_path
from designlab.validation.synthetic import plant

HIGHER_MM = 3.0
MORE_TILT_DEG = 15.0
OTHER_SEED = 1_000_000  # of the other sensor: other errors of poses and gains, other noise
RESAMPLES = 10_000
LEAST_GAP = 1.1  # mean squared residual over what is usual where nothing is missing


@dataclass(frozen=True)
class Transferred:
    """What a trial gave.

    Attributes
    ----------
    named, carried, left : list of str
        Effects that the diagnosis of the first design named, those of them put on the other, and those left
        behind because they belong to one unit.
    before, after, floor : float
        Mean squared residual on the other sensor's held-out presses in units of the noise: uncorrected model,
        corrected model, and what noise and errors granted to the simulation leave.
    removed : float or None
        Share of the gap that the correction takes away; None where there is hardly one.
    """

    trial: dict[str, Any]
    truth: dict[str, Any]
    verdict: str
    named: list[str]
    carried: list[str]
    left: list[str]
    before: float
    after: float
    floor: float
    removed: float | None
    warnings: list[str]
    processor_seconds: float


def transfers(pool: Iterable[Trial]) -> list[Trial]:
    """Sets of a pool with one effect, which holds for other designs.

    LEDs that sit on a core cannot be moved as `other` does, so those of a core are left out.
    """
    return [
        trial
        for trial in pool
        if len(trial.effects) == 1
        and not trial.without
        and effect(trial.kind).transferable
        and trial.design in AIR
    ]


def other(design: Design) -> Design:
    """Design that a lab might try next: LEDs higher and more tilted."""
    changes: dict[str, Any] = {"name": f"{design.name}, LEDs higher and more tilted"}
    for field, more in (("height_mm", HIGHER_MM), ("tilt_deg", MORE_TILT_DEG)):
        changes[f"leds.{field}"] = getattr(design.leds, field) + more
        for group, value in design.leds.own(field).items():
            changes[f"leds.groups.{group}.{field}"] = value + more
    changed = design.replace(changes)
    changed.require_feasible()
    return changed


def run_transfers(
    trials: Iterable[Trial], folder: Path, *, progress: Progress = silent, crew: Crew = ALONE
) -> list[Transferred]:
    """Run trials, or take them from the folder where they were run before.

    Parameters
    ----------
    trials : iterable of Trial
        The sets.
    folder : Path
        Where sets, models and outcomes lie; an interrupted run goes on there.
    crew : Crew
        Who runs them.
    """
    return [Transferred(**one) for one in kept(trials, folder, "transfers", _one, progress, crew)]


def _one(trial: Trial, folder: Path) -> Transferred:
    begun = time.process_time()
    design = preset(trial.design)
    (diagnosed,) = run([trial], folder)
    written = model_path(trial, folder)
    found = load_model(written) if written.is_file() else SensorModel.of(design)
    changed = other(design)
    corrected = found.transferable().on(changed)
    second = set_path(trial, folder).with_name(f"{written.parent.name}-other")
    if not second.exists():
        plant(
            changed,
            effects=diagnosed.truth["effects"],
            out=second,
            seed=OTHER_SEED + trial.seed,
            kit_seed=trial.kit_seed,
            columns=COLUMNS,
        )
    renders = Renders(folder / "renders" / f"{trial.design}-other", SAMPLES, SEED)
    before, after = predicted(load_measurement(second), [SensorModel.of(changed), corrected], renders)
    gap = level(before, after)
    carried = [applied.name for applied in corrected.effects]
    named = [applied.name for applied in found.effects]
    return Transferred(
        trial=asdict(trial),
        truth=diagnosed.truth["effects"],
        verdict=diagnosed.verdict,
        named=named,
        carried=carried,
        left=[name for name in named if name not in carried],
        before=gap.before,
        after=gap.after,
        floor=gap.floor,
        removed=removed(gap),
        warnings=list(corrected.warnings()),
        processor_seconds=time.process_time() - begun,
    )


def predicted(measurement: Measurement, models: Sequence[SensorModel], renders: Renders) -> list[Judged]:
    """Judge how well models predict a measurement, gains and poses registered, nothing else fitted.

    Gains are fitted on frames of the untouched gel and the select presses, the final presses are judged, all
    models in the noise that goes with the first; what a finer mesh explains counts for none, as in a
    diagnosis.
    """
    found: list[Judged] = []
    noises: list[Noise] = []
    for model in models:
        seen = observe_apart(measurement, model.effective_design(), columns=COLUMNS)
        seen = replace(seen, shots=tuple(shot for shot in seen.shots if shot.use != "train"))
        registered, final = seen.of("dark", "background", "select"), seen.of("final")
        fitter = Fitter(fill(renders, model, seen.shots, ()))
        state = fitter.start(registered)
        if noises:
            fitter.noises = noises
        else:
            fitter.measure(fitter.fit(state, (), registered).state)
            noises = fitter.noises
        found.append(judge(fitter, fitter.fit(state, (), registered), final))
    return found


def removed(gap: Level) -> float | None:
    """Share of the gap that is gone; None where the other design shows none."""
    return None if gap.before < LEAST_GAP * gap.usual else gap.removed


def summary(outcomes: Sequence[Transferred], *, seed: int = 0) -> dict[str, Any]:
    """Median share of the gap removed, its 95 % interval (bootstrap over sets), and a row for each set."""
    shares = np.array([o.removed for o in outcomes if o.removed is not None])
    found: dict[str, Any] = {"sets": len(outcomes), "without_gap": len(outcomes) - len(shares)}
    if len(shares):
        drawn = np.random.default_rng(seed).choice(shares, (RESAMPLES, len(shares)))
        low, high = np.quantile(np.median(drawn, axis=1), (0.025, 0.975))
        found |= {"median": float(np.median(shares)), "low": float(low), "high": float(high)}
    rows = [
        {
            "set": o.trial["name"],
            "design": o.trial["design"],
            "verdict": o.verdict,
            **{name: getattr(o, name) for name in ("named", "left", "before", "after", "floor", "removed")},
        }
        for o in outcomes
    ]
    return found | {"rows": rows}
