"""Damaged files through the command line, in one warm process: refused in a line, or a picture of something.

    python benchmarks/fuzz_files.py [--files 1000] [--seed 0] [--first N] [--keep DIR] [--million]

Good files of every kind (meshes, lenses, lights, pictures, designs, measurements, parts) are mutated: bytes,
numbers, words and lines changed, cut out, doubled; ends cut off. Each is given to the command that reads it.
Faults are: an exception or a traceback, what the command line calls a defect, a status other than 0 and 2,
exit 0 with a picture that shows nothing, a refusal of many lines or without the name of its file. `--first N`
begins with the N-th file, `--keep DIR` keeps files at fault, `--million` presses a million triangles.
"""

import argparse
import contextlib
import io
import json
import math
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
from damage import mutated
from good_files import DESIGN, seeds

from designlab.app.cli import main as designlab
from designlab.core.images import read_image, write_image
from designlab.sensor.design import preset

SHARES = {"mesh": 30, "lens": 20, "picture": 18, "light": 12, "design": 10, "measurement": 6, "parts": 4}
RARE = {".step"}  # read by a process of its own, which takes seconds to start
RARELY = 0.1
RENDERED = 0.25  # of the designs and light files: the others are read only
SMALL = ("--columns", "16", "--samples", "1", "--json")
NOTHING_MM = 1e-6
FULL_OF_WORDS = 2000  # letters of a refusal


class Case(NamedTuple):
    """A mutated file: its number, kind, name and content."""

    number: int
    kind: str
    name: str
    data: bytes


class Outcome(NamedTuple):
    """What came of a case: exit status (None: an exception), seconds, and the fault, if any."""

    case: Case
    status: int | None
    seconds: float
    fault: str


def case(number: int, good: dict[str, dict[str, bytes]], seed: int) -> Case:
    """The case of a number, which depends on it and the seed alone."""
    draw = np.random.default_rng([seed, number])
    shares = np.array(list(SHARES.values()), dtype=float)
    kind = list(SHARES)[draw.choice(len(shares), p=shares / shares.sum())]
    names = list(good[kind])
    weights = np.array([RARELY if Path(name).suffix in RARE else 1.0 for name in names])
    name = names[draw.choice(len(names), p=weights / weights.sum())]
    return Case(number, kind, name, mutated(good[kind][name], name, draw))


def prepared(folder: Path, good: dict[str, dict[str, bytes]]) -> None:
    """Write the good files that mutated ones are read together with."""
    preset("default").save(folder / "good.toml")
    (folder / "lens.json").write_bytes(good["lens"]["flat.json"])
    (folder / "ball.stl").write_bytes(good["mesh"]["binary.stl"])
    picture = np.full((24, 32, 3), 0.3, dtype=np.float32) + np.linspace(0, 0.2, 32, dtype=np.float32)[:, None]
    for name in ("background.exr", "press.exr"):
        write_image(folder / name, picture)


def commands(case: Case, file: Path) -> list[list[str]]:
    """Command lines that read the file; it is accepted where all end with 0."""
    folder, rendered = file.parent, np.random.default_rng(case.number + 1).random() < RENDERED
    picture, good, lens = (str(folder / name) for name in ("out.exr", "good.toml", "lens.json"))
    read = ["lens", lens, "--json", "--design"]
    if case.kind == "mesh":
        return [["render", DESIGN, "--probe", str(file), "--depth-mm", "0.4", "-o", picture, *SMALL]]
    if case.kind == "lens":
        return [["lens", str(file), "--design", good, "--out", str(folder / "new.toml"), "--json"]]
    if case.kind == "picture":
        how = ["--response", "linear", "--white", "1"] if case.name == "float.npy" else ["--response", "srgb"]
        out = str(folder / "set")
        return [
            ["import", str(file), "--kind", "background", *how, "--sensor", DESIGN, "--out", out, "--json"]
        ]
    if case.kind == "measurement":
        return [["compare", DESIGN, str(file), "--samples", "1", "--json"]]
    if case.kind == "parts":
        return [["parts", str(file), "--json"]]
    design = str(file)
    if case.kind == "light":
        design = str(folder / "lit.toml")
        field = case.name.partition(".")[2]
        text = f'mixing = [[1.0], [0.5], [0.2]]\n[leds]\nprofile = {{ {field} = "{file.name}" }}\n'
        text += '[[leds.groups]]\nname = "white"\nazimuth_deg = [90.0]\n'
        Path(design).write_text(text, encoding="utf-8")
    first = [*read, design]
    return [first, ["render", design, "-o", picture, *SMALL]] if rendered else [first]


def empty(words: list[str], data: dict[str, Any], folder: Path) -> str:
    """What is missing in a result of exit 0, if anything."""
    if words[0] == "render":
        light = data["mean_radiance"]
        if any(value is None or not math.isfinite(value) for value in light):
            return "picture with values that are no numbers"
        if max(light) <= 0:
            return "dark picture"
        told = any("touch" in warning or "picture" in warning for warning in data["warnings"])
        if "--probe" in words and not (data["deepest_mm"] or 0) > NOTHING_MM and not told:
            return "picture of the untouched gel"
    if words[0] == "import":
        values = read_image(folder / "set" / data["files"][0])
        if not np.isfinite(values).all():
            return "picture with values that are no numbers"
        if not values.max() > 0 and not data["notes"]:
            return "dark picture"
    if words[0] == "compare" and data["mse"] is None:
        return "figures that are no numbers"
    return ""


