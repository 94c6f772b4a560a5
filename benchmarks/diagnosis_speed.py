"""How long a diagnosis of a set with poses of its own takes, by what it does.

    OMP_NUM_THREADS=1 python benchmarks/diagnosis_speed.py [--quick] [--against WORKTREE]

Every set holds eight presses of the hour kit in frames 150 pixels wide, hides one effect, none, or something
that is not in the catalogue, and is diagnosed cold: in a process of its own, without pictures that were
rendered before. `--against` diagnoses each set by the code of another checkout too, in turn, so that what
else the machine does weighs on both.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from designlab.core.store import CACHE_VARIABLE

SETS = (
    ("gelsight-2020-flat", "led_profile"),
    ("gelsight-2020-dome", "contact_profile"),
    ("gelsight-2020-flat", "colour_mixing"),
    ("gelsight-2020-dome", "camera_pose"),
    ("gelsight-2020-flat", ""),
    ("gelsight-2020-dome", "led_tilt"),
    ("gelsight-2020-flat", "specular_coat"),
    ("gelsight-2020-dome", ""),
    ("gelsight-2020-flat", "second_contact"),
)
COLUMNS = 150
BALLS, TRIANGLES = (0, 3, 4, 7, 10, 13), (16, 17)  # of the presses of a kit: six places, both depths
FIRST_SEED = 700_000
PARTS = ("render", "fit", "judge", "rest")
HERE = Path(__file__).parents[1]


def planted(number: int, folder: Path) -> Path:
    """Generate a set."""
    from designlab.sensor.design import preset
    from designlab.validation.synthetic import plant
    from designlab.validation.synthetic.capture_plan import stated_presses
    from designlab.validation.synthetic.effects import draw
    from designlab.validation.synthetic.generator_sensor import Rig
    from designlab.validation.synthetic.unmodelled import outside_kinds

    name, hidden = SETS[number]
    design, seed = preset(name), FIRST_SEED + number
    presses = stated_presses(design, "hour", np.random.default_rng(seed))
    outside = {hidden: 1.0} if hidden in outside_kinds() else {}
    effects = {}
    if hidden and not outside:
        effects[hidden] = draw(hidden, Rig.of(design), strength=1.0, seed=seed)
    return plant(
        design,
        effects=effects,
        outside=outside,
        out=folder / f"set-{number}",
        seed=seed,
        presses=[presses[k] for k in (*BALLS, *TRIANGLES)],
        columns=COLUMNS,
    )


class Clock:
    """Wall and processor time by part; what a part calls counts for the part that is called."""

    def __init__(self) -> None:
        self.wall: dict[str, float] = defaultdict(float)
        self.processor: dict[str, float] = defaultdict(float)
        self._now, self._last = "rest", (time.perf_counter(), time.process_time())

    def switch(self, part: str) -> str:
        """Go over to a part; returns the one before."""
        here = time.perf_counter(), time.process_time()
        self.wall[self._now] += here[0] - self._last[0]
        self.processor[self._now] += here[1] - self._last[1]
        before, self._now, self._last = self._now, part, here
        return before

    @contextmanager
    def within(self, part: str) -> Iterator[None]:
        """Count what is done within for a part."""
        before = self.switch(part)
        try:
            yield
        finally:
            self.switch(before)

    def watch(self, owner: Any, name: str, part: str) -> None:
        """Count all calls of a function for a part."""
        function: Callable[..., Any] = getattr(owner, name)

        def counted(*arguments: Any, **more: Any) -> Any:
            with self.within(part):
                return function(*arguments, **more)

        setattr(owner, name, counted)


def diagnosed(measurement: Path) -> dict[str, Any]:
    """Diagnose a set, cold, in this process."""
    from designlab.inference.diagnosis import diagnose
    from designlab.inference.diagnosis.likelihood.fit import Fitter
    from designlab.inference.diagnosis.selection import forward_selection, recentring, refine
    from designlab.measurement import load_measurement
    from designlab.report.diagnosis_folder import write_diagnosis
    from designlab.simulation.render_cache import Renders

    clock = Clock()
    for user in (forward_selection, recentring, refine):
        clock.watch(user, "judge", "judge")
    clock.watch(Fitter, "fit", "fit")
    clock.watch(Renders, "basis", "render")
    clock.switch("rest")
    loaded = load_measurement(measurement)
    design = loaded.design()
    assert design is not None
    with tempfile.TemporaryDirectory() as out:
        found = diagnose(loaded, design, out=out, seed=1)
        report = write_diagnosis(found, pictures=False)
    clock.switch("rest")
    return {
        "wall": dict(clock.wall),
        "processor": dict(clock.processor),
        "pictures": found.provenance["rendered"],
        "memory_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
        "verdict": report["verdict"],
        "effects": report["effects"],
        "gap": report["gap"],
    }


def cold(measurement: Path, code: Path) -> dict[str, Any]:
    """Diagnose a set in a new process by the code of a checkout."""
    command = [sys.executable, str(Path(__file__).resolve()), "--one", str(measurement)]
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "PYTHONPATH": str(code), CACHE_VARIABLE: cache}
        done = subprocess.run(command, env=environment, cwd=code, check=True, capture_output=True, text=True)
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def told(found: dict[str, Any]) -> str:
    """One line of what a diagnosis took and found."""
    parts = (f"{p} {found['wall'].get(p, 0):.0f} ({found['processor'].get(p, 0):.0f})" for p in PARTS)
    names = [
        " ".join(
            [e["name"]]
            + [f"{k}={v['value']:.4g} ({v['low']:.4g}, {v['high']:.4g})" for k, v in e["parameters"].items()]
        )
        for e in found["effects"]
    ]
    final = found["gap"]["final"]
    return (
        f"{sum(found['wall'].values()):.0f} s ({sum(found['processor'].values()):.0f} s of processor): "
        f"{', '.join(parts)}; {found['pictures']} pictures, {found['memory_gb']:.1f} GB; "
        f"{found['verdict']}: {', '.join(names) or '-'}; gap {final['before']:.4g} to {final['after']:.4g}"
    )


def main() -> None:
    """Print the time of each diagnosis and its parts, and median and 95th percentile of all."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="one set only")
    parser.add_argument("--sets", type=int, nargs="+", help="numbers of the sets; all when absent")
    parser.add_argument("--against", type=Path, help="another checkout to compare with")
    parser.add_argument("--keep", type=Path, help="folder where the sets stay")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(diagnosed(arguments.one)))
        return
    numbers = [0] if arguments.quick else arguments.sets or range(len(SETS))
    codes = [path.resolve() for path in (arguments.against, HERE) if path]
    seconds: dict[Path, list[float]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        for number in numbers:
            there = folder / f"set-{number}"
            measurement = there if there.exists() else planted(number, folder)
            for code in codes:
                found = cold(measurement, code)
                seconds[code].append(sum(found["wall"].values()))
                print(f"{' '.join(SETS[number])} by {code.name}: {told(found)}", flush=True)
    for code in codes:
        median, most = np.percentile(seconds[code], [50, 95])
        print(
            f"{code.name}: median {median:.0f} s, 95th percentile {most:.0f} s of {len(seconds[code])} sets"
        )


if __name__ == "__main__":
    main()
