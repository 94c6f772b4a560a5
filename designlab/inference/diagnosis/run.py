"""The folder of a diagnosis: whose it is, and results that are complete or not there."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from designlab.core.store import digest, remove_partial, write_json
from designlab.inference.diagnosis.emulator.render_cache import Renders
from designlab.inference.diagnosis.result import GapReport
from designlab.measurement import Measurement
from designlab.measurement.shots import Observations
from designlab.simulation.effects import SensorModel

RUN, REPORT = "run.json", "report.json"


def begin_run(
    out: Path, measurement: Measurement, model: SensorModel, seed: int, *, resume: bool = True
) -> None:
    """Mark a folder with what is diagnosed in it; clear what a killed run left half-written.

    Raises
    ------
    ValueError
        If it is a file, or holds a diagnosis of other frames, of another model or with another seed.
    OSError
        If it cannot be written.
    """
    if out.exists() and not out.is_dir():
        raise ValueError(f"{out}: must be a folder, is a file")
    asked = {
        "measurement": measurement.name,
        "frames": frames_digest(measurement),
        "model": model.digest,
        "seed": seed,
    }
    there = _there(out / RUN)
    if resume and there is not None:
        says = {"frames": "other frames", "model": "another model", "seed": "another seed"}
        other = [words for name, words in says.items() if there.get(name) != asked[name]]
        if other:
            raise ValueError(
                f"{out}: holds a diagnosis of {' and '.join(other)} "
                f"({there.get('measurement')!r}, seed {there.get('seed')}); choose another folder"
            )
    out.mkdir(parents=True, exist_ok=True)
    for folder in (out, out / "renders"):
        remove_partial(folder)
    write_json(out / RUN, asked)


def end_run(
    out: Path, finished: Callable[[], GapReport], page: Callable[[GapReport], object] | None
) -> GapReport:
    """Write the results of a run, ``report.json`` last: where that is, all others are, and of the same run.

    Parameters
    ----------
    finished : callable
        Draws the pictures and gives the report that names them.
    page : callable, optional
        Writes more about it.
    """
    (out / REPORT).unlink(missing_ok=True)
    report = finished()
    report.updated.save(report.model)
    if page is not None:
        page(report)
    write_json(out / REPORT, report.to_json())
    return report


def provenance(
    measurement: Measurement, seen: Observations, model: SensorModel, renders: Renders
) -> dict[str, Any]:
    """What every report says of how it was made; frames, pictures rendered and seconds come on top."""
    from designlab import __version__

    return {
        "measurement": measurement.name,
        "model": model.digest,
        "seed": renders.seed,
        "samples": renders.samples,
        "noise": seen.noise_source,
        "floor": "measured" if seen.repeats else "assumed",
        "version": __version__,
    }


def frames_digest(measurement: Measurement) -> str:
    """Digest of a set: of what it says and of the content of its files."""
    files = [measurement.path(frame.file).read_bytes() for frame in measurement.frames]
    return digest(measurement, *files)


def _there(path: Path) -> dict[str, Any] | None:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None
