"""Screening ranks effects by their evidence in a linear approximation, without a fit."""

from collections.abc import Collection, Sequence

import numpy as np

from designlab.core.types import Array
from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.fixed_pattern import found_pattern
from designlab.inference.diagnosis.likelihood.normal_equations import System, log_evidence
from designlab.inference.diagnosis.selection.confounding import Overlaps, overlaps
from designlab.simulation.effects import effect
from designlab.simulation.effects.base import Scan


def screen(
    fitter: Fitter, state: State, names: Sequence[str], train: Sequence[int]
) -> tuple[dict[str, float], Overlaps]:
    """Logarithm of the Bayes factor of every candidate by linear approximation, on the training shots.

    Parameters
    ----------
    state : State
        The model that they join.
    names : sequence of str
        Candidates; those the model has already are left out.

    Returns
    -------
    dict, Overlaps
        Evidence by candidate, and which of them can stand for which.
    """
    names = [name for name in names if name not in state.values]
    linear = [name for name in names if not effect(name).per_pixel]
    whole = of_all(fitter, state, linear, train)
    found = {name: log_evidence(*alone(whole, name, linear)) - price_of_scan(name) for name in linear}
    for name in names:
        if effect(name).per_pixel:
            found[name] = found_pattern(fitter, state, train).evidence
    return found, overlaps(whole, linear)


def of_all(fitter: Fitter, state: State, names: Sequence[str], train: Sequence[int]) -> System:
    """Normal equations of a model and of all candidates that are no pattern of pixels."""
    scanned = state
    for name in names:
        if scan_of(name) is not None:
            scanned = with_scanned(fitter, scanned, name, train)
    return fitter.system(scanned, train, fitter.unknowns(scanned, [*state.values, *names], train))


def alone(
    whole: System, name: str, others: Sequence[str], *, along: Collection[str] = ()
) -> tuple[Array, Array]:
    """Information about one candidate and its right side, the other candidates held at their null.

    Parameters
    ----------
    whole : System
        Of all candidates.
    others : sequence of str
        All of them.
    along : collection of str
        Parameters of the candidate that are fitted along, as is what shots have in any case.
    """
    part = whole.only(lambda u: u.effect == name or u.effect not in others)
    places = [k for k, u in enumerate(part.unknowns) if u.effect == name and u.name not in along]
    return part.reduced(places)


def scan_of(name: str) -> Scan | None:
    """How an effect finds a parameter that shapes its waves; None for most."""
    draws = effect(name).draws
    return None if draws is None else draws.scan


def price_of_scan(name: str) -> float:
    """Logarithm of evidence that a scan may have found by chance: of one value among many."""
    scan = scan_of(name)
    return 0.0 if scan is None else float(np.log(len(scan.values)))


def with_scanned(fitter: Fitter, state: State, name: str, train: Sequence[int]) -> State:
    """Give an effect the waves of which the training shots hold most."""
    null, scan = effect(name).null(fitter.bank.model.design), scan_of(name)
    assert scan is not None
    best, most = null[scan.parameter], 0.0
    rows = []
    for n in train:
        shot, sigma = fitter.bank.shots[n], fitter.noises[n].sigma
        predicted = fitter.forward.predict(state, n)
        weight = np.where(shot.valid, (predicted / sigma) ** 2, 0.0).sum(axis=(1, 2))
        left = np.where(shot.valid, (shot.signal - predicted) * predicted / sigma**2, 0.0).sum(axis=(1, 2))
        rows.append((shot, left / np.sqrt(np.maximum(weight, 1e-9))))
    longest = scan.most_heights * min(shot.view.height_px for shot, _ in rows)
    for value in scan.values:
        if value > longest:
            break
        energy = 0.0
        for shot, left in rows:
            waves = effect(name).waves(shot.view, null | {scan.parameter: value})[..., 0]
            waves -= waves.mean(axis=1, keepdims=True)
            norm = np.maximum((waves**2).sum(axis=1), 1e-9)
            energy += float((((waves @ (left - left.mean())) ** 2) / norm).sum())
        if energy > most:
            best, most = value, energy
    return state.with_values(name, null | {scan.parameter: best})
