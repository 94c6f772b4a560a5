"""Running trials: each set is generated, diagnosed, and only then is its answer opened."""

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from designlab.core.interrupts import Interrupts
from designlab.core.progress import silent
from designlab.core.run_folder import require_same
from designlab.core.store import read_json, write_json
from designlab.core.types import Progress
from designlab.core.workers import calls_at_once, completed, submitter
from designlab.inference.diagnosis import diagnose
from designlab.inference.diagnosis.diagnose import COLUMNS, SAMPLES
from designlab.measurement import load_measurement
from designlab.report.diagnosis_folder import write_diagnosis
from designlab.sensor.design import preset
from designlab.simulation.effects import UNASKED, effect
from designlab.validation.blind.frozen import code_digest
from designlab.validation.blind.pool import Trial, frames_of
from designlab.validation.synthetic import plant, unseal
from designlab.validation.synthetic.effects import draw
from designlab.validation.synthetic.generator_sensor import Rig

SMALL_COLUMNS, SMALL_SAMPLES = 32, 64
SEED = 1
NOT_PLANTED = ("kit", "without")  # fields of a trial that its set does not depend on


@dataclass(frozen=True)
class Outcome:
    """What a trial gave: the set, its truth, and what of the report is scored.

    Attributes
    ----------
    sets, confidence : list
        Of each effect named: those that do as well, and how sure the report is.
    control : float or None
        Share of the gap that a wrong effect of the same size takes away.
    next_frames : list of dict
        Frames that would tell apart what this measurement does not.
    code : str
        Digest of the code that ran it.
    """

    trial: dict[str, Any]
    truth: dict[str, Any]
    verdict: str
    named: list[str]
    sets: list[list[str]]
    parameters: dict[str, Any]
    confidence: list[float]
    control: float | None
    next_frames: list[dict[str, Any]]
    gap: dict[str, Any]
    candidates: list[dict[str, Any]]
    seconds: float
    processor_seconds: float
    code: str


@dataclass(frozen=True)
class Crew:
    """Who runs trials: processes of this machine, or the workers of a Dask scheduler at an address."""

    workers: int = 1
    dask: str | None = None


ALONE = Crew()


def run(
    trials: Iterable[Trial], folder: Path, *, progress: Progress = silent, crew: Crew = ALONE
) -> list[Outcome]:
    """Run trials, or take them from the folder where they were run before.

    Parameters
    ----------
    trials : iterable of Trial
        The sets.
    folder : Path
        Where sets, reports and outcomes lie; an interrupted run goes on there.
    crew : Crew
        Who runs them.

    Raises
    ------
    ValueError
        If the folder holds sets or outcomes of other trials, or of another version.
    """
    records = kept(trials, folder, "outcomes", _one, progress, crew)
    known = {field.name for field in fields(Outcome)}
    for record in records:
        if record.keys() != known:
            raise ValueError(f"{folder}: outcomes there are of another version; begin in another folder")
    return [Outcome(**record) for record in records]


def kept(
    trials: Iterable[Trial],
    folder: Path,
    records: str,
    run_one: Callable[[Trial, Path], Any],
    progress: Progress,
    crew: Crew,
) -> list[dict[str, Any]]:
    """Run trials whose record is not in a folder yet; the records of all, in their order.

    Parameters
    ----------
    records : str
        Where within `folder` records are kept.
    run_one : callable
        Function of a module, called with a trial and the folder; its dataclass, which holds the trial as
        `trial`, becomes the record.
    """
    trials = list(trials)
    paths = [folder / records / f"{trial.label}.json" for trial in trials]
    missing = [n for n, path in enumerate(paths) if not path.is_file()]
    for n, path in enumerate(paths):
        if n not in missing:
            _require_same_trial(path, read_json(path).get("trial"), asdict(trials[n]))
    at_once = calls_at_once(crew.workers, crew.dask)

    def tell(what: str) -> None:
        progress(what, sum(path.is_file() for path in paths), len(paths))

    try:
        with Interrupts() as interrupts, submitter(crew.workers, interrupts, dask=crew.dask) as submit:
            for wave in _waves([(n, trials[n]) for n in missing]):
                tell(wave[0][1].name)
                calls = [(run_one, trial, folder) for _, trial in wave]
                for place, found in completed(submit, calls, at_once=at_once, interrupts=interrupts):
                    write_json(paths[wave[place][0]], asdict(found))
                    tell(wave[min(place + at_once, len(wave) - 1)][1].name)
    except BrokenProcessPool as error:
        raise RuntimeError(
            f"a worker process died, perhaps for lack of memory with {crew.workers} workers; sets that are "
            "finished are kept: the same command goes on"
        ) from error
    return [read_json(path) for path in paths]


