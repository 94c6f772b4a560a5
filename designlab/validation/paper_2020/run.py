"""The paper's experiments in one folder: each is run once, kept, and told about on one page.

Every experiment keeps its result in a folder of its own; one whose result is there already is not repeated.
"""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from designlab.core import __version__
from designlab.core.progress import THOUSANDTHS, part_of, silent
from designlab.core.run_folder import claim
from designlab.core.store import read_json, remove_partial, write_atomic, write_json
from designlab.core.types import Progress
from designlab.sensor.design import preset
from designlab.validation.paper_2020.accuracy import MODELS, accuracy
from designlab.validation.paper_2020.content import sections
from designlab.validation.paper_2020.markdown import markdown_page
from designlab.validation.paper_2020.page import html_page
from designlab.validation.paper_2020.probe import probe
from designlab.validation.paper_2020.real import real
from designlab.validation.paper_2020.recovery import recovery, told
from designlab.validation.paper_2020.sizes import SENSORS, SIZES, Size
from designlab.validation.paper_2020.timing import timing

RESULTS = 2  # raise when a change makes results of earlier runs wrong
MARKER, KEPT = "reproduce.json", "result.json"
REPORT, MARKDOWN = "report.html", "reproduction.md"
_DECIDED_BY = {
    "size": "of another size",
    "seed": "with another seed",
    "designs": "of other sensors",
    "results": "by another version of the experiments",
}
LEFT_OUT = "left_out"  # key of an experiment that could not be run; it is tried again


class Experiment(NamedTuple):
    """One experiment: what it is called, the function that does it in a folder, and what takes how long.

    Attributes
    ----------
    seconds : callable
        About what it takes on two cores; only the time left depends on it.
    parts : callable
        How parts of it begin to tell of themselves, in order, and what they take in relation; empty where
        the experiment counts all of its steps.
    """

    title: str
    run: Callable[[Path, Size, int, Progress], dict[str, Any]]
    seconds: Callable[[Size], float]
    parts: Callable[[Size], Mapping[str, float]] = lambda size: {}


def reproduce(
    out: str | Path, *, size: str = "full", seed: int = 1, progress: Progress = silent
) -> dict[str, Any]:
    """Run the paper's experiments; the same call again goes on where it ended.

    Parameters
    ----------
    out : path
        Folder of the results; may exist if it is empty or of an earlier call with the same size and seed.
    size : str
        "full", or "reduced": a small part that shows that everything runs.
    seed : int
        Seed of everything random but the hidden sensors that are fitted to tell of the errors, which have
        fixed ones.
    progress : callable, optional
        Called with what is being done, and how much of what was left to do is done in thousandths.

    Returns
    -------
    dict
        ``stages``: what each experiment found; and the files that were written.

    Raises
    ------
    ValueError
        If the size is unknown, or the folder holds something else.
    RuntimeError
        If an experiment fails; names it and the reason.
    OSError
        If the folder cannot be written.
    """
    if size not in SIZES:
        raise ValueError(f"size: must be one of {', '.join(SIZES)}, got {size!r}")
    out, extent = Path(out), SIZES[size]
    designs = {name: preset(name).digest for name in SENSORS.values()}
    asked = {"results": RESULTS, "seed": seed, "designs": designs, "size": dataclasses.asdict(extent)}
    claim(out, MARKER, asked, kind="a reproduction", decided_by=_DECIDED_BY)
    left = {name: stage for name, stage in STAGES.items() if not (out / name / KEPT).is_file()}
    total, done = sum(stage.seconds(extent) for stage in left.values()), 0.0
    found: dict[str, dict[str, Any]] = {}
    for name, stage in STAGES.items():
        if name in left:
            within = stage_progress(progress, stage, extent, done, total)
            found[name] = _run(out / name, stage, extent, seed, within)
            done += stage.seconds(extent)
        else:
            found[name] = read_json(out / name / KEPT)
    return _written(out, extent, seed, found, progress)


def _run(folder: Path, stage: Experiment, size: Size, seed: int, within: Progress) -> dict[str, Any]:
    remove_partial(folder)
    within("", 0, 1)
    try:
        found = stage.run(folder, size, seed, within)
    except (ValueError, RuntimeError) as error:
        raise RuntimeError(f"reproduce, {stage.title}: {error}") from error
    if LEFT_OUT not in found:
        write_json(folder / KEPT, found)
    return found


def stage_progress(progress: Progress, stage: Experiment, size: Size, done: float, total: float) -> Progress:
    """Turn the steps of an experiment into a share of everything, which only grows."""
    share_of = Growing(stage.parts(size))
    part = part_of(progress, stage.title, begun=done, cost=stage.seconds(size), total=total)

    def within(what: str, count: int, of: int) -> None:
        share = share_of(what, count, of) if what else 0.0
        part(what, round(THOUSANDTHS * share), THOUSANDTHS)

    return within


class Growing:
    """Share of an experiment that is done, from parts that each count their own steps."""

    def __init__(self, parts: Mapping[str, float]) -> None:
        self.parts, self.share = parts, 0.0

    def __call__(self, what: str, done: int, of: int) -> float:
        """Return the share after a step of what is being done; it never falls."""
        begun, share = 0.0, min(done / max(of, 1), 1.0)
        for name, cost in self.parts.items():
            if what.startswith(name):
                share = (begun + cost * share) / sum(self.parts.values())
                break
            begun += cost
        self.share = max(self.share, share)
        return self.share


def _written(
    out: Path, size: Size, seed: int, found: dict[str, dict[str, Any]], progress: Progress
) -> dict[str, Any]:
    """Write result and pages, anew at every call."""
    result = {"designlab": __version__, "size": size.name, "seed": seed, "stages": found}
    write_json(out / KEPT, result)
    content = sections(result, out)
    write_atomic(out / REPORT, html_page(result, content))
    write_atomic(out / MARKDOWN, markdown_page(result, content))
    progress("done", THOUSANDTHS, THOUSANDTHS)
    files = {"out": out, "report": out / REPORT, "markdown": out / MARKDOWN, "result": out / KEPT}
    return {**{name: str(path) for name, path in files.items()}, **result}


def _accuracy_parts(size: Size) -> dict[str, float]:
    photographing = 10.0 if size.name == "full" else 1.0
    parts: dict[str, float] = {}
    for sensor in (SENSORS[shape] for shape in SENSORS if shape in size.shapes_of_gel):
        parts[f"{sensor}: photographing"] = photographing
        for model in MODELS:
            parts |= {f"{sensor}: {model}: ": 0.9, f"{sensor}: {model}, comparing: ": 0.1}
    return parts


STAGES: dict[str, Experiment] = {
    "probe": Experiment("light probe", probe, lambda size: 15 if size.name == "full" else 8),
    "recovery": Experiment(
        "hidden sensors",
        lambda folder, size, seed, progress: recovery(size.repeats, folder, progress=progress),
        lambda size: 75 * size.repeats,
        lambda size: {told(number): 1.0 for number in range(size.repeats)},
    ),
    "accuracy": Experiment(
        "accuracy", accuracy, lambda size: 4000 if size.name == "full" else 150, _accuracy_parts
    ),
    "timing": Experiment("time of pictures", timing, lambda size: 900 if size.name == "full" else 30),
    "real": Experiment(
        "real picture",
        real,
        lambda size: 60 if size.name == "full" else 35,
        lambda size: {"fitting": 0.9, "comparing": 0.1},
    ),
}
