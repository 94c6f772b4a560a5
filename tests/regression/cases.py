"""What is recorded and compared: commands and calls small enough to be run at every test.

Every case takes a folder of its own to write into and a preset, and gives plain data. Cases go through the
command line where it can be made small: the effort `fast` is made smaller still, `gap diagnose` is called
with a short catalogue, and a study has a closed form in place of evaluations, which have cases of their own.
"""

import contextlib
import io
import json
import math
import re
import shutil
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import tomli_w

from designlab.app.cli import main
from designlab.core.images import read_image
from designlab.evaluation.evaluate import FIDELITIES
from designlab.inference.diagnosis import diagnose
from designlab.measurement import load_measurement
from designlab.optimization.study import load_study, run_study
from designlab.report.diagnosis_folder import write_diagnosis
from designlab.sensor.contact import KernelContact
from designlab.sensor.design import dumps, preset
from designlab.simulation.effects.model import load_model

HERE = Path(__file__).parent
RECORDED = HERE / "recorded"
PLANTED = HERE / "planted"  # what `plant` below made; its frames are measured by the other cases
FLAT, DOME, CORE = "gelsight-2020-flat", "gelsight-2020-dome", "gelsight-2020-flat-core"
DEFAULT = "default with the smoothing kernel that it had when its figures were recorded"
# As deep as these were pressed when that followed from each gel.
DEPTHS_MM = {DEFAULT: 0.7, DOME: 0.8, CORE: 0.8}

STUDY = f"""\
version = 1
name = "regression"
base = "{FLAT}"
trials = 6
fidelity = "fast"
seed = 5
sampler = "random"

[parameters.leds.height_mm]
low = 6.0
high = 12.0

[parameters.leds.tilt_deg]
low = 0.0
high = 40.0

[objectives]
uniformity_u0 = "maximise"
normal_error_median_deg = "minimise"

[constraints]
coverage.least = 0.95

[plan]
promoted = 2
confirmed = 1
seeds = 2
"""
EFFECTS = ("vignetting", "black_level")  # right, and wrong by far
ONE_PRESS = ("background-0.exr", "press-04.exr")
THREE_PLACES = (
    "dark.exr",
    "background-0.exr",
    "background-1.exr",
    "press-02.exr",
    "press-04.exr",
    "press-06.exr",
)

ZERO = 1e-12  # difference from which a number is another one, however small both are
# When, where and by which version something was made, what differs each time on purpose, digests of what is
# fitted, and paths.
NOT_COMPARED = re.compile(r"seconds|version|salt|model_digest|folder|files|pictures|report|model|out|output")


