"""Rendering: the only part of designlab that imports Mitsuba and Dr.Jit."""

from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from designlab import store
from designlab.press import Surface
from designlab.render.backend import activate
from designlab.scene import Scene
from designlab.viewing import Rays

if TYPE_CHECKING:
    from designlab.render.lightfield import LightField

KEPT_IN_MEMORY = 4  # light fields, about 20 MB each
LIGHTFIELD_VERSION = 1  # raise when a change of the light field makes cached ones wrong


def transport(
    scene: Scene,
    *,
    samples: int,
    seed: int,
    bake_seed: int,
    half: int | None,
    undeformed: Callable[[], Scene],
    surface: Surface,
    rays: Rays,
) -> NDArray[np.float32]:
    """Radiance of every LED group at unit flux, shape (groups, rows, columns), in mW/mm2/sr per mW.

    Where light runs straight, Mitsuba's path tracer renders the deformed scene. Where it refracts, path
    tracing would meet a small LED behind glass only by chance: there the press is shaded from a light field
    traced once for the undeformed scene, unless the back end is ``scalar_rgb``, which has the path tracer
    alone.

    Parameters
    ----------
    scene : Scene
        What to render.
    samples : int
        Effort: samples per pixel and LED group, or light-field photons in proportion.
    seed, bake_seed : int
        Seeds of the path tracer and of the light field. Same seeds, same numbers, on one back end.
    half : int, optional
        Of the two independent halves of a light field, use this one only; shows its random error.
    undeformed : callable
        Returns the scene without a press; its camera does not matter.
    surface, rays : Surface, Rays
        The membrane of `scene`, and where the pixels look.
    """
    if _by_light_field(scene):
        from designlab.render import lightfield

        flat = undeformed()
        fields = [_light_field(flat, samples, bake_seed, k) for k in ((0, 1) if half is None else (half,))]
        mean = lightfield.LightField(
            np.mean([field.power for field in fields], axis=0, dtype=np.float32),
            fields[0].x_mm,
            fields[0].y_mm,
        )
        return lightfield.shade(mean, scene, surface, rays)
    from designlab.render import path

    return path.radiance(scene, samples=samples, seed=seed)


def shows_defocus(scene: Scene) -> bool:
    """Whether what `transport` returns is as sharp as the camera sees it, not sharper."""
    return scene.camera.defocus is None or (activate().is_jit and not _by_light_field(scene))


def _by_light_field(scene: Scene) -> bool:
    return scene.refracts and activate().is_jit


_recent: dict[str, "LightField"] = {}


def _light_field(scene: Scene, samples: int, seed: int, half: int) -> "LightField":
    """Bake half of a light field, or take it from memory or from the cache on disk."""
    from designlab.render import lightfield

    key = store.digest(
        "light field", LIGHTFIELD_VERSION, version("mitsuba"), scene.light_digest, samples, seed, half
    )
    if key not in _recent:
        stored = store.read_cache(key)
        if stored is None:
            halved = lightfield.bake(scene, samples=max(1, samples // 2), seed=2 * seed + half)
            stored = {"power": halved.power, "origin": np.array([halved.x_mm, halved.y_mm])}
            with suppress(OSError):  # a full or read-only cache costs time, not the result
                store.write_cache(key, stored)
        while len(_recent) >= KEPT_IN_MEMORY:
            del _recent[next(iter(_recent))]
        x_mm, y_mm = (float(v) for v in stored["origin"])
        _recent[key] = lightfield.LightField(stored["power"], x_mm, y_mm)
    return _recent[key]
