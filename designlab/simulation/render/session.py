"""What rendering keeps from picture to picture: light fields, shaders and stray light of recent designs."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from designlab.core import store
from designlab.simulation.contact.surface import Surface
from designlab.simulation.render import baking, lightfield
from designlab.simulation.render.estimators import PHOTONS_PER_SAMPLE
from designlab.simulation.render.lightfield import LightField
from designlab.simulation.render.shading import Shader
from designlab.simulation.render.stray import stray
from designlab.simulation.scene.scene import Scene

Thing = TypeVar("Thing")
KEPT_IN_MEMORY = 4  # designs' light fields and shaders, some 100 MB each
LIGHTFIELD_VERSION = 8  # raise when a change of the light field makes cached ones wrong


class RenderSession:
    """Keeps what is costly to make, a few designs of it, and writes light fields to the cache on disk.

    Files are written by a thread of the session's own, for which the interpreter waits before it ends.

    Attributes
    ----------
    least_written : int
        Samples from which light fields are written: who bakes many drafts would fill the cache with them.
    between : callable
        Called time and again while a light field is baked; it may raise to give up, and nothing is kept then.
    """

    def __init__(self) -> None:
        self.least_written = 0
        self.between: Callable[[], None] = lambda: None
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="light-field-cache")
        self._written: dict[str, Future[None]] = {}
        self._fields: dict[str, list[LightField]] = {}
        self._shaders: dict[str, Shader] = {}
        self._strays: dict[str, NDArray[np.float32]] = {}

    def shader(
        self,
        undeformed: Scene,
        untouched: Surface,
        *,
        area_mm: tuple[float, float],
        samples: int,
        seed: int,
        half: int | None = None,
        like: Scene | None = None,
    ) -> Shader:
        """Return what shades every press of a design from its light field.

        The light field is baked, or taken from memory or from the disk.

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
            Number of the half of the light field that is used alone. The two halves are independent: their
            difference shows the random error.
        like : Scene, optional
            Undeformed scene with as many LEDs whose light field shares its random numbers, see `baking.bake`.
        """
        grid = [untouched.x_mm, untouched.y_mm]
        if like is not None and like.light_digest == undeformed.light_digest:
            like = None
        alike = [] if like is None else [like.light_digest]
        key = store.digest("shader", undeformed.light_digest, area_mm, samples, seed, half, *grid, *alike)

        def made() -> Shader:
            halves = self._light_field(undeformed, area_mm, samples, seed, like)
            field = lightfield.mean(halves if half is None else halves[half : half + 1])
            light = partial(self._stray, photons=samples * PHOTONS_PER_SAMPLE // 2, seed=seed, half=half)
            return Shader(field, undeformed, untouched, light)

        return _kept(self._shaders, key, made)

    def _light_field(
        self, scene: Scene, area_mm: tuple[float, float], samples: int, seed: int, like: Scene | None
    ) -> list[LightField]:
        """Bake both halves of a light field, or take them from memory or from the cache on disk."""
        programs = LIGHTFIELD_VERSION, version("mitsuba")
        alike = [] if like is None else [like.light_digest]
        key = store.digest("light field", *programs, scene.light_digest, area_mm, samples, seed, *alike)

        def made() -> list[LightField]:
            if key in self._written:  # forgotten meanwhile, but perhaps not on the disk yet
                self._written.pop(key).result()
            stored = store.read_cache(key)
            if stored is not None:
                return lightfield.unpacked(stored)
            photons = max(1, samples * PHOTONS_PER_SAMPLE // 2)
            seeds = (2 * seed, 2 * seed + 1)
            halves = baking.bake(
                scene, area_mm=area_mm, photons=photons, seeds=seeds, like=like, between=self.between
            )
            if samples >= self.least_written:
                # Presses are shaded meanwhile.
                folder = store.cache_dir() / "arrays"
                packed = lightfield.packed(halves)
                _kept(self._written, key, lambda: self._writer.submit(_write, key, packed, folder))
            return halves

        return _kept(self._fields, key, made)

    def _stray(self, scene: Scene, *, photons: int, seed: int, half: int | None) -> NDArray[np.float32]:
        """Stray light of a half of a light field, or the mean of both."""
        if half is None:
            halves = [self._stray(scene, photons=photons, seed=seed, half=k) for k in (0, 1)]
            return np.asarray(np.mean(halves, axis=0), dtype=np.float32)
        key = store.digest("stray light", scene.digest, photons, seed, half)
        own = int(np.random.SeedSequence([seed, half, 81]).generate_state(1)[0])
        return _kept(self._strays, key, lambda: stray(scene, photons_per_group=photons, seed=own))


def _kept(kept: dict[str, Thing], key: str, make: Callable[[], Thing]) -> Thing:
    """Return what is kept under a key, made first where it is not; the oldest gives way to it."""
    if key not in kept:
        made = make()
        while len(kept) >= KEPT_IN_MEMORY:
            del kept[next(iter(kept))]
        kept[key] = made
    return kept[key]


def _write(key: str, arrays: dict[str, NDArray[Any]], folder: Path) -> None:
    with suppress(OSError):  # a full or read-only cache costs time, not the result
        store.write_cache(key, arrays, folder=folder)


SESSION = RenderSession()
"""The session of this process."""
