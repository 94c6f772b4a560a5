"""Running trials: each set is generated, diagnosed, and only then is its answer opened."""

import json
import os
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from designlab.design import preset
from designlab.gap import diagnose
from designlab.measurement import MeasurementError, load_measurement
from designlab.plant import plant, unseal
from designlab.plant.effects import draw
from designlab.plant.rig import Rig
from designlab.store import write_json
from designlab.trials.pool import Trial

COLUMNS = 96
SEED = 1
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Outcome:
    """What a trial gave: the set, its truth, and what of the report is scored."""

    trial: dict[str, Any]
    truth: dict[str, Any]
    verdict: str
    named: list[str]
    sets: list[list[str]]
    parameters: dict[str, Any]
    gap: dict[str, Any]
    candidates: list[dict[str, Any]]
    seconds: float
    processor_seconds: float


def run(trials: Iterable[Trial], folder: Path, *, progress: Progress | None = None) -> list[Outcome]:
    """Run trials, or take them from the folder where they were run before.

    Parameters
    ----------
    trials : iterable of Trial
        The sets.
    folder : Path
        Where sets, reports and outcomes lie; an interrupted run goes on there.
    """
    found = kept(trials, folder / "outcomes", lambda trial: asdict(_one(trial, folder)), progress)
    return [Outcome(**one) for one in found]


def kept(
    trials: Iterable[Trial],
    folder: Path,
    run_one: Callable[[Trial], dict[str, Any]],
    progress: Progress | None,
) -> list[dict[str, Any]]:
    """Run trials whose record is not in a folder yet; the records of all."""
    trials = list(trials)
    found = []
    for number, trial in enumerate(trials):
        if progress is not None:
            progress(trial.name, number, len(trials))
        path = folder / f"{trial.name}-{trial.seed}.json"
        if not path.is_file():
            write_json(path, run_one(trial))
        found.append(json.loads(path.read_text(encoding="utf-8")))
    return found


def set_path(trial: Trial, folder: Path) -> Path:
    """Where the set of a trial lies."""
    return folder / "sets" / f"{trial.name}-{trial.seed}"


def model_path(trial: Trial, folder: Path) -> Path:
    """Where the model lies that the diagnosis of a trial found."""
    return folder / "reports" / f"{trial.name}-{trial.seed}" / "model.toml"


def _planted(trial: Trial, folder: Path) -> Path:
    """Generate the set of a trial, unless it is there."""
    design, measurement = preset(trial.design), set_path(trial, folder)
    if measurement.exists():
        return measurement
    rig = Rig.of(design)
    effects = {
        name: draw(name, rig, strength=strength, seed=trial.seed) for name, strength in trial.effects.items()
    }
    measurement.parent.mkdir(parents=True, exist_ok=True)
    return plant(
        design,
        effects=effects,
        outside=dict(trial.outside),
        out=measurement,
        seed=trial.seed,
        kit_seed=trial.kit_seed,
        columns=COLUMNS,
    )


def _one(trial: Trial, folder: Path) -> Outcome:
    design, measurement = preset(trial.design), _planted(trial, folder)
    begun = os.times()
    try:
        report = diagnose(
            load_measurement(measurement),
            design,
            out=model_path(trial, folder).parent,
            seed=SEED,
            columns=COLUMNS,
            renders=folder / "renders" / trial.design,
            pictures=False,
            recentre=False,
        ).to_json()
    except MeasurementError as error:
        report = {"verdict": f"refused: {error}", "effects": [], "gap": {}, "candidates": []}
    ended = os.times()
    return Outcome(
        trial=asdict(trial),
        truth=unseal(measurement),
        verdict=report["verdict"],
        named=[effect["name"] for effect in report["effects"]],
        sets=[effect["coherence_set"] for effect in report["effects"]],
        parameters={effect["name"]: effect["parameters"] for effect in report["effects"]},
        gap=report["gap"],
        candidates=report["candidates"],
        seconds=ended.elapsed - begun.elapsed,
        processor_seconds=ended.user + ended.system - begun.user - begun.system,
    )
