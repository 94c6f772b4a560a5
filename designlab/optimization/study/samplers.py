"""Samplers of Optuna draw the parameters of a study from its search ranges."""

import math
import warnings
from typing import TYPE_CHECKING

from designlab.optimization.study.definition import VARIANT, Study, StudyError
from designlab.optimization.study.parameter import Parameter

if TYPE_CHECKING:
    import optuna

_BY_CHANCE = 10  # designs that can be built with which tpe begins
_PATIENCE = 20  # infeasible designs in a row after which every other one is drawn at random


def distributions(study: Study) -> "dict[str, optuna.distributions.BaseDistribution]":
    """Return the search range of every parameter, and the choice among variants.

    Parameters of other variants are drawn too and then ignored: every sampler takes a space that stays the
    same, and few one that depends on what was drawn.
    """
    from optuna.distributions import CategoricalDistribution

    found = {path: distribution(study, path) for path in study.parameters}
    return {VARIANT: CategoricalDistribution(tuple(study.variants)), **found} if study.variants else found


def distribution(study: Study, path: str) -> "optuna.distributions.BaseDistribution":
    """Return the search range of a parameter."""
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    parameter: Parameter = study.parameters[path]
    if parameter.choices is not None or parameter.low is None or parameter.high is None:
        return CategoricalDistribution(parameter.choices or ())
    low, high, step = parameter.low, parameter.high, parameter.step
    if step is not None:
        high = low + math.floor((high - low) / step + 1e-9) * step
    if study.is_integer(path):
        return IntDistribution(int(low), int(high), log=parameter.log, step=int(step or 1))
    return FloatDistribution(low, high, log=parameter.log, step=step)


def method(study: Study, *, rejected: int = 0) -> str:
    """Name of the sampler that makes the next draw of a study.

    Parameters
    ----------
    rejected : int
        Designs in a row, up to now, that could not be built or of which no score could be had. Gaussian
        processes know nothing of these and would propose the like again: tpe draws in their place, and by
        chance if that goes on.

    Raises
    ------
    StudyError
        If the study asks for a sampler that needs what is not installed.
    """
    if rejected > _PATIENCE and rejected % 2 == 1:
        return "random"
    if study.sampler == "auto":
        return "tpe" if rejected or not has_torch() else "gp"
    if study.sampler == "gp" and not has_torch():
        raise StudyError("field sampler: 'gp' needs PyTorch, which is not installed (pip install torch)")
    return "tpe" if study.sampler == "gp" and rejected else study.sampler


def has_torch() -> bool:
    """Whether PyTorch, which Optuna's Gaussian processes need, is installed."""
    import importlib.util

    return importlib.util.find_spec("torch") is not None


def sampler(study: Study, name: str, seed: int, *, infeasible: int = 0) -> "optuna.samplers.BaseSampler":
    """Return a sampler of a study, by its name in `method`, for one draw.

    Parameters
    ----------
    infeasible : int
        Designs so far that could not be built. tpe counts them among those that it begins with by chance:
        without more of these it would know of none that can be built.
    """
    import optuna

    with warnings.catch_warnings():
        # Optuna calls some samplers experimental; its version is pinned.
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        return _sampler(name, study, seed, infeasible)


def _sampler(name: str, study: Study, seed: int, infeasible: int) -> "optuna.samplers.BaseSampler":
    from optuna import samplers

    if name == "random":
        return samplers.RandomSampler(seed=seed)
    population = min(50, max(8, study.trials // 4))
    if name == "nsga2":
        return samplers.NSGAIISampler(population_size=population, seed=seed)
    if name == "nsga3":
        return samplers.NSGAIIISampler(population_size=population, seed=seed)
    if name == "cmaes":
        return samplers.CmaEsSampler(seed=seed, warn_independent_sampling=False)
    if name == "qmc":
        # The sequence is one for the whole study; its position is kept in the record.
        return samplers.QMCSampler(
            scramble=True, seed=study.seed, warn_asynchronous_seeding=False, warn_independent_sampling=False
        )
    if name == "gp":
        return samplers.GPSampler(seed=seed, warn_independent_sampling=False)
    return samplers.TPESampler(seed=seed, n_startup_trials=_BY_CHANCE + infeasible)