def tried(case: Case, folder: Path) -> Outcome:
    """Give a file to the command line."""
    file = folder / case.name
    if case.kind == "mesh" and file.suffix == ".stl":
        file = folder / f"probe-{case.name}"
    file.write_bytes(case.data)
    started = time.perf_counter()
    status: int | None = 0
    fault = ""
    for words in commands(case, file):
        out, error = io.StringIO(), io.StringIO()
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
                status = designlab(words)
        except BaseException as escaped:
            if isinstance(escaped, KeyboardInterrupt):
                raise
            status, fault = None, f"{type(escaped).__name__}: {escaped}"
            break
        said = error.getvalue()
        fault = judged(words, status, out.getvalue(), said, file, folder)
        if status or fault:
            break
    seconds = time.perf_counter() - started
    file.unlink(missing_ok=True)
    shutil.rmtree(folder / "set", ignore_errors=True)
    return Outcome(case, status, seconds, fault)


def judged(words: list[str], status: int, out: str, said: str, file: Path, folder: Path) -> str:
    """The fault of what a command did, if any."""
    own = [line for line in said.splitlines() if line.startswith("designlab: ")]
    refusals = [line for line in own if not line.startswith("designlab: note: ")]
    if "Traceback" in said or "a defect of designlab" in said:
        return said.strip().splitlines()[-1]
    if status not in (0, 2):
        return f"exit status {status}: {' '.join(refusals)}"
    if status == 2:
        if len(refusals) != 1:
            return f"{len(refusals)} lines of refusal"
        # A design stands for its light file, a folder for its set; a lens that fits no design is named.
        names = (file.name, "lit.toml", *(["lens.json"] if words[0] == "lens" else []))
        names = (str(folder),) if words[0] == "compare" else names
        if not any(name in refusals[0] for name in names):
            return f"the refusal does not name the file: {refusals[0]}"
        return "" if len(refusals[0]) < FULL_OF_WORDS else f"a refusal of {len(refusals[0])} letters"
    return empty(words, json.loads(out), folder)


def fuzz(files: int, *, seed: int = 0, first: int = 0, keep: Path | None = None) -> list[Outcome]:
    """Try mutated files, one after the other in this process."""
    good, found = seeds(), []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepared(folder, good)
        warm = [Case(-1, kind, file, data) for kind in good for file, data in good[kind].items()]
        for one in warm:  # good files are accepted; what is loaded or compiled once, is
            outcome = tried(one, folder)
            if outcome.status != 0 or outcome.fault:
                raise AssertionError(f"{one.kind} {one.name} is good: {outcome.status} {outcome.fault}")
        for number in range(first, first + files):
            outcome = tried(case(number, good, seed), folder)
            found.append(outcome)
            if outcome.fault:
                one = outcome.case
                print(f"{one.number} {one.kind} {one.name}: {outcome.fault}", flush=True)
                if keep is not None:
                    keep.mkdir(parents=True, exist_ok=True)
                    (keep / f"{one.number}-{one.name}").write_bytes(one.data)
    return found


def million(folder: Path) -> tuple[float, float]:
    """Seconds, on the clock and of the processor, in which `render` reads and presses a million triangles."""
    steps = np.linspace(-30, 30, 709)
    x, y = np.meshgrid(steps, steps)
    z = np.maximum(-(x**2 + y**2) / 8, -12) + 0.01 * np.sin(3 * x)
    at = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    body = trimesh.Trimesh(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), faces, process=False)
    body.export(folder / "million.stl")
    started, worked = time.perf_counter(), time.process_time()
    words = ["render", DESIGN, "--probe", str(folder / "million.stl"), "--depth-mm", "0.4"]
    with contextlib.redirect_stdout(io.StringIO()):
        status = designlab([*words, "-o", str(folder / "million.exr"), *SMALL])
    if status:
        raise SystemExit("the mesh of a million triangles was refused")
    return time.perf_counter() - started, time.process_time() - worked


def peak_gb() -> float:
    """Largest memory that this process or one that it started has held, in GB."""
    most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return most * (1 if sys.platform == "darwin" else 1024) / 1e9


def main() -> None:
    """Print faults, and the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--files", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--million", action="store_true")
    args = parser.parse_args()
    found = fuzz(args.files, seed=args.seed, first=args.first, keep=args.keep)
    seconds = np.array([outcome.seconds for outcome in found])
    by_kind = Counter((one.case.kind, "accepted" if one.status == 0 else "refused") for one in found)
    for kind in SHARES:
        times = [one.seconds for one in found if one.case.kind == kind]
        accepted, refused = by_kind[kind, "accepted"], by_kind[kind, "refused"]
        slowest = max(times, default=0.0)
        print(f"{kind:12} {accepted:4} accepted {refused:4} refused, slowest {slowest:.1f} s")
    print(f"{len(found)} files, faults: {sum(bool(one.fault) for one in found)}")
    median, late = np.quantile(seconds, (0.5, 0.95))
    print(f"seconds a file: median {median:.2f}, 95th percentile {late:.2f}")
    print(f"memory: {peak_gb():.2f} GB")
    if args.million:
        with tempfile.TemporaryDirectory() as folder:
            wall, processor = million(Path(folder))
            print(f"a million triangles: {wall:.1f} s, {processor:.1f} s of the processor")


if __name__ == "__main__":
    main()
