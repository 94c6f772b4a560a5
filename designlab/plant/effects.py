"""Physical effects that a generated sensor has and its design does not mention; absent at null values."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from designlab.plant.rig import Rectangles, Rig

Array = NDArray[np.float64]

CHANNELS = ("R", "G", "B")
WAVELENGTHS_NM = np.arange(300.0, 1151.0, 0.5)
LED_SIGMA_NM = 10.0  # a chip LED is 20 to 30 nm wide at half its peak
BAND_SIGMA_NM = 30.0  # side band of a colour filter


class Parameter(NamedTuple):
    """Null value, usual spread about it, bounds and unit of a parameter."""

    null: float
    spread: float
    low: float
    high: float
    unit: str


def names() -> tuple[str, ...]:
    """Effects that can be planted."""
    return tuple(_EFFECTS)


def parameters(name: str, rig: Rig) -> dict[str, Parameter]:
    """Parameters of an effect on a sensor.

    Raises
    ------
    ValueError
        If the effect is unknown.
    """
    return _effect(name)[0](rig)


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
        known, change = _effect(name)
        allowed = known(rig)
        values = dict(given)
        if name == "colour_mixing" and not values.keys().isdisjoint(("filter_width_nm", "leak")):
            values = _mixing_of_filters(rig, **values)
        for parameter, value in values.items():
            if parameter not in allowed:
                raise ValueError(
                    f"effect {name}: unknown parameter {parameter!r}; known are {', '.join(allowed)}"
                )
            _, _, low, high, unit = allowed[parameter]
            if not low <= value <= high:
                raise ValueError(
                    f"effect {name}: {parameter} lies between {low:g} and {high:g} {unit}, got {value:g}"
                )
        truth[name] = {parameter: float(values.get(parameter, p.null)) for parameter, p in allowed.items()}
        rig = change(rig, truth[name])
    return rig, truth


def draw(name: str, rig: Rig, *, strength: float, seed: int) -> dict[str, float]:
    """Draw values of an effect whose root mean square distance from null is `strength` usual spreads.

    Parameters
    ----------
    name : str
        The effect.
    strength : float
        Distance in usual spreads; values beyond a bound are drawn again.
    seed : int
        Seed of the draw.
    """
    known = parameters(name, rig)
    random = np.random.default_rng(np.random.SeedSequence([seed, *name.encode()]))
    for _ in range(1000):
        direction = random.standard_normal(len(known))
        direction *= strength / np.sqrt(np.mean(direction**2))
        values = {
            parameter: p.null + p.spread * float(step)
            for (parameter, p), step in zip(known.items(), direction, strict=True)
        }
        if all(p.low <= values[parameter] <= p.high for parameter, p in known.items()):
            return values
    raise ValueError(f"effect {name}: no values within the bounds at strength {strength:g}")


def own_groups(rig: Rig) -> tuple[int, ...]:
    """LED group that each camera channel answers to most."""
    return tuple(int(group) for group in rig.mixing.argmax(axis=1))


def response(rig: Rig, filters: Array) -> Array:
    """Response of channels to groups, (3, groups): spectra of unit flux through filters (3, wavelengths).

    Spectra are Gaussian about the groups' peak wavelengths.
    """
    spectra = _gauss(rig.wavelength_nm, LED_SIGMA_NM) / (LED_SIGMA_NM * np.sqrt(2 * np.pi))
    return np.asarray(filters @ spectra.T * (WAVELENGTHS_NM[1] - WAVELENGTHS_NM[0]))


def _gauss(centres_nm: Array, sigma_nm: float) -> Array:
    return np.asarray(np.exp(-(((WAVELENGTHS_NM - np.asarray(centres_nm)[:, None]) / sigma_nm) ** 2) / 2))


def _mixing_parameters(rig: Rig) -> dict[str, Parameter]:
    own = own_groups(rig)
    return {
        f"{channel}_from_{group}": Parameter(0.0, 0.1, -0.7, 0.7, "")
        for channel, mine in zip(CHANNELS, own, strict=True)
        for number, group in enumerate(rig.group_names)
        if number != mine
    }


def _mixing_of_filters(rig: Rig, *, filter_width_nm: float = 10.0, leak: float = 0.0) -> dict[str, float]:
    """Off-diagonal responses, relative to each channel's own group, of Gaussian filters with a leak."""
    own = own_groups(rig)
    if not (1 <= filter_width_nm <= 200 and 0 <= leak <= 0.5):
        raise ValueError(
            f"effect colour_mixing: filter_width_nm lies between 1 and 200 nm and leak between 0 and 0.5, "
            f"got {filter_width_nm:g} nm and {leak:g}"
        )
    filters = leak + (1 - leak) * _gauss(rig.wavelength_nm[list(own)], filter_width_nm)
    answers = response(rig, filters)
    return {
        f"{channel}_from_{rig.group_names[group]}": float(answers[row, group] / answers[row, own[row]])
        for row, channel in enumerate(CHANNELS)
        for group in range(len(rig.group_names))
        if group != own[row]
    }


