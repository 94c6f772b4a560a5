"""The folder of a diagnosis: whose it is, and results that are complete or not there."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from designlab.core.run_folder import claim
from designlab.core.store import remove_partial, write_json
from designlab.inference.diagnosis.emulator.render_cache import Renders
from designlab.inference.diagnosis.result import GapReport
from designlab.measurement import Measurement
from designlab.measurement.shots import Observations
from designlab.simulation.effects import SensorModel

RUN, REPORT = "run.json", "report.json"


def claim_run(out: Path, measurement: Measurement, model: SensorModel, seed: int) -> None:
    """Mark a folder with what is diagnosed in it, see `core.run_folder.claim`."""
    run = {
        "measurement": measurement.name,
        "frames": measurement.content_digest(),
        "model": model.digest,
        "seed": seed,
    }
    differing = {"frames": "of other frames", "model": "of another model", "seed": "with another seed"}
    claim(out, RUN, run, kind="a diagnosis", decided_by=differing)
    remove_partial(out / "renders")


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