def _require_same_trial(path: Path, held: object, asked: Mapping[str, Any]) -> None:
    """Refuse what a folder holds of a trial that has changed since."""
    differing = {"trial": "that was defined otherwise"}
    require_same(path, {"trial": held}, {"trial": asked}, kind="a set", decided_by=differing)


def _waves(trials: Sequence[tuple[int, Trial]]) -> Iterator[list[tuple[int, Trial]]]:
    """One set of each design before all others: it renders the pictures that they share.

    Of the others the last come first: a pool ends with those that take longest, and a worker that is done
    should not have to wait for one of them.
    """
    first = {trial.design: number for number, trial in reversed(trials)}
    ahead = [one for one in trials if first[one[1].design] == one[0]]
    yield from filter(None, (ahead, [one for one in reversed(trials) if one not in ahead]))


def set_path(trial: Trial, folder: Path) -> Path:
    """Where the set of a trial lies."""
    return folder / "sets" / trial.set_label


def model_path(trial: Trial, folder: Path) -> Path:
    """Where the model lies that the diagnosis of a trial found."""
    return folder / "reports" / trial.label / "model.toml"


def planted(trial: Trial, folder: Path) -> Path:
    """Generate the set of a trial, unless it is there."""
    design, measurement = preset(trial.design), set_path(trial, folder)
    planted = {name: value for name, value in asdict(trial).items() if name not in NOT_PLANTED}
    definition = measurement.with_name(f"{measurement.name}.trial.json")
    if measurement.exists():
        _require_same_trial(definition, read_json(definition), planted)
        return measurement
    write_json(definition, planted)
    rig = Rig.of(design)
    effects = {
        name: draw(name, rig, strength=strength, seed=trial.seed) for name, strength in trial.effects.items()
    }
    return plant(
        design,
        effects=effects,
        outside=dict(trial.outside),
        out=measurement,
        seed=trial.seed,
        kit_seed=trial.kit_seed,
        further=trial.further,
        columns=COLUMNS if trial.size == "full" else SMALL_COLUMNS,
        kit="hour" if trial.size == "full" else "small",
        dirt=trial.dirt,
    )


def _catalogue(trial: Trial) -> list[str]:
    """Effects to try; of small sets those alone that take no pictures of their own."""
    tried = [name for name in UNASKED if trial.size == "full" or not effect(name).rendered]
    return [name for name in tried if name not in trial.without]


def _one(trial: Trial, folder: Path) -> Outcome:
    design, measurement = preset(trial.design), planted(trial, folder)
    begun = os.times()
    try:
        found = diagnose(
            frames_of(load_measurement(measurement), trial.kit),
            design,
            out=model_path(trial, folder).parent,
            seed=SEED,
            columns=COLUMNS,
            samples=SAMPLES if trial.size == "full" else SMALL_SAMPLES,
            renders=folder / "renders" / trial.design,
            catalogue=_catalogue(trial),
        )
        report = write_diagnosis(found, pictures=False)
    except ValueError as error:  # what a user would be told; one such set must not end a pool
        report = {
            "verdict": f"refused: {str(error).replace(str(measurement), trial.name)}",
            "effects": [],
            "gap": {},
            "control": None,
            "next": {"frames": []},
            "candidates": [],
        }
    ended = os.times()
    return Outcome(
        trial=asdict(trial),
        truth=unseal(measurement),
        verdict=report["verdict"],
        named=[effect["name"] for effect in report["effects"]],
        sets=[effect["coherence_set"] for effect in report["effects"]],
        parameters={effect["name"]: effect["parameters"] for effect in report["effects"]},
        confidence=[effect["confidence"] for effect in report["effects"]],
        control=None if report["control"] is None else report["control"]["removed"],
        next_frames=list(report["next"]["frames"]),
        gap=report["gap"],
        candidates=report["candidates"],
        seconds=ended.elapsed - begun.elapsed,
        processor_seconds=ended.user + ended.system - begun.user - begun.system,
        code=code_digest(),
    )
