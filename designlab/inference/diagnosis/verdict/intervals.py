"""Intervals of 95 % belong to the values of a fitted effect, also to what differs from picture to picture.

What the fit itself says of the error is joined by what no catalogue lists, see `empirical_errors`.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from designlab.core.intervals import NORMAL, Ends, of_amplitudes, of_deviation
from designlab.inference.diagnosis.emulator.state import State, Unknown
from designlab.inference.diagnosis.likelihood.fit import Fit, Fitter
from designlab.inference.diagnosis.likelihood.fixed_pattern import strengths_as_good
from designlab.inference.diagnosis.likelihood.normal_equations import ALIKE
from designlab.inference.diagnosis.result import Value
from designlab.inference.diagnosis.selection.screening import scan_of
from designlab.simulation.effects import EffectParameter, effect

LEAST_DRAWS = 3


def values(fitter: Fitter, fit: Fit, name: str, train: Sequence[int]) -> dict[str, Value]:
    """Values of an effect with the ends of their 95 % intervals.

    What is drawn anew for each picture is as uncertain as the number of pictures makes it.

    Parameters
    ----------
    fit : Fit
        Of the effect, to the training shots.
    train : sequence of int
        Those shots.
    """
    if strength := effect(name).per_pixel:
        ends = {strength: _of_pattern(fitter, fit.state, name, train)}
    elif effect(name).draws is not None:
        ends = _of_draws(fitter, fit, name, train)
    else:
        ends = _of_parameters(fitter, fit, name)
    fitted, parameters = fit.state.values[name], fitter.forward.parameters[name]
    return {
        p.name: _value(fitter.unlisted_sd(fit, name, p), p, fitted[p.name], ends.get(p.name))
        for p in parameters
        if p.name in fitted
    }


def _value(unlisted_sd: float, p: EffectParameter, value: float, ends: Ends | None) -> Value:
    if ends is None:
        return Value(value, None, None, p.unit, p.null, p.sd, (p.low, p.high), None)
    low, high = min(ends[0], value), max(ends[1], value)
    fit_sd = (high - low) / (2 * NORMAL)
    away = NORMAL * p.sd * unlisted_sd
    low, high = value - np.hypot(value - low, away), value + np.hypot(high - value, away)
    return Value(value, _within(p, low), _within(p, high), p.unit, p.null, p.sd, (p.low, p.high), fit_sd)


def _of_parameters(fitter: Fitter, fit: Fit, name: str) -> dict[str, Ends]:
    """Ends by the curvature of the misfit, all other unknowns fitted along."""
    found = {}
    deviations = _deviations(fit, [k for k, u in enumerate(fit.system.unknowns) if u.effect == name])
    parameters = {p.name: p for p in fitter.forward.parameters[name]}
    for unknown, deviation in deviations.items():
        p = parameters[unknown.name]
        t = p.coordinate(fit.state.values[name][p.name])
        found[p.name] = _beyond_bounds(p, t - NORMAL * deviation), _beyond_bounds(p, t + NORMAL * deviation)
    return found


def _beyond_bounds(p: EffectParameter, t: float) -> float:
    """Value at a coordinate, whatever its bounds: ends are cut when the error is known."""
    return p.null + p.sd * (float(np.sqrt(max(t, 0.0))) if p.squared else t)


def _of_draws(fitter: Fitter, fit: Fit, name: str, train: Sequence[int]) -> dict[str, Ends]:
    """Ends of the strength of draws by their number and errors, and of what is scanned by the misfit."""
    own, said = fit.state.drawn.get(name, {}), effect(name).draws
    assert said is not None
    draws = np.array([own[n] for n in train if n in own])
    if len(draws) < LEAST_DRAWS:
        return {}
    places = [k for k, u in enumerate(fit.system.unknowns) if u.effect == name and u.shot >= 0]
    error = sum((d * u.sd) ** 2 for u, d in _deviations(fit, places).items()) / len(draws)
    ends = {said.strength: (of_amplitudes if said.steady else of_deviation)(draws, error)}
    return ends if said.scan is None else ends | {said.scan.parameter: _of_scanned(fitter, fit, name, train)}


def _of_scanned(fitter: Fitter, fit: Fit, name: str, train: Sequence[int]) -> Ends:
    """Ends by a parabola through the misfits at a value and its neighbours, waves and gains fitted anew."""
    scan = scan_of(name)
    assert scan is not None
    value = fit.state.values[name][scan.parameter]
    step = float(np.log(scan.values[1] / scan.values[0]))

    def misfit(factor: float) -> float:
        return _misfit(fitter, fit.state, name, {scan.parameter: value * factor}, train)

    below, here, above = (misfit(float(np.exp(k * step))) for k in (-1, 0, 1))
    curvature = (below - 2 * here + above) / step**2
    if curvature <= 0:
        return scan.values[0], scan.values[-1]
    best = (below - above) / (2 * step * curvature)
    away = NORMAL / np.sqrt(0.5 * curvature)
    return value * float(np.exp(best - away)), value * float(np.exp(best + away))


def _misfit(
    fitter: Fitter, state: State, name: str, values: Mapping[str, float], train: Sequence[int]
) -> float:
    state = state.with_values(name, {**state.values[name], **values})
    unknowns = [u for u in fitter.unknowns(state, (name,), train) if u.effect in (name, "gain")]
    found = fitter.system(state, train, unknowns)
    _, fallen = found.step(*fitter.bounds(unknowns))
    return found.misfit + float(found.now @ found.now) - fallen


def _of_pattern(fitter: Fitter, state: State, name: str, train: Sequence[int]) -> Ends:
    """Ends where the evidence for a strength has fallen as a Gaussian's would."""
    bare = state.without(name)
    return strengths_as_good(fitter, bare, train, within=ALIKE * NORMAL**2 / 2)


def _deviations(fit: Fit, places: Sequence[int]) -> dict[Unknown, float]:
    """Standard deviations of unknowns, in those of their priors, all others fitted along."""
    if not places:
        return {}
    information, _ = fit.system.reduced(places)
    covariance = np.linalg.inv(information + np.eye(len(places)))
    return {
        fit.system.unknowns[k]: float(np.sqrt(v)) for k, v in zip(places, np.diag(covariance), strict=True)
    }


def _within(p: EffectParameter, value: float) -> float:
    return float(np.clip(value, p.low, p.high))
