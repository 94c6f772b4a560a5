"""Radiance by Mitsuba's own path tracer: unbiased, on every back end; slow for small LEDs behind glass."""

import numpy as np
from numpy.typing import NDArray

from designlab.simulation.render import bridge, sensors
from designlab.simulation.render.engine import mi
from designlab.simulation.render.surfaces import needs_media
from designlab.simulation.scene.scene import Scene

PASS_SAMPLES = (256, 64, 16, 4)  # the sampler's grids of cells want powers of four
MAX_WAVEFRONT = 2**26  # pixel samples traced at once; bounds memory


def radiance(scene: Scene, *, samples: int, seed: int) -> NDArray[np.float32]:
    """Radiance of every LED group at unit flux, shape (groups, rows, columns), in mW/mm2/sr per mW.

    Parameters
    ----------
    scene : Scene
        What to render.
    samples : int
        Samples per pixel and group; best a power of four, else the nearest multiple of the one below.
    seed : int
        Seed of the sampler; the same seed gives the same numbers on one back end.
    """
    if sensors.must_resample(scene.camera):
        flat = sensors.perspective_of(scene)
        fine = radiance(flat, samples=max(4, samples // sensors.FINER**2), seed=seed)
        return sensors.resampled(fine, flat, scene)
    pixels = scene.view.columns * scene.view.rows
    single = next(n for n in PASS_SAMPLES if n == 4 or (n <= samples and n * pixels <= MAX_WAVEFRONT))
    passes = max(1, round(samples / single))
    # Only the volumetric integrator tracks what light loses on its way.
    kind = "volpath" if needs_media(scene.shapes) else "path"
    integrator = {"type": kind, "max_depth": int(scene.path_length), "rr_depth": 1000}
    groups = []
    for group in range(scene.groups):
        loaded = bridge.load(scene, group=group, integrator=integrator, samples=single)
        total = np.zeros((scene.view.rows, scene.view.columns))
        for number in range(passes):
            image = mi.render(loaded, spp=single, seed=_seed(seed, group, number))
            total += np.asarray(image, dtype=float).reshape(total.shape)
        groups.append(total / passes)
    return np.stack(groups).astype(np.float32)


def _seed(seed: int, group: int, number: int) -> int:
    return int(np.random.SeedSequence([seed, group, number]).generate_state(1)[0])
