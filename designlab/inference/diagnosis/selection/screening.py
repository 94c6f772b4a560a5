"""Screening ranks effects by their evidence in a linear approximation, without a fit."""

from collections.abc import Sequence

import numpy as np

from designlab.inference.diagnosis.emulator.state import State
from designlab.inference.diagnosis.likelihood.fit import Fitter
from designlab.inference.diagnosis.likelihood.fixed_pattern import found_pattern
from designlab.inference.diagnosis.likelihood.normal_equations import System, log_evidence
from designlab.inference.diagnosis.selection.confounding import Overlaps, overlaps
from designlab.simulation.effects import effect

PERIODS = np.geomspace(40.0, 2000.0, 120)  # rows of the full sensor
LONGEST_PERIOD = 1.05  # heights of a picture: a longer wave is a slope there, which much else may bring about


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
    present = set(state.values)
    names = [name for name in names if name not in present]
    waved = with_period(fitter, state, train) if "banding" in names else state
    linear = [name for name in names if name != "fixed_pattern"]
    held = [name for name in present if name != "fixed_pattern"]
    unknowns = fitter.unknowns(waved, [*held, *linear], train)
    whole = fitter.system(waved, train, unknowns)
    found = {name: _linear_evidence(whole, name, linear) for name in linear}
    if "banding" in names:
        found["banding"] -= float(np.log(len(PERIODS)))
    if "fixed_pattern" in names:
        found["fixed_pattern"] = found_pattern(fitter, state, train).evidence
    return found, overlaps(whole, linear)


def with_period(fitter: Fitter, state: State, train: Sequence[int]) -> State:
    """Give banding the period of which the training shots hold most."""
    best, most = 400.0, 0.0
    rows = []
    for n in train:
        shot, sigma = fitter.bank.shots[n], fitter.noises[n].sigma
        predicted = fitter.forward.predict(state, n)
        weight = np.where(shot.valid, (predicted / sigma) ** 2, 0.0).sum(axis=(1, 2))
        left = np.where(shot.valid, (shot.signal - predicted) * predicted / sigma**2, 0.0).sum(axis=(1, 2))
        rows.append((shot, left / np.sqrt(np.maximum(weight, 1e-9))))
    longest = LONGEST_PERIOD * min(shot.view.height_px for shot, _ in rows)
    for period in PERIODS[longest >= PERIODS]:
        energy = 0.0
        for shot, left in rows:
            _, row = shot.view.centres()
            turn = 2 * np.pi * row[:, 0] / period
            waves = np.stack([np.sin(turn), np.cos(turn)])
            waves -= waves.mean(axis=1, keepdims=True)
            norm = np.maximum((waves**2).sum(axis=1), 1e-9)
            energy += float((((waves @ (left - left.mean())) ** 2) / norm).sum())
        if energy > most:
            best, most = float(period), energy
    return state.with_values(
        "banding", effect("banding").null(fitter.bank.model.design) | {"period_rows": best}
    )


def _linear_evidence(whole: System, name: str, others: Sequence[str]) -> float:
    """Evidence for an effect, the other candidates held at their null."""
    part = whole.only(lambda u: u.effect == name or u.effect not in others)
    places = [k for k, u in enumerate(part.unknowns) if u.effect == name]
    return log_evidence(*part.reduced(places))
