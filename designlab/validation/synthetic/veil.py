"""The veil is light that does not reach the camera straight from the membrane: off haze or glass."""

import numpy as np

from designlab.core.types import Array
from designlab.simulation.scene.materials import Diffuse
from designlab.validation.synthetic.backlight import GLOW_MM, ImmersedLightField
from designlab.validation.synthetic.generator_sensor import Rig
from designlab.validation.synthetic.tracing import CHANNELS, Glow, Tracer

COLUMNS, ROWS, DEGREE = 12, 9, 4  # rays over the view, and the polynomials through what they find
PATHS = 6000  # for each of them


def veil(rig: Rig, field: ImmersedLightField, tan_x: Array, tan_y: Array, *, seed: int = 5) -> Array:
    """Radiance of every LED group at unit flux beyond the membrane's own, shape (groups, rays).

    Paths start at the camera, a few directions over its view; what they find is smooth. The membrane is as if
    untouched. Zero where neither haze nor a bright housing is there.

    Parameters
    ----------
    tan_x, tan_y : array (rays,)
        Tangents of the viewing rays against the axis, in air.
    """
    glass, groups = rig.glass, len(rig.flux_mw)
    assert glass is not None
    housing = [
        w.material for w in glass.walls if w.name.startswith("housing") and isinstance(w.material, Diffuse)
    ]
    if not glass.scattering_per_mm and not any(any(m.reflectance) for m in housing):
        return np.zeros((groups, len(tan_x)))
    x = np.repeat(np.linspace(tan_x.min(), tan_x.max(), COLUMNS), ROWS * PATHS)
    y = np.tile(np.repeat(np.linspace(tan_y.min(), tan_y.max(), ROWS), PATHS), COLUMNS)
    # From just above the window: nothing but air is between it and the camera.
    fall = rig.camera.position_mm[2] - glass.window_mm - 1e-3
    direction = np.stack([x, y, -np.ones_like(x)], axis=1)
    origin = np.array(rig.camera.position_mm) + fall * direction
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    total = []
    for first in range(0, groups, CHANNELS):
        part = tuple(range(first, min(first + CHANNELS, groups)))
        glow = Glow(field.glow[list(part)], GLOW_MM)
        hazy, clear = Tracer(rig, part, glow=glow), Tracer(rig, part, glow=glow, spreading=False)
        # Equal random numbers: what comes straight from the membrane is the same in both, and cancels.
        found = Tracer(rig, part).radiance(origin, direction, seed=seed, within="air")
        found += hazy.radiance(origin, direction, seed=seed + 1, within="air")
        found -= clear.radiance(origin, direction, seed=seed + 1, within="air")
        total.append(found.reshape(len(part), COLUMNS * ROWS, PATHS).mean(axis=2))
    middle = (tan_x.max() + tan_x.min()) / 2, (tan_y.max() + tan_y.min()) / 2
    half = max(float(np.ptp(tan_x)), 1e-9) / 2, max(float(np.ptp(tan_y)), 1e-9) / 2

    def powers(u: Array, v: Array) -> Array:
        u, v = (u - middle[0]) / half[0], (v - middle[1]) / half[1]
        return np.stack([u**i * v**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)], axis=1)

    fit = np.linalg.lstsq(powers(x[::PATHS], y[::PATHS]), np.concatenate(total).T, rcond=None)[0]
    return np.asarray(np.maximum((powers(tan_x, tan_y) @ fit).T, 0.0))
