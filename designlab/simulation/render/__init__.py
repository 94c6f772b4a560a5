"""Rendering: the only part of designlab that imports Mitsuba and Dr.Jit."""

from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from designlab.core import store
from designlab.core.backend import activate
from designlab.simulation.contact.surface import Surface
from designlab.simulation.optics.viewing_rays import Rays
from designlab.simulation.scene.scene import Scene

if TYPE_CHECKING:
    from designlab.simulation.render.lightfield import LightField
    from designlab.simulation.render.shading import Shader

Estimator = Literal["fast", "corrected", "reference", "path"]
"""fast: presses are shaded from a light field of the design, with a small known bias; reference: unbiased, by
light tracing where light refracts and by path tracing elsewhere; corrected: fast, plus the smoothed
difference of reference and fast; path: Mitsuba's path tracer."""


class Bias(NamedTuple):
    """Largest systematic error seen on random designs, relative to the mean of a picture.

    Parameters
    ----------
    mean : float
        Of the mean of a picture.
    block : float
        Of the mean of any 8 x 8 pixels of a picture of 160 columns.
    """

    mean: float
    block: float


UNBIASED = Bias(0.0, 0.0)
FAST_BIAS = Bias(mean=0.004, block=0.05)
"""Measured against unbiased pictures of random designs, noise included: `benchmarks/bias_of_fast.py`."""

Thing = TypeVar("Thing")
KEPT_IN_MEMORY = 4  # designs' light fields and shaders, some 100 MB each
LIGHTFIELD_VERSION = 8  # raise when a change of the light field makes cached ones wrong
PHOTONS_PER_SAMPLE = 24_000  # lets one effort setting rule photons and the path tracer's samples


def chosen(estimator: Estimator, scene: Scene) -> Estimator:
    """Estimator that is used: ``scalar_rgb`` has the path tracer alone."""
    if not activate().is_jit or (estimator == "reference" and not scene.refracts):
        return "path"
    return estimator


def bias(estimator: Estimator) -> Bias:
    """Bias of a picture made with an estimator that `chosen` gave."""
    if estimator == "corrected":  # what is finer than the correction is that of fast
        return Bias(0.0, FAST_BIAS.block)
    return FAST_BIAS if estimator == "fast" else UNBIASED


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
        from designlab.simulation.render import reference

        return reference.radiance(
            scene, surface, rays, photons_per_group=samples * PHOTONS_PER_SAMPLE, seed=seed
        )
    from designlab.simulation.render import path

    return path.radiance(scene, samples=samples, seed=seed)


_writer = ThreadPoolExecutor(1, thread_name_prefix="light-field-cache")
_written: "dict[str, Future[None]]" = {}
_fields: dict[str, "list[LightField]"] = {}
_shaders: dict[str, "Shader"] = {}
_strays: dict[str, NDArray[np.float32]] = {}


def shader(
    undeformed: Scene,
    untouched: Surface,
    *,
    area_mm: tuple[float, float],
    samples: int,
    seed: int,
    half: int | None = None,
    like: Scene | None = None,
) -> "Shader":
    """What shades every press of a design, from its light field: baked, or taken from memory or the disk.

    Parameters
    ----------
    undeformed : Scene
        The scene without a press; its camera does not matter.
    untouched : Surface
        The undeformed membrane on the grid that all presses share.
    area_mm : tuple of float
        Width and height of the part of the membrane that matters most, the sensing area.
    samples : int
        Effort; photons in proportion.
    seed : int
        Same seeds, same numbers, on one back end.
    half : int, optional
        Of the two independent halves of a light field, use this one only; shows its random error.
    like : Scene, optional
        Undeformed scene with as many LEDs whose light field shares its random numbers, see `baking.bake`.
    """
    from designlab.simulation.render.lightfield import mean
    from designlab.simulation.render.shading import Shader

    grid = [untouched.x_mm, untouched.y_mm]
    if like is not None and like.light_digest == undeformed.light_digest:
        like = None
    alike = [] if like is None else [like.light_digest]
    key = store.digest("shader", undeformed.light_digest, area_mm, samples, seed, half, *grid, *alike)
    if key not in _shaders:
        halves = _light_field(undeformed, area_mm, samples, seed, like)
        field = mean(halves if half is None else halves[half : half + 1])
        stray = partial(_stray, photons=samples * PHOTONS_PER_SAMPLE // 2, seed=seed, half=half)
        _remember(_shaders, key, Shader(field, undeformed, untouched, stray))
    return _shaders[key]


def _light_field(
    scene: Scene, area_mm: tuple[float, float], samples: int, seed: int, like: Scene | None
) -> "list[LightField]":
    """Bake both halves of a light field, or take them from memory or from the cache on disk."""
    from designlab.simulation.render import baking, lightfield

    programs = LIGHTFIELD_VERSION, version("mitsuba")
    alike = [] if like is None else [like.light_digest]
    key = store.digest("light field", *programs, scene.light_digest, area_mm, samples, seed, *alike)
    if key not in _fields:
        if key in _written:  # forgotten meanwhile, but perhaps not on the disk yet
            _written.pop(key).result()
        stored = store.read_cache(key)
        if stored is None:
            photons = max(1, samples * PHOTONS_PER_SAMPLE // 2)
            seeds = (2 * seed, 2 * seed + 1)
            halves = baking.bake(scene, area_mm=area_mm, photons=photons, seeds=seeds, like=like)
            # Presses are shaded meanwhile; the interpreter waits for it before it ends.
            folder = store.cache_dir() / "arrays"
            _remember(_written, key, _writer.submit(_keep, key, lightfield.packed(halves), folder))
        else:
            halves = lightfield.unpacked(stored)
        _remember(_fields, key, halves)
    return _fields[key]


def _keep(key: str, arrays: dict[str, NDArray[Any]], folder: Path) -> None:
    with suppress(OSError):  # a full or read-only cache costs time, not the result
        store.write_cache(key, arrays, folder=folder)


def _stray(scene: Scene, *, photons: int, seed: int, half: int | None) -> NDArray[np.float32]:
    """Stray light of a half of a light field, or the mean of both."""
    from designlab.simulation.render import stray

    if half is None:
        halves = [_stray(scene, photons=photons, seed=seed, half=k) for k in (0, 1)]
        return np.asarray(np.mean(halves, axis=0), dtype=np.float32)
    key = store.digest("stray light", scene.digest, photons, seed, half)
    if key not in _strays:
        own = int(np.random.SeedSequence([seed, half, 81]).generate_state(1)[0])
        _remember(_strays, key, stray.stray(scene, photons_per_group=photons, seed=own))
    return _strays[key]


def _remember(kept: dict[str, Thing], key: str, thing: Thing) -> None:
    while len(kept) >= KEPT_IN_MEMORY:
        del kept[next(iter(kept))]
    kept[key] = thing
