"""Colour mixing: spectra of the LEDs seen through the filters of the channels."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from designlab.core.types import Array
from designlab.validation.synthetic.effects.base import Planted, PlantedParameter
from designlab.validation.synthetic.generator_sensor import Rig

CHANNELS = ("R", "G", "B")
WAVELENGTHS_NM = np.arange(300.0, 1151.0, 0.5)
LED_SIGMA_NM = 10.0  # a chip LED is 20 to 30 nm wide at half its peak
BAND_SIGMA_NM = 30.0  # side band of a colour filter


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


def _parameters(rig: Rig) -> dict[str, PlantedParameter]:
    own = own_groups(rig)
    return {
        f"{channel}_from_{group}": PlantedParameter(0.0, 0.1, -0.7, 0.7, "")
        for channel, mine in zip(CHANNELS, own, strict=True)
        for number, group in enumerate(rig.group_names)
        if number != mine
    }


def of_filters(rig: Rig, *, filter_width_nm: float = 10.0, leak: float = 0.0) -> dict[str, float]:
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


def _mix(rig: Rig, values: Mapping[str, float]) -> Rig:
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


COLOUR = {"colour_mixing": Planted(_parameters, _mix)}
