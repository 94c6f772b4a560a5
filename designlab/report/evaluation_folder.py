"""A design scored, and the folder that the scores and the pictures of them are left in."""

import json
from pathlib import Path

from designlab.core.progress import silent
from designlab.core.run_folder import require_writable
from designlab.core.store import atomic_folder, write_atomic
from designlab.core.types import Progress
from designlab.evaluation import evaluate as evaluation
from designlab.evaluation.press_plan import PressPlan
from designlab.evaluation.score import Evaluation, Score
from designlab.reconstruction import KernelCalibration
from designlab.report.evaluation_plots import Scale, figures
from designlab.report.figures import write_figure
from designlab.sensor.design import Design, dumps
from designlab.simulation.effects.model import SensorModel

SCORE_FILE = "score.json"


def evaluate(
    design: Design | SensorModel,
    *,
    fidelity: str = "fast",
    seed: int = 0,
    depth_mm: float | None = None,
    force_n: float | None = None,
    presses: PressPlan | None = None,
    all_scores: bool = False,
    out: str | Path | None = None,
    progress: Progress = silent,
    calibration: KernelCalibration | None = None,
    as_built: bool = False,
) -> Score:
    """Score a design by simulation.

    Parameters
    ----------
    design : Design or SensorModel
        What to score.
    fidelity : {"fast", "standard", "reference"}
        Effort; presses depend on plan and seed alone, so all see the same ones.
    seed : int
        Seed of places, render noise and camera noise.
    depth_mm : float, optional
        Depth of the deepest press in mm, see `PressPlan`; 0.8 when absent, less on small sensing areas.
    force_n : float, optional
        Force of the strongest press in N instead, for elastic gels.
    presses : PressPlan, optional
        A whole plan instead, which designs of other sensing areas can share: ``PressPlan.of(one, other)``.
    all_scores : bool
        Whether to find the scores of elastic gels that need presses of their own, as fidelity standard does.
    out : path, optional
        Folder for scores and pictures; replaced when it exists.
    progress, calibration, as_built
        As in `designlab.evaluation.evaluate.evaluate`.

    Returns
    -------
    Score
        Each score with value, standard error, bound of its bias, and unit.

    Raises
    ------
    InfeasibleDesign
        If the design breaks a geometric rule, or cannot take the presses.
    ValueError
        If the fidelity is unknown, two of depth, force and plan are given, or the folder holds anything but
        an earlier evaluation.
    OSError
        If the folder cannot be written.
    """
    if out is not None:
        require_writable(out, made_with=SCORE_FILE)
    if depth_mm is not None or force_n is not None:
        if presses is not None:
            raise ValueError("presses: a plan states depth or force, which are given too")
        built = SensorModel.of(design).effective_design()
        presses = PressPlan.of(built, depth_mm=depth_mm, force_n=force_n)
    found = evaluation.evaluate(
        design,
        fidelity=fidelity,
        seed=seed,
        presses=presses,
        all_scores=all_scores,
        progress=progress,
        calibration=calibration,
        as_built=as_built,
    )
    if out is not None:
        write_evaluation(found, Path(out))
    return found.score


def write_evaluation(found: Evaluation, out: Path, *, scale: Scale | None = None) -> None:
    """Write the design, the scores and pictures of them into a folder, which is replaced as a whole.

    Parameters
    ----------
    found : Evaluation
        What is written.
    out : Path
        The folder.
    scale : Scale, optional
        Ends of the scales of its pictures, which designs that are compared share.
    """
    with atomic_folder(out, replace=True) as folder:
        write_atomic(folder / "design.toml", dumps(found.design))
        write_atomic(folder / SCORE_FILE, json.dumps(found.score.to_json(), indent=2))
        for name, figure in figures(found, scale).items():
            write_figure(figure, folder / name)
