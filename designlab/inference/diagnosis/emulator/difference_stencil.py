"""A difference stencil lists the values of effects to render, so that all between can be combined."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from designlab.simulation.effects import Effect, EffectParameter
from designlab.simulation.effects.base import Values

NEAR_SD = 0.5  # steps about values that a fit has found
SHAPE_SD = 1.5  # steps of shapes, which are known least
LEAST_SD = 0.1  # steps shorter than this, at a bound, are taken to the other side


@dataclass(frozen=True)
class StencilStep:
    """Two other values of some parameters of an effect, each of which changes the light of other groups.

    Attributes
    ----------
    effect : str
        The effect.
    parameters : tuple of EffectParameter
        What is moved.
    ends : tuple of values
        The two values of the effect.
    reached : tuple of tuple of float
        For each end, how far the coordinate of each parameter is moved.
    usual : values
        The values between the two.
    product : bool
        Whether the change is of a shape, by a standard deviation of what it is the shape of.
    """

    effect: str
    parameters: tuple[EffectParameter, ...]
    ends: tuple[Values, Values]
    reached: tuple[tuple[float, ...], tuple[float, ...]]
    usual: Values
    product: bool = False

    def taken(self, *, both: bool) -> tuple[int, ...]:
        """Numbers of the ends that are rendered: both, or the nearer one, of equals the latter."""
        near, far = (max(map(abs, reached)) for reached in self.reached)
        return (0, 1) if both else (0,) if near < far else (1,)


def steps(
    effect: Effect, parameters: Sequence[EffectParameter], origin: Values | None
) -> Iterator[StencilStep]:
    """Steps of an effect to either side of its null, or of values that a fit has found.

    Of a one-sided parameter both ends lie on its side. A shape changes nothing at null: there its steps are
    those of the first parameter at one standard deviation.
    """
    if not effect.rendered:
        return
    null = {p.name: p.null for p in parameters}
    here = null if origin is None else origin
    mains = [p for p in parameters if not p.shape]
    free = mains if origin is None else parameters
    for together in _together(free):
        far = effect.step_sd if origin is None else NEAR_SD
        ways = [_ways(p, here[p.name], far) for p in together]
        yield _step(effect.name, tuple(together), here, ways)
    if origin is None:
        main = mains[0]
        raised = {**null, main.name: main.null + main.sd}
        for p in parameters:
            if p.shape:
                yield _step(effect.name, (p,), raised, [_ways(p, p.null, SHAPE_SD)], product=True)


def _step(
    effect: str,
    moved: tuple[EffectParameter, ...],
    here: Values,
    ways: Sequence[tuple[float, float]],
    *,
    product: bool = False,
) -> StencilStep:
    low, high = (
        {**here, **{p.name: here[p.name] + way[end] * p.sd for p, way in zip(moved, ways, strict=True)}}
        for end in (0, 1)
    )
    before, after = (
        tuple(p.coordinate(end[p.name]) - p.coordinate(here[p.name]) for p in moved) for end in (low, high)
    )
    return StencilStep(effect, moved, (low, high), (before, after), here, product)


def _ways(p: EffectParameter, here: float, far: float) -> tuple[float, float]:
    """Two distances from a value, in standard deviations, that stay within the bounds."""
    down = float(np.clip(-far, (p.low - here) / p.sd, 0.0))
    up = float(np.clip(far, 0.0, (p.high - here) / p.sd))
    if -down < LEAST_SD:
        return up, min(2 * up, (p.high - here) / p.sd)
    if up < LEAST_SD:
        return down, max(2 * down, (p.low - here) / p.sd)
    return down, up


def _together(parameters: Sequence[EffectParameter]) -> list[list[EffectParameter]]:
    """Sort parameters so that those of different LED groups are moved at once."""
    lots: list[list[EffectParameter]] = []
    for p in parameters:
        for lot in lots:
            if p.group and all(other.group and other.group != p.group for other in lot):
                lot.append(p)
                break
        else:
            lots.append([p])
    return lots
