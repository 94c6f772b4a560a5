"""The updated model holds the effects of a diagnosis, with their covariance, domain and provenance."""

import datetime
from collections.abc import Mapping

import numpy as np

from designlab.core import __version__
from designlab.inference.diagnosis.likelihood.fit import Fit, Fitter
from designlab.inference.diagnosis.result import GapReport, Value
from designlab.measurement import Measurement
from designlab.measurement.shots import Observations, Shot
from designlab.simulation.effects import AppliedEffect, EffectParameter, SensorModel
from designlab.simulation.effects.known import Covariance, Domain, Provenance


def updated(
    fitter: Fitter,
    best: Fit,
    measurement: Measurement,
    seen: Observations,
    report: GapReport,
    values: Mapping[str, Mapping[str, Value]],
    *,
    seed: int,
    samples: int,
) -> SensorModel:
    """Add the effects of a fit to the model that was given, with all that is known of their values.

    Poses, exposures and gains stay behind: they belong to the measurement.

    Parameters
    ----------
    fitter, best : Fitter, Fit
        The bank the fit was made with, and where it ended.
    measurement, seen : Measurement, Observations
        What was fitted.
    report : GapReport
        What the diagnosis says.
    values : mapping of effect and parameter to Value
        Values of all effects of the fit with their intervals, which may be unknown.
    seed, samples : int
        Of its renders.
    """
    given = model = fitter.bank.model
    if not best.state.values:
        return given
    sets = {one.name: one.coherence_set for one in report.effects}
    for name in best.state.values:
        parameters, fitted = fitter.forward.parameters[name], values[name]
        model = model.with_effect(
            AppliedEffect(
                name=name,
                values={p: v.value for p, v in fitted.items()},
                low={p: v.low for p, v in fitted.items() if v.low is not None},
                high={p: v.high for p, v in fitted.items() if v.high is not None},
                bounds={p.name: (p.low, p.high) for p in parameters if p.name in fitted},
                coherence_set=sets.get(name, ()),
                found_in=measurement.name,
            )
        )
    new = covariance(fitter, best)
    joint = model.covariance if new is None else new.beside(model.covariance)
    return SensorModel(
        design=given.design,
        effects=model.effects,
        covariance=joint,
        domain=domain([seen.shots[n] for n in seen.of("background", "train")]),
        provenance=Provenance(
            measurement=measurement.name,
            measurement_digest=measurement.content_digest(),
            design=given.design.name,
            design_digest=given.design.digest,
            verdict=report.verdict,
            gap={split: dict(vars(level)) for split, level in report.gap.items()},
            seed=seed,
            samples=samples,
            version=__version__,
            date=datetime.date.today().isoformat(),
        ),
        parent=given.digest,
    )


def covariance(fitter: Fitter, best: Fit) -> Covariance | None:
    """Joint covariance of all fitted parameters, gains and poses fitted along; None if none was fitted.

    Noise and the errors granted to the simulation, scaled to hold what no catalogue lists as well, see
    `empirical_errors`: that pulls values along what the frames tell least, so correlations stay. The fit
    knows parameters in prior standard deviations, squared ones by their square.
    """
    known = {name: {p.name: p for p in fitter.forward.parameters[name]} for name in best.state.values}
    unknowns = best.system.unknowns
    places = [k for k, u in enumerate(unknowns) if u.shot < 0 and u.name in known.get(u.effect, {})]
    if not places:
        return None
    information, _ = best.system.reduced(places)
    matrix = np.linalg.inv(information + np.eye(len(places)))
    fitted = [(u.effect, known[u.effect][u.name]) for u in (unknowns[k] for k in places)]
    unit = np.array([p.sd**2 if p.squared else p.sd for _, p in fitted])
    matrix = (matrix + matrix.T) / 2 * np.outer(unit, unit)
    unlisted = [
        _unlisted_variance(fitter.unlisted_sd(best, name, p), p, best.state.values[name][p.name])
        for name, p in fitted
    ]
    wider = np.sqrt(1 + np.array(unlisted) / np.diag(matrix))
    matrix = matrix * np.outer(wider, wider)
    return Covariance(
        parameters=tuple(f"{name}.{p.name}" for name, p in fitted),
        matrix=tuple(tuple(float(v) for v in row) for row in matrix),
    )


def _unlisted_variance(unlisted_sd: float, p: EffectParameter, value: float) -> float:
    """Variance of a value by what no catalogue lists; of a squared parameter that of its square."""
    variance = (p.sd * unlisted_sd) ** 2
    return 4 * value**2 * variance + 2 * variance**2 if p.squared else variance


def domain(shots: list[Shot]) -> Domain:
    """Range of the presses and exposures that values were fitted to."""
    return Domain.of(
        [shot.press for shot in shots if shot.press is not None],
        [float(shot.lit.max()) for shot in shots if shot.lit.any()],
    )
