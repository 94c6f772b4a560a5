"""The ways to render a picture: which of them runs here, how far each is off, and the unbiased ones."""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.core.backend import activate
from designlab.simulation.contact.surface import Surface
from designlab.simulation.optics.viewing_rays import Rays
from designlab.simulation.render import path, reference
from designlab.simulation.scene.scene import Scene

Estimator = Literal["fast", "corrected", "reference", "path"]
"""fast: presses are shaded from a light field of the design, with a small known bias; reference: unbiased, by
light tracing where light refracts and by path tracing elsewhere; corrected: fast, plus the smoothed
difference of reference and fast; path: Mitsuba's path tracer."""


class Bias(NamedTuple):
    """Largest systematic error seen on random designs, relative to the mean of a picture.

    Parameters
    ----------
    mean : float
        Error of the mean of a picture.
    block : float
        Error of the mean of any block of 8 x 8 pixels of a picture of 160 columns.
    """

    mean: float
    block: float


UNBIASED = Bias(0.0, 0.0)
FAST_BIAS = Bias(mean=0.004, block=0.05)
"""Measured against unbiased pictures of random designs, noise included: `benchmarks/bias_of_fast.py`."""

PHOTONS_PER_SAMPLE = 24_000  # lets one effort setting rule photons and the path tracer's samples


def chosen(estimator: Estimator, scene: Scene) -> Estimator:
    """Return the estimator that is used for the one asked for: ``scalar_rgb`` has the path tracer alone."""
    if not activate().is_jit or (estimator == "reference" and not scene.refracts):
        return "path"
    return estimator


def bias(estimator: Estimator) -> Bias:
    """Return the bias of a picture made with an estimator that `chosen` gave."""
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
        photons = samples * PHOTONS_PER_SAMPLE
        return reference.radiance(scene, surface, rays, photons_per_group=photons, seed=seed)
    return path.radiance(scene, samples=samples, seed=seed)
