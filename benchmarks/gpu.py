"""Time of a picture on the fastest back end of this machine, beside the published table.

    python benchmarks/gpu.py

The scene is the one of arXiv 2012.13184 with all LEDs in one colour picture, four path segments and Mitsuba's
default sampler, as published; the times beside it are the paper's, on a GeForce RTX 2080 Ti with Mitsuba 2.
Each figure is the median wall time of several pictures from start to pixels in memory, after pictures that
warm up; the scene is loaded before. The last lines give the fast mode: a light field once for a design, then
its presses, each one from the probe to the picture.
"""

import argparse
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from itertools import count

import numpy as np
from light_transport import coloured, presses

from designlab.core.backend import activate, cuda_devices
from designlab.core.store import CACHE_VARIABLE
from designlab.sensor.camera import View
from designlab.sensor.design import Design, preset
from designlab.simulation.render import sensors
from designlab.simulation.simulator import Simulator

# (side in pixels, samples a pixel, the paper's milliseconds)
PUBLISHED = (
    (600, 4, 64.0),
    (600, 8, 95.0),
    (600, 16, 174.0),
    (128, 8, 33.0),
    (256, 8, 36.0),
    (512, 8, 55.0),
    (1024, 8, 126.0),
)
DESIGN = "gelsight-2020-flat"


def square(design: Design, side: int) -> View:
    """View of the sensing area, cut to a square of so many pixels a side."""
    whole = design.view(side)
    left = whole.x_px + (whole.width_px - whole.height_px) / 2
    return whole._replace(x_px=left, width_px=whole.height_px, columns=side, rows=side)


def median_ms(action: Callable[[], None], repeats: int) -> float:
    """Median wall time in milliseconds, after two runs that warm up."""
    times = []
    for number in range(repeats + 2):
        begun = time.perf_counter()
        action()
        if number >= 2:
            times.append(1e3 * (time.perf_counter() - begun))
    return statistics.median(times)


def picture_ms(side: int, samples: int, *, repeats: int) -> float:
    """Time of one picture of a press by Mitsuba's path tracer."""
    import mitsuba as mi

    design = preset(DESIGN)
    simulator = Simulator(design, view=square(design, side), samples=samples, seed=1, estimator="path")
    scene = simulator.scene(simulator.surface(presses(1)[0]))
    integrator = {"type": "path", "max_depth": scene.path_length}
    loaded = coloured(scene, integrator)
    description = {**sensors.sensor(scene, samples)}
    description["sampler"] = {"type": "independent", "sample_count": samples}
    description["film"]["pixel_format"] = "rgb"
    camera, seeds = mi.load_dict(description), count()

    def render() -> None:
        np.asarray(mi.render(loaded, sensor=camera, spp=samples, seed=next(seeds)))

    return median_ms(render, repeats)


def fast_ms(side: int) -> tuple[float, float]:
    """Time of a light field and of the first press, and the median of eleven further presses."""
    design = preset(DESIGN)
    times: list[float] = []
    for seed in (1, 2):  # the first run warms up
        simulator = Simulator(design, view=square(design, side), seed=seed)
        times = []
        for press in presses(12):
            begun = time.perf_counter()
            _ = simulator.frame(press).basis
            times.append(1e3 * (time.perf_counter() - begun))
    return times[0], statistics.median(times[1:])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7, help="pictures of each figure (default: 7)")
    args = parser.parse_args()
    backend = activate()
    print(f"back end {backend.variant}, {backend.threads} processor cores; {backend.reason}")
    if backend.variant == "cuda_ad_rgb":
        print("device: " + ", ".join(cuda_devices()[1:]))
    else:
        print("no CUDA device: CUDA was not tried")
    print(f"{'pixels':>12}{'samples':>9}{'here ms':>10}{'RTX 2080 Ti ms (paper)':>25}{'ratio':>8}")
    for side, samples, paper_ms in PUBLISHED:
        here = picture_ms(side, samples, repeats=args.repeats)
        print(
            f"{side:>5} x {side:<4}{samples:>9}{here:>10.1f}{paper_ms:>25.0f}{paper_ms / here:>8.2f}",
            flush=True,
        )
    with tempfile.TemporaryDirectory() as folder:
        os.environ[CACHE_VARIABLE] = folder  # the light field is traced, not taken from the disk
        for side in (160, 600):
            first, press = fast_ms(side)
            print(
                f"fast mode, {side} x {side}: light field and first press {first:.0f} ms, "
                f"each further press {press:.0f} ms",
                flush=True,
            )


if __name__ == "__main__":
    main()