def command(*words: object) -> dict[str, Any]:
    """Run a command in this process and return the object that it prints."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        status = main([*map(str, words), "--json"])
    found: dict[str, Any] = json.loads(printed.getvalue())
    assert status == 0, found
    return found


@contextlib.contextmanager
def little_effort() -> Iterator[None]:
    """Make evaluations of the effort `fast` small: they are to be the same, not to be right."""
    small = FIDELITIES["fast"]._replace(samples=8, columns=48)
    with mock.patch.dict(FIDELITIES, {"fast": small}):
        yield


def evaluate(folder: Path, design: str) -> dict[str, Any]:
    depth_mm = DEPTHS_MM[design]
    if design == DEFAULT:
        kernel = preset("default").replace({"contact": KernelContact(kernel_length_mm=0.05)})
        # Its housing was a plain tube then.
        kernel = kernel.replace({"housing.seats": None, "name": kernel.name})
        (folder / "default.toml").write_text(dumps(kernel), encoding="utf-8")
        design = str(folder / "default.toml")
    with little_effort():
        return command("evaluate", design, "--depth-mm", depth_mm, "--seed", 0)


def render(folder: Path, design: str) -> dict[str, Any]:
    press = ("--probe", "star:4", "--depth-mm", 0.4, "--at", "1,-0.5", "--yaw-deg", 20)
    effort = ("--columns", 48, "--samples", 8, "--seed", 3)
    return command("render", design, *press, *effort, "-o", folder / "press.exr")


def compare(folder: Path, design: str) -> dict[str, Any]:
    return command("compare", design, PLANTED, "--samples", 16, "--seed", 0)


def plant(folder: Path, design: str) -> dict[str, Any]:
    """Also what every frame shows, since the command itself prints paths alone."""
    effect = ("--effect", "vignetting:corner_loss=0.5", "--kit", "small")
    command(
        "gap", "plant", "--design", design, *effect, "--columns", 24, "--seed", 3, "--out", folder / "planted"
    )
    files = sorted((folder / "planted").glob("*.exr"))
    means = {file.stem: read_image(file).mean(axis=(0, 1)).tolist() for file in files}
    return {"answer": json.loads((folder / "planted.answer.json").read_text()), "means": means}


def some(files: tuple[str, ...], folder: Path) -> Path:
    """Copy some frames of the planted set into a measurement of their own."""
    folder.mkdir()
    content = tomllib.loads((PLANTED / "measurement.toml").read_text(encoding="utf-8"))
    content["frame"] = [frame for frame in content["frame"] if frame["file"] in files]
    (folder / "measurement.toml").write_text(tomli_w.dumps(content), encoding="utf-8")
    for file in files:
        shutil.copy(PLANTED / file, folder)
    return folder


def _kept(found: dict[str, Any]) -> dict[str, Any]:
    """A calibration without its correlation, which is large and has entries near zero, and its verdict."""
    return {
        key: value for key, value in found.items() if key not in ("correlation", "fit_verdict", "reasons")
    }


def calibrate(folder: Path, design: str) -> dict[str, Any]:
    measured, out = some(ONE_PRESS, folder / "measured"), folder / "out"
    found = command("calibrate", measured, "--model", design, "--free", "--seed", 1, "--out", out)
    return _kept(found)


def phong(folder: Path, design: str) -> dict[str, Any]:
    """Calibrated light without transport, and how it does on the same frames."""
    measured, out = some(ONE_PRESS, folder / "measured"), folder / "out"
    found = command(
        "calibrate", measured, "--model", design, "--baseline", "phong", "--free", "--seed", 1, "--out", out
    )
    return {"found": _kept(found), "compared": command("compare", out / "calibrated.toml", measured)}


def diagnosis(folder: Path, design: str) -> dict[str, Any]:
    report = diagnose(
        load_measurement(some(THREE_PLACES, folder / "measured")),
        load_model(design),
        out=folder / "out",
        seed=0,
        catalogue=EFFECTS,
        samples=8,
        columns=24,
    )
    return write_diagnosis(report, pictures=False)


def closed_form(design: Any, *, fidelity: str, seed: int) -> SimpleNamespace:
    """Score a design of the study without any simulation."""
    tilt, height = design.leds.tilt_deg, design.leds.height_mm
    values = {
        "uniformity_u0": 1 / (1 + (tilt / 40) ** 2) + height / 100,
        "normal_error_median_deg": 2 + (tilt - 30) ** 2 / 900 + (seed % 7) / 100,
        "coverage": 1.0 - (height > 11) / 10,
    }
    scores = {
        name: SimpleNamespace(value=value, se=0.01, bias_bound=None, unit="1")
        for name, value in values.items()
    }
    return SimpleNamespace(scores=scores, seconds={})


def study(folder: Path, design: str) -> dict[str, Any]:
    """Which designs are drawn, recommended and confirmed, and what is said of them."""
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    definition = load_study(folder / "study.toml")
    run_study(definition, out=folder / "out", progress=False, evaluator=closed_form)
    return command("study", "status", folder / "out")


CASES = {
    "evaluate-default": (evaluate, DEFAULT),
    "evaluate-dome": (evaluate, DOME),
    "evaluate-core": (evaluate, CORE),
    "render-flat": (render, FLAT),
    "render-dome": (render, DOME),
    "compare": (compare, FLAT),
    "plant": (plant, FLAT),
    "calibrate": (calibrate, FLAT),
    "calibrate-phong": (phong, FLAT),
    "diagnosis": (diagnosis, FLAT),
    "study": (study, FLAT),
}


def run(name: str, folder: Path) -> dict[str, Any]:
    """Run a case, and give what JSON keeps of it."""
    case, design = CASES[name]
    found: dict[str, Any] = json.loads(json.dumps(case(folder, design)))
    return found


def numbers(content: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Give the path and value of every leaf that is compared."""
    if isinstance(content, dict):
        for name, value in content.items():
            if not NOT_COMPARED.fullmatch(name):
                yield from numbers(value, f"{path}.{name}" if path else name)
    elif isinstance(content, list):
        for number, value in enumerate(content):
            yield from numbers(value, f"{path}[{number}]")
    else:
        yield path, content


def differences(found: Any, recorded: Any, tolerances: Mapping[str, float]) -> list[str]:
    """Say which values are not as they were.

    Numbers may differ by a share of the larger one: that of the longest beginning of their path.
    """
    old, new = dict(numbers(recorded)), dict(numbers(found))
    said = [f"{path}: only {'now' if path in new else 'before'}" for path in sorted(set(old) ^ set(new))]
    for path, before in old.items():
        now = new.get(path, before)
        alike = before == now
        if isinstance(before, float) and isinstance(now, int | float):
            share = tolerances[max((start for start in tolerances if path.startswith(start)), key=len)]
            alike = math.isclose(before, now, rel_tol=share, abs_tol=ZERO)
        if not alike:
            said.append(f"{path}: was {before!r}, is {now!r}")
    return said
