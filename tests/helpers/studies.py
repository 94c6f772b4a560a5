"""Small studies of an evaluator with a closed form."""

import contextlib
import math
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

from designlab.optimization.study import Parameter, Plan, Study, run_study
from tests.helpers.scores import Estimate, Score

RANGES = {"leds.tilt_deg": Parameter(low=-20, high=60), "leds.height_mm": Parameter(low=5, high=14)}
BEST_TILT_DEG = {"uniformity_u0": 30.0, "normal_error_median_deg": 10.0}
OBJECTIVES = {"uniformity_u0": "maximise", "normal_error_median_deg": "minimise"}
BARE = {"constraints": {}, "plan": Plan(promoted=0)}


def closed_form(design, *, fidelity, seed):
    """Two scores that disagree about the tilt and agree about a height of 8 mm."""
    tilt, height = design.leds.tilt_deg, design.leds.height_mm
    loss = ((height - 8.0) / 10.0) ** 2
    return Score(
        {
            "uniformity_u0": Estimate(math.exp(-(((tilt - 30.0) / 40.0) ** 2) - loss)),
            "normal_error_median_deg": Estimate(1 + ((tilt - 10.0) / 20.0) ** 2 + loss, unit="deg"),
            "height_mae_um": Estimate(10.0 * height, unit="um"),
        }
    )


class Counting:
    """The closed form, remembering which designs it was asked for."""

    def __init__(self, answer=closed_form):
        self.answer = answer
        self.digests = []

    def __call__(self, design, *, fidelity, seed):
        self.digests.append(design.digest)
        return self.answer(design, fidelity=fidelity, seed=seed)


class Death(Exception):
    """Stands for the death of the process that evaluates."""


@contextlib.contextmanager
def mortal(workers, interrupts, **_):
    """In place of processes, threads: a call that raises Death breaks all that run beside it."""
    running = []

    def call(future, function, arguments):
        try:
            result = function(*arguments)
        except Death:
            for broken in [other for other in running if not other.done()]:
                broken.set_exception(BrokenProcessPool())
        else:
            if not future.done():
                future.set_result(result)

    with ThreadPoolExecutor(workers) as pool:

        def submit(function, *arguments):
            running.append(Future())
            pool.submit(call, running[-1], function, arguments)
            return running[-1]

        yield submit


def make(**changes):
    content = {"name": "ring", "base": "gelsight-2020-flat", "parameters": RANGES, "trials": 6, **BARE}
    return Study.model_validate(content | changes)


def run(study, out, **options):
    return run_study(study, out=out, progress=False, **({"evaluator": closed_form} | options))


def write(folder: Path, text: str) -> Path:
    path = folder / "study-file.toml"
    path.write_text(text, encoding="utf-8")
    return path
