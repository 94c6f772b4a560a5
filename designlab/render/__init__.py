"""Rendering: the only part of designlab that imports Mitsuba and Dr.Jit."""

from contextlib import suppress
from importlib.metadata import version
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from designlab import store
from designlab.press import Surface
from designlab.render.backend import activate
from designlab.scene import Scene
from designlab.viewing import Rays

if TYPE_CHECKING:
    from designlab.render.lightfield import LightField
    from designlab.render.shading import Shader

Estimator = Literal["fast", "corrected", "reference", "path"]
"""fast: presses are shaded from a light field of the design, with a small known bias; reference: unbiased, by
light tracing where light refracts and by path tracing elsewhere; corrected: fast, plus the smoothed
difference of reference and fast; path: Mitsuba's path tracer."""

Thing = TypeVar("Thing")
KEPT_IN_MEMORY = 4  # light fields and shaders, some 20 MB each
LIGHTFIELD_VERSION = 4  # raise when a change of the light field makes cached ones wrong
PHOTONS_PER_SAMPLE = 24_000  # lets one effort setting rule photons and the path tracer's samples


def chosen(estimator: Estimator, scene: Scene) -> Estimator:
    """Estimator that is used: ``scalar_rgb`` has the path tracer alone."""
    if not activate().is_jit or (estimator == "reference" and not scene.refracts):
        return "path"
    return estimator


def traces_lens(estimator: Estimator) -> bool:
    """Whether an estimator sees to defocus itself: the path tracer of a just-in-time back end does."""
    return estimator == "path" and activate().is_jit


def trace(
    scene: Scene, surface: Surface, rays: Rays, *, estimator: Estimator, samples: int, seed: int
) -> NDArray[np.float32]:
    """Trace radiance of every LED group at unit flux, shape (groups, rows, columns), in mW/mm2/sr per mW.

    Parameters
    ----------
    scene : Scene
        What to render.
    surface, rays : Surface, Rays
        Its membrane, and where its pixels look.
    estimator : str
        "reference" or "path"; "corrected" stands for its unbiased part, "reference".
    samples : int
        Effort: samples per pixel and LED group, or photons in proportion.
    seed : int
        Same seeds, same numbers, on one back end.
    """
    if chosen("reference" if estimator == "corrected" else estimator, scene) == "reference":
        from designlab.render import reference

        return reference.radiance(
            scene, surface, rays, photons_per_group=samples * PHOTONS_PER_SAMPLE, seed=seed
        )
    from designlab.render import path

    return path.radiance(scene, samples=samples, seed=seed)


_fields: dict[str, "LightField"] = {}
_shaders: dict[str, "Shader"] = {}


def shader(
    undeformed: Scene, untouched: Surface, *, samples: int, seed: int, half: int | None = None
) -> "Shader":
    """What shades every press of a design, from its light field: baked, or taken from memory or the disk.

    Parameters
    ----------
    undeformed : Scene
        The scene without a press; its camera does not matter.
    untouched : Surface
        The undeformed membrane on the grid that all presses share.
    samples : int
        Effort; photons in proportion.
    seed : int
        Same seeds, same numbers, on one back end.
    half : int, optional
        Of the two independent halves of a light field, use this one only; shows its random error.
    """
    from designlab.render.lightfield import mean
    from designlab.render.shading import Shader

    grid = [untouched.x_mm, untouched.y_mm]
    key = store.digest("shader", undeformed.light_digest, samples, seed, half, *grid)
    if key not in _shaders:
        halves = (0, 1) if half is None else (half,)
        field = mean([_light_field(undeformed, samples, seed, k) for k in halves])
        _remember(_shaders, key, Shader(field, undeformed, untouched, seed=seed))
    return _shaders[key]


def _light_field(scene: Scene, samples: int, seed: int, half: int) -> "LightField":
    """Bake half of a light field, or take it from memory or from the cache on disk."""
    from designlab.render import lightfield

    key = store.digest(
        "light field", LIGHTFIELD_VERSION, version("mitsuba"), scene.light_digest, samples, seed, half
    )
    if key not in _fields:
        stored = store.read_cache(key)
        if stored is None:
            photons = max(1, samples * PHOTONS_PER_SAMPLE // 2)
            halved = lightfield.bake(scene, photons=photons, seed=2 * seed + half)
            stored = {
                "power": halved.power,
                "irradiance": halved.irradiance,
                "origin": np.array([halved.x_mm, halved.y_mm]),
            }
            with suppress(OSError):  # a full or read-only cache costs time, not the result
                store.write_cache(key, stored)
        x_mm, y_mm = (float(v) for v in stored["origin"])
        field = lightfield.LightField(stored["power"], stored["irradiance"], x_mm, y_mm)
        _remember(_fields, key, field)
    return _fields[key]


def _remember(kept: dict[str, Thing], key: str, thing: Thing) -> None:
    while len(kept) >= KEPT_IN_MEMORY:
        del kept[next(iter(kept))]
    kept[key] = thing
