"""Timing measures time and quality of pictures by samples and pixels, as in the paper's appendix."""

import os
import platform
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from designlab.core.backend import activate, cuda_devices
from designlab.core.metrics import compare
from designlab.core.progress import silent
from designlab.core.store import CACHE_VARIABLE
from designlab.core.types import Progress
from designlab.sensor.camera import View
from designlab.sensor.design import Design, preset
from designlab.simulation.contact.press import Press
from designlab.simulation.simulator import Simulator
from designlab.validation.paper_2020.datasets import BALL, crop_around
from designlab.validation.paper_2020.sizes import CROP_PX, Size
from geometries.probes import parse

SENSOR = "gelsight-2020-flat"
DEPTH_MM = 1.0  # of the pressed ball
REFERENCE_SAMPLES = 64
SIDE_SAMPLES = 8  # at which the side of the picture is varied
SAMPLES, WARMING = 64, 4  # of the fast estimator, and of its first run
REPEATS = 3  # of which the median counts
NEXT_MM = (-1.0, -0.5, 0.5, 1.0)  # where the ball is pressed for further pictures of the fast estimator

PAPER_MS = {
    (600, 4): 64.0,
    (600, 8): 95.0,
    (600, 16): 174.0,
    (128, 8): 33.0,
    (256, 8): 36.0,
    (512, 8): 55.0,
    (1024, 8): 126.0,
}
"""Published milliseconds by side and samples a pixel, on a GeForce RTX 2080 Ti (arXiv 2012.13184)."""

Pixels = NDArray[np.float32]


def timing(folder: str | Path, size: Size, seed: int = 1, progress: Progress = silent) -> dict[str, Any]:
    """Time pictures of a pressed ball, and compare each with a long reference of the same view.

    A path-traced picture is timed from the membrane's shape to radiance of every LED group in memory, the
    scene's loading included; the median of some after one that compiles. The fast estimator is timed from the
    press to the picture: its first picture traces the light field, the next ones are shaded from it.

    Parameters
    ----------
    folder : path
        Where light fields are kept meanwhile, so that none of an earlier run is taken.
    size : Size
        Sides and samples.
    seed : int
        Seed of the light transport.
    progress : callable, optional
        Called with what is timed, pictures done and pictures in all.

    Returns
    -------
    dict
        ``device``; ``path``, one entry for each side and number of samples; ``fast``, one entry for each
        side: milliseconds, and SNR (dB) and SSIM against the reference.
    """
    design = preset(SENSOR)
    backend = activate()
    cases = [(size.crop_px, samples) for samples in size.timing_samples]
    cases += [(side, SIDE_SAMPLES) for side in size.timing_px if (side, SIDE_SAMPLES) not in cases]
    sides = sorted({side for side, _ in cases})
    references: dict[int, Pixels] = {}
    path: list[dict[str, Any]] = []
    steps = len(cases) + len(sides) + 1
    for side in sides:
        progress(f"reference of {side} x {side}", len(references) + len(path), steps)
        references[side] = reference(design, side, seed)
        for samples in (n for s, n in cases if s == side):
            progress(f"{side} x {side}, {samples} samples", len(references) + len(path), steps)
            row, picture = path_ms(design, side, samples, seed)
            path.append({**row, **_quality(picture, references[side])})
    progress("fast estimator", steps - 1, steps)
    with _own_cache(Path(folder)):
        row, picture = fast_ms(design, size.crop_px, seed)
    return {
        "device": device(),
        "backend": backend.variant,
        "reference_samples": REFERENCE_SAMPLES,
        "repeats": REPEATS,
        "path": [row for case in cases for row in path if case == (row["px"], row["samples"])],
        "fast": [{**row, **_quality(picture, references[size.crop_px])}],
    }


def device() -> str:
    """Name what the light is traced on: the GPU, or the processor and its cores that may be used."""
    backend = activate()
    if backend.variant == "cuda_ad_rgb":
        return ", ".join(cuda_devices()[1:])
    name = platform.processor() or platform.machine()
    try:
        about = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        about = ""
    named = [line.partition(":")[2].strip() for line in about.splitlines() if line.startswith("model name")]
    return f"{named[0] if named else name}, {backend.threads} cores"


def view(design: Design, side: int) -> View:
    """Square of the sensor that the paper compares, at so many pixels a side."""
    x, y, width, height = crop_around(design, (0.0, 0.0), CROP_PX)
    return View(float(x), float(y), float(width), float(height), side, side)


def reference(design: Design, side: int, seed: int) -> Pixels:
    """Trace a picture with many samples, with other random numbers than those that are timed."""
    simulator = Simulator(
        design, view=view(design, side), samples=REFERENCE_SAMPLES, seed=seed + 1_000_000, estimator="path"
    )
    return simulator.frame(_press()).mixed


def path_ms(design: Design, side: int, samples: int, seed: int) -> tuple[dict[str, Any], Pixels]:
    """Time a path-traced picture, the press calculated before; and the last picture."""
    simulator = Simulator(design, view=view(design, side), samples=samples, seed=seed, estimator="path")
    surface = simulator.surface(_press())
    times = []
    for number in range(REPEATS + 1):
        begun = time.perf_counter()
        frame = simulator.frame(_press(), seed=seed + number, surface=surface)
        times.append(1e3 * (time.perf_counter() - begun))
    paper_ms = PAPER_MS.get((side, samples))
    row = {"px": side, "samples": samples, "ms": statistics.median(times[1:]), "paper_ms": paper_ms}
    return row, frame.mixed


def fast_ms(design: Design, side: int, seed: int) -> tuple[dict[str, Any], Pixels]:
    """Time the first and the next pictures of the fast estimator; and its picture of the centred press."""
    for samples in (WARMING, SAMPLES):  # the first run compiles
        simulator = Simulator(design, view=view(design, side), samples=samples, seed=seed)
        begun = time.perf_counter()
        frame = simulator.frame(_press())
        picture = frame.mixed
        first = 1e3 * (time.perf_counter() - begun)
        following = []
        for at_mm in NEXT_MM:
            begun = time.perf_counter()
            _ = simulator.frame(_press(at_mm)).mixed
            following.append(1e3 * (time.perf_counter() - begun))
    return {"px": side, "first_ms": first, "next_ms": statistics.median(following)}, picture


def _press(at_mm: float = 0.0) -> Press:
    return Press(probe=parse(BALL), depth_mm=DEPTH_MM, centre_mm=(at_mm, 0.0))


def _quality(picture: Pixels, truth: Pixels) -> dict[str, float]:
    figures = compare(picture, truth)
    return {name: float(figures[name]) for name in ("snr_db", "ssim")}


@contextmanager
def _own_cache(folder: Path) -> Iterator[None]:
    """Keep light fields in a new folder for a while, so that each is traced and none taken from the disk."""
    before = os.environ.get(CACHE_VARIABLE)
    folder.mkdir(parents=True, exist_ok=True)
    # The last light field may still be on its way to the disk when the folder goes.
    with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as cache:
        os.environ[CACHE_VARIABLE] = cache
        try:
            yield
        finally:
            if before is None:
                del os.environ[CACHE_VARIABLE]
            else:
                os.environ[CACHE_VARIABLE] = before