def _mix_colours(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Give every filter side bands at the other groups' wavelengths; a colour matrix makes negative ones."""
    own = own_groups(rig)
    wanted = np.zeros_like(rig.mixing)
    for row, channel in enumerate(CHANNELS):
        for group, name in enumerate(rig.group_names):
            wanted[row, group] = 1.0 if group == own[row] else values[f"{channel}_from_{name}"]
    bands = _gauss(rig.wavelength_nm, BAND_SIGMA_NM)
    filters = np.linalg.solve(response(rig, bands).T, wanted.T).T @ bands
    answers = response(rig, filters)
    answers /= answers[range(len(CHANNELS)), own][:, None]
    answers[range(len(CHANNELS)), own] = 0.0
    peak = rig.mixing[range(len(CHANNELS)), own][:, None]
    return replace(rig, mixing=rig.mixing + peak * answers)


def _position_parameters(rig: Rig) -> dict[str, Parameter]:
    return {f"{axis}_mm": Parameter(0.0, 0.5, -3.0, 3.0, "mm") for axis in ("radial", "height", "tangential")}


def _move_leds(rig: Rig, values: Mapping[str, float]) -> Rig:
    """Move every package in the cylindrical frame of its row: outwards, up, counter-clockwise."""

    def moved(rectangles: Rectangles) -> Rectangles:
        around = rectangles.across
        outwards = np.stack([around[:, 1], -around[:, 0], np.zeros(len(around))], axis=1)
        up = np.array([0.0, 0.0, values["height_mm"]])
        shift = values["radial_mm"] * outwards + values["tangential_mm"] * around + up
        return rectangles._replace(centre=rectangles.centre + shift)

    return replace(rig, emitters=moved(rig.emitters), boards=moved(rig.boards))


def _kernel_parameters(rig: Rig) -> dict[str, Parameter]:
    return {"length_ratio": Parameter(1.0, 0.4, 0.1, 4.0, "")}


def _stretch_kernel(rig: Rig, values: Mapping[str, float]) -> Rig:
    return replace(rig, kernel_length_mm=rig.kernel_length_mm * values["length_ratio"])


_Known = Callable[[Rig], dict[str, Parameter]]
_Change = Callable[[Rig, Mapping[str, float]], Rig]

_EFFECTS: dict[str, tuple[_Known, _Change]] = {
    "colour_mixing": (_mixing_parameters, _mix_colours),
    "led_position": (_position_parameters, _move_leds),
    "contact_kernel": (_kernel_parameters, _stretch_kernel),
}


def _effect(name: str) -> tuple[_Known, _Change]:
    if name not in _EFFECTS:
        raise ValueError(f"effect: {name!r} cannot be planted; known are {', '.join(_EFFECTS)}")
    return _EFFECTS[name]
