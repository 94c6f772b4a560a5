"""Physical effects that a generated sensor has and its design does not mention; absent at null values."""

from collections.abc import Mapping

import numpy as np

from designlab.validation.synthetic.effects.base import Planted, PlantedParameter
from designlab.validation.synthetic.effects.camera import CAMERA, GEOMETRY
from designlab.validation.synthetic.effects.colour import COLOUR, of_filters
from designlab.validation.synthetic.effects.contact import CONTACT
from designlab.validation.synthetic.effects.emission import EMISSION
from designlab.validation.synthetic.effects.material import MATERIAL
from designlab.validation.synthetic.effects.transport import TRANSPORT
from designlab.validation.synthetic.generator_sensor import Rig

__all__ = ["Planted", "PlantedParameter", "apply", "draw", "names", "parameters"]

# One table for each stage.
_EFFECTS: dict[str, Planted] = GEOMETRY | EMISSION | TRANSPORT | MATERIAL | CONTACT | COLOUR | CAMERA


def names() -> tuple[str, ...]:
    """Effects that can be planted."""
    return tuple(_EFFECTS)


def parameters(name: str, rig: Rig) -> dict[str, PlantedParameter]:
    """Parameters of an effect on a sensor.

    Raises
    ------
    ValueError
        If the effect is unknown.
    """
    return _effect(name).known(rig)


def apply(rig: Rig, effects: Mapping[str, Mapping[str, float]]) -> tuple[Rig, dict[str, dict[str, float]]]:
    """Put effects into a sensor.

    Parameters
    ----------
    rig : Rig
        The sensor as designed.
    effects : mapping
        Effect name to values of its parameters; those left out stay at their null. ``colour_mixing`` may
        instead be given by its cause: ``filter_width_nm`` (standard deviation of every channel's filter
        curve) and ``leak`` (transmission of the filters everywhere, as a share of their peak).

    Returns
    -------
    Rig, dict
        The changed sensor, and the values of all parameters of each effect.

    Raises
    ------
    ValueError
        Naming effect, parameter, value and rule.
    """
    truth = {}
    for name, given in effects.items():
        effect = _effect(name)
        allowed = effect.known(rig)
        values = dict(given)
        if name == "colour_mixing" and not values.keys().isdisjoint(("filter_width_nm", "leak")):
            values = of_filters(rig, **values)
        for parameter, value in values.items():
            if parameter not in allowed:
                raise ValueError(
                    f"effect {name}: unknown parameter {parameter!r}; known are {', '.join(allowed)}"
                )
            low, high, unit = allowed[parameter].low, allowed[parameter].high, allowed[parameter].unit
            if not low <= value <= high:
                raise ValueError(
                    f"effect {name}: {parameter} lies between {low:g} and {high:g} {unit}".rstrip()
                    + f", got {value:g}"
                )
        truth[name] = {parameter: float(values.get(parameter, p.null)) for parameter, p in allowed.items()}
        rig = effect.change(rig, truth[name])
    return rig, truth


def draw(name: str, rig: Rig, *, strength: float, seed: int) -> dict[str, float]:
    """Draw values of an effect that lie `strength` usual spreads from null.

    The root of the sum of the squared distances, each in its own spreads, is `strength`; the direction is
    random, to the positive side where only that is possible. Parameters that only shape an effect are drawn
    from a Gaussian of their own and do not count.

    Parameters
    ----------
    name : str
        The effect.
    strength : float
        Distance in usual spreads; values beyond a bound are drawn again.
    seed : int
        Seed of the draw.

    Raises
    ------
    ValueError
        If no values within the bounds are that far from null.
    """
    known = parameters(name, rig)
    if not known:
        raise ValueError(f"effect {name}: has no parameters on this sensor")
    counted = {parameter: p for parameter, p in known.items() if not p.shape}
    random = np.random.default_rng(np.random.SeedSequence([seed, *name.encode()]))
    for _ in range(1000):
        direction = random.standard_normal(len(counted))
        direction *= strength / np.linalg.norm(direction)
        values = {
            parameter: p.null + p.spread * float(abs(step) if p.one_sided else step)
            for (parameter, p), step in zip(counted.items(), direction, strict=True)
        }
        shapes = {
            parameter: p.null + p.spread * float(random.standard_normal())
            for parameter, p in known.items()
            if p.shape
        }
        values = {parameter: (values | shapes)[parameter] for parameter in known}
        if all(p.low <= values[parameter] <= p.high for parameter, p in known.items()):
            return values
    raise ValueError(f"effect {name}: no values within the bounds at strength {strength:g}")


def _effect(name: str) -> Planted:
    if name not in _EFFECTS:
        raise ValueError(f"effect: {name!r} cannot be planted; known are {', '.join(_EFFECTS)}")
    return _EFFECTS[name]
