"""The main job end to end on a small budget: scores, files to make, search, hidden effect, real picture.

Every stage keeps its results in a folder of its own; a stage whose results are there already is not repeated.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from designlab.app.demo.page import index_page
from designlab.core.progress import THOUSANDTHS, part_of, silent
from designlab.core.run_folder import claim, resumed
from designlab.core.store import read_json, write_atomic
from designlab.core.types import Progress
from designlab.report.page import link
from designlab.sensor.design import Design, preset

if TYPE_CHECKING:
    from designlab.evaluation.score import Score

SENSOR = "default"
MEASURED = "gelsight-2020-flat"  # sensor that the real pictures are of
MEASURED_VARIABLE = "DESIGNLAB_MEASURED"
"""Environment variable that names a folder of real pictures; without it that stage is left out."""

MARKER = "demo.json"
TRIALS = 8
PARAMETERS = {"leds.height_mm": (2.0, 7.0), "leds.pitch_mm": (3.2, 6.5)}
HIDDEN = {"colour_mixing": {"R_from_green": 0.15, "G_from_blue": 0.2, "B_from_red": 0.1}}
PROBE = "sphere:4"
TRIED = (
    "colour_mixing",
    "black_level",
    "vignetting",
    "response_curve",
    "veiling_glare",
    "albedo_field",
)
"""Effects the demo tries; a diagnosis tries all, which takes minutes longer."""

_SECONDS = {"evaluation": 13, "parts": 15, "study": 12 * TRIALS, "gap": 100, "real": 15}
"""What stages take on two cores, in relation to each other; only the time left depends on it."""

_BACK = (link("../index.html", "all that the demo made"),)


class _Step(NamedTuple):
    """One stage: what it is called, and the function that does it."""

    title: str
    run: Callable[["Demo", Progress], dict[str, Any]]


@dataclass
class Demo:
    """A demo in a folder, with what its stages have found so far."""

    out: Path
    seed: int
    design: Design
    found: dict[str, dict[str, Any]] = field(default_factory=dict)
    score: "Score | None" = None

    @property
    def index(self) -> Path:
        """The page about everything."""
        return self.out / "index.html"

    def to_json(self) -> dict[str, Any]:
        """Plain data: what each stage found, and where."""
        return {"out": str(self.out), "report": str(self.index), "stages": self.found}

    @property
    def text(self) -> str:
        """Where everything is, for people."""
        real = self.found["real"].get("left_out") or f"{self.out / 'real'}"
        return "\n".join(
            [
                f"report         {self.index}",
                f"STL, STEP, 3MF {self.out / 'parts'}",
                f"pictures       {self.out / 'evaluation'}",
                f"study          {self.out / 'study' / 'report.html'}",
                f"diagnosis      {self.out / 'diagnosis' / 'report.html'}",
                f"real picture   {real}",
            ]
        )


def demo(out: str | Path, *, seed: int = 0, progress: Progress = silent) -> Demo:
    """Run the demo; the same call again goes on where it ended.

    Parameters
    ----------
    out : path
        Folder of the results; may exist if it is empty or an earlier demo with the same seed.
    seed : int
        Seed of everything random.
    progress : callable, optional
        Called with what is being done, and how much of everything is done in thousandths.

    Raises
    ------
    ValueError
        If the folder holds something else.
    RuntimeError
        If a stage fails; names the stage and the reason.
    OSError
        If the folder cannot be written.
    """
    state = Demo(Path(out), seed, preset(SENSOR))
    claim(
        state.out,
        MARKER,
        {"design": state.design.digest, "seed": seed, "trials": TRIALS},
        kind="a demo",
        decided_by={
            "design": "of another design",
            "seed": "with another seed",
            "trials": "of other size",
        },
    )
    total, done = sum(_SECONDS.values()), 0
    for name, step in _STEPS.items():
        within = part_of(progress, step.title, begun=done, cost=_SECONDS[name], total=total)
        within("", 0, 1)
        try:
            state.found[name] = step.run(state, within)
        except (ValueError, RuntimeError) as error:
            raise RuntimeError(f"demo, {step.title}: {error}") from error
        done += _SECONDS[name]
    write_atomic(state.index, index_page(state.out, state.design, state.seed, state.found))
    progress("done", THOUSANDTHS, THOUSANDTHS)
    return state


def _evaluation(state: Demo, within: Progress) -> dict[str, Any]:
    from designlab.report.evaluation import evaluation_report
    from designlab.report.evaluation_folder import evaluate

    folder = state.out / "evaluation"
    report = folder / "report.html"
    if not report.is_file():
        state.score = evaluate(state.design, seed=state.seed, out=folder, progress=within)
        evaluation_report(state.score.to_json(), report, links=_BACK)
    return read_json(folder / "score.json")


def _parts(state: Demo, within: Progress) -> dict[str, Any]:
    from designlab.fabrication import export
    from designlab.report.view3d import render_view

    folder, view = state.out / "parts", state.out / "sensor.png"
    if not (folder / "manifest.json").is_file():
        export(
            state.design, folder, probes=[PROBE], progress=lambda what, done, of: within(what, done, of + 1)
        )
    drawn = view.is_file() or render_view(state.design, view).path is not None
    manifest = read_json(folder / "manifest.json")
    return {
        "folder": str(folder),
        "files": sorted(manifest["files"]),
        "parts": manifest["parts"],
        "checks": len(manifest["checks"]),
        "warnings": manifest["warnings"],
        "picture": str(view) if drawn else None,
    }


def _study(state: Demo, within: Progress) -> dict[str, Any]:
    from designlab.optimization.study import Parameter, Plan, Study, StudyInterrupted, load_results, run_study
    from designlab.report.evaluation_folder import evaluate
    from designlab.report.study import study_report

    folder = state.out / "study"
    study = Study(
        name="LED height and spacing",
        base=state.design,
        parameters={path: Parameter(low=low, high=high) for path, (low, high) in PARAMETERS.items()},
        trials=TRIALS,
        plan=Plan(promoted=0),
        seed=state.seed,
    )
    count = load_results(folder).counts()["complete"] if (folder / "study.db").is_file() else 0

    def counted(design: Design, /, *, fidelity: str, seed: int) -> "Score":
        nonlocal count

        def tick(what: str, done: int, of: int) -> None:
            within(f"design {count + 1} of {TRIALS}", count * of + done, TRIALS * of)

        known = state.score  # of the first stage, whose design is the study's starting point
        wanted = (design.digest, fidelity, seed, study.presses)
        if known is None or (known.digest, known.fidelity, known.seed, known.press_plan) != wanted:
            known = evaluate(design, fidelity=fidelity, seed=seed, presses=study.presses, progress=tick)
        count += 1
        return known

    try:
        results = run_study(study, out=folder, progress=False, evaluator=counted)
    except StudyInterrupted:
        raise KeyboardInterrupt from None  # the demo as a whole goes on, not the study alone
    if not (folder / "report.html").is_file():
        study_report(results, links=_BACK)
    return results.to_json()


def _gap(state: Demo, within: Progress) -> dict[str, Any]:
    from designlab.inference.diagnosis import diagnose
    from designlab.measurement import load_measurement
    from designlab.report.diagnosis_folder import write_diagnosis
    from designlab.report.gap import gap_report
    from designlab.simulation.effects.model import SensorModel
    from designlab.validation.synthetic import plant, seal_path, unseal

    measured, folder = state.out / "measurement", state.out / "diagnosis"
    report = folder / "report.html"
    if not report.is_file():
        if not (measured.is_dir() and seal_path(measured).is_file()):
            plant(state.design, effects=HIDDEN, out=measured, seed=state.seed, kit="small")
        found = diagnose(
            load_measurement(measured),
            SensorModel.of(state.design),
            out=folder,
            seed=state.seed,
            progress=within,
            columns=96,
            catalogue=TRIED,
        )
        gap_report(write_diagnosis(found), report, links=_BACK)
    return {**read_json(folder / "report.json"), "hidden": unseal(measured)["effects"]}


def _real(state: Demo, within: Progress) -> dict[str, Any]:
    import numpy as np

    from designlab.core.images import tone_map, write_image
    from designlab.measurement import load_measurement
    from designlab.measurement.compare import compare_model

    named = os.environ.get(MEASURED_VARIABLE)
    if not named:
        return {"left_out": f"left out: {MEASURED_VARIABLE} names no folder of real pictures"}
    folder = state.out / "real"

    def compared() -> dict[str, Any]:
        found = compare_model(
            preset(MEASURED),
            load_measurement(Path(named) / "gelsight-flat"),
            seed=state.seed,
            progress=within,
        )
        folder.mkdir(parents=True, exist_ok=True)
        for pair in found.pairs:
            beside = np.concatenate([pair.simulated, pair.real], axis=1)
            white = float(np.percentile(pair.real, 99.9))
            write_image(folder / f"{Path(pair.file).stem}.png", tone_map(beside, white))
        return found.to_json()

    return resumed(folder / "comparison.json", compared)


_STEPS: dict[str, _Step] = {
    "evaluation": _Step("scoring the design", _evaluation),
    "parts": _Step("files to make it", _parts),
    "study": _Step("searching for better LED places", _study),
    "gap": _Step("finding a hidden effect", _gap),
    "real": _Step("comparing with a real picture", _real),
}
